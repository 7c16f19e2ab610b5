"""What README and docs name exists: commands and their options, modules, models, files."""

from __future__ import annotations

import importlib
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lambent.cli import command as root_command
from lambent.errors import LambentError
from lambent.filters.denoiser import DEFAULT_MODEL, DENOISERS, parameters

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]
PAGES = [p for p in PAGES if "_build" not in p.parts and not {"commands.md"} & {p.name}]
#: Names in examples of how to write a plug-in, which are nobody's.
EXAMPLES = {"median", "mine", "NAME", "MODEL"}


def texts() -> list[Any]:
    return [pytest.param(page, id=str(page.relative_to(ROOT))) for page in PAGES]


def options_of(command: Any, context: Any) -> set[str]:
    """All options of a command and of those below it."""
    found = {o for p in command.params for o in (*p.opts, *p.secondary_opts) if o.startswith("-")}
    for name in command.list_commands(context) if hasattr(command, "list_commands") else ():
        found |= options_of(command.get_command(context, name), context)
    return found


def commands() -> dict[str, set[str]]:
    root = root_command()
    context = root.context_class(root, info_name="lambent")
    everything = {"--help", "-h", "--version", "--debug", *options_of_root(root)}
    found = {}
    for name in root.list_commands(context):
        found[name] = options_of(root.get_command(context, name), context) | everything
    return found


def options_of_root(root: Any) -> set[str]:
    return {o for p in root.params for o in p.opts if o.startswith("-")}


def command_lines(text: str) -> Iterator[list[str]]:
    """The words of every `lambent ...` line in blocks of code, continued lines joined."""
    for block in re.findall(r"```(?:console|bash|sh|text)\n(.*?)```", text, re.S):
        for line in block.replace("\\\n", " ").splitlines():
            found = re.search(r"(?:^\$ |^|/)lambent (.+)$", line.strip())
            if found is None or not line.strip().startswith(("$", "lambent", ".venv")):
                continue
            lexer = shlex.shlex(found[1], posix=True, punctuation_chars="|>&;")
            lexer.whitespace_split = True
            yield list(lexer)


@pytest.mark.parametrize("page", texts())
def test_commands_and_options_exist(page: Path) -> None:
    known = commands()
    for words in command_lines(page.read_text()):
        if words[0].startswith("-") or not words[0].isidentifier():
            continue
        assert words[0] in known, words
        for word in words[1:]:
            if word in ("|", ">", "&&", ";", "#"):
                break
            if re.match(r"--?[a-z]", word):
                assert word.partition("=")[0] in known[words[0]], f"lambent {' '.join(words)}"


@pytest.mark.parametrize("page", texts())
def test_options_in_the_text_exist(page: Path) -> None:
    known = set().union(*commands().values())
    benchmarks = " ".join(p.read_text() for p in (ROOT / "benchmarks").glob("*.py"))
    for code in re.findall(r"`([^`\n]+)`", page.read_text()):
        if code.startswith(("pip", "make", "python", "benchmarks", "blender", "torchrun")):
            continue
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]+", code):
            assert option in known or f'"{option}"' in benchmarks, code


@pytest.mark.parametrize("page", texts())
def test_models_exist(page: Path) -> None:
    for name in re.findall(r"--model[ =]([\w-]+)", page.read_text()):
        assert name in DENOISERS or name in EXAMPLES, name
    for model, setting in re.findall(r"--model ([\w-]+) --set (\w+)=", page.read_text()):
        if model in DENOISERS:
            assert setting in parameters(model), (model, setting)


@pytest.mark.parametrize("page", texts())
def test_modules_exist(page: Path) -> None:
    for name in set(re.findall(r"`(lambent(?:\.\w+)+)(?:\(\))?`", page.read_text())):
        if name.rpartition(".")[2] in ("denoisers", "dialects", "toml", "exr", "html"):
            continue  # groups of entry points, files
        assert exists(name), name


def exists(name: str) -> bool:
    """Whether a dotted name is a module, or something in one."""
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            thing: Any = importlib.import_module(".".join(parts[:cut]))
        except (ImportError, LambentError):
            continue
        for part in parts[cut:]:
            if not hasattr(thing, part):
                return False
            thing = getattr(thing, part)
        return True
    return False


@pytest.mark.parametrize("page", texts())
def test_files_of_the_repository_exist(page: Path) -> None:
    for name in re.findall(r"`((?:benchmarks|recipes|examples|tests)/[\w./-]+)", page.read_text()):
        assert (ROOT / name.rstrip("./")).exists(), name
    package = ROOT / "src" / "lambent"
    for name in re.findall(r"`([a-z]+/[\w/]+\.py)`", page.read_text()):
        assert (ROOT / name).exists() or any(package.rglob(name)), name


def test_there_is_something_to_check() -> None:
    pages = [page.read_text() for page in PAGES]
    assert sum(len(list(command_lines(text))) for text in pages) > 60
    assert sum(len(re.findall(r"--model[ =]([\w-]+)", text)) for text in pages) > 20


def test_the_default_is_what_the_docs_say() -> None:
    import inspect

    from lambent.cli.denoise import denoise

    assert inspect.signature(denoise).parameters["model"].default == DEFAULT_MODEL
    page = (ROOT / "docs" / "guides" / "own_frames.md").read_text()
    from lambent.frame.noise import SMOOTH, SPLATTED

    assert DEFAULT_MODEL == "auto"
    assert f"correlates by {SPLATTED} to {SMOOTH}" in page
