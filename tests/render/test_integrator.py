"""The plug-in `lambent_frames` in Mitsuba's own hands, and what it sees of surfaces."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest

from lambent.render import variant
from lambent.render.variant import mitsuba

mi = mitsuba()

import drjit as dr

import lambent
import lambent.render.integrator  # noqa: F401 (registers the plug-in)
from lambent.render.surface import describe

from . import scenes


def test_render_returns_all_channels_by_name():
    scene = scenes.everything(mi, size=12)
    plugin = mi.load_dict({"type": "lambent_frames", "max_depth": 4, "features": "albedo,normal"})
    image = np.array(mi.render(scene, integrator=plugin, spp=8, seed=3))
    names = ["R", "G", "B", *plugin.aov_names()]
    assert image.shape == (12, 12, len(names))
    assert len(set(names)) == len(names)
    frame = plugin.frame(scene, seed=3, spp=8)
    np.testing.assert_array_equal(image[..., :3], frame.colour)
    at = names.index("albedo.R")
    np.testing.assert_array_equal(image[..., at : at + 3], frame["albedo"])
    at = names.index("variance.R")
    np.testing.assert_array_equal(image[..., at : at + 3], frame["colour.variance"])


def test_a_scene_file_may_name_it(tmp_path):
    path = tmp_path / "named.xml"
    path.write_text(
        '<scene version="3.0.0"><integrator type="lambent_frames">'
        '<integer name="max_depth" value="3"/></integrator>'
        '<sensor type="perspective"><film type="hdrfilm"><integer name="width" value="8"/>'
        '<integer name="height" value="8"/><rfilter type="box"/></film></sensor>'
        '<emitter type="constant"/></scene>'
    )
    image = np.array(mi.render(mi.load_file(str(path)), spp=2))
    assert image.shape[2] > 60
    np.testing.assert_allclose(image[..., :3], 1.0, rtol=1e-5)
    notes: list[str] = []
    from lambent.render.job import render_all
    from lambent.render.options import Effort, Listeners

    (done,) = render_all(path, effort=Effort(spp=2), listeners=Listeners(note=notes.append))
    np.testing.assert_allclose(done.frame.colour, 1.0, rtol=1e-5)
    assert not any("integrator" in note for note in notes)


def test_a_nested_integrator_is_wrapped():
    scene = scenes.everything(mi, size=12)
    nested = {"type": "direct"}
    plugin = mi.load_dict({"type": "lambent_frames", "features": "albedo", "inner": nested})
    frame = plugin.frame(scene, spp=64, seed=1)
    direct = np.array(mi.render(scene, integrator=mi.load_dict(nested), spp=256, seed=2))
    ratio = frame.colour.mean() / direct[..., :3].mean()
    assert ratio == pytest.approx(1, abs=0.05)


# ------------------------------------------------------------------- surfaces


def _seen(bsdf, cosine: float = 0.7, uv: tuple[float, float] = (0.5, 0.5)):
    """`describe` of a BSDF at an angle, and its directional albedo by sampling."""
    count = 200_000
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.Vector3f(math.sqrt(1 - cosine**2), 0, cosine)
    si.uv = mi.Point2f(*uv)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    si.n = mi.Normal3f(0, 0, 1)
    seen = describe(bsdf, si, True)
    importance = mi.BSDFContext(mi.TransportMode.Importance)  # no 1 / η² for radiance
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, count)
    _, weight = bsdf.sample(importance, si, sampler.next_1d(), sampler.next_2d())
    total = [float(dr.mean(c)[0]) for c in mi.Color3f(weight)]
    read = lambda colour: [float(np.array(c).ravel()[0]) for c in colour]  # noqa: E731
    rough = float(np.array(seen.roughness).ravel()[0])
    return read(seen.diffuse), read(seen.specular), rough, total


RGB = {"type": "rgb", "value": [0.2, 0.5, 0.8]}


@pytest.mark.parametrize(
    ("bsdf", "roughness", "tolerance"),
    [
        ({"type": "diffuse", "reflectance": RGB}, 1.0, 0.005),
        ({"type": "conductor", "material": "Cu"}, 0.0, 0.005),
        ({"type": "roughconductor", "material": "Au", "alpha": 0.04}, 0.2, 0.03),
        ({"type": "dielectric"}, 0.0, 0.005),
        ({"type": "thindielectric"}, 0.0, 0.01),
        ({"type": "plastic", "diffuse_reflectance": RGB}, 0.0, 0.12),
        ({"type": "roughplastic", "diffuse_reflectance": RGB, "alpha": 0.09}, 0.3, 0.12),
        ({"type": "principled", "base_color": RGB, "roughness": 0.5}, 0.5, 0.1),
        ({"type": "principled", "base_color": RGB, "metallic": 1.0, "roughness": 0.2}, 0.2, 0.12),
    ],
    ids=lambda v: v["type"] if isinstance(v, dict) else "",
)
def test_albedos_sum_to_what_a_surface_gives_back(bsdf, roughness, tolerance):
    """Against the directional albedo by sampling."""
    diffuse, specular, rough, total = _seen(mi.load_dict(bsdf))
    assert rough == pytest.approx(roughness, abs=1e-3)
    for d, s, t in zip(diffuse, specular, total, strict=True):
        assert 0 <= d <= 1
        assert 0 <= s <= 1
        assert min(d + s, 1) == pytest.approx(t, abs=tolerance)


def test_wrappers_are_looked_through():
    inner = {"type": "diffuse", "reflectance": RGB}
    plain = _seen(mi.load_dict(inner))
    two = _seen(mi.load_dict({"type": "twosided", "b": inner}))
    mask = _seen(mi.load_dict({"type": "mask", "opacity": 0.4, "b": inner}))
    assert plain[:3] == two[:3] == mask[:3]
    metal = {"type": "roughconductor", "alpha": 0.25}
    blend = _seen(mi.load_dict({"type": "blendbsdf", "weight": 0.25, "a": inner, "b": metal}))
    np.testing.assert_allclose(blend[0], np.multiply(plain[0], 0.75), rtol=1e-5)
    assert blend[2] == pytest.approx(0.75 * 1 + 0.25 * 0.5)


def test_textures_are_read_where_the_surface_is_hit():
    image = np.zeros((1, 2, 3), np.float32)
    image[0, 0], image[0, 1] = (0.9, 0.1, 0.1), (0.1, 0.1, 0.9)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(image), "raw": True, "filter_type": "nearest"}
    bsdf = mi.load_dict({"type": "diffuse", "reflectance": texture})
    np.testing.assert_allclose(_seen(bsdf, uv=(0.25, 0.5))[0], [0.9, 0.1, 0.1], atol=1e-3)
    np.testing.assert_allclose(_seen(bsdf, uv=(0.75, 0.5))[0], [0.1, 0.1, 0.9], atol=1e-3)


def test_light_groups_take_ids_of_emitters_and_of_shapes():
    from lambent.render.sampling import FrameSampler

    scene = scenes.everything(mi, size=12)
    by_shape = FrameSampler(scene, depth=4, light_groups={"key": ["lamp"]}).sample(8, 1).frame()
    by_own = FrameSampler(scene, depth=4, light_groups={"key": ["light"]}).sample(8, 1).frame()
    key = by_shape.extras["lightgroup_key"].data
    np.testing.assert_array_equal(key, by_own.extras["lightgroup_key"].data)
    # Without the sky, the lamp's light is all there is: as of a scene with the lamp alone.
    params = mi.traverse(scene)
    name = next(k for k in params.keys() if k.startswith("sky.radiance"))  # noqa: SIM118
    params[name] = 0.0
    params.update()
    alone = FrameSampler(scene, depth=4).sample(8, 1).frame()
    assert key.mean() == pytest.approx(alone.colour.mean(), rel=0.05)


def test_the_variant_is_chosen_and_errors_name_the_remedy(monkeypatch):
    from lambent.errors import OptionError

    assert mi.variant() == "llvm_ad_rgb"
    with pytest.raises(OptionError, match="no device 'tpu'"):
        variant.mitsuba("tpu")


def test_one_processor_is_enough():
    """Mitsuba's loader waits for ever with a pool of a single thread."""
    code = (
        "import os; os.sched_setaffinity(0, list(os.sched_getaffinity(0))[:1])\n"
        "from lambent.render.variant import mitsuba\n"
        "mi = mitsuba()\n"
        "import drjit as dr\n"
        "print(dr.thread_count())\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) >= 2
