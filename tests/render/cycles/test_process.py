"""Finding Blender and talking to it, with programs that only play Blender."""

from __future__ import annotations

import contextlib
import gzip
import os
import sys
import textwrap
import time
from pathlib import Path

import pytest

from lambent.errors import DamagedFileError, EngineError, FileError, OptionError
from lambent.render.cycles import cycles_available, render_blend
from lambent.render.cycles import find as finding
from lambent.render.cycles.blend import check_blend, numbered
from lambent.render.cycles.find import Blender, find_blender
from lambent.render.cycles.process import BlenderProcess, Refusal

READY = '{"lambent": "ready", "version": [5, 0, 1], "text": "5.0.1"}'


def player(folder: Path, body: str, name: str = "player") -> Blender:
    """A program that greets like Blender and then does what ``body`` says, line ``order``."""
    path = folder / name
    start = f"#!{sys.executable}\nimport json, os, signal, sys, time\nprint('Blender 5.0.1')\n"
    path.write_text(start + f"print('''{READY}''', flush=True)\n" + textwrap.dedent(body))
    path.chmod(0o755)
    return Blender(str(path), True)


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


# ------------------------------------------------------------------------------------- finding


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A machine without any Blender; the only folder on its path."""
    monkeypatch.delenv(finding.VARIABLE, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(finding.importlib.util, "find_spec", lambda name: None)
    return tmp_path


def test_none_is_there(bare: Path) -> None:
    assert not cycles_available()
    with pytest.raises(EngineError, match=r"lambent\[blender\].*Python 3.11.*LAMBENT_BLENDER"):
        find_blender()


def test_order_of_asking(bare: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The variable, this Python, the path."""
    on_path = bare / "blender"
    on_path.write_text("#!/bin/sh\n")
    on_path.chmod(0o755)
    assert find_blender() == Blender(str(on_path), False)
    monkeypatch.setattr(finding.importlib.util, "find_spec", lambda name: object())
    assert find_blender() == Blender(sys.executable, True)
    own = bare / "blender-4.5"
    own.write_text("#!/bin/sh\n")
    own.chmod(0o755)
    monkeypatch.setenv(finding.VARIABLE, str(own))
    assert find_blender() == Blender(str(own), False)


