"""Which lighting layers of a frame add up to its beauty.

Renderers split light in several ways at once (by lobe, by light, direct and indirect); each way is
a row of `WAYS`. A way counts where the frame has at least two of its layers; the residual says
whether the split is complete.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import INFO, Role, Stat

#: A residual below this means that the layers sum to the beauty (half floats lose about 0.05 %).
SUMS = 0.01


@dataclass(frozen=True)
class LayerSum:
    """``residual``: mean |sum - beauty| over mean |beauty|; ``sums``: it is below 1 %."""

    way: str
    layers: tuple[str, ...]
    beauty: str
    residual: float

    @property
    def sums(self) -> bool:
        """Whether the layers add up to the beauty."""
        return self.residual < SUMS


#: Ways to split light: words and a pattern for the last part of a layer's name. Layers of light
#: groups have the group's name behind.
GROUP = r"(combined|rgba?|beauty|c|light_?group|lg|lightselect|radiance_group)_.+"
WAYS: tuple[tuple[str, str], ...] = (
    ("light groups", GROUP),
    ("direct and indirect light", r"(in)?direct([_ ]?light(ing)?)?|emission|emissive"),
    (
        "lobes",
        r"diffuse|specular|glossy|coat|sheen|sss\d?|subsurface|transmission|volume|emission|"
        r"emissive|background|environment",
    ),
    (
        "lobes, direct and indirect",
        r"(diffuse|specular|glossy|coat|sheen|sss|subsurface|transmission|volume)[_ ]"
        r"(direct|indirect)|(in)?direct[_ ]?(diffuse|specular|glossy(reflection)?|volume|emission)|"
        r"glossytransmission|emission|background",
    ),
    (
        "V-Ray's elements",
        r"lighting|gi|reflect(ion)?|refract(ion)?|specular|sss\d?|selfillum(ination)?|"
        r"atmosphere|background|caustics",
    ),
    ("Corona's elements", r"cessential_.+"),
    (
        "Redshift's AOVs",
        r"diffuse[ _]?lighting|speculars?[ _]?lighting|global[ _]?illumination|gi|reflections?|"
        r"refractions?|sss|sub[ _]?surface[ _]?scatter(ing)?|caustics|emission|background|"
        r"volume[ _]?lighting",
    ),
    (
        "Octane's passes",
        r"emitters|environment|diffuse|reflection|refraction|transmission|volume|"
        r"sub-?surface[ _]?scattering|sss",
    ),
)

#: Cycles: light of a lobe is written before the colour of the surface (new and old pass names).
CYCLES_LOBES = (
    (("Diffuse Direct", "DiffDir"), ("Diffuse Indirect", "DiffInd"), ("Diffuse Color", "DiffCol")),
    (("Glossy Direct", "GlossDir"), ("Glossy Indirect", "GlossInd"), ("Glossy Color", "GlossCol")),
    (
        ("Transmission Direct", "TransDir"),
        ("Transmission Indirect", "TransInd"),
        ("Transmission Color", "TransCol"),
    ),
    (
        ("Subsurface Direct", "SubsurfaceDir"),
        ("Subsurface Indirect", "SubsurfaceInd"),
        ("Subsurface Color", "SubsurfaceCol"),
    ),
)
CYCLES_PLAIN = (
    ("Volume Direct", "VolumeDir"),
    ("Volume Indirect", "VolumeInd"),
    ("Emission", "Emit"),
    ("Environment", "Env"),
)


def layer_sums(frame: Frame) -> list[LayerSum]:
    """Every way in which the frame's light is split, best first; empty without a beauty."""
    beauty = frame.layer(Role.COLOUR)
    if beauty is None or beauty.data.size == 0:
        return []
    target = frame.colour
    scale = float(np.mean(np.abs(target[np.isfinite(target)]), dtype=np.float64))
    if not scale > 0:
        return []
    found = []
    for way, terms in _ways(frame):
        total = np.zeros(target.shape, np.float64)
        for _, image in terms:
            total += image
        difference = np.abs(total - target)
        residual = float(np.mean(difference[np.isfinite(difference)])) / scale
        found.append(LayerSum(way, tuple(name for name, _ in terms), beauty.name, residual))
    return sorted(found, key=lambda one: one.residual)


def _ways(frame: Frame) -> Iterator[tuple[str, list[tuple[str, FloatImage]]]]:
    light = [
        layer
        for layer in frame.all_layers()
        if layer.stat is Stat.MEAN and layer.role is not Role.COLOUR and INFO[layer.role].radiance
    ]
    cycles = _cycles(frame)
    if cycles:
        yield "Cycles' passes, Σ (direct + indirect) · colour + the rest", cycles
    seen = set()
    for way, pattern in WAYS:
        members = [
            layer for layer in light if re.fullmatch(pattern, last_part(layer.name), re.IGNORECASE)
        ]
        names = tuple(layer.name for layer in members)
        if len(members) >= 2 and names not in seen and not (cycles and way != "light groups"):
            seen.add(names)
            yield way, [(layer.name, layer.data) for layer in members]


def _cycles(frame: Frame) -> list[tuple[str, FloatImage]]:
    by_name: dict[str, Layer] = {last_part(layer.name): layer for layer in frame.all_layers()}

    def get(names: tuple[str, ...]) -> Layer | None:
        return next((by_name[name] for name in names if name in by_name), None)

    terms: list[tuple[str, FloatImage]] = []
    for direct, indirect, colour in CYCLES_LOBES:
        albedo = get(colour)
        for names in (direct, indirect):
            light = get(names)
            if light is not None and albedo is not None:
                terms.append((f"{light.name} · {last_part(albedo.name)}", light.data * albedo.data))
    if not terms:
        return []
    terms += [(layer.name, layer.data) for names in CYCLES_PLAIN if (layer := get(names))]
    return terms if len(terms) >= 2 else []


def last_part(name: str) -> str:
    """``"ViewLayer.Diffuse Direct"`` to ``"Diffuse Direct"``."""
    return name.rpartition(".")[2]
