"""Small kernels written as LLVM code, for what Dr.Jit's kernels do not reach.

A Dr.Jit kernel is one pass over an image: it reads planes, and writes its results around the cache
(non-temporal stores). NFOR wants loops in loops whose sums stay in registers and whose planes stay
in the cache, which is ten times faster (docs/results/kernels.md). So its loops are written out here
and compiled with the same LLVM library that Dr.Jit compiles with.

`Code` writes a function ``f(params, first, last, scratch)`` line by line; ``params`` is an array of
64-bit numbers and addresses, ``[first, last)`` the image rows to compute, ``scratch`` memory that
belongs to the calling thread. Vectors have 16 floats. `Kernel` compiles it when it is first called,
and `Kernel.rows` runs it on all of Dr.Jit's threads, some rows at a time. There is no such kernel
where LLVM's library is missing or the device is not the processor: `available` tells.
"""

from __future__ import annotations

import ctypes
import functools
import platform
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lambent.kernels.arrays import aligned
from lambent.startup import engine, find_llvm

#: Floats in a vector.
LANES = 16
VECTOR = f"<{LANES} x float>"
_INTEGERS = f"<{LANES} x i32>"
#: LLVM's name of the machine; elsewhere kernels stay with Dr.Jit.
_TARGET = {"x86_64": "X86", "AMD64": "X86", "aarch64": "AArch64", "arm64": "AArch64"}
_Function = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p)

#: Flush what is below 1e-38 to zero, as Dr.Jit does: x86 takes a hundred cycles for each of them,
#: and weights are full of them.
_FLUSH = (
    "  %mode = alloca i32",
    "  %flush = alloca i32",
    "  call void @llvm.x86.sse.stmxcsr(ptr %mode)",
    "  %old = load i32, ptr %mode",
    "  %new = or i32 %old, 32832",  # FTZ and DAZ
    "  store i32 %new, ptr %flush",
    "  call void @llvm.x86.sse.ldmxcsr(ptr %flush)",
)
_RESTORE = ("  call void @llvm.x86.sse.ldmxcsr(ptr %mode)",)


class Loop:
    """A loop being written: ``i`` counts, ``carry`` are the values that go round."""

    def __init__(self, i: str, carry: list[str]) -> None:
        self.i = i
        self.carry = carry
        self.after: list[str] = carry


