"""Radiosity: form factors beside a peer's, accuracy, scale, and many views beside path tracing.

    python benchmarks/radiosity.py factors             # needs pyviewfactor
    python benchmarks/radiosity.py accuracy SCENE.xml  # error over patches, uniform and adaptive
    python benchmarks/radiosity.py scale SCENE.xml     # time and memory over patches, by solver
    python benchmarks/radiosity.py views SCENE.xml     # 1 to 100 frames: solve, trace, denoise

All scenes are taken as diffuse (the integrator ``lambent_diffuse`` traces the same world). Errors
are relMSE, (x - r)² / (r² + 0.01 mean²), the noise of reference and view subtracted; ± is one
standard error of that, from the spread over pixels.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from lambent.render.variant import mitsuba

SIZES = (1_000, 4_000, 16_000, 64_000, 100_000)


def median_time(call, rounds=3):
    call()
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def relmse(x, r, noise):
    """relMSE without the noise (variances, a pixel), and its standard error."""
    size = r.mean(2) ** 2 + 0.01 * r.mean() ** 2
    error = (((x - r) ** 2).mean(2) - noise) / size
    return float(error.mean()), float(error.std() / error.size**0.5)


# ---------------------------------------------------------------------- factors


def factors(arguments):
    """All form factors of a furnished room of about 1,000 triangles, with what stands between."""
    import pyviewfactor as pvf
    import pyvista as pv

    mi = mitsuba()
    from lambent.transport.radiosity.casting import cast
    from lambent.transport.radiosity.pairs import exchange_matrix, face_corners
    from lambent.transport.radiosity.patches import cluster, size_for, uniform
    from lambent.transport.radiosity.probe import Probe
    from lambent.transport.surfaces import surfaces_of

    scene = mi.load_dict(_room(mi))
    surfaces = surfaces_of(scene)
    patches = cluster(uniform(surfaces, size_for(surfaces, arguments.count)))
    probe = Probe.of(patches)
    faces = 2 * np.arange(len(patches))
    live = np.zeros(2 * len(patches), bool)
    live[faces] = True
    area = patches.area
    corners = face_corners(patches, faces)
    mesh = pv.PolyData(
        corners.reshape(-1, 3),
        np.c_[np.full(len(faces), 3), np.arange(3 * len(faces)).reshape(-1, 3)].ravel(),
    )
    found = {}

    def pairs():
        found["pairs"] = exchange_matrix(scene, patches, probe, faces, live)[0].toarray()

    def rays():
        found["rays"] = cast(scene, patches, probe, faces, live, 256).shares[:, faces].toarray()

    def peer():
        found["peer"] = np.asarray(pvf.compute_viewfactor_matrix(mesh))

    timings = {name: median_time(call) for name, call in
               (("pairs", pairs), ("rays", rays), ("peer", peer))}  # fmt: skip
    ours = found["pairs"] / area[:, None]
    theirs = found["peer"].T  # theirs is F[i, j] = F(j -> i)
    if np.abs(theirs - ours).mean() > np.abs(theirs.T - ours).mean():
        theirs = theirs.T
    both = (ours > 0) & (theirs > 0)
    ratio = np.abs(ours - theirs)[both] / ours[both]
    clear = ratio < 0.02
    print(f"{len(faces):,} triangles, {platform.processor() or platform.machine()}, "
          f"{os.cpu_count()} processors; medians of three after one\n")  # fmt: skip
    print("| method | seconds | of the peer | mean row sum | |row sum - 1|, mean |")
    print("| :-- | --: | --: | --: | --: |")
    names = {"peer": "pyviewfactor 1.1", "pairs": "lambent, pairs", "rays": "lambent, 256 rays"}
    for name in ("peer", "pairs", "rays"):
        f = {"peer": theirs, "pairs": ours, "rays": found["rays"]}[name]
        sums = f.sum(axis=1)
        print(f"| {names[name]} | {timings[name]:.2f} | {timings[name] / timings['peer']:.3f} | "
              f"{sums.mean():.4f} | {np.abs(sums - 1).mean():.4f} |")  # fmt: skip
    print(f"\nof the pairs that both see, {100 * clear.mean():.1f} % differ by less than 2 %; "
          f"these by {100 * np.median(ratio[clear]):.4f} % (median). The others are pairs with "
          "something in between.")  # fmt: skip


def _room(mi):
    from lambent.transport.examples import furnished_room

    return furnished_room()


# --------------------------------------------------------------------- accuracy


def accuracy(arguments):
    """relMSE of views over the number of patches, uniform and adaptive."""
    mi = mitsuba()
    from lambent.frame.role import Role, Stat
    from lambent.render.sampling import FrameSampler
    from lambent.transport.radiosity.settings import Settings
    from lambent.transport.radiosity.solve import solve
    from lambent.transport.scene import load_for_light
    from lambent.transport.solution import picture

    loaded = load_for_light(arguments.scene, size=_size(arguments))
    path = mi.load_dict({"type": "lambent_diffuse"})
    started = time.perf_counter()
    reference = (
        FrameSampler(loaded.scene, loaded.sensor, features="none", integrator=path)
        .sample(arguments.spp, 99)
        .frame()
    )
    spent = time.perf_counter() - started
    r = reference.colour
    noise = reference.get(Role.COLOUR, Stat.VARIANCE).mean(2)
    size = r.mean(2) ** 2 + 0.01 * r.mean() ** 2
    print(f"{arguments.scene}, {r.shape[1]}x{r.shape[0]}; reference {arguments.spp} spp in "
          f"{spent:.0f} s, its own noise {float((noise / size).mean()):.1e}\n")  # fmt: skip
    print("| patches | cut | smooth relMSE | gather relMSE | mean: smooth, gather / path |")
    print("| --: | :-- | --: | --: | --: |")
    rows = []
    for count in arguments.sizes:
        for adaptive in [cut == "adaptive" for cut in arguments.cuts]:
            found = solve(loaded, Settings(patches=count, adaptive=adaptive, rays=arguments.rays,
                                           samples=arguments.samples))  # fmt: skip
            errors, sure, mean = {}, {}, {}
            for show, spp in (("smooth", 256), ("gather", arguments.gather_spp)):
                frame = picture(found.integrator(show), loaded, spp, "none")
                own = frame.get(Role.COLOUR, Stat.VARIANCE).mean(2)
                errors[show], sure[show] = relmse(frame.colour, r, noise + own)
                mean[show] = float(frame.colour.mean() / r.mean())
            cut = "adaptive" if adaptive else "uniform"
            cells = [f"{errors[show]:.2e} ± {sure[show]:.0e}" for show in errors]
            means = ", ".join(f"{share:.4f}" for share in mean.values())
            print(f"| {len(found):,} | {cut} | {cells[0]} | {cells[1]} | {means} |", flush=True)
            rows.append({"patches": len(found), "cut": cut, **errors})
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(rows, indent=1) + "\n")


# ------------------------------------------------------------------------ scale


def scale(arguments):
    """Time and peak memory of a whole solve, each in a process of its own."""
    print(f"{arguments.scene}, {os.cpu_count()} processors\n")
    print("| patches | faces | solver | seconds | factors | solver | GiB | steps |")
    print("| --: | --: | :-- | --: | --: | --: | --: | --: |")
    points: dict[str, list[tuple[float, float, float]]] = {}
    for solver in arguments.solvers:
        for count in arguments.sizes:
            if solver == "direct" and count > 6_000:
                continue
            if solver == "southwell" and count > 70_000:
                continue
            command = [sys.executable, __file__, "one", arguments.scene, "--count", str(count),
                       "--solvers", solver, "--rays", str(arguments.rays)]  # fmt: skip
            out = subprocess.run(command, capture_output=True, text=True)
            if out.returncode:
                print(f"| {count:,} | | {solver} | {out.stderr.strip().splitlines()[-1]} |")
                continue
            d = json.loads(out.stdout.splitlines()[-1])
            print(f"| {d['patches']:,} | {d['faces']:,} | {solver} | {d['seconds']:.1f} | "
                  f"{d['factors']:.1f} | {d['solver']:.2f} | {d['gib']:.2f} | {d['steps']} |",
                  flush=True)  # fmt: skip
            points.setdefault(solver, []).append((d["patches"], d["seconds"], d["gib"]))
    print()
    for solver, found in points.items():
        if len(found) > 2:
            n, t, m = (np.log([p[k] for p in found]) for k in range(3))
            print(f"{solver}: time grows as n^{np.polyfit(n[-3:], t[-3:], 1)[0]:.2f}, memory as "
                  f"n^{np.polyfit(n[-3:], m[-3:], 1)[0]:.2f} (last three)")  # fmt: skip


def one(arguments):
    """One solve, for `scale`."""
    from lambent.transport.scene import load_for_light

    loaded = load_for_light(arguments.scene)
    from lambent.transport.radiosity.settings import Settings
    from lambent.transport.radiosity.solve import solve

    start = time.perf_counter()
    found = solve(loaded, Settings(patches=arguments.count, solver=arguments.solvers[0],
                                   rays=arguments.rays))  # fmt: skip
    print(json.dumps({
        "patches": len(found), "faces": int(found.live.sum()),
        "seconds": time.perf_counter() - start, "factors": found.seconds["form factors"],
        "solver": found.seconds["solver"], "steps": len(found.history.steps),
        "gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }))  # fmt: skip


# ------------------------------------------------------------------------ views


def views(arguments):
    """At equal error: total time of 1 to 100 views, solved, traced, and traced and denoised."""
    mi = mitsuba()
    import lambent
    from lambent.frame.role import Role, Stat
    from lambent.render.sampling import FrameSampler
    from lambent.transport.radiosity.settings import Settings
    from lambent.transport.radiosity.solve import solve
    from lambent.transport.scene import load_for_light
    from lambent.transport.solution import picture

    loaded = load_for_light(arguments.scene, size=_size(arguments))
    path = mi.load_dict({"type": "lambent_diffuse"})
    features = ("albedo", "normal", "depth")

    def traced(spp, seed, what="none"):
        sampler = FrameSampler(loaded.scene, loaded.sensor, features=what, integrator=path)
        return sampler.sample(spp, seed).frame()

    reference = traced(arguments.spp, 99)
    noise = reference.get(Role.COLOUR, Stat.VARIANCE).mean(2)

    def error(frame, own=0.0):
        return relmse(frame.colour, reference.colour, noise + own)[0]

    start = time.perf_counter()
    found = solve(loaded, Settings(patches=arguments.count, adaptive=True))
    solving = time.perf_counter() - start
    ways = {
        "solved, smooth": lambda: picture(found.integrator("smooth"), loaded, 16, "none"),
        "solved, gather 16 spp, denoised": lambda: lambent.denoise(
            picture(found.integrator("gather"), loaded, 16, features)
        ),
    }
    for spp in (4, 16, 64, 256):
        ways[f"traced, {spp} spp"] = lambda spp=spp: traced(spp, 5)
        ways[f"traced, {spp} spp, denoised"] = lambda spp=spp: lambent.denoise(
            traced(spp, 5, features)
        )
    print(f"{arguments.scene}, {reference.width}x{reference.height}; solved once "
          f"in {solving:.1f} s ({len(found):,} patches, adaptive)\n")  # fmt: skip
    print("| way | relMSE | s a frame | 1 frame | 10 frames | 100 frames |")
    print("| :-- | --: | --: | --: | --: | --: |")
    table = {}
    for name, make in ways.items():
        frame = make()
        seconds = median_time(make)
        once = solving if name.startswith("solved") else 0.0
        table[name] = (error(frame), seconds, once)
        totals = " | ".join(f"{once + n * seconds:.1f} s" for n in (1, 10, 100))
        print(f"| {name} | {table[name][0]:.2e} | {seconds:.2f} | {totals} |", flush=True)
    print()
    for name in list(ways)[:2]:
        mine, seconds, once = table[name]
        for other, (theirs, their_seconds, _) in table.items():
            if other.startswith("traced") and theirs <= mine and their_seconds > seconds:
                count = once / (their_seconds - seconds)
                print(f"{name} is the faster from {max(1, int(np.ceil(count)))} frames on, against "
                      f"{other} (relMSE {theirs:.1e})")  # fmt: skip
                break


def _size(arguments):
    width, _, height = arguments.size.partition("x")
    return int(width), int(height)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("factors", "accuracy", "scale", "one", "views"))
    parser.add_argument("scene", nargs="?")
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--sizes", type=lambda t: [int(x) for x in t.split(",")], default=None)
    parser.add_argument("--cuts", type=lambda t: t.split(","), default=["uniform", "adaptive"])
    parser.add_argument("--size", default="256x256")
    parser.add_argument("--spp", type=int, default=4096)
    parser.add_argument("--gather-spp", type=int, default=512)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--samples", type=int, default=512)
    parser.add_argument("--solvers", type=lambda t: t.split(","), default=["cg", "matrix-free"])
    parser.add_argument("--json")
    arguments = parser.parse_args()
    if arguments.sizes is None:
        arguments.sizes = list(SIZES)
    globals()[arguments.what](arguments)


if __name__ == "__main__":
    main()
