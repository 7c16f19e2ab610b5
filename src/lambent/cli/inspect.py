"""Show what is in a file: parts, channels, which layer is what and why, and what looks wrong.

All values are decoded and counted: NaN, infinite, negative. Hints point out what denoisers suffer
from, such as a splatted pixel filter, tone-mapped colour, or clamped half values.
"""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lambent.cli.options import (
    JsonOption,
    MapOption,
    OverwriteOption,
    SppOption,
    check_output,
    page_for,
    pairs,
    print_json,
    report_option,
)
from lambent.cli.progress import Progress
from lambent.cli.terminal import columns, say
from lambent.escapes import escaped

if TYPE_CHECKING:
    from lambent.frame.inspection import Inspection, LayerReport

EPILOG = "Example: lambent inspect noisy.exr --map albedo=tex"


def inspect(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="An EXR, PNG, JPEG, TIFF, HDR or PFM.")
    ],
    mapping: MapOption = None,
    spp: SppOption = None,
    report: Annotated[str | None, report_option("Write a page of all layers", "the file")] = None,
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Typer's view of the command; the module docstring is its help."""
    from lambent.denoise.sequence import is_sequence
    from lambent.errors import OptionError
    from lambent.frame.inspection import inspect_file

    if not file.is_dir() and is_sequence(file):
        raise OptionError(
            f"{file} is a pattern, and inspect takes one file",
            remedy="name one frame of the sequence",
        )
    roles = pairs("--map", mapping) or None
    page = page_for(report, file.with_name(f"{file.stem}_inspection.html"))
    check_output(page, overwrite, [file])
    with Progress(file.name, quiet=as_json) as progress:
        progress.report(0, 1, "inspecting")
        found = inspect_file(file, roles, spp)
        if page is not None:
            progress.report(0, 1, "writing the page")
            _write_page(page, found, roles, spp)
    if as_json:
        print_json({**found.as_dict(), "report": None if page is None else str(page)})
        return
    _print(found)
    if page is not None:
        say("", page)


# ------------------------------------------------------------------- private


def _write_page(
    page: Path, found: Inspection, roles: dict[str, str] | None, spp: int | None
) -> None:
    from lambent.frame.files import read
    from lambent.frame.role import Role
    from lambent.report import write_inspection

    pictures: dict[str, Any] = {}
    for layer in read(found.path, roles=roles, spp=spp).all_layers():
        if layer.role not in (Role.ID, Role.OTHER) and layer.data.shape[2] in (1, 3):
            pictures[layer.name] = layer.data
    write_inspection(page, found.as_dict(), pictures)


def _print(found: Inspection) -> None:
    from lambent.memory import show_size

    width = columns()
    facts = [f"{found.width}x{found.height}", found.format.upper(), show_size(found.size)]
    facts += [f"{found.spp} spp"] if found.spp else []
    facts += [f"views {', '.join(found.views)}"] if found.views else []
    say(f"{found.path}: {', '.join(facts)}")
    dialect = "common names" if found.dialect == "generic" else found.dialect
    _wrapped(f"  {dialect} ({found.dialect_why})", 2, width)
    for part in found.parts:
        x0, y0, x1, y1 = part.data_window
        window = "" if part.data_window == part.display_window else f" at ({x0}, {y0})"
        name = f"'{part.name}'" if part.name else "unnamed"
        kinds = "/".join(dict.fromkeys(c.type for c in part.channels))
        say(
            f"  part {part.index} {name}: {x1 - x0 + 1}x{y1 - y0 + 1}{window}, "
            f"{len(part.channels)} {kinds} channels, {part.type}, {part.compression}"
        )
    _print_layers(found.layers, len(found.parts) > 1, bool(found.views), width)
    for total in found.sums:
        if total.sums:
            _wrapped(f"sum       {' + '.join(total.layers)} = {total.beauty}", 10, width)
    for hint in found.suspicions:
        _wrapped(f"{hint.level:<10}{hint.explanation} {hint.remedy}", 10, width)
    for note in found.notes:
        _wrapped(f"note      {note}", 10, width)


def _print_layers(layers: tuple[LayerReport, ...], parts: bool, views: bool, width: int) -> None:
    """One line a layer: role, name, range; trouble and the reason below it."""
    if not layers:
        say("", "No layers.")
        return
    ids = [layer.name for layer in layers if layer.role.value == "id"]
    layers = tuple(layer for layer in layers if layer.role.value != "id")
    roles = [
        _role(layer) + (f" ({escaped(layer.view)})" if views and layer.view else "")
        for layer in layers
    ]
    names = [escaped(layer.name) for layer in layers]
    first = max([4, *map(len, roles)]) + 2
    second = min(max([8, *map(len, names)]), max(16, width - first - 50)) + 2
    say()
    for role, name, layer in zip(roles, names, layers, strict=True):
        name = name if len(name) <= second - 2 else name[: second - 3] + "…"
        channels = " ".join(c.rpartition(".")[2] for c in layer.channels)
        say(f"{role:<{first}}{name:<{second}}{_range(layer):<22}  {channels}".rstrip())
        trouble = [
            f"{count} {word}"
            for count, word in (
                (layer.nan, "NaN"),
                (layer.infinite, "infinite"),
                (layer.negative if layer.role.value in _POSITIVE else 0, "negative"),
            )
            if count
        ]
        if trouble:
            say(" " * first + f"! {', '.join(trouble)} values")
        if layer.why and not layer.why.startswith("no table has a meaning"):
            _wrapped(" " * first + layer.why, first, width)
    if ids:
        _wrapped(f"{'id':<{first}}{', '.join(ids)} (never filtered)", first, width)
    say()


#: Roles in which a negative value is worth a remark.
_POSITIVE = frozenset(
    {"colour", "alpha", "albedo", "roughness", "emission", "diffuse", "specular", "direct"}
    | {"indirect", "lighting", "diffuse_albedo", "specular_albedo"}
)


def _role(layer: LayerReport) -> str:
    stat = layer.stat.value
    return layer.role.value if stat == "mean" else f"{layer.role.value}.{stat}"


def _range(layer: LayerReport) -> str:
    if layer.low is None or layer.high is None:
        return "no finite value"
    return f"{layer.low:.4g} … {layer.high:.4g}"


def _wrapped(text: str, indent: int, width: int) -> None:
    lead = len(text) - len(text.lstrip())
    say(
        *textwrap.wrap(
            escaped(text.strip()),
            width,
            initial_indent=" " * lead,
            subsequent_indent=" " * indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
    )
