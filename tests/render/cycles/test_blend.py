"""A .blend rendered by Cycles: roles, sums, motion, cleaning, and what cannot be rendered."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from blend_files import STEP

import lambent
from lambent.errors import (
    DamagedFileError,
    FileError,
    OptionError,
    OutputError,
    UnknownNameError,
)
from lambent.frame.role import Role, Space, Stat
from lambent.frame.windows import Windows
from lambent.render.cycles import render_blend
from lambent.render.cycles.blend import render_blend_frames

pytestmark = pytest.mark.blender


def test_roles_and_sums(blend, process) -> None:
    """The roles that a Mitsuba frame has; both splits sum to the beauty, the passes too."""
    seen: list[float] = []
    frame = render_blend(
        blend("still"), spp=8, size=(64, 48), seed=3, process=process,
        progress=lambda done, total, text: seen.append(done / total),
    )  # fmt: skip
    assert (frame.height, frame.width, frame.spp, frame.dialect) == (48, 64, 8, "blender")
    for role in (
        Role.COLOUR, Role.ALPHA, Role.ALBEDO, Role.NORMAL, Role.DEPTH, Role.POSITION, Role.MOTION,
        Role.DIFFUSE, Role.SPECULAR, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.DIRECT,
        Role.INDIRECT, Role.EMISSION,
    ):  # fmt: skip
        assert frame.has(role), role
        assert np.isfinite(frame[role]).all(), role
    assert frame.layer(Role.MOTION).space is Space.PIXELS
    colour = frame.colour
    assert colour.std() > 0.01
    for a, b in ((Role.DIFFUSE, Role.SPECULAR), (Role.DIRECT, Role.INDIRECT)):
        np.testing.assert_allclose(frame[a] + frame[b], colour, atol=1e-4 * colour.max())
        assert np.abs(frame[a]).mean() > 1e-3
    # Specular is made by subtraction: the passes that it stands for must give the same.
    passes = {n.rpartition(".")[2]: layer.data for n, layer in frame.extras.items()}
    glossy = (passes["Glossy Direct"] + passes["Glossy Indirect"]) * frame[Role.SPECULAR_ALBEDO]
    through = passes["Transmission Direct"] + passes["Transmission Indirect"]
    rest = passes["Environment"] + frame[Role.EMISSION]
    total = glossy + through * passes["Transmission Color"] + rest
    np.testing.assert_allclose(frame[Role.SPECULAR], total, atol=2e-3 * colour.max())
    assert "ViewLayer.Combined_lamp" in frame.extras
    assert seen
    assert seen[-1] == pytest.approx(1.0)
    notes = " ".join(frame.notes)
    assert "Motion blur is off" in notes
    assert "Adaptive sampling is off" in notes
    assert "clamps indirect light at 10" in notes


def test_output_is_whole_and_read_back(blend, process, tmp_path: Path) -> None:
    """What is written is what comes back, and what exists is not written over."""
    out = tmp_path / "out.exr"
    frame = render_blend(blend("still"), output=out, spp=2, size=(32, 24), process=process)
    again = lambent.read(out)
    assert again.spp == 2
    np.testing.assert_array_equal(again.colour, frame.colour)
    np.testing.assert_array_equal(again[Role.MOTION], frame[Role.MOTION])
    assert [p.name for p in tmp_path.iterdir()] == ["out.exr"]
    with pytest.raises(OutputError, match="exists already"):
        render_blend(blend("still"), output=out, spp=2, process=process)


def test_seed(blend, process) -> None:
    """The same seed gives the same samples, another seed others."""
    shots = [
        render_blend(blend("still"), spp=2, size=(24, 16), seed=s, device="cpu", process=process)
        for s in (1, 1, 2)
    ]
    np.testing.assert_array_equal(shots[0].colour, shots[1].colour)
    assert np.abs(shots[0].colour - shots[2].colour).max() > 1e-3


def test_halves_and_variance(blend, process, tmp_path: Path) -> None:
    """Halves average to the colour; the variance is that of renders with other seeds."""
    options = {"size": (32, 24), "process": process, "passes": "light", "device": "cpu"}
    shots = [render_blend(blend("still"), spp=4, halves=True, seed=s, **options) for s in range(24)]
    first = shots[0]
    a, b = first[Role.COLOUR, Stat.HALF_A], first[Role.COLOUR, Stat.HALF_B]
    np.testing.assert_allclose((a + b) / 2, first.colour, rtol=1e-5, atol=1e-6)
    told = np.mean([s[Role.COLOUR, Stat.VARIANCE] for s in shots], axis=0).mean()
    seen = np.var([s.colour for s in shots], axis=0, ddof=1).mean()
    # 24 estimates of one degree of freedom over 768 pixels: within 15 % unless it is wrong.
    assert 0.8 < told / seen < 1.25
    out = tmp_path / "halves.exr"
    kept = render_blend(blend("still"), spp=4, halves=True, output=out, **options)
    again = lambent.read(out)
    assert again.spp == 4
    np.testing.assert_array_equal(again[Role.COLOUR, Stat.HALF_A], kept[Role.COLOUR, Stat.HALF_A])


def sampled(image, x, y):
    """An image at places between pixels, bilinear; and which places are inside."""
    height, width = image.shape[:2]
    i, j = np.floor(y).astype(int), np.floor(x).astype(int)
    inside = (i >= 0) & (j >= 0) & (i < height - 1) & (j < width - 1)
    i, j = i.clip(0, height - 2), j.clip(0, width - 2)
    fy, fx = (y - i)[..., None], (x - j)[..., None]
    upper = image[i, j] * (1 - fx) + image[i, j + 1] * fx
    lower = image[i + 1, j] * (1 - fx) + image[i + 1, j + 1] * fx
    return upper * (1 - fy) + lower * fy, inside


def test_motion_leads_to_the_neighbouring_frames(blend, process) -> None:
    """Warping the frame before (and after) gives this one's position and albedo.

    The ball slides and the camera travels and turns. Errors are in pixels: a difference of
    position divided by its change from one pixel to the next. Frames beyond the edge and what is
    hidden in the other frame count too: the median is asked for.
    """
    shots = dict(
        render_blend_frames(
            blend("moving"), [2, 3, 4], spp=4, size=(192, 128), device="cpu", process=process
        )
    )
    now = shots[3]
    position, motion = now[Role.POSITION], now[Role.MOTION]
    ball = now.extras["ViewLayer.Object Index"].data[..., 0] > 0.5
    assert 500 < ball.sum() < ball.size / 2
    assert np.abs(motion[ball]).mean() > 1.0
    gradient = sum(np.linalg.norm(np.gradient(position, axis=k), axis=2) for k in (0, 1)) / 2
    y, x = np.mgrid[0:128, 0:192].astype(float)
    for other, channels, sign in ((2, (0, 1), -1), (4, (2, 3), 1)):
        u, v = x + motion[..., channels[0]], y + motion[..., channels[1]]
        where, inside = sampled(shots[other][Role.POSITION], u, v)
        expected = position + sign * np.where(ball[..., None], STEP, 0.0)
        error = np.linalg.norm(where - expected, axis=2) / gradient
        still, _ = sampled(shots[other][Role.POSITION], x, y)
        unmoved = np.linalg.norm(still - expected, axis=2) / gradient
        albedo, _ = sampled(shots[other][Role.ALBEDO], u, v)
        for part in (ball, ~ball):
            assert np.median(error[inside & part]) < 0.1
            assert np.median(unmoved[inside & part]) > 0.5  # the test could fail
            difference = np.abs(albedo - now[Role.ALBEDO]).mean(axis=2)
            assert np.median(difference[inside & part]) < 0.01


def test_motion_is_written_back_as_it_was(blend, process, tmp_path: Path) -> None:
    """A changed motion layer has Blender's signs in the file again."""
    out = tmp_path / "shot.exr"
    frame = render_blend(blend("moving"), output=out, spp=1, size=(32, 24), process=process)
    again = tmp_path / "again.exr"
    motion = frame.layer(Role.MOTION)
    lambent.write(again, lambent.read(out).with_layer(motion.with_data(motion.data * 2)))
    np.testing.assert_array_equal(lambent.read(again)[Role.MOTION], motion.data * 2)


