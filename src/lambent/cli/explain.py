"""Show the weights with which a filter averages around one pixel.

Prints the sum of the weights, the variance that is left (the sum of their squares), how many
pixels the average is worth, and the bias it risks; with -o also a picture of the weights. Those
of a learned model are shown beside those of classical filters.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lambent.cli.options import (
    JsonOption,
    MapOption,
    ModelOption,
    OverwriteOption,
    SetOption,
    SppOption,
    check_output,
    pairs,
    print_json,
)
from lambent.cli.progress import Progress
from lambent.cli.terminal import say

if TYPE_CHECKING:
    from lambent.filters.explain import Explanation

EPILOG = "Example: lambent explain noisy.exr --pixel 120,80 --model cross-bilateral -o weights.png"


def explain(
    frame: Annotated[Path, typer.Argument(metavar="FRAME", help="A noisy frame.")],
    pixel: Annotated[
        str,
        typer.Option(
            "--pixel",
            metavar="X,Y",
            help="The pixel as column,row, from 0,0 at the upper left of the data window.",
        ),
    ],
    model: ModelOption = "cross-bilateral",
    setting: SetOption = None,
    beside: Annotated[
        str | None,
        typer.Option(
            "--beside",
            metavar="MODELS",
            help="Other models to show beside it, with commas; 'none' for none. A learned model "
            "stands beside classical filters unless told otherwise.",
        ),
    ] = None,
    mapping: MapOption = None,
    spp: SppOption = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="PICTURE.png", help="Write the weights as a PNG."),
    ] = None,
    reference: Annotated[
        Path | None,
        typer.Option(metavar="REF", help="The noise-free image, to measure the bias with."),
    ] = None,
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Typer's view of the command; the module docstring is its help."""
    from lambent.denoise.model_file import as_denoiser
    from lambent.filters.denoiser import create
    from lambent.filters.explain import check_picture, classical_for, side_by_side
    from lambent.filters.explain import explain as find_weights
    from lambent.frame.atomic import atomic
    from lambent.frame.files import read
    from lambent.frame.repair import repair

    x, y = _pixel(pixel)
    model, params = as_denoiser(model, pairs("--set", setting))
    denoiser = create(model, **params)  # a wrong option before a missing file
    others = [
        name.strip() for name in (beside or "").split(",") if name.strip() not in ("", "none")
    ]
    for name in others:
        create(name)
    check_output(output, overwrite, [frame, *([] if reference is None else [reference])])
    if output is not None:
        check_picture(output)
    with Progress("explaining", quiet=as_json) as progress:
        progress.report(0, 1, "reading")
        noisy, mended = repair(read(frame, roles=pairs("--map", mapping) or None, spp=spp))
        repairs = mended.written(()).sentences()
        truth = None if reference is None else read(reference)
        progress.report(0, 1, f"weights of {model}")
        found = find_weights(noisy, denoiser, x, y, reference=truth)
        if beside is None and denoiser.card():
            others = classical_for(noisy)
        there = []
        for number, name in enumerate(others):
            progress.report(1 + number, 1 + len(others), f"weights of {name}")
            there.append(find_weights(noisy, name, x, y, reference=truth))
        if output is not None:
            from lambent.frame.tonemap import png_of

            picture = png_of(side_by_side([found, *there])) if there else found.png()
            with atomic(output, overwrite) as file:
                file.write(picture)
    if as_json:
        more = {"beside": [one.as_dict() for one in there]} if there else {}
        shown = None if output is None else str(output)
        print_json({**found.as_dict(), **more, "repairs": repairs, "picture": shown})
    else:
        _print(found)
        for line in repairs:
            say(f"  repaired {line}")
        if there:
            _print_beside(there)
        if output is not None:
            say("", output)


# ------------------------------------------------------------------- private


def _pixel(text: str) -> tuple[int, int]:
    from lambent.errors import OptionError

    parts = text.replace(" ", "").split(",")
    try:
        x, y = (int(part) for part in parts)
    except ValueError:
        raise OptionError(
            f"'{text}' is not a pixel",
            remedy="write column,row from the upper left: --pixel 120,80",
        ) from None
    return x, y


def _print(found: Explanation) -> None:
    height, width = found.weights.shape
    x, y = found.pixel
    share = 100 * float((abs(found.weights) > 1e-6 * found.greatest).mean())
    say(f"{found.model} at pixel {x},{y}", "")
    rows = [
        ("sum of weights", f"{found.sum:.4f}", "1: neither brightens nor darkens"),
        (
            "weights",
            f"{found.least:.2g} to {found.greatest:.2g}",
            "negative ones extrapolate" if found.least < 0 else "smallest and largest",
        ),
        ("looks at", f"{width}x{height} pixels", f"{share:.0f} % of them with some weight"),
        (
            "variance left",
            f"{found.variance_reduction:.4g}",
            "sum of squared weights; less is better",
        ),
        ("worth", f"{found.effective_pixels:.1f} pixels", "of a plain mean with that variance"),
    ]
    if found.bias is not None:
        bias = ", ".join(f"{value:+.3g}" for value in found.bias)
        rows.append(("bias at risk", bias, f"R, G, B; {_measured_on(found)}"))
    left = max(len(value) for _, value, _ in rows) + 2
    for label, value, note in rows:
        say(f"  {label:<16}{value:<{left}}{note}")


def _print_beside(there: list[Explanation]) -> None:
    """A line for each of the others."""
    left = max(len(one.model) for one in there) + 2
    say("", "beside it:")
    for one in there:
        worth = f"worth {one.effective_pixels:.1f} pixels"
        bias = "" if one.bias is None else ", ".join(f"{value:+.3g}" for value in one.bias)
        say(f"  {one.model:<{left}}{worth:<22}{bias and 'bias at risk '}{bias}".rstrip())


def _measured_on(found: Explanation) -> str:
    if found.bias_from == "reference":
        return "measured on the reference"
    return "measured on the result: at least this"
