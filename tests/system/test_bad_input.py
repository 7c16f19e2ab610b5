"""Bad input: a message that names file, layer and remedy; nothing lost; exit code not 0.

Each test is one line of the list that Lambent promises. The command runs in this process, except
where a real one is needed: a full disk, Ctrl-C, kill (`test_interrupted.py`).
"""

from __future__ import annotations

import ctypes
import os
import shutil
import socket
import stat
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import renders

from lambent.cli import main

#: Small and quick, and always there.
FAST = ["--model", "oidn-fast"]


@pytest.fixture
def noisy(tmp_path: Path) -> Path:
    return renders.write(tmp_path / "noisy.exr")


@pytest.fixture
def refused(capsys, tmp_path):
    """Run a command that must fail; return its message. Nothing may be left behind."""

    def run(*args: object, code: int) -> str:
        before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
        capsys.readouterr()
        assert main([str(a) for a in args]) == code
        text = capsys.readouterr().err
        assert text.startswith("error: ")
        assert "Traceback" not in text
        assert "→" in text, "a message without a remedy"
        assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
        return text

    return run


# ---------------------------------------------------------------------- files


def test_missing_file(refused, tmp_path):
    assert "absent.exr: there is no such file" in refused(
        "denoise", tmp_path / "absent.exr", code=2
    )


def test_missing_sequence(refused, tmp_path):
    assert "shot.####.exr" in refused("denoise", tmp_path / "shot.####.exr", code=2)


def test_empty_directory(refused, tmp_path):
    folder = tmp_path / "empty"
    folder.mkdir()
    assert "empty" in refused("denoise", folder, code=2)


def test_no_exr(refused, tmp_path):
    path = tmp_path / "text.exr"
    path.write_text("this is a poem, not a picture")
    assert str(path) in refused("denoise", path, code=2)


def test_empty_file(refused, tmp_path):
    path = tmp_path / "empty.exr"
    path.write_bytes(b"")
    assert str(path) in refused("denoise", path, code=2)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.95, 0.999])
def test_truncated(refused, noisy, tmp_path, share):
    """Cut in the header, in the table of offsets, in the pixels, in the last byte."""
    content = noisy.read_bytes()
    path = tmp_path / "cut.exr"
    path.write_bytes(content[: int(len(content) * share)])
    for command in ("denoise", "inspect"):
        assert str(path) in refused(command, path, code=2)


def test_pixels_overwritten_with_nonsense(refused, noisy, tmp_path):
    content = bytearray(noisy.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 4000] = b"\xff" * 4000
    path = tmp_path / "scratched.exr"
    path.write_bytes(content)
    assert str(path) in refused("denoise", path, code=2)


@pytest.mark.parametrize(
    "name",
    [
        "invalid_attribute.exr",
        "unopenable_header.exr",
        "undecodable_pixels.exr",
        "truncated_scanline.exr",
        "truncated_layers.exr",
    ],
)
def test_damaged_files_of_the_openexr_project(refused, shared_data, tmp_path, name):
    path = tmp_path / name
    shutil.copyfile(shared_data / "exr" / "damaged" / name, path)
    assert str(path) in refused("denoise", path, code=2)


def test_deep(refused, shared_data, tmp_path):
    path = tmp_path / "deep.exr"
    shutil.copyfile(shared_data / "exr" / "openexr_deep_trunks.exr", path)
    assert "deep" in refused("denoise", path, code=2)


def test_deep_flag_alone(refused, noisy, tmp_path):
    """A file that calls itself deep in its version field, without the shared data."""
    content = bytearray(noisy.read_bytes())
    content[4:8] = struct.pack("<I", struct.unpack("<I", content[4:8])[0] | 0x800)
    path = tmp_path / "deep.exr"
    path.write_bytes(content)
    refused("denoise", path, code=2)


# --------------------------------------------------------------------- layers


def test_no_colour_layer_lists_what_there_is(refused, tmp_path):
    arrays = {n: a for n, a in renders.channels().items() if n not in "RGB"}
    arrays["mystery.A1"] = arrays["depth.Z"]
    path = renders.write(tmp_path / "aovs.exr", arrays)
    text = refused("denoise", path, code=3)
    assert "--map colour=" in text
    assert "albedo" in text
    assert "mystery" in text


