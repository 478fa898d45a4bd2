# SPDX-License-Identifier: GPL-3.0-or-later
"""Random trees of the nodes that the engine knows, with settings and values as nobody would choose them."""

from __future__ import annotations

import random
from typing import Any

import bpy

from engine.shaders import nodes_closure
from engine.shaders.media import NODES as VOLUMES
from engine.shaders.node_values import NODES as VALUES

#: Need what these scenes do not have, or are told apart by what Cycles does not know either.
_LEFT_OUT = {
    "ShaderNodeTexImage", "ShaderNodeTexEnvironment", "ShaderNodeUVAlongStroke", "ShaderNodeTexPointDensity",
    "ShaderNodeVolumeInfo", "ShaderNodeOutputLight",
    # Named by notices, so that their pictures are not compared.
    "ShaderNodeWireframe", "ShaderNodeAmbientOcclusion", "ShaderNodeBevel", "ShaderNodeTexIES",
    # Its map is a second's work for each tree; its own scenes are compared.
    "ShaderNodeTexSky",
    # Cycles' light samples of them differ from its own sampling (docs/differences.md).
    "ShaderNodeBsdfHair", "ShaderNodeBsdfHairPrincipled",
    # So do they where portals are mixed with what is transparent (docs/differences.md).
    "ShaderNodeBsdfRayPortal",
}  # fmt: skip
_SURFACES = ("ShaderNodeBsdf", "ShaderNodeEmission", "ShaderNodeHoldout", "ShaderNodeEeveeSpecular")
_EXTREMES = (0.0, 0.0, 1.0, -1.0, 1e-6, 1e-3, 30.0, 1e4, 1e6, -1e3)
#: A tangent of zero length makes a surface black in Cycles, which divides by it. The normal of a coat that is not there
#: changes the sheen there. Of the others a notice would say that they are not supported.
_UNTOUCHED = {"Tangent", "Coat Normal", "Thin Film Thickness", "Subsurface Weight"}
#: Values of menus that are shown as something else (docs/differences.md), and axes about which the tangent of a flat
#: floor has no length, by which Cycles divides.
_OTHERS = {"BECKMANN", "ASHIKHMIN_SHIRLEY"}
_AXES = {"ShaderNodeTangent": ("Z",)}
#: Inputs with the least and the largest value that means the same to both. Of less detail than none Cycles makes no
#: number; of octaves that cancel each other neither does, but normals that follow from it differ. Curves of constants
#: are Blender's own work, which clips them. Layers of a weight of thousands make fireflies.
#: With an index of 1 a Fresnel node's output is what is left of rounding, and so is the direction of a normal that is
#: linked to it; far from 1 most pairs of directions that rough glass is asked about are such as no facet connects
#: (docs/differences.md). Media that take away less than nothing mean nothing.
_LIMITS = {
    "Detail": (0.0, 15.0), "Detail Roughness": (0.0, 1e6), "IOR": (1.05, 3.0),
    "Coat Weight": (0.0, 3.0), "Sheen Weight": (0.0, 3.0),
    "Absorption Coefficients": (0.0, 1e3), "Scatter Coefficients": (0.0, 1e3),
    ("ShaderNodeFloatCurve", "Value"): (0.0, 1.0), ("ShaderNodeRadialTiling", "Sides"): (2.1, 1e6),
}  # fmt: skip
#: Before Blender 5.3 Cycles attenuates the emission below coat and sheen for rays that the camera sends, and not for
#: light samples and paths that end there.
_ATTENUATED = bpy.app.version < (5, 3, 0)
#: How deep a value's tree is at most.
_DEPTH = 2


def known_kinds() -> dict[str, list[str]]:
    """Kinds of nodes by what they are for: values, surfaces, volumes. Those of this Blender that the engine knows."""
    closures = (kind for kind, closure in nodes_closure.CLOSURES.items() if closure.inputs is not None)
    kinds = {
        "values": [kind for kind in VALUES if kind not in _LEFT_OUT],
        "surfaces": [kind for kind in closures if kind.startswith(_SURFACES) and kind not in _LEFT_OUT],
        "volumes": list(VOLUMES),
    }
    tree = bpy.data.node_groups.new("Every node", "ShaderNodeTree")
    found = {of: [kind for kind in sorted(names) if _fits(tree, kind)] for of, names in kinds.items()}
    bpy.data.node_groups.remove(tree)
    return found


def _fits(tree: Any, kind: str) -> bool:
    try:
        tree.nodes.remove(tree.nodes.new(kind))
    except RuntimeError:  # The kind is another Blender's, or of another kind of tree.
        return False
    return True


