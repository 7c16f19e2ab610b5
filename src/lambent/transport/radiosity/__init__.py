"""Radiosity (Goral et al. 1984): B = E + ρ F B on patches, on any Mitsuba scene.

In the order in which they are used: `settings` is what a person can choose, `patches` cuts the
surfaces, `pairs` (of polygons) and `casting` (rays) find the form factors F, `balance` makes them
reciprocal and their rows complete, `system` puts the equation together, `solvers` solve it, `solve`
drives all this, `adaptive` decides where to cut finer. The result is a `solution`; `smooth`
interpolates it, `integrator` shows it in Mitsuba, `export` writes it for others. `method` is the
entry in the registry of methods.
"""
