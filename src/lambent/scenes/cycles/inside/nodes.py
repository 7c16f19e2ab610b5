"""Shader nodes in few words: ``tree.add("TexNoise", Vector=v, Scale=5.0).out("Factor")``.

Names of sockets changed over Blender's versions; `Node.out` and the keys of `Tree.add` take the
first that the node has of several (``"Factor|Fac"``).
"""

from __future__ import annotations

from typing import Any

Colour = tuple[float, float, float]


class Node:
    """A node of a tree; its outputs by name."""

    def __init__(self, raw: Any) -> None:
        self.raw = raw

    def out(self, names: str = "") -> Any:
        """An output socket; the first one without a name."""
        if not names:
            return self.raw.outputs[0]
        for name in names.split("|"):
            if name in self.raw.outputs:
                return self.raw.outputs[name]
        raise KeyError(f"{self.raw.bl_idname} has no output {names}")


class Tree:
    """A shader tree: adding nodes, with values or links for their inputs."""

    def __init__(self, raw: Any) -> None:
        self.raw = raw
        self.raw.nodes.clear()
        self._coordinates: Any = None

    def add(self, kind: str, /, *positional: Any, **inputs: Any) -> Node:
        """A node ``ShaderNode<kind>``. Keys are input names (``_`` for a space), values are
        sockets, numbers or colours; a key in small letters is a property of the node.
        """
        raw = self.raw.nodes.new("ShaderNode" + kind)
        for key, value in inputs.items():  # properties first: they decide which inputs there are
            if key[0].islower():
                setattr(raw, key, value)
        for index, value in enumerate(positional):
            self.put(raw.inputs[index], value)
        for key, value in inputs.items():
            if not key[0].islower():
                name = key.replace("_", " ")
                if name in raw.inputs:  # an input that this version lacks is left out
                    self.put(raw.inputs[name], value)
        return Node(raw)

    def put(self, socket: Any, value: Any) -> None:
        """Link a socket, or set the value of an input."""
        if hasattr(value, "is_output"):
            self.raw.links.new(value, socket)
        elif value is not None:
            if isinstance(value, tuple) and len(value) == 3 and socket.type == "RGBA":
                value = (*value, 1.0)
            socket.default_value = value

    def coordinates(self, which: str = "Object") -> Any:
        """A socket of texture coordinates."""
        if self._coordinates is None:
            self._coordinates = self.add("TexCoord")
        return self._coordinates.out(which)

    def math(self, operation: str, a: Any, b: Any = None, c: Any = None) -> Any:
        """The result of a calculation."""
        inputs = [x for x in (a, b, c) if x is not None]
        return self.add("Math", *inputs, operation=operation).out()

    def ramp(self, factor: Any, stops: list[tuple[float, Colour]], smooth: str = "LINEAR") -> Any:
        """A colour ramp over a factor: ``stops`` are places in [0, 1] with colours."""
        node = self.add("ValToRGB", factor)
        elements = node.raw.color_ramp.elements
        node.raw.color_ramp.interpolation = smooth
        while len(elements) < len(stops):
            elements.new(0.5)
        for element, (place, colour) in zip(elements, sorted(stops), strict=False):
            element.position = min(max(place, 0.0), 1.0)
            element.color = (*colour, 1.0)
        return node.out("Color")

    def mix(self, factor: Any, a: Any, b: Any, blend: str = "MIX") -> Any:
        """Two colours mixed."""
        node = self.add("Mix", data_type="RGBA", blend_type=blend)
        sockets = [s for s in node.raw.inputs if s.enabled]
        for socket, value in zip(sockets, (factor, a, b), strict=True):
            self.put(socket, value)
        return next(s for s in node.raw.outputs if s.enabled)
