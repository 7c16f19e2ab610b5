"""How fast the image kernels are, beside NumPy, scikit-image and OpenCV, and how near the limit.

Run ``python benchmarks/kernels.py [--size 1280x720] [--repeat 5]``; it prints two Markdown tables:
the kernels, and whole filters as `lambent denoise` calls them, on a frame with albedo, normal and
depth, their variances and half buffers, at radius 5 (five levels; NFOR and StatMC at their
defaults). All rows of one run are measured
in the same process on the same images; each figure is the least of the warm calls, all of which
are in the JSON (``--json``). "processor" is the least time that the processor worked, on all its
cores together: the half of it is what two idle cores take, also where other work runs beside.
"cold" is the first call in a process of its own, with an empty kernel
cache, without imports.

The limit of a kernel is the greater of two times: the bytes that its launches must move over the
bandwidth of a Dr.Jit copy kernel, and its floating-point operations over the rate of a Dr.Jit
kernel of independent FMAs, both measured first. Planes that stay in the cache between launches
come cheaper than the first figure says, so a kernel can be a little faster than "the limit".
The NumPy peers of the regression and of Welch's test are timed on a crop (`Case.peer_share` of the
pixels) and scaled by the pixels.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

RADIUS, PATCH, LEVELS, FEATURES = 5, 3, 5, 6
#: Radius of the disc of Welch's test, and side of the crop that slow peers are timed on.
DISC, CROP = 20, 192


@dataclass(frozen=True)
class Case:
    """One kernel: ours, its peers, and what it must at least do for a pixel."""

    name: str
    ours: Callable[[], Any]
    peers: dict[str, Callable[[], Any]]
    bytes_per_pixel: float
    flops_per_pixel: float
    target: float | None
    peer_share: float = 1.0


def images(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """A smooth picture with noise in [0, 1], and six features of it."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    clean = np.stack([np.sin(x / 40) * 0.2 + 0.5, np.cos(y / 50) * 0.2 + 0.5, x / width], axis=2)
    colour = np.clip(clean + 0.08 * rng.normal(size=clean.shape), 0, 1).astype(np.float32)
    more = np.floor(clean * 5) / 5 + 0.01 * rng.normal(size=clean.shape)
    return colour, np.concatenate([clean, more], axis=2).astype(np.float32)


# ------------------------------------------------------- NumPy, one offset at a time


def shifted(image: np.ndarray, dx: int, dy: int) -> tuple[Any, Any]:
    """The slices of the pixels, and of their neighbours at (dx, dy)."""
    height, width = image.shape[:2]
    here = slice(max(0, -dy), height - max(0, dy)), slice(max(0, -dx), width - max(0, dx))
    there = slice(max(0, dy), height + min(0, dy)), slice(max(0, dx), width + min(0, dx))
    return here, there


def numpy_window(targets: np.ndarray, guide: np.ndarray, spatial: float) -> np.ndarray:
    total, norm = np.zeros_like(targets), np.zeros(targets.shape[:2], np.float32)
    for dy in range(-RADIUS, RADIUS + 1):
        for dx in range(-RADIUS, RADIUS + 1):
            p, q = shifted(targets, dx, dy)
            apart = ((guide[q] - guide[p]) ** 2).sum(axis=2)
            w = np.exp(-apart - (dx * dx + dy * dy) * spatial)
            total[p] += w[:, :, None] * targets[q]
            norm[p] += w
    return total / norm[:, :, None]


def numpy_nlm(image: np.ndarray, h: float) -> np.ndarray:
    from scipy.ndimage import uniform_filter

    total, norm = np.zeros_like(image), np.zeros(image.shape[:2], np.float32)
    for dy in range(-RADIUS, RADIUS + 1):
        for dx in range(-RADIUS, RADIUS + 1):
            p, q = shifted(image, dx, dy)
            apart = ((image[q] - image[p]) ** 2).mean(axis=2)
            w = np.exp(-uniform_filter(apart, 2 * PATCH + 1, mode="reflect") / h**2)
            total[p] += w[:, :, None] * image[q]
            norm[p] += w
    return total / norm[:, :, None]


