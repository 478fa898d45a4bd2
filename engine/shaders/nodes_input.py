# SPDX-License-Identifier: GPL-3.0-or-later
"""Entries of the node table that read the surface, the object, the ray or the camera.

A node here may have several outputs with an instruction each: its entry is an `Outputs`, output identifier to a
function that lowers that output alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from engine.kernels.shader import light_path as lp
from engine.kernels.shader import ops_input as ops
from engine.kernels.shader.ops_rounds import (
    ROUND_CENTRE,
    ROUND_EDGE_U,
    ROUND_EDGE_V,
    ROUND_IS_STRAND,
    ROUND_RADIUS,
    ROUND_TANGENT_NORMAL,
    ROUND_THICKNESS,
)
from engine.scene.attribute_names import (
    DISPLACED_TANGENT,
    GEOMETRY_ATTRIBUTES,
    PARTICLE,
    PARTICLE_OUTPUTS,
    TANGENT,
    UNDISPLACED_NORMALS,
)
from engine.scene.description import Node
from engine.shaders import nodes_lamp as of_lamp
from engine.shaders.options import choice, flag, is_choice
from engine.shaders.table import COLOR, FLOAT, VECTOR, Implicit, NodeTable, Operation, Socket, SocketType
from engine.state.lanes import (
    RAY_CAMERA,
    RAY_DIFFUSE,
    RAY_GLOSSY,
    RAY_REFLECT,
    RAY_SHADOW,
    RAY_SINGULAR,
    RAY_TRANSMIT,
    RAY_VOLUME,
)


class Outputs(dict[str, Callable[[Node, Any], Operation]]):
    """Node kinds whose outputs are separate instructions."""


_NORMAL_INPUT = Socket("Normal", VECTOR, Implicit.NORMAL)

DEFAULT_UV_SLOT = -1
DEFAULT_COLOR_SLOT = -2


def constant(value: float | tuple[float, ...], type_: SocketType = FLOAT) -> Operation:
    """Operation without an instruction: the compiler returns its only input's default."""
    return Operation(-1, (Socket("", type_, value),), (Socket("", type_),))


def read(opcode: int, type_: SocketType, *immediates: int) -> Callable[[Node, Any], Operation]:
    """Output `type_` of an instruction without inputs."""
    operation = Operation(opcode, (), (Socket("", type_),), immediates, is_varying=True)
    return lambda node, builder: operation


def displaced(opcode: int) -> Callable[[Node, Any], Operation]:
    """Output of an instruction `vector <- width | axis`."""

    def lower(node: Node, builder: Any) -> Operation:
        width = Socket("", FLOAT, builder.filter_width)
        return Operation(opcode, (width,), (Socket("", VECTOR),), (builder.axis,), is_varying=True)

    return lower


def attribute(builder: Any, slot: int, outputs: tuple[Socket, ...], *, is_color: bool = False) -> Operation:
    """OP_ATTRIBUTE with its outputs vector, fac and alpha named."""
    width = Socket("", FLOAT, builder.filter_width)
    return Operation(
        ops.OP_ATTRIBUTE, (width,), outputs, (builder.axis, slot, int(is_color)), is_varying=True
    )


_UNNAMED = (Socket("", VECTOR), Socket("\0fac", FLOAT), Socket("\0alpha", FLOAT))


def uv(name: str) -> Callable[[Node, Any], Operation]:
    """UV map `name`, '' = the render-active one."""

    def lower(node: Node, builder: Any) -> Operation:
        slot = builder.attribute_slot(name) if name else DEFAULT_UV_SLOT
        return attribute(builder, slot, _UNNAMED)

    return lower


_generated = of_lamp.or_of_lamp(displaced(ops.OP_GENERATED), of_lamp.local_place)


def _object_coordinate(node: Node, builder: Any) -> Operation:
    matrix = node.properties.get("object_matrix")
    if matrix is None:
        return of_lamp.or_of_lamp(displaced(ops.OP_OBJECT_COORDINATE), of_lamp.local_place)(node, builder)
    position = Socket("", VECTOR, Implicit.POSITION)
    table = builder.add_table(np.asarray(matrix, np.float32)[:3])
    return Operation(ops.OP_TRANSFORM_POINT, (position,), (Socket("", VECTOR),), (table, 0))


