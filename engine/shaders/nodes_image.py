# SPDX-License-Identifier: GPL-3.0-or-later
"""Entries of the node table for Image and Environment Texture, and for textures that are replaced by a colour."""

from __future__ import annotations

from typing import Any

from engine.kernels.shader import images as lookup
from engine.kernels.shader import ops_image as ops
from engine.scene.description import Node
from engine.scene.image import is_multiplied
from engine.shaders.options import choice
from engine.shaders.table import COLOR, FLOAT, VECTOR, Implicit, NodeTable, Operation, Socket

_PROJECTIONS = {
    "FLAT": ops.PROJECTION_FLAT,
    "BOX": ops.PROJECTION_BOX,
    "SPHERE": ops.PROJECTION_SPHERE,
    "TUBE": ops.PROJECTION_TUBE,
}
_ENVIRONMENT_PROJECTIONS = {
    "EQUIRECTANGULAR": ops.PROJECTION_EQUIRECTANGULAR,
    "MIRROR_BALL": ops.PROJECTION_MIRROR_BALL,
}
_INTERPOLATIONS = {
    "Linear": lookup.INTERPOLATION_LINEAR,
    "Closest": lookup.INTERPOLATION_CLOSEST,
    "Cubic": lookup.INTERPOLATION_CUBIC,
    "Smart": lookup.INTERPOLATION_CUBIC,
}
_EXTENSIONS = {
    "REPEAT": lookup.EXTENSION_REPEAT,
    "EXTEND": lookup.EXTENSION_EXTEND,
    "CLIP": lookup.EXTENSION_CLIP,
    "MIRROR": lookup.EXTENSION_MIRROR,
}
_OUTPUTS = (Socket("Color", COLOR), Socket("Alpha", FLOAT))


def _lookup(node: Node, builder: Any, projection: int, vector: Implicit, extension: int) -> Operation:
    image = builder.image(int(node.properties.get("image", -1)))
    row = -1
    unassociate = 0
    if image is not None:
        row, description = image
        # Cycles divides alpha out of the colour only where the node's alpha is used.
        unassociate = int(is_multiplied(description) and builder.is_linked("Alpha"))
    # The box projection asks for the object space normal, at the undisplaced point.
    normal = Implicit.OBJECT_NORMAL if projection == ops.PROJECTION_BOX else (0.0, 0.0, 1.0)
    inputs = (
        Socket("Vector", VECTOR, vector),
        Socket("", VECTOR, normal),
        Socket("", FLOAT, float(node.properties.get("projection_blend", 0.0))),
    )
    interpolation = choice(node, builder, "interpolation", _INTERPOLATIONS, "Linear")
    immediates = (row, projection, interpolation, extension, unassociate)
    opcode = ops.OP_IMAGE if projection < ops.PROJECTION_EQUIRECTANGULAR else ops.OP_ENVIRONMENT
    return Operation(opcode, inputs, _OUTPUTS, immediates, is_varying=True)


def _image(node: Node, builder: Any) -> Operation:
    projection = choice(node, builder, "projection", _PROJECTIONS, "FLAT")
    extension = choice(node, builder, "extension", _EXTENSIONS, "REPEAT")
    return _lookup(node, builder, projection, Implicit.UV, extension)


def _environment(node: Node, builder: Any) -> Operation:
    projection = choice(node, builder, "projection", _ENVIRONMENT_PROJECTIONS, "EQUIRECTANGULAR")
    return _lookup(node, builder, projection, Implicit.POSITION, lookup.EXTENSION_REPEAT)


NODES: NodeTable = {
    "ShaderNodeTexImage": _image,
    "ShaderNodeTexEnvironment": _environment,
}
