"""Planes: a view at an offset is the neighbour, and nothing lies outside the image."""

from types import SimpleNamespace

import numpy as np
import pytest

from lambent.kernels.arrays import Layout, Plane, Planes, backend, to_image, valid_pixels


def test_views_are_neighbours():
    """Every offset the border allows; empty outside."""
    rng = np.random.default_rng(0)
    image = rng.random((5, 7, 2), dtype=np.float32)
    layout = Layout(5, 7, 3)
    planes = Planes.of(image, layout, backend())
    padded = np.pad(image, ((3, 3), (3, 3), (0, 0)))
    for dy in range(-3, 4):
        for dx in range(-3, 4):
            found = to_image(planes.views(dx, dy), layout)
            assert (found == padded[3 + dy : 8 + dy, 3 + dx : 10 + dx]).all()


def test_without_mapped_memory_views_are_gathered():
    """The way of CUDA, here on the processor: the same answers."""
    real = backend()
    module = SimpleNamespace(__name__="drjit.cuda", Float=real.Float, UInt32=real.UInt32)
    image = np.random.default_rng(0).random((5, 7, 2), dtype=np.float32)
    layout = Layout(5, 7, 3)
    mapped, gathered = Planes.of(image, layout, real), Planes.of(image, layout, module)
    for dx, dy, extend in ((0, 0, 0), (-3, 2, 0), (1, -1, 2)):
        for a, b in zip(mapped.views(dx, dy, extend), gathered.views(dx, dy, extend), strict=True):
            assert (a.numpy() == b.numpy()).all()


def test_rows_start_on_a_vector_boundary():
    planes = Planes.of(np.ones((5, 7, 2), np.float32), Layout(5, 7, 3), backend())
    assert planes.layout.stride % 16 == 0
    assert planes.memory.ctypes.data % 64 == 0


def test_a_result_is_read_at_offsets_like_an_image():
    """Kernel results are wrapped without a copy; both kinds of plane answer alike."""
    layout, module = Layout(4, 6, 2), backend()
    planes = Planes.of(np.arange(24, dtype=np.float32).reshape(4, 6, 1), layout, module)
    doubled = planes.view(0, extend=1) * 2
    import drjit as dr

    dr.eval(doubled)
    plane = Plane(layout, 1, doubled, module)
    assert (
        to_image([plane.view(1, -1)], layout) == 2 * to_image([planes.view(0, 1, -1)], layout)
    ).all()


def test_a_view_beyond_the_plane_is_refused():
    """Memory outside the plane is never read."""
    planes = Planes.of(np.ones((4, 4, 1), np.float32), Layout(4, 4, 1), backend())
    with pytest.raises(IndexError, match="leaves the plane"):
        planes.view(0, 0, 3)


def test_valid_pixels_need_all_channels():
    image = np.ones((2, 3, 2), np.float32)
    image[0, 1, 1] = np.nan
    other = np.ones((2, 3, 1), np.float32)
    other[1, 2, 0] = -np.inf
    assert valid_pixels(image, None, other).tolist() == [[1, 0, 1], [1, 1, 0]]


def test_valid_pixels_do_not_stumble_over_huge_values():
    """Finite values whose sum overflows are still finite."""
    assert valid_pixels(np.full((2, 2, 3), 3e38, np.float32)).all()
