"""What the builders of scenes tell the camera: where the subject is and where one may stand."""

from __future__ import annotations

from dataclasses import dataclass

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Layout:
    """``centre`` and ``radius`` of what is worth seeing; ``inside``: two corners of a room that the
    camera must not leave, or None; ``eye_height``: lowest and highest place of the camera.
    """

    kind: str
    centre: Point
    radius: float
    inside: tuple[Point, Point] | None = None
    eye_height: tuple[float, float] = (0.3, 3.0)
