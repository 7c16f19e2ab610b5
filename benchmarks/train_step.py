"""Where a training step of our own denoiser goes, and how many crops a second that makes.

    python benchmarks/train_step.py [--device cuda] [--batch 128] [--sizes fast,default,best]

Crops are noise of the right shape (time does not depend on what is in them), on the device as
`learn.stills` keeps them. On CUDA the filter's kernels (Triton) are first compared with the same
tap by tap, forwards and backwards, and both are timed. "issued": until the processor had asked for
everything; where that is nearly all of the time, the device waits for the processor. "recorded": as
`lambent train` does it on CUDA, the step a CUDA graph (`training.graphed`), several batches at
once.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import torch

from filters import machine, markdown_table
from lambent.learn import losses
from lambent.learn.batches import batch_of
from lambent.learn.cache import PLANES_OF, STORED, TARGET_PLANES, Cached
from lambent.learn.denoising import TOGETHER, Batch, cleaned
from lambent.learn.networks import kernel_pyramid
from lambent.learn.networks.lambent import WIDTHS, LambentNet
from lambent.learn.networks.rounded import RoundedNet
from lambent.learn.stills import Stills
from lambent.training.graphed import Graphed


def stills(folder: Path, count: int = 8) -> list[Cached]:
    """Cached stills of noise, three levels each."""
    rng = np.random.default_rng(0)
    found = []
    for number in range(count):
        shape = (3 * PLANES_OF + TARGET_PLANES, 128, 128)
        path = folder / f"{number}.npy"
        np.save(path, (0.3 * np.abs(rng.standard_normal(shape))).astype(np.float16))
        found.append(Cached(path, (1, 8, 64), (tuple(STORED),) * 3, str(number), 1.0))
    return found


def timed(device: torch.device, what: Callable[[], object], rounds: int) -> tuple[float, float]:
    """Seconds a call, and until it was issued; after a few calls to warm up."""
    wait = torch.cuda.synchronize if device.type == "cuda" else lambda: None
    for _ in range(min(5, rounds)):
        what()
    wait()
    start = time.perf_counter()
    for _ in range(rounds):
        what()
    issued = time.perf_counter() - start
    wait()
    return (time.perf_counter() - start) / rounds, issued / rounds


def compare_filters(batch: int, rounds: int) -> str:
    """Triton's kernels against tap by tap on CUDA: largest difference, and milliseconds."""
    device, triton = torch.device("cuda"), kernel_pyramid._triton
    z = 2 * torch.randn(batch, 144, 64, 64, device=device)
    z = z.to(memory_format=torch.channels_last)
    image = torch.rand(batch, 6, 128, 128, device=device)
    coarse = torch.rand(batch, 6, 64, 64, device=device)
    results, seconds = [], []
    for way in (triton, lambda: None):
        kernel_pyramid._triton = way  # type: ignore[assignment]
        inputs = [t.clone().requires_grad_() for t in (z, image, coarse)]

        def both(inputs: list[torch.Tensor] = inputs) -> torch.Tensor:
            for tensor in inputs:
                tensor.grad = None
            out = kernel_pyramid.average(*inputs, packed=True)
            (out * out).sum().backward()
            return out

        out = both()
        results.append([out.detach(), *(t.grad for t in inputs)])
        seconds.append(timed(device, both, rounds)[0])
    kernel_pyramid._triton = triton
    worst = max(float((a - b).abs().max() / b.abs().max()) for a, b in zip(*results, strict=True))
    return (
        f"finest level of the filter, forwards and backwards: Triton {1e3 * seconds[0]:.2f} ms, "
        f"tap by tap {1e3 * seconds[1]:.2f} ms; largest difference {worst:.1e} of the largest value"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--batch", type=int)
    parser.add_argument("--sizes", default=",".join(WIDTHS))
    parser.add_argument("--rounds", type=int)
    arguments = parser.parse_args()
    device = torch.device(arguments.device)
    batch = arguments.batch or (128 if device.type == "cuda" else 16)
    rounds = arguments.rounds or (20 if device.type == "cuda" else 2)
    name = torch.cuda.get_device_name() if device.type == "cuda" else machine()
    print(f"{name}; batches of {batch} crops of 128x128; ms, in brackets until issued\n")
    if device.type == "cuda":
        torch.backends.cudnn.benchmark = True
        print(compare_filters(batch, rounds) + "\n")
    with tempfile.TemporaryDirectory() as folder:
        residents = Stills(stills(Path(folder)), device)
    steps = iter(range(1 << 30))

    def made() -> Batch:
        packed, *rest = batch_of(residents, 1, next(steps), batch)
        return Batch.of(packed, *rest)

    def several() -> Iterator[Batch]:
        together = TOGETHER.get(device.type, 1)
        while True:
            drawn = batch_of(residents, 1, next(steps), batch * together)
            for packed, *rest in zip(*(part.chunk(together) for part in drawn), strict=True):
                yield Batch.of(packed, *rest)

    def loss_of(
        model: torch.nn.Module, tensors: Sequence[torch.Tensor]
    ) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        b = Batch(*tensors)
        return losses.denoising(cleaned(model, b), b.target, b.colour, b.deviation, b.preference)

    def cell(what: Callable[[], object]) -> tuple[str, float]:
        whole, issued = timed(device, what, rounds)
        return f"{1e3 * whole:.1f} ({1e3 * issued:.1f})", whole

    fixed = made()
    making = cell(made)[0]
    table = []
    for size in arguments.sizes.split(","):
        for kind, words in ((LambentNet, size), (RoundedNet, f"{size}, int8")):
            model = kind(size).to(device).to(memory_format=torch.channels_last)
            adam = torch.optim.AdamW(model.parameters(), fused=device.type == "cuda" or None)

            def network(model: torch.nn.Module = model) -> None:
                with torch.autocast(device.type, torch.bfloat16):
                    outputs = model(fixed.packed)
                sum(o.float().mean() for o in outputs).backward()

            def step(
                b: Batch | None = None,
                model: torch.nn.Module = model,
                adam: torch.optim.Optimizer = adam,
            ) -> None:
                b = b or fixed
                loss, _ = loss_of(model, list(vars(b).values()))
                adam.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
                adam.step()

            whole, seconds = cell(lambda step=step: step(made()))
            row = [words, cell(network)[0], cell(step)[0], making, whole]
            if device.type == "cuda":
                graphed, batches = Graphed(model, loss_of), several()

                def recorded(
                    graphed: Graphed = graphed,
                    batches: Iterator[Batch] = batches,
                    model: torch.nn.Module = model,
                    adam: torch.optim.Optimizer = adam,
                ) -> None:
                    graphed(list(vars(next(batches)).values()))
                    torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
                    adam.step()

                for _ in range(24):  # both shapes of a batch are met
                    recorded()
                text, seconds = cell(recorded)
                row.append(text)
            table.append([*row, f"{batch / seconds:,.0f}"])
    head = ["network", "network", "with filter, loss, Adam", "batch", "all"]
    head += ["recorded"] if device.type == "cuda" else []
    head.append("crops a second")
    print(markdown_table(head, table))


if __name__ == "__main__":
    main()
