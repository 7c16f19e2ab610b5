"""`compare`: tables, maps, names, and errors that say which files."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from PIL import Image

from lambent.errors import LayerError, OptionError, UnknownNameError
from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.metrics.compare import compare, number
from lambent.metrics.metric import METRICS
from lambent.metrics.relmse import relmse, relmse_map
from lambent.metrics.smape import smape, smape_map

QUICK = ["relmse", "smape", "psnr"]


@pytest.fixture
def images():
    g = np.random.default_rng(0)
    reference = g.uniform(0.1, 2, (20, 30, 3)).astype(np.float32)
    return {
        "reference": reference,
        "noisy": (reference * g.uniform(0.5, 1.5, reference.shape)).astype(np.float32),
        "clean": (reference * g.uniform(0.9, 1.1, reference.shape)).astype(np.float32),
    }


def test_rows_hold_what_the_functions_say(images):
    r = images.pop("reference")
    table = compare(r, images, QUICK)
    assert [row.name for row in table.rows] == ["noisy", "clean"]
    for row in table.rows:
        assert row.values["relmse"] == relmse(images[row.name], r)
        assert row.values["smape"] == smape(images[row.name], r)
    assert table.exposure == auto_exposure(r)
    assert table.size == (30, 20)
    assert table["clean"].values["psnr"] > table["noisy"].values["psnr"]
    assert table.best("psnr") == table.best("relmse") == {"clean"}


def test_maps_are_made_when_asked_for(images):
    r = images.pop("reference")
    table = compare(r, images, ["relmse"])
    assert np.array_equal(table.map("noisy", "relmse"), relmse_map(images["noisy"], r))
    assert table.map("noisy", "smape") is table.map("noisy", "smape")
    with pytest.raises(OptionError, match="no map"):
        table.map("noisy", "psnr")
    with pytest.raises(OptionError, match="no image 'nosy'"):
        table.map("nosy", "relmse")


def test_frames_give_their_spp_and_notes(images):
    r = images.pop("reference")
    frame = Frame.from_arrays(spp=4, colour=images["noisy"]).noted("3 pixels were repaired")
    table = compare(
        Frame.from_arrays(spp=768, colour=r),
        {"noisy": frame},
        ["relmse"],
        details={"noisy": {"model": "none", "seconds": np.float32(0.5)}},
    )
    assert table.pictures[0].spp == 4
    assert table.reference.spp == 768
    assert "noisy: 3 pixels were repaired" in table.notes()
    assert table.as_dict()["images"][0]["details"] == {"model": "none", "seconds": 0.5}


def test_as_dict_is_json_even_with_infinities(images):
    r = images.pop("reference")
    bad = r.copy()
    bad[0, 0] = np.nan
    table = compare(r, {"same": r, "bad": bad}, QUICK)
    text = json.dumps(table.as_dict(), allow_nan=False)
    back = json.loads(text)
    assert back["images"][0]["metrics"]["psnr"] == "inf"
    assert back["images"][1]["bad_pixels"] == 1
    assert any("1 pixels are NaN" in note for note in back["notes"])


def test_markdown_marks_the_best(images):
    r = images.pop("reference")
    text = compare(r, {"a|b": images["noisy"], "clean": images["clean"]}, QUICK).markdown()
    head, _, noisy, clean = text.splitlines()
    assert head == "| image | relMSE ↓ | SMAPE ↓ | PSNR ↑ |"
    assert noisy.startswith("| a\\|b |")
    assert "**" not in noisy
    assert clean.count("**") == 6


def test_without_a_reference_nothing_is_measured_but_change_is_mapped(images):
    table = compare(None, {"noisy": images["noisy"], "clean": images["clean"]})
    assert table.metrics == ()
    assert table.rows[1].values == {}
    assert not table.map("noisy", "smape").any()
    assert np.array_equal(table.map("clean", "smape"), smape_map(images["clean"], images["noisy"]))
    assert table.exposure == auto_exposure(images["noisy"])
    noise = [p.statistics()["noise"] for p in table.pictures]
    assert noise[0] > 0


def test_sizes_that_differ_name_both_images_and_sizes():
    with pytest.raises(LayerError) as caught:
        compare(np.zeros((4, 6, 3)), {"crop": np.zeros((4, 5, 3))})
    assert "image 'crop' is 5x4" in str(caught.value)
    assert "image 'reference' is 6x4" in str(caught.value)


def test_files_are_read_and_named_in_errors(monkeypatch, tmp_path):
    # The reader is another room's; what matters here is that paths reach it and errors name them.
    import sys
    import types

    sizes = {"ref.exr": (4, 6), "a.exr": (4, 6), "b.exr": (4, 5)}

    def read(path):
        name = str(path).rsplit("/", 1)[-1]
        return Frame.from_arrays(colour=np.ones((*sizes[name], 3)))

    module = types.ModuleType("lambent.frame.files")
    module.read = read
    monkeypatch.setitem(sys.modules, "lambent.frame.files", module)
    table = compare("x/ref.exr", ["x/a.exr", "y/a.exr"], ["relmse"])
    assert [row.name for row in table.rows] == ["a", "a (2)"]
    assert table.pictures[1].path == "y/a.exr"
    with pytest.raises(LayerError) as caught:
        compare("x/ref.exr", ["x/b.exr"])
    assert "x/b.exr is 5x4, x/ref.exr is 6x4" in str(caught.value)


def test_unknown_metric_and_nothing_to_compare(images):
    with pytest.raises(UnknownNameError, match="did you mean"):
        compare(images["reference"], {"a": images["noisy"]}, ["smap"])
    with pytest.raises(OptionError, match="nothing to compare"):
        compare(images["reference"], {})
    with pytest.raises(OptionError, match="exposure"):
        compare(images["reference"], {"a": images["noisy"]}, exposure=0)


def test_a_comparison_is_frozen(images):
    table = compare(images["reference"], {"a": images["noisy"]}, ["relmse"])
    with pytest.raises(dataclasses.FrozenInstanceError):
        table.exposure = 2
    with pytest.raises(TypeError):
        table.rows[0].values["relmse"] = 0
    with pytest.raises(ValueError, match="read-only"):
        table.map("a", "relmse")[0, 0] = 1


def test_progress_counts_every_metric_of_every_image(images):
    r = images.pop("reference")
    seen = []
    compare(r, images, QUICK, progress=lambda done, of, what: seen.append((what, done, of)))
    assert [s[1] for s in seen] == list(range(6))
    assert {s[2] for s in seen} == {6}
    assert seen[0][0] == "relMSE of noisy"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0123456, "0.01235"),
        (33.16149, "33.16"),
        (1234.5678, "1235"),
        (0, "0"),
        (math.inf, "∞"),
        (math.nan, "–"),
        (-0.5, "−0.5000"),
        (3.2e-7, "3.20e-07"),
    ],
)
def test_numbers_in_tables(value, text):
    assert number(value) == text


def test_real_frames_of_the_shared_sequence(shared_data):
    """4 spp against 768: the noisy frame's relMSE is near what 4 spp of this scene gives."""
    from lambent.frame.files import read

    folder = shared_data / "sequence" / "cornell-orbit"
    reference = read(folder / "reference_03.exr")
    table = compare(reference, {"noisy": folder / "noisy_03.exr"}, ["relmse", "relmse-trimmed"])
    values = table["noisy"].values
    assert 0.01 < values["relmse-trimmed"] < values["relmse"] < 100


