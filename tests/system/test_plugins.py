"""A scene from a stranger brings no native code along: plug-ins come from Mitsuba's package alone.

The plug-in is real: a shared object whose constructor writes a file, so that loading it shows.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

if importlib.util.find_spec("mitsuba") is None:  # importing it here would come before LLVM
    pytest.skip("needs the extra 'render'", allow_module_level=True)

SOURCE = """
#include <fcntl.h>
#include <stdlib.h>
__attribute__((constructor)) static void begin(void) {
    const char *mark = getenv("LAMBENT_TEST_MARK");
    if (mark) creat(mark, 0600);
}
void init_plugin(void) {}
"""
SCENE = """<scene version="3.0.0">{extra}
<sensor type="perspective"><transform name="to_world">
  <lookat origin="0,1,6" target="0,0.5,0" up="0,1,0"/></transform>
  <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/>
  <rfilter type="box"/></film></sensor>
<emitter type="constant"/>
<shape type="sphere"><bsdf type="{bsdf}"/></shape>
</scene>"""


@pytest.fixture(scope="module")
def foreign(tmp_path_factory) -> Path:
    """A shared object."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a C compiler")
    folder = tmp_path_factory.mktemp("foreign")
    (folder / "foreign.c").write_text(SOURCE)
    made = folder / "foreign.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", made, folder / "foreign.c"], check=True)
    return made


class Place:
    """A folder with a scene, a working folder beside it, and the mark."""

    def __init__(self, root: Path, foreign: Path) -> None:
        self.root, self.foreign, self.mark = root, foreign, root / "mark"
        self.scene, self.here = root / "scene" / "it.xml", root / "here"
        self.scene.parent.mkdir()
        self.here.mkdir()

    def write(self, bsdf: str, extra: str = "") -> None:
        self.scene.write_text(SCENE.format(bsdf=bsdf, extra=extra))

    def put(self, folder: Path, name: str) -> Path:
        target = folder / "plugins" / f"{name}.so"
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(self.foreign, target)
        return target

    def run(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "lambent", *map(str, arguments)],
            capture_output=True, text=True, cwd=self.here, check=False,
            env={**os.environ, "LAMBENT_TEST_MARK": str(self.mark)},
        )  # fmt: skip

    def refused(self, name: str, *arguments: object) -> str:
        done = self.run(*arguments)
        assert not self.mark.exists(), "the plug-in was loaded"
        assert done.returncode == 2, done.stderr
        assert f"the plug-in '{name}'" in done.stderr
        assert "Traceback" not in done.stderr
        return done.stderr


@pytest.fixture
def place(tmp_path, foreign) -> Place:
    return Place(tmp_path, foreign)


def test_the_test_would_show_it(place):
    """Mitsuba itself does load what lies beside a scene."""
    place.write("evil")
    place.put(place.scene.parent, "evil")
    code = (
        "from lambent.startup import has_llvm; has_llvm(); import mitsuba as mi\n"
        f"mi.set_variant('llvm_ad_rgb'); mi.load_file({str(place.scene)!r})"
    )
    subprocess.run(
        [sys.executable, "-c", code], cwd=place.here, capture_output=True, check=False,
        env={**os.environ, "LAMBENT_TEST_MARK": str(place.mark)},
    )  # fmt: skip
    assert place.mark.exists()


@pytest.mark.parametrize("name", ["evil", "diffuse", "../outside", "EVIL", "evil.so"])
def test_beside_the_scene(place, name):
    place.write(name)
    target = place.put(place.scene.parent, name.removesuffix(".so"))
    said = place.refused(name, "render", place.scene, "--spp", 1, "-o", "out.exr")
    assert "evil.so" in said or target.name in said
    assert "--allow-plugins" in said
    assert not (place.here / "out.exr").exists()


@pytest.mark.parametrize("name", ["evil", "diffuse"])
def test_in_the_current_folder(place, name):
    place.write(name)
    place.put(place.here, name)
    place.refused(name, "render", place.scene, "--spp", 1, "-o", "out.exr")


def test_in_a_path_of_the_scene(place):
    place.write("evil", '<path value="../elsewhere"/>')
    target = place.put(place.root / "elsewhere", "evil")
    said = place.refused("evil", "render", place.scene, "--spp", 1, "-o", "out.exr")
    assert str(target.parent.resolve()) in said.replace("scene/../", "")


def test_in_an_included_file_by_a_parameter(place):
    """The name is known only once the parser has put files and parameters together."""
    place.write("diffuse", '<default name="kind" value="ev"/><include filename="sub/part.xml"/>')
    (place.scene.parent / "sub").mkdir()
    (place.scene.parent / "sub" / "part.xml").write_text(
        '<scene version="3.0.0"><shape type="sphere"><bsdf type="${kind}il"/></shape></scene>'
        .replace("${kind}", "$kind")
        .replace("$kindil", "$kind")
    )  # fmt: skip
    place.put(place.scene.parent, "ev")
    place.refused("ev", "render", place.scene, "--spp", 1, "-o", "out.exr")
    done = place.run("render", place.scene, "--spp", 1, "-o", "out.exr", "-D", "kind=diffuse")
    assert done.returncode == 0, done.stderr
    assert not place.mark.exists()


