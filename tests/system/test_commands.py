"""Every command on a real file: what is written, what is left alone, what scripts get."""

from __future__ import annotations

import json
import os
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import renders

from lambent.cli import main

FAST = ["--model", "oidn-fast"]


@pytest.fixture
def noisy(tmp_path: Path) -> Path:
    return renders.write(tmp_path / "noisy.exr", comments="kept")


def run(capsys, *args: object) -> str:
    """A command that must succeed; what it printed on stdout."""
    capsys.readouterr()
    assert main([str(a) for a in args]) == 0, capsys.readouterr().err
    return capsys.readouterr().out


def run_json(capsys, *args: object) -> dict:
    return json.loads(run(capsys, *args, "--json"))


# -------------------------------------------------------------------- denoise


def test_denoise_writes_beside_and_keeps_the_rest_bit_for_bit(noisy, capsys):
    text = run(capsys, "denoise", noisy, *FAST)
    output = noisy.with_name("noisy_clean.exr")
    assert text.splitlines()[0] == str(output)
    before, after = renders.read(noisy), renders.read(output)
    assert set(before) == set(after)
    for name in before:
        same = np.array_equal(before[name], after[name])
        assert same == (name not in "RGB"), name
    spread = {k: np.std(np.stack([v[n] for n in "RGB"])) for k, v in ((0, before), (1, after))}
    assert spread[1] < 0.6 * spread[0], "it is hardly less noisy"


def test_json_says_what_was_done(noisy, capsys):
    found = run_json(capsys, "denoise", noisy, *FAST)
    assert found["output"] == str(noisy.with_name("noisy_clean.exr"))
    assert found["layers"] == ["RGB"]
    assert found["model"] == "oidn-fast"
    assert {"read", "filter", "write", "total"} <= set(found["seconds"])
    assert found["peak_memory"] > 10_000_000


def test_dry_run_writes_nothing(noisy, capsys):
    before = sorted(noisy.parent.iterdir())
    found = run_json(capsys, "denoise", noisy, "--dry-run", *FAST)
    assert sorted(noisy.parent.iterdir()) == before
    view = found["views"][""]
    assert view["roles"]["albedo"] == "albedo"
    assert view["filtered"] == ["RGB"]
    assert "depth" in view["untouched"]
    assert "would be written" in run(capsys, "denoise", noisy, "--dry-run", *FAST)


def test_strength_zero_keeps_the_picture(noisy, capsys):
    run(capsys, "denoise", noisy, "--strength", 0, *FAST)
    before, after = renders.read(noisy), renders.read(noisy.with_name("noisy_clean.exr"))
    assert all(np.array_equal(before[n], after[n]) for n in before)


@pytest.mark.parametrize("strength", [0, 1])
def test_what_is_not_filtered_is_not_repaired_in_the_file(tmp_path, capsys, strength):
    """A NaN in the albedo is kept from the filter, and is still in the output."""
    arrays = renders.channels()
    arrays["albedo.G"][3, 4] = np.nan
    arrays["R"][5, 6] = np.nan
    path = renders.write(tmp_path / "noisy.exr", arrays)
    text = run(capsys, "denoise", path, "--strength", strength, *FAST)
    assert "'albedo': 1 NaN" in text
    after = renders.read(tmp_path / "noisy_clean.exr")
    assert after["albedo.G"].tobytes() == arrays["albedo.G"].tobytes()
    assert np.isfinite(after["R"]).all()


def test_map_gives_a_layer_a_role(tmp_path, capsys):
    arrays = renders.channels()
    path = renders.write(
        tmp_path / "odd.exr", {n.replace("albedo", "paintwork"): a for n, a in arrays.items()}
    )
    found = run_json(capsys, "denoise", path, "--map", "albedo=paintwork", "--dry-run", *FAST)
    assert found["views"][""]["roles"]["albedo"] == "paintwork"
    found = run_json(capsys, "denoise", path, "--albedo", "paintwork", "--dry-run", *FAST)
    assert found["views"][""]["roles"]["albedo"] == "paintwork"