def numpy_atrous(targets: np.ndarray, guide: np.ndarray, features: np.ndarray) -> np.ndarray:
    from lambent.kernels.atrous import SPLINE

    state = np.concatenate([guide, targets], axis=2)
    for level in range(LEVELS):
        total, norm = np.zeros_like(state), np.zeros(state.shape[:2], np.float32)
        for j in range(-2, 3):
            for i in range(-2, 3):
                p, q = shifted(state, i * 2**level, j * 2**level)
                apart = ((state[q][:, :, :3] - state[p][:, :, :3]) ** 2).sum(axis=2) * 4**level
                apart += ((features[q] - features[p]) ** 2).sum(axis=2)
                w = np.exp(-apart) * np.float32(SPLINE[i + 2] * SPLINE[j + 2])
                total[p] += w[:, :, None] * state[q]
                norm[p] += w
        state = total / norm[:, :, None]
    return state[:, :, 3:]


def numpy_regression(
    colour: np.ndarray, features: np.ndarray, targets: np.ndarray, window: Any
) -> list[np.ndarray]:
    """NLM weights and collaborative first-order regression at w⁴ and w: all centres at a time."""
    from scipy.ndimage import uniform_filter

    height, width, count = targets.shape
    radius, s = window.radius, window.stride
    offsets = [(i, j) for j in range(-radius, radius + 1) for i in range(-radius, radius + 1)]
    n = features.shape[2] + 3
    centres = np.s_[::s, ::s]

    def there(image: np.ndarray, dx: int, dy: int) -> np.ndarray:
        at = np.pad(image, ((radius, radius), (radius, radius), (0, 0)), mode="symmetric")
        at = at[radius + dy : radius + dy + height, radius + dx : radius + dx + width]
        return at[centres]

    weights = []
    for dx, dy in offsets:
        w = np.zeros((height, width), np.float32)
        p, q = shifted(colour, dx, dy)
        apart = ((colour[q] - colour[p]) ** 2).mean(axis=2)
        w[p] = np.exp(-uniform_filter(apart, 2 * window.patch + 1, mode="reflect") * 50)
        weights.append(w[centres])
    results = []
    for power in (4, 1):
        gram = np.zeros((*weights[0].shape, n, n), np.float32)
        right = np.zeros((*weights[0].shape, n, count), np.float32)
        rows = []
        for (dx, dy), w in zip(offsets, weights, strict=True):
            x = np.empty((*w.shape, n), np.float32)
            x[..., :3] = 1, dx / radius, dy / radius
            x[..., 3:] = there(features, dx, dy) - features[centres]
            wx = (w**power)[..., None] * x
            gram += wx[..., :, None] * x[..., None, :]
            right += wx[..., :, None] * there(targets, dx, dy)[..., None, :]
            rows.append(x)
        beta = np.linalg.solve(gram + 1e-4 * np.eye(n, dtype=np.float32), right)
        total = np.zeros((height, width, count), np.float32)
        norm = np.full((height, width, 1), 1e-4, np.float32)
        y, x0 = np.mgrid[0:height:s, 0:width:s]
        for (dx, dy), w, x in zip(offsets, weights, rows, strict=True):
            qy, qx = y + dy, x0 + dx
            inside = (qy >= 0) & (qy < height) & (qx >= 0) & (qx < width)
            value = np.einsum("ijn,ijnc->ijc", x, beta) * (w**power)[..., None]
            total[qy[inside], qx[inside]] += value[inside]
            norm[qy[inside], qx[inside]] += (w**power)[inside][:, None]
        results.append(total / norm)
    return results


