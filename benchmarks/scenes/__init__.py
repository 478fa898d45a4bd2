# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds small scenes by script, one for each thing to compare: `builtin:NAME` names one.

Importing this package fills the registry; `bpy` is needed only to build.
"""

from benchmarks.scenes import (
    cameras,
    clamped,
    closures,
    coincident,
    culled,
    displaced,
    displaced_followers,
    failing_media,
    failures,
    fast_gi,
    flat_hair,
    furnished,
    geometry,
    hair,
    inlined,
    lamp_switches,
    lights,
    limits,
    linked,
    linked_closures,
    local_lamps,
    many_blockers,
    matter,
    matter_indoors,
    matter_large,
    media,
    motion,
    movies,
    moving_strands,
    node_rays,
    patterned_lamps,
    patterns,
    plants,
    portals,
    principled,
    ray_portals,
    rooms,
    shape_data,
    skies,
    spectral,
    stretched,
    subsurface,
    terminators,
    textures,
    wax,
    windows,
)
from benchmarks.scenes.registry import SCENES, BuiltinScene, build

__all__ = [
    "SCENES", "BuiltinScene", "build", "cameras", "clamped", "closures", "coincident", "culled", "displaced",
    "displaced_followers", "failing_media", "failures", "fast_gi", "flat_hair", "furnished", "geometry", "hair",
    "inlined", "lamp_switches", "lights", "limits", "linked", "linked_closures", "local_lamps", "many_blockers",
    "matter", "matter_indoors", "matter_large", "media", "motion", "movies", "moving_strands", "node_rays",
    "patterned_lamps", "patterns", "plants", "portals", "principled", "ray_portals", "rooms", "shape_data",
    "skies", "spectral", "stretched", "subsurface", "terminators", "textures", "wax", "windows",
]  # fmt: skip
