"""lambent train: what it prints, refuses and leaves behind."""

import json
import os
import subprocess
import sys

import pytest

from lambent.cli import main


def run(capsys, *args):
    code = main([str(a) for a in args])
    out = capsys.readouterr()
    return code, out.out, out.err


def test_without_anything_it_asks_for_a_recipe(capsys):
    code, _, err = run(capsys, "train")
    assert code == 4
    assert "a recipe is missing" in err


def test_a_recipe_without_data(capsys, tmp_path):
    recipe = tmp_path / "r.toml"
    recipe.write_text('name = "x"\n')
    code, _, err = run(capsys, "train", recipe)
    assert code == 4
    assert "names no data" in err


def test_an_unknown_task(capsys, tmp_path):
    recipe = tmp_path / "r.toml"
    recipe.write_text('name = "x"\ntask = "denoize"\n')
    code, _, err = run(capsys, "train", recipe)
    assert code == 4
    assert "did you mean denoise" in err


def test_fine_tuning_needs_an_output(capsys, tmp_path):
    code, _, err = run(capsys, "train", "--data", tmp_path / "a.exr")
    assert code == 4
    assert "-o" in err


def test_an_existing_output_is_kept(capsys, tmp_path):
    old = tmp_path / "old.lambent"
    old.write_text("precious")
    code, _, err = run(capsys, "train", "--data", tmp_path / "a.exr", "-o", old)
    assert code == 2
    assert "exists already" in err
    assert old.read_text() == "precious"


@pytest.mark.slow
def test_two_processes_make_the_data_and_write_the_model_once(tmp_path):
    data = tmp_path / "data.toml"
    data.write_text(
        'name = "tiny"\nseed = 3\ncount = 6\nitems_per_scene = 2\ncameras_per_scene = 1\n'
        "view = [160, 96]\ncrop = 64\nlevels = 2\nspp = [1, 4]\ntarget_spp = 16\n"
        "target_most = 16\nmean_spp = 2\n"
    )
    recipe = tmp_path / "r.toml"
    recipe.write_text(
        'name = "tiny"\nsize = "fast"\ndata = ["data.toml"]\nsteps = 2\nbatch = 2\nwarmup = 1\n'
        "held_out = 0.0\nseed = 1\ncheck_every = 2\nchecked = 4\n"
    )
    model = tmp_path / "mine.lambent"
    done = subprocess.run(
        [
            sys.executable, "-m", "torch.distributed.run", "--nproc-per-node=2",
            "--master-port=0", "--rdzv-backend=c10d", "--rdzv-endpoint=localhost:0",
            "-m", "lambent", "train", str(recipe), "-o", str(model), "--device", "cpu",
        ],
        env={**os.environ, "OMP_NUM_THREADS": "1", "LAMBENT_CACHE": str(tmp_path / "cache")},
        capture_output=True, text=True, timeout=500,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.count(f"wrote {model}") == 1
    assert model.exists()


def test_a_whole_run(capsys, tmp_path, monkeypatch):
    """From a data set to a page and a model that the next command uses."""
    monkeypatch.setenv("LAMBENT_CACHE", str(tmp_path / "cache"))
    data = tmp_path / "data.toml"
    data.write_text(
        'name = "tiny"\nseed = 3\ncount = 6\nitems_per_scene = 2\ncameras_per_scene = 1\n'
        "view = [160, 96]\ncrop = 64\nlevels = 2\nspp = [1, 4]\ntarget_spp = 16\n"
        "target_most = 16\nmean_spp = 2\n"
    )
    code, _, err = run(capsys, "dataset", "make", data, "-o", tmp_path / "data")
    assert code == 0, err
    recipe = tmp_path / "r.toml"
    recipe.write_text(
        'name = "tiny"\nsize = "fast"\ndata = ["data"]\nsteps = 3\nbatch = 2\nwarmup = 1\n'
        "held_out = 0.0\nseed = 1\ncheck_every = 2\nchecked = 4\n"
    )
    page, model = tmp_path / "page.html", tmp_path / "mine.lambent"
    code, out, err = run(
        capsys, "train", recipe, "--threads", 1, "--report", page, "-o", model, "--json"
    )
    assert code == 0, err
    told = json.loads(out)
    assert told["best"]["check"]["score"] > 0
    assert "validation" in page.read_text().lower()
    frame = next((tmp_path / "data" / "crops").rglob("*.exr"))
    code, out, err = run(
        capsys, "denoise", frame, "-o", tmp_path / "clean.exr", "--model", "lambent",
        "--set", f"weights={model}",
    )  # fmt: skip
    assert code == 0, err
    assert (tmp_path / "clean.exr").exists()
