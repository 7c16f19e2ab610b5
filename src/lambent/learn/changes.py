"""What may be done to rendered pictures so that they are other rendered pictures.

Every change is made to all rows of a batch at once, to noisy frame and target alike, and each is
something that a renderer could have produced: a mirrored or turned picture, another exposure,
coloured light, channels in another order, paler or tinted textures (colour and albedo together:
light that has left the surface once is proportional to its albedo). Normals get one random
rotation, since the network must not know which way is up. Lamps and pixel filters are in
`learn.lamps` and `learn.splat`; and there are

- **paint**: all surfaces get another texture. Colour, target and albedo are multiplied by one
  picture, since light that has left the surface once is proportional to the albedo;
- **shadows**: blinds, leaves, window frames, spots of light. Colour and target are multiplied by a
  pattern that no feature knows of, so that the network learns to find edges in the light itself;
- **relief**: surfaces get bumps, panels and folds. The normals are bent, and colour and target
  multiplied by what that changes under made-up lights: structure that normals alone tell of;
- **collage**: the crop, turned round, is laid over itself through a pattern of leaves, grids or
  discs: fine silhouettes, where every layer changes at once;
- **shrinking**: some batches are four times as many crops at half their size. Four pixels together
  are a pixel of the smaller picture with four times the samples, noisy picture and target alike.
  That is exact, and it is where crops of 64 to 1,024 samples come from, which are dear to render;
- **thinning**: of the samples of a crop some are dropped and the others weigh more, as if the
  renderer had drawn one lamp of several, or ended paths by chance. The mean stays, the noise grows,
  and at few samples there are pixels without light, as Cycles has them and Mitsuba has not;
- **haze**: some samples end in thin fog, before they reach a surface, with fog's light and fog's
  features. At few samples the albedo is then speckled, and where it is dark the light is not: what
  is divided by it is no light on a surface any more.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from lambent.denoise.inputs import MASKS
from lambent.learn.rows import AT, MEANS, NAMES, Rows, random

#: Exposure varies by up to so many stops either way.
STOPS = 2.0
#: Standard deviation of the logarithm of the gain of each channel: coloured light.
TINT = 0.2
#: Shares of the rows that keep all layers; albedo and normal, as most renderers write them; none.
#: Where layers are few there is more to learn.
ALL, PLAIN, COLOUR = 0.33, 0.25, 0.2
#: Share of the rows whose samples are not told.
UNTOLD = 0.5
#: Share of the rows that get another texture, and another pattern of light.
PAINTED, SHADED = 0.3, 0.3
#: Share of the rows that get a relief, and of those that are laid over themselves.
EMBOSSED, COLLAGED = 0.3, 0.2
#: Share of the rows whose samples are thinned, and the shares of samples that are kept.
THINNED, KEPT = 0.3, (0.15, 0.9)
#: Share of the rows in thin fog, and the shares of samples that end in it.
HAZED, IN_FOG = 0.15, (0.005, 0.15)


def shrunk(rows: Rows) -> Rows:
    """At half size: 2x2 pixels are one, with four times the samples.

    What is independent averages: a deviation of the mean of four means is half of their mean
    square's root.
    """
    planes = F.avg_pool2d(rows.planes, 2)
    deviations = slice(MEANS.stop, None)
    planes[:, deviations] = F.avg_pool2d(rows.planes[:, deviations] ** 2, 2).sqrt() / 2
    target = F.avg_pool2d(rows.target, 2)
    target[:, 3:] = F.avg_pool2d(rows.target[:, 3:] ** 2, 2).sqrt() / 2
    return Rows(planes, rows.there, target, 4 * rows.spp)


def turned(rows: Rows, rng: torch.Generator) -> Rows:
    """Mirrored and turned by quarters; normals rotated at random (half of the time)."""
    size = len(rows.planes)
    dice = random(size, 3, rng) < 0.5
    both = torch.cat([rows.planes, rows.target], 1)
    for axis in (2, 3):
        both = torch.where(dice[:, axis - 2, None, None, None], both.flip(axis), both)
    both = torch.where(dice[:, 2, None, None, None], both.transpose(2, 3), both)
    count = rows.planes.shape[1]
    rows = Rows(both[:, :count], rows.there, both[:, count:], rows.spp)
    q = rotations(size, rng)
    turn = random(size, 1, rng)[:, :, None] < 0.5
    q = torch.where(turn, q, torch.eye(3, device=q.device))
    normal = rows.layer("normal").flatten(2)
    rows.planes[:, AT["normal"]] = torch.bmm(q, normal).unflatten(2, both.shape[2:])
    return rows


def cut(rows: Rows, side: int, rng: torch.Generator) -> Rows:
    """A square of each row, somewhere; all of it where it is smaller."""
    height, width = rows.planes.shape[2:]
    tall, wide = min(side, height), min(side, width)
    places = random(len(rows.planes), 2, rng).tolist()
    corners = [(int(y * (height - tall + 1)), int(x * (width - wide + 1))) for y, x in places]
    planes, target = (
        torch.stack(
            [p[:, y : y + tall, x : x + wide] for p, (y, x) in zip(of, corners, strict=True)]
        )
        for of in (rows.planes, rows.target)
    )
    return Rows(planes, rows.there, target, rows.spp)


def exposed(rows: Rows, stops: float, rng: torch.Generator) -> None:
    """Another exposure by up to so many stops, and channels in another order, of rows with lobes.

    One gain and one order for all radiance of a row: its parts still sum to its colour.
    """
    size = len(rows.planes)
    gain = torch.exp2((random(size, 1, rng) * 2 - 1) * stops)[:, :, None, None]
    swap = torch.argsort(random(size, 3, rng), 1)[:, :, None, None]
    swap = swap.expand(-1, -1, *rows.planes.shape[2:])
    for planes, of in (
        (rows.planes, slice(0, 3)), (rows.planes, AT["albedo"]), (rows.planes, AT["diffuse"]),
        (rows.planes, AT["diffuse_albedo"]), (rows.target, slice(0, 3)), (rows.target, slice(4, 7)),
    ):  # fmt: skip
        planes[:, of] = planes[:, of].gather(1, swap)
    rows.planes[:, :3] *= gain
    for name in ("colour_std", "diffuse", "diffuse_std", "specular_std"):
        rows.planes[:, AT[name]] *= gain
    rows.target *= gain


def thinned(rows: Rows, rng: torch.Generator) -> None:
    """Each sample is kept with a chance p, and then weighs 1 / p: the same light, more noise.

    Of a pixel's n samples only the mean c and its variance σ² are known: k ~ B(n, p) of them are
    kept, with that mean. c' = c k / (n p) then has the variance σ² + (μ² + σ²) (1 - p) / (n p),
    which is told as k / (n p) (σ² + c² (1 - p) / (n p)): the same in the mean, and none where no
    sample has light, as a renderer would say.
    """
    size = len(rows.planes)
    p = log_uniform(random(size, 1, rng), KEPT)[:, :, None, None]
    n = rows.spp.round().clamp_min(1)[:, None, None, None]
    shape = (size, 1, *rows.planes.shape[2:])
    kept = torch.binomial(n.expand(shape).contiguous(), p.expand(shape).contiguous(), generator=rng)
    share = kept / (n * p)
    colour, spread = rows.planes[:, :3], rows.layer("colour_std")
    squares = (colour * colour).mean(1, keepdim=True)
    told = share * (spread * spread + squares * (1 - p) / (n * p))
    rows.planes[:, AT["colour_std"]] = told.sqrt()
    rows.planes[:, :3] = colour * share


def hazed(rows: Rows, rng: torch.Generator) -> None:
    """A share q of the samples ends in fog of radiance f, of which one sample says no more than
    that its light is drawn from an exponential distribution around f.

    Of a pixel's n samples k ~ B(n, q) do: c' = (1 - k/n) c + k/n f G with G ~ Γ(k, 1/k), features
    likewise, with one value each for the fog; the target is (1 - q) r + q f.
    """
    size = len(rows.planes)
    dice = random(size, 4, rng)
    q = log_uniform(dice[:, :1], IN_FOG)[:, :, None, None]
    n = rows.spp.round().clamp_min(1)[:, None, None, None]
    shape = (size, 1, *rows.planes.shape[2:])
    k = torch.binomial(n.expand(shape).contiguous(), q.expand(shape).contiguous(), generator=rng)
    share, some = k / n, k.clamp_min(1)
    spread = share * (1 - share) / (n - 1).clamp_min(1)
    stops = (dice[:, 1] * 6 - 2)[:, None, None, None]
    tint = torch.exp(0.2 * torch.randn(size, 3, 1, 1, generator=rng, device=rng.device))
    fog = rows.target[:, :3].mean((1, 2, 3), keepdim=True) * torch.exp2(stops) * tint
    light = fog * torch._standard_gamma(some, generator=rng) / some
    colour, noise = rows.planes[:, :3], rows.layer("colour_std")
    step = (light - colour).mean(1, keepdim=True)
    # within the fog, within the rest, between the two: what a renderer's sums of squares say
    own = (some - 1) * fog.mean(1, keepdim=True) ** 2 / (n * (n - 1)).clamp_min(1)
    told = own + (1 - share) * noise**2 + spread * step**2
    rows.planes[:, AT["colour_std"]] = told.sqrt()
    rows.planes[:, :3] = torch.lerp(colour, light, share)
    for name, value in (
        ("albedo", 0.2 * dice[:, 2]), ("normal", torch.zeros(size, device=rng.device)),
        ("roughness", torch.ones(size, device=rng.device)), ("depth", dice[:, 3] - 0.5),
    ):  # fmt: skip
        there, value = rows.layer(name), value[:, None, None, None]
        if f"{name}_std" in AT:
            step = (value - there).abs().mean(1, keepdim=True)
            before = (1 - share) * rows.layer(f"{name}_std") ** 2
            rows.planes[:, AT[f"{name}_std"]] = (before + spread * step**2).sqrt()
        rows.planes[:, AT[name]] = torch.lerp(there, value, share)
    rows.target[:, :3] = torch.lerp(rows.target[:, :3], fog.expand_as(rows.target[:, :3]), q)
    rows.target[:, 3:] *= 1 - q


def recoloured(rows: Rows, rng: torch.Generator) -> None:
    """Another exposure, coloured light, channels in another order, paler or tinted textures."""
    size, dev = len(rows.planes), rows.planes.device
    order = torch.argsort(random(size, 3, rng), 1)
    keep = random(size, 1, rng) < 0.5
    order = torch.where(keep, order, torch.arange(3, device=dev))
    stops = (random(size, 1, rng) * 2 - 1) * STOPS
    gain = torch.exp2(stops) * torch.exp(TINT * torch.randn(size, 3, generator=rng, device=dev))
    paint = random(size, 3, rng) * 0.7 + 0.3
    paint = torch.where(random(size, 1, rng) < 0.5, paint, 1.0)
    paint = torch.where(rows.there[:, :1] > 0, paint, 1.0)
    gain = gain * paint
    swap = order[:, :, None, None].expand(-1, -1, *rows.planes.shape[2:])
    scale, grey = gain[:, :, None, None], gain.mean(1)[:, None, None, None]
    rows.planes[:, :3] = rows.planes[:, :3].gather(1, swap) * scale
    rows.target[:, :3] = rows.target[:, :3].gather(1, swap) * scale
    rows.target[:, 3:] *= grey
    rows.planes[:, AT["colour_std"]] *= grey
    rows.planes[:, AT["albedo"]] = rows.layer("albedo").gather(1, swap) * paint[:, :, None, None]
    rows.planes[:, AT["albedo_std"]] *= paint.mean(1)[:, None, None, None]
    depth = rows.layer("depth")
    shift = 0.1 * torch.randn(size, 1, 1, 1, generator=rng, device=dev)
    rows.planes[:, AT["depth"]] = torch.where(depth >= 1, depth, (depth + shift).clamp(-1, 1))


def painted(rows: Rows, rng: torch.Generator) -> None:
    """Another texture on everything that has an albedo: albedo and light multiplied alike."""
    size = len(rows.planes)
    height, width = rows.planes.shape[2:]
    first, second = pattern(2 * size, height, width, rng).chunk(2)
    tints = random(size, 6, rng)
    a, b = (tints[:, i : i + 3, None, None] * 0.8 + 0.2 for i in (0, 3))
    grey = random(size, 1, rng)[:, :, None, None] < 0.5
    a, b = (torch.where(grey, t.mean(1, keepdim=True), t) for t in (a, b))
    coarse = random(size, 1, rng)[:, :, None, None] < 0.5
    mix = torch.where(coarse, first * second, first)
    paint = a * mix + b * (1 - mix)
    paint = torch.where(rows.there[:, :1, None, None] > 0, paint, 1.0)
    rows.planes[:, :3] *= paint
    rows.target[:, :3] *= paint
    grey_paint = paint.mean(1, keepdim=True)
    rows.target[:, 3:] *= grey_paint
    rows.planes[:, AT["colour_std"]] *= grey_paint
    rows.planes[:, AT["albedo"]] *= paint
    rows.planes[:, AT["albedo_std"]] *= grey_paint


def shaded(rows: Rows, rng: torch.Generator) -> None:
    """Another pattern of light: colour and target multiplied by what no feature shows."""
    size = len(rows.planes)
    height, width = rows.planes.shape[2:]
    dark = torch.exp2(-random(size, 1, rng) * 4)[:, :, None, None]
    bright = torch.exp2(random(size, 1, rng) * 3)[:, :, None, None]
    light = dark + (bright - dark) * pattern(size, height, width, rng)
    tint = torch.exp(0.15 * torch.randn(size, 3, 1, 1, generator=rng, device=rows.planes.device))
    light = light * tint
    grey = light.mean(1, keepdim=True)
    rows.planes[:, :3] *= light
    rows.planes[:, AT["colour_std"]] *= grey
    rows.target[:, :3] *= light
    rows.target[:, 3:] *= grey


def embossed(rows: Rows, rng: torch.Generator) -> None:
    """A relief on all surfaces: normals are bent, and light changes as E(n') / E(n).

    E is the light that falls on a normal n from around and from two distant lamps,
    a + Σ w max(0, n·l). n is an average of 3x3 pixels: the same factor is for colour and target.
    """
    size, dev = len(rows.planes), rows.planes.device
    height, width = rows.planes.shape[2:]
    dice = random(size, 5, rng)[:, :, None, None]
    panels = pattern(size, height, width, rng)
    bumps = torch.randn(size, 1, 40, 40, generator=rng, device=dev)
    bumps = F.interpolate(bumps, (height, width), mode="bicubic")
    relief = torch.where(dice[:, :1] < 0.6, panels, 0.3 * bumps)
    slopes = [F.pad(relief.diff(dim=axis), pad) for axis, pad in ((2, (0, 0, 0, 1)), (3, (0, 1)))]
    slope = torch.cat(slopes, 1)
    steep = slope.square().sum(1, keepdim=True)
    # bounded: the edge of a panel is a bevel
    slope = slope / (steep + steep.mean((2, 3), keepdim=True) + 1e-8).sqrt()
    slope = slope * log_uniform(dice[:, 1:2], (0.1, 1.0))
    along = rotations(size, rng)[:, :2].transpose(1, 2)  # two directions in space
    bent = torch.bmm(along, slope.flatten(2)).unflatten(2, (height, width))
    normal = rows.layer("normal")
    length = normal.norm(dim=1, keepdim=True)
    there = (length > 0.3) & (rows.there[:, NAMES.index("normal"), None, None, None] > 0)
    mean = F.normalize(F.avg_pool2d(normal, 3, 1, 1, count_include_pad=False), dim=1)
    lamps_at = F.normalize(torch.randn(size, 2, 3, generator=rng, device=dev), dim=2)
    weights = torch.cat([dice[:, 2:3], 0.5 * dice[:, 3:4]], 1)

    def light(n: Tensor) -> Tensor:
        cosines = torch.bmm(lamps_at, n.flatten(2)).unflatten(2, (height, width)).clamp_min(0)
        return 0.05 + 0.4 * dice[:, 4:5] + (weights * cosines).sum(1, keepdim=True)

    factor = (light(F.normalize(mean + bent, dim=1)) / light(mean)).clamp(1 / 8, 8)
    factor = torch.where(there, factor, 1.0)
    rows.planes[:, :3] *= factor
    rows.planes[:, AT["colour_std"]] *= factor
    rows.target *= factor
    unit = normal / length.clamp_min(1e-3)
    rows.planes[:, AT["normal"]] = torch.where(
        there, length * F.normalize(unit + bent, dim=1), normal
    )


def collaged(rows: Rows, rng: torch.Generator) -> None:
    """Each crop, turned by half, over itself: a share m of a pixel shows what is in front.

    Of a pixel's n samples k ~ B(n, m) do: every layer is k/n of one and the rest of the other.
    """
    size = len(rows.planes)
    height, width = rows.planes.shape[2:]
    cover = pattern(size, height, width, rng)
    n = rows.spp.round().clamp_min(1)[:, None, None, None]
    hits = torch.binomial(n.expand_as(cover).contiguous(), cover, generator=rng) / n
    spread = hits * (1 - hits) / (n - 1).clamp_min(1)
    behind, front = rows.planes, rows.planes.flip(2, 3)
    planes = torch.lerp(behind, front, hits)
    for name in NAMES:
        if name.endswith("_std"):
            of = slice(0, 3) if name == "colour_std" else AT[name.removesuffix("_std")]
            step = (front[:, of] - behind[:, of]).square().mean(1, keepdim=True)
            # a mean of k samples of one and n - k of the other
            own = (1 - hits) * behind[:, AT[name]] ** 2 + hits * front[:, AT[name]] ** 2
            planes[:, AT[name]] = (own + spread * step).sqrt()
    rows.planes[:] = planes
    target = rows.target
    mixed = torch.lerp(target, target.flip(2, 3), cover)
    deviation = (1 - cover) ** 2 * target[:, 3:] ** 2 + (cover * target[:, 3:].flip(2, 3)) ** 2
    rows.target[:] = torch.cat([mixed[:, :3], deviation.sqrt()], 1)


def pattern(size: int, height: int, width: int, rng: torch.Generator) -> Tensor:
    """Something between 0 and 1 with edges, sharp or soft ``(size, 1, H, W)``.

    Stripes (blinds, boards), grids (windows, tiles), level sets of smooth noise (leaves, stains),
    half planes (the edge of a wall's shadow) and discs, seen at an angle and in perspective.
    """
    dev = rng.device
    p = random(size, 16, rng)[:, :, None, None]
    y = torch.linspace(-1, 1, height, device=dev)[None, :, None]
    x = torch.linspace(-1, 1, width, device=dev)[None, None, :]

    def number(i: int, low: float, high: float) -> Tensor:
        return low + (high - low) * p[:, i]

    angle = number(0, 0, 2 * math.pi)
    u = torch.cos(angle) * x + torch.sin(angle) * y + number(1, -0.5, 0.5)
    v = torch.cos(angle) * y - torch.sin(angle) * x + number(2, -0.5, 0.5)
    depth = 1 + number(3, -0.35, 0.35) * u + number(4, -0.35, 0.35) * v
    u, v = u / depth, v / depth
    often = torch.exp2(number(5, 0.5, 5.0))
    duty = number(6, 0.15, 0.85)
    # distances to the nearest edge, positive inside; as a share of the picture's half
    stripes = _teeth(u * often, duty) / often
    grid = torch.minimum(stripes, _teeth(v * often * number(7, 0.4, 1.5), duty) / often)
    discs = _dots(u * often, v * often, duty) / often
    half = u
    coarse = torch.randn(size, 1, 20, 20, generator=rng, device=dev)
    fine = torch.randn(size, 1, 64, 64, generator=rng, device=dev)
    noise = F.interpolate(coarse, (height, width), mode="bicubic")[:, 0]
    noise = noise + number(8, 0, 0.6) * F.interpolate(fine, (height, width), mode="bicubic")[:, 0]
    leaves = 0.1 * (noise + number(9, -1, 1))
    kind = p[:, 10] * 5
    edge = torch.where(kind < 1, stripes, torch.where(kind < 2, grid, torch.where(
        kind < 3, discs, torch.where(kind < 4, leaves, half))))  # fmt: skip
    # from half a pixel to an eighth of the picture
    soft = torch.exp2(number(11, -7.5, -3.0)) * 2
    found = torch.sigmoid(4 * edge / soft)
    found = torch.where(p[:, 12] < 0.5, found, 1 - found)
    return found[:, None]


def without_some(rows: Rows, spp: Tensor, rng: torch.Generator) -> tuple[Tensor, Tensor]:
    """Masks ``(B, len(MASKS))`` of the layers that are kept, and spp, 0 if unknown.

    One network shall serve every subset of layers: `ALL`, `PLAIN`, `COLOUR`; the rest lose each
    mask's layers by chance.
    """
    size = len(rows.planes)
    names = list(MASKS)
    kind = random(size, 1, rng)
    keep = (random(size, len(names), rng) < 0.6).float()
    plain = torch.tensor([float(n in ("albedo", "normal")) for n in names], device=spp.device)
    keep = torch.where(kind < ALL + PLAIN + COLOUR, 0.0, keep)
    keep = torch.where(kind < ALL + PLAIN, plain, keep)
    keep = torch.where(kind < ALL, 1.0, keep)
    return keep, torch.where(random(size, 1, rng)[:, 0] < UNTOLD, 0.0, spp)


# ------------------------------------------------------------------- private


def rotations(size: int, rng: torch.Generator) -> Tensor:
    """Orthogonal 3x3 matrices, mirrors among them, uniform: unit quaternions (Shoemake 1992)."""
    q = F.normalize(torch.randn(size, 4, generator=rng, device=rng.device), dim=1)
    w, x, y, z = q.unbind(1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    found = torch.stack([torch.stack(row, 1) for row in rows], 1)
    return found * torch.where(random(size, 1, rng) < 0.5, 1.0, -1.0)[:, :, None]


def _teeth(t: Tensor, duty: Tensor) -> Tensor:
    """Signed distance to the edges of stripes of period 1 and width ``duty``, in periods."""
    return duty / 2 - (t - t.round()).abs()


def _dots(u: Tensor, v: Tensor, duty: Tensor) -> Tensor:
    """The same for discs on a grid."""
    return duty / 2 - torch.hypot(u - u.round(), v - v.round())


def log_uniform(p: Tensor, bounds: tuple[float, float]) -> Tensor:
    """Uniform numbers as ones whose logarithm is uniform within bounds."""
    low, high = (math.log(b) for b in bounds)
    return torch.exp(low + (high - low) * p)
