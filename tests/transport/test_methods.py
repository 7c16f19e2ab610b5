"""The registry of methods: what every entry has, and how a new one joins without other changes."""

import json
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from boxes import mi

import lambent
from lambent.cli import main
from lambent.errors import FileError, OptionError, UnknownNameError
from lambent.settings import check_settings, setting, settings_of
from lambent.transport.methods import METHODS, Method
from lambent.transport.solution import Solution, card_fields, open_solution

SCENE = """<scene version="3.0.0">
<sensor type="perspective"><transform name="to_world">
  <lookat origin="0,0,3" target="0,0,0" up="0,1,0"/></transform>
  <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/>
    <rfilter type="box"/></film></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="9"/></transform></shape>
<emitter type="constant"/>
</scene>
"""


# a method of one number: the same light everywhere
@dataclass(frozen=True)
class Wish:
    radiance: float = setting(1.0, "Of all surfaces.", low=0, high=100, metavar="X")
    rounds: int = setting(2, "How often it is halved.", low=1, high=9, resumed="anew")

    def __post_init__(self):
        check_settings(self)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Constant(Solution):
    method: ClassVar[str] = "constant"
    radiance: float
    steps: int = 0

    def packed(self):
        return {"radiance": self.radiance, "steps": self.steps}, {}

    def facts(self):
        return {"radiance": f"{self.radiance:g}", **super().facts()}

    def residuals(self):
        return [(k + 1, 0.5**k) for k in range(self.steps)]

    def tables(self, scene):
        return {"Shapes": ("number", {"in the scene": len(scene.shapes())})}


class ConstantView(mi.SamplingIntegrator):
    def __init__(self, props):
        super().__init__(props)

    def prepare(self, scene):
        pass

    def update(self, solution):
        self.radiance = solution.radiance

    def sample(self, scene, sampler, ray, medium=None, active=True):
        hit = scene.ray_intersect(mi.Ray3f(ray), active).is_valid()
        return mi.Color3f(self.radiance * self.factor), hit, []


def solve_constant(loaded, settings, start, progress, watch):
    made = None
    for steps in range(1 + settings.rounds):
        made = Constant(
            radiance=settings.radiance,
            steps=steps + (start.steps if start else 0),
            scene=str(loaded.path),
            scene_digest=loaded.digest,
            settings=vars(settings),
            notes=("it is a toy",),
            seconds={"nothing": 0.25},
        )
        if watch is not None:
            watch(made)
    return made


def view_constant(solution, show):
    view = ConstantView(mi.Properties())
    view.factor = {"plain": 1.0, "half": 0.5}[show]
    view.update(solution)
    return view


def load_constant(archive):
    card = archive.card
    return Constant(radiance=card["radiance"], steps=card["steps"], **card_fields(archive))


CONSTANT = Method(
    name="constant",
    title="the same light everywhere",
    paper="none",
    shows={"plain": "the light", "half": "half of it"},
    page=("half",),
    settings=Wish,
    solve=solve_constant,
    load=load_constant,
    view=view_constant,
)


@pytest.fixture
def constant(monkeypatch):
    monkeypatch.setitem(METHODS._own, "constant", "")
    monkeypatch.setitem(METHODS._loaded, "constant", CONSTANT)


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "room.xml"
    path.write_text(SCENE)
    return path


def test_a_new_method_is_solved_saved_viewed_and_reported(constant, scene, tmp_path, capsys):
    path = tmp_path / "room.lambent"
    options = ["--method", "constant", "-o", str(path)]
    assert main(["solve", str(scene), *options, "--radiance", "3", "--report"]) == 0
    printed = capsys.readouterr().out
    for words in ("radiance 3", "nothing 0.2 s", "it is a toy", f"lambent view {path}"):
        assert words in printed
    page = path.with_suffix(".html").read_text()
    for words in (
        "room.xml, solved", "Radiance", "it is a toy", "How it grew", "step 2",
        "half: half of it", "Shapes", "in the scene", "Residual",
    ):  # fmt: skip
        assert words in page, words

    found = lambent.open_solution(path)
    assert isinstance(found, Constant)
    assert (found.radiance, found.steps, found.seconds) == (3, 2, {"nothing": 0.25})
    assert repr(found) == f"<Constant of {scene}: radiance 3>"
    assert "<th>radiance</th>" in found._repr_html_()
    np.testing.assert_allclose(found.view(spp=1, features="none").colour, 3)

    out = tmp_path / "view.exr"
    assert main(["view", str(path), "-o", str(out), "--show", "half", "--spp", "2"]) == 0
    frame = lambent.read(out)
    np.testing.assert_allclose(frame.colour, 1.5)
    assert {"albedo", "normal"} <= {key[0].value for key in frame.layers}

    capsys.readouterr()
    assert main(["solve", str(scene), *options, "--resume", "--rounds", "3", "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert (numbers["method"], numbers["steps"], numbers["residual"]) == ("constant", 5, 0.5**4)
    assert lambent.open_solution(path).radiance == 3  # kept


def test_wishes_that_a_method_does_not_know(constant, scene, tmp_path, capsys):
    path, new = tmp_path / "room.lambent", tmp_path / "new.lambent"
    lambent.solve(scene, "constant", output=path)
    for args, words in (
        (("solve", scene, "-o", path, "--resume", "--radiance", 2), "radiance (1.0 there, 2.0"),
        (
            ("solve", scene, "-o", new, "--method", "constant", "--patches", 9),
            "constant has no setting patch",
        ),
        (("solve", scene, "-o", new, "--radiance", 9), "radiosity has no setting radiance"),
        (("solve", scene, "-o", new, "--method", "constant", "--radiance", 900), "from 0 to 100"),
        (("solve", scene, "-o", new, "--method", "magic"), "no method 'magic'"),
        (("view", path, "-o", tmp_path / "a.png", "--show", "mesh"), "Known: half, plain"),
        (("view", path, "-o", tmp_path / "a.exr", "--lightmap"), "by constant has no lightmap"),
        (("view", path, "-o", tmp_path / "a.glb"), "by constant has no mesh"),
    ):
        assert (main([str(a) for a in args]), words in capsys.readouterr().err) == (4, True), args
    with pytest.raises(FileError, match="by constant, not by radiosity"):
        open_solution(path, "radiosity")


@pytest.mark.parametrize("name", METHODS)
def test_every_method_is_complete(name):
    method = METHODS[name]
    assert method.name == name
    assert method.title
    assert method.paper
    assert set(method.page) < set(method.shows)
    method.settings()  # the defaults are sound
    for key, (_, about) in settings_of(method.settings).items():
        assert about.help.endswith("."), key
        assert about.option in ("", f"--{key}") or not hasattr(method.settings, about.option[2:])


def test_settings_are_checked():
    for values, error, words in (
        ({"rounds": 0}, OptionError, "from 1 to 9"),
        ({"radiance": float("nan")}, OptionError, "out of range"),
    ):
        with pytest.raises(error, match=words):
            Wish(**values)
    with pytest.raises(UnknownNameError, match="no solver 'magic'"):
        METHODS["radiosity"].settings(solver="magic")
