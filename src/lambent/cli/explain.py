"""Show the weights with which a filter averages around one pixel.

Prints the sum of the weights, the variance that is left (the sum of their squares), how many
pixels the average is worth, and the bias it risks; with -o also a picture of the weights.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lambent.cli.options import (
    JsonOption,
    MapOption,
    ModelOption,
    SetOption,
    pairs,
    print_json,
)
from lambent.cli.progress import Progress

EPILOG = "Example: lambent explain noisy.exr --pixel 120,80 --model cross-bilateral -o weights.png"


def explain(
    frame: Annotated[Path, typer.Argument(metavar="FRAME", help="A noisy frame.")],
    pixel: Annotated[
        str,
        typer.Option("--pixel", metavar="X,Y", help="The pixel: column,row from the upper left."),
    ],
    model: ModelOption = "cross-bilateral",
    setting: SetOption = None,
    mapping: MapOption = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="PICTURE.png", help="Write the weights as a PNG."),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a picture that exists.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Typer's view of the command; the module docstring is its help."""
    from lambent.errors import OutputError
    from lambent.filters.explain import explain as find_weights
    from lambent.frame.files import read
    from lambent.frame.repair import repair

    x, y = _pixel(pixel)
    if output is not None and output.exists() and not overwrite:
        raise OutputError(
            "this file exists already", file=output, remedy="allow replacing it with --overwrite"
        )
    with Progress("explaining", quiet=as_json) as progress:
        progress.report(0, 1, "reading")
        noisy, _ = repair(read(frame, roles=pairs("--map", mapping) or None))
        progress.report(0, 1, f"weights of {model}")
        found = find_weights(noisy, model, x, y, **pairs("--set", setting))
        if output is not None:
            from lambent.frame.atomic import atomic

            with atomic(output, overwrite) as file:
                file.write(found.to_png())
    if as_json:
        print_json({**_facts(found, model, x, y), "picture": None if output is None else output})
    else:
        _print(found, model, x, y)
        if output is not None:
            print(f"\n{output}")


# ------------------------------------------------------------------- private


def _pixel(text: str) -> tuple[int, int]:
    from lambent.errors import OptionError

    parts = text.replace(" ", "").split(",")
    try:
        x, y = (int(part) for part in parts)
    except ValueError:
        raise OptionError(
            f"'{text}' is no pixel", remedy="write column,row from the upper left: --pixel 120,80"
        ) from None
    return x, y
