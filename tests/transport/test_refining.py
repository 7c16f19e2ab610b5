"""Where patches are cut, and what a gathered view takes from them."""

from dataclasses import replace

import boxes
import drjit as dr
import numpy as np
import pytest
from boxes import mi

import lambent
from lambent.render.sampling import FrameSampler
from lambent.transport.radiosity import adaptive
from lambent.transport.radiosity.light import arriving, met_by_ray
from lambent.transport.radiosity.patches import cluster, uniform
from lambent.transport.scene import load_for_light
from lambent.transport.surfaces import surfaces_of
from lambent.transport.warps import cosine_hemisphere


def fine_floor(tmp_path, cells=40):
    """A square of edge 2 as a mesh of small triangles, facing up."""
    line = np.linspace(-1, 1, cells + 1)
    x, z = np.meshgrid(line, line, indexing="ij")
    corner = np.arange((cells + 1) ** 2).reshape(cells + 1, -1)
    a, b, c, d = (corner[i : cells + i, j : cells + j].ravel() for i in (0, 1) for j in (0, 1))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([c, b, d], 1)])
    mesh = mi.Mesh("floor", (cells + 1) ** 2, len(faces))
    params = mi.traverse(mesh)
    points = np.stack([x, np.full_like(x, -0.99), z], axis=2)
    params["vertex_positions"] = points.astype(np.float32).ravel()
    params["faces"] = faces.astype(np.uint32).ravel()
    params.update()
    path = tmp_path / "floor.ply"
    mesh.write_ply(str(path))
    return {"type": "ply", "filename": str(path), "bsdf": boxes.grey(0.7)}


def under_a_roof():
    """A floor in one piece under a far lamp, with a roof over its middle: a sharp shadow."""
    return {
        "type": "scene",
        "floor": {"type": "rectangle", "bsdf": boxes.grey(0.5)},
        "roof": {
            "type": "rectangle",
            "to_world": boxes.T().translate([0, 0, 0.05]).scale(0.5),
            "bsdf": {"type": "twosided", "bsdf": boxes.grey(0.5)},
        },
        "lamp": {"type": "directional", "direction": [0, 0, -1], "irradiance": 2.0},
        "sensor": boxes.camera(),
    }


def both_ways(scene, p, n, count):
    """Irradiance at a point ``(count, 3)``: by emitters alone, and by emitters and rays."""
    rng = mi.PCG32(count, 7)
    at = dr.zeros(mi.Interaction3f, count)
    at.p, at.n = mi.Point3f(p), mi.Normal3f(n)
    u = mi.Point2f(rng.next_float32(), rng.next_float32())
    alone = arriving(scene, at, u)
    local = cosine_hemisphere(rng.next_float32(), rng.next_float32())
    ray = at.spawn_ray(mi.Frame3f(at.n).to_world(local))
    met = scene.ray_intersect(ray)
    both = arriving(scene, at, u, beside_ray=True) + met_by_ray(scene, at, met, local.z)
    return np.array(alone).T, np.array(both).T


def test_emitters_and_rays_together_give_the_light_of_emitters():
    sky = {"type": "scene", "sky": {"type": "constant", "radiance": 3.0}}
    for scene, p, n in (
        (mi.load_dict(sky), [0, 0, 0], [0, 0, 1]),
        (mi.load_dict(boxes.room()), [0.1, -1, 0.2], [0, 1, 0]),
        (mi.load_dict(boxes.room()), [0.1, 0.85, 0.2], [0, 1, 0]),  # a hand below the lamp
        (mi.load_dict(under_a_roof()), [0.8, 0, 0], [0, 0, 1]),
        (mi.load_dict({**sky, **under_a_roof()}), [0, 0, 0], [0, 0, 1]),  # points cannot be met
    ):
        alone, both = both_ways(scene, p, n, 200_000)
        sure = np.sqrt((alone.var(0) + both.var(0)) / len(both))
        assert (np.abs(alone.mean(0) - both.mean(0)) <= 4 * sure + 1e-5).all()
        assert both.mean() > 0
    open_sky = both_ways(mi.load_dict(sky), [0, 0, 0], [0, 0, 1], 100_000)[1]
    assert open_sky.mean() == pytest.approx(3 * np.pi, rel=0.01)