def test_preview_and_report(noisy, capsys):
    from PIL import Image

    found = run_json(capsys, "denoise", noisy, "--preview", "--report", *FAST)
    with Image.open(found["preview"]) as picture:
        assert picture.size == (64 * 2 + 2, 48)
    page = Path(found["report"]).read_text()
    assert "<html" in page
    assert "noisy.exr" in page


def test_a_preview_that_exists_is_not_replaced(noisy, capsys):
    precious = noisy.with_name("noisy_clean_preview.png")
    precious.write_text("precious")
    assert main(["denoise", str(noisy), "--preview", *FAST]) == 2
    assert precious.read_text() == "precious"
    assert not noisy.with_name("noisy_clean.exr").exists()


def test_tiles_by_command_give_the_same_picture(tmp_path, capsys):
    path = renders.write(tmp_path / "large.exr", renders.channels(700, 900))
    run(capsys, "denoise", path, "-o", tmp_path / "whole.exr", *FAST)
    from lambent import memory
    from lambent.denoise.pipeline import RESERVE

    limit = int((memory.used() + 140_000_000) / (1 - RESERVE))
    text = run(capsys, "denoise", path, "-o", tmp_path / "tiled.exr", "--max-memory", limit, *FAST)
    assert "tiles" in text
    whole, tiled = renders.read(tmp_path / "whole.exr"), renders.read(tmp_path / "tiled.exr")
    np.testing.assert_allclose(tiled["R"], whole["R"], rtol=1e-4, atol=1e-5)


def test_alpha_stays_or_goes(tmp_path, capsys):
    arrays = renders.channels()
    rng = np.random.default_rng(1)
    arrays["A"] = rng.uniform(0.2, 0.8, arrays["R"].shape).astype(np.float32)
    path = renders.write(tmp_path / "fog.exr", arrays)
    run(capsys, "denoise", path, "-o", tmp_path / "kept.exr", "--no-alpha", *FAST)
    run(capsys, "denoise", path, "-o", tmp_path / "clean.exr", *FAST)
    np.testing.assert_array_equal(renders.read(tmp_path / "kept.exr")["A"], arrays["A"])
    assert renders.read(tmp_path / "clean.exr")["A"].std() < 0.5 * arrays["A"].std()


SHARED = [
    "arnold_multichannel_tiled.exr",
    "cycles_box_4096spp.exr",
    "gaffer_weird_part_names.exr",
    "mitsuba3_aov_cornell.exr",
    "nuke_multiview_singlepart.exr",
    "openexr_displaywindow_t08.exr",
    "openexr_mipmap_colorcodedlevels.exr",
    "openexr_nan_inf.exr",
    "vray_cornell_layers_cryptomatte.exr",
]


@pytest.mark.parametrize("name", SHARED)
def test_files_of_many_renderers(shared_data, tmp_path, capsys, name):
    """Denoised without a flag; whatever was not denoised comes back bit for bit."""
    from lambent.frame.exr import decode

    source, output = shared_data / "exr" / name, tmp_path / name
    found = run_json(capsys, "denoise", source, "-o", output, *FAST)
    before, after = decode(source), decode(output)
    assert [p.name for p in before.parts] == [p.name for p in after.parts]
    cleaned = {n.rpartition(".")[2] if n == "RGBA" else n for n in found["layers"]}
    kept = 0
    for old, new in zip(before.parts, after.parts, strict=True):
        assert old.data_window == new.data_window
        assert list(old.channels) == list(new.channels)
        for key, channel in old.channels.items():
            layer = key.rpartition(".")[0]
            touched = not layer or layer in cleaned or old.name in cleaned
            if touched or layer in ("left", "right"):
                continue
            assert channel.data.tobytes() == new.channels[key].data.tobytes(), key
            kept += 1
    if name.startswith(("arnold", "mitsuba", "vray")):
        assert kept > 3


# ------------------------------------------------------------------ sequences


@pytest.fixture
def shot(tmp_path: Path) -> Path:
    for number in (1, 2, 3):
        renders.write(tmp_path / f"shot.{number:04d}.exr", renders.channels(seed=number))
    return tmp_path / "shot.####.exr"


def test_sequence_skips_what_is_finished(shot, capsys):
    first = run_json(capsys, "denoise", shot, *FAST)
    assert (len(first["done"]), len(first["skipped"])) == (3, 0)
    second = run_json(capsys, "denoise", shot, *FAST)
    assert (len(second["done"]), len(second["skipped"])) == (0, 3)


