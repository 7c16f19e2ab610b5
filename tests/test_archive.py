"""Archives from anybody: what is sound comes back, the rest is refused before it costs much."""

import io
import json
import os
import resource
import struct
import subprocess
import sys
import textwrap
import zipfile

import numpy as np
import pytest

from lambent.archive import (
    arrays_of,
    check_card,
    packed_array,
    read_archive,
    write_archive,
)
from lambent.errors import DamagedFileError, FileError

ARRAY = np.arange(12, dtype=np.float32).reshape(4, 3)


@pytest.fixture
def sound(tmp_path):
    path = tmp_path / "sound.lambent"
    write_archive(path, "field", {"name": "x", "error": None}, {"a.npy": packed_array(ARRAY)})
    return path


def rewritten(path, content=None, card=None, method=zipfile.ZIP_DEFLATED):
    """The archive at ``path`` with other members, its checksums made to fit."""
    import hashlib

    with zipfile.ZipFile(path) as old:
        members = {name: old.read(name) for name in old.namelist()}
    about = json.loads(members.pop("card.json"))
    members.update(content or {})
    about["sha256"] = {n: hashlib.sha256(d).hexdigest() for n, d in members.items()}
    about.update(card or {})
    with zipfile.ZipFile(path, "w", method) as new:
        new.writestr("card.json", json.dumps(about))
        for name, data in members.items():
            new.writestr(name, data)
    return path


def npy(header: str, data: bytes = b"") -> bytes:
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


def test_what_is_written_comes_back(sound):
    archive = read_archive(sound, "field")
    assert archive.card["name"] == "x"
    check_card(archive, {"name": str, "error": float | None})
    np.testing.assert_array_equal(arrays_of(archive, {"a": (np.float32, ("N", 3))})["a"], ARRAY)


def test_the_same_content_is_the_same_file(sound, tmp_path):
    again = tmp_path / "again.lambent"
    write_archive(again, "field", {"name": "x", "error": None}, {"a.npy": packed_array(ARRAY)})
    assert again.read_bytes() == sound.read_bytes()


def test_another_kind_is_named(sound):
    with pytest.raises(FileError, match="is a field, not a model"):
        read_archive(sound, "model")


@pytest.mark.parametrize(
    ("card", "words"),
    [
        ({"kind": "virus"}, "is not a Lambent field"),
        ({"kind": ["field"]}, "is not a Lambent field"),
        ({"kind": None}, "is not a Lambent field"),
        ({"format": 99}, "another version"),
        ({"format": "x" * 10000}, "another version"),
        ({"sha256": {}}, "checksum for each member"),
        ({"sha256": None}, "checksum for each member"),
        ({"sha256": {"a.npy": 5}}, "checksum for each member"),
        ({"sha256": {"a.npy": "0" * 64}}, "does not match its checksum"),
        ({"sha256": {"a.npy": "0" * 64, "../b": "0" * 64}}, "checksum for each member"),
    ],
)
def test_cards_that_make_no_sense(sound, card, words):
    with pytest.raises(FileError, match=words):
        read_archive(rewritten(sound, card=card), "field")


@pytest.mark.parametrize(
    "card",
    [b"", b"[]", b"5", b"{", b"\xff\xfe", b'{"a":' * 100000, b"[" * 1000000, b'"' + b"x" * 100],
    ids=lambda b: repr(b[:8]),
)
def test_cards_that_are_no_object(tmp_path, card):
    path = tmp_path / "x.lambent"
    with zipfile.ZipFile(path, "w") as new:
        new.writestr("card.json", card)
    with pytest.raises(FileError):
        read_archive(path, "field")


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (5, str), ("x", int), (True, int), (1, bool), (float("nan"), float),
        (float("inf"), float), (10**400, float), ([1, "x"], list[int]), ({"a": 1}, dict[str, str]),
        ([], dict[str, int]), ({}, list[int]), (5, str | None),
    ],
)  # fmt: skip
def test_values_of_other_types_are_named(sound, value, kind):
    archive = read_archive(rewritten(sound, card={"thing": value}), "field")
    with pytest.raises(DamagedFileError, match="on its card 'thing' is"):
        check_card(archive, {"thing": kind})
    with pytest.raises(DamagedFileError, match="it has no 'other'"):
        check_card(archive, {"other": kind})


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no valid header"),
        (b"\x93NUMPY\x07\x00", "no valid header"),
        (npy("{'descr': '<f4', 'fortran_order': False, 'shape': (10**9,), }"), "header"),
        (npy("{'descr': '<f4', 'fortran_order': False, 'shape': (4000000000000, 3), }"), "bytes"),
        (npy("{'descr': '<f4', 'fortran_order': False, 'shape': (-4, -3), }", b"0" * 48), "header"),
        (npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", b"0" * 8), "header"),
        (npy("{'descr': '<f4', 'fortran_order': True, 'shape': (4, 3), }", b"0" * 48), "header"),
        (npy("{'descr': '<f4', 'fortran_order': False, 'shape': (4, 3), }", b"0" * 44), "bytes"),
        (npy("__import__('os').system('true')"), "no valid header"),
        (npy("(" * 5000), "no valid header"),
        (packed_array(ARRAY.astype(np.float64)), "float64"),
        (packed_array(ARRAY[:, :2]), "float32"),
        (packed_array(np.full((4, 3), np.nan, np.float32)), "not finite"),
    ],
    ids=range(13),
)  # fmt: skip
def test_arrays_that_are_no_arrays(sound, content, words):
    archive = read_archive(rewritten(sound, {"a.npy": content}), "field")
    with pytest.raises(DamagedFileError, match=words):
        arrays_of(archive, {"a": (np.float32, ("N", 3))})


