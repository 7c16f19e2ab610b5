"""Which native code Mitsuba loads: its own package's plug-ins, and those that a person allows.

Mitsuba finds the plug-in ``NAME`` as ``plugins/NAME.so`` in the current folder, in the scene's, in
those that the scene adds with ``<path>``, and only then in its own package. So a scene from a
stranger could bring code along. What is loaded once stays: Mitsuba looks a name up a single time in
a process. That is what `settle` builds on: it loads all plug-ins of the package, and of the folders
given to `allow`, before any scene is opened. `check` then refuses a scene that names others, by
what Mitsuba's parser has read of it (``<include>`` and ``$names`` resolved): nothing that a scene
names is left to be looked for in a folder.

Plug-ins written in Python (``mi.register_bsdf`` …) are code that runs already, and may be named.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lambent.errors import DamagedFileError, EngineError, FileError, stop_by_interrupt

#: Names that Mitsuba's parser knows without a plug-in.
BUILT_IN = frozenset({"scene", "ref", "rgb", "spectrum", "resources"})
#: What shared objects end in.
ENDING = {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")

#: Folders that plug-ins may come from besides Mitsuba's package, and the plug-ins loaded so far:
#: Mitsuba keeps a plug-in until the process ends, so these live as long.
_allowed: list[Path] = []
_loaded: dict[str, Path] = {}


def allow(folders: Iterable[Path]) -> None:
    """Let scenes use the plug-ins ``NAME.so`` in these folders (or in their ``plugins``).

    For this process, from now on; a plug-in named as one of Mitsuba's own takes its place.
    Raises `FileError` for a folder without plug-ins, `EngineError` for a plug-in whose name Mitsuba
    has loaded already or that cannot be loaded.
    """
    for folder in folders:
        place = folder / "plugins" if (folder / "plugins").is_dir() else folder
        try:
            files = sorted(place.glob(f"*{ENDING}"))
        except OSError as error:
            raise FileError(f"cannot be read: {error.strerror}", file=folder) from error
        if not files:
            raise FileError(
                "holds no plug-ins",
                file=folder,
                remedy=f"--allow-plugins names the folder of the files NAME{ENDING}",
            )
        place = place.resolve()
        if place not in _allowed:
            _allowed.append(place)
    if "mitsuba" in sys.modules:
        settle(sys.modules["mitsuba"])


def allowed() -> tuple[Path, ...]:
    """The folders that were allowed; for processes that shall do as this one."""
    return tuple(_allowed)


def settle(mi: Any) -> None:
    """Load the plug-ins of allowed folders and of Mitsuba's package that are not loaded yet.

    ``mi`` needs no variant. Raises `EngineError`.
    """
    for folder in (*_allowed, _own(mi)):
        files = [f for f in sorted(folder.glob(f"*{ENDING}")) if not _is_settled(mi, f)]
        if not files:
            continue
        with tempfile.TemporaryDirectory(prefix="lambent-plugins-") as scratch:
            (Path(scratch) / "plugins").symlink_to(folder, target_is_directory=True)
            with _looking_first_in(mi, scratch):
                for file in files:
                    _load(mi, file)


def check(mi: Any, names: Mapping[str, str], file: object) -> None:
    """Refuse a scene, ``file``, that names other plug-ins than the process has.

    ``names``: of plug-ins, with where they stand in the file. Called while Mitsuba's file resolver
    has the scene's folders. Raises `DamagedFileError` with the name, and with the file where a
    folder of the scene holds one of that name.
    """
    for name in sorted(names.keys() - BUILT_IN):
        place = f" ({names[name]})" if names[name] else ""
        foreign = _foreign(mi, name)
        if foreign is not None:
            raise DamagedFileError(
                f"asks for the plug-in '{name}'{place}, which Mitsuba would load from '{foreign}': "
                "native code, which may do anything, so it was not loaded",
                file=file,
                remedy="remove that file; or, if you trust it, say so: "
                f"--allow-plugins {foreign.parent}",
            )
        if name not in _loaded and not _is_registered(mi, name):
            raise DamagedFileError(
                f"asks for the plug-in '{name}'{place}, which Mitsuba does not have",
                file=file,
                remedy="correct its type, import the package that registers it first, or name the "
                "folder of its file with --allow-plugins",
            )


def names_in(scene: Mapping[str, Any]) -> set[str]:
    """The plug-ins that a scene in memory names, however deep."""
    found = {str(scene.get("type", "scene"))}
    for value in scene.values():
        if isinstance(value, Mapping):
            found |= names_in(value)
    return found


# ------------------------------------------------------------------- private


def _own(mi: Any) -> Path:
    """The folder of Mitsuba's own plug-ins."""
    return Path(mi.__path__[0]).resolve() / "plugins"


