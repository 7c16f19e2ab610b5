"""The ways in which a solution by radiosity can be looked at."""

from __future__ import annotations

from lambent.errors import UnknownNameError

#: What a view can show.
SHOWS = {
    "smooth": "irradiance interpolated between corners, times the texture",
    "gather": "final gather: direct light and one bounce traced, the rest from the solution",
    "patch": "irradiance of the patch, times the texture",
    "mesh": "as patch, with the outlines of the patches",
    "irradiance": "smooth, without the texture",
    "residual": "where the solution does not yet agree with itself: |E + ρFB - B|",
}


def check_show(name: str) -> None:
    """Raises `UnknownNameError` unless there is such a kind of view."""
    if name not in SHOWS:
        raise UnknownNameError("kind of view", name, SHOWS)
