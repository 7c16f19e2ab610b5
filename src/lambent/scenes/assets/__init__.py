"""Random scenes of real things: models, materials, environment maps and whole scenes of a folder.

Reading order: `library` (what a folder holds), `gltf` and `model` (a model as meshes and surfaces),
`arrange` (models on a floor, a table, a shelf, terrain or in a room, as a `ScenePlan`), `whole`
(cameras in scenes that somebody made).
"""