def test_denoise_cleans_it(blend, process) -> None:
    """`lambent.denoise` brings the frame nearer to a render with many more samples."""
    options = {"size": (96, 64), "process": process, "passes": "light", "device": "cpu"}
    noisy = render_blend(blend("still"), spp=4, seed=1, **options)
    reference = render_blend(blend("still"), spp=256, seed=2, **options)
    clean = lambent.denoise(noisy)

    def error(frame) -> float:
        squares = (frame.colour - reference.colour) ** 2
        return float((squares / (reference.colour**2 + 0.01)).mean())

    assert error(clean) < 0.5 * error(noisy)


# ----------------------------------------------------------------------------------- bad input


def test_frames_have_names_and_seeds_of_their_own(blend, process, tmp_path: Path) -> None:
    """`####` becomes the number; noise does not stand still over frames without motion."""
    shots = dict(
        render_blend_frames(
            blend("still"), [1, 2], output=tmp_path / "shot.####.exr", spp=1, size=(16, 16),
            process=process,
        )
    )  # fmt: skip
    assert sorted(p.name for p in tmp_path.iterdir()) == ["shot.0001.exr", "shot.0002.exr"]
    assert np.abs(shots[1].colour - shots[2].colour).max() > 1e-3


def test_packed_file(blend, process) -> None:
    path = blend("still", "small.packed")
    assert not path.read_bytes().startswith(b"BLENDER")
    assert render_blend(path, spp=1, size=(16, 16), process=process).width == 16


