"""The plug-in ``lambent_radiosity``: pictures of a solved scene from any camera, in any script.

After ``import lambent.transport.radiosity.integrator`` (with a variant set) a scene may say::

    <integrator type="lambent_radiosity">
        <string name="solution" value="room.lambent"/>
        <string name="show" value="gather"/>
    </integrator>

``show`` is one of `lambent.transport.radiosity.settings.SHOWS`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lambent.errors import OptionError
from lambent.transport.diffuse import lit_side, reflectance
from lambent.transport.jit import dr, mi
from lambent.transport.methods import checked_show
from lambent.transport.radiosity.light import arriving, met_by_ray
from lambent.transport.radiosity.settings import SHOWS
from lambent.transport.radiosity.smooth import at_vertices, vertices_of
from lambent.transport.radiosity.solution import RadiositySolution
from lambent.transport.solution import open_solution
from lambent.transport.surfaces import NOWHERE, TRIANGLE, surfaces_of
from lambent.transport.warps import cosine_hemisphere


class RadiosityView(mi.SamplingIntegrator):  # type: ignore[misc]
    """Shows a `RadiositySolution`; see the module. Properties: ``solution`` (path), ``show``."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.show = checked_show(str(props.get("show", "smooth")), SHOWS)
        path = props.get("solution", None)
        self.solution: Any = None if path is None else open_solution(str(path), "radiosity")
        self._ready_for: Any = None

    @classmethod
    def of(cls, solution: RadiositySolution, show: str = "smooth") -> RadiosityView:
        """Of a solution in memory."""
        properties = mi.Properties()
        properties["show"] = show
        made = cls(properties)
        made.solution = solution
        return made

    def update(self, solution: RadiositySolution) -> None:
        """Show another state of the same patches, without compiling anything anew."""
        self.solution = solution
        if self._ready_for is not None:
            self._fill()

    def sample(
        self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
    ) -> Any:
        """Radiance along rays."""
        self.prepare(scene)
        si = scene.ray_intersect(mi.Ray3f(ray), +mi.RayFlags.All, mi.Bool(True), active)
        valid = si.is_valid() & active
        value = self._irradiance(si, ray, self.show, valid)
        if self.show == "residual":
            return value * dr.inv_pi, valid, []
        if self.show == "gather":
            value = self._gather(scene, sampler, si, valid)
        shine = mi.Color3f(1) if self.show == "irradiance" else reflectance(si, valid)
        shine = dr.select(lit_side(si) & valid, shine, 0)
        emitted = dr.select(active, si.emitter(scene).eval(si, active), 0)
        if self.show == "irradiance":
            emitted = mi.Color3f(0)
        radiance = emitted + shine * value * dr.inv_pi
        if self.show == "mesh":
            radiance *= self._outline(si, valid)
        return radiance, valid, []

    def prepare(self, scene: Any) -> None:
        """Bring the solution into Dr.Jit's memory, once for a scene."""
        if self._ready_for is scene:
            return
        solution = self.solution
        if solution is None:
            raise OptionError(
                "lambent_radiosity has no solution to show",
                remedy='give its file: <string name="solution" value="room.lambent"/>',
            )
        surfaces = surfaces_of(scene)
        solution.check(surfaces)
        patches = solution.patches_on(surfaces)
        self._tree = patches.cells.table()
        self._cell_patch = mi.Int32(patches.cell_patch)
        self._cell_prim = mi.UInt32(patches.cells.prim.astype(np.uint32))
        self._patches, self._vertices = patches, vertices_of(patches)
        self._corner = mi.Int32(self._vertices.corner.ravel())
        self._fill()
        self._ready_for = scene

    def at(self, prim: Any, ab: Any, side: int) -> Any:
        """Irradiance ``(N, 3)`` at parameters ``ab`` ``(N, 2)`` of primitives, on a side."""
        cell, a, b = self._tree.descend(
            mi.UInt32(prim.astype(np.uint32)),
            mi.Float(ab[:, 0].astype(np.float32)),
            mi.Float(ab[:, 1].astype(np.float32)),
        )
        sides = dr.full(mi.UInt32, side, len(prim))
        return np.array(self._smooth("irradiance", cell, a, b, sides, mi.Bool(True))).T

    def patch_at(self, prim: Any, ab: Any) -> Any:
        """The patch ``(N,)`` at parameters of primitives."""
        cell, _, _ = self._tree.descend(
            mi.UInt32(prim.astype(np.uint32)),
            mi.Float(ab[:, 0].astype(np.float32)),
            mi.Float(ab[:, 1].astype(np.float32)),
        )
        return dr.gather(mi.Int32, self._cell_patch, cell).numpy()

    def to_string(self) -> str:
        """For ``print``."""
        return f"RadiosityView[show = {self.show}]"

    # --------------------------------------------------------------- private

    def _fill(self) -> None:
        """The values of the faces and of the vertices."""
        solution, patches, vertices = self.solution, self._patches, self._vertices
        known = solution.live.astype(float)
        self._face, self._vertex = {}, {}
        for name in ("irradiance", "indirect", "residual"):
            values = np.asarray(getattr(solution, name), np.float64)
            if name == "residual":
                values = np.abs(values)
            self._face[name] = mi.Float(values.astype(np.float32).ravel())
            both = [
                at_vertices(vertices, patches, values[side::2], known[side::2]) for side in (0, 1)
            ]
            table = np.stack(both, axis=1).astype(np.float32)
            self._vertex[name] = mi.Float(table.ravel() if table.size else np.zeros(3, np.float32))

    def _where(self, si: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """(cell, a, b, known) of what is seen."""
        cell, a, b = self._tree.find(si.shape, si.prim_index, si.p, active)
        known = active & (cell != NOWHERE)
        return dr.select(known, cell, 0), a, b, known

    def _irradiance(self, si: Any, ray: Any, show: str, active: Any) -> Any:
        cell, a, b, known = self._where(si, active)
        prim = dr.gather(mi.UInt32, self._cell_prim, cell, known)
        normal = self._tree.surfaces.normal(prim, si.p)
        side = dr.select(dr.dot(normal, mi.Vector3f(ray.d)) > 0, mi.UInt32(1), 0)
        name = show if show in ("residual", "indirect") else "irradiance"
        if show in ("patch", "mesh", "residual"):
            patch = dr.gather(mi.Int32, self._cell_patch, cell, known)
            known &= patch >= 0
            face = 2 * mi.UInt32(patch) + side
            found = dr.gather(mi.Color3f, self._face[name], face, known)
            return dr.select(known, found, mi.Color3f(0))
        return self._smooth(name, cell, a, b, side, known)

    def _smooth(self, name: str, cell: Any, a: Any, b: Any, side: Any, known: Any) -> Any:
        """Interpolated between the corners of a cell."""
        prim = dr.gather(mi.UInt32, self._cell_prim, cell, known)
        triangle = dr.gather(mi.UInt32, self._tree.surfaces.kind, prim, known) == TRIANGLE
        weights = [
            dr.select(triangle, 1 - a - b, (1 - a) * (1 - b)),
            dr.select(triangle, a, a * (1 - b)),
            dr.select(triangle, b, (1 - a) * b),
            dr.select(triangle, 0, a * b),
        ]
        found = mi.Color3f(0)
        for k, weight in enumerate(weights):
            vertex = dr.gather(mi.Int32, self._corner, 4 * cell + k, known)
            there = known & (vertex >= 0)
            value = dr.gather(mi.Color3f, self._vertex[name], 2 * mi.UInt32(vertex) + side, there)
            found += dr.select(there, weight * value, 0)
        return found

    def _gather(self, scene: Any, sampler: Any, si: Any, active: Any) -> Any:
        """Irradiance: direct light by samples, here and where one cosine-weighted ray ends.

        Only indirect light is the solution's there. Direct light has the edges that patches cannot
        show: read off the solution, it made the error of a room with windows five times as large
        (2.0e-3 in place of 4e-4, at 20,000 patches).
        """
        at = _lit_point(si)
        direct = arriving(scene, at, sampler.next_2d(), active, beside_ray=True)
        wo = cosine_hemisphere(*sampler.next_2d())
        cosine = mi.Float(wo.z)
        wo.z *= dr.sign(si.wi.z)
        ray = si.spawn_ray(si.to_world(wo))
        there = scene.ray_intersect(ray, +mi.RayFlags.All, mi.Bool(False), active)
        direct += met_by_ray(scene, at, there, cosine, active)
        hit = active & there.is_valid()
        beyond = arriving(scene, _lit_point(there), sampler.next_2d(), hit)
        beyond += self._irradiance(there, ray, "indirect", hit)
        shine = dr.select(hit & lit_side(there), reflectance(there, hit), 0)
        return direct + shine * beyond

    def _outline(self, si: Any, active: Any) -> Any:
        """Darker near the sides of a cell."""
        _, a, b, known = self._where(si, active)
        near = mi.Float(0.05)
        edge = (a < near) | (b < near) | (1 - a - b < near)
        edge_square = (a < near) | (b < near) | (a > 1 - near) | (b > 1 - near)
        cell, _, _, _ = self._where(si, active)
        prim = dr.gather(mi.UInt32, self._cell_prim, cell, known)
        triangle = dr.gather(mi.UInt32, self._tree.surfaces.kind, prim, known) == TRIANGLE
        dark = known & dr.select(triangle, edge, edge_square)
        return dr.select(dark, mi.Float(0.35), mi.Float(1))


def _lit_point(si: Any) -> Any:
    """The point of a surface interaction, with the normal of the side that is seen."""
    at = dr.zeros(mi.Interaction3f, dr.width(si.p))
    at.p, at.n = si.p, mi.Normal3f(si.sh_frame.n * dr.sign(si.wi.z))
    return at


mi.register_integrator("lambent_radiosity", lambda props: RadiosityView(props))
