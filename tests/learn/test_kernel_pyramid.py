"""The filter in PyTorch: compiled kernels against plain tensors, forwards and backwards."""

import numpy as np
import pytest
import torch

from lambent.kernels import machine, pyramid
from lambent.learn.networks import kernel_pyramid


def logits(batch, size, seed=0):
    torch.manual_seed(seed)
    shapes = [(batch, 144, size // 2, size // 2)]
    shapes += [(batch, 35 if n < 4 else 25, size >> n, size >> n) for n in range(1, 5)]
    return [torch.randn(shape, requires_grad=True) for shape in shapes]


def results(batch, size):
    found = logits(batch, size)
    image = torch.rand(batch, 6, size, size)
    wanted = torch.rand(batch, 6, size, size)
    out = kernel_pyramid.apply(found, image)
    (((out - wanted) ** 2) * torch.arange(6)[:, None, None]).sum().backward()
    return out.detach(), [tensor.grad for tensor in found]


@pytest.mark.skipif(not machine.available("cpu"), reason="needs LLVM")
@pytest.mark.parametrize(("batch", "size"), [(2, 32), (1, 64), (3, 96)])
def test_compiled_kernels_are_the_plain_tensors(monkeypatch, batch, size):
    fast, fast_grads = results(batch, size)
    monkeypatch.setattr(kernel_pyramid, "available", lambda: False)
    plain, plain_grads = results(batch, size)
    torch.testing.assert_close(fast, plain, atol=3e-6, rtol=1e-5)
    for a, b in zip(fast_grads, plain_grads, strict=True):
        torch.testing.assert_close(a, b, atol=2e-5 * float(b.abs().max()), rtol=1e-3)


def test_gradients_are_those_of_finite_differences():
    found = logits(1, 32, seed=1)
    image = torch.rand(1, 3, 32, 32)
    weight = torch.rand(1, 3, 32, 32)

    def value():
        return (kernel_pyramid.apply(found, image) * weight).sum().item()

    (kernel_pyramid.apply(found, image) * weight).sum().backward()
    rng = np.random.default_rng(0)
    for tensor in found:
        for _ in range(3):
            place = tuple(int(rng.integers(n)) for n in tensor.shape)
            if tensor is found[0]:
                place = (place[0], place[1] % 140, *place[2:])  # the gate is not the filter's
            with torch.no_grad():
                tensor[place] += 0.05
                high = value()
                tensor[place] -= 0.1
                low = value()
                tensor[place] += 0.05
            assert tensor.grad[place].item() == pytest.approx((high - low) / 0.1, abs=2e-3)


def test_the_run_time_filters_alike():
    found = [t.detach() for t in logits(1, 64, seed=2)]
    level = pyramid.level_of(6, 64, 64)
    level.planes[...] = np.random.default_rng(0).random(level.planes.shape, np.float32)
    expected = kernel_pyramid.apply(found, torch.tensor(level.planes.copy()[None]))[0]
    memory = []
    for tensor in found:
        memory.append(pyramid.logits_memory(tuple(tensor.shape[1:])))
        memory[-1][...] = tensor[0].numpy()
    out = pyramid.filter_planes(memory, level).planes
    np.testing.assert_allclose(out, expected.numpy(), atol=3e-6)


@pytest.mark.skipif(not machine.available("cpu"), reason="needs LLVM")
@pytest.mark.parametrize("channels", [1, 4, 7])
def test_any_number_of_channels(monkeypatch, channels):
    found = [t.detach().requires_grad_() for t in logits(1, 32, seed=3)]
    image = torch.rand(1, channels, 32, 32)
    results = []
    for fast in (True, False):
        monkeypatch.setattr(kernel_pyramid, "available", lambda fast=fast: fast)
        for tensor in found:
            tensor.grad = None
        out = kernel_pyramid.apply(found, image)
        (out**2).sum().backward()
        results.append((out.detach(), [tensor.grad.clone() for tensor in found]))
    (a, a_grads), (b, b_grads) = results
    torch.testing.assert_close(a, b, atol=3e-6, rtol=1e-5)
    for one, two in zip(a_grads, b_grads, strict=True):
        torch.testing.assert_close(one, two, atol=2e-5 * float(two.abs().max()), rtol=1e-3)


@pytest.mark.parametrize("compiled", [True, False])
def test_near_is_a_softmax_over_nine_neighbours(monkeypatch, compiled):
    if compiled and not machine.available("cpu"):
        pytest.skip("needs LLVM")
    monkeypatch.setattr(kernel_pyramid, "available", lambda: compiled)
    torch.manual_seed(0)
    z = torch.randn(2, 36, 16, 16, requires_grad=True)
    image, weight = torch.rand(2, 3, 32, 32), torch.rand(2, 3, 32, 32)
    (kernel_pyramid.near(z, image) * weight).sum().backward()
    again = z.detach().clone().requires_grad_()
    logits = torch.nn.functional.pixel_shuffle(again, 2)
    one = torch.nn.functional.unfold(torch.ones(1, 1, 32, 32), 3, padding=1).reshape(1, 9, 32, 32)
    share = torch.softmax(torch.where(one > 0, logits, -torch.inf), 1)
    taps = torch.nn.functional.unfold(image, 3, padding=1).reshape(2, 3, 9, 32, 32)
    expected = (taps * share[:, None]).sum(2)
    (expected * weight).sum().backward()
    torch.testing.assert_close(kernel_pyramid.near(z, image), expected, atol=3e-6, rtol=1e-5)
    torch.testing.assert_close(z.grad, again.grad, atol=1e-5, rtol=1e-3)


def test_the_run_time_averages_the_albedo_alike():
    torch.manual_seed(1)
    z = torch.randn(1, 36, 16, 32)
    level = pyramid.level_of(3, 32, 64)
    level.planes[...] = np.random.default_rng(0).random(level.planes.shape, np.float32)
    expected = kernel_pyramid.near(z, torch.tensor(level.planes.copy()[None]))[0]
    memory = pyramid.logits_memory((36, 16, 32))
    memory[...] = z[0].numpy()
    out = pyramid.average_planes(memory, level).planes
    np.testing.assert_allclose(out, expected.numpy(), atol=3e-6)
