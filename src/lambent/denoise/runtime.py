"""The inference engine for learned denoisers: OpenVINO.

`network` compiles a model for this machine and keeps it for the process; of the papers' networks,
which take frames of any size, what OpenVINO compiles is cached on disk (``$LAMBENT_CACHE`` or
``~/.cache/lambent``, folder ``compiled``). Our own is compiled for each size of frames.
Convolutions may be int8; what is between them is computed in the processor's own short type
(bfloat16 where it has matrix units for it), or in float32.

`probe` tells whether OpenVINO is there and which precisions the processor runs natively.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.denoise.compiled import compiled
from lambent.denoise.foreign import check_graph
from lambent.denoise.model_file import ModelFile
from lambent.denoise.openvino import openvino
from lambent.denoise.prepare import packed_memory
from lambent.denoise.views import two_views
from lambent.errors import DamagedFileError, EngineError
from lambent.frame.layer import FloatImage
from lambent.kernels.pyramid import Logits, Workspace, logits_memory
from lambent.startup import claim

#: The channels that the network gives (`learn.networks.lambent`), and at which fraction of the
#: packed size: of the pyramid's levels, and of the albedo's kernels.
OUTPUTS = ((144, 1), (35, 1), (35, 2), (35, 4), (25, 8), (36, 1))


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
        ov = openvino()
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


class Network:
    """A compiled network. Calls take turns: one uses all cores.

    ``compiled``: by OpenVINO; None where a subclass compiles later.
    """

    def __init__(self, compiled: Any = None) -> None:
        self._request: Any = None if compiled is None else compiled.create_infer_request()
        self._lock = threading.Lock()

    def __enter__(self) -> Network:
        self._lock.acquire()
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def outputs(self, *planes: FloatImage) -> list[FloatImage]:
        """All outputs for inputs ``(1, C, H, W)``, float32; the next call writes them again.

        Only within ``with network:``.
        """
        ov = openvino()
        for number, array in enumerate(planes):
            self._request.set_input_tensor(number, ov.Tensor(array, shared_memory=True))
        self._run()
        return [
            self._request.get_output_tensor(number).data
            for number in range(len(self._request.model_outputs))
        ]

    def _run(self) -> None:
        self._request.start_async()
        try:
            while not self._request.wait_for(100):  # so that Ctrl-C is heard
                pass
        except BaseException:  # it writes to memory that may be let go after this
            self._request.cancel()
            with suppress(RuntimeError):  # which says that it was cancelled
                self._request.wait()
            raise


class PyramidNetwork(Network):
    """The network of our own denoiser: its logits go where `kernels.pyramid` takes them from.

    It is compiled for one size of frames, again for another (0.1 s): OpenVINO then knows where each
    tensor ends, and lets the next have its memory, which it does not for sizes that it does not
    know (1280x720: 180 MB in place of 340). All memory is used again by the next frame of the size.
    """

    def __init__(
        self, graph: Any, compile_: Callable[[Any], Any], step: float | None = None
    ) -> None:
        super().__init__()
        self._graph, self._compile = graph, compile_
        #: The input is whole numbers of this step, int8; None: it is float32.
        self.step = step
        self._logits: list[Logits] = []
        self._packed: NDArray[Any] | None = None
        self._layers: frozenset[str] | None = None
        self.workspace = Workspace()

    def input(self, shape: tuple[int, ...], layers: Iterable[str]) -> tuple[NDArray[Any], bool]:
        """Memory for packed inputs, the same for every frame of a size; and whether it holds just
        these layers (`holds`), so that the planes of all others are 0.
        """
        if self._packed is None or self._packed.shape != shape:
            self._packed = self._layers = None
            self._packed = packed_memory(shape, self.step)
        return self._packed, self._layers == frozenset(layers)

    def holds(self, layers: Iterable[str] | None) -> None:
        """The memory has been filled with these layers; None: it is about to be."""
        self._layers = None if layers is None else frozenset(layers)

    def __enter__(self) -> PyramidNetwork:
        super().__enter__()
        return self

    def __call__(self, packed: NDArray[Any]) -> list[Logits]:
        """The logits of every level ``(channels, H/2^l, W/2^l)``, then those of the albedo ``(36,
        H/2, W/2)``, for ``packed`` ``(1, C, H/2, W/2)``, int8 or float32 as `step` says.

        They are bfloat16 (`kernels.pyramid`): the largest tensors there are, and half as large.

        Only within ``with network:``; the arrays are written again by the next call.
        """
        ov = openvino()
        height, width = packed.shape[2:]
        shapes = [(count, height // part, width // part) for count, part in OUTPUTS]
        if [a.shape for a in self._logits] != shapes:
            self._logits, self._request = [], None  # let go first
            self._graph.reshape([1, packed.shape[1], height, width])
            request = self._compile(self._graph).create_infer_request()
            memory = [logits_memory(shape, short=True) for shape in shapes]
            for number, array in enumerate(memory):
                shape = ov.Shape([1, *array.shape])
                request.set_output_tensor(number, ov.Tensor(array, shape, ov.Type.bf16))
            self._request, self._logits = request, memory
        self._request.set_input_tensor(ov.Tensor(packed, shared_memory=True))
        self._run()
        return self._logits


_networks: dict[tuple[Any, ...], Network] = {}
_networks_lock = threading.Lock()


def pyramid_network(
    model: ModelFile, precision: str = "auto", threads: int | None = None, views: int = 1
) -> PyramidNetwork:
    """`network` of a model that reads signals and predicts a pyramid's kernels."""
    found = network(model, OUTPUTS, precision, threads, views)
    assert isinstance(found, PyramidNetwork)
    return found