def test_a_gathered_view_takes_only_indirect_light_from_the_solution():
    scene = mi.load_dict(boxes.room())
    loaded = load_for_light(scene)
    found = lambent.solve(scene, patches=60, rays=512, samples=128)
    view = found.view(scene=loaded, show="gather", spp=32, features="none").colour
    blind = replace(found, direct=np.zeros_like(found.direct))
    np.testing.assert_array_equal(
        blind.view(scene=loaded, show="gather", spp=32, features="none").colour, view
    )
    half = replace(found, indirect=found.indirect / 2)
    assert half.view(scene=loaded, show="gather", spp=32, features="none").colour.mean() < (
        0.97 * view.mean()
    )
    # so that patches of a third of a wall are enough for it
    path = mi.load_dict({"type": "lambent_diffuse"})
    truth = FrameSampler(scene, 0, features="none", integrator=path).sample(2048, 3).frame().colour
    size = truth.mean(2) ** 2 + 0.01 * truth.mean() ** 2
    error = {
        show: np.mean(
            ((found.view(scene=loaded, show=show, spp=spp).colour - truth) ** 2).mean(2) / size
        )
        for show, spp in (("smooth", 64), ("gather", 2048))
    }
    assert error["gather"] < 3e-3
    assert error["smooth"] > 20 * error["gather"]


def test_hidden_finds_the_shadow_within_a_patch():
    scene = load_for_light(under_a_roof()).scene
    patches = cluster(uniform(surfaces_of(scene), 10.0))
    assert len(patches) == 4  # two triangles each
    found = adaptive.hidden(scene, patches, np.ones(8, bool), 256)
    floor = 2 * np.flatnonzero(patches.area > 1.9)
    # each triangle of the floor has half of the shadow: one quarter none, one on half of its area
    dark = np.array([0, 0.25, 0.25, 0.5])
    both = np.array([sorted(q) for q in _dark_shares(scene, patches)])
    np.testing.assert_allclose(both, np.tile(dark, (2, 1)), atol=0.03)
    np.testing.assert_allclose(found[floor], 4 * dark.var(), rtol=0.05)
    assert found[floor + 1].max() == 0  # nothing reaches the other side
    none = adaptive.hidden(scene, patches, np.zeros(8, bool), 4)
    assert np.abs(none).max() == 0


def _dark_shares(scene, patches):
    """Which part of each quarter of the floor's triangles lies below the roof."""
    rng = np.random.default_rng(1)
    for patch in np.flatnonzero(patches.area > 1.9):
        leaf = patches.leaf[patches.start[patch]]
        parts = patches.cells.split(np.array([leaf]))
        shares = []
        for part in range(parts.child[leaf], parts.child[leaf] + 4):
            u = rng.random((4000, 2))
            u = np.where((u.sum(1) > 1)[:, None], 1 - u, u)
            c = parts.corner[part].astype(float)
            ab = c[0] + u[:, :1] * (c[1] - c[0]) + u[:, 1:] * (c[2] - c[0])
            p, _ = parts.surfaces.points(np.full(4000, parts.prim[part]), ab)
            shares.append((np.abs(p[:, :2]).max(axis=1) < 0.5).mean())
        yield shares


def test_noise_is_not_taken_for_a_shadow():
    # the lamp of the room is large: few samples of it differ much
    loaded = load_for_light(boxes.room())
    patches = cluster(uniform(surfaces_of(loaded.scene), 0.1))
    live = np.ones(2 * len(patches), bool)
    area = np.repeat(patches.area, 2)
    rough, fine = (
        np.average(adaptive.hidden(loaded.scene, patches, live, n), weights=area) for n in (8, 512)
    )
    assert rough == pytest.approx(fine, rel=0.3)


def test_halved_cubes_lie_in_whole_ones(tmp_path):
    surfaces = surfaces_of(mi.load_dict({"type": "scene", "floor": fine_floor(tmp_path)}))
    cells = uniform(surfaces, 0.5)
    whole = cluster(cells, 0.5)
    none = cluster(cells, 0.5, None, np.zeros(len(cells.child), np.int8))
    np.testing.assert_array_equal(none.cell_patch, whole.cell_patch)
    assert len(whole) < 40
    halved = np.zeros(len(cells.child), np.int8)
    marked = whole.leaf[whole.start[3] : whole.start[4]]
    halved[marked] = 1
    found = cluster(cells, 0.5, None, halved)
    assert len(whole) + 2 < len(found) < len(whole) + 6
    assert found.area.sum() == pytest.approx(whole.area.sum())
    # all that shared a patch and were not marked share one still, the others lie in what was one
    rest = np.setdiff1d(whole.leaf, marked)
    pairs = np.unique(np.stack([whole.cell_patch[rest], found.cell_patch[rest]]), axis=1)
    assert pairs.shape[1] == len(whole) - 1
    assert not set(found.cell_patch[marked]) & set(found.cell_patch[rest])
    halved[marked] = adaptive.MOST_HALVED
    single = cluster(cells, 0.5, None, halved)
    assert len(single) == len(whole) - 1 + len(marked)


