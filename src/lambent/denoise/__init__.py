"""Denoising at run time: the pipeline from file to file, tiles, sequences.

Reading order: `pipeline` (one frame), `tiles`, `files` (one file), `sequence` (many), `runtime`.
``lambent.denoise(frame)`` is `lambent.denoise.pipeline.denoise`.
"""
