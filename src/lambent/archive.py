"""The one archive format of Lambent: models, solutions, fields. Nothing in it is code.

The file is a ZIP archive (``.lambent``)::

    card.json      ``kind`` and ``format`` of the file, the SHA-256 of every other member, and what
                   the kind wants to say about itself
    …              plain members: a network, weights, arrays (``.npy``)

A file may come from anybody, so `read_archive` believes nothing: before a byte is unpacked it
checks how large the members are by the archive's directory, how they are packed, and that their
names are plain; then the card; then every member against its checksum. A checksum tells damage, not
malice: what the numbers mean is checked by their owner, with `check_card` and `arrays_of`.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import re
import stat
import struct
import types
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import DamagedFileError, FileError
from lambent.frame.atomic import atomic
from lambent.frame.limits import check_bytes
from lambent.frame.magic import begins_as, kind_at
from lambent.settings import fits, parse_json, shortened, wrong_key

SUFFIX = ".lambent"
CARD = "card.json"
#: The version of the file itself.
FORMAT = 1
#: Kind -> what it is, and how a person gets another one.
KINDS: Mapping[str, tuple[str, str]] = {
    "model": ("model", "name a model that lambent train has made, or install Lambent again"),
    "solution": ("solution", "solve the scene again: lambent solve SCENE -o FILE"),
    "field": ("field", "fit it again: lambent fit THING -o FILE"),
}
#: Kind -> the command that takes it, where there is one.
_TAKEN_BY: Mapping[str, str] = {
    "model": "lambent denoise RENDER.exr --model {}",
    "solution": "lambent view {}",
}
#: How members may be packed. Others need libraries that not every Python has.
_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")
_HEADER = re.compile(
    rb"\{'descr': '([<|](?:[fiu][1248]|b1))', 'fortran_order': False, "
    rb"'shape': \(((?:\d{1,15},? ?){0,8})\), \}\s*"
)
_MOST_MEMBERS = 1000
_LARGEST_CARD = 16 << 20
#: Networks and arrays shrink by a factor of 1.1 to 20; a bomb by a thousand.
_SMALL, _LARGEST_RATIO = 64 << 20, 100


@dataclass(frozen=True, eq=False)
class Archive:
    """A checked archive. ``card``: see the module; ``members``: bytes by name."""

    card: Mapping[str, Any]
    members: Mapping[str, bytes]
    path: Path


def read_archive(path: str | os.PathLike[str], kind: str) -> Archive:
    """The content of an archive of a kind (a key of `KINDS`), every member checked.

    Raises `FileError`: missing, no archive of Lambent, of another kind, of another version, larger
    than may be unpacked; `DamagedFileError`: cut off, or not what its checksums say.
    """
    path = Path(path)
    what, remedy = KINDS[kind]
    try:
        _check_regular(path, what)
        with zipfile.ZipFile(path) as archive:
            infos = _checked_directory(archive, path, what, remedy)
            card = _card(archive, infos, path, kind)
            data = {name: archive.read(info) for name, info in infos.items() if name != CARD}
    except FileNotFoundError:
        raise FileError("there is no such file", file=path, remedy="check the path") from None
    except (
        zipfile.BadZipFile, zlib.error, EOFError, ValueError, NotImplementedError, struct.error,
        RecursionError,
    ) as error:  # fmt: skip
        if begins_as(path, "zip"):
            reason = str(error) or type(error).__name__
            raise DamagedFileError(f"is damaged: {reason}", file=path, remedy=remedy) from None
        picture = kind_at(path)
        words = f"is not a Lambent {what}" + (f", but {picture}" if picture else "")
        raise FileError(words, file=path, remedy=remedy) from None
    except OSError as error:
        raise FileError(
            f"cannot be read: {error.strerror or error}", file=path, remedy="check its permissions"
        ) from None
    for name, content in data.items():
        if hashlib.sha256(content).hexdigest() != card["sha256"][name]:
            raise DamagedFileError(
                f"is damaged: {name} does not match its checksum", file=path, remedy=remedy
            )
    return Archive(types.MappingProxyType(card), types.MappingProxyType(data), path)


def write_archive(
    path: str | os.PathLike[str],
    kind: str,
    card: Mapping[str, Any],
    members: Mapping[str, bytes],
    overwrite: bool = False,
) -> None:
    """An archive to a file, in one step; the same content is the same file, byte for byte.

    Raises `OutputError`.
    """
    assert kind in KINDS
    assert all(_NAME.fullmatch(name) and name != CARD for name in members)
    sums = {name: hashlib.sha256(content).hexdigest() for name, content in members.items()}
    full = {**card, "kind": kind, "format": FORMAT, "sha256": sums}
    content = {CARD: json.dumps(full, indent=1).encode(), **members}
    with (
        atomic(path, overwrite) as handle,
        zipfile.ZipFile(handle, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for name, data in content.items():
            info = zipfile.ZipInfo(name, (2000, 1, 1, 0, 0, 0))  # no date of today
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, data)


def check_card(archive: Archive, kinds: Mapping[str, Any]) -> None:
    """Raise `DamagedFileError` unless the card has these keys with values of these types.

    Types are those of `lambent.settings.fits`.
    """
    wrong = wrong_key(dict(archive.card), dict(kinds))
    if wrong:
        raise _damaged(archive, f"on its card {wrong}")


def packed_array(array: NDArray[Any]) -> bytes:
    """An array as the bytes of a member ``NAME.npy``."""
    buffer = io.BytesIO()
    np.save(buffer, np.ascontiguousarray(array), allow_pickle=False)
    return buffer.getvalue()


def arrays_of(
    archive: Archive, layout: Mapping[str, tuple[Any, tuple[int | str, ...]]]
) -> dict[str, NDArray[Any]]:
    """The arrays ``NAME.npy`` of an archive, by name.

    ``layout``: name -> dtype and shape; an axis is a number, or a letter that means the same
    length wherever it stands. Floats must be finite. Raises `DamagedFileError`.
    """
    lengths: dict[str, int] = {}
    arrays = {}
    for name, (dtype, shape) in layout.items():
        array = _array(archive, name)
        wanted = ", ".join(str(lengths.get(str(axis), axis)) for axis in shape)
        fits = array.dtype == np.dtype(dtype) and array.ndim == len(shape)
        for axis, length in zip(shape, array.shape, strict=False):
            expected = lengths.setdefault(axis, length) if isinstance(axis, str) else axis
            fits = fits and expected == length
        if not fits:
            raise _damaged(
                archive,
                f"{name} is {array.dtype.name} {array.shape}, "
                f"not {np.dtype(dtype).name} ({wanted})",
            )
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise _damaged(archive, f"{name} has values that are not finite")
        arrays[name] = array
    return arrays


# ------------------------------------------------------------------- private


def _check_regular(path: Path, what: str) -> None:
    mode = path.stat().st_mode
    if not stat.S_ISREG(mode):
        words = "is a folder" if stat.S_ISDIR(mode) else "is a pipe or a device"
        raise FileError(f"{words}, not a Lambent {what}", file=path, remedy="name a .lambent file")


def _checked_directory(
    archive: zipfile.ZipFile, path: Path, what: str, remedy: str
) -> dict[str, zipfile.ZipInfo]:
    """The members by name, from the archive's directory alone."""
    infos = {info.filename: info for info in archive.infolist()}
    if CARD not in infos:
        raise FileError(f"is not a Lambent {what}", file=path, remedy=remedy)
    wrong = ""
    if len(infos) != len(archive.infolist()):
        wrong = "two members have the same name"
    elif len(infos) > _MOST_MEMBERS:
        wrong = f"it has {len(infos)} members"
    for name, info in infos.items():
        if not _NAME.fullmatch(name):
            wrong = f"a member has the name {shortened(name)}"
        elif info.flag_bits & 0x1:
            wrong = f"{name} is encrypted"
        elif info.compress_type not in _PACKED:
            wrong = f"{name} is packed by method {info.compress_type}, not 0 or 8"
    if wrong:
        raise DamagedFileError(f"is damaged: {wrong}", file=path, remedy=remedy)
    total = sum(info.file_size for info in infos.values())
    if (
        infos[CARD].file_size > _LARGEST_CARD
        or total > _SMALL + _LARGEST_RATIO * path.stat().st_size
    ):
        raise DamagedFileError(
            f"is damaged: {path.stat().st_size:,} bytes that unpack to {total:,}",
            file=path,
            remedy=remedy,
        )
    check_bytes(total, path, what="members", stored=path.stat().st_size)
    return infos


