"""Solutions whose checksums fit and whose numbers do not: refused on loading, each of them."""

import hashlib
import json
import zipfile

import boxes
import numpy as np
import pytest

import lambent
from lambent.archive import packed_array
from lambent.errors import FileError


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    path = tmp_path_factory.mktemp("crafted") / "room.lambent"
    lambent.solve(boxes.room(), patches=60, output=path, adaptive=False)
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def crafted(content, path, arrays=(), card=()):
    members = {**content, **{f"{n}.npy": packed_array(a) for n, a in dict(arrays).items()}}
    about = {**json.loads(members.pop("card.json")), **dict(card)}
    about["sha256"] = {n: hashlib.sha256(d).hexdigest() for n, d in members.items()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("card.json", json.dumps(about))
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def array(content, name):
    import io

    return np.load(io.BytesIO(content[f"{name}.npy"]))


def test_uncrafted_it_opens(content, tmp_path):
    solution = lambent.open_solution(crafted(content, tmp_path / "x.lambent"))
    assert (solution.child >= 0).any(), "the tests below need cells with children"
    assert "patches" in repr(solution)


def a_child_out_of_range(child):
    child[np.flatnonzero(child >= 0)[0]] = 10**9


def a_child_that_is_its_parent(child):
    inner = np.flatnonzero(child >= 0)
    child[inner[-1]] = inner[0]


def a_negative_child(child):
    child[np.flatnonzero(child >= 0)[0]] = -7


def two_parents_of_one(child):
    inner = np.flatnonzero(child >= 0)
    child[inner[1]] = child[inner[0]]


def no_roots(child):
    child[:] = 0


@pytest.mark.parametrize(
    "change",
    [
        a_child_out_of_range,
        a_child_that_is_its_parent,
        a_negative_child,
        two_parents_of_one,
        no_roots,
    ],
)
def test_trees_that_are_none(content, tmp_path, change):
    child = array(content, "child")
    change(child)
    with pytest.raises(FileError, match="is damaged"):
        lambent.open_solution(crafted(content, tmp_path / "x.lambent", {"child": child}))


@pytest.mark.parametrize(
    ("name", "value"),
    [("prim", -1), ("prim", 10**6), ("cell_patch", 10**8), ("cell_patch", -2), ("cell_patch", 0)],
)
def test_numbers_out_of_range(content, tmp_path, name, value):
    numbers = array(content, name)
    numbers[0] = value
    with pytest.raises(FileError, match="is damaged"):
        lambent.open_solution(crafted(content, tmp_path / "x.lambent", {name: numbers}))


@pytest.mark.parametrize("seed", range(12))
def test_arrays_at_random(content, tmp_path, seed):
    rng = np.random.default_rng(seed)
    names = [name.removesuffix(".npy") for name in content if name != "card.json"]
    for name in names:
        old = array(content, name)
        new = [
            old[: len(old) // 2],
            old.astype(np.float64),
            old[None],
            np.concatenate([old, old]),
            np.zeros((0, *old.shape[1:]), old.dtype),
        ][rng.integers(5)]
        with pytest.raises(FileError, match="is damaged"):
            lambent.open_solution(crafted(content, tmp_path / "x.lambent", {name: new}))


@pytest.mark.parametrize(
    "card",
    [
        {"method": "magic"}, {"method": 5}, {"method": "../../radiosity"}, {"scene": 5},
        {"parameters": []}, {"parameters": {"a": 1}}, {"notes": "x"}, {"notes": [1]},
        {"seconds": {"a": "b"}}, {"interrupted": "no"}, {"error": "much"}, {"error": float("nan")},
        {"history": {}}, {"history": {"steps": [1], "rings": [2]}}, {"history": 5},
        {"settings": 7}, {"geometry": None}, {"scene_digest": []},
    ],
    ids=str,
)  # fmt: skip
def test_cards_that_make_no_sense(content, tmp_path, card):
    with pytest.raises(lambent.LambentError):
        lambent.open_solution(crafted(content, tmp_path / "x.lambent", card=card))
