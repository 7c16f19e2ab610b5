"""Every end of a command has its right exit code, also while the processor has other work.

While `denoise` begins, libraries are loaded and kernels compiled in a second thread. Whatever ends
the command meanwhile, the process may neither crash nor hang.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import renders

LAMBENT = [sys.executable, "-m", "lambent"]
DENOISE = [*LAMBENT, "denoise"]


@pytest.fixture(scope="module")
def _busy() -> Iterator[None]:
    """Other programs that want all processors."""
    code = f"import os\nwhile os.getppid() == {os.getpid()}: sum(range(100000))"
    others = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(os.cpu_count() or 1)]
    yield
    for other in others:
        other.kill()
        other.wait()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A frame, a damaged one, and a sequence that is finished."""
    frame = renders.write(tmp_path / "frame.exr")
    content = frame.read_bytes()
    (tmp_path / "cut.exr").write_bytes(content[: len(content) // 2])
    for number in range(3):
        shutil.copyfile(frame, tmp_path / f"shot.{number:04d}.exr")
    sequence = [*DENOISE, str(tmp_path / "shot.####.exr"), "-o", str(tmp_path / "done")]
    subprocess.run(sequence, check=True, capture_output=True, timeout=120)
    return tmp_path


#: What to add to `lambent denoise`, in a folder, and the exit code.
ENDS = {
    "option": (["frame.exr", "--passes", "foo"], 4),
    "word": (["frame.exr", "--strength", "strong"], 4),
    "missing": (["absent.exr"], 2),
    "damaged": (["cut.exr"], 2),
    "strength0": (["frame.exr", "-o", "out.exr", "--overwrite", "--strength", "0"], 0),
    "finished": (["shot.####.exr", "-o", "done"], 0),
    "done": (["frame.exr", "-o", "out.exr", "--overwrite"], 0),
}


def ended(args: list[str], folder: Path) -> tuple[int, str]:
    """Exit code and messages."""
    done = subprocess.run(
        [*DENOISE, *args], cwd=folder, capture_output=True, text=True, check=False, timeout=120
    )
    return done.returncode, done.stderr


def signalled(args: list[str], folder: Path, number: int, delay: float) -> tuple[int, str]:
    """Exit code and messages of a command that gets a signal so long after it began to run."""
    process = subprocess.Popen(
        [*DENOISE, *args],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=renders.heed_ctrl_c,
    )
    try:
        while not heeds(process.pid, signal.SIGTERM):  # Python itself is not up yet
            assert process.poll() is None, process.communicate()
            time.sleep(0.001)
        time.sleep(delay)
        process.send_signal(number)
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
    return process.returncode, err


def heeds(pid: int, number: int) -> bool:
    """Whether a process has a handler for a signal."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        name, _, value = line.partition(":")
        if name == "SigCgt":
            return bool(int(value, 16) >> (number - 1) & 1)
    return False


def check_ends(folder: Path, times: int) -> None:
    for args, code in ENDS.values():
        for _ in range(times):
            found, err = ended(args, folder)
            assert found == code, f"{args}: {found}\n{err}"
            assert "Traceback" not in err


def check_signals(folder: Path, times: int) -> None:
    """A signal at a random moment, in the start as often as later."""
    rng = random.Random(times)
    for count in range(times):
        number = (signal.SIGINT, signal.SIGTERM)[count % 2]
        source = ["frame.exr", "-o", "out.exr"] if count % 4 < 2 else ["shot.####.exr", "-o", "new"]
        delay = rng.uniform(0, 0.5) if count % 8 < 4 else rng.uniform(0, 2.5)
        code, err = signalled([*source, "--overwrite"], folder, number, delay)
        case = f"{source} {signal.Signals(number).name} after {delay:.3f} s: {code}\n{err}"
        assert "Traceback" not in err, case
        if code == 0:  # it was faster
            made = [folder / "out.exr"] if "out.exr" in source else [*(folder / "new").iterdir()]
            assert len(made) in (1, 3), case
        else:
            assert code == 130, case
            assert err.count("interrupted: ") == 1, case
        left = [p for p in folder.rglob("*") if p.name.startswith(".")]
        assert not left, f"{case}\n{left}"
        for path in [*folder.glob("out*.exr"), *folder.glob("new/*.exr")]:
            assert renders.read(path)["R"].shape == (48, 64), case
            path.unlink()


@pytest.mark.usefixtures("_busy")
def test_ends(folder):
    check_ends(folder, times=2)


@pytest.mark.usefixtures("_busy")
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc here")
def test_signals(folder):
    check_signals(folder, times=16)


@pytest.mark.slow
@pytest.mark.usefixtures("_busy")
@pytest.mark.parametrize("name", ENDS)
def test_200_ends(folder, name):
    args, code = ENDS[name]
    assert [ended(args, folder)[0] for _ in range(200)] == 200 * [code]


@pytest.mark.slow
@pytest.mark.usefixtures("_busy")
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc here")
def test_200_signals(folder):
    check_signals(folder, times=200)
