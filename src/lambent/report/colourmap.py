"""The colour map of error maps: black over violet, red and orange to pale yellow.

Made here, in OkLCh (B. Ottosson, "A perceptual color space for image processing", 2020): lightness
rises evenly from 0.10 to 0.98, so that a map also reads in grey and for colour-blind eyes, while
the hue turns from violet to yellow and the chroma swells in between.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lambent.frame.tonemap import srgb

#: OkLab to linear Rec. 709: cone responses (to be cubed), then the matrix to RGB.
TO_CONES = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)

#: Place on the map, hue in degrees, chroma.
KNOTS = np.array(
    [
        [0.00, 280.0, 0.010],
        [0.15, 286.0, 0.095],
        [0.35, 325.0, 0.170],
        [0.55, 375.0, 0.190],
        [0.72, 400.0, 0.165],
        [0.88, 435.0, 0.120],
        [1.00, 465.0, 0.065],
    ]
)


def error_colours(count: int = 256) -> NDArray[np.uint8]:
    """``(count, 3)`` sRGB bytes from no error to the largest."""
    t = np.linspace(0, 1, count)
    lightness = 0.10 + 0.88 * t
    hue = np.deg2rad(np.interp(t, KNOTS[:, 0], KNOTS[:, 1]))
    chroma = np.interp(t, KNOTS[:, 0], KNOTS[:, 2])
    colours = _rgb(lightness, chroma, hue)
    for _ in range(60):  # pull what the screen cannot show towards grey, at equal lightness
        outside = ((colours < 0) | (colours > 1)).any(axis=1)
        if not outside.any():
            break
        chroma = np.where(outside, chroma * 0.97, chroma)
        colours = _rgb(lightness, chroma, hue)
    return np.asarray(srgb(colours) * 255 + 0.5, np.uint8)


def _rgb(
    lightness: NDArray[np.float64], chroma: NDArray[np.float64], hue: NDArray[np.float64]
) -> NDArray[np.float64]:
    lab = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=1)
    return np.asarray(((lab @ TO_CONES.T) ** 3) @ TO_RGB.T)
