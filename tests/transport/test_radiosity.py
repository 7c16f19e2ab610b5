"""Radiosity: what must hold exactly, and agreement with path tracing."""

import boxes
import numpy as np
import pytest
from boxes import mi

import lambent
from lambent.errors import DamagedFileError, FileError, OptionError, UnknownNameError
from lambent.render.sampling import FrameSampler
from lambent.transport.radiosity.solvers import SOLVERS
from lambent.transport.scene import load_for_light
from lambent.transport.surfaces import surfaces_of


def solved(scene, **settings):
    return lambent.solve(scene, **{"patches": 300, "rays": 128, "samples": 64, **settings})


@pytest.mark.parametrize("factors", ["rays", "pairs"])
def test_a_white_furnace_is_white(factors):
    # every wall emits what it does not reflect: the radiosity is 1 everywhere
    rho = 0.7
    scene = boxes.walls(rho, radiance=(1 - rho) / np.pi)
    found = solved(scene, direct="factors", factors=factors, tolerance=1e-9)
    inner = found.radiosity[found.live]
    assert len(inner) > 100
    np.testing.assert_allclose(inner, 1, atol=1e-6)


def test_rows_sum_to_one_and_are_reciprocal():
    from lambent.transport.radiosity.balance import balanced, symmetric
    from lambent.transport.radiosity.casting import cast
    from lambent.transport.radiosity.patches import cluster, uniform
    from lambent.transport.radiosity.probe import Probe

    scene = load_for_light(boxes.room()).scene
    patches = cluster(uniform(surfaces_of(scene), 0.4), 0.4)
    fronts = 2 * np.arange(len(patches))
    alive = np.zeros(2 * len(patches), bool)
    alive[fronts] = True
    found = cast(scene, patches, Probe.of(patches), fronts, alive, 128)
    shares = found.shares[:, fronts]
    seen = np.asarray(shares.sum(axis=1)).ravel()
    factors, off = balanced(symmetric(shares, patches.area), patches.area, seen, 128)
    assert off < 1e-6
    sums = np.asarray(factors.sum(axis=1)).ravel()
    assert (seen == 1).sum() > 10
    np.testing.assert_allclose(sums[seen == 1], 1, atol=1e-6)
    assert np.abs(sums - seen).mean() < 0.01  # the black back of the lamp is what is missing
    g = factors.multiply(patches.area[:, None]).tocsr()
    assert abs(g - g.T).max() < 1e-9


@pytest.mark.parametrize("size", [20, 400, 2000])
def test_a_ground_that_misses_a_box_lights_it_all_the_same(size):
    scene = {
        "type": "scene",
        "ground": {"type": "rectangle", "to_world": boxes.T().scale(size), "bsdf": boxes.grey(0.5)},
        "box": {
            "type": "cube",
            "to_world": boxes.T().translate([0, 0, 1.5]),
            "bsdf": boxes.grey(0.5),
        },
        "sky": {"type": "constant"},
        "sensor": boxes.camera(),
    }
    found = solved(scene, patches=60, rays=256)
    small = np.repeat(np.sqrt(found.patches_on(surfaces_of(load_for_light(scene).scene)).area), 2)
    sides = found.indirect[(small < 3) & found.live].mean(axis=1)
    # a side of the box sees the ground with half of its sky, its floor with all but itself
    assert sides.max() > 0.8 * np.pi / 2
    other = solved(scene, patches=60, rays=256, solver="matrix-free")
    mean = other.indirect[(small < 3) & other.live].mean()
    assert sides.mean() == pytest.approx(mean, rel=0.1)
    assert found.error > 0


