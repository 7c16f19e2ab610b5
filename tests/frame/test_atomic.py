"""A name holds the old content or the new one, whatever happens on the way."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lambent.errors import OutputError
from lambent.frame import atomic as module
from lambent.frame.atomic import atomic, check_target


@pytest.fixture(params=["nameless", "named"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Both ways: a file without a name (Linux), and a hidden one beside the target."""
    if request.param == "named":
        monkeypatch.delattr(os, "O_TMPFILE", raising=False)
    return request.param


def test_writes_and_replaces(way: str, tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    with atomic(path) as out:
        out.write(b"old")
        assert not path.exists()
    assert path.read_bytes() == b"old"
    os.chmod(path, 0o640)
    with atomic(path, overwrite=True) as out:
        out.write(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert path.stat().st_mode & 0o777 == 0o640
    assert os.listdir(tmp_path) == ["a.bin"]


@pytest.mark.parametrize("error", [ValueError("x"), KeyboardInterrupt(), SystemExit(3)])
def test_nothing_is_left_behind(way: str, error: BaseException, tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")

    def write() -> None:
        with atomic(path, overwrite=True) as out:
            out.write(b"half of the new")
            raise error

    with pytest.raises(type(error)):
        write()
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.bin"]


@pytest.mark.parametrize(
    ("code", "word"), [(errno.ENOSPC, "room"), (errno.EDQUOT, "quota"), (errno.EIO, "disk")]
)
def test_disk_errors_have_a_remedy(way: str, code: int, word: str, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=word) as caught, atomic(tmp_path / "a.bin"):
        raise OSError(code, os.strerror(code))
    assert str(tmp_path / "a.bin") in str(caught.value)
    assert os.listdir(tmp_path) == []


def test_a_disk_that_fills_up(tmp_path: Path) -> None:
    """A real failing write, by a limit on the size of files."""
    code = (
        "import resource, signal, sys\n"
        "from lambent.errors import OutputError\n"
        "from lambent.frame.atomic import atomic\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))\n"
        "try:\n"
        "    with atomic(sys.argv[1], overwrite=True) as out:\n"
        "        for _ in range(100): out.write(bytes(1 << 16))\n"
        "except OutputError as error: print(error)\n"
    )
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True
    )
    assert "no files of that size" in done.stdout
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.bin"]
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 100_000


def test_target_is_checked_early(tmp_path: Path) -> None:
    (tmp_path / "there.bin").write_bytes(b"x")
    with pytest.raises(OutputError, match="does not exist"):
        check_target(tmp_path / "no" / "a.bin")
    with pytest.raises(OutputError, match="is a directory"):
        check_target(tmp_path)
    with pytest.raises(OutputError, match="exists already"):
        check_target(tmp_path / "there.bin")
    with pytest.raises(OutputError, match="not a folder"):
        check_target(tmp_path / "there.bin" / "a.bin")
    assert check_target(tmp_path / "there.bin", overwrite=True).name == "there.bin"


def test_read_only_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Root may write anywhere, so the answer of the system is put in its mouth."""
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(OutputError, match="not writable"):
        check_target(tmp_path / "a.bin")
    monkeypatch.undo()

    def refuse(*_: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(module, "_create", refuse)
    with pytest.raises(OutputError, match="read-only"), atomic(tmp_path / "a.bin"):
        pass


def test_somebody_else_is_faster(way: str, tmp_path: Path) -> None:
    """Without overwrite a file that appears meanwhile is not replaced."""
    path = tmp_path / "a.bin"

    def write() -> None:
        with atomic(path) as out:
            out.write(b"ours")
            path.write_bytes(b"theirs")

    with pytest.raises(OutputError, match="exists already"):
        write()
    assert path.read_bytes() == b"theirs"
    assert os.listdir(tmp_path) == ["a.bin"]


def test_links_are_followed(tmp_path: Path) -> None:
    (tmp_path / "real.bin").write_bytes(b"old")
    (tmp_path / "link.bin").symlink_to("real.bin")
    with atomic(tmp_path / "link.bin", overwrite=True) as out:
        out.write(b"new")
    assert (tmp_path / "link.bin").is_symlink()
    assert (tmp_path / "real.bin").read_bytes() == b"new"


KILLED = """
import sys, time
import numpy as np
sys.path.insert(0, sys.argv[2])
from lambent.frame.frame import Frame
from lambent.frame.files import write
frame = Frame.from_arrays(colour=np.full((600, 600, 3), float(sys.argv[3]), np.float32))
print("go", flush=True)
while True:
    write(sys.argv[1], frame, overwrite=True)
"""


def test_killed_while_writing(tmp_path: Path) -> None:
    """SIGKILL at any moment: the target is whole, and nothing lies about it."""
    from lambent.frame.files import read, write
    from lambent.frame.frame import Frame

    path = tmp_path / "out" / "shot.exr"
    path.parent.mkdir()
    import numpy as np

    write(path, Frame.from_arrays(colour=np.zeros((600, 600, 3), np.float32)))
    for n in range(1, 5):
        process = subprocess.Popen(
            [sys.executable, "-c", KILLED, str(path), str(Path(__file__).parent), str(n)],
            stdout=subprocess.PIPE,
        )
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(0.03 + 0.11 * n)
        process.send_signal(signal.SIGKILL)
        process.wait()
        colour = read(path).colour
        assert colour.shape == (600, 600, 3)
        assert colour.min() == colour.max()
        assert colour.max() in range(n + 1)
        if hasattr(os, "O_TMPFILE"):
            assert len(os.listdir(path.parent)) <= 1 + n  # a name given just before the end
