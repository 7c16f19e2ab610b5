"""The light of a scene, solved once and looked at from anywhere.

`solve` is the verb; what it returns is a `solution.Solution`. A method is a package (`radiosity`)
and an entry in `methods`. What they share stands here: what a surface is to a diffuse world
(`diffuse`), the shapes as parametrised primitives (`surfaces`), scenes without instances (`scene`).
"""
