# SPDX-License-Identifier: GPL-3.0-or-later
"""Which inputs and settings of nodes are known, so that whatever a newer host adds is reported and not dropped.

An operation of the table of nodes says which inputs it reads. The settings of its node are listed here: read, or
without effect on the picture. Entries of closures list both (`nodes_closure`).
"""

from __future__ import annotations

from collections.abc import Collection

from engine.scene.description import Link, Node

#: Inputs that an operation has worked into a table, where they are constant.
FOLDED_INPUTS: dict[str, tuple[str, ...]] = {"ShaderNodeMapping": ("Location", "Rotation", "Scale")}

_FUNCTION_INPUT = ("vector", "vector_dimensions", "integer", "boolean")

#: Settings of nodes by their names in the host, without those that the host resolves (images, ramps, curves).
SETTINGS: dict[str, tuple[str, ...]] = {
    "ShaderNodeAmbientOcclusion": ("samples", "inside", "only_local"),
    "ShaderNodeAttribute": ("attribute_type", "attribute_name"),
    "ShaderNodeBevel": ("samples",),
    "ShaderNodeBump": ("invert",),
    "ShaderNodeClamp": ("clamp_type",),
    "ShaderNodeCombineColor": ("mode",),
    "ShaderNodeDisplacement": ("space",),
    "ShaderNodeMapRange": ("clamp", "interpolation_type", "data_type"),
    "ShaderNodeMapping": ("vector_type",),
    "ShaderNodeMath": ("operation", "use_clamp"),
    "ShaderNodeMix": ("data_type", "factor_mode", "blend_type", "clamp_factor", "clamp_result"),
    # The switch for alpha belongs to the compositor.
    "ShaderNodeMixRGB": ("blend_type", "use_alpha", "use_clamp"),
    "ShaderNodeNormalMap": ("space", "uv_map", "convention", "base"),
    "ShaderNodeRadialTiling": ("normalize",),
    "ShaderNodeRaycast": ("only_local", "active_index"),
    "ShaderNodeSeparateColor": ("mode",),
    "ShaderNodeTangent": ("direction_type", "axis", "uv_map"),
    "ShaderNodeTexBrick": ("offset_frequency", "squash_frequency", "offset", "squash"),
    "ShaderNodeTexCoord": ("from_instancer",),
    "ShaderNodeTexEnvironment": ("projection", "interpolation"),
    "ShaderNodeTexGabor": ("gabor_type",),
    "ShaderNodeTexGradient": ("gradient_type",),
    "ShaderNodeTexIES": ("mode", "filepath", "photometry"),
    "ShaderNodeTexImage": ("projection", "interpolation", "projection_blend", "extension"),
    "ShaderNodeTexMagic": ("turbulence_depth",),
    "ShaderNodeTexNoise": ("noise_dimensions", "noise_type", "normalize"),
    "ShaderNodeTexSky": (
        "sky_type", "sun_disc", "sun_size", "sun_intensity", "sun_elevation", "sun_rotation", "altitude",
        "air_density", "aerosol_density", "ozone_density", "sun_direction", "turbidity", "ground_albedo",
    ),
    "ShaderNodeTexVoronoi": ("voronoi_dimensions", "distance", "feature", "normalize"),
    "ShaderNodeTexWave": ("wave_type", "bands_direction", "rings_direction", "wave_profile"),
    "ShaderNodeTexWhiteNoise": ("noise_dimensions",),
    "ShaderNodeUVMap": ("from_instancer", "uv_map"),
    "ShaderNodeVectorDisplacement": ("space",),
    "ShaderNodeVectorMath": ("operation",),
    "ShaderNodeVectorRotate": ("rotation_type", "invert"),
    "ShaderNodeVectorTransform": ("vector_type", "convert_from", "convert_to"),
    "ShaderNodeVertexColor": ("layer_name",),
    "ShaderNodeWireframe": ("use_pixel_size",),
    "FunctionNodeInputBool": _FUNCTION_INPUT,
    "FunctionNodeInputInt": _FUNCTION_INPUT,
    "FunctionNodeInputVector": _FUNCTION_INPUT,
}


def unknown_parts(node: Node, known_inputs: Collection[str], known_settings: Collection[str]) -> list[str]:
    """What of a node of a known kind is not known and may matter, in words.

    Parameters
    ----------
    known_inputs : collection of str
        Identifiers of its inputs that are.
    known_settings : collection of str
        Names of its settings that are.
    """
    known_inputs = {*known_inputs, *FOLDED_INPUTS.get(node.kind, ())}
    parts = [
        f"the input {name!r}"
        for name, value in node.inputs.items()
        if name not in known_inputs and (isinstance(value, Link) or name in node.changed)
    ]
    parts += [
        f"the setting {name!r}" for name in node.properties if name in node.changed and name not in known_settings
    ]
    return parts
