"""Dialects: what the layers of a renderer's files mean.

One file a renderer, each a table of data (`Dialect`); `identify` reads them. Reading order:
`table` (the records), `blender` (the richest table), `images`, `matching`, `choices`.

Example: ``identify(decode("noisy.exr")).of(Role.ALBEDO).name`` is ``"ViewLayer.Denoising Albedo"``.

Other people's renderers join through the entry-point group ``lambent.dialects`` (an entry names a
`Dialect`), or in a session through ``DIALECTS.register("mine", Dialect(...))``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from lambent.frame.dialects.choices import asked_for, joined, overridden
from lambent.frame.dialects.images import images_of, views_of
from lambent.frame.dialects.matching import (
    assign,
    attributes,
    chosen_scope,
    recognise,
    samples,
    scope_of,
    settle,
)
from lambent.frame.dialects.table import Dialect, Found, Identified, Rule, misses
from lambent.frame.role import INFO, Role, Stat
from lambent.frame.stamp import DENOISED, model_of, stamp_in
from lambent.registry import Registry

if TYPE_CHECKING:
    from lambent.frame.exr import ExrFile

__all__ = ["DIALECTS", "Dialect", "Found", "Identified", "Rule", "identify", "misses"]

_HERE = "lambent.frame.dialects"

#: Every dialect by name, in the order of asking; ``generic`` is what is left when none is proved.
DIALECTS = Registry(
    "dialect",
    {
        "lambent": f"{_HERE}.lambent:LAMBENT",
        "blender": f"{_HERE}.blender:BLENDER",
        "mitsuba": f"{_HERE}.mitsuba:MITSUBA",
        "pbrt": f"{_HERE}.pbrt:PBRT",
        "renderman": f"{_HERE}.renderman:RENDERMAN",
        "arnold": f"{_HERE}.arnold:ARNOLD",
        "vray": f"{_HERE}.vray:VRAY",
        "redshift": f"{_HERE}.redshift:REDSHIFT",
        "corona": f"{_HERE}.corona:CORONA",
        "octane": f"{_HERE}.octane:OCTANE",
        "unreal": f"{_HERE}.unreal:UNREAL",
        "houdini": f"{_HERE}.houdini:HOUDINI",
        "luxcore": f"{_HERE}.luxcore:LUXCORE",
        "appleseed": f"{_HERE}.appleseed:APPLESEED",
        "falcor": f"{_HERE}.falcor:FALCOR",
        "generic": f"{_HERE}.generic:GENERIC",
    },
    group="lambent.dialects",
)


def identify(
    exr: ExrFile, overrides: Mapping[str, str] | None = None, spp: int | None = None
) -> Identified:
    """What the layers of a decoded EXR mean, and why.

    ``overrides``: the user's own ``{role: layer}``, e.g. ``{"albedo": "MyLayer"}`` or channels with
    commas (``"0,1,2"``); a choice of colour in another view layer (Blender) makes that one the
    source of all roles. ``spp``: samples per pixel where the user knows better than the header.
    Every channel of the file is in exactly one layer, except those an image has beyond its role.
    A file without a colour is no error here: the frame simply has none.
    Raises `UnknownNameError` for an unknown role or layer, `LayerError` where a chosen layer has
    a number of channels that does not suit its role.
    """
    images = joined(images_of(exr), overrides or {}, exr.path)
    generic = DIALECTS["generic"]
    dialects = {name: DIALECTS[name] for name in DIALECTS if name != "generic"}
    # Plug-ins are asked first: who installs one wants it.
    own = [name for name in dialects if not DIALECTS.where(name).startswith(_HERE)]
    dialects = {name: dialects[name] for name in (*own, *(n for n in dialects if n not in own))}
    dialect, why = recognise(exr, images, dialects)

    scopes = {scope_of(image, dialect)[0] for image in images}
    told = samples(exr, dialect, scopes | {""}, generic)
    told = {scope: spp or count for scope, count in told.items()}
    matches, notes = assign(images, dialect, generic, _cryptomattes(exr), told)
    wanted = asked_for(images, overrides or {}, exr.path)
    asked = [scope_of(i, dialect)[0] for role, _, i in wanted if role is Role.COLOUR]
    scope = chosen_scope(matches, asked[0] if asked else "")
    if wanted:
        # A bare pass name that every view layer has means that of the view layer in use.
        near = sorted(images, key=lambda image: scope_of(image, dialect)[0] not in ("", scope))
        wanted = asked_for(near, overrides or {}, exr.path)
        matches = overridden(matches, wanted)
        mapped = {id(image) for _, _, image in wanted}
        matches = [replace(m, scope=scope) if id(m.image) in mapped else m for m in matches]
    layers_found, more = settle(matches, scope)
    layers_found, stale = _without_stale(exr, layers_found, {(r, s) for r, s, _ in wanted})
    return Identified(
        dialect="generic" if dialect is None else dialect.name,
        why=why or "nothing in the file tells the renderer; layers go by common names",
        layers=tuple(layers_found),
        spp=told.get(scope),
        views=views_of(exr),
        notes=tuple(
            dict.fromkeys([*stale, *_denoised(layers_found), *notes, *more, *_cie(layers_found)])
        ),
    )


def _cryptomattes(exr: ExrFile) -> list[str]:
    """Names of the cryptomattes that the header lists (Cryptomatte specification 1.2)."""
    names = []
    for text in attributes(exr):
        key, _, value = text.partition("=")
        if key.startswith("cryptomatte/") and key.endswith("/name") and value:
            names.append(value)
    return list(dict.fromkeys(names))


def _without_stale(
    exr: ExrFile, layers: list[Found], asked: set[tuple[Role, Stat]]
) -> tuple[list[Found], list[str]]:
    """The layers of a file that Lambent has denoised, and a remark.

    Variances and half buffers of what was filtered are those of the noisy picture: they lose their
    roles, unless the user asks for them.
    """
    stamps = [stamp for part in exr.parts if (stamp := stamp_in(part.header)) is not None]
    model = model_of(stamps[0]) if stamps else ""
    if not model:
        return layers, []
    only_beauty = stamps[0].get("passes") == "beauty"
    kept, stale = [], []
    for found in layers:
        filtered = found.role is Role.COLOUR if only_beauty else INFO[found.role].radiance
        if filtered and found.stat is not Stat.MEAN and (found.role, found.stat) not in asked:
            stale.append(found.name)
            why = f"{found.role.value}.{found.stat.value} of the picture before it was denoised"
            found = replace(found, role=Role.OTHER, stat=Stat.MEAN, why=why)
        kept.append(found)
    tail = "; its variances and half buffers are those of the noisy picture and are not used"
    return kept, [f"The file {DENOISED} (model {model}){tail if stale else ''}."]


def _denoised(layers: list[Found]) -> list[str]:
    """A remark where the file has a denoised beauty beside the noisy one."""
    for found in layers:
        if "already denoised" in found.why:
            beauty = next((f for f in layers if (f.role, f.stat) == (Role.COLOUR, Stat.MEAN)), None)
            if beauty is not None and beauty.name != found.name:
                return [
                    f"'{found.name}' is already denoised and stays as it is; '{beauty.name}' is "
                    "taken as the colour."
                ]
    return []


def _cie(layers: list[Found]) -> list[str]:
    """A remark on each layer of CIE XYZ."""
    return [
        f"'{found.name}' holds CIE XYZ; it is filtered as linear RGB (Rec. 709) and written back "
        "as XYZ."
        for found in layers
        if found.cie
    ]
