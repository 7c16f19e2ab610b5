"""One kernel for all samples: the light is Mitsuba's, the books balance, variances are true."""

from __future__ import annotations

import numpy as np
import pytest

from lambent.errors import OptionError, UnknownNameError
from lambent.frame.role import Role, Stat
from lambent.render.variant import mitsuba

# Not pytest.importorskip: Dr.Jit looks for LLVM when Mitsuba is imported, so that comes second.
mi = mitsuba()

from lambent.render.sampling import FrameSampler, Request

from . import scenes

#: Scene of the sums: every kind of light at once.
SUMS = [("", False), ("", True), ("homogeneous", True), ("heterogeneous", False)]


@pytest.mark.parametrize(("medium", "lens"), SUMS)
def test_parts_of_the_light_sum_to_the_beauty(medium, lens):
    scene = scenes.everything(mi, medium=medium, lens=lens)
    sampler = FrameSampler(scene, depth=8, light_groups={"lamp": ["lamp"]})
    frame = sampler.sample(16, seed=3).frame()
    colour = frame.colour
    close = dict(rtol=2e-5, atol=2e-6 * float(colour.max()))
    np.testing.assert_allclose(frame["diffuse"] + frame["specular"], colour, **close)
    np.testing.assert_allclose(frame["direct"] + frame["indirect"], colour, **close)
    groups = [layer.data for name, layer in frame.extras.items() if name.startswith("lightgroup_")
              and "variance" not in name]  # fmt: skip
    assert len(groups) == 2
    np.testing.assert_allclose(sum(groups), colour, **close)
    halves = frame["colour.half_a"] + frame["colour.half_b"]
    np.testing.assert_allclose(halves / 2, colour, **close)
    # Each part holds something, and no light is negative.
    for name in ("diffuse", "specular", "direct", "indirect", "emission"):
        assert frame[name].mean() > 1e-3, name
        assert frame[name].min() >= -1e-6, name
    assert (frame["emission"] <= frame["direct"] + 1e-5).all()


@pytest.mark.parametrize("medium", ["", "homogeneous", "heterogeneous"])
def test_beauty_agrees_with_mitsuba(medium):
    """Per-pixel z-test of two independent renders, 256 spp each.

    Hypotheses: 3 channels x 24 x 24 pixels; the statistic is the mean of z² over all of them, whose
    expectation is 1 where both estimate the same radiance. Its spread over the (heavy-tailed,
    correlated) channels is taken from the pixels themselves; significance 1e-4 (3.9 sigma).
    """
    scene = scenes.everything(mi, medium=medium)
    theirs = mi.load_dict({"type": "volpath" if medium else "path", "max_depth": 6})
    ours = FrameSampler(scene, features="none", depth=6).sample(256, seed=1)
    wrapped = FrameSampler(scene, features="none", depth=6, integrator=theirs).sample(256, seed=2)
    noise = ours.variance() + wrapped.variance()
    apart = ours.mean - wrapped.mean
    z = np.mean(apart / np.sqrt(noise + 1e-12), axis=2).ravel()
    # The mean of z over pixels is zero: a bias of one percent of the light would show.
    assert abs(z.mean()) < 3.9 * z.std() / np.sqrt(z.size), z.mean()
    # And no pixel is off by more than chance allows (Šidák over 576 pixels at 1e-4: 5.2 sigma).
    assert np.mean(np.abs(z) > 5.2) < 0.01
    total = apart.sum() / np.sqrt(noise.sum())
    assert abs(total) < 3.9, total


def test_mitsubas_own_film_agrees():
    """The film of `mi.render` (another code path for rays and sums) has the same mean."""
    scene = scenes.everything(mi)
    path = mi.load_dict({"type": "path", "max_depth": 6})
    image = np.stack(
        [np.array(mi.render(scene, integrator=path, spp=64, seed=s))[..., :3] for s in range(8)]
    )
    ours = FrameSampler(scene, features="none", depth=6).sample(512, seed=5)
    theirs, spread = image.mean(0), image.var(0, ddof=1) / 8
    total = (ours.mean - theirs).sum() / np.sqrt((ours.variance() + spread).sum())
    assert abs(total) < 3.9, total


