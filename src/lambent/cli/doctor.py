"""Check this machine: processor, engines, memory, speed; say what to fix.

Takes about ten seconds, most of it a speed test; --no-speed leaves that out.
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from lambent.cli.options import JsonOption, print_json
from lambent.cli.terminal import columns, say, say_labelled
from lambent.errors import stop_by_interrupt

EPILOG = "Exit code 5 if something is broken; notes alone are not a failure."

#: Instruction sets that matter, as Linux names them, and what they are for.
FEATURES = {
    "avx2": "AVX2",
    "avx512f": "AVX-512",
    "avx512_vnni": "VNNI",
    "avx_vnni": "AVX-VNNI",
    "avx512_bf16": "BF16",
    "amx_int8": "AMX-INT8",
    "amx_bf16": "AMX-BF16",
    "asimd": "NEON",
}

#: Packages without which something promised does not work.
PACKAGES = (
    "numpy",
    "OpenEXR",
    "drjit",
    "mitsuba-oidn",
    "flip-evaluator",
    "pillow",
    "tifffile",
    "typer",
    "rich",
)

#: Seconds times cores that OIDN High takes for 1280x720 with albedo and normal, measured on two
#: cores with AVX-512; AVX2 alone needs about 1.8x that.
OIDN_CORE_SECONDS = 2.0
AVX2_FACTOR = 1.8

#: The speed test ends after so many seconds, whatever it has by then.
SPEED_SECONDS = 10.0


@dataclass(frozen=True)
class Check:
    """One line of the diagnosis. ``state``: "ok", "note" (works, could be better) or "broken"."""

    name: str
    state: Literal["ok", "note", "broken"]
    text: str
    remedy: str = ""


def doctor(
    speed: Annotated[
        bool, typer.Option("--speed/--no-speed", help="Measure how fast filters run.")
    ] = True,
    as_json: JsonOption = False,
) -> int:
    """Typer's view of the command; the module docstring is its help."""
    parts: list[Callable[[], list[Check]]] = [
        _lambent,
        _packages,
        _processor,
        _memory,
        _disk,
        _llvm,
        _cuda,
        _oidn,
        _openvino,
    ]
    if speed:
        parts.append(_speed)
    checks: list[Check] = []
    for part in parts:
        found = _safely(part)
        checks += found
        if not as_json:
            for check in found:
                _print(check)
    broken = [check for check in checks if check.state == "broken"]
    if as_json:
        print_json({"healthy": not broken, "checks": [asdict(check) for check in checks]})
    else:
        _print_fixes(checks)
    return 5 if broken else 0


# ------------------------------------------------------------------- printing


def _print(check: Check) -> None:
    mark = {"ok": "ok    ", "note": "note  ", "broken": "BROKEN"}[check.state]
    say_labelled(f"{mark}  {check.name}", check.text, 22, columns())


def _print_fixes(checks: list[Check]) -> None:
    fixes = [check for check in checks if check.remedy]
    assert all(check.remedy for check in checks if check.state != "ok")
    if not fixes:
        say("", "All is well.")
        return
    broken = any(check.state == "broken" for check in checks)
    say("", "To fix:" if broken else "Everything needed works. What could be better:")
    for check in fixes:
        say(f"  {check.name}: {check.remedy}")


def _safely(part: Callable[[], list[Check]]) -> list[Check]:
    """A check that fails by itself is a finding too, not the end of the diagnosis."""
    try:
        return part()
    except Exception as error:
        stop_by_interrupt(error)
        name = part.__name__.strip("_")
        text = f"the check failed: {type(error).__name__}: {error}"
        return [Check(name, "broken", text, "pip install --force-reinstall lambent")]


# --------------------------------------------------------------------- checks


def _lambent() -> list[Check]:
    from lambent import __version__

    where = Path(__file__).resolve().parents[1]
    system = f"{platform.system()} {platform.machine()}"
    python = platform.python_version()
    return [Check("lambent", "ok", f"{__version__}, Python {python}, {system}, in {where}")]


def _packages() -> list[Check]:
    from importlib.metadata import PackageNotFoundError, version

    found, missing = [], []
    for name in PACKAGES:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    checks = [Check("packages", "ok", ", ".join(found))]
    if missing:
        names = " ".join(missing)
        text = f"not installed: {', '.join(missing)}"
        checks.append(Check("packages", "broken", text, f"pip install {names}"))
    return checks


def _processor() -> list[Check]:
    name, flags = _cpuinfo()
    features = [title for flag, title in FEATURES.items() if flag in flags]
    usable = _usable_cores()
    cores = (
        f"{usable} of {os.cpu_count()} cores usable"
        if usable != os.cpu_count()
        else (f"{usable} cores")
    )
    text = f"{name}, {cores}; " + (", ".join(features) or "no vector extensions found")
    if flags and not {"avx2", "asimd"} & flags:
        return [
            Check(
                "processor",
                "note",
                text,
                "without AVX2, filters run several times slower; use a newer machine if you can",
            )
        ]
    return [Check("processor", "ok", text)]


def _memory() -> list[Check]:
    from lambent.memory import available, show_size

    free = available()
    if free is None:
        return [Check("memory", "ok", "this system does not tell how much is free")]
    text = f"{show_size(free)} free"
    if free < 2 * 2**30:
        tip = "close other programs, or work in tiles: lambent denoise --max-memory 1G"
        return [Check("memory", "note", text, tip)]
    return [Check("memory", "ok", text)]