def test_a_newer_input_is_done_again(shot, capsys):
    run(capsys, "denoise", shot, *FAST)
    later = time.time() + 10
    os.utime(shot.with_name("shot.0002.exr"), (later, later))
    again = run_json(capsys, "denoise", shot, *FAST)
    assert [Path(r["source"]).name for r in again["done"]] == ["shot.0002.exr"]


def test_other_settings_are_never_skipped_silently(shot, capsys):
    run(capsys, "denoise", shot, *FAST)
    assert main(["denoise", str(shot), *FAST, "--strength", "0.5"]) == 2
    assert "made with other settings" in capsys.readouterr().err
    done = run_json(capsys, "denoise", shot, *FAST, "--strength", "0.5", "--overwrite")
    assert len(done["done"]) == 3


def test_foreign_files_are_never_replaced_silently(shot, capsys):
    precious = shot.with_name("shot_clean.0002.exr")
    renders.write(precious)
    content = precious.read_bytes()
    assert main(["denoise", str(shot), *FAST]) == 2
    assert "not written by lambent" in capsys.readouterr().err
    assert precious.read_bytes() == content


def test_frames_are_the_same_alone_and_in_sequence(shot, capsys):
    run(capsys, "denoise", shot, *FAST)
    alone = shot.with_name("alone.exr")
    run(capsys, "denoise", shot.with_name("shot.0002.exr"), "-o", alone, *FAST)
    together = renders.read(shot.with_name("shot_clean.0002.exr"))
    np.testing.assert_array_equal(renders.read(alone)["R"], together["R"])


def test_a_directory_goes_into_a_directory(shot, capsys):
    done = run_json(capsys, "denoise", shot.parent, *FAST)
    outputs = [Path(r["output"]) for r in done["done"]]
    assert [p.name for p in outputs] == ["shot.0001.exr", "shot.0002.exr", "shot.0003.exr"]
    assert outputs[0].parent.name == shot.parent.name + "_clean"


def test_several_files_by_name(shot, capsys):
    files = sorted(shot.parent.glob("shot.000[12].exr"))
    done = run_json(capsys, "denoise", *files, *FAST)
    assert [Path(r["output"]).name for r in done["done"]] == [
        "shot.0001_clean.exr",
        "shot.0002_clean.exr",
    ]


def test_the_orbit_sequence(shared_data, tmp_path, capsys):
    folder = shared_data / "sequence" / "cornell-orbit"
    done = run_json(capsys, "denoise", folder / "noisy_##.exr", "-o", tmp_path / "c_##.exr", *FAST)
    assert len(done["done"]) == 8
    assert done["missing"] == []
    names = ["relmse"]
    reference = folder / "reference_03.exr"
    table = run_json(
        capsys,
        "compare",
        reference,
        folder / "noisy_03.exr",
        tmp_path / "c_03.exr",
        "--metrics",
        ",".join(names),
    )
    noisy, clean = (image["metrics"]["relmse"] for image in table["images"])
    assert clean < noisy / 5


# ------------------------------------------------------------- other commands


def test_inspect_names_roles_and_counts(tmp_path, capsys):
    arrays = renders.channels()
    arrays["R"][3, 4] = np.nan
    path = renders.write(tmp_path / "noisy.exr", arrays)
    found = run_json(capsys, "inspect", path)
    roles = {layer["role"]: layer for layer in found["layers"]}
    assert {"colour", "albedo", "normal", "depth"} <= set(roles)
    assert roles["colour"]["nan"] == 1
    text = run(capsys, "inspect", path)
    assert "! 1 NaN" in text


