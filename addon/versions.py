# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender's versions did to settings: since when there is one, and where it was before.

`SETTINGS` is the table; whoever reads a setting in it does so by `read_setting`. What versions did to nodes is in
`export.node_versions`, what they did to calls (normals, UV maps, triangles) where these are made.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import bpy

Version = tuple[int, int]

#: The newest Blender whose nodes were gone through (tests/addon/test_node_coverage.py): all are known or reported.
NEWEST_KNOWN: Version = (5, 3)

#: Passes have their new names, also as sockets of the compositor.
RENAMED_PASSES: Version = (5, 0)
#: Node groups are dissolved before Cycles sees them: sockets in between do not count.
GROUPS_INLINED: Version = (5, 0)
#: The background has motion vectors in this version alone.
BACKGROUND_VECTORS: Version = (5, 2)
#: Transmission Color and Denoising Albedo know how rough glass is.
LOOKED_UP_TRANSMISSION: Version = (5, 2)
#: Denoisers get specular albedo and roughness too.
SPECULAR_FEATURES: Version = (5, 3)
#: Cycles can look textures up in files that it has made of them.
TEXTURE_CACHE: Version = (5, 2)
#: Pink stands for a missing image beyond its edges too, where the texture clips.
MISSING_IMAGES_UNCLIPPED: Version = (5, 2)
#: Cycles' normals of smooth faces stop at flat faces, with and without sharp edges.
NORMALS_STOP_AT_FLAT_FACES: Version = (5, 2)
#: Each window has a pause button of its own; Cycles' setting for all of them does nothing any more.
PAUSED_BY_WINDOW: Version = (5, 3)
#: Whether colours of a file are multiplied by alpha, an image's setting tells Cycles; before, the file itself did.
ALPHA_AS_SET: Version = (5, 2)
#: Cycles' attribute N is in the world's space where nothing shares the mesh, and absent where normals are of corners;
#: P and radius are names of its own.
NORMALS_AS_ATTRIBUTES: Version = (5, 2)
#: Materials see a mesh's own attributes before those that Cycles has under the same name, and N of corners again.
OWN_ATTRIBUTES_FIRST: Version = (5, 3)
#: Watts of an area light mean what they do now: the same number made it dimmer before.
BRIGHTER_AREA_LIGHTS: Version = (4, 0)
#: Materials and worlds always have nodes, and lights: `use_nodes` only says so, until Blender 6 drops it.
NODES_IN_MATERIALS: Version = (5, 0)
NODES_IN_LIGHTS: Version = (5, 2)


class Setting(NamedTuple):
    """A setting that not every Blender has, or not in the same place.

    `since`: the first version that has it under its name; `default`: what a Blender without it does; `before`: its name
    among Cycles' settings of the datablock in older versions, None if it was not there either.
    """

    since: Version
    default: Any
    before: str | None = None