def test_as_the_integrator(place):
    place.write("diffuse")
    place.put(place.here, "evil")
    done = place.run("render", place.scene, "--integrator", "evil", "--spp", 1, "-o", "out.exr")
    assert not place.mark.exists()
    assert done.returncode == 4, done.stderr
    assert "no integrator 'evil'" in done.stderr


def test_solving_and_looking(place):
    """`solve` refuses; so does `view` where a sound solution's scene has become another."""
    place.write("evil")
    place.put(place.scene.parent, "evil")
    solution = place.root / "it.lambent"
    place.refused("evil", "solve", place.scene, "-o", solution, "--patches", 20)
    place.write("diffuse")
    done = place.run("solve", place.scene, "-o", solution, "--patches", 20, "--rays", 16)
    assert done.returncode == 0, done.stderr
    place.write("evil")
    place.refused("evil", "view", solution, "-o", "view.png")
    place.put(place.scene.parent, "diffuse")
    place.write("diffuse")
    place.refused("diffuse", "view", solution, "-o", "view.png")


def test_data_sets(place):
    place.write("evil")
    place.put(place.scene.parent, "evil")
    recipe = place.root / "recipe.toml"
    recipe.write_text(
        f'name = "x"\nseed = 1\nsource = "scenes"\nscenes = ["{place.scene}"]\ncount = 1\n'
        "view = [32, 32]\ncrop = 32\n"
    )
    for options in ([], ["--processes", "2"]):
        done = place.run("dataset", "make", recipe, "-o", place.root / "set", *options)
        assert not place.mark.exists()
        assert done.returncode == 1, done.stderr
        assert "the plug-in 'evil'" in done.stdout


def test_what_is_allowed_is_loaded(place):
    """A plug-in that works: Mitsuba's own rough plastic under another name, or that of another."""
    import lambent

    own = Path(importlib.util.find_spec("mitsuba").origin).parent / "plugins"
    trusted = place.root / "trusted"
    trusted.mkdir()
    shutil.copy(own / "roughplastic.so", trusted / "mine.so")
    renders = {}
    for name in ("mine", "roughplastic"):
        place.write(name)
        done = place.run(
            "render", place.scene, "--spp", 4, "-o", f"{name}.exr", "--allow-plugins", trusted
        )
        assert done.returncode == 0, done.stderr
        renders[name] = lambent.read(place.here / f"{name}.exr").colour
    assert (renders["mine"] == renders["roughplastic"]).all()
    # in the place of Mitsuba's own
    shutil.move(trusted / "mine.so", trusted / "diffuse.so")
    place.write("diffuse")
    done = place.run(
        "render", place.scene, "--spp", 4, "-o", "diffuse.exr", "--allow-plugins", trusted
    )
    assert done.returncode == 0, done.stderr
    assert (lambent.read(place.here / "diffuse.exr").colour == renders["mine"]).all()


def test_what_is_allowed_must_be_a_plugin(place):
    place.write("diffuse")
    render = ("render", place.scene, "--spp", 1, "-o", "out.exr", "--allow-plugins")
    done = place.run(*render, place.root / "nowhere")
    assert done.returncode == 2
    assert "holds no plug-ins" in done.stderr
    (place.here / "plugins").mkdir()
    (place.here / "plugins" / "text.so").write_text("no shared object")
    done = place.run(*render, place.here)
    assert done.returncode == 5, done.stderr
    assert "text.so' cannot be loaded" in done.stderr


def test_what_python_has_registered_may_be_named(place):
    """In the library: dictionaries, too, and a plug-in that refuses to be made without values."""
    place.write('known" id="skin')
    place.put(place.here, "evil")
    code = f"""
import lambent
from lambent.render.variant import mitsuba
mi = mitsuba("cpu")
class Known(mi.BSDF):
    def __init__(self, props):
        if not props.id(): raise ValueError("no name")
        super().__init__(props)
        self.m_components = [mi.BSDFFlags.Null]
        self.m_flags = mi.BSDFFlags.Null
    def to_string(self): return "Known"
mi.register_bsdf("known", Known)
from lambent.errors import DamagedFileError
from lambent.render.scene import load
load({str(place.scene)!r})
def scene(kind):
    ball = {{"type": "sphere", "bsdf": {{"type": kind, "id": "skin"}}}}
    return {{"type": "scene", "ball": ball, "sky": {{"type": "constant"}},
             "camera": {{"type": "perspective"}}}}
load(scene("known"))
for kind in ("evil", "unheard-of"):
    try:
        load(scene(kind))
    except DamagedFileError as error:
        print(error.message)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=place.here, capture_output=True, text=True, check=False,
        env={**os.environ, "LAMBENT_TEST_MARK": str(place.mark)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert not place.mark.exists()
    assert "the plug-in 'evil', which Mitsuba would load from" in done.stdout
    assert "the plug-in 'unheard-of', which Mitsuba does not have" in done.stdout
