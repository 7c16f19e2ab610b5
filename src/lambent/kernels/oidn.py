"""Open Image Denoise as an image kernel: NumPy arrays in, a NumPy array out.

The library is Intel's Open Image Denoise 2.5 through the package ``mitsuba-oidn``, which brings
it along and lets it work on Dr.Jit's thread pool (Dr.Jit itself is not imported).

- Images go in and out without a copy: OIDN reads NumPy's memory with any pixel and row stride, so
  a crop of a frame or three channels of a stack are fine. Only where the device cannot see the
  process's memory (a GPU) are they staged.
- Devices and the last few filters are kept for the process (a filter costs 0.1 to 0.2 s to make
  anew, mostly fresh memory); images are let go after every call. Calls from several threads take
  turns: one call uses all cores.
- Every call of OIDN, the release of a filter included, waits for the device's own lock while it
  holds Python's. A progress monitor that waits for Python's lock meanwhile would wait for ever. So
  everything that touches a device happens under one lock of ours, and no filter is let go outside.
- OIDN cannot be interrupted by a signal, only by its progress monitor. So on the main thread the
  work runs in a helper thread, and Ctrl-C stops it within a few hundredths of the whole.
"""

from __future__ import annotations

import atexit
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from lambent.device import check_device
from lambent.errors import EngineError
from lambent.frame.layer import FloatImage
from lambent.progress import Progress
from lambent.startup import claim, owns

#: OIDN's network halves the resolution four times: tiles agree when they begin on multiples of it.
ALIGNMENT = 16

#: How many filters are kept. They share one scratch memory a device.
_KEPT = 4

_NAME = "Open Image Denoise"


@dataclass(frozen=True)
class Options:
    """OIDN's own parameters, in its own terms.

    ``quality``: high, balanced or fast. ``hdr``: radiance without upper limit; otherwise values
    in [0, 1], ``srgb`` if they carry that transfer. ``clean_aux``: albedo and normal have no
    noise. ``input_scale``: factor that takes the colour to the exposure the network expects, None
    for automatic. ``max_memory_mb``: OIDN works in tiles of its own where it would need more;
    None for its default. ``device``: auto (the fastest), cpu or cuda. ``threads``: None for
    Dr.Jit's shared pool; a number makes a pool of that size.
    """

    quality: str = "high"
    hdr: bool = True
    srgb: bool = False
    clean_aux: bool = False
    input_scale: float | None = None
    max_memory_mb: int | None = None
    device: str = "auto"
    threads: int | None = None


def clean(
    images: Mapping[str, FloatImage], options: Options, progress: Progress | None = None
) -> FloatImage:
    """Denoise one image.

    ``images``: ``"color"`` ``(H, W, 1 or 3)`` with optional ``"albedo"`` ``(H, W, 1 or 3)`` in
    [0, 1] and ``"normal"`` ``(H, W, 3)`` in [-1, 1] (only together with albedo); or ``"albedo"``
    or ``"normal"`` alone, which is then what is denoised. Returns float32 of the shape of what is
    denoised. Raises `EngineError` for what OIDN refuses, `KeyboardInterrupt` on Ctrl-C,
    and what ``progress`` raises.
    """
    claim(_NAME)
    if threading.current_thread() is not threading.main_thread():
        return _clean(images, options, progress, threading.Event())
    stop = threading.Event()
    outcome: list[FloatImage] = []
    failure: list[BaseException] = []

    def work() -> None:
        try:
            outcome.append(_clean(images, options, progress, stop))
        except BaseException as error:
            failure.append(error)

    helper = threading.Thread(target=work, name="oidn")
    helper.start()
    try:
        while helper.is_alive():
            helper.join(0.25)
    except BaseException:
        stop.set()
        helper.join()
        raise
    if failure:
        raise failure[0]
    return outcome[0]


def overlap(options: Options, aux: bool = True) -> int:
    """The overlap in pixels with which OIDN tiles: its receptive field, rounded up to 16.

    96 for the base and small networks, 112 for the large one (quality high with clean guides).
    """
    return 112 if options.quality == "high" and options.clean_aux and aux else 96


def release() -> None:
    """Free the kept filters and devices with their memory."""
    if not owns(_NAME):  # a fork has none of the threads that this would wait for
        return
    with _lock:
        _filters.clear()
        _devices.clear()


# ------------------------------------------------------------------- private

_lock = threading.RLock()
_devices: dict[tuple[str, int | None], Any] = {}
_filters: OrderedDict[tuple[Any, ...], Any] = OrderedDict()
atexit.register(release)  # before the interpreter takes the modules apart