def _uv_map(node: Node, builder: Any) -> Operation:
    if node.properties.get("from_instancer"):
        return read(ops.OP_INSTANCER, VECTOR, 1)(node, builder)
    return uv(str(node.properties.get("uv_map", "")))(node, builder)


def _from_instancer(kind: int, otherwise: Callable[[Node, Any], Operation]) -> Callable[[Node, Any], Operation]:
    def lower(node: Node, builder: Any) -> Operation:
        if node.properties.get("from_instancer"):
            return read(ops.OP_INSTANCER, VECTOR, kind)(node, builder)
        return otherwise(node, builder)

    return lower


def _value(value: float) -> Callable[[Node, Any], Operation]:
    return lambda node, builder: constant(value)


def _factor_of(name: str) -> Callable[[Node, Any], Operation]:
    """A number that is an attribute of curves or points."""
    outputs = (Socket("\0vector", VECTOR), Socket("", FLOAT), Socket("\0alpha", FLOAT))
    return lambda node, builder: attribute(builder, builder.attribute_slot(name), outputs)


def _of_surface(name: str) -> Callable[[Node, Any], Operation]:
    """A number that is an attribute of meshes; 0 within volumes."""
    read_attribute = _factor_of(name)
    return lambda node, builder: constant(0.0) if builder.is_inside else read_attribute(node, builder)


def _vector_of(name: str) -> Callable[[Node, Any], Operation]:
    """A vector that is an attribute."""
    return lambda node, builder: attribute(builder, builder.attribute_slot(name), _UNNAMED)


_ATTRIBUTE_OWNERS = ("GEOMETRY", "OBJECT", "INSTANCER", "VIEW_LAYER", "LIGHT")


def _attribute(node: Node, builder: Any) -> Operation:
    name = str(node.properties.get("attribute_name", ""))
    outputs = (Socket("Color", COLOR), Socket("Fac", FLOAT), Socket("Alpha", FLOAT))
    kind = _ATTRIBUTE_OWNERS[choice(node, builder, "attribute_type", _ATTRIBUTE_OWNERS, "GEOMETRY")]
    if kind == "LIGHT":
        builder.notice(f"the attribute {name!r} of lights is not supported", "0")
    if kind in ("VIEW_LAYER", "LIGHT"):
        value = tuple(float(x) for x in node.properties.get("value", (0.0, 0.0, 0.0, 0.0)))
        color = Socket("", COLOR, value[:3])
        fac = Socket("", FLOAT, sum(value[:3]) / 3.0)
        inputs = (color, fac, Socket("", FLOAT, value[3]))
        return Operation(-1, inputs, outputs)
    if kind in ("OBJECT", "INSTANCER"):
        name = f"{kind.lower()}:{name}"
    if builder.is_inside:
        return grid(builder, name, outputs)
    return attribute(builder, builder.attribute_slot(name) if name else -3, outputs)


def grid(builder: Any, name: str, outputs: tuple[Socket, ...], default: float = 0.0) -> Operation:
    """What a volume's grid holds at a point inside, else `default`: outputs are a colour, its mean, alpha."""
    immediates = (builder.attribute_slot(name), int(builder.has_smooth_voxels))
    return Operation(ops.OP_GRID, (Socket("", FLOAT, default),), outputs, immediates, is_varying=True)


def _volume_info(name: str, type_: SocketType) -> Callable[[Node, Any], Operation]:
    """An output of the Volume Info node; there is nothing on surfaces."""

    def lower(node: Node, builder: Any) -> Operation:
        if not builder.is_inside:
            return constant(0.0 if type_ is FLOAT else (0.0, 0.0, 0.0), type_)
        return grid(builder, name, (Socket("", type_), Socket("\0fac", FLOAT), Socket("\0alpha", FLOAT)))

    return lower


def _color_attribute(node: Node, builder: Any) -> Operation:
    name = str(node.properties.get("layer_name", ""))
    slot = builder.attribute_slot(name) if name else DEFAULT_COLOR_SLOT
    outputs = (Socket("Color", COLOR), Socket("\0fac", FLOAT), Socket("Alpha", FLOAT))
    return attribute(builder, slot, outputs, is_color=True)