def test_cameras(blend, process) -> None:
    """No camera, none active, an unknown one, one by name."""
    with pytest.raises(FileError, match="no camera"):
        render_blend(blend("no-camera"), process=process)
    with pytest.raises(OptionError, match=r"left, right"):
        render_blend(blend("two-cameras"), process=process)
    with pytest.raises(UnknownNameError, match=r"'lift'(.|\n)*left(.|\n)*right"):
        render_blend(blend("two-cameras"), camera="lift", process=process)
    shots = [
        render_blend(blend("two-cameras"), camera=c, spp=1, size=(16, 16), process=process).colour
        for c in ("left", "right")
    ]
    assert np.abs(shots[0] - shots[1]).max() > 1e-3


def test_not_for_blender(process, tmp_path: Path) -> None:
    """The right first bytes, and rubbish behind them."""
    bad = tmp_path / "bad.blend"
    bad.write_bytes(b"BLENDER17-01v0500" + b"\0" * 100)
    with pytest.raises(DamagedFileError, match="cannot open"):
        render_blend(bad, process=process)


def test_time_limit(blend, process) -> None:
    """A picture ends when the time is up, and tells how many samples it has."""
    frame = render_blend(
        blend("still"), spp=100000, time=1.0, size=(64, 48), device="cpu", process=process
    )
    assert 1 <= frame.spp < 100000
    assert "The time was up" in " ".join(frame.notes)


def test_killed_lambent_leaves_no_blender(blend, tmp_path: Path) -> None:
    """`kill -9` on the way: Blender ends by itself, with its scratch folder; no output file."""
    code = (
        "import sys; from lambent.render.cycles.blend import render_blend_frames\n"
        "from lambent.render.cycles.process import BlenderProcess\n"
        "p = BlenderProcess(); p.start(); print(p.pid, p.scratch, flush=True)\n"
        "list(render_blend_frames(sys.argv[1], None, output=sys.argv[2], spp=100000, process=p))\n"
    )
    out = tmp_path / "out.exr"
    parent = subprocess.Popen(
        [sys.executable, "-c", code, str(blend("still")), str(out)], stdout=subprocess.PIPE
    )
    pid, scratch = parent.stdout.readline().split()
    time.sleep(2)
    parent.kill()
    parent.wait()
    for _ in range(100):
        if not Path(f"/proc/{int(pid)}").exists():
            break
        time.sleep(0.1)
    assert not Path(f"/proc/{int(pid)}").exists()
    assert not Path(scratch.decode()).exists()
    assert not list(tmp_path.iterdir())


def test_a_render_region_lies_in_the_whole_picture(blend, process, tmp_path) -> None:
    """It is written with its place; a size that leaves it out is told."""
    out = tmp_path / "region.exr"
    frame = render_blend(blend("region"), output=out, spp=64, halves=True, process=process)
    assert frame.windows == Windows((24, 32, 71, 47), (0, 0, 95, 63))
    assert lambent.read(out).windows == frame.windows
    assert not any("region" in note for note in frame.notes)
    whole = render_blend(blend("still"), spp=64, size=(96, 64), process=process)
    cut = whole.crop(32, 48, 24, 72)
    assert cut.windows == frame.windows
    apart = {
        (y, x): np.abs(frame[Role.ALBEDO] - whole[Role.ALBEDO][32 + y : 48 + y, 24 + x : 72 + x])
        for y in (-1, 0, 1)
        for x in (-1, 0, 1)
    }
    assert min(apart, key=lambda shift: float(apart[shift].mean())) == (0, 0)
    sized = render_blend(blend("region"), spp=2, halves=True, size=(48, 32), process=process)
    assert (sized.width, sized.height) == (48, 32)
    assert any("render region was left out" in note for note in sized.notes)