def numpy_welch(
    targets: np.ndarray, mean: np.ndarray, bound: np.ndarray, guide: np.ndarray, sigma: float
) -> np.ndarray:
    total, norm = np.zeros_like(targets), np.zeros(targets.shape[:2], np.float32)
    for dy in range(-DISC, DISC + 1):
        for dx in range(-DISC, DISC + 1):
            if dx * dx + dy * dy > DISC * DISC:
                continue
            p, q = shifted(targets, dx, dy)
            same = ((mean[q] - mean[p]) ** 2 <= bound[q] + bound[p]).all(axis=2)
            apart = ((guide[q] - guide[p]) ** 2).sum(axis=2)
            w = same * np.exp(-apart - (dx * dx + dy * dy) / (2 * sigma**2))
            total[p] += w[:, :, None] * targets[q]
            norm[p] += w
    return total / norm[:, :, None]


# ------------------------------------------------------------------- cases


def cases(height: int, width: int, peers: bool = True) -> list[Case]:
    from lambent.filters.bilateral import gaussian_weight, log_gaussian
    from lambent.kernels.atrous import atrous
    from lambent.kernels.nlm import PatchSearch, nlm_mean, squared_difference
    from lambent.kernels.window import _launches, weighted_window

    colour, features = images(height, width)
    sigma_d, sigma_r, h = 2.5, 0.2, 0.1
    spatial = log_gaussian(RADIUS, sigma_d)
    scaled = colour / np.float32(np.sqrt(2) * sigma_r)
    factors = [(4.0**level, 1.0) for level in range(LEVELS)]
    taps, side = (2 * RADIUS + 1) ** 2, 2 * RADIUS + 1

    def search() -> Any:
        return PatchSearch.of(colour, None, RADIUS, PATCH, squared_difference, (1 / h**2, 0.0))

    def window_cost(guide: int) -> tuple[float, float]:
        # each launch: centre, neighbours, mask, targets, sums in and out
        launches = len(list(_launches(RADIUS, guide + 3 + 1)))
        moved = 4 * launches * (2 * guide + 1 + 3 + 2 * 4)
        return moved, taps * (3 * guide + 18 + 2 * 4)

    # four launches for a row of the upper half: differences, means along the rows, along the
    # columns with the exp, and sums for both directions
    launches = 4 * side + 2 + 2 * side + 2 * 1 + side + 2 * (3 + 1) + 2 * 4 + 6
    nlm_bytes = 4 * (RADIUS + 1) * launches
    nlm_flops = taps / 2 * ((3 * 3 + 4) + 2 * (2 * PATCH + 8) + 18 + 2 * 8)
    wide = 3 + FEATURES
    atrous_bytes = 4 * LEVELS * (wide * 2 + 3 + 1 + 2 * 6)
    atrous_flops = 25 * LEVELS * (3 * wide + 20 + 2 * 6 + 2)
    found = [
        Case(
            f"cross-bilateral, radius {RADIUS}, {FEATURES} features",
            lambda: weighted_window(colour, features, RADIUS, gaussian_weight, spatial=spatial),
            {"numpy": lambda: numpy_window(colour, features, 1 / (2 * sigma_d**2))},
            *window_cost(FEATURES),
            0.25,
        ),
        Case(
            f"bilateral, radius {RADIUS}",
            lambda: weighted_window(colour, scaled, RADIUS, gaussian_weight, spatial=spatial),
            {"numpy": lambda: numpy_window(colour, scaled, 1 / (2 * sigma_d**2))},
            *window_cost(3),
            None,
        ),
        Case(
            f"NLM, radius {RADIUS}, patch {PATCH} (7x7)",
            lambda: nlm_mean(colour, search()),
            {"numpy": lambda: numpy_nlm(colour, h)},
            nlm_bytes,
            nlm_flops,
            0.8,
        ),
        Case(
            f"à-trous, {LEVELS} levels, {FEATURES} features",
            lambda: atrous(colour, colour, features, factors),
            {"numpy": lambda: numpy_atrous(colour, colour, features)},
            atrous_bytes,
            atrous_flops,
            0.15,
        ),
    ]
    found += [_regression(colour, features), _nfor(colour, features), _welch(colour, features)]
    if peers:
        import cv2
        from skimage.restoration import denoise_bilateral, denoise_nl_means

        bytes_image = (colour * 255).astype(np.uint8)
        found[1].peers["scikit-image"] = lambda: denoise_bilateral(
            colour, win_size=side, sigma_color=sigma_r, sigma_spatial=sigma_d, channel_axis=2
        )
        found[1].peers["opencv"] = lambda: cv2.bilateralFilter(colour, side, sigma_r, sigma_d)
        found[2].peers["scikit-image"] = lambda: denoise_nl_means(
            colour, patch_size=2 * PATCH + 1, patch_distance=RADIUS, h=h, fast_mode=True,
            channel_axis=2,
        )  # fmt: skip
        # 8 bits a channel is all that OpenCV's takes
        found[2].peers["opencv"] = lambda: cv2.fastNlMeansDenoisingMulti(
            [bytes_image], 0, 1, None, h * 255, 2 * PATCH + 1, side
        )
    return found


