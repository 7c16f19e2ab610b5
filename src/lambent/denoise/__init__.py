"""Denoising at run time: the pipeline from file to file, tiles, sequences."""