def test_letters_mean_the_same_length(sound):
    archive = read_archive(rewritten(sound, {"b.npy": packed_array(ARRAY[:2])}), "field")
    layout = {"a": (np.float32, ("N", 3)), "b": (np.float32, ("N", 3))}
    with pytest.raises(DamagedFileError, match=r"b is float32 \(2, 3\), not float32 \(4, 3\)"):
        arrays_of(archive, layout)
    with pytest.raises(DamagedFileError, match=r"no c\.npy"):
        arrays_of(archive, {"c": (np.float32, ("N",))})


@pytest.mark.parametrize("name", ["../a", "/etc/a", "a\\b", ".a", "a/", "a" * 200, "ä", "a\nb"])
def test_names_are_plain(sound, name):
    with pytest.raises(DamagedFileError, match="has the name"):
        read_archive(rewritten(sound, {name: b"x"}), "field")


def test_packed_otherwise(sound):
    with pytest.raises(DamagedFileError, match="packed by method 12"):
        read_archive(rewritten(sound, method=zipfile.ZIP_BZIP2), "field")


def test_two_members_of_one_name(sound):
    with zipfile.ZipFile(sound, "a") as more, pytest.warns(UserWarning, match="Duplicate"):
        more.writestr("a.npy", b"x")
    with pytest.raises(DamagedFileError, match="two members"):
        read_archive(sound, "field")


def test_encrypted(sound):
    data = bytearray(sound.read_bytes())
    at = data.index(b"PK\x01\x02")
    while at != -1:
        data[at + 8] |= 1
        at = data.find(b"PK\x01\x02", at + 1)
    sound.write_bytes(data)
    with pytest.raises(DamagedFileError, match="encrypted"):
        read_archive(sound, "field")


def test_what_is_no_regular_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.lambent")
    with pytest.raises(FileError, match="pipe"):
        read_archive(tmp_path / "pipe.lambent", "field")
    with pytest.raises(FileError, match="folder"):
        read_archive(tmp_path, "field")
    with pytest.raises(FileError, match="no such file"):
        read_archive(tmp_path / "none.lambent", "field")


def test_any_byte_may_be_wrong(sound):
    good = sound.read_bytes()
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(300):
        data = bytearray(good)
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        sound.write_bytes(data[: rng.integers(1, len(data) + 1)] if rng.random() < 0.3 else data)
        try:
            archive = read_archive(sound, "field")
            assert archive.members["a.npy"] == packed_array(ARRAY)
        except FileError:
            refused += 1
    assert refused > 200


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path):
    path = tmp_path / "bomb.lambent"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        new.writestr("card.json", json.dumps({"kind": "field", "format": 1}))
        with new.open("a.npy", "w", force_zip64=True) as member:
            block = bytes(1 << 24)
            for _ in range(64):  # 1 GiB
                member.write(block)
    script = f"""
        import sys
        from lambent.archive import read_archive
        from lambent.errors import FileError
        try:
            read_archive({str(path)!r}, "field")
        except FileError as error:
            print(error)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_DATA, (1 << 29, 1 << 29)),
        check=True,
    )
    assert "that unpack to" in done.stdout


def test_memory_is_bounded_by_the_limit_that_a_person_sets(sound, monkeypatch):
    content = np.random.default_rng(0).random(1 << 18).astype(np.float32)
    rewritten(sound, {"a.npy": packed_array(content)})
    monkeypatch.setenv("LAMBENT_MAX_DECODED", "500K")
    with pytest.raises(FileError, match="LAMBENT_MAX_DECODED"):
        read_archive(sound, "field")
    monkeypatch.setenv("LAMBENT_MAX_DECODED", "5M")
    assert len(read_archive(sound, "field").members["a.npy"]) > 1 << 20


def test_an_old_file_without_a_kind_is_read(sound):
    buffer = io.BytesIO(sound.read_bytes())
    with zipfile.ZipFile(buffer) as old:
        card = json.loads(old.read("card.json"))
        data = old.read("a.npy")
    del card["kind"]
    with zipfile.ZipFile(sound, "w") as new:
        new.writestr("card.json", json.dumps({**card, "method": "radiosity"}))
        new.writestr("a.npy", data)
    assert read_archive(sound, "solution").card["method"] == "radiosity"