class GraphMaker:
    """Fills node trees.

    Parameters
    ----------
    numbers : random.Random
    extreme : float
        How likely a value is one that nobody would choose.
    """

    def __init__(self, numbers: random.Random, extreme: float) -> None:
        self._numbers, self._extreme = numbers, extreme
        self._kinds = known_kinds()

    def surface(self, tree: Any, depth: int = 2) -> Any:
        """The output of a random closure, or of a mix of two."""
        numbers = self._numbers
        if depth and numbers.random() < 0.35:
            node = tree.nodes.new(numbers.choice(("ShaderNodeMixShader", "ShaderNodeAddShader")))
            shaders = [socket for socket in node.inputs if socket.type == "SHADER"]
            for socket in shaders:
                tree.links.new(self.surface(tree, depth - 1), socket)
            self._fill(tree, node, _DEPTH)
            return node.outputs[0]
        return self._closure(tree, numbers.choice(self._kinds["surfaces"]))

    def volume(self, tree: Any) -> Any:
        """The output of a random volume, thin enough to see something."""
        node = tree.nodes[self._closure(tree, self._numbers.choice(self._kinds["volumes"])).node.name]
        if "Density" in node.inputs and not node.inputs["Density"].is_linked:
            node.inputs["Density"].default_value = self._numbers.choice((0.0, 0.05, 0.3, 1.0))
        return node.outputs[0]

    def value(self, tree: Any, depth: int = _DEPTH) -> Any:
        """Some output of a random node that gives values."""
        node = tree.nodes.new(self._numbers.choice(self._kinds["values"]))
        self._settings(node)
        self._fill(tree, node, depth - 1)
        outputs = [socket for socket in node.outputs if socket.enabled and socket.type != "SHADER"]
        if not outputs:
            return self.value(tree, depth)
        return self._numbers.choice(outputs)

    def _closure(self, tree: Any, kind: str) -> Any:
        node = tree.nodes.new(kind)
        self._settings(node)
        self._fill(tree, node, _DEPTH)
        return node.outputs[0]

    def _settings(self, node: Any) -> None:
        for item in node.bl_rna.properties:
            if item.type != "ENUM" or item.is_readonly or item.identifier in ("bl_icon", "warning_propagation"):
                continue
            if item.identifier in bpy.types.Node.bl_rna.properties or self._numbers.random() < 0.5:
                continue
            values = [value.identifier for value in item.enum_items if value.identifier not in _OTHERS]
            if item.identifier == "axis":
                values = list(_AXES.get(node.bl_idname, values))
            if values:
                try:
                    setattr(node, item.identifier, self._numbers.choice(values))
                except TypeError:  # Menus whose values depend on other settings.
                    continue

    def _fill(self, tree: Any, node: Any, depth: int) -> None:
        for socket in node.inputs:
            if socket.name in _UNTOUCHED or socket.is_linked or socket.type == "SHADER":
                continue
            if not socket.enabled or socket.is_unavailable:
                continue
            if socket.name == "Emission Strength" and _ATTENUATED:
                continue
            limits = _LIMITS.get(socket.name) or _LIMITS.get((node.bl_idname, socket.name))
            if depth > 0 and self._numbers.random() < 0.25:
                source = self.value(tree, depth)
                if socket.type == "RGBA" and node.outputs[0].type == "SHADER":
                    source = _clamped(tree, source, "ShaderNodeMix")
                elif limits:
                    kind = "ShaderNodeVectorMath" if socket.type == "VECTOR" else "ShaderNodeClamp"
                    source = _clamped(tree, source, kind, limits)
                tree.links.new(source, socket)
            elif hasattr(socket, "default_value") and self._numbers.random() < 0.6:
                self._set(socket)
                if limits:
                    socket.default_value = _within(socket.default_value, limits)

    def _set(self, socket: Any) -> None:
        if socket.type == "VALUE":
            socket.default_value = self._number()
        elif socket.type == "RGBA":
            # Some closures of Cycles make light below zero out of brighter ones.
            socket.default_value = (*(min(max(self._number(), 0.0), 1.0) for _ in range(3)), 1.0)
        elif socket.type == "VECTOR":
            socket.default_value = [self._number() for _ in range(len(socket.default_value))]
        elif socket.type == "INT":
            socket.default_value = self._numbers.randint(-2, 8)
        elif socket.type == "BOOLEAN":
            socket.default_value = self._numbers.random() < 0.5

    def _number(self) -> float:
        if self._numbers.random() < self._extreme:
            return self._numbers.choice(_EXTREMES)
        return self._numbers.choice((self._numbers.random(), self._numbers.uniform(0.0, 3.0)))


def _within(value: Any, limits: tuple[float, float]) -> Any:
    """A number, or a vector's numbers, within limits."""
    if isinstance(value, float):
        return min(max(value, limits[0]), limits[1])
    return [_within(number, limits) for number in value]


def _clamped(tree: Any, source: Any, kind: str, limits: tuple[float, float] = (0.0, 1.0)) -> Any:
    """What a node makes of a value so that it stays within limits.

    A Mix node does so of colours, a Clamp node of numbers, two Vector Math nodes of vectors.
    """
    if kind == "ShaderNodeVectorMath":
        for operation, limit in zip(("MAXIMUM", "MINIMUM"), limits, strict=True):
            node = tree.nodes.new(kind)
            node.operation, node.inputs[1].default_value = operation, (limit,) * 3
            tree.links.new(source, node.inputs[0])
            source = node.outputs[0]
        return source
    node = tree.nodes.new(kind)
    if kind == "ShaderNodeMix":
        node.data_type, node.clamp_result = "RGBA", True
        colors = [socket for socket in node.inputs if socket.type == "RGBA"]
        node.inputs[0].default_value = 1.0
        tree.links.new(source, colors[1])
        return next(socket for socket in node.outputs if socket.type == "RGBA")
    node.inputs["Min"].default_value, node.inputs["Max"].default_value = limits
    tree.links.new(source, node.inputs["Value"])
    return node.outputs[0]
