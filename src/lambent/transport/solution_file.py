"""Solutions as files: a card in JSON and plain arrays, in a ZIP archive. Nothing in it is code.

``card.json`` says the method, the scene (path, digest of its geometry), settings, and the SHA-256
of every array; the arrays are ``.npy`` members. All methods of `lambent.transport` write this.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import DamagedFileError, FileError
from lambent.frame.atomic import atomic
from lambent.frame.magic import begins_as

#: The version of the file.
FORMAT = 1
CARD = "card.json"
_REMEDY = "solve the scene again: lambent solve SCENE -o FILE"


def write_solution(
    path: str | os.PathLike[str],
    card: Mapping[str, Any],
    arrays: Mapping[str, NDArray[Any]],
    overwrite: bool = False,
) -> None:
    """Write a solution, in one step. Raises `OutputError`."""
    packed = {}
    for name, array in arrays.items():
        buffer = io.BytesIO()
        np.save(buffer, np.ascontiguousarray(array), allow_pickle=False)
        packed[f"{name}.npy"] = buffer.getvalue()
    sums = {name: hashlib.sha256(data).hexdigest() for name, data in packed.items()}
    full = {**card, "format": FORMAT, "sha256": sums}
    with (
        atomic(path, overwrite) as handle,
        zipfile.ZipFile(handle, "w", zipfile.ZIP_DEFLATED, compresslevel=4) as archive,
    ):
        archive.writestr(CARD, json.dumps(full, indent=1))
        for name, data in packed.items():
            archive.writestr(name, data)


def read_solution(path: str | os.PathLike[str]) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Card and arrays. Raises `FileError` (missing, no solution, another version) and
    `DamagedFileError`.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            if CARD not in names:
                raise FileError("is no solution of Lambent", file=path, remedy=_REMEDY)
            card = json.loads(archive.read(CARD))
            data = {name: archive.read(name) for name in names if name != CARD}
    except FileNotFoundError:
        raise FileError("does not exist", file=path, remedy=_REMEDY) from None
    except IsADirectoryError:
        raise FileError("is a folder", file=path, remedy="name a .lambent file") from None
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError) as error:
        if begins_as(path, "zip"):
            raise DamagedFileError(f"is damaged: {error}", file=path, remedy=_REMEDY) from None
        raise FileError("is no solution of Lambent", file=path, remedy=_REMEDY) from None
    except OSError as error:
        raise FileError(f"cannot be read: {error}", file=path) from None
    if not isinstance(card, dict) or "method" not in card:
        what = "a model, not a solution" if "inputs" in card else "no solution of Lambent"
        raise FileError(f"is {what}", file=path, remedy=_REMEDY)
    if card.get("format") != FORMAT:
        raise FileError(
            f"was made by another version of Lambent (format {card.get('format')}, here {FORMAT})",
            file=path,
            remedy=_REMEDY,
        )
    arrays = {}
    for name, digest in card.get("sha256", {}).items():
        content = data.get(name)
        if content is None or hashlib.sha256(content).hexdigest() != digest:
            raise DamagedFileError(
                f"is damaged: {name} is not what its checksum says", file=path, remedy=_REMEDY
            )
        arrays[name.removesuffix(".npy")] = np.load(io.BytesIO(content), allow_pickle=False)
    return card, arrays
