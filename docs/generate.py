"""The pages that are derived from the code: one a command, one a denoiser.

A command's page is made from the command line's own definition, a denoiser's from its entry in the
registry and its docstring; so neither can say anything that the program does not do.
"""

from __future__ import annotations

import inspect
import os
import sys
import textwrap
import typing
from pathlib import Path
from typing import Any


def everything(folder: Path) -> None:
    """Write all generated pages below ``folder``."""
    _write(folder / "commands.md", commands())
    for name, page in filters():
        _write(folder / "filters" / f"{name}.md", page)
    _write(folder / "filters.md", filter_table())
    _write(folder / "dialects.md", dialects())
    _write(folder / "metrics.md", metrics())


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text() != text:
        path.write_text(text)


# ------------------------------------------------------------------ commands


def commands() -> str:
    """One section a command: what it does, its arguments and options."""
    from lambent.cli import command as root_command

    os.environ.setdefault("NO_COLOR", "1")
    root = root_command()
    context = root.context_class(root, info_name="lambent")
    out = ["# Commands", "", _prose(root.help), ""]
    for name in root.list_commands(context):
        out += _command(root, context, name, "##")
    return "\n".join(out)


def _command(group: Any, context: Any, name: str, mark: str) -> list[str]:
    """The section of a command, and below it those of its own commands."""
    command = group.get_command(context, name)
    assert command is not None
    sub = command.context_class(command, info_name=name, parent=context)
    usage = command.get_usage(sub).replace("Usage: ", "")
    out = [f"{mark} {sub.command_path}", "", _prose(command.help), ""]
    out += ["```text", " ".join(usage.split()), "```", ""]
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option" and not p.hidden]
    rows = [(f"`{_metavar(p)}`", getattr(p, "help", "") or "") for p in arguments]
    rows += [(_option(p), _help(p)) for p in options if p.name != "help"]
    if rows:
        out += ["| argument or option | what it does |", "| --- | --- |"]
        out += [f"| {a} | {_cell(b)} |" for a, b in rows]
    out += [""]
    for below in command.list_commands(sub) if hasattr(command, "list_commands") else ():
        out += _command(command, sub, below, mark + "#")
    return out


def _metavar(parameter: Any) -> str:
    return str(parameter.metavar or parameter.name.upper()).replace("|", "\\|")


def _option(option: Any) -> str:
    names = ", ".join(f"`{o}`" for o in [*option.opts, *option.secondary_opts])
    if option.is_flag:
        return names
    return f"{names} `{_metavar(option)}`"


def _help(option: Any) -> str:
    text = (option.help or "").strip()
    default = option.default
    if option.is_flag or default is None or callable(default) or default in ("", (), []):
        return text
    if not isinstance(default, (str, int, float)):
        return text
    return text if "default" in text.lower() else f"{text} Default: `{default}`."


def _prose(text: str | None) -> str:
    return inspect.cleandoc(text or "").replace("\b", "").replace("\f", "").strip()


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())


# ------------------------------------------------------------------- filters

#: Method pages written by hand, for the models that have one.
METHODS = {
    "lambent": "lambent", "lambent-fast": "lambent", "lambent-best": "lambent",
    "kpcn": "kpcn", "dpcn": "kpcn", "modular": "modular", "dncnn": "dncnn",
}  # fmt: skip

#: Order of the pages: from the generic filter to what is best.
ORDER = (
    "box", "gaussian", "bilateral", "cross-bilateral", "nlm", "joint-nlm", "atrous", "atrous-tuned",
    "sbf", "sbf-tuned", "aaf", "nfor", "nfor-tuned", "statmc", "statmc-tuned",
    "dncnn", "dpcn", "kpcn", "modular", "lambent", "lambent-fast", "lambent-best",
    "oidn", "oidn-balanced", "oidn-fast", "oidn-best", "lambent-oidn", "auto",
)  # fmt: skip


def _names() -> list[str]:
    from lambent.filters.denoiser import DENOISERS

    names = list(DENOISERS)
    return [n for n in ORDER if n in names] + sorted(n for n in names if n not in ORDER)


