"""Scenes for solvers of light: instances unfolded, so that every surface point is one point.

A Mitsuba instance shows one shape group many times; light falls on each copy differently. So a
scene file is read by Mitsuba's own parser, every instance is replaced by the shapes of its group,
moved to where the instance has them, and then the scene is built.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import LambentError, OptionError, stop_by_interrupt
from lambent.render.scene import LoadedScene, build, load
from lambent.render.variant import mitsuba
from lambent.transport.extra import check_extra


def load_for_light(source: Any, **options: Any) -> LoadedScene:
    """As `lambent.render.scene.load`, with the instances of a scene file unfolded.

    Raises what `load` raises, and `OptionError` for a scene in memory that has instances.
    """
    check_extra()
    loaded = load(source, **options)
    importlib.import_module("lambent.transport.diffuse")  # registers an integrator
    if not any(shape.class_name() == "Instance" for shape in loaded.scene.shapes()):
        return loaded
    if loaded.path is None:
        raise OptionError(
            "the scene in memory has instances, which cannot be told apart",
            remedy="give the scene's file, or shapes in place of instances",
        )
    try:
        mi = mitsuba(options.get("device", "auto"))
        scene = build(mi, loaded.path, options.get("parameters") or {}, _unfold)
    except LambentError:
        raise
    except Exception as error:
        stop_by_interrupt(error)
        raise OptionError(
            f"its instances cannot be unfolded: {error}",
            file=loaded.path,
            remedy="replace them by shapes",
        ) from error
    again = load(scene, **{k: v for k, v in options.items() if k != "parameters"})
    return LoadedScene(
        again.scene, again.sensor, loaded.digest, loaded.path, loaded.depth, loaded.rr_depth,
        loaded.notes,
    )  # fmt: skip


# ------------------------------------------------------------------- private


def _unfold(mi: Any, nodes: Any) -> None:
    """Put the shapes of its group in the place of every instance."""
    for number in range(len(nodes)):
        for key, target in _references(mi, nodes[number].props):
            child = nodes[target]
            if child.props.plugin_name() != "instance":
                continue
            move = _matrix(child.props)
            made = []
            for _, group in _references(mi, child.props):
                if nodes[group].props.plugin_name() == "shapegroup":
                    made += [
                        _moved(mi, nodes, shape, move)
                        for _, shape in _references(mi, nodes[group].props)
                    ]
            props = nodes[number].props
            del props[key]
            for k, index in enumerate(made):
                props[f"{key}_{k}"] = mi.Properties.ResolvedReference(index)


def _references(mi: Any, props: Any) -> list[tuple[str, int]]:
    return [
        (key, props[key].index())
        for key in props.keys()  # noqa: SIM118 (Mitsuba's own mapping)
        if isinstance(props[key], mi.Properties.ResolvedReference)
    ]


def _matrix(props: Any) -> NDArray[np.float64]:
    """A node's ``to_world``, 4x4."""
    if "to_world" not in props:
        return np.eye(4)
    return np.array(props["to_world"].matrix, np.float64).reshape(4, 4)


def _moved(mi: Any, nodes: Any, number: int, move: Any) -> int:
    """A copy of a shape's node, moved; its number."""
    node = nodes[number]
    copy = type(node)()
    copy.type, copy.file_index, copy.offset = node.type, node.file_index, node.offset
    props = mi.Properties(node.props)
    props.set_id("")
    if props.plugin_name() == "sphere" and np.linalg.det(move[:3, :3]) < 0:
        # Mitsuba turns a mirrored sphere inside out; an instance of one it does not
        props["flip_normals"] = not props.get("flip_normals", False)
    props["to_world"] = mi.ScalarAffineTransform4d(move @ _matrix(node.props))
    copy.props = props
    nodes.append(copy)
    return len(nodes) - 1
