"""`lambent.denoise` and `lambent.render` are functions, and packages in every form of import."""

import subprocess
import sys

import pytest

FORMS = (
    "import lambent.denoise.pipeline as p",
    "from lambent.denoise import pipeline as p",
    "import lambent; lambent.denoise; import lambent.denoise.pipeline as p",
    "import lambent.denoise.pipeline; import sys; p = sys.modules['lambent.denoise.pipeline']",
)


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_import(form):
    code = f"""{form}
import inspect, pickle, lambent
assert p.Settings.__module__ == "lambent.denoise.pipeline", p
assert inspect.isfunction(lambent.denoise)
assert "model" in inspect.signature(lambent.denoise).parameters
assert pickle.loads(pickle.dumps(lambent.denoise)) is lambent.denoise
"""
    subprocess.run([sys.executable, "-c", code], check=True)
