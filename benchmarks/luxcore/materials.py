# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials that LuxCore means as Blender does: Diffuse, smooth Glass and Glossy, Transparent, Mix, Emission, and
absorption within glass.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from benchmarks.luxcore.properties import Properties, prefixed, refuse_links, socket_value

#: As smooth as these are in Blender, mirrors and clear glass are in LuxCore.
_SMOOTH = 1e-4


def _color(node: Any) -> list[float]:
    return list(socket_value(node, "Color")[:3])


def _require_smooth(node: Any, what: str) -> None:
    if socket_value(node, "Roughness") > _SMOOTH:
        raise ValueError(f"its {what} is rough")


def _diffuse(node: Any) -> Properties:
    _require_smooth(node, "diffuse surface")
    return {"type": "matte", "kd": _color(node)}


def _glass(node: Any) -> Properties:
    _require_smooth(node, "glass")
    if "Thin Film Thickness" in node.inputs and socket_value(node, "Thin Film Thickness") > 0.0:
        raise ValueError("its glass has a thin film")
    color = _color(node)
    return {"type": "glass", "kr": color, "kt": color, "interiorior": socket_value(node, "IOR"), "exteriorior": 1.0}


def _mirror(node: Any) -> Properties:
    _require_smooth(node, "metal")
    return {"type": "mirror", "kr": _color(node)}


def _transparent(node: Any) -> Properties:
    return {"type": "null", "transparency": _color(node)}


def _emission(node: Any) -> Properties:
    strength = socket_value(node, "Strength")
    return {"type": "matte", "kd": [0.0] * 3, "emission": _color(node), "emission.gain": [strength] * 3}


_CLOSURES: Mapping[str, Callable[[Any], Properties]] = {
    "BSDF_DIFFUSE": _diffuse, "BSDF_GLASS": _glass, "BSDF_GLOSSY": _mirror, "BSDF_TRANSPARENT": _transparent,
    "EMISSION": _emission,
}  # fmt: skip


def _closure(node: Any, name: str) -> Properties:
    """Properties of a node's material `name`, and of those that it mixes, which come first: LuxCore asks for that."""
    if node is None or (node.type not in _CLOSURES and node.type != "MIX_SHADER"):
        raise ValueError(f"it has {node.bl_label if node is not None else 'no surface'}")
    if node.type != "MIX_SHADER":
        refuse_links(node)
        return prefixed(f"scene.materials.{name}", _CLOSURES[node.type](node))
    factor, *sides = node.inputs
    if factor.is_linked:
        raise ValueError("the factor of its Mix is linked")
    made: Properties = {}
    for side, socket in zip("ab", sides, strict=True):
        mixed = socket.links[0].from_node if socket.is_linked else None
        if mixed is not None and mixed.type == "EMISSION":
            raise ValueError("its Mix glows")
        made |= _closure(mixed, f"{name}{side}")
    mix = {"type": "mix", "material1": f"{name}a", "material2": f"{name}b", "amount": float(factor.default_value)}
    return made | prefixed(f"scene.materials.{name}", mix)


def _volume(node: Any, surface: Any, name: str) -> Properties:
    """Absorption within glass, by the distance [1/m]; its refractive index is the glass's."""
    if node.type != "VOLUME_ABSORPTION":
        raise ValueError(f"it has a {node.bl_label} inside")
    if surface.type != "BSDF_GLASS":
        raise ValueError("it has a volume inside, and is no Glass")
    refuse_links(node)
    density = max(socket_value(node, "Density"), 0.0)
    absorption = [density * max(1.0 - channel, 0.0) for channel in _color(node)]
    volume = {"type": "clear", "absorption": absorption, "ior": socket_value(surface, "IOR")}
    inside = {f"scene.materials.{name}.volume.interior": f"{name}v"}
    return prefixed(f"scene.volumes.{name}v", volume) | inside


def export_material(material: Any, name: str) -> Properties:
    """A material's properties, as LuxCore's material `name`.

    Raises
    ------
    ValueError
        Naming what LuxCore would not show alike.
    """
    if material is None:
        raise ValueError("an object has no material: give it one")
    try:
        return _exported(material, name)
    except ValueError as error:
        raise ValueError(f"the material {material.name!r}: {error}; LuxCore would not show it alike") from error


def _exported(material: Any, name: str) -> Properties:
    output = material.node_tree.get_output_node("CYCLES") if material.node_tree is not None else None

    def source(socket: str) -> Any:
        links = output.inputs[socket].links if output is not None else ()
        return links[0].from_node if links else None

    if source("Displacement") is not None:
        raise ValueError("it is displaced")
    surface, volume = source("Surface"), source("Volume")
    made = _closure(surface, name)
    return made if volume is None else made | _volume(volume, surface, name)


def glows(properties: Properties) -> bool:
    """Whether a material's properties have a light."""
    return any(name.endswith(".emission") for name in properties)
