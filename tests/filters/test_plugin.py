"""The plug-in of docs/guides/plugins.md, taken from the page itself and installed as a package."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "guides" / "plugins.md"


@pytest.fixture
def plugin(tmp_path: Path) -> dict[str, str]:
    """An environment in which the page's package is installed (module and entry point)."""
    text = PAGE.read_text()
    module = re.search(r"```python\n(.*?)```", text, re.S)
    entry = re.search(r"```toml\n\[project\.entry-points\.\"(.+?)\"\]\n(.*?)```", text, re.S)
    assert module is not None
    assert entry is not None
    (tmp_path / "lambent_median.py").write_text(module[1])
    info = tmp_path / "lambent_median-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lambent-median\nVersion: 1.0\n")
    points = entry[2].replace('"', "")
    (info / "entry_points.txt").write_text(f"[{entry[1]}]\n{points}")
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PYTHONPATH": path}


def test_the_page_s_plugin_is_listed_and_denoises(plugin: dict[str, str], tmp_path: Path) -> None:
    import lambent

    image = np.full((12, 16, 3), 0.5, np.float32)
    image[5, 6] = 40.0  # one firefly
    noisy = tmp_path / "noisy.exr"
    lambent.write(noisy, lambent.Frame.from_arrays(colour=image))

    run = [sys.executable, "-m", "lambent"]
    listed = subprocess.run(
        [*run, "models", "--json"], env=plugin, capture_output=True, text=True, check=True
    )
    assert "median" in json.dumps(json.loads(listed.stdout))
    subprocess.run(
        [*run, "denoise", str(noisy), "--model", "median", "--set", "radius=1"],
        env=plugin,
        check=True,
        capture_output=True,
    )
    clean = lambent.read(tmp_path / "noisy_clean.exr").colour
    np.testing.assert_array_equal(clean, np.full_like(image, 0.5))


def test_a_broken_plugin_is_named(tmp_path: Path) -> None:
    """A plug-in that cannot be imported is an error that names it, not a traceback."""
    from lambent.errors import LambentError
    from lambent.registry import Registry

    registry = Registry("model", {}, group=None)
    registry.__dict__["_plugins"] = {"bad": "no_such_module_at_all:Thing"}
    with pytest.raises(LambentError, match="plug-in for model 'bad'"):
        registry["bad"]