@pytest.mark.parametrize("columns", [80, 120])
def test_inspect_fits_the_terminal(noisy, capsys, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    lines = run(capsys, "inspect", noisy).splitlines()
    assert all(len(line) <= columns for line in lines if str(noisy) not in line)


def test_inspect_writes_a_page(noisy, capsys):
    found = run_json(capsys, "inspect", noisy, "--report")
    assert Path(found["report"]).name == "noisy_inspection.html"
    assert "albedo" in Path(found["report"]).read_text()


@pytest.mark.parametrize("columns", [60, 80, 120])
def test_compare_prints_a_table_that_fits(noisy, capsys, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    run(capsys, "denoise", noisy, "--overwrite", *FAST)
    text = run(capsys, "compare", noisy, noisy.with_name("noisy_clean.exr"), noisy)
    lines = text.splitlines()
    assert all(len(line) <= columns for line in lines if str(noisy) not in line)
    assert "relMSE" in text
    assert "*" in text


def test_compare_writes_a_page_once(noisy, capsys):
    page = noisy.with_name("page.html")
    run(capsys, "compare", noisy, noisy, "--report", page)
    assert "<html" in page.read_text()
    assert main(["compare", str(noisy), str(noisy), "--report", str(page)]) == 2


def test_compare_refuses_other_sizes(noisy, tmp_path, capsys):
    small = renders.write(tmp_path / "small.exr", renders.channels(10, 10))
    assert main(["compare", str(noisy), str(small)]) == 3
    assert "small.exr" in capsys.readouterr().err


def test_explain_prints_and_draws(noisy, capsys):
    picture = noisy.with_name("weights.png")
    found = run_json(capsys, "explain", noisy, "--pixel", "20,30", "--model", "box", "-o", picture)
    assert found["sum"] == pytest.approx(1, abs=1e-4)
    assert found["effective_pixels"] * found["variance_reduction"] == pytest.approx(1)
    assert picture.read_bytes().startswith(b"\x89PNG")
    text = run(capsys, "explain", noisy, "--pixel", "20,30", "--model", "box")
    assert "sum of weights" in text
    assert "beside it" not in text


def test_explain_sets_a_learned_kernel_beside_classical_ones(noisy, capsys):
    picture = noisy.with_name("beside.png")
    found = run_json(capsys, "explain", noisy, "--pixel", "20,30", "--model", "kpcn", "-o", picture)
    assert found["sum"] == pytest.approx(1, abs=1e-4)
    names = [one["model"] for one in found["beside"]]
    assert names == ["gaussian", "cross-bilateral", "nlm", "joint-nlm"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    text = run(capsys, "explain", noisy, "--pixel", "20,30", "--model", "kpcn", "--beside", "box")
    assert "beside it:\n  box" in text
    found = run_json(
        capsys, "explain", noisy, "--pixel", "20,30", "--model", "kpcn", "--beside", "none"
    )
    assert "beside" not in found


@pytest.mark.parametrize("pixel", ["20", "a,b", "900,1", "-1,3"])
def test_explain_refuses_pixels_that_are_none(noisy, capsys, pixel):
    assert main(["explain", str(noisy), f"--pixel={pixel}", "--model", "box"]) == 4
    assert capsys.readouterr().err.startswith("error: ")


@pytest.mark.parametrize("command", [["denoise"], ["explain", "--pixel", "1,2"]])
def test_a_wrong_option_is_told_before_a_missing_file(command, tmp_path, capsys):
    missing = str(tmp_path / "no.exr")
    assert main([*command, missing, "--model", "nforr"]) == 4
    assert "did you mean nfor" in capsys.readouterr().err
    assert main([*command, missing, "--model", "nlm", "--set", "radios=3"]) == 4
    assert "radius" in capsys.readouterr().err


def test_doctor_is_well_here(capsys):
    found = run_json(capsys, "doctor", "--no-speed")
    names = [check["name"] for check in found["checks"]]
    assert found["healthy"]
    for name in ("lambent", "packages", "processor", "memory", "disk", "LLVM", "OIDN", "OpenVINO"):
        assert name in names
    text = run(capsys, "doctor", "--no-speed")
    remedies = [check["remedy"] for check in found["checks"] if check["remedy"]]
    assert all(remedy in text for remedy in remedies)
    assert ("All is well" in text) == (not remedies)


def test_doctor_reports_what_is_broken_with_the_remedy(capsys, monkeypatch):
    monkeypatch.setattr("lambent.startup.has_llvm", lambda: False)
    assert main(["doctor", "--no-speed"]) == 5
    text = capsys.readouterr().out
    assert "BROKEN" in text
    assert "pip install karellen-llvm-core" in text


def test_doctor_says_when_the_machine_is_slow(monkeypatch):
    from lambent.cli import doctor

    monkeypatch.setattr(doctor, "_best_time", lambda model, deadline: 60.0)
    check = doctor._oidn_speed(0.0)
    assert check.state == "note"
    assert check.remedy


def test_a_gap_in_a_sequence_ends_with_the_code_of_a_missing_file(tmp_path, capsys):
    for number in (1, 3):
        renders.write(tmp_path / f"shot.{number:04d}.exr")
    pattern = str(tmp_path / "shot.####.exr")
    assert main(["denoise", pattern, "-o", str(tmp_path / "out"), *FAST]) == 2
    assert "1 missing" in capsys.readouterr().err


def test_dataset_alone_prints_its_help(capsys):
    text = run(capsys, "dataset")
    assert "Commands:" in text
    assert "verify" in text


def test_a_denoised_file_is_recognised_and_its_statistics_are_not_used(tmp_path, capsys):
    arrays = renders.channels()
    for name in ("variance", "half_a", "half_b"):
        arrays |= {f"colour.{name}.{c}": arrays[c] for c in "RGB"}
    noisy = renders.write(tmp_path / "noisy.exr", arrays)
    assert run_json(capsys, "denoise", noisy, *FAST)["notes"] == []
    clean = tmp_path / "noisy_clean.exr"
    (note,) = run_json(capsys, "inspect", clean)["notes"]
    assert "denoised by Lambent before (model oidn-fast)" in note
    roles = {layer["name"]: layer["role"] for layer in run_json(capsys, "inspect", clean)["layers"]}
    assert roles["colour.half_a"] == roles["colour.variance"] == "other"
    assert note in run_json(capsys, "denoise", clean, *FAST)["notes"]
    code = main(["denoise", str(clean), "--model", "nfor", "-o", str(tmp_path / "again.exr")])
    assert code == 3, "the half buffers of the noisy picture were taken"


def test_an_archive_of_lambent_is_named_as_one(tmp_path, capsys):
    archive = tmp_path / "room.lambent"
    with zipfile.ZipFile(archive, "w") as made:
        made.writestr("card.json", "{}")
    for command in ("denoise", "inspect"):
        assert main([command, str(archive)]) == 2
        text = capsys.readouterr().err
        assert "is a solution or a model of Lambent, not a picture" in text
        assert "room_clean" not in text
    picture = renders.write(tmp_path / "room.exr")
    assert main(["view", str(picture)]) == 2
    assert "is not a Lambent solution, but an OpenEXR image" in capsys.readouterr().err
    assert main(["view", str(tmp_path / "nope.lambent")]) == 2
    assert "check the path" in capsys.readouterr().err


def test_inspect_takes_one_file_and_says_so(noisy, capsys):
    assert main(["inspect", str(noisy.with_name("shot.####.exr"))]) == 4
    assert "inspect takes one file" in capsys.readouterr().err


def test_the_noisy_original_is_not_offered_for_replacement(noisy, capsys):
    assert main(["denoise", str(noisy), "-o", str(noisy)]) == 2
    text = capsys.readouterr().err
    assert "the output is the input itself" in text
    assert "--overwrite" not in text


def test_parameters_need_a_model_that_has_them(noisy, capsys):
    assert main(["denoise", str(noisy), "--set", "radius=5"]) == 4
    assert "name the model that has it" in capsys.readouterr().err
    assert main(["denoise", str(noisy), "--model", "nlm", "--set", "radus=5"]) == 4
    assert "'nlm' has no parameter 'radus'" in capsys.readouterr().err


def test_a_missing_half_buffer_is_called_one(noisy, capsys):
    assert main(["denoise", str(noisy), "--model", "nfor"]) == 3
    assert "first half buffer of the beauty" in capsys.readouterr().err


def test_the_page_of_a_comparison_stands_beside_the_first_image(capsys):
    assert "beside the first image" in " ".join(run(capsys, "compare", "--help").split())


def test_an_output_that_is_there_names_both_ways_to_replace_it(noisy):
    import lambent

    with pytest.raises(lambent.LambentError, match=r"--overwrite \(in Python: overwrite=True\)"):
        lambent.write(noisy, lambent.read(noisy))
