"""The engine for an NVIDIA GPU: our own network at run time, by PyTorch.

The same steps as on the processor (`denoise.prepare`, `denoise.runtime`, `kernels.pyramid`), with
PyTorch in place of OpenVINO and the filter of training in place of the compiled loops. It joins
`denoise.engines` through the entry point ``cuda`` of ``lambent.engines``.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from lambent.denoise.engines import Work
from lambent.denoise.inputs import OFFSET
from lambent.denoise.prepare import packed_inputs
from lambent.denoise.views import turned_inputs, turned_outputs
from lambent.device import choose_device
from lambent.frame.layer import FloatImage
from lambent.kernels.exponential import LEAST
from lambent.kernels.pyramid import COARSE, OWN, TINY
from lambent.learn.export import float_weights
from lambent.learn.networks.kernel_pyramid import LOGITS, average, cells, near
from lambent.learn.networks.lambent import WIDTHS, LambentNet
from lambent.learn.networks.rounded import RoundedNet


@functools.lru_cache(maxsize=4)
def network(model: str, device: str) -> LambentNet:
    """The network of a model file on a device. Raises `FileError`, `EngineError`."""
    choose_device(device, torch.cuda.is_available)
    weights = float_weights(model, steps=True)
    size = next(n for n, widths in WIDTHS.items() if widths[0] == len(weights["stem.weight"])
                and widths[-1] == len(weights["enc3b.weight"]))  # fmt: skip
    # what was taught in int8 counts on activations that end at their largest integer
    found = RoundedNet(size) if "steps.input" in weights else LambentNet(size)
    found.load_state_dict(weights)
    return found.eval().to(device).to(memory_format=torch.channels_last)


def cuda(work: Work) -> list[FloatImage]:
    """The images, filtered (`denoise.engines`). Raises `EngineError`, `FileError`."""
    packed = packed_inputs(work.given, work.whole, work.preference, "auto")
    weights, divisor = str(work.model.path), work.given.divisor()
    return filtered(weights, packed, work.images, work.divided, divisor, "cuda", work.views)


@torch.no_grad()
def filtered(
    model: str,
    packed: FloatImage,
    images: Sequence[FloatImage],
    divided: Sequence[bool],
    divisor: FloatImage | None,
    device: str,
    views: int = 1,
) -> list[FloatImage]:
    """Images ``(H, W, 1 or 3)`` filtered; where ``divided``, the quotient, too, and both put
    together by the gate. ``divisor`` ``(H, W, 3)``: before it is averaged.

    ``packed``: `denoise.prepare.packed_inputs`, H and W padded to multiples of 32. ``views``: looks
    at the frame, 1 or 2. What is not finite counts as 0.
    """
    net = network(model, device)
    inputs = torch.from_numpy(packed).to(device).contiguous(memory_format=torch.channels_last)
    with torch.autocast(device, torch.bfloat16, enabled=device == "cuda"):
        logits = [level.float() for level in net(inputs)]
        if views == 2:  # `denoise.views`, with the picture turned in place of the network
            turned = net(inputs[:, turned_inputs()].flip(2, 3))
            logits = [
                (a + b[:, turned_outputs(b.shape[1])].flip(2, 3)) / 2
                for a, b in zip(logits, turned, strict=True)
            ]
    height, width = images[0].shape[:2]
    room = (0, 2 * packed.shape[3] - width, 0, 2 * packed.shape[2] - height)
    mask = F.pad(torch.ones(1, 1, height, width, device=device), room)
    *levels, of_albedo = logits
    gate = torch.sigmoid(F.pixel_shuffle(levels[0][:, 4 * LOGITS :].float(), 2))
    d = None
    if divisor is not None:
        d = near(of_albedo, torch.cat([F.pad(_planes(divisor, device), room), mask], 1))
        d = (d[:, :-1] / (d[:, -1:] + TINY)).clamp_min(OFFSET)
    found = []
    for image, own in zip(images, divided, strict=True):
        c = F.pad(torch.nan_to_num(_planes(image, device), 0, 0, 0), room)
        if d is None or not own:
            out = masked(levels, c, mask)
        else:
            by = d if c.shape[1] == 3 else d.mean(1, keepdim=True)
            quotient, plain = masked(levels, torch.cat([c / by, c], 1), mask).chunk(2, 1)
            out = gate * by * quotient + (1 - gate) * plain
        out = out[0, :, :height, :width].permute(1, 2, 0)
        found.append(np.ascontiguousarray(out.cpu().numpy()))
    return found


def masked(logits: Sequence[Tensor], image: Tensor, mask: Tensor) -> Tensor:
    """`kernel_pyramid.apply` where only part of the pixels are there, as `kernels.pyramid` does it.

    ``mask`` ``(1, 1, H, W)``: 1 where there is a pixel. Weights over all taps, then divided by the
    sum of those that are there.
    """
    images, masks = [image * mask], [mask]
    for number, level in enumerate(logits[:-1]):
        u = cells(level, packed=number == 0)
        e = torch.exp((u - u.amax((3, 5), keepdim=True)).clamp_min(LEAST)) * _folded(masks[-1])
        total = e.sum((3, 5)) + TINY
        images.append((_folded(images[-1]) * e).sum((3, 5)) / total)
        masks.append(F.max_pool2d(masks[-1], 2))
    out: Tensor | None = None
    for number in range(len(logits) - 1, -1, -1):
        own = torch.cat([images[number], masks[number]], 1)
        above = None if out is None else torch.cat([out, masks[number + 1]], 1)
        packed, taps = number == 0, OWN if above is None else OWN + COARSE
        both = average(_floored(logits[number], taps, packed), own, above, packed)
        out = both[:, :-1] / (both[:, -1:] + TINY) * masks[number]
    assert out is not None
    return out


def _floored(logits: Tensor, taps: int, packed: bool) -> Tensor:
    """The logits of the taps, none more than `LEAST` below the highest: as the kernels have it."""
    b, _, h, w = logits.shape
    count = taps * (4 if packed else 1)
    own = logits[:, :count].reshape(b, taps, -1, h, w)
    own = torch.maximum(own, own.amax(1, keepdim=True) + LEAST)
    return torch.cat([own.flatten(1, 2), logits[:, count:]], 1)


def _folded(image: Tensor) -> Tensor:
    b, c, h, w = image.shape
    return image.reshape(b, c, h // 2, 2, w // 2, 2)


def _planes(image: FloatImage, device: str) -> Tensor:
    """``(H, W, C)`` to ``(1, C, H, W)`` there."""
    planes = np.array(image.transpose(2, 0, 1), np.float32, order="C")  # a copy that is our own
    return torch.from_numpy(planes)[None].to(device)
