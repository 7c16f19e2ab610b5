"""Progress of a part, as progress of the whole."""

from __future__ import annotations

from lambent.progress import part_of


def test_a_part_is_told_as_its_share_of_the_whole():
    seen = []
    third = part_of(lambda *state: seen.append(state), 20, 10, 30)
    part_of(third, 1, 1, 2)(3, 4, "second half")
    assert seen == [(20 + 10 * (1 + 3 / 4) / 2, 30, "second half")]