def test_sizes_that_differ_between_layers(refused, tmp_path):
    """A part of another size is left alone; asked for by name, it is refused."""
    import OpenEXR

    small = np.full((10, 12), 0.5, np.float32)
    beauty = {n: a for n, a in renders.channels().items() if n in "RGB"}
    window = (np.array([0, 0], np.int32), np.array([63, 47], np.int32))
    header = {"type": OpenEXR.scanlineimage, "displayWindow": window}
    parts = [
        OpenEXR.Part({**header, "name": "rgb"}, beauty),
        OpenEXR.Part({**header, "name": "tex"}, {n: small.copy() for n in "RGB"}),
    ]
    path = tmp_path / "sizes.exr"
    OpenEXR.File(parts).write(str(path))
    text = refused("denoise", path, "--albedo", "tex", *FAST, code=3)
    assert "layer 'tex'" in text
    assert str(path) in text
    assert main(["denoise", str(path), *FAST]) == 0


def test_unknown_layer_suggests(refused, noisy):
    text = refused("denoise", noisy, "--albedo", "albeddo", code=4)
    assert "albedo" in text.partition("→")[2]


def test_unknown_role_suggests(refused, noisy):
    assert "did you mean albedo" in refused("denoise", noisy, "--map", "albdo=albedo", code=4)


def test_unknown_pass_suggests(refused, noisy):
    assert "no pass 'speckular'" in refused("denoise", noisy, "--passes", "speckular", code=4)


def test_model_that_needs_what_is_not_there(refused, noisy):
    text = refused("denoise", noisy, "--model", "statmc", code=3)
    assert "statmc" in text
    assert "variance" in text


# -------------------------------------------------------------------- options


def test_unknown_model_suggests(refused, noisy):
    assert "did you mean oidn" in refused("denoise", noisy, "--model", "odin", code=4)


def test_unknown_parameter_suggests(refused, noisy):
    assert "did you mean quality" in refused(
        "denoise", noisy, "--model", "oidn", "--set", "qualty=fast", code=4
    )


@pytest.mark.parametrize(
    "args",
    [
        ["--strength", "2"],
        ["--strength", "-0.1"],
        ["--strength", "lots"],
        ["--strength", "nan"],
        ["--max-memory", "foo"],
        ["--max-memory", "0"],
        ["--frames", "1-5"],  # one file is no sequence
        ["--threads", "0"],
        ["--device", "quantum"],
        ["--map", "albedo"],
        ["--map", "albedo=x", "--map", "albedo=y"],
        ["--set", "quality"],
        ["--set", "quality=bogus"],
    ],
)
def test_option_nonsense(refused, noisy, args):
    refused("denoise", noisy, *args, code=4)


@pytest.mark.parametrize("frames", ["x", "5-1", "1-", "1--3", "1-10x0"])
def test_frames_nonsense(refused, noisy, tmp_path, frames):
    shutil.copyfile(noisy, tmp_path / "shot.0001.exr")
    refused("denoise", tmp_path / "shot.####.exr", "--frames", frames, code=4)


def test_too_little_memory_says_how_much_it_takes(refused, noisy):
    assert "--max-memory" in refused("denoise", noisy, "--max-memory", "1M", code=4)


# --------------------------------------------------------------------- output


def test_output_directory_missing(refused, noisy, tmp_path):
    text = refused("denoise", noisy, "-o", tmp_path / "no" / "way" / "out.exr", code=2)
    assert "mkdir -p" in text


def test_an_output_directory_is_made_if_its_last_part_is_missing(noisy, tmp_path):
    assert main(["denoise", str(noisy), "-o", str(tmp_path / "no" / "out.exr"), *FAST]) == 0
    assert (tmp_path / "no" / "out.exr").is_file()


def test_output_below_a_file(refused, noisy):
    refused("denoise", noisy, "-o", noisy / "out.exr", code=2)


