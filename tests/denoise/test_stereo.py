"""Stereo files, one view of which has nothing to denoise."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

import lambent
from lambent.cli import main
from lambent.denoise.files import denoise_file
from lambent.frame.exr import decode
from lambent.frame.files import read_views
from lambent.frame.role import Role


def stereo(path: Path, left: str, right: str, parts: bool) -> Path:
    """A file of two views with these channels; in one part, or one part a view."""
    rng = np.random.default_rng(4)

    def pixels(names: str, lead: str = "") -> dict[str, np.ndarray]:
        return {lead + n: rng.gamma(2.0, 0.5, (16, 20)).astype(np.float32) for n in names}

    if parts:
        made = [
            OpenEXR.Part({"view": view}, pixels(names), f"{'rgba' if 'R' in names else 'z'}.{view}")
            for view, names in (("left", left), ("right", right))
        ]
        OpenEXR.File(made).write(str(path))
    else:
        channels = pixels(left) | pixels(right, "right.")
        OpenEXR.File({"multiView": ["left", "right"]}, channels).write(str(path))
    return path


def changed(before: Path, after: Path) -> set[tuple[int, str]]:
    """Which channels of a file differ in another."""
    one, two = decode(before), decode(after)
    return {
        (part.index, name)
        for part, other in zip(one.parts, two.parts, strict=True)
        for name, channel in part.channels.items()
        if channel.data.tobytes() != other.channels[name].data.tobytes()
    }


@pytest.mark.parametrize("parts", [False, True])
@pytest.mark.parametrize("empty", ["left", "right"])
def test_a_view_without_a_beauty_stays_as_it_is(empty: str, parts: bool, tmp_path: Path) -> None:
    """The other view is denoised, by library and command alike; the empty one is named."""
    chosen = {"left": "RGBZ", "right": "RGBZ", empty: "Z"}
    source = stereo(tmp_path / "in.exr", **chosen, parts=parts)
    result = denoise_file(source, model="box")
    assert result.views == ("left", "right")
    assert f"the view '{empty}' has no beauty and stays as it is" in result.notes
    with_beauty = 0 if empty == "right" else 1
    lead = "" if parts or with_beauty == 0 else "right."
    place = with_beauty if parts else 0
    assert changed(source, result.output) == {(place, lead + c) for c in "RGB"}
    frame = lambent.denoise(source, "box")
    assert frame.has(Role.COLOUR)
    named = [note for note in frame.notes if "the view 'left' has no beauty" in note]
    assert len(named) == (empty == "left")  # the main view, for which another one stands in
    twin = read_views(result.output)["left" if empty == "right" else "right"]
    np.testing.assert_array_equal(frame.colour, twin.colour)


def test_the_command_names_the_view(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With its plan, its preview and its page, which show the view that was denoised."""
    source = stereo(tmp_path / "in.exr", "Z", "RGBZ", parts=False)
    assert main(["denoise", str(source), "--model", "box", "--dry-run", "--json"]) == 0
    plan = json.loads(capsys.readouterr().out)
    assert plan["views"]["left"]["filtered"] == []
    assert plan["views"]["right"]["filtered"] == ["RGB"]
    arguments = ["denoise", str(source), "--model", "box"]
    assert main([*arguments, "--dry-run"]) == 0
    assert "the view 'left' has no beauty and stays as it is" in capsys.readouterr().out
    assert main([*arguments, "--preview", "--report"]) == 0
    assert "the view 'left' has no beauty and stays as it is" in capsys.readouterr().out
    assert (tmp_path / "in_clean_preview.png").is_file()
    assert (tmp_path / "in_clean.html").is_file()


def test_a_file_without_any_beauty_is_refused(tmp_path: Path) -> None:
    source = stereo(tmp_path / "in.exr", "Z", "Z", parts=False)
    for refused in (
        lambda: denoise_file(source, model="box"),
        lambda: lambent.denoise(source, "box"),
    ):
        with pytest.raises(lambent.LambentError, match="no layer for 'colour'"):
            refused()
    assert not (tmp_path / "in_clean.exr").exists()
