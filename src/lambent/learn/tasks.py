"""What can be learned, by name: the ``task`` of a recipe."""

from lambent.registry import Registry

#: An entry is a function of a recipe, the cache's folder and a progress function to a `Task`.
TASKS = Registry(
    "task",
    {
        "denoise": "lambent.learn.denoising:denoising_task",
        "photo": "lambent.learn.photo:photo_task",
        "kpcn": "lambent.learn.rendered:rendered_task",
        "dpcn": "lambent.learn.rendered:rendered_task",
        "modular": "lambent.learn.rendered:rendered_task",
        "blocks": "lambent.learn.rendered:rendered_task",
    },
)
