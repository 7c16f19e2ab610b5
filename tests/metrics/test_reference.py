"""The noise of a reference is taken off the errors that are measured against it."""

from __future__ import annotations

import numpy as np
import pytest

import lambent
from lambent.errors import LayerError
from lambent.frame.role import Role, Stat
from lambent.metrics.reference import reference_of, reference_variance
from lambent.metrics.relmse import relmse

SIDE, SIGMA, OFF = 256, 0.05, 0.05


def halves() -> tuple[lambent.Frame, lambent.Frame]:
    rng = np.random.default_rng(1)
    one, two = (1 + SIGMA * rng.standard_normal((SIDE, SIDE, 3)) for _ in range(2))
    return tuple(  # type: ignore[return-value]
        lambent.Frame.from_arrays(colour=image.astype(np.float32)) for image in (one, two)
    )


def test_two_renders_tell_the_error_against_the_truth() -> None:
    mean, variance = reference_of(*halves())
    assert variance.mean() == pytest.approx(SIGMA**2 / 2, rel=0.02)
    image = np.full((SIDE, SIDE, 3), 1 + OFF, np.float32)
    truth = OFF**2 / 1.01
    assert relmse(image, mean) == pytest.approx((OFF**2 + SIGMA**2 / 2) / 1.01, rel=0.03)
    # what the denominator leaves (metrics.relmse): 4 · OFF · V / 3 of 1, some 3 %
    assert relmse(image, mean, reference_variance=variance) == pytest.approx(truth, rel=0.06)


def test_the_variance_layer_comes_first_then_half_buffers() -> None:
    a, b = halves()
    assert reference_variance(a) is None
    colour = a.layer(Role.COLOUR)
    assert colour is not None
    frame = lambent.Frame.from_arrays(
        colour=(a.colour + b.colour) / 2, colour_half_a=a.colour, colour_half_b=b.colour
    )
    assert frame.has(Role.COLOUR, Stat.HALF_A)
    found = reference_variance(frame)
    np.testing.assert_allclose(found, reference_of(a, b)[1])
    told = lambent.Frame.from_arrays(colour=a.colour, colour_variance=np.ones_like(a.colour))
    np.testing.assert_array_equal(reference_variance(told), 1)


def test_renders_of_two_sizes_are_refused() -> None:
    small = lambent.Frame.from_arrays(colour=np.ones((4, 4, 3), np.float32))
    with pytest.raises(LayerError, match="one size"):
        reference_of(halves()[0], small)