def network(
    model: ModelFile,
    outputs: Sequence[tuple[int, int]],
    precision: str = "auto",
    threads: int | None = None,
    views: int = 1,
) -> Network:
    """The network of a model, compiled for this machine.

    ``outputs``: what it has to give: channels, and by what its size is less than the input's.
    ``precision``: of what is not int8: ``"auto"`` (the processor's best), or ``"f32"``.
    ``views``: 2 for `views.two_views`, of a model that predicts a pyramid's kernels. Raises
    `EngineError` without OpenVINO, `DamagedFileError` for a network it does not take.
    """
    key = (str(model.card["sha256"]), tuple(outputs), precision, threads, views)
    claim("OpenVINO")
    with _networks_lock:
        if key not in _networks:
            _networks[key] = _made(model, outputs, precision, threads, views)
        return _networks[key]


def _made(
    model: ModelFile,
    outputs: Sequence[tuple[int, int]],
    precision: str,
    threads: int | None,
    views: int,
) -> Network:
    """The network of a model."""
    try:
        core = _core()
    except ImportError as error:
        raise EngineError(
            f"OpenVINO does not load: {error}", remedy="pip install openvino, or --model oidn"
        ) from error
    options: dict[str, Any] = {"PERFORMANCE_HINT": "LATENCY"}
    if precision == "f32":
        options["INFERENCE_PRECISION_HINT"] = "f32"
    if threads is not None:
        options["INFERENCE_NUM_THREADS"] = threads
    try:
        graph = core.read_model(model.network, model.weights)
        check_graph(model, graph, outputs)
        if not _is_pyramid(model):
            identity = str(sorted(model.card["sha256"].items()))
            return Network(compiled(core, graph, options, identity, openvino().__version__))
        step = _with_short_input(graph)
        if views == 2:
            again = core.read_model(model.network, model.weights)
            _with_short_input(again)
            graph = two_views(graph, again)
        graph = _with_short_outputs(graph)
    except RuntimeError as error:
        raise _refused(model, error) from error

    def compile_(graph: Any) -> Any:
        try:  # for one size of frames: not worth a place in the cache
            return core.compile_model(graph, "CPU", options)
        except RuntimeError as error:
            raise _refused(model, error) from error

    return PyramidNetwork(graph, compile_, step)


def _refused(model: ModelFile, error: RuntimeError) -> DamagedFileError:
    return DamagedFileError(
        f"OpenVINO rejects this network: {str(error).strip().splitlines()[-1]}",
        file=model.path,
        remedy="install Lambent again, or export the model again",
    )


def _is_pyramid(model: ModelFile) -> bool:
    return bool(model.card.get("reads", "signals") == "signals")


def _with_short_input(graph: Any) -> float | None:
    """Let a graph whose input is rounded first take the whole numbers instead; their step.

    A quarter of the memory, and a pass over it less. None where the input is not rounded.
    """
    ov = openvino()
    op = ov.opset13
    (old,) = graph.get_parameters()
    rounding = [target.get_node() for target in old.output(0).get_target_inputs()]
    if [node.get_type_name() for node in rounding] != ["FakeQuantize"]:
        return None
    low, high = (float(rounding[0].input_value(n).get_node().data.reshape(-1)[0]) for n in (1, 2))
    step = high / 127
    if rounding[0].get_attributes()["levels"] != 256 or abs(low + 128 * step) > 1e-3 * step:
        return None
    new = op.parameter(old.get_partial_shape(), ov.Type.i8, "packed")
    values = op.multiply(op.convert(new, "f32"), np.float32(step))
    for target in rounding[0].output(0).get_target_inputs():
        target.replace_source_output(values.output(0))
    graph.add_parameters([new])
    graph.remove_parameter(old)
    graph.validate_nodes_and_infer_types()
    return step


def _with_short_outputs(graph: Any) -> Any:
    """The graph with bfloat16 outputs."""
    ov = openvino()
    ends = ov.preprocess.PrePostProcessor(graph)
    for number in range(len(graph.outputs)):
        ends.output(number).tensor().set_element_type(ov.Type.bf16)
    return ends.build()


@functools.lru_cache(maxsize=1)
def _core() -> Any:
    return openvino().Core()