# ----------------------------------------------------------- whole filters


def filters(height: int, width: int) -> list[tuple[str, str, Callable[[], Any]]]:
    """Name, parameters and call of every filter whose kernel is measured."""
    from lambent.filters.denoiser import create
    from lambent.frame.frame import Frame

    colour, features = images(height, width)
    rng = np.random.default_rng(1)
    noise = 0.05 * rng.normal(size=colour.shape).astype(np.float32)
    frame = Frame.from_arrays(
        colour=colour,
        colour_variance=np.full_like(colour, 0.0064),
        colour_half_a=colour + noise,
        colour_half_b=colour - noise,
        albedo=np.ascontiguousarray(features[:, :, :3]),
        albedo_variance=np.full_like(colour, 1e-4),
        normal=np.ascontiguousarray(features[:, :, 3:]),
        normal_variance=np.full_like(colour, 1e-4),
        depth=1 + features[:, :, 0],
        depth_variance=np.full((height, width), 1e-4, np.float32),
    )

    def case(model: str, **options: Any) -> tuple[str, str, Callable[[], Any]]:
        denoiser = create(model, **options).fitted(frame)
        said = ", ".join(f"{name} {value}" for name, value in options.items())
        return model, said, lambda: denoiser.filter(frame, colour)

    # as `lambent denoise` calls it: either half of the beauty has weights of its own
    whole = create("nfor").fitted(frame)
    layer = next(iter(frame.all_layers()))
    nfor = ("nfor", "", lambda: whole.filter_layers(frame, [layer]))
    return [
        case("bilateral", radius=RADIUS),
        case("cross-bilateral", radius=RADIUS),
        case("atrous", levels=LEVELS),
        case("nlm", radius=RADIUS),
        case("joint-nlm", radius=RADIUS),
        case("atrous-tuned", levels=LEVELS),
        nfor,
        case("nfor-tuned"),
        case("statmc"),
        case("statmc-tuned"),
    ]