_MAPPINGS = ("POINT", "TEXTURE", "VECTOR", "NORMAL")


def _mapping(node: Node, builder: Any) -> Operation:
    code = choice(node, builder, "vector_type", _MAPPINGS, "POINT")
    inputs = (
        Socket("Vector", VECTOR, (0.0, 0.0, 0.0)),
        Socket("Location", VECTOR, (0.0, 0.0, 0.0)),
        Socket("Rotation", VECTOR, (0.0, 0.0, 0.0)),
        Socket("Scale", VECTOR, (1.0, 1.0, 1.0)),
    )
    outputs = (Socket("Vector", VECTOR),)
    known = [builder.constant_input(socket) for socket in inputs[1:]]
    if any(value is None for value in known):
        return Operation(ops.OP_MAPPING, inputs, outputs, (code,))
    kind = _MAPPINGS[code]
    table = builder.add_table(mapping_matrix(kind, *known))
    return Operation(ops.OP_TRANSFORM_POINT, inputs[:1], outputs, (table, int(kind == "NORMAL")))


def mapping_matrix(
    kind: str, location: tuple[float, ...], rotation: tuple[float, ...], scale: tuple[float, ...]
) -> np.ndarray:
    """The Mapping node with constant settings as a 3x4 matrix (NORMAL is normalised after it)."""
    (cx, cy, cz), (sx, sy, sz) = (tuple(f(a) for a in rotation) for f in (math.cos, math.sin))
    turn = np.array(
        [
            [cy * cz, sy * sx * cz - cx * sz, sy * cx * cz + sx * sz],
            [cy * sz, sy * sx * sz + cx * cz, sy * cx * sz - sx * cz],
            [-sy, cy * sx, cy * cx],
        ]
    )
    inverse_scale = np.array([1.0 / s if s != 0.0 else 0.0 for s in scale])
    matrix = np.zeros((3, 4))
    if kind == "TEXTURE":
        matrix[:, :3] = inverse_scale[:, None] * turn.T
        matrix[:, 3] = -matrix[:, :3] @ np.array(location)
    elif kind == "NORMAL":
        matrix[:, :3] = turn * inverse_scale
    else:
        matrix[:, :3] = turn * np.array(scale)
        if kind == "POINT":
            matrix[:, 3] = location
    return matrix.astype(np.float32)


_SPACES = ("TANGENT", "OBJECT", "WORLD", "BLENDER_OBJECT", "BLENDER_WORLD")


def _normal_map(node: Node, builder: Any) -> Operation:
    space = choice(node, builder, "space", _SPACES, "TANGENT")
    is_green_down = is_choice(node, builder, "convention", "DIRECTX", "OPENGL", "OPENGL")
    name = str(node.properties.get("uv_map", ""))
    tangent_slot = -3
    uv_slot = -1
    is_bent = is_choice(node, builder, "base", "DISPLACED", "ORIGINAL", "ORIGINAL") and builder.is_displaced
    if space == 0:
        tangent_slot = builder.attribute_slot(name + (DISPLACED_TANGENT if is_bent else TANGENT))
        uv_slot = builder.attribute_slot(name) if name else -1
    inputs = (Socket("Color", COLOR, (0.5, 0.5, 1.0)), Socket("Strength", FLOAT, 1.0))
    bits = ops.NORMAL_MAP_GREEN_DOWN if is_green_down else 0
    if flag(node, "has_unit_frame", True):
        bits |= ops.NORMAL_MAP_UNIT_FRAME
    normal_slot = -1
    if space == 0 and builder.is_displaced and not is_bent:
        normal_slot = builder.attribute_slot(UNDISPLACED_NORMALS)
    immediates = (space, tangent_slot, uv_slot, bits, normal_slot)
    return Operation(ops.OP_NORMAL_MAP, inputs, (Socket("Normal", VECTOR),), immediates, is_varying=True)


_AXES = ("X", "Y", "Z")


