"""Common names, for files whose renderer is not known and as the last resort of every dialect.

These are words that mean the same wherever they stand: ``albedo``, ``normal``, ``depth``. Names
that one renderer uses in its own sense (V-Ray's ``diffuse`` is an albedo) belong in its table,
which is asked first. ``variance``, ``half_a`` and ``half_b`` (with a role in front: of that role)
are Lambent's own: a variance is that of the pixel's mean.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space, Stat

#: Role to words; the first group of a role is better than the next ones.
WORDS: tuple[tuple[Role, str, Space | None], ...] = (
    (Role.COLOUR, r"noisy([ _]?(image|colou?r|rgb))?", None),
    (Role.COLOUR, r"rgba?|y", None),
    (Role.COLOUR, r"beauty|colou?r|combined|radiance|hdr|render", None),
    (Role.ALBEDO, r"(denois(e|ing)[ _])?albedo|alb|base_?colou?r", None),
    (Role.DIFFUSE_ALBEDO, r"diffuse[_ ]?(albedo|colou?r|filter|reflectance)", None),
    (Role.SPECULAR_ALBEDO, r"(specular|glossy)[_ ]?(albedo|colou?r|filter|reflectance)", None),
    (Role.NORMAL, r"(denois(e|ing)[ _])?normals?|shading_?normals?|sh_normal|ns", None),
    (Role.NORMAL, r"n|nn|world_?normals?|normals?_?world", None),
    (Role.DEPTH, r"(denois(e|ing)[ _])?depth(\.z)?|z|z_?depth|distance", None),
    (Role.POSITION, r"p|pos|positions?|world_?pos(ition)?|pworld|pos_?w", None),
    (Role.MOTION, r"motion([_ ]?vectors?)?|mvec|flow", None),
    (Role.ROUGHNESS, r"rough(ness)?", None),
    (Role.EMISSION, r"emission|emissive|emit", None),
    (Role.DIFFUSE, r"diffuse", None),
    (Role.SPECULAR, r"specular|glossy", None),
    (Role.DIRECT, r"direct([_ ]?(light(ing)?|illumination))?", None),
    (Role.INDIRECT, r"indirect([_ ]?(light(ing)?|illumination))?|gi", None),
    (Role.ALPHA, r"a|alpha", None),
)

#: What follows a role's word (nothing: colour's) for its other statistics; a text all contain.
STATS: tuple[tuple[Stat, str, str, str], ...] = (
    (Stat.VARIANCE, r"var(iance)?", "var", "variance, taken to be that of the mean"),
    (Stat.HALF_A, r"half[_.]?(a|0)", "half", "one half of the samples"),
    (Stat.HALF_B, r"half[_.]?(b|1)", "half", "the other half of the samples"),
)

#: Ids and masks, with a text that every match contains.
IDS = (
    (r".*crypto.*", "crypto"),
    (r".*mask\d*(\.\w+)?", "mask"),
    (r".*matte\d*(\.\w+)?", "matte"),
    (
        r"(.*[_ .])?(object|obj|material|mat|instance|prim(itive)?|shape|asset|mesh|node|puzzle)"
        r"?[_ ]?(id|index)s?\d*(\.\w)?",
        "i",
    ),
)


def _rules() -> tuple[Rule, ...]:
    rules = [Rule(words, role, "a common name", space=space) for role, words, space in WORDS]
    rules += [
        Rule(pattern, Role.ID, "an id or a mask, never filtered", hint=hint)
        for pattern, hint in IDS
    ]
    for role, words, _ in WORDS:
        for stat, suffix, hint, what in STATS:
            front = f"(({words})[_. ])" + ("?" if role is Role.COLOUR else "")
            rules.append(Rule(front + suffix, role, what, stat, hint=hint))
    # Light in parts: these sum to the beauty where they are complete.
    rules += [
        Rule(
            r"(diffuse|specular|glossy|transmission|coat|sheen|sss|subsurface|volume)"
            r"[_ ]?(direct|indirect)|(direct|indirect)[_ ]?(diffuse|specular|glossy|volume)",
            Role.LIGHTING,
            "a part of the light",
        ),
        Rule(r"(light_?group|lg)[_ .].+|(rgba?|beauty|combined)_.+", Role.LIGHTING, "light group"),
        Rule(r"sss|subsurface|transmission|refraction|reflection|environment|background|volume",
             Role.LIGHTING, "a part of the light"),
    ]  # fmt: skip
    return tuple(rules)


GENERIC = Dialect(
    name="generic",
    title="common names",
    rules=_rules(),
    spp=((r"(?:.*[/.:])?(?:spp|samples_?per_?pixel|sample_?count)=(\d+(?:\.\d+)?)", 1),),
    verified="not a renderer",
)