def _regression(colour: np.ndarray, features: np.ndarray) -> Case:
    """What NFOR does for one half: weights, and two regressions of four channels."""
    from lambent.kernels.regression import Window, first_order, patch_weights

    window = Window()
    guide = np.concatenate([features, colour[:, :, :1]], axis=2)[:, :, :7]
    targets = np.concatenate([colour, colour[:, :, :1]], axis=2)
    variance = np.full_like(colour, 0.0064)

    def ours() -> Any:
        weights = patch_weights(colour, variance, window, k=0.5)
        return first_order(weights, guide, targets, (4, 1), 1e-4)

    n, c, taps, share = 10, 4, window.offsets(), window.stride**-2
    weighing = taps * (27 + 7 / window.stride + (7 + 20) * share)
    fit = taps * (n * (n + 1) + 2 * n * c + 2 * n + c) * share + 2 * n**3 / 3 * share
    predict = taps * share * (2 * (n - 1) * c + 2 * (c + 1))
    moved = 4 * taps * share * (2 + 2 * 2)  # column sums and weights out and in, read four times
    few = np.s_[:CROP, :CROP]
    peer = [np.ascontiguousarray(image[few]) for image in (colour, guide, targets)]
    return Case(
        f"regression, radius {window.radius}, 7 features, two bandwidths",
        ours,
        {"numpy": lambda: numpy_regression(*peer, window)},
        moved + 4 * taps / window.stride * 2,
        weighing + 2 * (fit + predict),
        None,
        peer[0][:, :, 0].size / colour[:, :, 0].size,
    )


