"""Patch distances and the weights of non-local means, offset by offset.

For each offset o of the search window the distance of the patches around p and p + o,

    D_o(p) = mean over t in the patch, over channels c, of δ_c(p + t, p + t + o),

is one image: a kernel for δ, then a box mean along the rows, then along the columns
(Buades, Coll and Morel, "A non-local algorithm for image denoising", 2005, made O(1) in the patch
as in Darbon et al. 2008). The patch has ``2·patch + 1`` pixels a side.

Only pairs with both pixels inside the image count in the mean. A pixel that is not finite adds no
distance to the patches around it, and gets no weight.

`patch_distances` and `nlm_weights` give the images one after the other to whoever wants to sum
something with them (NLM, NFOR, StatMC); `nlm_mean` is the weighted mean.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.kernels.arrays import (
    FloatImage,
    Layout,
    Plane,
    Planes,
    backend,
    constants,
    valid_pixels,
)
from lambent.kernels.exponential import exp_weight
from lambent.kernels.extremes import greater, smaller
from lambent.kernels.window import WeightedSums

#: ``difference(p, q, vp, vq, numbers)``: one value a pixel from the guide and its variance there
#: and at the neighbour (lists of ``Float``; the variances are [] where the guide has none).
Difference = Callable[[list[Any], list[Any], list[Any], list[Any], list[Any]], Any]

#: Offsets that go through one launch of each kernel: few, so that their planes stay in the cache.
_BATCH = 4


def squared_difference(
    p: list[Any], q: list[Any], vp: list[Any], vq: list[Any], k: list[Any]
) -> Any:
    """Mean over channels of (u_p - u_q)²·k₀ - k₁: Buades 2005 with a uniform noise level.

    k₀ = 1/h², k₁ = 2σ²/h² takes the noise's own part out.
    """
    import drjit as dr

    total: Any = None
    for a, b in zip(p, q, strict=True):
        step = a - b
        total = step * step if total is None else dr.fma(step, step, total)
    return dr.fma(total, k[0] * (1.0 / len(p)), -k[1])


def variance_difference(
    p: list[Any], q: list[Any], vp: list[Any], vq: list[Any], k: list[Any]
) -> Any:
    """Rousselle et al. 2012, mean over channels.

    ((u_p - u_q)² - α (v_p + min(v_p, v_q))) / (ε + k² (v_p + v_q));  k₀ = k², k₁ = α, k₂ = ε.
    """
    import drjit as dr

    total: Any = None
    for a, b, va, vb in zip(p, q, vp, vq, strict=True):
        step = a - b
        above = dr.fma(step, step, -k[1] * (va + smaller(va, vb)))
        term = above / dr.fma(k[0], va + vb, k[2])
        total = term if total is None else total + term
    return total * (1.0 / len(p))


@dataclass(frozen=True, eq=False)
class PatchSearch:
    """What a search over patches works on: made once, then asked offset by offset.

    ``layout`` has a border of ``2·radius + patch + 2``. ``mask`` is 1 at pixels that take part.
    """

    layout: Layout
    radius: int
    patch: int
    guide: Planes
    variance: Planes | None
    mask: Planes
    columns: Plane
    rows: Plane
    difference: Difference
    numbers: tuple[float, ...]
    module: Any

    @classmethod
    def of(
        cls,
        guide: NDArray[Any],
        variance: NDArray[Any] | None,
        radius: int,
        patch: int,
        difference: Difference = variance_difference,
        numbers: Sequence[float] = (0.45**2, 1.0, 1e-10),
        valid: NDArray[Any] | None = None,
        device: str = "auto",
    ) -> PatchSearch:
        """A search over ``guide`` ``(H, W, G)`` with its ``variance`` (same shape, or None).

        ``radius`` of the search window and ``patch`` in pixels; ``difference`` a module-level
        function with its ``numbers``; ``valid`` ``(H, W)``: 0 at pixels to leave out.
        """
        module = backend(device)
        height, width = guide.shape[:2]
        layout = Layout(height, width, 2 * radius + patch + 2)
        mask = valid_pixels(guide, variance)
        if valid is not None:
            mask = mask * valid
        return cls(
            layout,
            radius,
            patch,
            Planes.of(guide, layout, module),
            None if variance is None else Planes.of(variance, layout, module),
            Planes.of(mask, layout, module),
            *_coordinates(layout, patch + radius + 1, module),
            difference,
            tuple(numbers),
            module,
        )

    def batches(self) -> Iterator[list[tuple[int, int]]]:
        """All offsets (dx, dy) of the window, in groups of one launch, row by row.

        Every row is cut at the same dx: kernels are compiled for the alignment of their loads.
        """
        reach = range(-self.radius, self.radius + 1)
        for dy in reach:
            for start in range(0, len(reach), _BATCH):
                yield [(dx, dy) for dx in reach[start : start + _BATCH]]

    def row_means(self, offsets: Sequence[tuple[int, int]], extend: int = 0) -> list[Plane]:
        """δ averaged along the patch's rows: a `Plane` for each offset.

        ``extend``: rows above and below the image for which distances are wanted.
        """
        import drjit as dr

        inner = extend + self.patch
        outer = inner + 1
        variance = self.variance
        knobs = constants(self.numbers, self.module)
        p, mask = self.guide.views(extend=outer), self.mask.view(0, extend=outer)
        vp = [] if variance is None else variance.views(extend=outer)
        raw = []
        for dx, dy in offsets:
            q = self.guide.views(dx, dy, outer)
            vq = [] if variance is None else variance.views(dx, dy, outer)
            both = mask * self.mask.view(0, dx, dy, outer)
            raw.append(self.difference(p, q, vp, vq, knobs) * both)
        dr.eval(raw)
        planes = [Plane(self.layout, outer, d, self.module) for d in raw]
        taps = range(-self.patch, self.patch + 1)
        along = _means(
            [[plane.view(t, 0, inner) for t in taps] for plane in planes],
            self.columns.view(extend=inner),
            [self._ends(dx, self.layout.width) for dx, _ in offsets],
        )
        dr.eval(along)
        return [Plane(self.layout, inner, a, self.module) for a in along]

    def column_views(self, planes: Sequence[Plane], extend: int = 0) -> list[list[Any]]:
        """For each plane of `row_means` the views that the mean along the columns sums."""
        taps = range(-self.patch, self.patch + 1)
        return [[plane.view(0, t, extend) for t in taps] for plane in planes]

    def column_ends(self, dy: int) -> list[Any]:
        """What `mean_along` along the columns needs to know of an offset."""
        return self._ends(dy, self.layout.height)

    def _ends(self, step: int, size: int) -> list[Any]:
        """First and last coordinate with both pixels inside the image, and the patch."""
        first, last = max(0, -step), min(size - 1, size - 1 - step)
        return constants([first, last, self.patch], self.module)


def patch_distances(search: PatchSearch) -> Iterator[tuple[int, int, Any]]:
    """(dx, dy, D): the mean patch distance to the pixel at that offset, for each offset.

    D is an evaluated ``Float`` of ``search.layout.size`` entries; it may be negative where the
    difference takes variance out. Entries whose neighbour lies outside the image mean nothing:
    multiply what comes of them with ``search.mask.view(0, dx, dy)``.
    """
    import drjit as dr

    for batch in search.batches():
        planes = search.row_means(batch)
        rows = search.rows.view()
        ends = [search.column_ends(dy) for _, dy in batch]
        distances = _means(search.column_views(planes), rows, ends)
        dr.eval(distances)
        for (dx, dy), distance in zip(batch, distances, strict=True):
            yield dx, dy, distance


def nlm_weights(search: PatchSearch) -> Iterator[tuple[int, int, Any]]:
    """(dx, dy, w): exp(-max(0, D)) for each offset, 0 where the neighbour does not take part.

    Rousselle et al. 2012. w is an unevaluated ``Float`` of ``layout.size`` entries.
    """

    for dx, dy, distance in patch_distances(search):
        yield dx, dy, exp_weight(-greater(distance, 0.0)) * search.mask.view(0, dx, dy)


def nlm_mean(
    targets: NDArray[Any],
    search: PatchSearch,
    joint: tuple[NDArray[Any], Callable[[list[Any], list[Any], list[Any]], Any]] | None = None,
    numbers: Sequence[float] = (),
) -> FloatImage:
    """The weighted mean of ``targets`` ``(H, W, C)`` with the weights of a search.

    ``joint``: feature planes ``(H, W, G)`` and a module-level function ``(p, q, numbers)`` of them
    that gives a distance; the greater of the two distances decides, which is the smaller of the
    two weights (Rousselle et al. 2013).
    Targets that are not finite take no part. Returns float32 ``(H, W, C)``.
    """
    layout, module = search.layout, search.module
    seen = None if joint is None else Planes.of(joint[0], layout, module)
    also = None if joint is None else joint[1]
    inside = slice(layout.margin_rows, layout.margin_rows + layout.height)
    sound = valid_pixels(targets, None if joint is None else joint[0])
    valid = sound * search.mask.memory[0, inside, : layout.width]
    knobs = constants(numbers, module)
    centre = [] if seen is None else seen.views()
    sums = WeightedSums(targets, valid, layout, module)
    if joint is None and search.difference is squared_difference:
        for batch in search.batches():
            _add_both_ways(search, batch, sums)
        return sums.mean()
    for batch in search.batches():
        weights = []
        for plane, (dx, dy) in zip(search.row_means(batch), batch, strict=True):
            (views,) = search.column_views([plane])
            distance = mean_along(views, search.rows.view(), search.column_ends(dy))
            if seen is not None and also is not None:
                distance = greater(distance, also(centre, seen.views(dx, dy), knobs))
            weights.append((dx, dy, exp_weight(-greater(distance, 0.0))))
        sums.add(weights)
    return sums.mean()


# ------------------------------------------------------------------ private


def _add_both_ways(search: PatchSearch, batch: list[tuple[int, int]], sums: WeightedSums) -> None:
    """Add the weights of some offsets, and of the opposite ones, where the distance is symmetric.

    D_o(p) is the distance of p and p + o, and so D_-o(p) = D_o(p - o): half the distances do.
    """
    import drjit as dr

    half = [(dx, dy) for dx, dy in batch if (dy, dx) >= (0, 0)]
    if not half:
        return
    reach = search.radius + 1  # a step to the left in the last column wraps one row up
    planes = search.row_means(half, reach)
    rows = search.rows.view(extend=reach)
    likenesses = []
    for views, (_, dy) in zip(search.column_views(planes, reach), half, strict=True):
        distance = mean_along(views, rows, search.column_ends(dy))
        likenesses.append(exp_weight(-greater(distance, 0.0)))
    dr.eval(likenesses)
    weights = []
    for likeness, (dx, dy) in zip(likenesses, half, strict=True):
        plane = Plane(search.layout, reach, likeness, search.module)
        weights.append((dx, dy, plane.view()))
        if (dx, dy) != (0, 0):
            weights.append((-dx, -dy, plane.view(-dx, -dy)))
    sums.add(weights)


def _coordinates(layout: Layout, extent: int, module: Any) -> tuple[Plane, Plane]:
    """The column and the row of every entry, as planes."""
    rows, columns = np.mgrid[-extent : layout.height + extent, 0 : layout.stride]
    return (
        Plane(layout, extent, columns.astype(np.float32).reshape(-1), module),
        Plane(layout, extent, rows.astype(np.float32).reshape(-1), module),
    )


def mean_along(views: list[Any], place: Any, ends: list[Any]) -> Any:
    """Sum of the views over the number of pairs inside the image, along one axis.

    ``place``: the coordinate of each entry along this axis; ``ends``: from `PatchSearch`.
    """
    import drjit as dr

    total = views[0]
    for view in views[1:]:
        total = total + view
    first, last, reach = ends
    high = smaller(place + reach, last)
    low = greater(place - reach, first)
    return total * dr.rcp(greater(high - low + 1.0, 1.0))


def _means(views: list[list[Any]], place: Any, ends: list[list[Any]]) -> list[Any]:
    return [mean_along(v, place, e) for v, e in zip(views, ends, strict=True)]