def _tangent(node: Node, builder: Any) -> Operation:
    outputs = (Socket("Tangent", VECTOR),)
    if is_choice(node, builder, "direction_type", "RADIAL", "UV_MAP", "RADIAL"):
        axis = choice(node, builder, "axis", _AXES, "Z")
        return Operation(ops.OP_TANGENT, (), outputs, (axis, -3, -3), is_varying=True)
    name = str(node.properties.get("uv_map", ""))
    tangent_slot = builder.attribute_slot(name + (DISPLACED_TANGENT if builder.is_displaced else TANGENT))
    slots = (tangent_slot, builder.attribute_slot(name) if name else -1)
    return Operation(ops.OP_TANGENT, (), outputs, (3, *slots), is_varying=True)


_TRANSFORMS = ("VECTOR", "POINT", "NORMAL")
_FRAMES = ("WORLD", "OBJECT", "CAMERA")


def _local_incoming(node: Node, builder: Any) -> Operation:
    immediates = tuple(choices.index(name) for choices, name in (
        (_TRANSFORMS, "NORMAL"), (_FRAMES, "WORLD"), (_FRAMES, "OBJECT")
    ))  # fmt: skip
    inputs = (Socket("", VECTOR, Implicit.INCOMING),)
    return Operation(ops.OP_VECTOR_TRANSFORM, inputs, (Socket("", VECTOR),), immediates, is_varying=True)


def _vector_transform(node: Node, builder: Any) -> Operation:
    immediates = (
        choice(node, builder, "vector_type", _TRANSFORMS, "VECTOR"),
        choice(node, builder, "convert_from", _FRAMES, "WORLD"),
        choice(node, builder, "convert_to", _FRAMES, "OBJECT"),
    )
    inputs = (Socket("Vector", VECTOR, (0.5, 0.5, 0.5)),)
    frames = {_FRAMES[code] for code in immediates[1:]}
    if builder.lamp is not None and frames == {"WORLD", "OBJECT"}:
        return of_lamp.transform_by_lamp(
            builder, inputs[0], _TRANSFORMS[immediates[0]], to_lamp=_FRAMES[immediates[2]] == "OBJECT"
        )
    if builder.lamp is not None and frames == {"CAMERA", "OBJECT"}:
        builder.notice("between a lamp's own space and the camera's is not supported", "the world's space instead")
    return Operation(ops.OP_VECTOR_TRANSFORM, inputs, (Socket("Vector", VECTOR),), immediates, is_varying=True)


def _normal(node: Node, builder: Any) -> Operation:
    direction = tuple(float(x) for x in node.properties.get("value", (0.0, 0.0, 1.0)))
    inputs = (Socket("Normal", VECTOR, (0.0, 0.0, 1.0)), Socket("", VECTOR, direction))
    return Operation(ops.OP_NORMAL_NODE, inputs, (Socket("Normal", VECTOR), Socket("Dot", FLOAT)))


def _light_path(kind: int) -> Callable[[Node, Any], Operation]:
    return read(ops.OP_LIGHT_PATH, FLOAT, kind)


def _object_float(kind: int) -> Callable[[Node, Any], Operation]:
    return read(ops.OP_OBJECT_FLOAT, FLOAT, kind)


def _socket_value(type_: SocketType, identifier: str) -> Callable[[Node, Any], Operation]:
    def lower(node: Node, builder: Any) -> Operation:
        value = node.properties.get("value", 0.0)
        if type_ is not FLOAT:
            value = tuple(float(x) for x in (value if isinstance(value, (tuple, list)) else (value,) * 3))[:3]
        return Operation(-1, (Socket("", type_, value),), (Socket(identifier, type_),))

    return lower


def _scene_time(node: Node, builder: Any) -> Operation:
    """The frame and its time in seconds, which the host knows."""
    names = {"Seconds": "seconds", "Frame": "frame"}
    inputs = tuple(Socket("", FLOAT, float(node.properties.get(name, 0.0))) for name in names.values())
    return Operation(-1, inputs, tuple(Socket(name, FLOAT) for name in names))


