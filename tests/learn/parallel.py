"""A short training, to be run in one process or several."""

import itertools
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import made
import torch

from lambent.learn.denoising import DenoisingTask
from lambent.learn.recipe import TrainRecipe
from lambent.learn.train import train_task as train


class Whole(DenoisingTask):
    """One process with what two have between them."""

    def batches(self, first, rank, world):
        for step in itertools.count(first):
            yield step, self.recipe.batch // 2

    def tensors(self, batch):
        step, size = batch
        halves = [super(Whole, self).tensors((step, rank, size)) for rank in self._apart()]
        return tuple(torch.cat(parts) for parts in zip(*halves, strict=True))

    def _apart(self):
        for rank in range(2):
            self._drawn = None  # what was drawn is another process's
            yield rank


if __name__ == "__main__":
    torch.set_num_threads(1)
    data, run = map(Path, sys.argv[1:3])
    recipe = TrainRecipe(
        name="parallel", size="fast", steps=3, batch=4, warmup=1, check_every=100, checked=2,
        held_out=0.0,
    )  # fmt: skip
    folder = data / f"copy{run.name}{os.environ.get('RANK', '')}"
    folder.mkdir(exist_ok=True)
    task = Whole if "RANK" not in os.environ else DenoisingTask
    train(recipe, task(recipe, made.stills(folder)), run, "cpu")