def test_mirrored_shapes_and_windings_against_normals(tmp_path):
    for name, change in (
        ("wall", {"type": "rectangle", "to_world": boxes.T().scale([-0.7, 0.7, 1])}),
        ("disk", {"type": "disk", "to_world": boxes.T().scale([-0.7, 0.7, 0.7])}),
        ("cube", {"type": "cube", "to_world": boxes.T().scale([-0.3, 0.3, 0.3])}),
        ("ball", {"type": "sphere", "to_world": boxes.T().scale([-0.4, 0.4, 0.4])}),
    ):
        for wrap in (False, True):
            material = boxes.grey(0.6)
            if wrap:
                material = {"type": "twosided", "bsdf": material}
            scene = mi.load_dict({**boxes.room(), "block": {**change, "bsdf": material}})
            loaded = load_for_light(scene)
            found = solved(scene, patches=1500)
            view = found.view(scene=loaded, show="gather", spp=256, features="none").colour
            path = mi.load_dict({"type": "lambent_diffuse"})
            truth = FrameSampler(scene, 0, features="none", integrator=path)
            reference = truth.sample(256, 3).frame().colour.mean(2)
            lit = reference > 1e-3
            ratio = view.mean(2)[lit] / reference[lit]
            assert np.median(ratio) == pytest.approx(1, abs=0.03), (name, wrap)
            assert (ratio < 0.25).mean() < 0.05, (name, wrap)
            assert view.mean(2)[~lit].max(initial=0) < 0.01, (name, wrap)


def test_the_texture_of_a_disk_is_where_it_is():
    image = np.zeros((64, 64, 3), np.float32)
    image[:16] = 0.9
    scene = boxes.room()
    scene["block"] = {
        "type": "disk",
        "to_world": boxes.T().scale(0.5),
        "bsdf": {
            "type": "diffuse",
            "reflectance": {"type": "bitmap", "bitmap": mi.Bitmap(image), "raw": True},
        },
    }
    found = solved(scene, patches=500)
    surfaces = surfaces_of(load_for_light(scene).scene)
    patches = found.patches_on(surfaces)
    round_ = surfaces.kind[patches.cells.prim[patches.leaf[patches.start[:-1]]]] == 2
    mean = np.average(found.reflectance[0::2][round_].mean(axis=1), weights=patches.area[round_])
    assert mean == pytest.approx(0.225, abs=0.02)


def test_all_solvers_agree():
    scene = boxes.room()
    first = solved(scene, solver="direct")
    for solver in SOLVERS:
        if solver == "matrix-free":
            continue
        found = solved(scene, solver=solver, tolerance=1e-8)
        np.testing.assert_allclose(found.indirect, first.indirect, atol=2e-6 * first.indirect.max())
        assert found.history.residuals[-1] <= 1e-8 or solver == "direct"


def test_without_a_matrix_it_is_nearly_the_same():
    scene = boxes.room()
    one, other = solved(scene), solved(scene, solver="matrix-free")
    a, b = one.indirect[one.live], other.indirect[one.live]
    assert np.abs(a - b).mean() < 0.03 * a.mean()
    assert a.mean() == pytest.approx(b.mean(), rel=0.01)


def test_pairs_and_rays_give_the_same_light():
    scene = boxes.room()
    one = solved(scene, rays=2048)
    other = solved(scene, factors="pairs")
    a, b = one.indirect[one.live], other.indirect[one.live]
    assert np.abs(a - b).mean() < 0.02 * a.mean()


@pytest.mark.parametrize("show", ["smooth", "gather"])
def test_views_agree_with_path_tracing(show):
    scene = mi.load_dict(boxes.room())
    loaded = load_for_light(scene)
    found = solved(scene, patches=6000, samples=256)
    spp = {"smooth": 64, "gather": 2048}[show]
    view = found.view(scene=loaded, show=show, spp=spp, features="none").colour
    path = mi.load_dict({"type": "lambent_diffuse"})
    truth = FrameSampler(scene, 0, features="none", integrator=path).sample(2048, 3).frame().colour
    size = truth.mean(2) ** 2 + 0.01 * truth.mean() ** 2
    error = ((view - truth) ** 2).mean(2) / size
    # the edges of the lamp and of shadows are what patches cannot show
    limit = {"smooth": 2e-3, "gather": 1e-3}[show]
    assert np.sort(error.ravel())[: int(0.99 * error.size)].mean() < limit
    assert view.mean() == pytest.approx(truth.mean(), rel=0.01)


