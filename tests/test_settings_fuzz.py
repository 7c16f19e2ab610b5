"""Files that people and programs write for Lambent: whatever is in them, the error is ours."""

from __future__ import annotations

import copy
import json
import os
import random
from pathlib import Path
from typing import Any

import pytest

from lambent.dataset.folder import MANIFEST, read_lines, read_manifest, recipe_of
from lambent.dataset.recipe import load_recipe
from lambent.errors import FileError, LambentError, OptionError
from lambent.render.animation import read_keyframes

KEYFRAMES = {
    "frames": [1, 48],
    "camera": {
        "at": [1, 24, 48],
        "origin": [[0, 1, 5], [2, 1, 4], [3, 1, 2]],
        "target": [[0, 1, 0]],
        "up": [0, 1, 0],
        "fov": [45, 45, 35],
        "interpolation": "linear",
    },
    "object": [
        {
            "shape": "ball*",
            "at": [1, 48],
            "translate": [[0, 0, 0], [1, 0, 0]],
            "axis": [0, 1, 0],
            "angle": [0, 180],
            "pivot": [0, 0, 0],
            "scale": 2,
        }
    ],
}
RECIPE = {
    "name": "small", "seed": 1, "source": "procedural", "count": 8, "clip_count": 0,
    "mean_spp": 4.0, "target_spp": 16, "target_error": 0.25,
}  # fmt: skip
ODD: list[Any] = [
    None, True, False, 0, -1, 1, 2, 10**9, -(10**9), 10**30, 1e308, float("inf"), float("-inf"),
    float("nan"), 0.5, "", "x", "\x1b[31m", "../../x", [], [[]], [[[1]]], {}, {"a": 1}, [1, "x"],
    ["a"], [0, 0, 0], [1, 1000000000], [2, 1], [float("nan")] * 3, [1] * 4, [[1, 2, 3]] * 5,
]  # fmt: skip


def as_toml(value: Any, table: bool = True) -> str:
    """A value as TOML, whatever it is (None has no form there)."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        items = [(json.dumps(k), v) for k, v in value.items() if v is not None]
        if table:
            return "\n".join(f"{k} = {as_toml(v, False)}" for k, v in items)
        return "{" + ", ".join(f"{k} = {as_toml(v, False)}" for k, v in items) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(as_toml(v, False) for v in value if v is not None) + "]"
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, int):
        return str(value)
    return json.dumps(value)


def changed(good: Any, rng: random.Random) -> Any:
    """A copy in which one value, somewhere, is another, missing, or twice there."""
    found = copy.deepcopy(good)
    spot, steps = found, rng.randint(1, 3)
    for _ in range(steps):
        inner = [
            k for k in (spot if isinstance(spot, dict) else range(len(spot)))
            if isinstance(spot[k], (dict, list)) and spot[k]
        ]  # fmt: skip
        if not inner or rng.random() < 0.3:
            break
        spot = spot[rng.choice(inner)]
    key = rng.choice(list(spot) if isinstance(spot, dict) else range(len(spot)))
    kind = rng.random()
    if kind < 0.75:
        spot[key] = rng.choice(ODD)
    elif kind < 0.9:
        del spot[key]
    elif isinstance(spot, dict):
        spot["kye"] = spot[key]
    else:
        spot.append(spot[key])
    return found


def play(path: Path) -> None:
    """All that a film asks of keyframes."""
    keyframes = read_keyframes(path)
    frames = keyframes.frames
    for frame in {frames[0], frames[len(frames) // 2], frames[-1]}:
        keyframes(frame)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(
    ("good", "read"), [(KEYFRAMES, play), (RECIPE, load_recipe)], ids=["keyframes", "recipe"]
)
def test_toml_with_odd_values(tmp_path, good, read, seed):
    path = tmp_path / "file.toml"
    path.write_text(as_toml(good))
    read(path)
    rng, refused = random.Random(seed), 0
    for _ in range(60):
        text = as_toml(changed(good, rng))
        path.write_text(text)
        try:
            read(path)
        except LambentError as error:
            refused += error.file == str(path)
        except Exception as error:
            raise AssertionError(f"{type(error).__name__}: {error}\n{text}") from error
    assert refused > 15


@pytest.mark.parametrize(
    "content",
    [
        b"", b"\xff\xfe\x00", b"frames = [1, 2", b"a = " + b"[" * 100000, b"x = 1e400",
        b"a = " + b"9" * 10000, b"\x00" * 100, b"frames = [1, 1000000000]", b"a = 1\na = 2",
        b"[camera]\n[camera]", b"camera = 5", b"object = [1]", b"frames = [nan, nan]",
        "name = 'ü'".encode("latin-1"),
    ],
    ids=range(14),
)  # fmt: skip
@pytest.mark.parametrize("read", [play, load_recipe], ids=["keyframes", "recipe"])
def test_what_is_no_toml(tmp_path, read, content):
    path = tmp_path / "file.toml"
    path.write_bytes(content)
    with pytest.raises(LambentError) as raised:
        read(path)
    assert raised.value.file == str(path)


@pytest.mark.parametrize("read", [play, load_recipe], ids=["keyframes", "recipe"])
def test_what_is_no_file(tmp_path, read):
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(FileError, match="is a pipe"):
        read(tmp_path / "pipe.toml")
    with pytest.raises(FileError, match="is a folder"):
        read(tmp_path)
    with pytest.raises(FileError, match="no such"):
        read(tmp_path / "none.toml")


def test_frames_without_end_take_no_memory(tmp_path):
    path = tmp_path / "k.toml"
    path.write_text("frames = [1, 1000000000]")
    with pytest.raises(OptionError, match="more than 1,000,000"):
        read_keyframes(path)


def test_manifests_with_odd_values(tmp_path):
    recipe = load_recipe_of(tmp_path)
    good = {"format": 2, "versions": [{}], "recipe": recipe.as_dict()}
    path, rng = tmp_path / MANIFEST, random.Random(1)
    from lambent.dataset import folder

    good["format"] = folder.FORMAT
    path.write_text(json.dumps(good))
    assert recipe_of(tmp_path).name == "small"
    refused = 0
    for content in [json.dumps(changed(good, rng)).encode() for _ in range(200)] + [
        b"", b"[" * 100000, b"{}", b"[]", b"5", b"\xff", b"nul",
    ]:  # fmt: skip
        path.write_bytes(content)
        try:
            recipe_of(tmp_path)
            read_manifest(tmp_path)
        except LambentError:
            refused += 1
    assert refused > 60


def test_lines_of_items_that_name_other_files_are_left_out(tmp_path):
    good = {"what": "still", "index": 3, "file": "", "sha256": "0" * 64, "bytes": 5}
    from lambent.dataset.folder import ITEMS, SUBFOLDERS, file_of

    what = next(iter(SUBFOLDERS))
    good |= {"what": what, "file": file_of(what, 3)}
    odd = [
        {**good, "file": "../../../etc/passwd"}, {**good, "index": -1}, {**good, "index": "3"},
        {**good, "what": "nothing"}, {**good, "bytes": None}, [], 5, None,
    ]  # fmt: skip
    lines = "".join(json.dumps(line) + "\n" for line in (*odd, {**good, "index": 4}))
    (tmp_path / ITEMS).write_text(lines + "[" * 100000 + "\n" + json.dumps(good) + "\n")
    assert list(read_lines(tmp_path)) == [(what, 3)]


def load_recipe_of(folder: Path):
    path = folder / "recipe.toml"
    path.write_text(as_toml(RECIPE))
    return load_recipe(path)
