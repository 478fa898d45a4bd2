# SPDX-License-Identifier: GPL-3.0-or-later
"""Light objects in Blender's own units."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from engine.array_types import Float32Array
from engine.scene.description import Light, Portal

from ..versions import BRIGHTER_AREA_LIGHTS, is_since, read_setting, uses_nodes
from .context import ExportContext, cycles_property
from .nodes import GraphExporter

if TYPE_CHECKING:
    import bpy


class LightExporter:
    """Exports appearances of light objects; what many share of one datablock is read once.

    Parameters
    ----------
    context : ExportContext
    graphs : GraphExporter
    """

    def __init__(self, context: ExportContext, graphs: GraphExporter) -> None:
        self._context = context
        self._graphs = graphs
        #: Light portals among what has been exported.
        self.portals: list[Portal] = []
        #: By address.
        self._shared: dict[int, dict[str, Any]] = {}

    def export(
        self,
        light_object: bpy.types.Object,
        transform: Float32Array,
        visibility: int,
        light_group: int,
        random: float,
        key: object,
    ) -> Light | None:
        """One appearance of a light object; None for portals, which emit nothing: they are kept in `portals`.

        Parameters
        ----------
        transform : float32 (4, 4)
            Object to world.
        visibility : int
            VISIBLE_* bits.
        light_group : int
            Index into the view layer's, -1 = none.
        random : float
            In [0, 1), for Object Info.
        """
        data = light_object.data
        name = light_object.name
        if data.type == "AREA" and cycles_property(data, "is_portal", False):
            self.portals.append(Portal(transform, **_rectangle(data)))
            return None
        address = data.as_pointer()
        shared = self._shared.get(address)
        if shared is None:
            shared = self._shared[address] = self._read(data, name)
        return Light(
            key=("light", key), name=name, transform=transform, visibility=visibility, light_group=light_group,
            random=random, object_color=tuple(light_object.color), pass_index=light_object.pass_index, **shared,
        )

    def _read(self, data: bpy.types.Light, name: str) -> dict[str, Any]:
        """Fields of `Light` that all of a datablock's objects have in common; `name` stands for them in notices."""
        return {
            "kind": data.type,
            "color": _color(data),
            "temperature": _temperature(data),
            "energy": _energy(data),
            "is_normalized": read_setting(data, "normalize"),
            "use_soft_falloff": read_setting(data, "use_soft_falloff"),
            "cast_shadow": bool(read_setting(data, "use_shadow")),
            "use_mis": cycles_property(data, "use_multiple_importance_sampling", True),
            "max_bounces": cycles_property(data, "max_bounces", 1024),
            "graph": self._graphs.export(data.node_tree, name) if uses_nodes(data) else None,
            **_SHAPES[data.type](data),
        }


def _point(data: bpy.types.PointLight | bpy.types.SpotLight) -> dict[str, Any]:
    return {"radius": data.shadow_soft_size}


def _spot(data: bpy.types.SpotLight) -> dict[str, Any]:
    return _point(data) | {"spot_angle": data.spot_size, "spot_blend": data.spot_blend}


def _sun(data: bpy.types.SunLight) -> dict[str, Any]:
    return {"angle": data.angle}


def _area(data: bpy.types.AreaLight) -> dict[str, Any]:
    return _rectangle(data) | {"spread": data.spread}


def _rectangle(data: bpy.types.AreaLight) -> dict[str, Any]:
    size_y = data.size_y if data.shape in ("RECTANGLE", "ELLIPSE") else data.size
    return {"shape": data.shape, "size_x": data.size, "size_y": size_y}


#: By kind: the fields of `Light` that only this kind has.
_SHAPES: dict[str, Callable[[Any], dict[str, Any]]] = {"POINT": _point, "SPOT": _spot, "SUN": _sun, "AREA": _area}


def _energy(data: bpy.types.Light) -> float:
    """[W] as newer Blenders mean it."""
    if data.type == "AREA" and not is_since(BRIGHTER_AREA_LIGHTS):
        return data.energy * math.pi / 4.0
    return data.energy


def _color(data: bpy.types.Light) -> tuple[float, float, float]:
    color = np.array(data.color, np.float64)
    if read_setting(data, "use_temperature"):
        color *= np.array(data.temperature_color, np.float64)
    color *= 2.0 ** read_setting(data, "exposure")
    return float(color[0]), float(color[1]), float(color[2])


def _temperature(data: bpy.types.Light) -> float:
    """[K] of lights that have the colour of a black body, 0 of others: tinted ones have another spectrum."""
    is_grey = data.color[0] == data.color[1] == data.color[2]
    return data.temperature if read_setting(data, "use_temperature") and is_grey else 0.0
