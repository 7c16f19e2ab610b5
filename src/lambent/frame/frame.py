"""A render: layers by role, extra layers by name, and what is needed to write the file back."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from lambent.errors import LayerError
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import INFO, Role, Stat, parse_role

if TYPE_CHECKING:
    from lambent.frame.origin import Origin
    from lambent.frame.windows import Windows

Key = tuple[Role, Stat]

#: Roles that a frame holds by name in `extras`, since there may be many of each.
NAMED_ROLES = frozenset({Role.LIGHTING, Role.ID, Role.OTHER})


#: What stands before a role's title for its other statistics.
_STATS = {
    Stat.MEAN: "",
    Stat.VARIANCE: "variance of the ",
    Stat.HALF_A: "first half buffer of the ",
    Stat.HALF_B: "second half buffer of the ",
}


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture with everything its renderer told about it. Frozen: changes make a new one.

    ``layers``: one layer for each (role, statistic). ``extras``: other layers by name (lighting
    layers, ids, anything). ``spp``: samples per pixel if known. ``view``: name of the stereo view,
    or "". ``notes``: remarks made while reading and repairing, one sentence each. ``windows``:
    where the pixels lie in the picture, or None for a whole one.
    All layers have the same height and width.
    """

    layers: Mapping[Key, Layer] = field(default_factory=dict)
    extras: Mapping[str, Layer] = field(default_factory=dict)
    spp: int | None = None
    view: str = ""
    dialect: str = ""
    origin: Origin | None = None
    notes: tuple[str, ...] = ()
    windows: Windows | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "layers", MappingProxyType(dict(self.layers)))
        object.__setattr__(self, "extras", MappingProxyType(dict(self.extras)))

    # ---------------------------------------------------------------- making

    @classmethod
    def from_layers(cls, layers: Iterable[Layer], **fields: Any) -> Frame:
        """A frame from layers; the first of a role wins, named roles go to `extras`."""
        by_key: dict[Key, Layer] = {}
        extras: dict[str, Layer] = {}
        for layer in layers:
            if layer.role in NAMED_ROLES or layer.key in by_key:
                extras[layer.name] = layer
            else:
                by_key[layer.key] = layer
        return cls(layers=by_key, extras=extras, **fields)

    @classmethod
    def from_arrays(cls, spp: int | None = None, **arrays: Any) -> Frame:
        """A frame from arrays ``(H, W, C)`` or ``(H, W)`` named by role.

        ``Frame.from_arrays(colour=c, albedo=a, colour_variance=v, colour_half_a=h)``; a light
        group or other lighting layer is passed as ``lighting={"key": k, "fill": f}``.
        Raises `UnknownNameError` for an unknown role, `LayerError` where sizes differ.
        """
        layers = []
        for name, array in arrays.items():
            if array is None:
                continue
            if name == "lighting":
                layers += [Layer(Role.LIGHTING, a, name=n) for n, a in array.items()]
                continue
            text = name
            for stat in Stat:
                if name.endswith("_" + stat.value):
                    text = name[: -len(stat.value) - 1] + "." + stat.value
            role, stat = parse_role(text)
            layers.append(Layer(role, np.asarray(array), stat=stat))
        return cls.from_layers(layers, spp=spp).checked()

    def checked(self) -> Frame:
        """This frame, after making sure that all layers have the size of the colour."""
        size = None
        for layer in self.all_layers():
            here = layer.data.shape[:2]
            if size is None:
                size = here
            elif here != size:
                raise LayerError(
                    f"is {here[1]}x{here[0]}, the first layer is {size[1]}x{size[0]}",
                    file=self.path,
                    layer=layer.name,
                    remedy="all layers of a frame need the same size",
                )
        return self

    # --------------------------------------------------------------- looking

    @property
    def path(self) -> str | None:
        """The file this came from, or None."""
        return None if self.origin is None else str(self.origin.path)

    @property
    def height(self) -> int:
        """Rows."""
        return int(self._any().data.shape[0])

    @property
    def width(self) -> int:
        """Columns."""
        return int(self._any().data.shape[1])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        """The beauty ``(H, W, 3)`` for ``np.asarray(frame)``. Raises `LayerError` without one."""
        array = np.asarray(self.colour, dtype)
        if copy is False and array is not self.colour:
            raise ValueError("a frame's colour as another type is a copy")
        return array.copy() if copy else array

    def _any(self) -> Layer:
        for layer in self.all_layers():
            return layer
        raise LayerError("the frame has no layers", file=self.path)

    def all_layers(self) -> Iterable[Layer]:
        """Every layer, those with a role first."""
        yield from self.layers.values()
        yield from self.extras.values()

    def layer(self, role: Role, stat: Stat = Stat.MEAN) -> Layer | None:
        """The layer of a role, or None."""
        return self.layers.get((role, stat))

    def has(self, role: Role, stat: Stat = Stat.MEAN) -> bool:
        """Whether there is a layer of that role."""
        return (role, stat) in self.layers

    def get(self, role: Role, stat: Stat = Stat.MEAN) -> FloatImage | None:
        """The pixels of a role ``(H, W, C)``, or None."""
        layer = self.layer(role, stat)
        return None if layer is None else layer.data

    def __getitem__(self, key: Role | Key | str) -> FloatImage:
        """The pixels of a role: ``frame[Role.ALBEDO]``, ``frame["colour.variance"]``.

        Raises `LayerError` that lists what there is and how to map a layer by hand.
        """
        if isinstance(key, Role):
            role, stat = key, Stat.MEAN
        elif isinstance(key, str):
            role, stat = parse_role(key)
        else:
            role, stat = key
        layer = self.layer(role, stat)
        if layer is None:
            raise self.missing(role, stat)
        return layer.data

    def missing(self, role: Role, stat: Stat = Stat.MEAN) -> LayerError:
        """The error to raise where a layer is needed that is not there."""
        name = role.value if stat is Stat.MEAN else f"{role.value}.{stat.value}"
        choice = "LAYER (or FILE.exr)" if INFO[role].guide else "LAYER"
        have = ", ".join(sorted({layer.name for layer in self.all_layers()})) or "nothing"
        return LayerError(
            f"no layer for '{name}' ({_STATS[stat]}{INFO[role].title}) was found",
            file=self.path,
            remedy=f"name one yourself: --map {name}={choice}. The file has: {have}.",
        )

    @property
    def colour(self) -> FloatImage:
        """The beauty ``(H, W, 3)``, linear radiance. Raises `LayerError` if there is none."""
        image = self[Role.COLOUR]
        return image if image.shape[2] == 3 else np.repeat(image, 3, axis=2)

    def lighting(self) -> dict[str, Layer]:
        """Every layer of radiance beside the beauty, by name in the file (mean only)."""
        found = {}
        for layer in self.all_layers():
            if layer.role is Role.COLOUR or layer.stat is not Stat.MEAN:
                continue
            if INFO[layer.role].radiance:
                found[layer.name] = layer
        return found

    # -------------------------------------------------------------- changing

    def replace(self, **changes: Any) -> Frame:
        """A copy with other fields (`spp`, `notes`, …)."""
        return dataclasses.replace(self, **changes)

    def with_layer(self, layer: Layer) -> Frame:
        """A copy in which ``layer`` takes its place (by role, or by name among the extras)."""
        if layer.name in self.extras or layer.role in NAMED_ROLES:
            return self.replace(extras={**self.extras, layer.name: layer})
        return self.replace(layers={**self.layers, layer.key: layer})

    def without(self, *keys: Role | Key) -> Frame:
        """A copy without these layers. A bare role means all its statistics."""
        drop = {k for k in self.layers for x in keys if k == x or k[0] == x}
        return self.replace(layers={k: v for k, v in self.layers.items() if k not in drop})

    def noted(self, *notes: str) -> Frame:
        """A copy with more remarks."""
        return self.replace(notes=(*self.notes, *notes))

    def crop(self, top: int, bottom: int, left: int, right: int) -> Frame:
        """Rows ``top:bottom`` and columns ``left:right`` of every layer, cut when looked at."""

        def cut(layer: Layer) -> Layer:
            def pixels() -> FloatImage:
                return layer.data[top:bottom, left:right]

            return dataclasses.replace(layer, pixels=pixels, _decoded=[])

        windows = self.windows
        return self.replace(
            windows=windows and windows.cropped(top, bottom, left, right),
            layers={k: cut(v) for k, v in self.layers.items()},
            extras={k: cut(v) for k, v in self.extras.items()},
        )

    # --------------------------------------------------------------- showing

    def __repr__(self) -> str:
        roles = ", ".join(
            k[0].value if k[1] is Stat.MEAN else f"{k[0].value}.{k[1].value}" for k in self.layers
        )
        more = f" + {len(self.extras)} more" if self.extras else ""
        spp = f", {self.spp} spp" if self.spp else ""
        size = f"{self.width}x{self.height}" if (self.layers or self.extras) else "empty"
        return f"<Frame {size}{spp}: {roles}{more}>"

    def _repr_png_(self) -> bytes | None:
        """The tone-mapped beauty, for Jupyter."""
        if not self.has(Role.COLOUR):
            return None
        from lambent.frame.tonemap import to_png

        return to_png(self.colour)
