"""Options of random Cycles scenes are checked before any Blender is started."""

from __future__ import annotations

import pytest

from lambent.errors import OptionError
from lambent.scenes.cycles import render_random


@pytest.mark.parametrize(
    "options",
    [
        {"spp_list": ()}, {"spp_list": (0,)}, {"reference_blocks": 1}, {"size": (4, 4)},
        {"kind": "castle"}, {"crop": 2.0}, {"frames": 0},
    ],
)  # fmt: skip
def test_options_of_random_scenes(options: dict) -> None:
    with pytest.raises(OptionError):
        render_random(0, **options)
