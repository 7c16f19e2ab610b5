"""Options mean the same in every command."""

from pathlib import Path

import pytest

from lambent.cli import command, main
from lambent.cli.app import COMMANDS
from lambent.cli.options import page_for, seconds_of
from lambent.errors import OptionError


def commands():
    """Every command by its words, with its parameters by their long names."""
    root = command()
    for name in COMMANDS:
        found = root.get_command(None, name)
        inner = getattr(found, "commands", None)
        if inner is None:
            inner = {"": found}
        for part, one in inner.items():
            yield f"{name} {part}".strip(), {p.opts[0]: p for p in one.params if p.opts}


ALL = dict(commands())


@pytest.mark.parametrize(
    ("text", "seconds"), [("60", 60), ("45s", 45), ("90m", 5400), ("2h", 7200), ("0.5 min", 30)]
)
def test_time(text, seconds):
    assert seconds_of("--time", text) == seconds


@pytest.mark.parametrize("text", ["", "soon", "0", "-3s", "1d", "inf", "nan"])
def test_what_is_no_time(text):
    with pytest.raises(OptionError, match="45s, 90m or 2h"):
        seconds_of("--time", text)


@pytest.mark.parametrize("name", ["dataset make", "train", "render", "solve"])
def test_time_is_one_option(name):
    assert ALL[name]["--time"].metavar == "TIME"
    assert not {"--minutes", "--seconds"} & set(ALL[name])


@pytest.mark.parametrize("name", ["denoise", "inspect", "compare", "train", "render", "solve"])
def test_a_report_takes_a_page_or_none(name):
    assert ALL[name]["--report"].metavar == "[PAGE.html]"


def test_no_output_is_required():
    for options in ALL.values():
        if "--output" in options:
            assert not options["--output"].required


def test_from_is_where_a_training_begins():
    assert [name for name, options in ALL.items() if "--from" in options] == ["train"]


def test_one_help_for_one_option():
    """What several commands share is explained in the same words."""
    for option in ("--overwrite", "--device", "--json", "--threads", "--define", "--allow-plugins"):
        assert len({o[option].help for o in ALL.values() if option in o}) == 1


def test_page_names():
    assert page_for(None, Path("a.html")) is None
    assert page_for("", Path("a.html")) == Path("a.html")
    assert page_for("b.HTM", Path("a.html")) == Path("b.HTM")
    with pytest.raises(OptionError, match=r"end it in \.html"):
        page_for("b.exr", Path("a.html"))


@pytest.mark.parametrize(
    ("words", "page"),
    [
        (["--report"], "small_comparison.html"),
        (["--report", "page.html"], "page.html"),
        (["--report=page.html"], "page.html"),
    ],
)
@pytest.mark.parametrize("first", [True, False])
def test_a_report_before_and_after_the_files(tmp_path, monkeypatch, words, page, first, capsys):
    monkeypatch.chdir(tmp_path)
    from PIL import Image

    for name in ("reference.png", "small.png"):
        Image.new("RGB", (16, 16), (90, 80, 70)).save(name)
    files = ["reference.png", "small.png"]
    assert main(["compare", *(words + files if first else files + words)]) == 0
    assert sorted(p.name for p in tmp_path.glob("*.html")) == [page]
    code = main(["compare", *files, *words])
    assert code == 2
    assert "--overwrite" in capsys.readouterr().err


def test_a_report_never_takes_an_input_for_its_page(tmp_path, capsys):
    frame = tmp_path / "a.exr"
    frame.write_bytes(b"precious")
    assert main(["inspect", "--report", str(frame)]) == 2
    assert main(["inspect", f"--report={frame}", str(frame)]) == 4
    assert "end it in .html" in capsys.readouterr().err
    assert frame.read_bytes() == b"precious"


def test_one_page_is_not_for_several_frames(capsys):
    assert main(["denoise", "a.exr", "b.exr", "--report", "page.html"]) == 4
    assert "a page beside each" in capsys.readouterr().err


def test_a_note_is_told_once_a_sequence_though_its_figures_differ(capsys):
    from lambent.cli.denoise import _print_line
    from lambent.denoise.files import Result

    told = set()
    for share in ("3.4", "12.0"):
        result = Result(
            **{
                **dict.fromkeys(Result.__dataclass_fields__),
                "output": Path("a.exr"),
                "repairs": (),
                "seconds": {"total": 1.0},
                "notes": (f"the denoised beauty holds {share} % less light than the noisy one",),
            }
        )
        _print_line(result, told)
    lines = capsys.readouterr().out.splitlines()
    assert "3.4 % less light" in lines[0]
    assert "light" not in lines[1]