def test_refinement_lowers_the_error_and_adaptive_more():
    scene = mi.load_dict(boxes.room())
    loaded = load_for_light(scene)
    path = mi.load_dict({"type": "lambent_diffuse"})
    truth = FrameSampler(scene, 0, features="none", integrator=path).sample(1024, 3).frame().colour
    size = truth.mean(2) ** 2 + 0.01 * truth.mean() ** 2

    def error(**settings):
        found = solved(scene, samples=256, **settings)
        view = found.view(scene=loaded, spp=64, features="none").colour
        return (((view - truth) ** 2).mean(2) / size).mean(), len(found)

    coarse, _ = error(patches=300)
    fine, count = error(patches=5000)
    cut, fewer = error(patches=count // 2, adaptive=True)
    assert fine < 0.5 * coarse
    assert cut < coarse
    assert fewer < count


def test_energy_is_conserved():
    # in a closed room without anything black, what arrives is absorbed in the end
    scene = boxes.walls(0.6, radiance=[1, 2, 3])
    power = solved(scene).balance(surfaces_of(load_for_light(scene).scene))
    assert power["absorbed"] == pytest.approx(power["direct"], rel=1e-5)
    power = solved(scene, direct="factors").balance(surfaces_of(load_for_light(scene).scene))
    assert power["emitted"] == pytest.approx(power["direct"], rel=1e-5)
    # a black lamp in it takes its part
    room = boxes.room()
    power = solved(room).balance(surfaces_of(load_for_light(room).scene))
    assert 0.01 < power["escaped"] / power["direct"] < 0.06


def test_a_solution_comes_back_from_its_file(tmp_path):
    scene = boxes.room()
    path = tmp_path / "room.lambent"
    found = solved(scene, output=path)
    again = lambent.open_solution(path)
    for name in ("direct", "indirect", "reflectance", "emission", "live", "child"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))
    assert again.history.residuals == pytest.approx(found.history.residuals)
    frame = again.view(scene=scene, spp=4)
    assert frame.colour.mean() > 0
    assert {"albedo", "normal", "depth"} <= {key[0].value for key in frame.layers}


def test_the_plug_in_shows_a_solution_in_any_script(tmp_path):
    path = tmp_path / "room.lambent"
    found = solved(boxes.room(), output=path)
    scene = mi.load_dict(boxes.room())
    integrator = mi.load_dict({"type": "lambent_radiosity", "solution": str(path)})
    image = np.array(mi.render(scene, integrator=integrator, spp=16, seed=1))
    view = found.view(scene=scene, spp=16, features="none").colour
    ratio = image[:, :, :3].mean(2) / view.mean(2)  # other samples at edges, above all the lamp's
    assert np.median(ratio) == pytest.approx(1, abs=0.002)
    assert (np.abs(ratio - 1) < 0.05).mean() > 0.8
    with pytest.raises(Exception, match="kind of view"):
        mi.load_dict({"type": "lambent_radiosity", "solution": str(path), "show": "magic"})


def test_resuming_begins_where_it_ended(tmp_path):
    scene, path = boxes.room(), tmp_path / "room.lambent"
    rough = solved(scene, output=path, solver="jacobi", steps=2)
    finer = solved(scene, output=path, resume=True, solver="jacobi", tolerance=1e-7)
    whole = solved(scene, solver="jacobi", tolerance=1e-7)
    assert len(finer.history.steps) < len(whole.history.steps)
    assert rough.history.residuals[-1] > finer.history.residuals[-1]
    np.testing.assert_allclose(finer.indirect, whole.indirect, atol=1e-5)


def test_an_interrupt_keeps_what_is_there():
    def stop(solution):
        raise KeyboardInterrupt

    found = solved(boxes.room(), solver="jacobi", watch=stop)
    assert found.interrupted
    assert found.indirect.max() > 0


def test_a_file_of_another_scene_or_a_damaged_one_is_refused(tmp_path):
    path = tmp_path / "room.lambent"
    solved(boxes.room(), output=path)
    other = boxes.room()
    other["block"]["to_world"] = boxes.T().translate([0.3, -0.4, 0]).scale(0.25)
    with pytest.raises(FileError, match="another scene"):
        lambent.open_solution(path).view(scene=other)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    broken = tmp_path / "broken.lambent"
    broken.write_bytes(content)
    with pytest.raises(DamagedFileError):
        lambent.open_solution(broken)
    broken.write_bytes(content[:100])
    with pytest.raises(DamagedFileError):
        lambent.open_solution(broken)
    broken.write_text("no archive")
    with pytest.raises(FileError, match="not a Lambent solution"):
        lambent.open_solution(broken)
    with pytest.raises(FileError, match="no such file"):
        lambent.open_solution(tmp_path / "nowhere.lambent")


