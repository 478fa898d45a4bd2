# SPDX-License-Identifier: GPL-3.0-or-later
"""Shader nodes: closures, and how Mix and Add Shader hand weights on to them.

Each closure's entry has a function `emit(node, weight, builder)`; it appends instructions through `builder.closure`,
which takes the opcode, the weight, further operands and the modes that need the instruction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from engine.kernels.bsdf.kinds import ASHIKHMIN_SHIRLEY, BECKMANN, GGX, MULTI_GGX, WEIGHT_CUTOFF
from engine.kernels.bsdf.linked_lobes import link_lobes
from engine.kernels.bsdf.plain_glass import fold_glass, fold_glossy
from engine.kernels.bsdf.plain_principled import fold_principled
from engine.kernels.bsdf.subsurface import BURLEY, RANDOM_WALK, RANDOM_WALK_LEGACY, RANDOM_WALK_SKIN
from engine.kernels.bsdf.tables import load_tables
from engine.kernels.shader import ops_closure as ops
from engine.scene.description import Node
from engine.shaders import nodes_hair, nodes_linked
from engine.shaders.closure_inputs import BLACK as _BLACK
from engine.shaders.closure_inputs import ONE as _ONE
from engine.shaders.closure_inputs import WHITE as _WHITE
from engine.shaders.closure_inputs import ZERO as _ZERO
from engine.shaders.closure_inputs import color as _color
from engine.shaders.closure_inputs import known as _known
from engine.shaders.closure_inputs import normal as _normal
from engine.shaders.closure_inputs import number as _float
from engine.shaders.options import choice, flag
from engine.shaders.program import Constant, Value, is_zero
from engine.shaders.table import VECTOR, Implicit, Socket
from engine.state.shaders import MODE_CLOSURES, MODE_EMISSION, MODE_TRANSPARENCY

Emit = Callable[[Node, Value, Any], None]


@dataclass(frozen=True)
class ClosureNode:
    """A shader node, and what of it is known: whatever a newer host adds is reported.

    Attributes
    ----------
    inputs : tuple of str or None
        All that it has, since `emit` asks for inputs only where these matter; None: the node is reported whole.
    settings : tuple of str
        Those that are read, or without effect on the picture.
    """

    emit: Emit
    inputs: tuple[str, ...] | None = None
    settings: tuple[str, ...] = ()


_LOBES = (MODE_CLOSURES,)
_DISTRIBUTIONS = {
    "GGX": GGX,
    "MULTI_GGX": MULTI_GGX,
    "BECKMANN": BECKMANN,
    "ASHIKHMIN_SHIRLEY": ASHIKHMIN_SHIRLEY,
    "SHARP": GGX,
}
_SUBSURFACE_METHODS = {
    "BURLEY": BURLEY,
    "RANDOM_WALK": RANDOM_WALK,
    "RANDOM_WALK_LEGACY": RANDOM_WALK_LEGACY,
    "RANDOM_WALK_SKIN": RANDOM_WALK_SKIN,
}


def _distribution(node: Node, builder: Any, roughness: Value, default: str) -> int:
    kind: int = choice(node, builder, "distribution", _DISTRIBUTIONS, default)
    # Mirrors have none.
    if kind >= BECKMANN and is_zero(roughness):
        return GGX
    if kind >= BECKMANN:
        link_lobes()
    return kind


def _roughness(node: Node, builder: Any, default: float) -> Value:
    if node.properties.get("distribution") == "SHARP":
        return _ZERO
    return _float(builder, "Roughness", default)


def _tints_by_bounce(node: Node) -> int:
    """Whether facets of rough diffuse surfaces tint light as from Blender 5.3 on."""
    return flag(node, "tints_by_bounce", True)


def diffuse(node: Node, weight: Value, builder: Any) -> None:
    """Diffuse BSDF."""
    operands = (_normal(builder), _color(builder), _float(builder, "Roughness", 0.0))
    builder.closure(ops.opcode("DIFFUSE"), weight, operands, (_tints_by_bounce(node),), modes=_LOBES)


def translucent(node: Node, weight: Value, builder: Any) -> None:
    """Translucent BSDF."""
    builder.closure(ops.opcode("TRANSLUCENT"), weight, (_normal(builder), _color(builder)), modes=_LOBES)


def transparent(node: Node, weight: Value, builder: Any) -> None:
    """Transparent BSDF."""
    builder.closure(
        ops.OP_TRANSPARENT, weight, (_color(builder, default=1.0),), modes=(MODE_CLOSURES, MODE_TRANSPARENCY)
    )


def holdout(node: Node, weight: Value, builder: Any) -> None:
    """Holdout."""
    builder.closure(ops.OP_HOLDOUT, weight, (), modes=(MODE_CLOSURES, MODE_TRANSPARENCY))


def emission(node: Node, weight: Value, builder: Any) -> None:
    """Emission and Background."""
    color = _color(builder, default=1.0 if node.kind == "ShaderNodeEmission" else 0.8)
    strength = _float(builder, "Strength", 1.0)
    if not is_zero(color) and not is_zero(strength):
        builder.closure(ops.OP_EMISSION, weight, (color, strength), modes=(MODE_CLOSURES, MODE_EMISSION))


def glossy(node: Node, weight: Value, builder: Any) -> None:
    """Glossy BSDF (which Blender 4 and later store as the anisotropic one)."""
    anisotropy = _float(builder, "Anisotropy", 0.0)
    rotation = _ZERO if is_zero(anisotropy) else _float(builder, "Rotation", 0.0)
    tangent = _BLACK if is_zero(anisotropy) else builder.input(Socket("Tangent", VECTOR, Implicit.TANGENT))
    roughness = _roughness(node, builder, 0.5)
    plain = (_normal(builder), _color(builder))
    distribution = _distribution(node, builder, roughness, "MULTI_GGX")
    known = _known(roughness)
    if is_zero(anisotropy) and known is not None and distribution < BECKMANN:
        folded = fold_glossy(load_tables().data, known, is_multiple=distribution == MULTI_GGX)
        builder.closure(ops.opcode("PLAIN_GLOSSY"), weight, (*plain, Constant(folded)), modes=_LOBES)
        return
    operands = (*plain, roughness, anisotropy, rotation, tangent)
    builder.closure(ops.opcode("GLOSSY"), weight, operands, (distribution,), modes=_LOBES)


def refraction(node: Node, weight: Value, builder: Any) -> None:
    """Refraction BSDF."""
    color = _color(builder, default=1.0)
    roughness = _roughness(node, builder, 0.0)
    operands = (_normal(builder), color, roughness, _float(builder, "IOR", 1.45))
    distribution = _distribution(node, builder, roughness, "BECKMANN")
    builder.closure(ops.opcode("REFRACTION"), weight, operands, (distribution,), modes=_LOBES)


def glass(node: Node, weight: Value, builder: Any) -> None:
    """Glass BSDF."""
    film = nodes_linked.film(builder)
    color = _color(builder, default=1.0)
    roughness = _roughness(node, builder, 0.0)
    ior = _float(builder, "IOR", 1.5)
    distribution = _distribution(node, builder, roughness, "MULTI_GGX")
    anisotropy = _float(builder, "Anisotropy", 0.0)
    if not is_zero(anisotropy) and not is_zero(roughness):
        nodes_linked.glass(builder, weight, distribution, (color, ior), (roughness, anisotropy, film))
        return
    known, known_ior = _known(roughness), _known(ior)
    if known is not None and known_ior is not None and is_zero(film[0]) and distribution < BECKMANN:
        folded = fold_glass(load_tables().data, known, known_ior, is_multiple=distribution == MULTI_GGX)
        builder.closure(
            ops.opcode("PLAIN_GLASS"), weight, (_normal(builder), color, Constant(folded)), modes=_LOBES
        )
        return
    operands = (_normal(builder), color, roughness, ior, *film)
    builder.closure(ops.opcode("GLASS"), weight, operands, (distribution,), modes=_LOBES)


#: Operands of PRINCIPLED behind the normals and the tangent, with the values that switch each of them off.
_PRINCIPLED_OFF: dict[str, Value] = {
    "base_color": _BLACK,
    "metallic": _ZERO,
    "roughness": Constant((0.5,)),
    "diffuse_roughness": _ZERO,
    "ior": Constant((1.5,)),
    "specular_level": _ZERO,
    "specular_tint": _WHITE,
    "anisotropic": _ZERO,
    "anisotropic_rotation": _ZERO,
    "transmission": _ZERO,
    "coat_weight": _ZERO,
    "coat_roughness": _ZERO,
    "coat_ior": Constant((1.5,)),
    "coat_tint": _WHITE,
    "sheen_weight": _ZERO,
    "sheen_roughness": Constant((0.5,)),
    "sheen_tint": _WHITE,
    "emission_color": _BLACK,
    "emission_strength": _ZERO,
    "alpha": _ONE,
    "subsurface_weight": _ZERO,
    "subsurface_radius": Constant((1.0, 0.2, 0.1)),
    "subsurface_scale": _ZERO,
    "subsurface_ior": Constant((1.4,)),
    "subsurface_anisotropy": _ZERO,
    "thin_wall": _ZERO,
    "film_thickness": _ZERO,
    "film_ior": _ONE,
}


def _plain_principled(distribution: int, normal: Value, values: Mapping[str, Value]) -> tuple[Value, ...] | None:
    """Operands of PLAIN_PRINCIPLED, or None where more is asked of PRINCIPLED."""
    numbers: dict[str, tuple[float, ...]] = {}
    for name, value in values.items():
        if isinstance(value, Constant):
            numbers[name] = value.value
    folded = ("roughness", "ior", "specular_level", "specular_tint")
    off = (
        *("metallic", "diffuse_roughness", "anisotropic", "transmission", "coat_weight", "sheen_weight"),
        *("subsurface_weight", "film_thickness"),
    )
    if not all(name in numbers for name in (*folded, *off, "emission_color", "emission_strength", "alpha")):
        return None
    if any(numbers[name][0] >= WEIGHT_CUTOFF for name in off) or numbers["alpha"][0] < 1.0:
        return None
    if any(numbers["emission_color"]) and any(numbers["emission_strength"]):
        return None
    roughness, ior, level = (numbers[name][0] for name in folded[:3])
    table = fold_principled(
        load_tables().data, roughness, ior, level, numbers["specular_tint"], is_multiple=distribution == MULTI_GGX
    )
    return normal, values["base_color"], Constant(table)


def _principled_lobes(
    builder: Any, weight: Value, settings: tuple[int, int, int, int], modes: tuple[int, ...], **values: Value
) -> None:
    """PRINCIPLED with everything off but `values` (and the normals).

    Parameters
    ----------
    settings : tuple of 4 int
        Distribution, how light scatters below the surface, whether facets tint by bounce, and whether glass is
        anisotropic.
    """
    normal = values.pop("normal", None) or _normal(builder)
    coat_normal = values.pop("coat_normal", None) or normal
    tangent = values.pop("tangent", None) or _BLACK
    inputs = _PRINCIPLED_OFF | values
    plain = _plain_principled(settings[0], normal, inputs)
    if plain is not None:
        builder.closure(ops.opcode("PLAIN_PRINCIPLED"), weight, plain, modes=modes)
        return
    rest = tuple(inputs.values())
    builder.closure(
        ops.opcode("PRINCIPLED"), weight, (normal, coat_normal, tangent, *rest), settings, modes=modes
    )


def _may_be_clear_wall(builder: Any) -> bool:
    """Whether a Principled BSDF may be a thin wall of glass so smooth that shadow rays go through."""
    names = {"Transmission Weight": 0.0, "Thin Wall": 0.0}
    if any(is_zero(_float(builder, name, default)) for name, default in names.items()):
        return False
    roughness, ior = _known(_float(builder, "Roughness", 0.5)), _known(_float(builder, "IOR", 1.5))
    # What bends light next to nothing comes through smoothly however rough it is (`thin_alpha`).
    return roughness is None or ior is None or roughness < 0.1 or ior < 1.01


def _stretches_glass(node: Node, builder: Any) -> int:
    """Whether a Principled BSDF has anisotropic glass, as from Blender 5.3 on: its lobe is linked."""
    parts = {"Anisotropic": 0.0, "Transmission Weight": 0.0, "Roughness": 0.5}
    if not _tints_by_bounce(node) or any(is_zero(_float(builder, name, other)) for name, other in parts.items()):
        return 0
    nodes_linked.link_lobes()
    return 1


def principled(node: Node, weight: Value, builder: Any) -> None:
    """Principled BSDF; shadow rays see its alpha only, light samples its emission only."""
    alpha = _float(builder, "Alpha", 1.0)
    is_clear = _may_be_clear_wall(builder)
    if not is_clear and not (isinstance(alpha, Constant) and alpha.value[0] >= 1.0):
        builder.closure(ops.OP_ALPHA, weight, (alpha,), modes=(MODE_TRANSPARENCY,))
    if isinstance(alpha, Constant) and alpha.value[0] <= 0.0:
        builder.closure(ops.OP_ALPHA, weight, (alpha,), modes=_LOBES)
        return
    coat = _float(builder, "Coat Weight", 0.0)
    sheen = _float(builder, "Sheen Weight", 0.0)
    emission_color = _color(builder, "Emission Color", 1.0)
    emission_strength = _float(builder, "Emission Strength", 0.0)
    values: dict[str, Value] = {"alpha": alpha}
    emits = not is_zero(emission_color) and not is_zero(emission_strength)
    if emits:
        values |= {"emission_color": emission_color, "emission_strength": emission_strength}
    if not is_zero(coat):
        values |= {
            "coat_weight": coat,
            "coat_roughness": _float(builder, "Coat Roughness", 0.03),
            "coat_ior": _float(builder, "Coat IOR", 1.5),
            "coat_tint": _color(builder, "Coat Tint", 1.0),
            "coat_normal": _normal(builder, "Coat Normal"),
        }
    if not is_zero(sheen):
        values |= {
            "sheen_weight": sheen,
            "sheen_roughness": _float(builder, "Sheen Roughness", 0.5),
            "sheen_tint": _color(builder, "Sheen Tint", 1.0),
        }
    settings = (
        _distribution(node, builder, _ZERO, "MULTI_GGX"),
        choice(node, builder, "subsurface_method", _SUBSURFACE_METHODS, "RANDOM_WALK"),
        _tints_by_bounce(node),
        _stretches_glass(node, builder),
    )
    if emits:
        if is_zero(coat) and is_zero(sheen):
            visible = builder.multiply(weight, builder.saturate(alpha))
            operands = (emission_color, emission_strength)
            builder.closure(ops.OP_EMISSION, visible, operands, modes=(MODE_EMISSION,))
        else:
            # Coat and sheen attenuate what lies below them: let the whole closure work it out.
            _principled_lobes(builder, weight, settings, (MODE_EMISSION,), **values)
    anisotropic = _float(builder, "Anisotropic", 0.0)
    if not is_zero(anisotropic):
        values |= {
            "anisotropic": anisotropic,
            "anisotropic_rotation": _float(builder, "Anisotropic Rotation", 0.0),
            "tangent": builder.input(Socket("Tangent", VECTOR, Implicit.TANGENT)),
        }
    values |= {
        "base_color": _color(builder, "Base Color"),
        "metallic": _float(builder, "Metallic", 0.0),
        "roughness": _float(builder, "Roughness", 0.5),
        "diffuse_roughness": _float(builder, "Diffuse Roughness", 0.0),
        "ior": _float(builder, "IOR", 1.5),
        "specular_level": _float(builder, "Specular IOR Level", 0.5),
        "specular_tint": _color(builder, "Specular Tint", 1.0),
        "transmission": _float(builder, "Transmission Weight", 0.0),
    }
    thin_wall = _float(builder, "Thin Wall", 0.0)
    has_depth = not is_zero(_float(builder, "Subsurface Scale", 0.05)) or not is_zero(thin_wall)
    if not is_zero(_float(builder, "Subsurface Weight", 0.0)) and has_depth:
        values |= {
            "subsurface_weight": _float(builder, "Subsurface Weight", 0.0),
            "subsurface_radius": builder.input(Socket("Subsurface Radius", VECTOR, (1.0, 0.2, 0.1))),
            "subsurface_scale": _float(builder, "Subsurface Scale", 0.05),
            "subsurface_ior": _float(builder, "Subsurface IOR", 1.4),
            "subsurface_anisotropy": _float(builder, "Subsurface Anisotropy", 0.0),
        }
    if any(not is_zero(_float(builder, name, 0.0)) for name in ("Transmission Weight", "Subsurface Weight")):
        values["thin_wall"] = thin_wall
    values["film_thickness"], values["film_ior"] = nodes_linked.film(builder)
    modes = (*_LOBES, MODE_TRANSPARENCY) if is_clear else _LOBES
    _principled_lobes(builder, weight, settings, modes, **values)


def metallic(node: Node, weight: Value, builder: Any) -> None:
    """Metallic BSDF: where its lobe need not be linked, as the metallic part of the Principled BSDF."""
    film = nodes_linked.film(builder)
    by_index = choice(node, builder, "fresnel_type", ("F82", "PHYSICAL_CONDUCTOR"), "F82") == 1
    anisotropic = _float(builder, "Anisotropy", 0.0)
    is_isotropic = is_zero(anisotropic)
    rotation = _ZERO if is_isotropic else _float(builder, "Rotation", 0.0)
    tangent = _BLACK if is_isotropic else builder.input(Socket("Tangent", VECTOR, Implicit.TANGENT))
    roughness = _float(builder, "Roughness", 0.5)
    distribution = _distribution(node, builder, roughness, "MULTI_GGX")
    if by_index or distribution >= BECKMANN or not is_zero(film[0]):
        numbers = (roughness, anisotropic, rotation, *film)
        nodes_linked.metal(builder, weight, distribution, tangent, numbers, by_index=by_index)
        return
    values: dict[str, Value] = {
        "base_color": _color(builder, "Base Color", 0.617),
        "specular_tint": _color(builder, "Edge Tint", 0.695),
        "metallic": _ONE,
        "roughness": roughness,
    }
    if not is_isotropic:
        values |= {"anisotropic": anisotropic, "anisotropic_rotation": rotation, "tangent": tangent}
    _principled_lobes(builder, weight, (distribution, RANDOM_WALK, 1, 0), _LOBES, **values)


def sheen(node: Node, weight: Value, builder: Any) -> None:
    """Sheen BSDF, of microfibres as the sheen of the Principled BSDF over black."""
    if choice(node, builder, "distribution", ("MICROFIBER", "ASHIKHMIN"), "MICROFIBER"):
        nodes_linked.velvet(node, weight, builder)
        return
    values = {
        "sheen_weight": _ONE,
        "sheen_roughness": _float(builder, "Roughness", 0.5),
        "sheen_tint": _color(builder),
    }
    _principled_lobes(builder, weight, (GGX, RANDOM_WALK, 1, 0), _LOBES, **values)


def subsurface(node: Node, weight: Value, builder: Any) -> None:
    """Subsurface Scattering."""
    operands = (
        _normal(builder), _color(builder), _float(builder, "Roughness", 1.0),
        builder.input(Socket("Radius", VECTOR, (1.0, 0.2, 0.1))), _float(builder, "Scale", 0.05),
        _float(builder, "IOR", 1.4), _float(builder, "Anisotropy", 0.0),
    )  # fmt: skip
    method = choice(node, builder, "falloff", _SUBSURFACE_METHODS, "RANDOM_WALK")
    builder.closure(ops.opcode("SUBSURFACE"), weight, operands, (method,), modes=_LOBES)


def _nothing(problem: str) -> Emit:
    def emit(node: Node, weight: Value, builder: Any) -> None:
        builder.notice(problem, "nothing")

    return emit


_LOBE = ("Color", "Roughness", "Normal")
_FILM = ("Thin Film Thickness", "Thin Film IOR")
_GLOSSY = ClosureNode(glossy, (*_LOBE, "Anisotropy", "Rotation", "Tangent"), ("distribution",))
_GLASS = ClosureNode(glass, (*_LOBE, "IOR", "Anisotropy", "Rotation", "Tangent", *_FILM), ("distribution",))
_EMISSION = ClosureNode(emission, ("Color", "Strength"))
_VOLUME = ClosureNode(_nothing("is a volume linked to a surface"))
_PRINCIPLED = ClosureNode(
    principled,
    (
        *("Base Color", "Metallic", "Roughness", "IOR", "Alpha", "Normal", "Diffuse Roughness", "Thin Wall"),
        *("Subsurface Weight", "Subsurface Radius", "Subsurface Scale", "Subsurface IOR", "Subsurface Anisotropy"),
        *("Specular IOR Level", "Specular Tint", "Anisotropic", "Anisotropic Rotation", "Tangent"),
        # The host says how strongly a material disperses (`Material.dispersion`).
        *("Transmission Dispersion Scale", "Transmission Dispersion Abbe Number"),
        *("Transmission Weight", "Coat Weight", "Coat Roughness", "Coat IOR", "Coat Tint", "Coat Normal"),
        *("Sheen Weight", "Sheen Roughness", "Sheen Tint", "Emission Color", "Emission Strength", *_FILM),
    ),
    ("distribution", "subsurface_method"),
)
_METALLIC = ClosureNode(
    metallic,
    (
        *("Base Color", "Edge Tint", "Extinction", "IOR", "Roughness"),
        *("Anisotropy", "Rotation", "Normal", "Tangent", *_FILM),
    ),
    ("distribution", "fresnel_type"),
)

CLOSURES: dict[str, ClosureNode] = {
    "ShaderNodeBsdfPrincipled": _PRINCIPLED,
    "ShaderNodeBsdfDiffuse": ClosureNode(diffuse, _LOBE),
    "ShaderNodeBsdfGlossy": _GLOSSY,
    "ShaderNodeBsdfAnisotropic": _GLOSSY,
    "ShaderNodeBsdfRefraction": ClosureNode(refraction, (*_LOBE, "IOR"), ("distribution",)),
    "ShaderNodeBsdfGlass": _GLASS,
    "ShaderNodeBsdfTranslucent": ClosureNode(translucent, ("Color", "Normal")),
    "ShaderNodeBsdfTransparent": ClosureNode(transparent, ("Color",)),
    "ShaderNodeBsdfMetallic": _METALLIC,
    "ShaderNodeBsdfSheen": ClosureNode(sheen, _LOBE, ("distribution",)),
    "ShaderNodeBsdfVelvet": ClosureNode(nodes_linked.velvet, ("Color", "Sigma", "Normal")),
    "ShaderNodeBsdfToon": ClosureNode(nodes_linked.toon, ("Color", "Size", "Smooth", "Normal"), ("component",)),
    "ShaderNodeBsdfHair": ClosureNode(nodes_hair.hair, nodes_hair.HAIR_INPUTS, ("component",)),
    "ShaderNodeBsdfHairPrincipled": ClosureNode(
        nodes_hair.principled_hair, nodes_hair.PRINCIPLED_HAIR_INPUTS, ("model", "parametrization")
    ),
    "ShaderNodeSubsurfaceScattering": ClosureNode(
        subsurface, (*_LOBE, "Scale", "Radius", "IOR", "Anisotropy"), ("falloff",)
    ),
    "ShaderNodeBsdfRayPortal": ClosureNode(nodes_linked.ray_portal, ("Color", "Position", "Direction")),
    "ShaderNodeEmission": _EMISSION,
    "ShaderNodeBackground": _EMISSION,
    "ShaderNodeHoldout": ClosureNode(holdout, ()),
    "ShaderNodeVolumeAbsorption": _VOLUME,
    "ShaderNodeVolumeScatter": _VOLUME,
    "ShaderNodeVolumePrincipled": _VOLUME,
    "ShaderNodeVolumeCoefficients": _VOLUME,
}

MIX_SHADER = "ShaderNodeMixShader"
ADD_SHADER = "ShaderNodeAddShader"
#: Inputs of the nodes that hand weights on.
MIXES: dict[str, tuple[str, ...]] = {
    MIX_SHADER: ("Fac", "Shader", "Shader_001"),
    ADD_SHADER: ("Shader", "Shader_001"),
}