def test_output_where_nobody_may_write(refused, noisy):
    """/proc refuses new files even from root, who may write into read-only folders."""
    if not Path("/proc/self").is_dir():
        pytest.skip("this system has no /proc")
    text = refused("denoise", noisy, "-o", "/proc/out.exr", *FAST, code=2)
    assert "/proc/out.exr" in text


def test_output_equals_input(refused, noisy):
    text = refused("denoise", noisy, "-o", noisy, code=2)
    assert "the input itself" in text
    assert "-o NAME" in text


def test_output_equals_input_through_a_link(refused, noisy, tmp_path):
    link = tmp_path / "link.exr"
    link.symlink_to(noisy)
    assert "the input itself" in refused("denoise", noisy, "-o", link, code=2)


def test_output_exists(refused, noisy):
    (noisy.parent / "noisy_clean.exr").write_text("precious")
    assert "--overwrite" in refused("denoise", noisy, code=2)


def test_output_equals_input_with_overwrite(noisy):
    before = renders.read(noisy)
    assert main(["denoise", str(noisy), "-o", str(noisy), "--overwrite", *FAST]) == 0
    after = renders.read(noisy)
    assert not np.array_equal(before["R"], after["R"])
    np.testing.assert_array_equal(before["depth.Z"], after["depth.Z"])


@pytest.mark.parametrize("command", ["explain", "compare", "inspect"])
def test_an_input_is_never_replaced_by_what_is_made_from_it(refused, noisy, command):
    """Not even with --overwrite: it would be a picture or a page in the place of a render."""
    noisy = noisy.rename(noisy.with_name("noisy.html"))  # else no page would be called like it
    options = {
        "explain": [noisy, "--pixel", "5,5", "--model", "box", "-o", noisy],
        "compare": [noisy, noisy, "--report", noisy],
        "inspect": [noisy, "--report", noisy],
    }[command]
    assert "is an input" in refused(command, *options, "--overwrite", code=2)


@pytest.mark.parametrize("many", [False, True])
def test_standard_output_is_refused_by_its_name(refused, noisy, many):
    sources = [noisy, renders.write(noisy.with_name("b.exr"))] if many else [noisy]
    assert "standard output" in refused("denoise", *sources, "-o", "-", code=2)


def test_standard_input_is_refused_by_its_name(refused):
    assert "standard input" in refused("denoise", "-", code=2)
    assert "standard input" in refused("inspect", "-", code=2)


@pytest.mark.parametrize("command", ["denoise", "inspect", "explain", "compare"])
@pytest.mark.parametrize("kind", ["pipe", "socket", "device"])
def test_what_is_no_file_is_no_input(refused, tmp_path, command, kind):
    """Nothing waits for a writer, and nothing is read that has no end."""
    path = tmp_path / "odd.exr"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(str(path))
    else:
        path = Path("/dev/zero")
    rest = {"explain": ["--pixel", "1,1", "--model", "box"], "compare": [path]}.get(command, [])
    assert f"is a {kind}, not a file" in refused(command, path, *rest, code=2)


def test_a_pipe_is_never_replaced(refused, noisy, tmp_path):
    target = tmp_path / "out.exr"
    os.mkfifo(target)
    for command in (["denoise", noisy, *FAST], ["explain", noisy, "--pixel", "1,1"]):
        text = refused(*command, "-o", target, "--overwrite", code=2)
        assert "is a pipe" in text
    assert stat.S_ISFIFO(target.stat().st_mode)


def test_names_that_are_too_long(refused, noisy, tmp_path):
    long = tmp_path / f"{'x' * 300}.exr"
    assert "too long" in refused("denoise", noisy, "-o", long, code=2)
    for command in ("denoise", "inspect"):
        assert "too long" in refused(command, long, code=2)
    assert "too long" in refused("denoise", tmp_path / f"{'x' * 300}.####.exr", code=2)
    # the input's name is short enough, that of the default output is not
    just = noisy.rename(tmp_path / f"{'x' * 248}.exr")
    assert "too long" in refused("denoise", just, code=2)


