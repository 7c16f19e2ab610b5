"""The radiosity of a scene as a record: what every patch reflects, emits and receives.

It holds irradiance rather than radiosity, so that a view multiplies it by the texture at the very
point that is seen: B(x) = E(x) + ρ(x) H, with H smooth where ρ is not.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lambent.archive import Archive, arrays_of, check_card, packed_array
from lambent.errors import DamagedFileError, FileError
from lambent.transport.radiosity.patches import Cells, Patches
from lambent.transport.radiosity.solvers import History
from lambent.transport.solution import Solution, card_fields
from lambent.transport.surfaces import Array, Surfaces, surfaces_of

#: The arrays of its file: cells T, faces F.
_ARRAYS: dict[str, tuple[Any, tuple[int | str, ...]]] = {
    "child": (np.int32, ("T",)),
    "prim": (np.int32, ("T",)),
    "corner": (np.float32, ("T", 3, 2)),
    "cell_patch": (np.int32, ("T",)),
    "reflectance": (np.float32, ("F", 3)),
    "emission": (np.float32, ("F", 3)),
    "direct": (np.float32, ("F", 3)),
    "indirect": (np.float32, ("F", 3)),
    "residual": (np.float32, ("F", 3)),
    "live": (np.bool_, ("F",)),
}
#: The entries of its balance, in words.
_POWER = {
    "emitted": "leaves lamps that are surfaces",
    "direct": "arrives straight from emitters",
    "reflected": "leaves by reflection, all bounces",
    "absorbed": "stays in the surfaces",
    "escaped": "leaves the scene, or ends on something black, after a reflection",
}
#: What its card has of its own.
_CARD = {"geometry": str, "error": float | None, "history": dict[str, list[float]]}


@dataclass(frozen=True, eq=False, repr=False)
class RadiositySolution(Solution):
    """What `lambent.solve(scene, method="radiosity")` returns.

    Of the ``n`` patches' ``2 n`` faces (`lambent.transport.radiosity.patches`), ``(2 n, 3)`` each:
    ``reflectance``, ``emission`` (emitted radiosity, W/m²), ``direct`` and ``indirect`` irradiance,
    ``residual`` of the equation; ``live`` ``(2 n,)``: faces that light reaches. ``error``: relative
    standard error of a face's indirect light, from the number of rays (None where form factors are
    not by rays). ``child``, ``prim``, ``corner``, ``cell_patch``: the cells and the patch of each.
    ``digest`` is of the geometry.
    """

    method: ClassVar[str] = "radiosity"

    child: NDArray[np.int32]
    prim: NDArray[np.int32]
    corner: NDArray[np.float32]
    cell_patch: NDArray[np.int32]
    reflectance: NDArray[np.float32]
    emission: NDArray[np.float32]
    direct: NDArray[np.float32]
    indirect: NDArray[np.float32]
    residual: NDArray[np.float32]
    live: NDArray[np.bool_]
    history: History
    digest: str
    error: float | None = None

    def __len__(self) -> int:
        """Number of patches."""
        return len(self.reflectance) // 2

    @property
    def irradiance(self) -> Array:
        """Light that arrives ``(2 n, 3)``, W/m²."""
        return np.asarray(self.direct + self.indirect)

    @property
    def reflected(self) -> Array:
        """Light that leaves by reflection ``(2 n, 3)``, W/m²: ρ H."""
        return np.asarray(self.reflectance * self.irradiance)

    @property
    def radiosity(self) -> Array:
        """All light that leaves ``(2 n, 3)``, W/m²: B = E + ρ H."""
        return np.asarray(self.emission + self.reflected)

    def patches_on(self, surfaces: Surfaces) -> Patches:
        """The patches on the surfaces of the scene. Call `check` first."""
        cells = Cells(surfaces, self.child, self.prim, self.corner)
        leaf = cells.leaves
        patch = self.cell_patch[leaf]
        order = np.argsort(patch, kind="stable")
        area = cells.areas(leaf)
        start = np.searchsorted(patch[order], np.arange(len(self) + 1))
        return Patches(
            cells, leaf[order], start, self.cell_patch, area[order],
            np.bincount(patch, area, minlength=len(self)).astype(np.float64),
        )  # fmt: skip

    def check(self, surfaces: Surfaces, scene: object = None) -> None:
        """Raises `FileError` unless this was solved for these very surfaces."""
        cells = Cells(surfaces, self.child, self.prim, self.corner)
        fits = self.prim.max() + 1 == len(surfaces) and digest_of(surfaces) == self.digest
        if not fits or (self.cell_patch[cells.leaves] < 0).any():
            raise FileError(
                "the solution is of another scene, or the scene's shapes have changed since",
                file=scene,
                remedy="solve it again: lambent solve SCENE -o FILE",
            )

    def balance(self, surfaces: Surfaces) -> dict[str, float]:
        """Power in watts, mean of the channels, of all patches: emitted by surfaces, arriving
        directly, reflected, absorbed, and what leaves the scene after at least one reflection.
        """
        area = np.repeat(self.patches_on(surfaces).area, 2)[:, None]

        def watts(x: Any) -> float:
            return float((area * np.asarray(x, np.float64)).sum() / 3)

        absorbed = np.where(self.live[:, None], (1 - self.reflectance) * self.irradiance, 0)
        arrives = watts(np.where(self.live[:, None], self.direct, 0))
        return {
            "emitted": watts(self.emission),
            "direct": arrives,
            "reflected": watts(self.reflected),
            "absorbed": watts(absorbed),
            "escaped": arrives - watts(absorbed),
        }

    # ------------------------------------------------------- as a solution

    def facts(self) -> dict[str, str]:
        """Patches, solver, residual, error, time."""
        found = {
            "patches": f"{len(self):,}",
            "faces": f"{int(self.live.sum()):,} see light",
            "solver": f"{self.settings.get('solver')}, step {len(self.history.steps)}",
        }
        if self.history.residuals:
            found["residual"] = f"{self.history.residuals[-1]:.1e}"
        if self.error is not None:
            rays = self.settings.get("rays")
            found["error"] = f"{100 * self.error:.1f} % of a patch's indirect light ({rays} rays)"
        return {**found, **super().facts()}

    def numbers(self) -> dict[str, Any]:
        """The same for programs."""
        live = int(self.live.sum())
        return {
            "patches": len(self), "live_faces": live, "error": self.error, **super().numbers()
        }  # fmt: skip

    def residuals(self) -> list[tuple[int, float]]:
        """After each step of the solver, relative to the first light."""
        return list(zip(self.history.steps, self.history.residuals, strict=True))

    def tables(self, scene: Any) -> dict[str, tuple[str, dict[str, float]]]:
        """Sizes of the patches, and where the power goes."""
        surfaces = surfaces_of(scene)
        area = self.patches_on(surfaces).area
        length = np.sqrt(area)
        sizes = {
            "smallest": length.min(), "median": np.median(length), "largest": length.max(),
            "all, area": area.sum(),
        }  # fmt: skip
        power = {_POWER[name]: watts for name, watts in self.balance(surfaces).items()}
        return {"Patches": ("length (area: square)", sizes), "Power": ("watts", power)}

    def packed(self) -> tuple[dict[str, Any], dict[str, bytes]]:
        """Its arrays."""
        card = {
            "geometry": self.digest,
            "patches": len(self),
            "error": self.error,
            "history": vars(self.history),
        }
        return card, {f"{name}.npy": packed_array(getattr(self, name)) for name in _ARRAYS}

    @classmethod
    def from_archive(cls, archive: Archive) -> RadiositySolution:
        """From a file's content. Raises `DamagedFileError`."""
        common = card_fields(archive)
        check_card(archive, _CARD)
        card = archive.card
        arrays: dict[str, Any] = arrays_of(archive, _ARRAYS)
        wrong = _wrong_cells(**{name: arrays[name] for name in ("child", "prim", "cell_patch")})
        if not wrong and len(arrays["live"]) != 2 * (int(arrays["cell_patch"].max()) + 1):
            wrong = f"{len(arrays['live'])} faces are not two for each patch"
        history = card["history"]
        if set(history) != set(vars(History())) or len({len(v) for v in history.values()}) != 1:
            wrong = wrong or "the history on its card lacks something"
        if wrong:
            raise DamagedFileError(
                f"is damaged: {wrong}",
                file=archive.path,
                remedy="solve the scene again: lambent solve SCENE -o FILE",
            )
        return cls(
            **arrays,
            **common,
            history=History(**history),
            digest=card["geometry"],
            error=card["error"],
        )