def _card(
    archive: zipfile.ZipFile, infos: Mapping[str, zipfile.ZipInfo], path: Path, kind: str
) -> dict[str, Any]:
    what, remedy = KINDS[kind]
    card = parse_json(archive.read(infos[CARD]))
    if not isinstance(card, dict):
        raise FileError(f"is not a Lambent {what}", file=path, remedy=remedy)
    here = card.get("kind", _kind_of_old(card))
    if here != kind:
        if not isinstance(here, str) or here not in KINDS:
            raise FileError(f"is not a Lambent {what}", file=path, remedy=remedy)
        if here in _TAKEN_BY:
            remedy = f"a {KINDS[here][0]} is for: {_TAKEN_BY[here].format(path)}"
        raise FileError(f"is a {KINDS[here][0]}, not a {what}", file=path, remedy=remedy)
    if card.get("format") != FORMAT:
        raise FileError(
            f"was made by another version of Lambent (format {shortened(card.get('format'))}, here "
            f"{FORMAT})",
            file=path,
            remedy=remedy,
        )
    sums = card.get("sha256")
    each = isinstance(sums, dict) and fits(sums, dict[str, str])
    if not isinstance(sums, dict) or not each or set(sums) != set(infos) - {CARD}:
        raise DamagedFileError(
            "is damaged: its card does not have a checksum for each member",
            file=path,
            remedy=remedy,
        )
    return card


def _kind_of_old(card: Mapping[str, Any]) -> str | None:
    """The kind of a file from before cards had one."""
    return "model" if "inputs" in card else "solution" if "method" in card else None


def _array(archive: Archive, name: str) -> NDArray[Any]:
    content = archive.members.get(f"{name}.npy")
    if content is None:
        raise _damaged(archive, f"it has no {name}.npy")
    # as NumPy writes them (format 1.0), and nothing else: NumPy would evaluate the header's text
    start = 10 + int.from_bytes(content[8:10], "little")
    header = _HEADER.fullmatch(content[10:start]) if content[:8] == b"\x93NUMPY\x01\x00" else None
    if header is None:
        raise _damaged(archive, f"{name}.npy has no valid header")
    dtype = np.dtype(header[1].decode())
    shape = tuple(int(n) for n in header[2].replace(b",", b" ").split())
    # counted before anything is made: a header may name any size
    if math.prod(shape) * dtype.itemsize != len(content) - start:
        raise _damaged(
            archive, f"{name}.npy has {len(content) - start} bytes for {dtype.name} {shape}"
        )
    return np.frombuffer(content, dtype, offset=start).reshape(shape).copy()


def _remedy(archive: Archive) -> str:
    return KINDS[archive.card.get("kind") or _kind_of_old(archive.card) or "model"][1]


def _damaged(archive: Archive, what: str) -> DamagedFileError:
    return DamagedFileError(f"is damaged: {what}", file=archive.path, remedy=_remedy(archive))