def filter_table() -> str:
    """The table of all denoisers, and the list of their pages."""
    from lambent.filters.denoiser import DENOISERS

    intro = (Path(__file__).parent / "methods" / "filters_intro.md").read_text()
    out = ["# All denoisers, a page each", "", intro, ""]
    out += ["| model | what it is | when to use it |", "| --- | --- | --- |"]
    for name in _names():
        about = DENOISERS[name].about
        out.append(f"| [`{name}`](filters/{name}.md) | {about.title} | {about.when} |")
    out += ["", "```{toctree}", ":hidden:", ""]
    out += [f"filters/{name}" for name in _names()]
    out += ["```", ""]
    return "\n".join(out)


def filters() -> list[tuple[str, str]]:
    """Name and page of every denoiser."""
    from lambent.filters.denoiser import DENOISERS, parameters

    pages = []
    pictures = Path(__file__).parent / "pictures"
    for name in _names():
        kind = DENOISERS[name]
        about = kind.about
        out = [f"# {name}: {about.title}", ""]
        if about.paper:
            out += [f"*{about.paper}*", ""]
        out += [f"**When to use it:** {about.when}", ""]
        if name in METHODS:
            out += [f"**How it works**, with equations: [](../../methods/{METHODS[name]}.md).", ""]
        picture = pictures / f"filter_{name}.jpg"
        if picture.exists():
            out += [f"```{{image}} ../../pictures/{picture.name}",
                    f":alt: noisy, {name}, reference", "```", ""]  # fmt: skip
        out += ["| | |", "| --- | --- |"]
        out += [f"| needs | {', '.join(about.needs).replace('|', ' or ')} |"]
        out += [f"| can use | {', '.join(about.uses) or 'nothing else'} |"]
        out += [f"| cost | {about.cost} |"]
        linear = (
            "yes: lighting layers get the same weights and still sum; `lambent explain` shows them"
        )
        out += [f"| weighted average | {linear if about.linear else 'no'} |", ""]
        known = parameters(name)
        if known:
            out += ["## Parameters", "", "`--set name=value`, or keyword arguments.", ""]
            out += ["| parameter | type | default |", "| --- | --- | --- |"]
            out += [f"| `{p}` | {_type(t)} | `{d}` |" for p, (t, d) in known.items()]
            out += [""]
        if kind.__doc__:
            out += [_markdown(inspect.cleandoc(kind.__doc__)), ""]
        out += ["## How it works", "", "```{code-block} text", ":class: prose", ""]
        module = inspect.getmodule(kind)
        out += [textwrap.dedent(inspect.getdoc(module) or "").strip(), "```", ""]
        out += [f"The class is `{kind.__module__}.{kind.__qualname__}`.", ""]
        pages.append((name, "\n".join(out)))
    return pages


def _markdown(docstring: str) -> str:
    """A docstring's prose: double backticks become single ones."""
    return docstring.replace("``", "`")


def _type(kind: Any) -> str:
    if typing.get_origin(kind) is typing.Literal:
        return " or ".join(f"`{choice}`" for choice in typing.get_args(kind))
    text = kind.__name__ if isinstance(kind, type) else str(kind).replace("typing.", "")
    return f"`{text}`".replace("|", "or")


# ------------------------------------------------------------------ dialects


def dialects() -> str:
    """One table a renderer: layer names and the roles they mean."""
    from lambent.frame.dialects import DIALECTS

    out: list[str] = []
    for name in DIALECTS:
        dialect = DIALECTS[name]
        out += [f"## {dialect.title}", ""]
        if dialect.verified:
            out += [f"Names looked up in: {dialect.verified}.", ""]
        out += ["| layer (pattern) | role | what it is |", "| --- | --- | --- |"]
        for rule in dialect.rules:
            role = rule.role.value + ("" if rule.stat.value == "mean" else f".{rule.stat.value}")
            pattern = rule.pattern.replace("|", "\\|")
            out.append(f"| `{pattern}` | {role} | {_cell(rule.what)} |")
        out.append("")
    return "\n".join(out)


# ------------------------------------------------------------------- metrics


def metrics() -> str:
    """The definition of every metric, as its module states it."""
    from lambent.metrics.metric import METRICS

    out: list[str] = []
    seen: dict[str, list[str]] = {}
    for name in METRICS:
        seen.setdefault(METRICS.where(name).partition(":")[0], []).append(name)
    for module, names in seen.items():
        __import__(module)
        title = ", ".join(f"`{n}`" for n in names)
        doc = textwrap.dedent(inspect.getdoc(sys.modules[module]) or "").strip()
        out += [f"## {title}", "", "```{code-block} text", ":class: prose", "", doc, "```", ""]
    return "\n".join(out)