NODES: NodeTable = {
    "ShaderNodeValue": _socket_value(FLOAT, "Value"),
    "ShaderNodeRGB": _socket_value(COLOR, "Color"),
    "FunctionNodeInputBool": _socket_value(FLOAT, "Boolean"),
    "FunctionNodeInputInt": _socket_value(FLOAT, "Integer"),
    "FunctionNodeInputVector": _socket_value(VECTOR, "Vector"),
    "GeometryNodeInputSceneTime": _scene_time,
    "ShaderNodeUVMap": lambda node, builder: _rename(_uv_map(node, builder), "UV"),
    "ShaderNodeAttribute": _attribute,
    "ShaderNodeVertexColor": _color_attribute,
    "ShaderNodeMapping": _mapping,
    "ShaderNodeNormalMap": _normal_map,
    "ShaderNodeNormal": _normal,
    "ShaderNodeTangent": _tangent,
    "ShaderNodeVectorTransform": _vector_transform,
    "ShaderNodeFresnel": Operation(
        ops.OP_FRESNEL, (Socket("IOR", FLOAT, 1.5), _NORMAL_INPUT), (Socket("Fac", FLOAT),), is_varying=True
    ),
    "ShaderNodeLayerWeight": Operation(
        ops.OP_LAYER_WEIGHT,
        (Socket("Blend", FLOAT, 0.5), _NORMAL_INPUT),
        (Socket("Fresnel", FLOAT), Socket("Facing", FLOAT)),
        is_varying=True,
    ),
    "ShaderNodeCameraData": Operation(
        ops.OP_CAMERA_DATA,
        (),
        (Socket("View Vector", VECTOR), Socket("View Z Depth", FLOAT), Socket("View Distance", FLOAT)),
        is_varying=True,
    ),
    "ShaderNodeLightFalloff": Operation(
        ops.OP_LIGHT_FALLOFF,
        (Socket("Strength", FLOAT, 100.0), Socket("Smooth", FLOAT, 0.0)),
        (Socket("Quadratic", FLOAT), Socket("Linear", FLOAT), Socket("Constant", FLOAT)),
        is_varying=True,
    ),
}


def _rename(operation: Operation, identifier: str) -> Operation:
    first, *rest = operation.outputs
    outputs = (Socket(identifier, first.type), *rest)
    return Operation(operation.opcode, operation.inputs, outputs, operation.immediates, operation.is_varying)