#: By name, as seen from its owner (in the comment); 'cycles.x' is among Cycles' settings of the owner.
SETTINGS: dict[str, Setting] = {
    # Camera
    "panorama_type": Setting((5, 0), "EQUIRECTANGULAR", "panorama_type"),
    "latitude_min": Setting((5, 0), None, "latitude_min"),
    "latitude_max": Setting((5, 0), None, "latitude_max"),
    "longitude_min": Setting((5, 0), None, "longitude_min"),
    "longitude_max": Setting((5, 0), None, "longitude_max"),
    "fisheye_fov": Setting((5, 0), None, "fisheye_fov"),
    "fisheye_lens": Setting((5, 0), None, "fisheye_lens"),
    "fisheye_polynomial_k0": Setting((5, 0), 0.0, "fisheye_polynomial_k0"),
    "fisheye_polynomial_k1": Setting((5, 0), 0.0, "fisheye_polynomial_k1"),
    "fisheye_polynomial_k2": Setting((5, 0), 0.0, "fisheye_polynomial_k2"),
    "fisheye_polynomial_k3": Setting((5, 0), 0.0, "fisheye_polynomial_k3"),
    "fisheye_polynomial_k4": Setting((5, 0), 0.0, "fisheye_polynomial_k4"),
    "central_cylindrical_range_u_min": Setting((5, 0), -math.pi, "central_cylindrical_range_u_min"),
    "central_cylindrical_range_u_max": Setting((5, 0), math.pi, "central_cylindrical_range_u_max"),
    "central_cylindrical_range_v_min": Setting((5, 0), -1.0, "central_cylindrical_range_v_min"),
    "central_cylindrical_range_v_max": Setting((5, 0), 1.0, "central_cylindrical_range_v_max"),
    "central_cylindrical_radius": Setting((5, 0), 1.0, "central_cylindrical_radius"),
    # Light
    "exposure": Setting((4, 5), 0.0),
    "normalize": Setting((4, 5), True),
    "use_shadow": Setting((4, 2), True, "cast_shadow"),
    "use_soft_falloff": Setting((4, 1), True),
    "use_temperature": Setting((4, 5), False),
    # Material
    "cycles.emission_sampling": Setting((3, 5), None),
    "displacement_method": Setting((4, 1), "BUMP", "displacement_method"),
    "use_transparent_shadow": Setting((4, 2), True, "use_transparent_shadow"),
    # Modifier; Cycles had it on the object
    "use_adaptive_subdivision": Setting((5, 0), False, "use_adaptive_subdivision"),
    # Object
    "light_linking": Setting((4, 0), None),
    "shadow_terminator_geometry_offset": Setting((5, 0), 0.0, "shadow_terminator_geometry_offset"),
    "shadow_terminator_shading_offset": Setting((5, 0), 0.0, "shadow_terminator_offset"),
    "visible_raycast": Setting((5, 3), None),
    # Render settings; Cycles had it on the scene
    "motion_blur_position": Setting((4, 2), "CENTER", "motion_blur_position"),
    "use_auto_generate_texture_cache": Setting((5, 2), False),
    "use_texture_cache": Setting((5, 3), True),
    # Scene
    "cycles.texture_resolution": Setting((5, 2), 1.0),
    "cycles.texture_resolution_render": Setting((5, 2), 1.0),
    "cycles.use_pixel_jitter": Setting((5, 2), False),
    # World
    "cycles.use_shadows": Setting((5, 2), True),
}


def is_since(version: Version) -> bool:
    """Whether this Blender is of that version or later."""
    return bpy.app.version[:2] >= version


def is_newer(version: Version) -> bool:
    """Whether this Blender is of a later version."""
    return bpy.app.version[:2] > version


def read_setting(owner: Any, name: str, cycles_owner: Any = None) -> Any:
    """A setting of `SETTINGS` from wherever this Blender has it.

    Parameters
    ----------
    cycles_owner : datablock, optional
        Whose Cycles settings had it before, where that is not `owner`.
    """
    setting = SETTINGS[name]
    places = [(owner, name)]
    if name.startswith("cycles."):
        places = [(getattr(owner, "cycles", None), name.removeprefix("cycles."))]
    if setting.before is not None:
        places.append((getattr(cycles_owner or owner, "cycles", None), setting.before))
    # A name that Blender had for other engines before, or that Cycles kept, says nothing.
    if not is_since(setting.since):
        places.reverse()
    for place, attribute in places:
        value = getattr(place, attribute, None)
        if value is not None:
            return value
    return setting.default


def uses_nodes(owner: bpy.types.Material | bpy.types.World | bpy.types.Light) -> bool:
    """Whether a datablock's look comes from its nodes."""
    if owner.node_tree is None:
        return False
    since = NODES_IN_LIGHTS if isinstance(owner, bpy.types.Light) else NODES_IN_MATERIALS
    return is_since(since) or owner.use_nodes
