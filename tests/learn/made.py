"""Small noisy frames with known answers, for learning from; tests here need the extra ``train``."""

import numpy as np
import pytest
import torch

from lambent.dataset.item import Still
from lambent.frame.frame import Frame
from lambent.learn import cache


@pytest.fixture(autouse=True)
def few_threads():
    """Tests run in several processes: one thread each. Imported, it holds for a whole file."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def frame(rng, spp, size=64, clean=None, lobes=False):
    """A textured picture under soft light, with ``spp`` samples of noise.

    ``lobes``: with a glossy stripe apart from the rest.
    """
    y, x = np.mgrid[0:size, 0:size].astype(np.float32) / size
    albedo = np.stack([0.5 + 0.4 * np.sin(20 * x), 0.5 + 0.4 * np.cos(17 * y), 0.6 + 0 * x], 2)
    light = (0.2 + x * y)[:, :, None]
    picture = (albedo * light).astype(np.float32)
    noise = 0.5 * picture / np.sqrt(spp)
    normal = np.zeros((size, size, 3), np.float32)
    normal[:, :, 2] = 1
    colour = picture if clean else rng.gamma(picture**2 / noise**2, noise**2 / picture)
    apart = {}
    if lobes:
        gloss = np.repeat(np.exp(-((x - 0.5) ** 2) * 200)[:, :, None], 3, 2).astype(np.float32)
        shine = gloss if clean else gloss * rng.gamma(spp, 1 / spp, gloss.shape)
        apart = {
            "diffuse": colour.astype(np.float32),
            "specular": shine.astype(np.float32),
            "diffuse_albedo": albedo.astype(np.float32),
            "diffuse_variance": noise.astype(np.float32) ** 2,
            "specular_variance": gloss**2 / spp,
        }
        colour = colour + shine
    return Frame.from_arrays(
        **apart,
        spp=spp,
        colour=colour.astype(np.float32),
        colour_variance=noise.astype(np.float32) ** 2,
        albedo=albedo.astype(np.float32),
        normal=normal,
        depth=(1 + y[:, :, None]).astype(np.float32),
        roughness=np.full((size, size, 1), 0.5, np.float32),
    )


def still(seed, size=64, lobes=False):
    """Levels of 1, 4 and 16 spp and the clean target."""
    rng = np.random.default_rng(seed)
    levels = tuple(frame(rng, spp, size, lobes=lobes) for spp in (1, 4, 16))
    return Still(levels, frame(rng, 4096, size, clean=True, lobes=lobes))


def stills(folder, count=4, size=64, lobes=False):
    """Cached stills of as many scenes."""
    found = []
    for number in range(count):
        path = folder / f"{number}.npy"
        about = cache._store(path, still(number, size, lobes))
        found.append(
            cache.Cached(
                path,
                tuple(about["spp"]),
                tuple(tuple(n) for n in about["layers"]),
                f"scene {number}",
                about["exposure"],
            )
        )
    return found