def digest_of(surfaces: Surfaces) -> str:
    """A hash of the geometry: the same shapes give the same."""
    digest = hashlib.sha256(surfaces.kind.tobytes())
    digest.update(surfaces.matrix.astype(np.float32).tobytes())
    digest.update(surfaces.flip.astype(np.int8).tobytes())
    return digest.hexdigest()[:32]


def _wrong_cells(
    child: NDArray[np.int32], prim: NDArray[np.int32], cell_patch: NDArray[np.int32]
) -> str:
    """What is wrong with trees from a file (see `radiosity.patches.Cells`), or "".

    A loop or a number out of range would lead the kernels out of their memory, or nowhere.
    """
    inner = np.flatnonzero(child != -1)
    roots = len(child) - 4 * len(inner)
    first = np.sort(child[inner])
    if roots <= 0 or not np.array_equal(first, roots + 4 * np.arange(len(inner))):
        return "its cells are not the children of one another"
    if (child[inner] <= inner).any():
        return "a cell comes after its children"
    children = child[inner, None] + np.arange(4)
    if (
        not np.array_equal(prim[:roots], np.arange(roots))
        or (prim[children] != prim[inner, None]).any()
    ):
        return "its cells belong to other surfaces than their parents"
    if (cell_patch < -1).any() or (cell_patch[inner] != -1).any() or cell_patch.max() < 0:
        return "its cells belong to no patch"
    if len(np.unique(cell_patch[cell_patch >= 0])) != int(cell_patch.max()) + 1:
        return "it has patches without cells"
    return ""
