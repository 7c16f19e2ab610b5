"""Random scenes to learn from, made from a seed: the same seed, the same scene.

`mitsuba` makes plans of rooms, still lifes, landscapes, halls and studios, and builds Mitsuba
scenes of them; `cycles` builds scenes with Blender's own means and renders them in a Blender.
"""
