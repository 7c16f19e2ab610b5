"""The tasks of the denoisers: recipes, data, augmentation, losses, networks, export.

Needs the extra ``train``. Reading order and an example are in README.md.
"""
