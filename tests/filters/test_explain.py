"""Explain: the weights shown are those the filter uses."""

import io

import numpy as np
import pytest

from lambent.errors import FileError, OptionError, OutputError
from lambent.filters.denoiser import create
from lambent.filters.explain import CLASSICAL, classical_for, explain, heat, side_by_side
from lambent.frame.files import read, write
from lambent.frame.frame import Frame

MODELS = (
    "box", "gaussian", "bilateral", "cross-bilateral", "nlm", "joint-nlm", "atrous", "atrous-tuned"
)  # fmt: skip


def frame(variance=False):
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:44, 0:60]
    ramp = (0.3 + x / 60)[:, :, None].astype(np.float32)
    colour = ramp * (1 + 0.3 * rng.normal(size=(44, 60, 3))).astype(np.float32)
    more = {"colour_variance": 0.09 * ramp.repeat(3, axis=2) ** 2} if variance else {}
    return Frame.from_arrays(
        colour=colour,
        albedo=ramp.repeat(3, axis=2) * 0.5,
        depth=(2 + y / 50).astype(np.float32),
        **more,
    )


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("pixel", [(30, 20), (0, 0), (59, 41)])
def test_the_weights_make_the_filtered_pixel(model, pixel):
    """Σ_q w_pq c_q from the explanation is the filter's own result, also in a corner."""
    f = frame(variance=pixel == (30, 20))
    options = {"levels": 3} if model.startswith("atrous") else {"radius": 3}
    shown = explain(f, model, *pixel, **options)
    denoiser = create(model, **options).fitted(f)
    wanted = denoiser.filter(f, f.colour)[pixel[1], pixel[0]]
    height, width = shown.weights.shape
    left, top = shown.origin
    patch = f.colour[top : top + height, left : left + width]
    np.testing.assert_allclose(
        (shown.weights[:, :, None] * patch).sum(axis=(0, 1)), wanted, atol=3e-6
    )
    assert shown.sum == pytest.approx(1.0, abs=1e-5)
    assert shown.least >= 0
    assert shown.variance_reduction <= 1.0 + 1e-6


def test_numbers_of_a_box():
    """Known answers: 25 equal weights; no bias on a linear ramp, some on a square."""
    f = frame()
    x = np.arange(60, dtype=np.float32)[None, :, None]
    square = np.repeat(np.repeat(x**2, 44, axis=0), 3, axis=2)
    shown = explain(f, "box", 30, 20, radius=2, reference=square)
    assert shown.weights.shape == (5, 5)
    assert shown.origin == (28, 18)
    assert shown.effective_pixels == pytest.approx(25, rel=1e-5)
    assert shown.greatest == pytest.approx(1 / 25)
    assert shown.bias == pytest.approx((2.0, 2.0, 2.0), rel=1e-3)  # mean of (dx)² over -2..2
    assert shown.bias_from == "reference"
    ramp = explain(f, "box", 30, 20, radius=2, reference=np.sqrt(square))
    assert ramp.bias == pytest.approx((0, 0, 0), abs=1e-4)
    assert explain(f, "box", 30, 20).bias_from == "denoised"


def test_a_file_is_explained_as_its_frame(tmp_path):
    noisy, clean = tmp_path / "noisy.exr", tmp_path / "clean.exr"
    write(noisy, frame())
    write(clean, frame(variance=True))
    by_path = explain(noisy, "box", 30, 20, reference=str(clean))
    by_frame = explain(read(noisy), "box", 30, 20, reference=read(clean))
    assert by_path.as_dict() == by_frame.as_dict()
    np.testing.assert_array_equal(by_path.weights, by_frame.weights)
    with pytest.raises(FileError, match="no such file"):
        explain(tmp_path / "none.exr", "box", 30, 20)


def test_the_picture_and_the_numbers_can_be_saved(tmp_path):
    from PIL import Image

    shown = explain(frame(), "cross-bilateral", 5, 6)
    saved = Image.open(shown.save(tmp_path / "weights.png"))
    assert saved.width > 2 * (saved.height - 50) * 0.8
    assert Image.open(io.BytesIO(shown.png())).size == saved.size
    numbers = shown.as_dict()
    assert numbers["pixel"] == [5, 6]
    assert np.array(numbers["weights"]).sum() == pytest.approx(numbers["sum"], abs=1e-5)
    with pytest.raises(OutputError, match="another place"):
        shown.save(tmp_path / "no" / "weights.png")


def test_the_legend_shows_the_scale_and_the_mark():
    """Under the map: colours from the smallest weight to the greatest, a green frame, letters."""
    import dataclasses

    shown = explain(frame(), "cross-bilateral", 30, 20, radius=3)
    picture = shown.picture()
    rows = 55 * 7  # 7 weights a side at 54 or more screen pixels each
    legend = picture[-50:]
    assert picture.shape[0] < rows + 50
    bar = legend[16]
    assert bar[13].max() < 60  # w = 0 is black
    middle = picture.shape[1] // 2
    assert bar[middle - 26].min() > 240  # the greatest is white
    assert (legend == (0, 255, 128)).all(axis=2).sum() > 40
    assert (legend[28:, : middle // 2] > 150).any()  # letters
    signed = dataclasses.replace(shown, least=-shown.greatest).picture()[-50:][16]
    assert signed[13, 2] > 240
    assert signed[(middle - 12) // 2].max() < 60  # zero lies in the middle


def test_negative_weights_are_blue():
    colours = heat(np.array([[1.0, 0.0, -1.0]]))
    assert colours[0, 0].tolist() == [255, 255, 255]
    assert colours[0, 1].tolist() == [0, 0, 0]
    assert colours[0, 2, 2] == 255
    faint = heat(np.array([[1.0, -0.05]]))[0, 1]
    assert faint[2] > faint[0]


def test_what_cannot_be_explained():
    with pytest.raises(OptionError, match="60x44"):
        explain(frame(), "box", 60, 0)
    with pytest.raises(OptionError, match="not a weighted mean"):
        explain(frame(), "oidn", 0, 0)


def test_models_stand_side_by_side():
    f = frame()
    found = [explain(f, name, 5, 6) for name in ("gaussian", "cross-bilateral")]
    picture = side_by_side(found, half=7)
    zoom = 260 // 15
    assert picture.shape == (15 * zoom + 40, 3 * 15 * zoom + 2 * 8, 3)
    # what lies outside the frame is black, the pixel itself is bright, and marked
    assert picture[2, 2].tolist() == [0, 0, 0]
    middle = 7 * zoom + zoom // 2
    assert picture[middle, middle].min() > 100
    assert picture[7 * zoom, middle].tolist() == [0, 255, 128]


def test_only_filters_that_can_work_stand_beside():
    assert classical_for(frame()) == list(CLASSICAL)
    bare = Frame.from_arrays(colour=frame().colour)
    assert classical_for(bare) == ["gaussian", "nlm"]
