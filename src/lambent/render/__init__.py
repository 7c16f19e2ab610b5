"""Frames with every feature, from Mitsuba scenes and from Blender's Cycles.

Reading order: `path` (one sample, and the books it keeps), `surface` (what is seen), `sampling`
(all samples of a picture in one kernel), `moments` (what is known of every pixel), `accumulate` (a
picture that grows and resumes), `animation` and `motion`, `scene` (files), `job` (the verb);
`integrator` is the same as a Mitsuba plug-in. `cycles` talks to Blender. Random scenes are in
`lambent.scenes`.

``lambent.render("scene.xml", spp=64)`` is `lambent.render.job.render`.
"""