def test_names_are_limited_in_bytes(noisy, tmp_path):
    """70 letters of three bytes each are a name; the hidden file beside must be one too."""
    target = tmp_path / ("光" * 80 + ".exr")
    assert main(["denoise", str(noisy), "-o", str(target), *FAST]) == 0
    assert target.is_file()


def bound_by_permissions() -> None:
    """For a child: what a file's mode forbids is forbidden to root too."""
    if sys.platform == "linux" and os.geteuid() == 0:
        libc = ctypes.CDLL(None, use_errno=True)
        drop_from_bounding_set, override, read_search = 24, 1, 2
        for capability in (override, read_search):
            assert libc.prctl(drop_from_bounding_set, capability, 0, 0, 0) == 0


@pytest.mark.skipif(sys.platform != "linux", reason="root is bound by permissions on Linux only")
@pytest.mark.parametrize("command", ["denoise", "inspect"])
@pytest.mark.parametrize("case", ["file", "folder", "folder_of_frames", "pattern", "output"])
def test_without_permission(tmp_path, case, command):
    """Exit code 2 and the path, whichever part may not be read, entered or written to."""
    folder = tmp_path / "shots"
    folder.mkdir()
    render = renders.write(folder / "shot.0001.exr")
    source = {"folder_of_frames": folder, "pattern": folder / "shot.####.exr"}.get(case, render)
    if case == "file":
        render.chmod(0o000)
    else:
        folder.chmod({"folder": 0o644, "output": 0o555}.get(case, 0o000))
    options = FAST if command == "denoise" else ["--report"]
    try:
        done = subprocess.run(
            [sys.executable, "-m", "lambent", command, source, *options],
            capture_output=True, text=True, timeout=60, preexec_fn=bound_by_permissions,
        )  # fmt: skip
    finally:
        folder.chmod(0o755)
    assert done.returncode == 2, done.stderr
    assert "unforeseen" not in done.stderr
    assert str(folder) in done.stderr
    words = ("ermission denied", "not writable", "is a directory")
    assert any(each in done.stderr for each in words)


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize(
    ("args", "code"),
    [
        (["--version"], 0),
        (["models"], 0),
        (["inspect", "noisy.exr"], 0),
        (["inspect", "absent.exr", "--json"], 2),
        (["denoise", "noisy.exr", *FAST], 0),
        (["denoise", "shot.####.exr", "--model", "box"], 0),
    ],
    ids=lambda value: "-".join(value[:2]) if isinstance(value, list) else None,
)
def test_nobody_reads_what_is_printed(noisy, args, code, unbuffered):
    """The exit code stays true, the work is done to its end, and nothing is complained about."""
    for number in (1, 2, 3):
        shutil.copyfile(noisy, noisy.with_name(f"shot.{number:04d}.exr"))
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "lambent", *args], stdout=writing, stderr=subprocess.PIPE,
        text=True, timeout=120, cwd=noisy.parent,
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
    )  # fmt: skip
    os.close(writing)
    assert done.returncode == code, done.stderr
    assert "BrokenPipe" not in done.stderr
    assert "unforeseen" not in done.stderr
    if args[:2] == ["denoise", "shot.####.exr"]:
        assert len(list(noisy.parent.glob("shot_clean.*.exr"))) == 3


def test_a_picture_in_a_pipe_is_refused(noisy):
    with noisy.open("rb") as picture:
        cat = subprocess.Popen(["cat"], stdin=picture, stdout=subprocess.PIPE)
        done = subprocess.run(
            [sys.executable, "-m", "lambent", "inspect", "/dev/stdin"],
            stdin=cat.stdout, capture_output=True, text=True, timeout=60,
        )  # fmt: skip
        cat.stdout.close()
        cat.wait()
    assert done.returncode == 2
    assert "/dev/stdin: is a pipe, not a file" in done.stderr


# ------------------------------------------------- odd pixels, odd pictures


def cleaned(path: Path, *args: str) -> dict[str, np.ndarray]:
    output = path.with_name(path.stem + "_out.exr")
    assert main(["denoise", str(path), "-o", str(output), *FAST, *args]) == 0
    return renders.read(output)