def test_what_is_made_of_small_triangles_is_refined_by_smaller_groups(tmp_path):
    surfaces = surfaces_of(mi.load_dict({"type": "scene", "floor": fine_floor(tmp_path)}))
    cells = uniform(surfaces, 0.5)
    patches = cluster(cells, 0.5)
    share = np.zeros(len(patches))
    share[[2, 5]] = 1
    new, halved = adaptive.refined(patches, share, 6, np.zeros(len(cells.child), np.int8))
    assert len(new.child) == len(cells.child)  # no triangle was cut
    assert set(patches.cell_patch[np.flatnonzero(halved)]) == {2, 5}
    assert len(patches) + 3 < len(cluster(new, 0.5, None, halved)) <= len(patches) + 12
    # large ones are cut in four
    flat = surfaces_of(mi.load_dict(boxes.walls()))
    large = cluster(uniform(flat, 1.5))
    new, halved = adaptive.refined(
        large, np.arange(len(large)) + 1.0, 3, np.zeros(len(large.cells.child), np.int8)
    )
    assert len(cluster(new)) == len(large) + 3
    assert len(halved) == len(new.child)
    assert halved.max() == 0


def test_many_leaves_count_as_one_of_their_size(tmp_path):
    # the same gradient on a mesh, whose triangles share patches, and on a square cut to as many
    found = []
    for floor in (fine_floor(tmp_path), {"type": "rectangle"}):
        surfaces = surfaces_of(mi.load_dict({"type": "scene", "floor": floor}))
        patches = cluster(uniform(surfaces, 0.5), 0.5)
        prim, ab = patches.cells.prim[patches.leaf], patches.cells.corner[patches.leaf]
        x = surfaces.points(prim, ab.astype(float).mean(axis=1))[0][:, 0]
        middle = np.add.reduceat(x * patches.leaf_area, patches.start[:-1]) / patches.area
        radiosity = np.repeat(2 + middle, 2)[:, None] * np.ones(3)
        share = adaptive.shares(
            patches, radiosity, np.ones(len(radiosity)), np.zeros(len(radiosity))
        )
        inner = np.abs(middle) < 0.6
        # steps grow with the length of a patch, their squares with its area
        found.append(share[inner].sum() / (patches.area[inner] ** 2).sum())
    assert 0.6 < found[0] / found[1] < 1.6
    # what is hidden within counts where corners see nothing
    flat = np.ones((2 * len(patches), 3))
    live = np.ones(len(flat))
    assert adaptive.shares(patches, flat, live, np.zeros(len(flat))).max() < 1e-12
    variance = np.zeros(len(flat))
    variance[6] = 0.1
    share = adaptive.shares(patches, flat, live, variance)
    assert share.argmax() == 3
    assert np.count_nonzero(share > 1e-12) == 1
    assert share[3] == pytest.approx(patches.area[3] * adaptive.GRADIENT * 0.1 / 1.1**2)


def test_adaptive_cuts_help_on_meshes_of_small_triangles(tmp_path):
    above = boxes.T().look_at([0, 1, 2.2], [0, -1, 0.2], [0, 1, 0])
    scene = mi.load_dict(
        {
            "type": "scene",
            "floor": fine_floor(tmp_path, 96),
            "roof": {
                "type": "rectangle",
                "to_world": boxes.T().translate([0, -0.5, 0]).rotate([1, 0, 0], 90).scale(0.35),
                "bsdf": {"type": "twosided", "bsdf": boxes.grey(0.5)},
            },
            "sun": {"type": "directional", "direction": [0.2, -1, 0.1], "irradiance": 5.0},
            "sky": {"type": "constant", "radiance": 0.3},
            "sensor": {**boxes.camera(48), "to_world": above, "fov": 50},
        }
    )
    loaded = load_for_light(scene)
    path = mi.load_dict({"type": "lambent_diffuse"})
    truth = FrameSampler(scene, 0, features="none", integrator=path).sample(1024, 3).frame().colour
    size = truth.mean(2) ** 2 + 0.01 * truth.mean() ** 2

    def error(**settings):
        found = lambent.solve(scene, rays=128, samples=256, **settings)
        view = found.view(scene=loaded, spp=64, features="none").colour
        return (((view - truth) ** 2).mean(2) / size).mean(), len(found)

    plain, count = error(patches=300)
    cut, fewer = error(patches=count, adaptive=True)
    assert cut < 0.3 * plain
    assert fewer < 1.1 * count
