# SPDX-License-Identifier: GPL-3.0-or-later
"""Random trees of all nodes that the engine knows: kinds, settings, values and links between all types of sockets."""

from __future__ import annotations

import warnings
from functools import cache
from random import Random
from typing import Any

from tests.fuzz.images import random_image
from tests.fuzz.numbers import chance, color, number, vector
from tests.helpers.node_kinds import kinds, known, settings_of

#: Closures that make a background or a lamp's light.
LIGHT = ("ShaderNodeEmission", "ShaderNodeBackground", "ShaderNodeMixShader", "ShaderNodeAddShader")
VOLUMES = (
    "ShaderNodeVolumeAbsorption", "ShaderNodeVolumeScatter", "ShaderNodeVolumePrincipled", "ShaderNodeVolumeCoefficients",
)  # fmt: skip
#: Parts that are shown as something else, with a notice: a scene that has them is not compared with Cycles.
REPORTED_SOCKETS = ("Thin Film Thickness", "Subsurface Weight")
REPORTED_SETTINGS = ("BECKMANN", "ASHIKHMIN_SHIRLEY", "PHYSICAL_CONDUCTOR")
REPORTED_KINDS = ("ShaderNodeHairInfo", "ShaderNodeParticleInfo", "ShaderNodePointInfo", "ShaderNodeVolumeInfo")
REPORTED_OUTPUTS = ("Pointiness", "Random Per Island")
#: Names that an Attribute, a UV map or a colour may be asked by; some are there (`objects.py`).
NAMES = ("", "UVMap", "Tint", "Mask", "Nowhere")
#: Most nodes of a tree.
LARGEST = 14


@cache
def _sockets() -> dict[str, tuple[tuple[str, str], ...]]:
    """Outputs (name, type) of all known nodes but those that would be reported, by kind."""
    import bpy

    tree = bpy.data.node_groups.new("Kinds", "ShaderNodeTree")
    found = {}
    for kind in kinds(tree):
        if (known(kind) or kind in VOLUMES) and kind not in REPORTED_KINDS:
            node = tree.nodes.new(kind)
            found[kind] = tuple((socket.identifier, socket.type) for socket in node.outputs)
    bpy.data.node_groups.remove(tree)
    return found


def _kinds_of(is_shader: bool) -> list[str]:
    return sorted(kind for kind, outputs in _sockets().items() if any((t == "SHADER") == is_shader for _, t in outputs))


