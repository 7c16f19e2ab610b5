"""The inference engine for learned denoisers: the only place that imports OpenVINO.

OpenVINO is optional so far (the embedded default, OIDN, brings its own engine); `probe` tells
whether it is there and which precisions the processor runs natively.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Inference:
    """What OpenVINO finds on this machine.

    ``precisions``: what the processor computes in natively ("FP32", "INT8", "BF16", …).
    """

    version: str
    devices: tuple[str, ...]
    processor: str
    precisions: tuple[str, ...]

    def best_precision(self) -> str:
        """The precision our networks are fastest in: int8, which touches weights only."""
        return "INT8" if "INT8" in self.precisions else "FP32"


def probe() -> Inference | None:
    """Ask OpenVINO what it can do here; None where it is not installed or does not load."""
    try:
        import openvino as ov
    except ImportError:
        return None
    core = ov.Core()
    devices = tuple(str(name) for name in core.available_devices)
    if "CPU" not in devices:
        return Inference(ov.__version__.split("-")[0], devices, "", ())
    abilities = core.get_property("CPU", "OPTIMIZATION_CAPABILITIES")
    known = ("FP32", "BF16", "FP16", "INT8")
    return Inference(
        version=ov.__version__.split("-")[0],
        devices=devices,
        processor=str(core.get_property("CPU", "FULL_DEVICE_NAME")),
        precisions=tuple(name for name in known if name in abilities),
    )