def test_metrics_are_named_singly_by_family_or_in_one_text(images):
    r, noisy = images["reference"], {"noisy": images["noisy"]}
    everything = compare(r, noisy).metrics
    assert everything == tuple(METRICS)
    assert compare(r, noisy, "flip").metrics == ("flip-ldr", "flip-hdr")
    assert compare(r, noisy, "RMSE, flip_ldr,flip").metrics == ("rmse", "flip-ldr", "flip-hdr")
    assert compare(r, noisy, ["relmse"]).metrics == ("relmse",)  # not relmse-trimmed, too
    for name in METRICS:
        table = compare(r, noisy, [name])
        assert table.metrics == (name,)
        assert math.isfinite(table["noisy"].values[name])
    for wrong in ("flipp", ["relmse", "flip-"], "lpips"):
        with pytest.raises(UnknownNameError) as raised:
            compare(r, noisy, wrong)
        assert all(name in raised.value.remedy for name in METRICS)
    with pytest.raises(OptionError, match="no metric is named"):
        compare(r, noisy, " ,")


def test_display_values_are_compared_as_they_are(tmp_path):
    dark, bright = np.full((12, 12, 3), 40, np.uint8), np.full((12, 12, 3), 60, np.uint8)
    for name, pixels in (("dark", dark), ("bright", bright)):
        Image.fromarray(pixels).save(tmp_path / f"{name}.png")
    found = compare(tmp_path / "dark.png", {"bright": tmp_path / "bright.png"}, "psnr")
    assert found.exposure == 1
    assert found["bright"].values["psnr"] == pytest.approx(20 * np.log10(255 / 20), abs=1e-3)