class TreeMaker:
    """Fills node trees by the numbers of one generator.

    Parameters
    ----------
    has_reported : bool
        Whether what gives notices may be there too.
    """

    def __init__(self, random: Random, *, has_reported: bool) -> None:
        self.random = random
        self.has_reported = has_reported

    def fill(self, tree: Any, output_kind: str, closures: tuple[str, ...] | None = None) -> None:
        """Put random nodes before a new output of the kind.

        Parameters
        ----------
        closures : tuple of str, optional
            Kinds that shaders are of; None: all surfaces.
        """
        tree.nodes.clear()
        self._tree, self._left = tree, self.random.randrange(2, LARGEST)
        self._closures = closures or tuple(kind for kind in _kinds_of(True) if kind not in VOLUMES)
        self._made: list[Any] = []
        output = tree.nodes.new(output_kind)
        source = self._value(0) if chance(self.random, 0.06) else self._shader(0)
        self._link(source, output.inputs["Surface"])
        if output_kind == "ShaderNodeOutputMaterial" and chance(self.random, 0.05):
            self._link(self._value(1), output.inputs["Displacement"])

    def add_volume(self, tree: Any, *, alone: bool) -> None:
        """A medium of moderate density inside of what the tree has, or nothing but that."""
        output = next(node for node in tree.nodes if node.bl_idname.startswith("ShaderNodeOutput"))
        if alone:
            for link in list(output.inputs["Surface"].links):
                tree.links.remove(link)
        self._tree, self._left, self._closures, self._made = tree, 4, VOLUMES, []
        self._link(self._shader(1), output.inputs["Volume"])

    def _link(self, source: Any, target: Any) -> None:
        if chance(self.random, 0.05):
            reroute = self._tree.nodes.new("NodeReroute")
            self._tree.links.new(source, reroute.inputs[0])
            source = reroute.outputs[0]
        self._tree.links.new(source, target)

    def _shader(self, depth: int) -> Any:
        kind = self.random.choice(self._closures)
        if self._left <= 0 or depth > 4:
            leaves = [kind for kind in self._closures if kind not in ("ShaderNodeMixShader", "ShaderNodeAddShader")]
            kind = self.random.choice(leaves)
        return self._output(self._node(kind, depth), is_shader=True)

    def _value(self, depth: int) -> Any:
        """An output that carries a number, a colour or a vector: of a new node, at times of one that is there."""
        if self._made and chance(self.random, 0.2):
            node = self.random.choice(self._made)
        else:
            node = self._node(self.random.choice(_kinds_of(False)), depth)
        return self._output(node, is_shader=False)

    def _output(self, node: Any, *, is_shader: bool) -> Any:
        sockets = [
            socket for socket in node.outputs
            if (socket.type == "SHADER") == is_shader and socket.enabled and not socket.is_unavailable
            and (self.has_reported or socket.identifier not in REPORTED_OUTPUTS)
        ]  # fmt: skip
        return self.random.choice(sockets)

    def _node(self, kind: str, depth: int) -> Any:
        self._left -= 1
        node = self._tree.nodes.new(kind)
        self._choose_settings(node)
        if hasattr(node, "image"):
            node.image = random_image(self.random)
        if hasattr(node, "color_ramp"):
            self._choose_ramp(node.color_ramp)
        if hasattr(node, "mapping"):
            self._choose_curves(node.mapping)
        for socket in [*node.inputs]:
            if socket.enabled and not socket.is_unavailable:
                self._choose_input(node, socket, depth + 1)
        if kind in ("ShaderNodeValue", "ShaderNodeRGB", "ShaderNodeNormal"):
            self._choose_constant(node.outputs[0])
        if node.outputs[0].type != "SHADER":
            self._made.append(node)
        node.mute = chance(self.random, 0.02)
        return node

    def _choose_settings(self, node: Any) -> None:
        random = self.random
        for name, prop in settings_of(node).items():
            if chance(random, 0.4):
                continue
            if prop.type == "ENUM" and not prop.is_enum_flag:
                values = [item.identifier for item in prop.enum_items]
                values = [value for value in values if self.has_reported or value not in REPORTED_SETTINGS]
                try:
                    setattr(node, name, random.choice(values))
                except TypeError:  # Not offered to shaders.
                    continue
            elif prop.type == "BOOLEAN":
                setattr(node, name, chance(random, 0.5))
            elif prop.type == "STRING":
                setattr(node, name, random.choice(NAMES))
            elif prop.type == "INT":
                setattr(node, name, random.randint(max(prop.hard_min, 0), min(prop.hard_max, 6)))
            elif prop.type == "FLOAT" and not prop.is_array:
                setattr(node, name, number(random, max(prop.soft_min, -2.0), min(prop.soft_max, 2.0)))

    def _choose_input(self, node: Any, socket: Any, depth: int) -> None:
        random = self.random
        if socket.type == "SHADER":
            if chance(random, 0.95):
                self._link(self._value(depth) if chance(random, 0.05) else self._shader(depth), socket)
            return
        if socket.identifier in REPORTED_SOCKETS and not self.has_reported:
            return
        if self._left > 0 and depth < 6 and chance(random, 0.3 if socket.type != "STRING" else 0.0):
            source = self._value(depth)
            self._link(self._limited(source) if node.bl_idname in VOLUMES else source, socket)
            return
        # What a surface supplies by itself, as its normal, cannot be typed in.
        if not socket.hide_value and chance(random, 0.7):
            self._choose_constant(socket)

    def _limited(self, source: Any) -> Any:
        """Media of any density would take any time."""
        clamp = self._tree.nodes.new("ShaderNodeClamp")
        clamp.inputs["Max"].default_value = 2.0
        self._tree.links.new(source, clamp.inputs["Value"])
        return clamp.outputs[0]

    def _choose_constant(self, socket: Any) -> None:
        random = self.random
        if socket.type == "RGBA":
            socket.default_value = color(random)
        elif socket.type == "VECTOR":
            size = len(socket.default_value)
            socket.default_value = (*vector(random, 2.0), 0.0)[:size] if size < 4 else (*vector(random, 2.0), 0.0)
        elif socket.type in ("VALUE", "INT"):
            prop = socket.bl_rna.properties["default_value"]
            is_medium = socket.node.bl_idname in VOLUMES
            value = number(random, 0.0, 2.0, 0.0 if is_medium else 0.15)
            if socket.identifier == "IOR" and not chance(random, 0.2):
                value = random.uniform(1.0, 2.5)
            if socket.identifier in ("Temperature", "Wavelength"):
                value = random.uniform(300.0, 9000.0)
            socket.default_value = int(value) if prop.type == "INT" else value

    def _choose_ramp(self, ramp: Any) -> None:
        random = self.random
        ramp.interpolation = random.choice(("EASE", "CARDINAL", "LINEAR", "B_SPLINE", "CONSTANT"))
        for _ in range(random.randrange(3)):
            ramp.elements.new(random.random())
        for element in ramp.elements:
            element.color = color(random)

    def _choose_curves(self, mapping: Any) -> None:
        random = self.random
        for curve in mapping.curves:
            for _ in range(random.randrange(3)):
                curve.points.new(random.random(), random.uniform(-0.2, 1.2))
        if chance(random, 0.3):
            mapping.extend = "HORIZONTAL"
        mapping.update()


def node_tree(owner: Any) -> Any:
    """The node tree of a material, a world or a lamp, which older Blenders make on demand."""
    if owner.node_tree is None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            owner.use_nodes = True
    return owner.node_tree