def test_a_model_is_no_solution():
    from lambent.denoise.model_file import shipped

    with pytest.raises(FileError, match="a model, not a solution"):
        lambent.open_solution(next(iter(shipped().values())))


def test_sides_and_flipped_normals():
    # the same room with the wall's normal turned away: black if one-sided, the same if two-sided
    scene = boxes.room()
    plain = solved(scene).reflected.sum()
    turned = boxes.room()
    turned["back"]["flip_normals"] = True
    assert solved(turned).reflected.sum() < 0.95 * plain
    turned["back"]["bsdf"] = {"type": "twosided", "bsdf": turned["back"]["bsdf"]}
    assert solved(turned).reflected.sum() == pytest.approx(plain, rel=0.02)


def test_an_environment_alone_lights_a_floor():
    scene = {
        "type": "scene",
        "floor": {"type": "rectangle", "bsdf": boxes.grey(0.5)},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1, 2, 3]}},
        "sensor": boxes.camera(),
    }
    found = solved(scene, patches=64)
    front = found.direct[0::2]
    np.testing.assert_allclose(front.mean(axis=0), np.pi * np.array([1, 2, 3]), rtol=0.01)
    assert front.std(axis=0)[0] < 0.05 * np.pi


def test_albedo_of_one_ends():
    scene = boxes.room()
    scene["floor"]["bsdf"] = boxes.grey(1.0)
    found = solved(scene)
    assert found.reflectance.max() <= 0.99 + 1e-6
    assert found.history.residuals[-1] < 1e-6


def test_the_stated_error_is_the_error():
    scene = boxes.room()
    truth = solved(scene, rays=8192)
    for rays in (32, 512):
        found = solved(scene, rays=rays)
        live = found.live
        apart = found.indirect[live] - truth.indirect[live]
        real = np.sqrt((apart**2).mean() / (truth.indirect[live] ** 2).mean())
        # balancing makes the solution a little better than its rays
        assert 0.4 * real < found.error < 2.5 * real
    assert solved(scene, factors="pairs").error is None


def test_triangles_without_an_area_and_coincident_faces(tmp_path):
    mesh = mi.Mesh("flat", 5, 3)
    params = mi.traverse(mesh)
    params["vertex_positions"] = np.array(
        [[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1], [0, 0, -1]], np.float32
    ).ravel()
    params["faces"] = np.array([[0, 2, 1], [0, 3, 2], [0, 4, 1]], np.uint32).ravel()
    params.update()
    path = tmp_path / "flat.ply"
    mesh.write_ply(str(path))
    scene = boxes.room()
    for name in ("one", "other"):  # the same twice, at the same place
        scene[name] = {
            "type": "ply",
            "filename": str(path),
            "to_world": boxes.T().translate([0, -0.97, 0]),
            "bsdf": {"type": "twosided", "bsdf": boxes.grey(0.5)},
        }
    found = solved(scene)
    assert any("without an area" in note for note in found.notes)
    assert np.isfinite(found.radiosity).all()
    assert np.isfinite(found.view(scene=scene, spp=4).colour).all()


def test_curved_shapes_and_textures():
    scene = boxes.room()
    scene["ball"] = {"type": "sphere", "center": [-0.5, -0.6, 0], "radius": 0.25,
                     "bsdf": boxes.grey(0.6)}  # fmt: skip
    scene["tube"] = {"type": "cylinder", "p0": [0.5, -0.9, 0], "p1": [0.5, -0.2, 0], "radius": 0.1,
                     "bsdf": {"type": "twosided", "bsdf": boxes.grey(0.6)}}  # fmt: skip
    scene["floor"]["bsdf"] = {
        "type": "diffuse",
        "reflectance": {
            "type": "checkerboard",
            "color0": {"type": "rgb", "value": 0.1},
            "color1": {"type": "rgb", "value": 0.7},
        },
    }
    found = solved(scene, patches=500)
    view = found.view(scene=scene, spp=16)
    assert np.isfinite(view.colour).all()
    assert view.colour.min() >= 0
    # the mean of the checkerboard where patches are as large as its fields or larger
    assert found.reflectance[found.live].max() <= 0.7 + 1e-4


