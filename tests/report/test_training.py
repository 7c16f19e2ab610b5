"""The page of a training run."""

import io
import re

import pytest
from PIL import Image

from lambent.report.training import training_page


def lines():
    found = []
    for step in range(50, 501, 50):
        found.append({"step": step, "loss": 1 / step, "steps_a_second": 2.0})
        if step % 250 == 0:
            check = {"full relmse": 0.1, "full relmse/oidn": 1.5, "score": 100 / step}
            found.append({"step": step, "check": check})
    return found


def picture():
    buffer = io.BytesIO()
    Image.new("RGB", (30, 10)).save(buffer, "PNG")
    return buffer.getvalue(), (30, 10)


def test_it_shows_curves_scores_and_pictures():
    page = training_page("ours", lines(), [picture()], 1000, running=True)
    assert page.count("<polyline") == 3
    assert "500 of 1000" in page
    assert "0.200 at step 500" in page
    assert 'http-equiv="refresh"' in page
    assert "about 4 min" in page
    assert page.count("<figure>") == 1
    assert "full relmse/oidn" in page


@pytest.mark.parametrize("running", [True, False])
def test_a_run_that_has_just_begun(running):
    page = training_page("ours", [], [], 1000, running=running)
    assert "0 of 1000" in page
    assert ("refresh" in page) is running


def test_a_curve_over_decades_is_marked_at_powers_of_ten():
    from lambent.report.curve import curve

    drawn = curve({"residual": [(1, 0.37), (2, 0.02), (3, 4.1e-5)]})
    assert re.findall(r'text-anchor="end">([0-9.e-]+)</text>', drawn) == [
        "0.0001",
        "0.001",
        "0.01",
        "0.1",
    ]