def _nfor(colour: np.ndarray, features: np.ndarray) -> Case:
    """What the paper's form does for one half: as above, with a centre at every pixel."""
    from lambent.kernels.dense_nlm import least_weight_rows
    from lambent.kernels.dense_regression import dense_first_order
    from lambent.kernels.regression import Window

    radius, patch, n, c = 9, 3, 10, 3
    guide = np.concatenate([features, colour[:, :, :1]], axis=2)[:, :, :7]
    variance = np.full_like(colour, 0.0064)

    def ours() -> Any:
        rows = least_weight_rows(colour, variance, radius, patch, 1.0, "auto")
        return dense_first_order(rows, guide, colour, (4, 1), 1e-5)

    window = Window(radius, patch, 1)
    taps = window.offsets()
    weighing = taps * (3 * (11 + 2 * 7) + 20)
    # sums without those in y, which come row by row
    fit = taps * (2 * ((n - 1) * n // 2 + (n - 1) * c) + (n - 1) + (n - 3 + c) / 2)
    predict = taps * (2 * n * c + 1)
    few = np.s_[:CROP, :CROP]
    peer = [np.ascontiguousarray(image[few]) for image in (colour, guide, colour)]
    return Case(
        f"NFOR's regression, radius {radius}, 7 features, two bandwidths, every pixel",
        ours,
        {"numpy": lambda: numpy_regression(*peer, window)},
        4 * taps * 2 * 1.5,
        weighing + 2 * (fit + predict),
        None,
        peer[0][:, :, 0].size / colour[:, :, 0].size,
    )


def _welch(colour: np.ndarray, features: np.ndarray) -> Case:
    from lambent.kernels.statistics import disc, welch_mean

    bound = np.full_like(colour, 0.05)
    guide = features / np.float32(0.3)
    taps = len(disc(DISC, 10.0)[0])
    few = np.s_[:CROP, :CROP]
    peer = [np.ascontiguousarray(image[few]) for image in (colour, colour, bound, guide)]
    return Case(
        f"Welch's test, radius {DISC}, {FEATURES} features",
        lambda: welch_mean(colour, colour, bound, guide, DISC, 10.0),
        {"numpy": lambda: numpy_welch(*peer, 10.0)},
        4 * (3 * 3 + FEATURES + 3),
        taps * (4 * 3 + 3 * FEATURES + 18 + 1 + 2 * 3),
        None,
        peer[0][:, :, 0].size / colour[:, :, 0].size,
    )


# --------------------------------------------------------------- measuring


def seconds(call: Callable[[], Any], repeat: int) -> list[float]:
    return [wall for wall, _ in timed(call, repeat)]


def timed(call: Callable[[], Any], repeat: int) -> list[tuple[float, float]]:
    """Seconds by the clock and of the processor, for each call."""
    times = []
    for _ in range(repeat):
        start, worked = time.perf_counter(), time.process_time()
        call()
        times.append((time.perf_counter() - start, time.process_time() - worked))
    return times


def least(times: list[tuple[float, float]]) -> tuple[float, float]:
    """The least of either kind."""
    wall, worked = zip(*times, strict=True)
    return min(wall), min(worked)


def bandwidth() -> float:
    """Bytes a second that a Dr.Jit kernel reads and writes in arrays beyond the cache."""
    import drjit as dr

    from lambent.kernels.arrays import backend

    module = backend()
    count = 1 << 26
    a = dr.opaque(module.Float, 1.0, count)

    def copy() -> None:
        b = a + 1.0
        dr.eval(b)
        dr.sync_thread()

    copy()
    return 2 * 4 * count / min(seconds(copy, 5))


def fma_rate() -> float:
    """Floating-point operations a second of independent FMAs on registers."""
    import drjit as dr

    from lambent.kernels.arrays import backend

    module = backend()
    count, chains, rounds = 1 << 20, 10, 100
    start = dr.opaque(module.Float, 0.5, count)

    def run() -> None:
        values = [start + 0.01 * i for i in range(chains)]
        for _ in range(rounds):
            values = [dr.fma(v, 0.999, 0.001) for v in values]
        total = values[0]
        for value in values[1:]:
            total += value
        dr.eval(total)
        dr.sync_thread()

    run()
    return 2 * chains * rounds * count / min(seconds(run, 5))


def cold(index: int, size: str) -> float:
    """The first call of a case in a fresh process with an empty kernel cache."""
    with tempfile.TemporaryDirectory() as home:
        answer = subprocess.run(
            [sys.executable, __file__, "--size", size, "--cold", str(index)],
            env={**os.environ, "HOME": home},
            capture_output=True,
            text=True,
            check=True,
        )
    return float(answer.stdout.split()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--json", help="write all figures here")
    parser.add_argument("--cold", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    width, height = (int(n) for n in options.size.split("x"))
    if options.cold is not None:
        case = cases(height, width, peers=False)[options.cold]
        print(seconds(case.ours, 1)[0])
        return
    stream, rate = bandwidth(), fma_rate()
    processor = f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
    print(f"{width}x{height}, {processor}; {stream / 1e9:.1f} GB/s, {rate / 1e9:.0f} GFLOP/s\n")
    print(
        "| kernel | ours s | processor s | target s | cold s | limit s | x limit "
        "| peer | peer s | x ours |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    rows = []
    for index, case in enumerate(cases(height, width)):
        first = cold(index, options.size)
        case.ours()
        times = timed(case.ours, options.repeat)
        ours, worked = least(times)
        pixels = width * height
        limits = (case.bytes_per_pixel * pixels / stream, case.flops_per_pixel * pixels / rate)
        bound = "memory" if limits[0] > limits[1] else "FMA"
        row = {"kernel": case.name, "seconds": times, "cold": first, "limits": limits}
        row["peers"] = {}
        for number, (peer, call) in enumerate(case.peers.items()):
            there = min(seconds(call, 1 if peer == "numpy" else 3))
            there /= case.peer_share
            row["peers"][peer] = there
            left = [""] * 7
            if number == 0:
                aim = "" if case.target is None else f"{case.target:.2f}"
                left = [case.name, f"{ours:.3f}", f"{worked:.3f}", aim, f"{first:.2f}"]
                left += [f"{max(limits):.3f} ({bound})", f"{ours / max(limits):.1f}"]
            print(f"| {' | '.join([*left, peer, f'{there:.2f}', f'{there / ours:.1f}'])} |")
        sys.stdout.flush()
        rows.append(row)
    print("\n| filter, with variances | ours s | processor s |\n|---|---|---|")
    whole = {}
    for model, said, call in filters(height, width):
        call()
        whole[model] = timed(call, options.repeat)
        wall, worked = least(whole[model])
        print(f"| {model}{', ' * bool(said)}{said} | {wall:.2f} | {worked:.2f} |", flush=True)
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(
                {"bandwidth": stream, "fma": rate, "rows": rows, "filters": whole}, file, indent=1
            )


if __name__ == "__main__":
    main()