def _is_settled(mi: Any, file: Path) -> bool:
    """Whether a plug-in is loaded, or Mitsuba's own whose place another took.

    Raises `EngineError` where an allowed one comes too late.
    """
    own = _own(mi)
    loaded = _loaded.get(file.stem)
    if loaded is None and file.parent != own and _is_mapped(own / file.name):
        loaded = own / file.name  # by the script that runs
    if loaded not in (None, file) and file.parent != own:
        raise EngineError(
            f"the plug-in '{file}' is allowed too late: '{loaded}' is loaded under this name",
            remedy="allow it before anything is rendered, or give it another name",
        )
    return loaded is not None


def _load(mi: Any, file: Path) -> None:
    """Load a plug-in while the resolver finds its folder first. Raises `EngineError`."""
    # to ask for its type loads it, but keeps to itself what goes wrong
    mi.PluginManager.instance().plugin_type(file.stem)
    if file.parent != _own(mi) and not _is_mapped(file):
        raise EngineError(
            f"'{file}' cannot be loaded as a plug-in of Mitsuba {mi.__version__}",
            remedy="build it for this version, or leave it out of the folder",
        )
    _loaded[file.stem] = file


def _is_mapped(file: Path) -> bool:
    """Whether a shared object is in this process, as the system (Linux) knows."""
    with open("/proc/self/maps", "rb") as lines:
        return any(line.rstrip().endswith(b" " + bytes(file.resolve())) for line in lines)


def _foreign(mi: Any, name: str) -> Path | None:
    """The file that Mitsuba would load for a name, unless it is Mitsuba's own or allowed."""
    for folder in (*mi.file_resolver(), os.curdir):
        file = os.path.join(str(folder), "plugins", os.path.splitext(name)[0] + ENDING)
        if os.path.isfile(file):
            real, loaded = Path(file).resolve(), _loaded.get(name)
            if real.parent == _own(mi) or (loaded is not None and real == loaded.resolve()):
                return None
            return Path(file)
    return None


def _is_registered(mi: Any, name: str) -> bool:
    """Whether a plug-in written in Python has this name in the present variant.

    There is no list of them. So one is asked for, where the only file of that name is no plug-in.
    """
    if not re.fullmatch(r"[A-Za-z0-9_-]+", name):
        return False  # the file that Mitsuba makes of it may be any
    with tempfile.TemporaryDirectory(prefix="lambent-plugins-") as scratch:
        stand_in = Path(scratch) / "plugins" / f"{name}{ENDING}"
        stand_in.parent.mkdir()
        stand_in.touch()
        with _looking_first_in(mi, scratch):
            try:
                mi.PluginManager.instance().create_object(mi.Properties(name))
            except Exception as error:  # of its constructor, which was given no properties
                stop_by_interrupt(error)
                return str(stand_in) not in str(error)
    return True


@contextmanager
def _looking_first_in(mi: Any, folder: str) -> Iterator[None]:
    """Mitsuba's resolver with this folder, then Mitsuba's own (its data), and no other.

    Mitsuba's loading of scenes exchanges the resolver in the same way.
    """
    before = mi.file_resolver()
    two = mi.FileResolver()
    two.clear()
    two.append(folder)
    two.append(str(_own(mi).parent))
    mi.set_file_resolver(two)
    try:
        yield
    finally:
        mi.set_file_resolver(before)
