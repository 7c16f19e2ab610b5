"""A learned model as one file: its network, what it reads, and its card. Nothing in it is code.

The file is a ZIP archive (``.lambent``)::

    card.json      what the model is: name, size, what it reads (a key of `READS`) and the
                   version of that, how it was trained on what, its scores, and the SHA-256 of the
                   other members
    network.xml    the network as OpenVINO reads it
    network.bin    its weights

`read_model` checks everything before anything is used. The weights of the float network, which
fine-tuning begins with, are read back from the same numbers (`learn.export`).
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from lambent.denoise import inputs, lobes
from lambent.errors import DamagedFileError, FileError, UnknownNameError
from lambent.frame.atomic import atomic
from lambent.frame.magic import begins_as

SUFFIX = ".lambent"
#: The version of the file itself.
FORMAT = 1
#: What a network may read, and the version of its description: `inputs`, `lobes`, or the values of
#: a display-referred picture themselves.
READS: Mapping[str, int] = {"signals": inputs.VERSION, "lobes": lobes.VERSION, "pixels": 1}
CARD, NETWORK, WEIGHTS = "card.json", "network.xml", "network.bin"


@dataclass(frozen=True, eq=False)
class ModelFile:
    """The content of a model file. ``card``: see the module; ``path``: where it came from."""

    card: Mapping[str, Any]
    network: bytes
    weights: bytes
    path: Path


def read_model(path: str | os.PathLike[str], reads: str | None = None) -> ModelFile:
    """A model from a file; ``reads``: what it must read, a key of `READS` (None: anything).

    Raises `FileError`: missing, no model, of another kind, made for another version of Lambent;
    `DamagedFileError`: cut off, or not what its checksums say.
    """
    path = Path(path)
    remedy = "name a model that lambent train has made, or install Lambent again"
    try:
        with zipfile.ZipFile(path) as archive:
            names = set(archive.namelist())
            if not {CARD, NETWORK, WEIGHTS} <= names:
                raise FileError("is no model of Lambent", file=path, remedy=remedy)
            card = json.loads(archive.read(CARD))
            network, weights = archive.read(NETWORK), archive.read(WEIGHTS)
    except FileNotFoundError:
        raise FileError("there is no such model", file=path, remedy=remedy) from None
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError) as error:
        if zipfile.is_zipfile(path) or begins_as(path, "zip"):
            raise DamagedFileError(f"is damaged: {error}", file=path, remedy=remedy) from None
        raise FileError("is no model of Lambent", file=path, remedy=remedy) from None
    except OSError as error:
        raise FileError(f"cannot be read: {error}", file=path, remedy=remedy) from None
    if not isinstance(card, dict) or "sha256" not in card:
        raise FileError("is no model of Lambent", file=path, remedy=remedy)
    kind = card.get("reads", "signals")  # models from before there were others do not say
    version = READS.get(kind)
    if card.get("format") != FORMAT or version is None or card.get("inputs") != version:
        raise FileError(
            f"was made for another version of Lambent (format {card.get('format')}, inputs "
            f"{card.get('inputs')} of {kind}; here {FORMAT} and {version})",
            file=path,
            remedy="train or export it again with this version",
        )
    if reads is not None and kind != reads:
        raise FileError(
            f"is a model that reads {kind}, not {reads}",
            file=path,
            remedy=f"it was made for --model {card.get('recipe', {}).get('task', 'lambent')}",
        )
    for name, data in ((NETWORK, network), (WEIGHTS, weights)):
        if hashlib.sha256(data).hexdigest() != card["sha256"].get(name):
            raise DamagedFileError(
                f"is damaged: {name} is not what its checksum says", file=path, remedy=remedy
            )
    return ModelFile(card, network, weights, path)


def write_model(
    path: str | os.PathLike[str],
    card: Mapping[str, Any],
    network: bytes,
    weights: bytes,
    overwrite: bool = False,
) -> None:
    """A model to a file, in one step; the card's ``reads`` is a key of `READS`.

    Raises `OutputError`.
    """
    sums = {
        name: hashlib.sha256(data).hexdigest()
        for name, data in ((NETWORK, network), (WEIGHTS, weights))
    }
    reads = card.get("reads", "signals")
    full = {**card, "reads": reads, "format": FORMAT, "inputs": READS[reads], "sha256": sums}
    with (
        atomic(path, overwrite) as handle,
        zipfile.ZipFile(handle, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for name, data in (
            (CARD, json.dumps(full, indent=1).encode()),
            (NETWORK, network),
            (WEIGHTS, weights),
        ):
            # a fixed date, so that the same model is the same file
            info = zipfile.ZipInfo(name, (2000, 1, 1, 0, 0, 0))
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, data)


def shipped() -> dict[str, Path]:
    """The models that come with Lambent, by name."""
    folder = Path(str(resources.files("lambent") / "models"))
    return {path.stem: path for path in sorted(folder.glob(f"*{SUFFIX}"))}


def find_model(name: str) -> Path:
    """The file of a shipped model by name, or ``name`` itself if it is a path.

    Raises `UnknownNameError`.
    """
    known = shipped()
    if name in known:
        return known[name]
    if name.endswith(SUFFIX) or os.sep in name:
        return Path(name)
    raise UnknownNameError("network", name, list(known))


def loaded_model(name: str, reads: str) -> ModelFile:
    """The model of a name or path, read once as long as its file does not change.

    Raises `UnknownNameError` and what `read_model` raises.
    """
    path = find_model(name)
    key = f"{reads}:{path}:{path.stat().st_mtime_ns if path.exists() else 0}"
    if key not in _loaded:
        _loaded[key] = read_model(path, reads)
    return _loaded[key]


_loaded: dict[str, ModelFile] = {}