class Code:
    """LLVM code of one function, written line by line. Values are the names of registers."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._count = 0
        self._block = "entry"

    # -------------------------------------------------------------- values

    def _new(self, text: str) -> str:
        self._count += 1
        self.lines.append(f"  %v{self._count} = {text}")
        return f"%v{self._count}"

    def param(self, number: int) -> str:
        """The ``number``-th parameter, as i64."""
        at = self._new(f"getelementptr i64, ptr %params, i64 {number}")
        return self._new(f"load i64, ptr {at}, align 8")

    def address(self, number: int) -> str:
        """The ``number``-th parameter, as an address."""
        return self._new(f"inttoptr i64 {self.param(number)} to ptr")

    def integer(self, op: str, a: str | int, b: str | int) -> str:
        """``add``, ``sub``, ``mul`` of two i64."""
        return self._new(f"{op} i64 {a}, {b}")

    def least(self, a: str | int, b: str | int) -> str:
        """The smaller of two i64."""
        less = self._new(f"icmp slt i64 {a}, {b}")
        return self._new(f"select i1 {less}, i64 {a}, i64 {b}")

    def most(self, a: str | int, b: str | int) -> str:
        """The greater of two i64."""
        more = self._new(f"icmp sgt i64 {a}, {b}")
        return self._new(f"select i1 {more}, i64 {a}, i64 {b}")

    def at(self, base: str, *index: str | int) -> str:
        """The address of the float at the sum of the indices."""
        total = str(index[0])
        for more in index[1:]:
            total = self.integer("add", total, more)
        return self._new(f"getelementptr float, ptr {base}, i64 {total}")

    def load(self, address: str) -> str:
        """The vector at an address, aligned or not."""
        return self._new(f"load {VECTOR}, ptr {address}, align 4")

    def load_short(self, base: str, *index: str | int) -> str:
        """A vector of bfloat16 at the sum of the indices, as floats: their upper halves."""
        total = str(index[0])
        for more in index[1:]:
            total = self.integer("add", total, more)
        address = self._new(f"getelementptr i16, ptr {base}, i64 {total}")
        short = self._new(f"load <{LANES} x i16>, ptr {address}, align 2")
        wide = self._new(f"zext <{LANES} x i16> {short} to {_INTEGERS}")
        bits = self._new(f"shl {_INTEGERS} {wide}, splat (i32 16)")
        return self._new(f"bitcast {_INTEGERS} {bits} to {VECTOR}")

    def store(self, value: str, address: str) -> None:
        """A vector to an address, aligned or not."""
        self.lines.append(f"  store {VECTOR} {value}, ptr {address}, align 4")

    def prefetch(self, address: str) -> None:
        """Ask for what is needed soon."""
        self.lines.append(f"  call void @llvm.prefetch.p0(ptr {address}, i32 0, i32 2, i32 1)")

    def everywhere(self, address: str) -> str:
        """One float of memory in all lanes."""
        return self._spread(self._new(f"load float, ptr {address}, align 4"))

    def number(self, value: float) -> str:
        """A constant in all lanes."""
        bits = np.array(np.float32(value), np.float64).view(np.uint64)
        return self._spread(f"0x{int(bits):016X}")

    def _spread(self, scalar: str) -> str:
        one = self._new(f"insertelement {VECTOR} poison, float {scalar}, i64 0")
        return self._new(
            f"shufflevector {VECTOR} {one}, {VECTOR} poison, {_INTEGERS} zeroinitializer"
        )

    def op(self, op: str, a: str, b: str) -> str:
        """``fadd``, ``fsub``, ``fmul``, ``fdiv`` of two vectors."""
        return self._new(f"{op} {VECTOR} {a}, {b}")

    def ratio(self, a: str, b: str) -> str:
        """a / b by an estimate of 1/b and a Newton step, where the machine has one."""
        return self._new(f"fdiv arcp {VECTOR} {a}, {b}")

    def fma(self, a: str, b: str, c: str) -> str:
        """a·b + c."""
        call = f"call {VECTOR} @llvm.fmuladd.v{LANES}f32"
        return self._new(f"{call}({VECTOR} {a}, {VECTOR} {b}, {VECTOR} {c})")

    def smaller(self, a: str, b: str) -> str:
        """The smaller of two vectors, lane by lane; b where either is NaN."""
        less = self._new(f"fcmp olt {VECTOR} {a}, {b}")
        return self._new(f"select <{LANES} x i1> {less}, {VECTOR} {a}, {VECTOR} {b}")

    def greater(self, a: str, b: str) -> str:
        """The greater of two vectors, lane by lane; b where either is NaN."""
        more = self._new(f"fcmp ogt {VECTOR} {a}, {b}")
        return self._new(f"select <{LANES} x i1> {more}, {VECTOR} {a}, {VECTOR} {b}")

    def shuffle(self, a: str, b: str, lanes: Sequence[int]) -> str:
        """The lanes of a and b with these numbers; those of b count from 16."""
        mask = ", ".join(f"i32 {lane}" for lane in lanes)
        return self._new(f"shufflevector {VECTOR} {a}, {VECTOR} {b}, {_INTEGERS} <{mask}>")

    def exp(self, x: str) -> str:
        """exp(x) as a weight: `lambent.kernels.exponential`."""
        from lambent.kernels.exponential import LEAST_POWER, LOG2_E, POLYNOMIAL, ROUND

        y = self.greater(self.op("fmul", x, self.number(LOG2_E)), self.number(LEAST_POWER))
        rounded = self.op("fadd", y, self.number(ROUND))
        fraction = self.op("fsub", y, self.op("fsub", rounded, self.number(ROUND)))
        power = self.number(POLYNOMIAL[0])
        for coefficient in POLYNOMIAL[1:]:
            power = self.fma(power, fraction, self.number(coefficient))
        bits = self._new(f"bitcast {VECTOR} {power} to {_INTEGERS}")
        exponent = self._new(f"bitcast {VECTOR} {rounded} to {_INTEGERS}")
        shifted = self._new(f"shl {_INTEGERS} {exponent}, splat (i32 23)")
        total = self._new(f"add {_INTEGERS} {bits}, {shifted}")
        return self._new(f"bitcast {_INTEGERS} {total} to {VECTOR}")

    # --------------------------------------------------------------- loops

    @contextmanager
    def loop(
        self, first: str | int, last: str | int, step: int = 1, carry: Sequence[str] = ()
    ) -> Iterator[Loop]:
        """``for i in range(first, last, step)``; set ``carry`` in the body to what goes round.

        ``after`` holds what has come of it behind the loop.
        """
        self._count += 1
        name = f"loop{self._count}"
        before = self._block
        self.lines += [f"  br label %{name}", f"{name}:"]
        self._block = name
        spot = len(self.lines)
        i = f"%{name}.i"
        heads = [f"%{name}.c{k}" for k in range(len(carry))]
        self.lines += [""] * (1 + len(carry))
        go = self._new(f"icmp slt i64 {i}, {last}")
        self.lines += [f"  br i1 {go}, label %{name}.body, label %{name}.end", f"{name}.body:"]
        self._block = f"{name}.body"
        this = Loop(i, list(heads))
        yield this
        again = self._new(f"add nsw i64 {i}, {step}")
        end = self._block
        self.lines[spot] = f"  {i} = phi i64 [ {first}, %{before} ], [ {again}, %{end} ]"
        for k, (head, start, value) in enumerate(zip(heads, carry, this.carry, strict=True)):
            self.lines[spot + 1 + k] = (
                f"  {head} = phi {VECTOR} [ {start}, %{before} ], [ {value}, %{end} ]"
            )
        self.lines += [f"  br label %{name}", f"{name}.end:"]
        self._block = f"{name}.end"
        this.after = heads

    def text(self, name: str) -> str:
        """The whole module."""
        x86 = _TARGET.get(platform.machine()) == "X86"
        args = "ptr noalias %params, i64 %first, i64 %last, ptr noalias %scratch"
        return "\n".join(
            [
                f"declare {VECTOR} @llvm.fmuladd.v{LANES}f32({VECTOR}, {VECTOR}, {VECTOR})",
                "declare void @llvm.prefetch.p0(ptr, i32, i32, i32)",
                *(f"declare void @llvm.x86.sse.{way}mxcsr(ptr)" for way in ("ld", "st") if x86),
                f"define void @{name}({args}) #0 {{",
                "entry:",
                *(_FLUSH if x86 else ()),
                *self.lines,
                *(_RESTORE if x86 else ()),
                "  ret void",
                "}",
                f'attributes #0 = {{ nounwind "target-cpu"="{_host()[0]}" '
                f'"target-features"="{_host()[1]}" "prefer-vector-width"="512" '
                '"reciprocal-estimates"="vec-divf:1" }',
            ]
        )


@dataclass(eq=False)
class Kernel:
    """A compiled function over image rows.

    ``effort``: LLVM's, 0 to 3. Compiling with 0 takes a third of the time, and code that waits for
    memory runs as fast.
    """

    name: str
    write: Callable[[Code], None]
    effort: int = 3
    _function: Any = field(default=None)

    def rows(
        self,
        params: Sequence[int | np.ndarray],
        first: int,
        last: int,
        scratch: int = 0,
        chunk: int = 4,
    ) -> None:
        """Run it on rows ``first`` to ``last``, ``chunk`` at a time, on all of Dr.Jit's threads.

        ``params``: numbers, and arrays, whose addresses are passed. ``scratch``: floats a thread.
        """
        import drjit as dr

        self.prepare()
        numbers = np.array(
            [p.ctypes.data if isinstance(p, np.ndarray) else p for p in params], np.int64
        )
        starts = iter(range(first, last, chunk))

        def work(_: int) -> None:
            own = aligned((max(scratch, 1),))
            for start in starts:  # `next` of a range is one step of the interpreter: no lock
                self._function(
                    numbers.ctypes.data, start, min(start + chunk, last), own.ctypes.data
                )

        count = max(1, dr.thread_count())
        if count == 1:
            work(0)
            return
        with ThreadPoolExecutor(count) as pool:
            list(pool.map(work, range(count)))

    def call(
        self, params: Sequence[int | np.ndarray], first: int, last: int, scratch: np.ndarray
    ) -> None:
        """Run it on rows ``first`` to ``last`` on the calling thread, with its own scratch."""
        self.prepare()
        numbers = np.array(
            [p.ctypes.data if isinstance(p, np.ndarray) else p for p in params], np.int64
        )
        self._function(numbers.ctypes.data, first, last, scratch.ctypes.data)

    def prepare(self) -> None:
        """Compile it now, if it is not yet."""
        with _compiling:
            if self._function is None:
                code = Code()
                self.write(code)
                self._function = _compile(code.text(self.name), self.name, self.effort)


_compiling = threading.Lock()


def available(device: str = "auto") -> bool:
    """Whether kernels of this kind can run."""
    return engine(device) == "llvm" and _library() is not None


# ------------------------------------------------------------------- LLVM's own interface


@functools.lru_cache(maxsize=1)
def _library() -> Any:
    """LLVM's library with the functions declared, or None."""
    path = find_llvm()
    kind = _TARGET.get(platform.machine())
    if path is None or kind is None:
        return None
    try:
        llvm = ctypes.CDLL(path)
        for part in ("TargetInfo", "Target", "TargetMC", "AsmPrinter"):
            getattr(llvm, f"LLVMInitialize{kind}{part}")()
        llvm.LLVMLinkInMCJIT()
        for name in (
            "LLVMGetHostCPUName", "LLVMGetHostCPUFeatures", "LLVMContextCreate",
            "LLVMCreateMemoryBufferWithMemoryRangeCopy",
        ):  # fmt: skip
            getattr(llvm, name).restype = ctypes.c_void_p
        llvm.LLVMGetFunctionAddress.restype = ctypes.c_uint64
        # opaque pointers and `splat` in the text
        major = ctypes.c_uint()
        llvm.LLVMGetVersion(ctypes.byref(major), None, None)
    except (OSError, AttributeError):
        return None
    return llvm if major.value >= 19 else None