def test_nan_inf_negative_huge_are_repaired_counted_reported(tmp_path, capsys):
    arrays = renders.channels()
    arrays["R"][5, 5] = np.nan
    arrays["G"][20, 30] = np.inf
    arrays["B"][30, 20] = -3.0
    arrays["R"][40, 50] = 3e38
    path = renders.write(tmp_path / "odd.exr", arrays)
    found = cleaned(path)
    text = capsys.readouterr().out
    assert "repaired" in text
    for word in ("NaN", "infinit", "negative"):
        assert word.lower() in text.lower()
    for name in "RGB":
        assert np.isfinite(found[name]).all()
        assert found[name].max() < 100, "a huge pixel has spread"


def test_a_bad_pixel_does_not_spread(tmp_path):
    """Far from the bad pixel the result is what it would be without it."""
    arrays = renders.channels(96, 96)
    good = cleaned(renders.write(tmp_path / "good.exr", arrays), "--set", "input_scale=1")
    arrays["R"][5, 5] = np.nan
    bad = cleaned(renders.write(tmp_path / "bad.exr", arrays), "--set", "input_scale=1")
    np.testing.assert_allclose(bad["R"][60:, 60:], good["R"][60:, 60:], rtol=0.05, atol=1e-3)


def test_all_black_passes_through_with_a_note(tmp_path, capsys):
    arrays = renders.channels()
    for name in "RGB":
        arrays[name][:] = 0
    found = cleaned(renders.write(tmp_path / "black.exr", arrays))
    assert not any(found[name].any() for name in "RGB")
    assert "black" in capsys.readouterr().out


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (2, 3)])
@pytest.mark.parametrize("model", ["oidn", "cross-bilateral", "nlm", "atrous", "box"])
def test_one_pixel_and_one_row(tmp_path, size, model):
    path = renders.write(tmp_path / "tiny.exr", renders.channels(*size))
    output = tmp_path / "out.exr"
    assert main(["denoise", str(path), "-o", str(output), "--model", model]) == 0
    found = renders.read(output)
    assert found["R"].shape == size
    assert np.isfinite(found["R"]).all()


# ------------------------------------------------------------------ sequences


def test_a_range_with_holes_is_done_and_reported(tmp_path, capsys):
    for number in (1, 2, 5):
        renders.write(tmp_path / f"shot.{number:04d}.exr", renders.channels(seed=number))
    assert main(["denoise", str(tmp_path / "shot.####.exr"), "--frames", "1-5", *FAST]) == 2
    text = capsys.readouterr().err
    assert "missing: 3-4" in text
    assert sorted(p.name for p in tmp_path.glob("*clean*")) == [
        "shot_clean.0001.exr",
        "shot_clean.0002.exr",
        "shot_clean.0005.exr",
    ]


def test_a_gap_between_frames_is_a_missing_frame(tmp_path, capsys):
    for number in (1, 3):
        renders.write(tmp_path / f"shot.{number:04d}.exr", renders.channels(seed=number))
    assert main(["denoise", str(tmp_path / "shot.####.exr"), *FAST]) == 2
    assert "missing: 2" in capsys.readouterr().err


def test_the_directory_one_stands_in(tmp_path, capsys, monkeypatch):
    (tmp_path / "shots").mkdir()
    renders.write(tmp_path / "shots" / "a.exr", renders.channels())
    monkeypatch.chdir(tmp_path / "shots")
    assert main(["denoise", ".", *FAST]) == 0
    assert (tmp_path / "shots_clean" / "a.exr").is_file()


def test_a_damaged_frame_does_not_stop_the_others(tmp_path, capsys):
    for number in (1, 2, 3):
        renders.write(tmp_path / f"shot.{number:04d}.exr", renders.channels(seed=number))
    bad = tmp_path / "shot.0002.exr"
    bad.write_bytes(bad.read_bytes()[:700])
    assert main(["denoise", str(tmp_path / "shot.####.exr"), *FAST]) == 2
    text = capsys.readouterr().err
    assert str(bad) in text
    assert "2 frames cleaned, 1 failed" in text
    assert len(list(tmp_path.glob("*clean*"))) == 2
