"""The page builder: safe against text from files, self-contained, and complete."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from lambent.errors import OptionError, OutputError
from lambent.frame.frame import Frame
from lambent.metrics.compare import compare
from lambent.report import write_inspection, write_report
from lambent.report.colourmap import error_colours
from lambent.report.comparison import comparison_page, reduced
from lambent.report.histogram import BINS, Axis, counts, histograms
from lambent.report.page import build, escape, json_block

EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\"' &amp; %%body%%"


@pytest.fixture
def images():
    g = np.random.default_rng(0)
    reference = g.uniform(0.1, 2, (24, 36, 3)).astype(np.float32)
    return reference, {
        "noisy": (reference * g.uniform(0.3, 1.7, reference.shape)).astype(np.float32),
        "clean": (reference * g.uniform(0.95, 1.05, reference.shape)).astype(np.float32),
    }


def data_of(page: str) -> dict:
    return json.loads(re.search(r'id="data">(.*?)</script>', page, re.S).group(1))


def test_text_from_files_cannot_become_code(images):
    reference, named = images
    frame = Frame.from_arrays(colour=named["noisy"]).noted(EVIL)
    table = compare(
        reference, {EVIL: frame, "ok": named["clean"]}, ["relmse"], details={"ok": {EVIL: EVIL}}
    )
    page = comparison_page(table, title=EVIL, notes=[EVIL])
    # Two script elements: the data and the page's own; nothing of the text is markup.
    assert len(re.findall(r"<script", page)) == 2
    assert "<img" not in page
    assert "onerror=alert(2)>" not in page
    assert data_of(page)["images"][1]["name"] == EVIL


def test_a_page_of_an_inspection_cannot_be_injected(tmp_path):
    path = write_inspection(
        tmp_path / "i.html",
        {"path": EVIL, "layers": [{"name": EVIL, "why": EVIL, EVIL: 3}], "suspicions": [EVIL]},
        {EVIL: np.ones((4, 4, 3))},
        title=EVIL,
    )
    page = path.read_text("utf-8")
    assert len(re.findall(r"<script", page)) == 1
    assert "<img src=x" not in page
    assert page.count("<img src=") == 1


def test_json_block_holds_any_text_and_refuses_nan():
    value = {"a": "</script><!-- & \u2028 é 😀", "b": [1, 2.5, None]}
    block = json_block("data", value)
    inner = re.search(r">(.*)</script>$", block, re.S).group(1)
    assert "<" not in inner
    assert "&" not in inner
    assert inner.isascii()
    assert json.loads(inner) == value
    with pytest.raises(ValueError, match="JSON"):
        json_block("data", float("nan"))


def test_escape_shows_control_characters():
    assert escape("a\x00<b>\x1b") == "a\ufffd&lt;b&gt;\ufffd"


def test_the_policy_allows_only_what_the_page_brings():
    import base64
    import hashlib

    page = build("t", "<p>b</p>")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page).group(1)
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    for tag, rule in (("script", "script-src"), ("style", "style-src")):
        text = re.search(rf"<{tag}>(.*?)</{tag}>", page, re.S).group(1)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{rule} 'sha256-{digest}'" in policy


def test_nothing_is_loaded_from_anywhere(images):
    reference, named = images
    page = comparison_page(compare(reference, named, ["relmse"]))
    assert "http:" not in page
    assert "https:" not in page
    assert not re.search(r'(src|href)="(?!data:)', page)


def test_the_table_stands_in_the_page_without_any_script(images):
    reference, named = images
    table = compare(reference, named, ["relmse", "psnr"], details={"clean": {"seconds": 0.25}})
    page = comparison_page(table)
    cells = re.findall(r'data-value="([^"]*)" data-metric="relmse"', page)
    assert [float(c) for c in cells] == [row.values["relmse"] for row in table.rows]
    assert 'data-value="0.25"' in page
    best = re.findall(r'data-metric="(\w+)" class=best', page)
    assert best == ["relmse", "psnr"]


def test_a_perfect_image_and_a_broken_one_can_be_shown(images):
    reference, named = images
    broken = named["noisy"].copy()
    broken[2, 3] = np.nan
    table = compare(reference, {"same": reference, "broken": broken}, ["relmse", "psnr"])
    page = comparison_page(table)
    assert 'data-value="inf"' in page
    assert data_of(page)["images"][2]["bad"] == [2 * 36 + 3]
    assert "1 pixels are NaN or infinite" in page


def test_without_a_reference_there_are_changes_but_no_metrics(tmp_path, images):
    _, named = images
    page = write_report(tmp_path / "d.html", named, title="One frame").read_text("utf-8")
    data = data_of(page)
    assert [i["name"] for i in data["images"]] == ["noisy", "clean"]
    assert [m["id"] for m in data["maps"]] == ["smape"]
    assert list(data["maps"][0]["layers"]) == ["clean"]
    assert "<h2>Metrics" not in page
    assert "Distribution of the change" in page
    single = comparison_page(compare(None, {"only": named["noisy"]}))
    assert data_of(single)["maps"] == []


def test_large_pictures_are_reduced_and_crops_are_not(images):
    g = np.random.default_rng(0)
    r = g.random((90, 120, 3)).astype(np.float32)
    table = compare(r, {"a": r * 0.9}, ["relmse"])
    page = comparison_page(table, max_pixels=3000)
    assert data_of(page)["size"] == [60, 45]
    assert "Shown at 1/2 of the size" in page
    cut = comparison_page(table, crop=(10, 20, 50, 40), max_pixels=3000)
    assert data_of(cut)["size"] == [50, 40]
    assert data_of(cut)["offset"] == [10, 20]
    with pytest.raises(OptionError, match="not inside"):
        comparison_page(table, crop=(100, 0, 50, 40))


def test_reduced_is_the_mean_and_keeps_what_is_not_finite():
    image = np.arange(24, dtype=np.float32).reshape(4, 6)
    assert reduced(image, 2).tolist() == [[3.5, 5.5, 7.5], [15.5, 17.5, 19.5]]
    image[0, 0] = np.nan
    assert np.isnan(reduced(image, 2)[0, 0])
    assert reduced(image[:3, :5], 2).shape == (1, 2)


def test_a_page_that_cannot_be_written_is_an_output_error(tmp_path, images):
    _, named = images
    with pytest.raises(OutputError):
        write_report(tmp_path / "missing" / "r.html", named)
    target = tmp_path / "r.html"
    target.write_text("old")
    write_report(target, named)
    assert target.read_text("utf-8").startswith("<!doctype html>")
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"]


def test_a_frame_of_720p_with_four_noisy_pictures_weighs_what_was_promised():
    # Real renders weigh less: here every pixel of two pictures is independent noise.
    g = np.random.default_rng(0)
    y, x = np.mgrid[:720, :1280] / 1280
    r = (np.stack([x, y, x * y], axis=2) + 0.1).astype(np.float32)
    noisy = (r * g.gamma(4, 0.25, r.shape)).astype(np.float32)
    table = compare(r, {"noisy": noisy, "a": r * 0.9, "b": r * 1.1}, ["relmse"])
    assert len(comparison_page(table)) < 4_000_000


# ------------------------------------------------------- colours, histograms


def test_the_error_colours_rise_evenly_in_lightness():
    from skimage.color import rgb2lab

    colours = error_colours()
    assert colours.shape == (256, 3)
    lightness = rgb2lab(colours[None] / 255.0)[0, :, 0]
    assert lightness[0] < 2
    assert lightness[-1] > 95
    assert np.diff(lightness).min() > -0.5
    assert np.abs(np.diff(colours.astype(int), axis=0)).max() < 12  # no edges of their own


def test_histograms_count_every_pixel():
    values = np.random.default_rng(0).lognormal(-4, 3, (50, 60))
    for axis in (Axis(1e-4, 10, "log"), Axis(0, 1)):
        count = counts(values, axis)
        assert count.sum() == values.size
        assert count.shape == (BINS,)
    assert counts(np.array([1e-9, 1e-4]), Axis(1e-4, 10, "log"))[0] == 2
    assert counts(np.array([1.0, 7.0]), Axis(0, 1))[-1] == 2
    assert counts(np.array([0.1, 0.1]), Axis(1e-3, 10, "log"))[BINS // 2] == 2


def test_histograms_say_their_numbers_to_everybody():
    text = histograms({"<a>": np.linspace(0, 1, 101)[None]}, Axis(0, 1), "FLIP")
    assert "FLIP of &lt;a&gt;: half of the pixels below 0.5, 99 % below 0.99" in text


# --------------------------------------------------------------- inspection


def test_an_inspection_shows_everything_it_is_given(tmp_path):
    inspection = {
        "path": "shots/a.exr",
        "dialect": "Cycles",
        "spp": 64,
        "parts": [{"name": "rgba", "width": 32, "compression": "ZIP"}],
        "layers": [
            {
                "name": "Combined",
                "role": "colour",
                "why": "Cycles: pass 'Combined'",
                "range": [0, 4.5],
            },
            {"name": "Normal", "role": "normal", "why": "by name", "range": [-1, 1]},
        ],
        "suspicions": ["the pixel filter looks splatted"],
    }
    path = write_inspection(tmp_path / "i.html", inspection, {"Combined": np.ones((300, 400, 3))})
    page = path.read_text("utf-8")
    for text in ("Cycles", "64", "rgba", "ZIP", "Combined", "by name", "4.5", "splatted"):
        assert text in page
    assert page.index("Suspicions") < page.index("Layers") < page.index("<h2>Parts")
    assert "<title>Inspection of a.exr</title>" in page
    assert len(page) < 60_000


def test_an_inspection_names_every_channel_whatever_their_order(tmp_path):
    # Types alternate along the names: none may be lost in grouping them.
    names = ["A", "B", "Z", "id.x", "id.y"]
    kinds = ["half", "float", "half", "uint", "float"]
    channels = [{"name": n, "type": k} for n, k in zip(names, kinds, strict=True)]
    channels.append({"name": "RY", "type": "half", "x_sampling": 2, "y_sampling": 2})
    page = write_inspection(
        tmp_path / "i.html", {"parts": [{"index": 0, "channels": channels}]}
    ).read_text("utf-8")
    assert "<i>half</i> A  Z<br><i>float</i> B  id.y<br><i>uint</i> id.x" in page
    assert "<i>half (every 2 × 2)</i> RY" in page


def test_broken_values_of_light_stand_out_and_negative_normals_do_not(tmp_path):
    layers = [
        {"name": "L", "role": "colour", "space": "linear", "negative": 7, "nan": 0},
        {"name": "N", "role": "normal", "space": "world", "negative": 9, "nan": 3},
    ]
    page = write_inspection(tmp_path / "i.html", {"layers": layers}).read_text("utf-8")
    assert 'class="number warn">7</td>' in page
    assert 'class="number">9</td>' in page
    assert 'class="number warn">3</td>' in page


def test_real_files_can_be_inspected(shared_data, tmp_path):
    from lambent.frame.inspection import inspect_file

    inspection = inspect_file(shared_data / "exr" / "vray_cornell_layers_cryptomatte.exr").as_dict()
    page = write_inspection(tmp_path / "i.html", inspection).read_text("utf-8")
    for layer in inspection["layers"]:
        assert escape(layer["name"]) in page
        assert escape(layer["why"]) in page