def _disk() -> list[Check]:
    from lambent.memory import show_size

    free = shutil.disk_usage(Path.cwd()).free
    text = f"{show_size(free)} free in {Path.cwd()}"
    if free < 2**30:
        return [Check("disk", "note", text, "make room, or write elsewhere with -o")]
    return [Check("disk", "ok", text)]


def _llvm() -> list[Check]:
    from lambent.startup import find_llvm, has_llvm

    if not has_llvm():
        return [
            Check(
                "LLVM",
                "broken",
                "not found; all models but oidn* need it",
                "pip install karellen-llvm-core, or set DRJIT_LIBLLVM_PATH to a libLLVM",
            )
        ]
    return [Check("LLVM", "ok", find_llvm() or "found by Dr.Jit among the system's libraries")]


def _cuda() -> list[Check]:
    from lambent.startup import has_cuda

    if has_cuda():
        return [Check("CUDA", "ok", "a device is there: --device cuda")]
    return [Check("CUDA", "ok", "no device; everything runs on the processor")]


def _oidn() -> list[Check]:
    import mitsuba_oidn as oidn

    devices = ", ".join(str(d.name) for d in oidn.physical_devices())
    return [Check("OIDN", "ok", f"{oidn.oidn_version()} on {devices}")]


def _openvino() -> list[Check]:
    from lambent.denoise.runtime import probe

    found = probe()
    if found is None:
        return [
            Check(
                "OpenVINO",
                "broken",
                "not found; the model lambent needs it (the others do not)",
                "pip install openvino",
            )
        ]
    text = (
        f"{found.version} on {', '.join(found.devices)}; native precisions "
        f"{', '.join(found.precisions)}; networks run in {found.best_precision()}"
    )
    return [Check("OpenVINO", "ok", text)]


def _speed() -> list[Check]:
    """Time filters on a 1280x720 frame; compare OIDN with what this kind of processor reaches."""
    began = time.monotonic()
    checks = [_oidn_speed(began + 0.5 * SPEED_SECONDS)]
    if any(check.state == "ok" for check in _openvino()):
        seconds = _best_time("lambent", began + 0.7 * SPEED_SECONDS)
        checks.append(Check("speed", "ok", f"lambent 1280x720 in {seconds:.2f} s (warm)"))
    from lambent.startup import has_llvm

    if has_llvm() and time.monotonic() < began + 0.8 * SPEED_SECONDS:
        seconds = _best_time("cross-bilateral", began + SPEED_SECONDS)
        checks.append(Check("speed", "ok", f"cross-bilateral 1280x720 in {seconds:.2f} s (warm)"))
    return checks


def _oidn_speed(deadline: float) -> Check:
    seconds = _best_time("oidn", deadline)
    _, flags = _cpuinfo()
    factor = 1.0 if "avx512f" in flags else AVX2_FACTOR
    expected = OIDN_CORE_SECONDS * factor / _usable_cores()
    text = (
        f"oidn 1280x720 in {seconds:.2f} s; about {expected:.2g} s is usual for "
        f"{_usable_cores()} cores with {'AVX-512' if factor == 1.0 else 'AVX2'}"
    )
    if seconds <= 2 * expected:
        return Check("speed", "ok", text)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    busy = load > 0.5 * _usable_cores()
    tip = (
        f"other programs keep the processor busy (load {load:.1f}): see them with 'top'"
        if busy
        else "check the power profile (powerprofilesctl set performance) and the limits of the "
        "container or virtual machine"
    )
    return Check("speed", "note", text, tip)


def _best_time(model: str, deadline: float) -> float:
    """The best of a few runs on a synthetic frame, until the deadline."""
    from lambent.filters.denoiser import create

    frame = _synthetic_frame()
    denoiser = create(model)
    best = float("inf")
    while True:
        start = time.perf_counter()
        denoiser(frame)
        best = min(best, time.perf_counter() - start)
        if time.monotonic() + best > deadline:
            return best


def _synthetic_frame() -> Any:
    """1280x720 of smooth colour under exponential noise, with albedo and normal."""
    import numpy as np

    from lambent.frame.frame import Frame

    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:720, 0:1280].astype(np.float32)
    ramp = np.stack([x / 1280, y / 720, np.full_like(x, 0.5)], axis=2)
    noise = rng.exponential(1.0, ramp.shape).astype(np.float32)
    normal = np.zeros_like(ramp)
    normal[..., 2] = 1
    return Frame.from_arrays(colour=ramp * noise, albedo=ramp, normal=normal)


def _usable_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _cpuinfo() -> tuple[str, frozenset[str]]:
    """The processor's name and its feature flags, as far as this system tells."""
    name, flags = platform.processor() or platform.machine(), frozenset[str]()
    if sys.platform == "darwin":
        return name, frozenset({"asimd"}) if platform.machine() == "arm64" else flags
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return name, flags
    for line in text.splitlines():
        key, _, value = line.partition(":")
        if key.strip() == "model name":
            name = value.strip()
        elif key.strip() in ("flags", "Features"):
            flags = frozenset(value.split())
    return name, flags