def test_materials_that_are_not_diffuse_are_named():
    scene = boxes.room()
    scene["block"]["bsdf"] = {"type": "roughconductor", "material": "Au"}
    found = solved(scene)
    assert any("RoughConductor (1)" in note for note in found.notes)
    assert not solved(boxes.room()).notes


def test_bump_and_normal_maps_that_are_left_out_are_named():
    scene = boxes.room()
    heights = {"type": "bitmap", "bitmap": mi.Bitmap(np.eye(4, dtype=np.float32)), "raw": True}
    bumps = {"type": "bumpmap", "heights": heights, "bsdf": boxes.grey(0.5)}
    scene["block"]["bsdf"] = {"type": "twosided", "bsdf": bumps}
    found = solved(scene)
    assert list(found.notes) == ["bump and normal maps are left out, their surfaces flat: 1 shapes"]
    flat = boxes.room()
    flat["block"]["bsdf"] = {"type": "twosided", "bsdf": boxes.grey(0.5)}
    np.testing.assert_allclose(found.radiosity, solved(flat).radiosity, rtol=1e-5, atol=1e-7)


def test_instances_are_unfolded(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(
        """<scene version="3.0.0">
        <sensor type="perspective"><transform name="to_world">
          <lookat origin="1,4,8" target="1,0,0" up="0,1,0"/></transform></sensor>
        <shape type="shapegroup" id="g"><shape type="cube"><transform name="to_world">
          <scale value="0.5"/></transform></shape></shape>
        <shape type="instance"><ref id="g"/><transform name="to_world"><translate x="2"/>
          </transform></shape>
        <shape type="instance"><ref id="g"/></shape>
        <emitter type="constant"/></scene>"""
    )
    shapes = load_for_light(path).scene.shapes()
    assert sorted(float(s.bbox().min.x) for s in shapes) == pytest.approx([-0.5, 1.5])
    found = lambent.solve(path, patches=200, rays=64)
    assert found.view(size=(32, 32), spp=4).colour.mean() > 0


def test_wishes_that_cannot_be():
    with pytest.raises(UnknownNameError, match="magic"):
        solved(boxes.room(), solver="magic")
    with pytest.raises(UnknownNameError, match="method"):
        lambent.solve(boxes.room(), method="magic")
    with pytest.raises(OptionError, match="no setting"):
        solved(boxes.room(), colour=3)
    with pytest.raises(OptionError, match="patches"):
        solved(boxes.room(), patches=0)
    curved = {**boxes.room(), "ball": {"type": "sphere", "radius": 0.2}}
    with pytest.raises(OptionError, match="one triangle each"):
        solved(curved, factors="pairs")


def test_the_direct_solver_says_what_it_would_take(monkeypatch):
    from lambent.transport.radiosity import solvers

    monkeypatch.setattr(solvers, "available", lambda: 1000)
    with pytest.raises(OptionError, match="GiB"):
        solved(boxes.room(), solver="direct")


def test_scenes_without_light_or_surface_are_refused():
    dark = boxes.room()
    del dark["lamp"]
    with pytest.raises(OptionError, match="no emitter"):
        solved(dark)
    away = {
        "type": "scene",
        "floor": {"type": "rectangle", "flip_normals": True},
        "lamp": {"type": "point", "position": [0, 0, 3]},
        "sensor": boxes.camera(),
    }
    with pytest.raises(OptionError, match="no light reaches"):
        solved(away)
    empty = {"type": "scene", "sky": {"type": "constant"}, "sensor": boxes.camera()}
    with pytest.raises(OptionError, match="no surface"):
        solved(empty)


def test_light_through_factors_leaves_points_out_and_says_so():
    scene = {**boxes.room(), "point": {"type": "point", "position": [0, 0.5, 0]}}
    seen = []
    found = solved(scene, direct="factors", adaptive=True, watch=seen.append)
    assert sum("PointLight" in note for note in found.notes) == 1
    assert found.error is not None
    assert seen

    def stop(solution):
        raise KeyboardInterrupt

    assert solved(scene, direct="factors", solver="jacobi", watch=stop).interrupted
