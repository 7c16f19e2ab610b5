"""Cameras at random in scenes that somebody made, where there is something to see.

The scene's own camera stands in free space. Rays from it end on things; a point on the way to such
an end, before it, is free space, too. From there a camera looks at another such end. A coarse grid
of rays says how near things are, and how many are seen; views of one wall, from inside a thing or
into the void are dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from lambent.errors import OptionError
from lambent.scenes.mitsuba.geometry import Array

_GRID = (9, 13)
_TRIES = 120


class Cameras:
    """Random cameras in a loaded scene, chosen by a seed: `at`."""

    def __init__(self, mi: Any, scene: Any) -> None:
        params = mi.traverse(scene.sensors()[0])
        if "x_fov" not in params:
            raise OptionError("its sensor is not a perspective camera")
        self.mi, self.scene = mi, scene
        self.home = np.array(params["to_world"].matrix, float).reshape(4, 4)
        self.fov = float(np.array(params["x_fov"]).ravel()[0])
        self.up = self._upright()
        self.reach = 1.0
        self._ends = self._seen()

    def at(self, seed: int, count: int) -> list[tuple[Array, float]]:
        """``to_world (4, 4)`` and field of view in degrees of ``count`` cameras, the home included
        where too few others are good."""
        random = np.random.Generator(np.random.PCG64(seed))
        origin, ends, reach = self.home[:3, 3], self._ends, self.reach
        if len(ends) < 8:
            return [(self.home, self.fov)] * count
        a, b = ends[random.integers(len(ends), size=(2, _TRIES))]
        places = origin + (a - origin) * random.uniform(0.0, 0.8, (_TRIES, 1))
        views = [_look_at(p, t, self.up) for p, t in zip(places, b, strict=True)]
        lengths = np.exp(random.uniform(np.log(16), np.log(60), _TRIES))
        fovs = np.degrees(2 * np.arctan(18 / lengths))
        rays = zip(*self._rays(np.array(views), fovs), strict=True)
        found = []
        for matrix, fov, (stops, shapes, front) in zip(views, fovs, rays, strict=True):
            score = _score(np.linalg.norm(stops - matrix[:3, 3], axis=1), shapes, front, reach)
            if score > 0:
                found.append((score, matrix, float(fov)))
        found.sort(key=lambda f: -f[0])
        kept: list[tuple[Array, float]] = []
        for apart in (0.3, 0.1, 0.0):  # first well apart, then whatever is left
            for _, matrix, fov in found:
                if len(kept) < count and all(_distance(matrix, m, reach) > apart for m, _ in kept):
                    kept.append((matrix, fov))
        return kept + [(self.home, self.fov)] * (count - len(kept))

    def _seen(self) -> Array:
        """Where rays from the home camera end ``(N, 3)``; sets ``reach``, how far that is."""
        origin = self.home[:3, 3]
        # The home camera sees a part of the scene; turned about the vertical, more of it.
        views = np.stack([self.home] * 3)
        for view, angle in zip(views, np.radians((0, -50, 50)), strict=True):
            view[:3, :3] = _about(self.up, angle) @ view[:3, :3]
        ends = self._rays(views, np.full(3, 75.0))[0].reshape(-1, 3)
        ends = ends[np.isfinite(ends).all(1)]
        if len(ends):
            self.reach = float(np.median(np.linalg.norm(ends - origin, axis=1)))
        return ends

    def _upright(self) -> Array:
        """The axis that is up: the one next to the home camera's up."""
        up = self.home[:3, 1]
        axis = np.zeros(3)
        k = int(np.abs(up).argmax())
        axis[k] = np.sign(up[k])
        return axis

    def _rays(self, views: Array, fovs: Array) -> tuple[Array, Array, Array]:
        """Where a grid of rays of each of the ``views (K, 4, 4)`` ends ``(K, N, 3)``, what shape is
        there ``(K, N)``, and whether its front is seen; nan, 0 and false where nothing is hit."""
        import drjit as dr

        mi = self.mi
        rows, columns = _GRID
        y, x = np.meshgrid(
            np.linspace(0.55, -0.55, rows), np.linspace(-0.95, 0.95, columns), indexing="ij"
        )
        half = np.tan(np.radians(fovs) / 2)[:, None]
        d = np.stack([x.ravel() * half, y.ravel() * half, np.ones((len(views), x.size))], -1)
        d = np.einsum("kij,knj->kni", views[:, :3, :3], d).reshape(-1, 3)
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        origins = np.repeat(views[:, :3, 3], x.size, 0)
        ray = mi.Ray3f(
            mi.Point3f(np.ascontiguousarray(origins.T, np.float32)),
            mi.Vector3f(np.ascontiguousarray(d.T, np.float32)),
        )
        hit = self.scene.ray_intersect(ray)
        valid, front = hit.is_valid(), dr.dot(hit.n, ray.d) < 0
        shapes = dr.reinterpret_array(mi.UInt32, hit.shape)
        dr.eval(hit.p, valid, front, shapes)
        seen = np.array(valid)
        ends = np.array(hit.p).reshape(3, -1).T.astype(np.float64)
        ends[~seen] = np.nan
        shape = len(views), x.size
        return (
            ends.reshape(*shape, 3),
            np.where(seen, np.array(shapes), 0).reshape(shape),
            (np.array(front) & seen).reshape(shape),
        )


