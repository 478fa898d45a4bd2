# SPDX-License-Identifier: GPL-3.0-or-later
"""Entries of the node table for procedural textures and for operations on numbers, vectors and colours."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.kernels.shader import ops_math, ops_texture
from engine.kernels.shader.color_math import BLEND_MODES
from engine.kernels.shader.scalar_math import MATH_OPERATIONS
from engine.kernels.shader.vector_math import COMPONENT_OPERATIONS, VECTOR_OPERATIONS
from engine.scene.description import Node
from engine.shaders.options import choice, flag, is_choice
from engine.shaders.table import COLOR, FLOAT, VECTOR, Implicit, NodeTable, Operation, Socket
from engine.spectral.observer import CIE_1931_TO_REC709

_BLACK = (0.0, 0.0, 0.0)
_GREY = (0.5, 0.5, 0.5)
_LIGHT = (0.8, 0.8, 0.8)
_DARK = (0.2, 0.2, 0.2)
_ONE = (1.0, 1.0, 1.0)

_TEXTURE_VECTOR = Socket("Vector", VECTOR, Implicit.GENERATED)
_COLOR_AND_FAC = (Socket("Color", COLOR), Socket("Fac", FLOAT))

_DIMENSIONS = ("1D", "2D", "3D", "4D")
_AXES = ("X", "Y", "Z")
_NOISE_TYPES = ("MULTIFRACTAL", "FBM", "HYBRID_MULTIFRACTAL", "RIDGED_MULTIFRACTAL", "HETERO_TERRAIN")
_GRADIENT_TYPES = ("LINEAR", "QUADRATIC", "EASING", "DIAGONAL", "RADIAL", "QUADRATIC_SPHERE", "SPHERICAL")
_VORONOI_FEATURES = ("F1", "F2", "SMOOTH_F1", "DISTANCE_TO_EDGE", "N_SPHERE_RADIUS")
_VORONOI_METRICS = ("EUCLIDEAN", "MANHATTAN", "CHEBYCHEV", "MINKOWSKI")
_INTERPOLATIONS = ("LINEAR", "STEPPED", "SMOOTHSTEP", "SMOOTHERSTEP")
_COLOR_MODELS = ("RGB", "HSV", "HSL")
_ROTATIONS = ("AXIS_ANGLE", "X_AXIS", "Y_AXIS", "Z_AXIS", "EULER_XYZ")


def _constant(node: Node, name: str, default: float) -> Socket:
    """A property that kernels read like an unlinked socket."""
    return Socket("", FLOAT, float(node.properties.get(name, default)))


# ---------------------------------------------------------------------------------------------------------------------
# Procedural textures


def _noise(node: Node, builder: Any) -> Operation:
    return Operation(
        ops_texture.OP_NOISE,
        (
            _TEXTURE_VECTOR,
            Socket("W", FLOAT, 0.0),
            Socket("Scale", FLOAT, 5.0),
            Socket("Detail", FLOAT, 2.0),
            Socket("Roughness", FLOAT, 0.5),
            Socket("Lacunarity", FLOAT, 2.0),
            Socket("Offset", FLOAT, 0.0),
            Socket("Gain", FLOAT, 1.0),
            Socket("Distortion", FLOAT, 0.0),
        ),
        (Socket("Fac", FLOAT), Socket("Color", COLOR)),
        (
            1 + choice(node, builder, "noise_dimensions", _DIMENSIONS, "3D"),
            choice(node, builder, "noise_type", _NOISE_TYPES, "FBM"),
            flag(node, "normalize", True),
        ),
    )


def _gradient(node: Node, builder: Any) -> Operation:
    kind = choice(node, builder, "gradient_type", _GRADIENT_TYPES, "LINEAR")
    return Operation(ops_texture.OP_GRADIENT, (_TEXTURE_VECTOR,), _COLOR_AND_FAC, (kind,))


def _voronoi(node: Node, builder: Any) -> Operation:
    return Operation(
        ops_texture.OP_VORONOI,
        (
            _TEXTURE_VECTOR,
            Socket("W", FLOAT, 0.0),
            Socket("Scale", FLOAT, 5.0),
            Socket("Detail", FLOAT, 0.0),
            Socket("Roughness", FLOAT, 0.5),
            Socket("Lacunarity", FLOAT, 2.0),
            Socket("Smoothness", FLOAT, 1.0),
            Socket("Exponent", FLOAT, 0.5),
            Socket("Randomness", FLOAT, 1.0),
        ),
        (
            Socket("Distance", FLOAT),
            Socket("Color", COLOR),
            Socket("Position", VECTOR),
            Socket("W", FLOAT),
            Socket("Radius", FLOAT),
        ),
        (
            1 + choice(node, builder, "voronoi_dimensions", _DIMENSIONS, "3D"),
            choice(node, builder, "feature", _VORONOI_FEATURES, "F1"),
            choice(node, builder, "distance", _VORONOI_METRICS, "EUCLIDEAN"),
            flag(node, "normalize", False),
        ),
    )


def _wave(node: Node, builder: Any) -> Operation:
    kind = choice(node, builder, "wave_type", ("BANDS", "RINGS"), "BANDS")
    if kind == 0:
        direction = choice(node, builder, "bands_direction", (*_AXES, "DIAGONAL"), "X")
    else:
        direction = choice(node, builder, "rings_direction", (*_AXES, "SPHERICAL"), "X")
    return Operation(
        ops_texture.OP_WAVE,
        (
            _TEXTURE_VECTOR,
            Socket("Scale", FLOAT, 5.0),
            Socket("Distortion", FLOAT, 0.0),
            Socket("Detail", FLOAT, 2.0),
            Socket("Detail Scale", FLOAT, 1.0),
            Socket("Detail Roughness", FLOAT, 0.5),
            Socket("Phase Offset", FLOAT, 0.0),
        ),
        _COLOR_AND_FAC,
        (kind, direction, choice(node, builder, "wave_profile", ("SIN", "SAW", "TRI"), "SIN")),
    )


def _brick(node: Node, builder: Any) -> Operation:
    return Operation(
        ops_texture.OP_BRICK,
        (
            _TEXTURE_VECTOR,
            Socket("Color1", COLOR, _LIGHT),
            Socket("Color2", COLOR, _DARK),
            Socket("Mortar", COLOR, _BLACK),
            Socket("Scale", FLOAT, 5.0),
            Socket("Mortar Size", FLOAT, 0.02),
            Socket("Mortar Smooth", FLOAT, 0.1),
            Socket("Bias", FLOAT, 0.0),
            Socket("Brick Width", FLOAT, 0.5),
            Socket("Row Height", FLOAT, 0.25),
            _constant(node, "offset", 0.5),
            _constant(node, "squash", 1.0),
        ),
        _COLOR_AND_FAC,
        (int(node.properties.get("offset_frequency", 2)), int(node.properties.get("squash_frequency", 2))),
    )


def _magic(node: Node, builder: Any) -> Operation:
    inputs = (_TEXTURE_VECTOR, Socket("Scale", FLOAT, 5.0), Socket("Distortion", FLOAT, 1.0))
    depth = int(node.properties.get("turbulence_depth", 2))
    return Operation(ops_texture.OP_MAGIC, inputs, _COLOR_AND_FAC, (depth, flag(node, "wraps_scaled", True)))


def _white_noise(node: Node, builder: Any) -> Operation:
    dimensions = 1 + choice(node, builder, "noise_dimensions", _DIMENSIONS, "3D")
    inputs = (Socket("Vector", VECTOR, _BLACK), Socket("W", FLOAT, 0.0))
    return Operation(
        ops_texture.OP_WHITE_NOISE, inputs, (Socket("Value", FLOAT), Socket("Color", COLOR)), (dimensions,)
    )


# ---------------------------------------------------------------------------------------------------------------------
# Numbers and vectors


def _math(node: Node, builder: Any) -> Operation:
    return Operation(
        ops_math.OP_MATH,
        (Socket("Value", FLOAT, 0.5), Socket("Value_001", FLOAT, 0.5), Socket("Value_002", FLOAT, 0.5)),
        (Socket("Value", FLOAT),),
        (choice(node, builder, "operation", MATH_OPERATIONS, "ADD"), flag(node, "use_clamp", False)),
    )


def _vector_math(node: Node, builder: Any) -> Operation:
    vectors = (
        Socket("Vector", VECTOR, _BLACK),
        Socket("Vector_001", VECTOR, _BLACK),
        Socket("Vector_002", VECTOR, _BLACK),
    )
    outputs = (Socket("Vector", VECTOR), Socket("Value", FLOAT))
    name = node.properties.get("operation", "ADD")
    if name in COMPONENT_OPERATIONS:
        operation = MATH_OPERATIONS.index(COMPONENT_OPERATIONS[name])
        return Operation(ops_math.OP_VECTOR_COMPONENTS, vectors, outputs, (operation,))
    operation = choice(node, builder, "operation", VECTOR_OPERATIONS, "SCALE")
    return Operation(ops_math.OP_VECTOR_MATH, (*vectors, Socket("Scale", FLOAT, 1.0)), outputs, (operation,))


def _map_range(node: Node, builder: Any) -> Operation:
    interpolation = choice(node, builder, "interpolation_type", _INTERPOLATIONS, "LINEAR")
    immediates = (interpolation, flag(node, "clamp", True))
    if is_choice(node, builder, "data_type", "FLOAT_VECTOR", "FLOAT", "FLOAT"):
        vectors = (
            Socket("Vector", VECTOR, _BLACK),
            Socket("From_Min_FLOAT3", VECTOR, _BLACK),
            Socket("From_Max_FLOAT3", VECTOR, _ONE),
            Socket("To_Min_FLOAT3", VECTOR, _BLACK),
            Socket("To_Max_FLOAT3", VECTOR, _ONE),
            Socket("Steps_FLOAT3", VECTOR, (4.0, 4.0, 4.0)),
        )
        return Operation(ops_math.OP_MAP_RANGE_VECTOR, vectors, (Socket("Vector", VECTOR),), immediates)
    numbers = (
        Socket("Value", FLOAT, 1.0),
        Socket("From Min", FLOAT, 0.0),
        Socket("From Max", FLOAT, 1.0),
        Socket("To Min", FLOAT, 0.0),
        Socket("To Max", FLOAT, 1.0),
        Socket("Steps", FLOAT, 4.0),
    )
    return Operation(ops_math.OP_MAP_RANGE, numbers, (Socket("Result", FLOAT),), immediates)


def _clamp(node: Node, builder: Any) -> Operation:
    is_range = is_choice(node, builder, "clamp_type", "RANGE", "MINMAX", "MINMAX")
    inputs = (Socket("Value", FLOAT, 1.0), Socket("Min", FLOAT, 0.0), Socket("Max", FLOAT, 1.0))
    return Operation(ops_math.OP_CLAMP, inputs, (Socket("Result", FLOAT),), immediates=(int(is_range),))


def _vector_rotate(node: Node, builder: Any) -> Operation:
    return Operation(
        ops_math.OP_VECTOR_ROTATE,
        (
            Socket("Vector", VECTOR, _BLACK),
            Socket("Center", VECTOR, _BLACK),
            Socket("Axis", VECTOR, (0.0, 0.0, 1.0)),
            Socket("Angle", FLOAT, 0.0),
            Socket("Rotation", VECTOR, _BLACK),
        ),
        (Socket("Vector", VECTOR),),
        (choice(node, builder, "rotation_type", _ROTATIONS, "AXIS_ANGLE"), flag(node, "invert", False)),
    )


def _float_curve(node: Node, builder: Any) -> Operation:
    return Operation(
        ops_math.OP_FLOAT_CURVE,
        (Socket("Factor", FLOAT, 1.0), Socket("Value", FLOAT, 1.0), *_curve_range(node)),
        (Socket("Value", FLOAT),),
        _curve_table(node, builder, 1),
    )


# ---------------------------------------------------------------------------------------------------------------------
# Mixing


def _mix(node: Node, builder: Any) -> Operation:
    data_type = node.properties.get("data_type", "FLOAT")
    clamp_factor = flag(node, "clamp_factor", True)
    if data_type == "RGBA":
        blend_type = choice(node, builder, "blend_type", BLEND_MODES, "MIX")
        return Operation(
            ops_math.OP_MIX_COLOR,
            (Socket("Factor_Float", FLOAT, 0.5), Socket("A_Color", COLOR, _GREY), Socket("B_Color", COLOR, _GREY)),
            (Socket("Result_Color", COLOR),),
            (blend_type, clamp_factor, flag(node, "clamp_result", False)),
        )
    if data_type == "VECTOR":
        is_uniform = is_choice(node, builder, "factor_mode", "UNIFORM", "NON_UNIFORM", "UNIFORM")
        factor = Socket("Factor_Float", FLOAT, 0.5) if is_uniform else Socket("Factor_Vector", VECTOR, _GREY)
        return Operation(
            ops_math.OP_MIX_VECTOR,
            (factor, Socket("A_Vector", VECTOR, _BLACK), Socket("B_Vector", VECTOR, _BLACK)),
            (Socket("Result_Vector", VECTOR),),
            (clamp_factor, int(is_uniform)),
        )
    if data_type != "FLOAT":
        builder.notice(f"data_type {data_type!r} is not supported", "numbers are mixed instead")
    return Operation(
        ops_math.OP_MIX_FLOAT,
        (Socket("Factor_Float", FLOAT, 0.5), Socket("A_Float", FLOAT, 0.0), Socket("B_Float", FLOAT, 0.0)),
        (Socket("Result_Float", FLOAT),),
        (clamp_factor,),
    )


def _mix_rgb(node: Node, builder: Any) -> Operation:
    return Operation(
        ops_math.OP_MIX_COLOR,
        (Socket("Fac", FLOAT, 0.5), Socket("Color1", COLOR, _GREY), Socket("Color2", COLOR, _GREY)),
        (Socket("Color", COLOR),),
        (choice(node, builder, "blend_type", BLEND_MODES, "MIX"), 1, flag(node, "use_clamp", False)),
    )


# ---------------------------------------------------------------------------------------------------------------------
# Colours


def _combine_color(node: Node, builder: Any) -> Operation:
    inputs = (Socket("Red", FLOAT, 0.0), Socket("Green", FLOAT, 0.0), Socket("Blue", FLOAT, 0.0))
    model = choice(node, builder, "mode", _COLOR_MODELS, "RGB")
    return Operation(ops_math.OP_COMBINE_COLOR, inputs, (Socket("Color", COLOR),), (model,))


def _separate_color(node: Node, builder: Any) -> Operation:
    outputs = (Socket("Red", FLOAT), Socket("Green", FLOAT), Socket("Blue", FLOAT))
    model = choice(node, builder, "mode", _COLOR_MODELS, "RGB")
    return Operation(ops_math.OP_SEPARATE_COLOR, (Socket("Color", COLOR, _LIGHT),), outputs, (model,))


def _ramp(node: Node, builder: Any) -> Operation:
    table = node.properties.get("ramp")
    if table is None:
        builder.notice("the colour ramp has no table", "a ramp from black to white is used")
        table = np.ones((2, 4), np.float32)
        table[0, :3] = 0.0
    table = np.asarray(table, np.float32).reshape(-1, 4)
    return Operation(
        ops_math.OP_RAMP,
        (Socket("Fac", FLOAT, 0.5),),
        (Socket("Color", COLOR), Socket("Alpha", FLOAT)),
        (builder.add_table(table), len(table), flag(node, "interpolate", True)),
    )


def _curve_range(node: Node) -> tuple[Socket, Socket]:
    return _constant(node, "min_x", 0.0), _constant(node, "max_x", 1.0)


def _curve_table(node: Node, builder: Any, width: int) -> tuple[int, int, int]:
    """Immediates of a curve: table, size, extrapolate."""
    table = node.properties.get("curves")
    if table is None:
        builder.notice("the curve has no table", "a straight line is used")
        ends = (float(node.properties.get("min_x", 0.0)), float(node.properties.get("max_x", 1.0)))
        table = np.repeat(np.array(ends, np.float32)[:, None], width, axis=1)
    table = np.asarray(table, np.float32).reshape(len(table), -1)[:, :width]
    return builder.add_table(table), len(table), flag(node, "extrapolate", True)


def _rgb_curves(node: Node, builder: Any) -> Operation:
    return Operation(
        ops_math.OP_CURVES,
        (Socket("Fac", FLOAT, 1.0), Socket("Color", COLOR, _ONE), *_curve_range(node)),
        (Socket("Color", COLOR),),
        _curve_table(node, builder, 3),
    )


def _vector_curves(node: Node, builder: Any) -> Operation:
    return Operation(
        ops_math.OP_CURVES,
        (Socket("Fac", FLOAT, 1.0), Socket("Vector", VECTOR, _BLACK), *_curve_range(node)),
        (Socket("Vector", VECTOR),),
        _curve_table(node, builder, 3),
    )


def _wavelength(node: Node, builder: Any) -> Operation:
    return Operation(
        ops_math.OP_WAVELENGTH,
        (Socket("Wavelength", FLOAT, 500.0), Socket("", FLOAT, 380.0), Socket("", FLOAT, 780.0)),
        (Socket("Color", COLOR),),
        (builder.add_table(CIE_1931_TO_REC709), len(CIE_1931_TO_REC709)),
    )


NODES: NodeTable = {
    # Procedural textures
    "ShaderNodeTexChecker": Operation(
        ops_texture.OP_CHECKER,
        (_TEXTURE_VECTOR, Socket("Color1", COLOR, _LIGHT), Socket("Color2", COLOR, _DARK), Socket("Scale", FLOAT, 5.0)),
        _COLOR_AND_FAC,
    ),
    "ShaderNodeTexNoise": _noise,
    "ShaderNodeTexGradient": _gradient,
    "ShaderNodeTexVoronoi": _voronoi,
    "ShaderNodeTexWave": _wave,
    "ShaderNodeTexBrick": _brick,
    "ShaderNodeTexMagic": _magic,
    "ShaderNodeTexWhiteNoise": _white_noise,
    # Numbers and vectors
    "ShaderNodeMath": _math,
    "ShaderNodeVectorMath": _vector_math,
    "ShaderNodeMapRange": _map_range,
    "ShaderNodeClamp": _clamp,
    "ShaderNodeFloatCurve": _float_curve,
    "ShaderNodeVectorCurve": _vector_curves,
    "ShaderNodeVectorRotate": _vector_rotate,
    "ShaderNodeCombineXYZ": Operation(
        ops_math.OP_COMBINE_XYZ,
        (Socket("X", FLOAT), Socket("Y", FLOAT), Socket("Z", FLOAT)),
        (Socket("Vector", VECTOR),),
    ),
    "ShaderNodeSeparateXYZ": Operation(
        ops_math.OP_SEPARATE_XYZ,
        (Socket("Vector", VECTOR, _BLACK),),
        (Socket("X", FLOAT), Socket("Y", FLOAT), Socket("Z", FLOAT)),
    ),
    # Mixing
    "ShaderNodeMix": _mix,
    "ShaderNodeMixRGB": _mix_rgb,
    # Colours
    "ShaderNodeCombineColor": _combine_color,
    "ShaderNodeSeparateColor": _separate_color,
    "ShaderNodeRGBToBW": Operation(
        ops_math.OP_LUMINANCE, (Socket("Color", COLOR, _GREY),), (Socket("Val", FLOAT),)
    ),
    "ShaderNodeInvert": Operation(
        ops_math.OP_INVERT,
        (Socket("Fac", FLOAT, 1.0), Socket("Color", COLOR, _BLACK)),
        (Socket("Color", COLOR),),
    ),
    "ShaderNodeHueSaturation": Operation(
        ops_math.OP_HUE_SATURATION,
        (
            Socket("Hue", FLOAT, 0.5),
            Socket("Saturation", FLOAT, 1.0),
            Socket("Value", FLOAT, 1.0),
            Socket("Fac", FLOAT, 1.0),
            Socket("Color", COLOR, _LIGHT),
        ),
        (Socket("Color", COLOR),),
    ),
    "ShaderNodeGamma": Operation(
        ops_math.OP_GAMMA, (Socket("Color", COLOR, _ONE), Socket("Gamma", FLOAT, 1.0)), (Socket("Color", COLOR),)
    ),
    "ShaderNodeBrightContrast": Operation(
        ops_math.OP_BRIGHT_CONTRAST,
        (Socket("Color", COLOR, _ONE), Socket("Bright", FLOAT, 0.0), Socket("Contrast", FLOAT, 0.0)),
        (Socket("Color", COLOR),),
    ),
    "ShaderNodeBlackbody": Operation(
        ops_math.OP_BLACKBODY, (Socket("Temperature", FLOAT, 6500.0),), (Socket("Color", COLOR),)
    ),
    "ShaderNodeWavelength": _wavelength,
    "ShaderNodeValToRGB": _ramp,
    "ShaderNodeRGBCurve": _rgb_curves,
}
