"""`lambent render` as a process: killed at random moments, interrupted, given nonsense."""

from __future__ import annotations

import json
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import renders

import lambent
from lambent.cli import main

LAMBENT = [sys.executable, "-m", "lambent"]

SCENE = """<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="5"/></integrator>
<sensor type="perspective"><float name="fov" value="45"/>
  <transform name="to_world"><lookat origin="0,1,6" target="0,0.5,0" up="0,1,0"/></transform>
  <film type="hdrfilm"><integer name="width" value="240"/><integer name="height" value="180"/>
  <rfilter type="box"/></film></sensor>
<emitter type="constant"/>
<shape type="sphere"><bsdf type="diffuse"/></shape>
<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/>
  <scale value="5"/><translate y="-1"/></transform><bsdf type="plastic"/></shape>
</scene>"""
SPP = 512


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "balls.xml"
    path.write_text(SCENE)
    return path


def command(scene: Path, out: Path, *more: str) -> list[str]:
    return [*LAMBENT, "render", str(scene), "-o", str(out), "--spp", str(SPP), "--resume",
            "--features", "albedo", "--checkpoint", "0.1", *more]  # fmt: skip


def spp_of(path: Path) -> int:
    """Samples in a picture, which must be whole: every layer is decoded."""
    if not path.exists():
        return 0
    frame = lambent.read(path)
    for layer in frame.all_layers():
        assert np.isfinite(layer.data).all()
    assert frame.spp is not None
    return frame.spp


def test_killed_at_ten_random_moments(scene, tmp_path):
    """After each kill the picture is whole and holds no fewer samples; in the end it is the one
    that an undisturbed run makes: nothing lost, nothing doubled."""
    out, rng = tmp_path / "out.exr", random.Random(5)
    reached = [0]
    longest = 2.2  # seconds until a kill; grows while a busy machine reaches no checkpoint in it
    for _ in range(10):
        process = subprocess.Popen(
            command(scene, out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        time.sleep(rng.uniform(0.3, longest))
        process.kill()
        process.wait()
        reached.append(spp_of(out))
        assert reached[-1] >= reached[-2]
        left = [p.name for p in tmp_path.iterdir() if p.name not in ("out.exr", "balls.xml")]
        assert left == []
        longest *= 1.6 if reached[-1] == 0 else 1.0
    assert max(reached) > 0, "every kill came before the first checkpoint"
    subprocess.run(command(scene, out), check=True, capture_output=True)
    alone = tmp_path / "alone.exr"
    subprocess.run(command(scene, alone), check=True, capture_output=True)
    one, other = lambent.read(out), lambent.read(alone)
    assert one.spp == other.spp == SPP
    np.testing.assert_allclose(one.colour, other.colour, rtol=2e-4, atol=2e-5)
    np.testing.assert_allclose(
        one["colour.variance"], other["colour.variance"], rtol=2e-2, atol=1e-7
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_keeps_what_was_reached(scene, tmp_path, number):
    """No checkpoint was due: the picture is written because of the signal.

    A busy machine may still be compiling the kernel when the signal comes; then nothing was
    reached, nothing may be written, and a later signal is tried.
    """
    out = tmp_path / "out.exr"
    for wait in (6, 15, 40, 100):
        process = subprocess.Popen(
            [*LAMBENT, "render", str(scene), "-o", str(out), "--time", "600", "--features", "none"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            preexec_fn=renders.heed_ctrl_c,
        )  # fmt: skip
        time.sleep(wait)
        process.send_signal(number)
        _, err = process.communicate(timeout=120)
        assert process.returncode == 130, err
        assert "Traceback" not in err
        if out.exists():
            break
    reached = spp_of(out)
    assert reached >= 4
    done = subprocess.run(
        [*LAMBENT, "render", str(scene), "-o", str(out), "--spp", "+4", "--resume",
         "--features", "none", "--json"], capture_output=True, text=True, check=True,
    )  # fmt: skip
    (told,) = json.loads(done.stdout)["frames"]
    assert (told["began_with"], told["spp"]) == (reached, reached + 4)


def test_a_render_is_denoised_with_all_its_layers(scene, tmp_path, capsys):
    noisy, reference = tmp_path / "noisy.exr", tmp_path / "reference.exr"
    size = ["--size", "96x72"]
    assert main(["render", str(scene), "-o", str(noisy), "--spp", "4", *size]) == 0
    assert main(["render", str(scene), "-o", str(reference), "--spp", "512", *size]) == 0
    assert main(["denoise", str(noisy), "--model", "nlm"]) == 0
    clean = lambent.read(tmp_path / "noisy_clean.exr")
    truth = lambent.read(reference).colour
    before = np.mean((lambent.read(noisy).colour - truth) ** 2)
    assert np.mean((clean.colour - truth) ** 2) < 0.5 * before
    np.testing.assert_allclose(
        clean["diffuse"] + clean["specular"], clean.colour, rtol=1e-3, atol=1e-4
    )


def test_the_report_shows_the_picture(scene, tmp_path):
    out = tmp_path / "out.exr"
    assert main(["render", str(scene), "-o", str(out), "--spp", "16", "--report",
                 "--size", "48x36"]) == 0  # fmt: skip
    page = (tmp_path / "out.html").read_text()
    assert "16 samples a pixel" in page
    assert page.count("data:image/png") > 10
    assert 'http-equiv="refresh"' not in page.replace("'", '"')


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--spp", "0"], "more than zero"),
        (["--spp", "many"], "not a number of samples"),
        (["--size", "12"], "not a size in pixels"),
        (["--features", "albedoo"], "albedo"),
        (["--camera", "3"], "no camera '3'"),
        (["--light-group", "key"], "NAME=ID"),
        (["--integrator", "magic"], "no integrator"),
        (["--frames", "1-3"], "place for a frame number"),
        (["--device", "tpu"], "no device"),
    ],
)
def test_nonsense_is_told(scene, tmp_path, capsys, options, word):
    code = main(["render", str(scene), "-o", str(tmp_path / "out.exr"), *options])
    assert code in (2, 4, 5)
    text = capsys.readouterr().err
    assert word in text
    assert "Traceback" not in text
    assert not (tmp_path / "out.exr").exists()


def test_ctrl_c_says_what_was_kept(tmp_path):
    scene, out = tmp_path / "scene.xml", tmp_path / "out.exr"
    scene.write_text(SCENE)
    process = subprocess.Popen(
        [sys.executable, "-m", "lambent", "render", str(scene), "-o", str(out), "--time", "60"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        preexec_fn=renders.heed_ctrl_c,
    )  # fmt: skip
    time.sleep(6)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    if out.exists():
        assert re.search(r"out\.exr holds \d+ samples a pixel; --resume continues", err), err
    else:
        assert "nothing is kept" in err