OUTPUTS: dict[str, Outputs] = {
    "ShaderNodeTexCoord": Outputs(
        {
            "Generated": _from_instancer(0, _generated),
            "Normal": of_lamp.or_of_lamp(displaced(ops.OP_OBJECT_NORMAL), of_lamp.local_normal),
            "UV": _from_instancer(1, uv("")),
            "Object": _object_coordinate,
            "Camera": displaced(ops.OP_CAMERA_COORDINATE),
            "Window": displaced(ops.OP_WINDOW),
            "Reflection": read(ops.OP_REFLECTION, VECTOR),
        }
    ),
    "ShaderNodeNewGeometry": Outputs(
        {
            "Position": displaced(ops.OP_POSITION),
            "Normal": read(ops.OP_NORMAL, VECTOR),
            "Tangent": read(ops.OP_TANGENT, VECTOR, 2, ops.TANGENT_OF_CURVES, -3),
            "True Normal": read(ops.OP_TRUE_NORMAL, VECTOR),
            "Incoming": read(ops.OP_INCOMING, VECTOR),
            "Parametric": displaced(ops.OP_PARAMETRIC),
            "Backfacing": read(ops.OP_BACKFACING, FLOAT),
            "Pointiness": _of_surface(GEOMETRY_ATTRIBUTES["Pointiness"]),
            "Random Per Island": _of_surface(GEOMETRY_ATTRIBUTES["Random Per Island"]),
        }
    ),
    "ShaderNodeObjectInfo": Outputs(
        {
            "Location": of_lamp.or_of_lamp(read(ops.OP_OBJECT_VECTOR, VECTOR, 0), of_lamp.location),
            "Color": of_lamp.or_of_lamp(read(ops.OP_OBJECT_VECTOR, COLOR, 1), of_lamp.color),
            "Alpha": of_lamp.or_of_lamp(_object_float(lp.OBJECT_ALPHA), of_lamp.alpha),
            "Object Index": of_lamp.or_of_lamp(_object_float(lp.OBJECT_INDEX), of_lamp.pass_index),
            "Material Index": _object_float(lp.OBJECT_MATERIAL_INDEX),
            "Random": of_lamp.or_of_lamp(_object_float(lp.OBJECT_RANDOM), of_lamp.random),
        }
    ),
    "ShaderNodeLightPath": Outputs(
        {
            "Is Camera Ray": _light_path(RAY_CAMERA),
            "Is Shadow Ray": _light_path(RAY_SHADOW),
            "Is Diffuse Ray": _light_path(RAY_DIFFUSE),
            "Is Glossy Ray": _light_path(RAY_GLOSSY),
            "Is Singular Ray": _light_path(RAY_SINGULAR),
            "Is Reflection Ray": _light_path(RAY_REFLECT),
            "Is Transmission Ray": _light_path(RAY_TRANSMIT),
            "Is Volume Scatter Ray": _light_path(RAY_VOLUME),
            "Ray Length": _light_path(lp.LIGHT_PATH_LENGTH),
            "Ray Depth": _light_path(lp.LIGHT_PATH_DEPTH),
            "Diffuse Depth": _light_path(lp.LIGHT_PATH_DIFFUSE_DEPTH),
            "Glossy Depth": _light_path(lp.LIGHT_PATH_GLOSSY_DEPTH),
            "Transparent Depth": _light_path(lp.LIGHT_PATH_TRANSPARENT_DEPTH),
            "Transmission Depth": _light_path(lp.LIGHT_PATH_TRANSMISSION_DEPTH),
            "Portal Depth": _value(0.0),
        }
    ),
    "ShaderNodeParticleInfo": Outputs(
        {
            output: _factor_of(f"{PARTICLE}{output}") if width == 1 else _vector_of(f"{PARTICLE}{output}")
            for output, width in PARTICLE_OUTPUTS.items()
        }
    ),
    "ShaderNodeVolumeInfo": Outputs(
        {
            "Color": _volume_info("color", COLOR),
            "Density": _volume_info("density", FLOAT),
            "Flame": _volume_info("flame", FLOAT),
            "Temperature": _volume_info("temperature", FLOAT),
        }
    ),
    "ShaderNodeHairInfo": Outputs(
        {
            "Is Strand": read(ops.OP_ROUND, FLOAT, ROUND_IS_STRAND),
            "Intercept": _factor_of("curve_intercept"),
            "Length": _factor_of("curve_length"),
            "Thickness": read(ops.OP_ROUND, FLOAT, ROUND_THICKNESS),
            "Tangent Normal": read(ops.OP_ROUND, VECTOR, ROUND_TANGENT_NORMAL),
            "Random": _factor_of("curve_random"),
        }
    ),
    "ShaderNodePointInfo": Outputs(
        {
            "Position": read(ops.OP_ROUND, VECTOR, ROUND_CENTRE),
            "Radius": read(ops.OP_ROUND, FLOAT, ROUND_RADIUS),
            "Random": _factor_of("point_random"),
        }
    ),
}

#: Where unlinked sockets take their value from.
IMPLICIT: dict[Implicit, Callable[[Node, Any], Operation]] = {
    Implicit.NORMAL: read(ops.OP_NORMAL, VECTOR),
    Implicit.INCOMING: read(ops.OP_INCOMING, VECTOR),
    Implicit.LOCAL_INCOMING: of_lamp.or_of_lamp(_local_incoming, of_lamp.local_incoming),
    Implicit.POSITION: displaced(ops.OP_POSITION),
    Implicit.GENERATED: _generated,
    Implicit.UV: uv(""),
    Implicit.TANGENT: read(ops.OP_TANGENT, VECTOR, 2, ops.TANGENT_OF_CURVES, -3),
    Implicit.CURVE_NORMAL: lambda node, builder: attribute(builder, builder.attribute_slot("curve_normal"), _UNNAMED),
    Implicit.EDGE_U: read(ops.OP_ROUND, VECTOR, ROUND_EDGE_U),
    Implicit.EDGE_V: read(ops.OP_ROUND, VECTOR, ROUND_EDGE_V),
    Implicit.CURVE_THICKNESS: read(ops.OP_ROUND, FLOAT, ROUND_THICKNESS),
    Implicit.CURVE_RANDOM: lambda node, builder: attribute(builder, builder.attribute_slot("curve_random"), _UNNAMED),
    Implicit.OBJECT_NORMAL: lambda node, builder: Operation(
        ops.OP_OBJECT_NORMAL, (Socket("", FLOAT, 0.0),), (Socket("", VECTOR),), (0,), is_varying=True
    ),
}