def _library() -> ModuleType:
    try:
        import mitsuba_oidn
    except ImportError as error:
        raise EngineError(
            f"Open Image Denoise cannot be loaded: {error}",
            remedy="pip install mitsuba-oidn, or take another model (lambent models)",
        ) from error
    claim(_NAME)
    return mitsuba_oidn


def _device(kind: str, threads: int | None) -> Any:
    key = (kind, threads)
    if key not in _devices:
        oidn = _library()
        check_device(kind)
        types = {"auto": "Default", "cpu": "CPU", "cuda": "CUDA"}
        try:
            device = oidn.Device(getattr(oidn.DeviceType, types[kind]))
            if threads is not None and device.type == oidn.DeviceType.CPU:
                device.num_threads = threads
            device.commit()
        except RuntimeError as error:
            raise EngineError(
                f"Open Image Denoise finds no device '{kind}': {error}",
                remedy="use --device cpu"
                if kind != "cpu"
                else "it needs a 64-bit processor with SSE4.1 or NEON",
            ) from error
        _devices[key] = device
    return _devices[key]


def _filter(options: Options, shapes: tuple[Any, ...]) -> Any:
    """A filter with these options that last saw images of these shapes, or a new one."""
    key = (options, shapes)
    if key in _filters:
        _filters.move_to_end(key)
        return _filters[key]
    oidn = _library()
    made = _device(options.device, options.threads).new_filter("RT")
    made.quality = getattr(oidn.Quality, options.quality.capitalize())
    made.hdr = options.hdr
    made.srgb = options.srgb
    made.clean_aux = options.clean_aux
    made.input_scale = options.input_scale
    if options.max_memory_mb is not None:
        made.max_memory_mb = options.max_memory_mb
    _filters[key] = made
    while len(_filters) > _KEPT:
        _filters.popitem(last=False)
    return made


def _clean(
    images: Mapping[str, FloatImage],
    options: Options,
    progress: Progress | None,
    stop: threading.Event,
) -> FloatImage:
    main = next(name for name in ("color", "albedo", "normal") if name in images)
    trouble: list[BaseException] = []

    def monitor(done: float) -> bool:
        if progress is not None and not stop.is_set():
            try:
                progress(done, 1.0, "filtering")
            except BaseException as error:  # must not travel through the C++ code
                trouble.append(error)
                stop.set()
        return not stop.is_set()

    with _lock:
        shapes = tuple((name, image.shape) for name, image in images.items())
        worker = _filter(options, shapes)
        bound = []
        try:
            for name, image in images.items():
                _bind(worker, name, _readable(image))
                bound.append(name)
            result = np.empty(images[main].shape, np.float32)
            fetch = _bind(worker, "output", result)
            bound.append("output")
            worker.set_progress_monitor(monitor)
            worker.execute()
            if fetch is not None:
                fetch.read(result)
        except RuntimeError as error:
            if trouble:
                raise trouble[0] from None
            raise _explained(error, stop.is_set()) from error.with_traceback(None)
        finally:
            worker.set_progress_monitor(None)
            for name in bound:
                worker.unset_image(name)
            worker = None  # no traceback may keep it: see the module's docstring
    return result


def _bind(worker: Any, name: str, image: FloatImage) -> Any:
    """Give a filter an image: its memory itself, or a buffer on the device (returned)."""
    if worker.device.can_share(image):
        worker.set_image(name, image)
        return None
    oidn = _library()
    height, width, channels = image.shape
    buffer = worker.device.new_buffer(image.nbytes)
    if name != "output":
        buffer.write(np.ascontiguousarray(image))
    kind = oidn.Format(oidn.Format.Float.value + channels - 1)
    worker.set_image(name, buffer, format=kind, width=width, height=height)
    return buffer


def _readable(image: FloatImage) -> FloatImage:
    """The image in a memory layout that OIDN takes: float32, channels adjacent, rows forward."""
    rows, columns, channels = image.strides
    plain = channels == 4 and columns >= 4 * image.shape[2] and rows >= columns * image.shape[1]
    if image.dtype == np.float32 and plain:
        return image
    return np.ascontiguousarray(image, dtype=np.float32)


def _explained(error: RuntimeError, stopped: bool) -> EngineError:
    if stopped:
        return EngineError("the denoising was stopped")
    code = getattr(getattr(error, "code", None), "name", "")
    remedy = {
        "OutOfMemory": "allow less with --max-memory, so that it works in tiles",
        "UnsupportedHardware": "use --device cpu, or take another model",
    }.get(code)
    return EngineError(f"Open Image Denoise: {error}", remedy=remedy)
