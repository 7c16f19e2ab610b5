"""The one training loop. It knows no task: `lambent.learn` and others bring theirs.

Importing the package, `schedule`, `run` and `task` needs no PyTorch; `loop` and `graphed` do.
Reading order and an example are in README.md.
"""
