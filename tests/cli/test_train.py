"""lambent train: what it prints, refuses and leaves behind."""

import json
import os
import subprocess
import sys
import types
from pathlib import Path

import pytest

from lambent.cli import main, train
from lambent.training.run import Run


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


def test_fine_tuning_writes_beside_the_first_frame_and_replaces_nothing(capsys, tmp_path):
    (tmp_path / "a_tuned.lambent").write_text("precious")
    code, _, err = run(capsys, "train", "--data", tmp_path / "a.exr")
    assert code == 2
    assert "a_tuned.lambent" in err
    assert "exists already" in err


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


def test_the_first_recipe_is_small_and_learns(capsys, tmp_path, monkeypatch):
    """Fewer crops and steps than a person takes; the error is far below the input's."""
    monkeypatch.setenv("LAMBENT_CACHE", str(tmp_path / "cache"))
    recipes = Path(__file__).resolve().parents[2] / "recipes"
    data = tmp_path / "first.toml"
    data.write_text((recipes / "first.toml").read_text().replace("count = 64", "count = 16"))
    recipe = tmp_path / "train" / "first.toml"
    recipe.parent.mkdir()
    text = (recipes / "train" / "first.toml").read_text()
    for old, new in (("steps = 300", "steps = 40"), ("check_every = 30", "check_every = 20")):
        assert old in text
        text = text.replace(old, new)
    recipe.write_text(text)
    pages = []
    written = train._Watch.write_page
    monkeypatch.setattr(
        train._Watch,
        "write_page",
        lambda self, running=True: (written(self, running), pages.append(self.page.read_text())),
    )
    code, out, err = run(capsys, "train", recipe, "--threads", 1, "--report", "--json")
    assert code == 0, err
    result = json.loads(out)
    assert result["best"]["check"]["relmse/noisy"] < 0.5
    assert result["report"].endswith("/runs/first/report.html")
    assert "1 of 40" in pages[0]  # from the first step
    assert "Loss" in pages[0]
    assert "40 of 40" in pages[-1]


def test_the_progress_line_has_the_newest_loss_and_score(tmp_path):
    log = tmp_path / "log.jsonl"
    log.write_text(
        '{"step": 1, "loss": 0.5}\n{"step": 30, "check": {"score": 1.25}}\n'
        '{"step": 50, "loss": 0.125}\n'
    )
    shown = []
    place = types.SimpleNamespace(report=lambda *state: shown.append(state))
    watch = train._Watch(Run(tmp_path), None, None, place)
    watch.report(51, 300, "training x, step 51 of 300")
    assert shown == [(51, 300, "training x, step 51 of 300, loss 0.1250, score 1.250")]