@functools.lru_cache(maxsize=1)
def _host() -> tuple[str, str]:
    """Name and features of this processor."""
    llvm = _library()
    found = []
    for get in (llvm.LLVMGetHostCPUName, llvm.LLVMGetHostCPUFeatures):
        address = get()
        found.append(ctypes.string_at(address).decode())
        llvm.LLVMDisposeMessage(ctypes.c_void_p(address))
    return found[0], found[1]


class _Options(ctypes.Structure):
    """LLVMMCJITCompilerOptions."""

    _fields_ = [
        ("OptLevel", ctypes.c_uint),
        ("CodeModel", ctypes.c_int),
        ("NoFramePointerElim", ctypes.c_int),
        ("EnableFastISel", ctypes.c_int),
        ("MCJMM", ctypes.c_void_p),
    ]


def _compile(text: str, name: str, effort: int) -> Any:
    """The function ``name`` of a module; it stays loaded as long as the process runs."""
    llvm = _library()
    context = ctypes.c_void_p(llvm.LLVMContextCreate())
    raw = text.encode()
    buffer = ctypes.c_void_p(
        llvm.LLVMCreateMemoryBufferWithMemoryRangeCopy(raw, ctypes.c_size_t(len(raw)), b"kernel")
    )
    module, message = ctypes.c_void_p(), ctypes.c_char_p()
    if llvm.LLVMParseIRInContext(
        context, buffer, ctypes.byref(module), ctypes.byref(message)
    ):  # it owns the buffer
        raise RuntimeError(f"LLVM does not understand {name}: {message.value!r}")
    options = _Options()
    size = ctypes.c_size_t(ctypes.sizeof(options))
    llvm.LLVMInitializeMCJITCompilerOptions(ctypes.byref(options), size)
    options.OptLevel = effort
    machine = ctypes.c_void_p()
    if llvm.LLVMCreateMCJITCompilerForModule(
        ctypes.byref(machine), module, ctypes.byref(options), size, ctypes.byref(message)
    ):
        raise RuntimeError(f"LLVM does not compile {name}: {message.value!r}")
    address = llvm.LLVMGetFunctionAddress(machine, name.encode())
    return _Function(address)
