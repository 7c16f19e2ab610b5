"""What can be learned, by name: the ``task`` of a recipe.

An entry is a `task.Learnable`: options with their ranges, network, and the task that trains it.
"""

from lambent.registry import Registry

TASKS = Registry(
    "task",
    {
        "denoise": "lambent.learn.denoising:DENOISE",
        "photo": "lambent.learn.photo:PHOTO",
        "kpcn": "lambent.learn.networks.kpcn:LEARN_KPCN",
        "dpcn": "lambent.learn.networks.kpcn:LEARN_DPCN",
        "modular": "lambent.learn.networks.modular:LEARN_MODULAR",
        "blocks": "lambent.learn.networks.blocks:LEARN_BLOCKS",
    },
)
