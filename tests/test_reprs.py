"""What a notebook shows of the public records: a line, never the pixels."""

import numpy as np
import pytest

import lambent
from lambent.render.variant import mitsuba

mitsuba()

IMAGE = np.random.default_rng(0).random((48, 60, 3), np.float32)
ROOM = {
    "type": "scene",
    "sensor": {"type": "perspective"},
    "floor": {"type": "rectangle", "bsdf": {"type": "diffuse"}},
    "lamp": {"type": "constant"},
}
FRAME = lambent.Frame.from_arrays(colour=IMAGE, albedo=IMAGE)


def records():
    yield FRAME
    yield FRAME.layer(lambent.Role.COLOUR)
    yield lambent.compare(FRAME, {"<b>": FRAME})
    yield lambent.compare(FRAME, FRAME).pictures[0]
    yield lambent.explain(FRAME, "bilateral", x=5, y=5)
    yield lambent.DENOISERS
    yield lambent.DENOISERS["nlm"]()
    yield lambent.solve(ROOM, patches=60)


@pytest.mark.parametrize("record", list(records()), ids=lambda r: type(r).__name__)
def test_reprs_are_short(record):
    text = repr(record)
    assert "array(" not in text
    assert len(text) < (800 if record is lambent.DENOISERS else 250)


def test_a_comparison_is_a_table_in_a_notebook_and_when_printed():
    table = lambent.compare(FRAME, {"<b>": FRAME, "noisy": IMAGE * 1.1}, ["relmse"])
    html = table._repr_html_()
    assert html.count("<tr>") == 3
    assert "&lt;b&gt;" in html
    assert "<b>0</b>" in html
    assert str(table) == table.markdown()


def test_a_solution_in_a_notebook():
    html = lambent.solve(ROOM, patches=60)._repr_html_()
    assert "<th>patches</th>" in html
    assert "radiosity" in html


def test_one_image_alone_can_be_compared():
    for image in (FRAME, IMAGE):
        assert len(lambent.compare(FRAME, image).rows) == 1
