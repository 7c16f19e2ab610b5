"""The command line as a whole: quick, lazy, and never a traceback."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from lambent.cli import main
from lambent.cli.app import COMMANDS
from lambent.errors import EngineError, FileError


def imported_by(*args: str) -> set[str]:
    """The modules a command line has imported when it ends."""
    code = (
        "import sys\n"
        "from lambent.cli import main\n"
        f"main({list(args)!r})\n"
        "print('\\n'.join(sys.modules), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return {line.partition(".")[0] for line in done.stderr.splitlines()}


HEAVY = {"numpy", "rich", "OpenEXR", "drjit", "mitsuba_oidn", "PIL", "openvino", "torch", "scipy"}


@pytest.mark.parametrize("args", [["--help"], ["--version"], ["denoise", "--help"]])
def test_help_and_version_import_nothing_heavy(args):
    assert not imported_by(*args) & HEAVY


def test_version_does_not_even_import_typer():
    assert "typer" not in imported_by("--version")


def test_every_command_has_a_module_with_help(capsys):
    for name in COMMANDS:
        assert main([name, "--help"]) == 0
        text = capsys.readouterr().out
        assert text.startswith(f"Usage: lambent {name}")
        assert "Typer's view" not in text


def test_help_lists_every_command(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(f"  {name} " in text for name in COMMANDS)
    assert all(len(line) <= 100 for line in text.splitlines())


def test_no_arguments_show_the_help(capsys):
    main([])
    captured = capsys.readouterr()
    assert "Commands:" in captured.out + captured.err


def test_an_unknown_command_is_answered_with_the_nearest(capsys):
    assert main(["denose"]) == 4
    assert "did you mean 'lambent denoise'?" in capsys.readouterr().err


def test_a_file_in_place_of_a_command_is_recognised(capsys, tmp_path):
    path = tmp_path / "noisy.exr"
    path.write_bytes(b"x")
    assert main([str(path)]) == 4
    assert f"lambent denoise {path}" in capsys.readouterr().err


def test_an_unknown_option_is_our_error(capsys):
    assert main(["denoise", "x.exr", "--modle", "oidn"]) == 4
    text = capsys.readouterr().err
    assert text.startswith("error: ")
    assert "--modle" in text


def test_errors_keep_their_exit_codes_and_are_json_on_demand(capsys, monkeypatch):
    def fail(*args: object, **kwargs: object) -> None:
        raise FileError("is broken", file="a.exr", remedy="render it again")

    monkeypatch.setattr("lambent.cli.models._card", fail)
    assert main(["models", "oidn", "--json"]) == FileError.exit_code == 2
    captured = capsys.readouterr()
    assert json.loads(captured.out)["error"]["remedy"] == "render it again"
    assert captured.err == "error: a.exr: is broken\n  → render it again\n"


def test_an_unforeseen_error_is_no_traceback_unless_debugging(capsys, monkeypatch):
    def fail(*args: object, **kwargs: object) -> None:
        raise ZeroDivisionError("oops")

    monkeypatch.delenv("LAMBENT_DEBUG", raising=False)
    monkeypatch.setattr("lambent.cli.models._card", fail)
    assert main(["models", "oidn"]) == 1
    assert "ZeroDivisionError: oops" in capsys.readouterr().err
    monkeypatch.setenv("LAMBENT_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        main(["models", "oidn"])


def test_ctrl_c_is_130(capsys, monkeypatch):
    def interrupt(*args: object, **kwargs: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("lambent.cli.models._card", interrupt)
    assert main(["models", "oidn"]) == 130
    assert "every file that was written is whole" in capsys.readouterr().err


def test_exit_codes_are_those_of_the_help():
    assert EngineError.exit_code == 5


def test_completion_offers_models_and_roles():
    from lambent.cli.options import complete_models, complete_roles

    assert ("oidn", "") in complete_models("oi")
    assert complete_roles("alb") == ["albedo="]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("lambent de", ["denoise"]),
        ("lambent denoise --model oidn-b", ["oidn-balanced", "oidn-best"]),
        ("lambent denoise --map rough", ["roughness="]),
        ("lambent models nf", ["nfor", "nfor-tuned"]),
    ],
)
def test_bash_completes_commands_models_and_roles(words, expected):
    """As the script of ``--install-completion`` asks."""
    done = subprocess.run(
        [sys.executable, "-c", "from lambent.cli import main; main()"],
        capture_output=True,
        text=True,
        check=True,
        env={
            **os.environ,
            "COMP_WORDS": words,
            "COMP_CWORD": str(words.count(" ")),
            "_LAMBENT_COMPLETE": "complete_bash",
        },
    )
    assert done.stdout.split() == expected


def test_without_a_word_the_help_is_shown(capsys):
    assert main([]) == 0
    assert "denoise" in capsys.readouterr().out
