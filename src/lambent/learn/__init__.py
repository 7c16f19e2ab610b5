"""Training: the one loop, its recipes, data, losses and networks. Needs the extra ``train``.

Reading order: `recipe`, `cache` (a data set as arrays), `augment` and `splat` (what may be done to
a picture), `batches`, `networks`, `losses`, `task` and `denoising` (what the loop asks for),
`loop`, `export`, `finetune`. PyTorch is imported here and in no room below.
"""