def test_variable_that_names_nothing_useful(bare: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(finding.VARIABLE, str(bare / "nothing"))
    with pytest.raises(EngineError, match="not a program"):
        find_blender()
    without = bare / "python"
    without.write_text("#!/bin/sh\nexit 1\n")
    without.chmod(0o755)
    monkeypatch.setenv(finding.VARIABLE, str(without))
    with pytest.raises(EngineError, match="cannot `import bpy`"):
        find_blender()
    without.write_text("#!/bin/sh\nexit 0\n")
    finding._has_bpy.cache_clear()
    assert find_blender() == Blender(str(without), True)


def test_command_lines() -> None:
    script = Path("/x/server.py")
    assert Blender("py", True).command(script, "/s") == ["py", "-I", "-u", "/x/server.py", "/s"]
    line = Blender("blender", False).command(script, "/s")
    assert line[:2] == ["blender", "-b"]
    assert "--disable-autoexec" in line
    assert line[-4:] == ["--python", "/x/server.py", "--", "/s"]


def test_no_module_comes_from_the_current_folder(tmp_path, monkeypatch) -> None:
    """A real Python: neither asking it for bpy nor starting it runs what lies around."""
    mark, folder = tmp_path / "mark", tmp_path / "folder"
    folder.mkdir()
    for name in ("contextlib", "json", "importlib", "sitecustomize", "usercustomize", "bpy"):
        (folder / f"{name}.py").write_text(f"open({str(mark)!r}, 'w').close()\n")
    monkeypatch.chdir(folder)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    monkeypatch.setenv("PYTHONSTARTUP", str(folder / "bpy.py"))
    monkeypatch.setenv(finding.VARIABLE, sys.executable)
    finding._has_bpy.cache_clear()
    with contextlib.suppress(EngineError):  # this Python may have a bpy
        find_blender()
    with BlenderProcess(Blender(sys.executable, True)) as process, contextlib.suppress(EngineError):
        process.start()
    assert not mark.exists()


# ------------------------------------------------------------------------------------- talking


def test_orders_and_answers(tmp_path: Path) -> None:
    """Chatter is skipped, progress is reported, refusals carry their facts, Blender lives on."""
    blender = player(
        tmp_path,
        """
        for line in sys.stdin:
            order = json.loads(line)
            print("Fra:1 Mem:12M", flush=True)
            if order["do"] == "refuse":
                answer = {"lambent": "error", "kind": "camera", "message": "x", "known": ["y"]}
                print(json.dumps(answer), flush=True)
            else:
                half = {"lambent": "progress", "done": 1, "total": 2, "text": "half"}
                print(json.dumps(half), flush=True)
                print(json.dumps({"lambent": "done", "kind": order["do"]}), flush=True)
        """,
    )
    seen = []
    with BlenderProcess(blender) as process:
        facts = process.order({"do": "work"}, lambda *state: seen.append(state))
        assert facts == {"kind": "work"}
        assert seen == [(1, 2, "half")]
        pid, scratch = process.pid, process.scratch
        with pytest.raises(Refusal) as refusal:
            process.order({"do": "refuse"})
        assert (refusal.value.kind, refusal.value.facts) == ("camera", {"known": ["y"]})
        assert process.order({"do": "again"}) == {"kind": "again"}
        assert process.pid == pid
        assert scratch.is_dir()
    assert gone(pid)
    assert not scratch.exists()


def test_death_shows_the_log_and_is_survived(tmp_path: Path) -> None:
    blender = player(
        tmp_path,
        """
        for line in sys.stdin:
            if json.loads(line)["do"] == "die":
                print("out of luck", file=sys.stderr, flush=True)
                os.kill(os.getpid(), signal.SIGKILL)
            print('{"lambent": "done"}', flush=True)
        """,
    )
    with BlenderProcess(blender) as process:
        with pytest.raises(EngineError, match=r"signal 9(.|\n)*out of luck(.|\n)*out of memory"):
            process.order({"do": "die"})
        assert process.pid is None
        assert process.order({"do": "work"}) == {}


def test_crash_inside_is_told_and_blender_started_afresh(tmp_path: Path) -> None:
    blender = player(
        tmp_path,
        """
        for line in sys.stdin:
            print("Traceback: deep", file=sys.stderr, flush=True)
            answer = {"lambent": "error", "kind": "crash", "message": "ValueError: 3"}
            print(json.dumps(answer), flush=True)
        """,
    )
    with BlenderProcess(blender) as process:
        with pytest.raises(EngineError, match=r"ValueError: 3\n(.|\n)*Traceback: deep"):
            process.order({"do": "x"})
        assert process.pid is None


def test_interrupt_ends_blender_and_leaves_nothing(tmp_path: Path) -> None:
    """Ctrl-C comes up from the progress report, as it does from a terminal."""
    blender = player(
        tmp_path,
        """
        sys.stdin.readline()
        print('{"lambent": "progress", "done": 1, "total": 9, "text": ""}', flush=True)
        time.sleep(600)
        """,
    )
    process = BlenderProcess(blender)
    process.start()
    pid, scratch = process.pid, process.scratch
    (scratch / "half.exr").write_bytes(b"half")

    def interrupt(*state: object) -> None:
        raise KeyboardInterrupt

    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        process.order({"do": "x"}, interrupt)
    assert time.monotonic() - start < 10
    assert gone(pid)
    assert not scratch.exists()


def test_what_cannot_start(tmp_path: Path) -> None:
    with pytest.raises(EngineError, match="cannot be started"):
        BlenderProcess(Blender(str(tmp_path / "none"), True)).start()
    broken = tmp_path / "broken"
    answer = '{"lambent": "error", "kind": "engine", "message": "ImportError: libX"}'
    broken.write_text(f"#!/bin/sh\necho '{answer}'\n")
    broken.chmod(0o755)
    with pytest.raises(EngineError, match="cannot be loaded: ImportError: libX"):
        BlenderProcess(Blender(str(broken), True)).start()


# ------------------------------------------------------------------- what needs no Blender to see


def test_files_that_are_no_blend(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="there is no such file"):
        render_blend(tmp_path / "none.blend")
    with pytest.raises(FileError, match="directory"):
        render_blend(tmp_path)
    for content in (b"", b"PK\3\4 something else", gzip.compress(b"no blend")):
        path = tmp_path / "x.blend"
        path.write_bytes(content)
        with pytest.raises(DamagedFileError, match=r"empty|not a \.blend"):
            render_blend(path)
    path.write_bytes(b"\x1f\x8b broken")
    with pytest.raises(DamagedFileError, match="cannot be read"):
        check_blend(path)


def test_versions_of_files(tmp_path: Path) -> None:
    path = tmp_path / "x.blend"
    for content, version in (
        (b"BLENDER-v405REND", (4, 5)),
        (b"BLENDER17-01v0500", (5, 0)),
        (gzip.compress(b"BLENDER_v279RENDx"), (2, 79)),
        (b"\x28\xb5\x2f\xfd\x00", None),
    ):
        path.write_bytes(content)
        assert check_blend(path) == version


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"spp": 0}, "at least 1"),
        ({"spp": 1, "halves": True}, "at least 2"),
        ({"size": (0, 4)}, "cannot be rendered"),
        ({"depth": -1}, "bounces"),
        ({"time": 0.0}, "time"),
        ({"device": "tpu"}, "auto, cpu or cuda"),
        ({"passes": "most"}, "all or light"),
    ],
)
def test_options(options: dict, match: str, tmp_path: Path) -> None:
    path = tmp_path / "x.blend"
    path.write_bytes(b"BLENDER-v405REND")
    with pytest.raises(OptionError, match=match):
        render_blend(path, **options)


def test_numbered() -> None:
    assert numbered("a/shot.####.exr", 7, 3) == Path("a/shot.0007.exr")
    assert numbered("one.exr", None, 1) == Path("one.exr")
    with pytest.raises(OptionError, match="####"):
        numbered("one.exr", 1, 3)