class WholePlaces:
    """Cameras of a whole scene, as a data set asks for them; in a clip each drifts and turns."""

    def __init__(self, cameras: list[tuple[Array, float]], seed: int, reach: float) -> None:
        self._cameras, self._seed, self._reach = cameras, seed, reach

    def animation(self, camera: int) -> Callable[[float], Any]:
        """Where the camera is in each frame."""
        from lambent.render.animation import Pose

        random = np.random.Generator(np.random.PCG64([self._seed, camera]))
        start = self._cameras[camera][0]
        drift = random.normal(0, 0.012, 3) * self._reach
        turn = np.radians(random.normal(0, 0.7))

        def pose(frame: float) -> Pose:
            matrix = start.copy()
            matrix[:3, 3] += start[:3, :3] @ drift * frame
            matrix[:3, :3] = start[:3, :3] @ _about(np.array([0.0, 1, 0]), turn * frame)
            return Pose(matrix)

        return pose

    def lens(self, camera: int) -> Mapping[str, float]:
        """The file's own."""
        return {}

    def fov(self, camera: int) -> float:
        """Degrees across the picture."""
        return self._cameras[camera][1]

    def medium(self, camera: int) -> None:
        """All cameras stand where the file's does."""


# ------------------------------------------------------------------- private


def _score(distance: Array, shapes: Array, front: Array, reach: float) -> float:
    """How much there is to see, by the rays of one view; 0 for a view that is no good."""
    hit = np.isfinite(distance)
    if hit.mean() < 0.45 or front[hit].mean() < 0.7:
        return 0.0
    ends = distance[hit]
    if (ends < 0.06 * reach).mean() > 0.05 or np.median(ends) < 0.12 * reach:
        return 0.0
    _, counts = np.unique(shapes[hit], return_counts=True)
    share = counts / len(shapes)
    if len(counts) < 2 or share.max() > 0.9:
        return 0.0
    spread = -float((share * np.log(share)).sum())
    depth = float(np.log(np.percentile(ends, 90) / np.percentile(ends, 10)))
    return spread + 0.3 * min(depth, 2)


def _look_at(origin: Array, target: Array, up: Array) -> Array:
    forward = target - origin
    forward = forward / max(float(np.linalg.norm(forward)), 1e-9)
    if abs(forward @ up) > 0.98:
        up = np.roll(up, 1)
    left = np.cross(up, forward)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = left, np.cross(forward, left), forward
    matrix[:3, 3] = origin
    return matrix


def _about(axis: Array, angle: float) -> Array:
    """A rotation ``(3, 3)``, by Rodrigues' formula."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def _distance(a: Array, b: Array, reach: float) -> float:
    turn = 1 - float(a[:3, 2] @ b[:3, 2])
    return turn + float(np.linalg.norm(a[:3, 3] - b[:3, 3])) / reach
