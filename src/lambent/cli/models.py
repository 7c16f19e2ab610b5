"""List the denoisers: those for work, those from papers, and the floors of comparisons.

With NAME, describe that one: what it needs, can use and costs, and its parameters for --set; or
with a model file, such as lambent train makes: what it was trained on, and its score.
"""

from __future__ import annotations

import re
from typing import Annotated, Any

import typer

from lambent.cli.options import JsonOption, complete_models, print_json
from lambent.cli.terminal import columns, remark, say, say_labelled
from lambent.escapes import escaped

#: Headings of the table, in its order.
GROUPS = {
    "work": "For work",
    "paper": "From papers, as published",
    "floor": "Floors: what any method should beat",
}

EPILOG = "Other packages can bring more models: see the documentation on plug-ins."


def models(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]",
            help="A model, or a model file: mine.lambent.",
            autocompletion=complete_models,
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Typer's view of the command; the module docstring is its help."""
    from lambent.errors import LambentError
    from lambent.filters.denoiser import DEFAULT_MODEL, DENOISERS

    if name is not None:
        card = _card(name)
        print_json(card) if as_json else _print_card(card)
        return
    cards = []
    for one in DENOISERS:
        try:
            cards.append(_card(one))
        except LambentError as error:  # somebody's plug-in; the others are still worth listing
            remark(*f"warning: {error}".split("\n"))
    if as_json:
        print_json({"default": DEFAULT_MODEL, "models": cards})
    else:
        _print_table(cards, DEFAULT_MODEL)


# ------------------------------------------------------------------- private


def _card(name: str) -> dict[str, Any]:
    """What is known of a model, or of the model in a file."""
    from lambent.denoise.model_file import as_denoiser
    from lambent.filters.denoiser import DENOISERS, create, parameters

    model, params = as_denoiser(name, {})
    about = DENOISERS[model].about
    training = dict(create(model, **params).card())
    cost, when = about.cost, about.when
    if params:  # the denoiser's words are of the weights that it comes with
        when = ""
        if "macs" in training:
            cost = f"{training['macs'] / 1000:.0f} kMAC a pixel"
    return {
        "name": name,
        "title": about.title,
        "needs": list(about.needs),
        "can_use": list(about.uses),
        "cost": cost,
        "paper": about.paper,
        "when": when,
        "group": about.group,
        "linear": about.linear,
        "training": training,
        "parameters": [
            {"name": key, "type": _type_name(kind), "default": _default(default)}
            for key, (kind, default) in parameters(model).items()
            if key not in params
        ],
    }


def _type_name(kind: Any) -> str:
    import types
    import typing

    choices = typing.get_args(kind)
    if typing.get_origin(kind) is typing.Literal:
        return "|".join(map(str, choices))
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return "|".join("auto" if c is type(None) else _type_name(c) for c in choices)
    return getattr(kind, "__name__", str(kind))


def _default(value: Any) -> Any:
    return value if isinstance(value, (bool, int, float, str, type(None))) else str(value)


def _print_table(cards: list[dict[str, Any]], default: str) -> None:
    """Three groups with a line each: for work when to take it, of a paper whose and what it is."""
    width = columns()
    left = max(len(card["name"]) for card in cards) + 4
    for group, heading in GROUPS.items():
        say(heading)
        for card in cards:
            if card["group"] != group:
                continue
            text = card["when"]
            if group == "paper":
                text = f"{_citation(card['paper'])}: {card['title']}"
            mark = "(default) " if card["name"] == default else ""
            say(f"  {card['name']:<{left - 2}}" + _cut(mark + text, width - left))
        say()
    say("What one needs, costs and can be set to: lambent models NAME")


def _citation(paper: str) -> str:
    """``"Li, Wu and Chuang 2012"`` to ``"Li et al. 2012"``; of two papers the first."""
    first = paper.partition(";")[0]
    names = re.split(", | and ", first)
    year = re.search(r"\d{4}$", first)
    return f"{names[0]} et al. {year[0]}" if len(names) > 2 and year else first


def _cut(text: str, width: int) -> str:
    text = escaped(text)
    return text if len(text) <= width else text[: width - 1].rstrip(" ,:") + "…"


def _print_card(card: dict[str, Any]) -> None:
    width = columns()
    say(f"{card['name']}: {card['title']}", "")
    rows = [
        ("paper", card["paper"]),
        ("when", card["when"]),
        ("needs", ", ".join(card["needs"])),
        ("can use", ", ".join(card["can_use"]) or "nothing more"),
        ("cost", card["cost"]),
        (
            "layers",
            "lighting layers get the weights of the beauty, so they still sum"
            if card["linear"]
            else "not linear in the colour",
        ),
    ]
    if card["training"]:
        rows += _training(card["training"])
    for label, text in rows:
        if text:
            say_labelled(f"  {label}", text, 12, width)
    if card["parameters"]:
        say("", "Parameters, with their defaults (--set NAME=VALUE):")
        left = max(len(p["name"]) for p in card["parameters"]) + 4
        for p in card["parameters"]:
            shown = "auto" if p["default"] is None else p["default"]
            say_labelled(f"  {p['name']}", f"{shown}  ({p['type']})", left, width)
    say("", f"Use it: lambent denoise noisy.exr --model {card['name']}")


def _training(card: dict[str, Any]) -> list[tuple[str, str]]:
    """What a learned model's card says, in words."""
    sets = [_data_set(one) for one in card.get("data", ())]
    score = card.get("score", {})
    return [
        ("data", ", ".join(sets)),
        ("trained", _effort(card)),
        ("weights", _weights(card)),
        ("fails", "; ".join(card.get("known_failures", ()))),
        (
            "score",
            card.get("score_says")
            # cards from before there were models of other kinds
            or (
                f"{score['score']:.3f} of OIDN High's error on held-out crops of its own data"
                if score
                else ""
            ),
        ),
    ]


def _weights(card: dict[str, Any]) -> str:
    """Which weights these are: the commit that brought them, and of what they are a mean."""
    averaged = card.get("averaged", "in a way that is not noted")
    return f"averaged {averaged}" + (f"; commit {card['commit']}" if "commit" in card else "")


def _effort(card: dict[str, Any]) -> str:
    """How long, all runs that led to the weights taken together."""
    runs = [*card.get("begun_with", ()), card]
    if any("hours" not in run or "step" not in run for run in runs):
        return "? steps, ? h"
    text = f"{sum(run['step'] for run in runs):,} steps, {sum(run['hours'] for run in runs):.2f} h"
    where = card.get("trained_with", {}).get("cuda") or ""
    return text + (f" in {len(runs)} runs" if len(runs) > 1 else "") + (where and f", {where}")


def _data_set(one: dict[str, Any]) -> str:
    """One of the things that a model was trained on."""
    if "pictures" in one:
        return f"{one['pictures']} pictures of {one['name']}"
    licences = "; ".join(one["licences"])
    return f"{one['crops']} crops and {one['clips']} clips of {one['scenes']} scenes ({licences})"
