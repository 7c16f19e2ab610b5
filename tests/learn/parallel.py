"""A short training, to be run in one process or several."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import made
import torch

from lambent.learn.denoising import DenoisingTask
from lambent.learn.recipe import TrainRecipe
from lambent.learn.train import train_task as train

if __name__ == "__main__":
    torch.set_num_threads(1)
    data, run = map(Path, sys.argv[1:3])
    recipe = TrainRecipe(
        name="parallel", size="fast", steps=3, batch=4, warmup=1, check_every=100, checked=2,
        held_out=0.0,
    )  # fmt: skip
    folder = data / f"copy{run.name}{__import__('os').environ.get('RANK', '')}"
    folder.mkdir(exist_ok=True)
    train(recipe, DenoisingTask(recipe, made.stills(folder)), run, "cpu")