def test_variance_is_the_spread_of_independent_renders():
    """64 renders of 16 spp: their spread against the mean of what each says of itself.

    Under the null each pixel's ratio has a relative error of about sqrt(2/63) (more for heavy
    tails), so that the ratio of sums over all pixels lies within 5 % with room to spare.
    """
    scene = scenes.everything(mi, size=16, lens=True)
    sampler = FrameSampler(scene, depth=5)
    runs = [sampler.sample(16, seed=s) for s in range(64)]
    spread = np.var([r.mean for r in runs], axis=0, ddof=1)
    told = np.mean([r.variance() for r in runs], axis=0)
    for group in runs[0].groups:
        at = runs[0].at(group.name)
        if told[..., at].max() < 1e-9:
            continue
        mine, true = told[..., at].ravel(), spread[..., at].ravel()
        # Trimmed: one firefly in 64 renders decides the sum of a heavy-tailed channel.
        keep = true <= np.quantile(true, 0.98)
        ratio = mine[keep].sum() / true[keep].sum()
        assert 0.85 < ratio < 1.25, (group.name, ratio)


def test_features_are_those_of_mitsubas_aov_on_the_first_hit():
    scene = scenes.everything(mi)
    frame = FrameSampler(scene, depth=4).sample(64, seed=1).frame()
    aov = mi.load_dict({"type": "aov", "aovs": "n:sh_normal,d:depth,p:position"})
    theirs = np.array(mi.render(scene, integrator=aov, spp=256, seed=9))
    depth = frame.extras["first_depth"].data[..., 0]
    hit = frame["alpha"][..., 0] > 0.999
    assert hit.sum() > 300
    inner = hit & (np.abs(depth - theirs[..., 3]) < 0.02 * depth)
    assert inner.sum() > 0.9 * hit.sum()
    normal = frame.extras["first_normal"].data
    assert np.median(np.abs(normal - theirs[..., :3])[hit]) < 0.02


def test_mirrors_and_glass_show_what_is_seen_in_them():
    """In the gold ball one sees the floor or the sky, never the ball: where the reflection hits
    the floor, roughness is the floor's, and albedo the floor's times gold's reflectance."""
    scene = scenes.everything(mi, size=48)
    frame = FrameSampler(scene, depth=6).sample(32, seed=1).frame()
    first = frame.extras["first_albedo"].data
    gold = (first[..., 0] > 0.9) & (first[..., 2] < 0.6) & (first[..., 1] > 0.6)
    assert gold.sum() > 40
    reflected_floor = gold & (frame["roughness"][..., 0] > 0.39)
    assert reflected_floor.sum() > 10
    # Albedo there is that of the floor times gold's reflectance: darker than the floor's.
    assert np.quantile(frame["albedo"][reflected_floor][:, 2], 0.9) < 0.3
    depth = frame["depth"][..., 0]
    assert (depth[reflected_floor] > frame.extras["first_depth"].data[reflected_floor, 0]).all()


