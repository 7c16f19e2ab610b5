"""The engine for the processor: OpenVINO for the network, compiled loops for its kernels."""

from __future__ import annotations

from lambent.denoise import prepare, runtime
from lambent.denoise.engines import Work
from lambent.frame.layer import FloatImage
from lambent.kernels.pyramid import COARSE, OWN, filter_planes

#: Images filtered in one pass: weights are made again for the next so many.
AT_ONCE = 4
#: Channel of the first gate logit.
GATE = 4 * (OWN + COARSE + 1)


def filtered(work: Work) -> list[FloatImage]:
    """The images, filtered. Raises `EngineError` and `DamagedFileError`."""
    given, images, divided = work.given, work.images, work.divided
    results: list[FloatImage] = []
    with runtime.pyramid_network(work.model, work.precision, work.threads, work.views) as network:
        space = network.workspace
        memory, same = network.input(prepare.packed_shape(given), given.arrays)
        network.holds(None)
        packed = prepare.packed_inputs(
            given, work.whole, work.preference, "cpu", memory, same, network.step
        )
        network.holds(given.arrays)
        *levels, of_albedo = network(packed)
        d = prepare.divisors(given, of_albedo, "cpu", space) if any(divided) else None
        for first in range(0, len(images), AT_ONCE):
            some = list(images[first : first + AT_ONCE])
            by = list(divided[first : first + AT_ONCE])
            level = prepare.split(given, some, by, d, "cpu", space)
            level = filter_planes(levels, level, "cpu", space)
            channels = [image.shape[2] for image in some]
            gate = levels[0][GATE:]
            results += prepare.merged(given, level, gate, channels, by, d, "cpu")
    return results
