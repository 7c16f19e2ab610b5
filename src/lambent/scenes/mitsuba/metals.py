"""Complex indices of refraction of metals, for red, green and blue.

Values at about 630, 530 and 465 nm, rounded from the measurements of Johnson and Christy ("Optical
Constants of the Noble Metals", 1972; "Optical constants of transition metals", 1974) and, for
aluminium, Rakić ("Algorithm for the determination of intrinsic optical constants of metal films",
1995). Brass and bronze are mixtures by eye.
"""

from __future__ import annotations

Triple = tuple[float, float, float]

#: Name to ``(eta, k)``.
METALS: dict[str, tuple[Triple, Triple]] = {
    "aluminium": ((1.40, 0.87, 0.62), (7.6, 6.3, 5.4)),
    "silver": ((0.056, 0.055, 0.047), (4.2, 3.4, 2.8)),
    "gold": ((0.18, 0.54, 1.34), (3.4, 2.3, 1.9)),
    "copper": ((0.24, 1.12, 1.15), (3.6, 2.6, 2.5)),
    "brass": ((0.44, 0.60, 1.20), (3.7, 2.8, 1.9)),
    "bronze": ((0.60, 1.00, 1.25), (3.5, 2.6, 2.2)),
    "iron": ((2.90, 2.95, 2.65), (3.1, 2.9, 2.8)),
    "chromium": ((3.10, 3.15, 2.40), (3.3, 3.3, 3.2)),
    "titanium": ((2.70, 2.40, 2.15), (3.7, 3.3, 2.95)),
}