def test_white_furnace():
    """In a closed white world every pixel is 1 / (1 - albedo) times the emission, with no noise."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "film": scenes.film(8)},
            "world": {
                "type": "sphere",
                "radius": 10,
                "flip_normals": True,
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}},
                "light": {"type": "area", "radiance": 1.0},
            },
        }
    )
    moments = FrameSampler(scene, depth=-1, rr_depth=1000).sample(64, seed=1)
    colour = moments.mean[..., :3]
    np.testing.assert_allclose(colour.mean(), 2.0, rtol=2e-2)


def test_the_same_seed_gives_the_same_samples_and_another_does_not():
    sampler = FrameSampler(scenes.everything(mi, size=8), depth=4)
    one, same, other = (sampler.sample(4, seed=s).mean for s in (7, 7, 8))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one[..., :3] - other[..., :3]).max() > 1e-3


def test_moments_add_up_to_one_render():
    sampler = FrameSampler(scenes.everything(mi, size=8), depth=4)
    parts = [sampler.sample(n, seed=n) for n in (3, 5, 8)]
    total = parts[0] + parts[1] + parts[2]
    assert total.spp == 16
    count = sum(p.spp * p.mean for p in parts) / 16
    np.testing.assert_allclose(total.mean, count, rtol=1e-4, atol=1e-4)
    # Spread about the common mean, by its definition.
    spread = sum(p.spread + p.spp * (p.mean - count) ** 2 for p in parts)
    np.testing.assert_allclose(total.spread, spread, rtol=2e-3, atol=1e-3)
    np.testing.assert_allclose(
        (total.half_a * total.half_count[..., None]
         + total.half_b * (total.count - total.half_count)[..., None]) / 16,
        total.mean[..., :3], rtol=1e-4, atol=1e-5,
    )  # fmt: skip


def test_samples_that_are_not_finite_are_left_out_and_counted():
    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "film": scenes.film(8)},
            "light": {"type": "constant", "radiance": 1.0},
            "wall": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0.5, 0, 2]).rotate([0, 1, 0], 180),
                "bsdf": {
                    "type": "diffuse",
                    "reflectance": {
                        "type": "bitmap",
                        "bitmap": mi.Bitmap(np.full((2, 2, 3), np.nan, np.float32)),
                        "raw": True,
                    },
                },
            },
        }
    )
    moments = FrameSampler(scene, depth=3).sample(4, seed=1)
    assert moments.dropped > 0
    assert moments.dropped == 4 * 64 - moments.count.sum()
    assert np.isfinite(moments.mean[..., :3]).all()
    frame = moments.frame()
    assert any("not finite" in note for note in frame.notes)


def test_a_wrapped_integrator_splits_no_light():
    scene = scenes.everything(mi, size=8)
    direct = mi.load_dict({"type": "direct"})
    sampler = FrameSampler(scene, integrator=direct)
    frame = sampler.sample(4, seed=1).frame()
    assert set(sampler.left_out) == {"diffuse", "specular", "direct", "indirect", "emission"}
    assert not frame.has(Role.DIFFUSE)
    assert frame.has(Role.ALBEDO, Stat.VARIANCE)
    assert frame.colour.mean() > 0.05


def test_wrong_wishes_are_refused():
    scene = scenes.everything(mi, size=8)
    with pytest.raises(OptionError, match="at least 1 sample"):
        FrameSampler(scene).sample(0)
    with pytest.raises(OptionError, match="depth"):
        FrameSampler(scene, depth=0)
    with pytest.raises(UnknownNameError, match="albedoo"):
        FrameSampler(scene, features="albedoo")
    with pytest.raises(UnknownNameError, match="emitter 'sun'"):
        FrameSampler(scene, light_groups={"key": ["sun"]})


def test_memory_and_kernel_do_not_depend_on_spp():
    """Another number of samples is data: no second kernel is compiled."""
    import drjit as dr

    sampler = FrameSampler(scenes.everything(mi, size=8), depth=3)
    sampler.sample(2, seed=1)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        sampler.sample(9, seed=2)
        history = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    assert history
    assert all(k["cache_hit"] for k in history)


def test_a_window_has_the_same_samples_alone_and_among_others():
    sampler = FrameSampler(scenes.everything(mi, size=16), depth=3)
    wanted = Request(3, 5, 6, 4, spp=5, seed=11)
    (alone,) = sampler.sample_windows([wanted])
    others = [Request(0, 0, 16, 16, 2, 7), Request(1, 1, 3, 3, 9, 5)]
    among = sampler.sample_windows([others[0], wanted, others[1]])
    np.testing.assert_array_equal(alone.mean, among[1].mean)
    np.testing.assert_array_equal(alone.spread, among[1].spread)
    assert [m.spp for m in among] == [2, 5, 9]
    assert [m.size for m in among] == [(16, 16), (6, 4), (3, 3)]
    # A window shows what the whole picture shows there, with noise of its own.
    whole = sampler.sample(256, seed=1)
    (part,) = sampler.sample_windows([Request(3, 5, 6, 4, spp=256, seed=2)])
    at = whole.at("first_depth")
    apart = np.abs(part.mean[..., at] - whole.mean[5:9, 3:9, at])
    assert np.median(apart) < 0.02
    elsewhere = np.abs(part.mean[..., at] - whole.mean[9:13, 8:14, at])
    assert np.median(elsewhere) > 0.2


def test_one_sample_tells_no_variance(tmp_path):
    """A variance of 0 would tell filters that there is no noise; and the picture can still grow."""
    from lambent.render.job import render

    scene = tmp_path / "ball.xml"
    scene.write_text(
        '<scene version="3.0.0"><sensor type="perspective"><transform name="to_world"><lookat '
        'origin="0,0,5" target="0,0,0" up="0,1,0"/></transform></sensor>'
        '<emitter type="constant"/><shape type="sphere"><bsdf type="diffuse"/></shape></scene>'
    )
    out = tmp_path / "one.exr"
    one = render(scene, out, spp=1, size=(16, 16))
    assert one.spp == 1
    assert not any(layer.stat is Stat.VARIANCE for layer in one.all_layers())
    assert not any(name.endswith("_variance") for name in one.extras)
    grown = render(scene, out, spp="+3", size=(16, 16), resume=True)
    at_once = render(scene, tmp_path / "four.exr", spp=4, size=(16, 16))
    assert grown.spp == 4
    spread = [float(f[Role.COLOUR, Stat.VARIANCE].mean()) for f in (grown, at_once)]
    assert 0.5 < spread[0] / spread[1] < 2
