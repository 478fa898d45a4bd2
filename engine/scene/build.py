# SPDX-License-Identifier: GPL-3.0-or-later
"""Description to arrays: geometry, shader programs, lights, camera, acceleration structure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields

import numpy as np

from engine.accel import MASK_SHADOW_OPAQUE, MASK_SHADOW_TRANSPARENT, Accelerator, build_accelerator
from engine.kernels.bsdf import BsdfTables, load_tables
from engine.scene.arrays import (
    INSTANCE_MESH,
    INSTANCE_VISIBILITY,
    MESH_FIRST_TRIANGLE,
    MESH_TRIANGLE_COUNT,
    GeometryArrays,
)
from engine.scene.camera import CameraArrays, build_camera
from engine.scene.description import VISIBLE_SHADOW, Notice, SceneDescription
from engine.scene.geometry import build_geometry
from engine.scene.light_arrays import LightArrays
from engine.scene.lights import build_lights
from engine.scene.limits import check_frame
from engine.scene.programs import compile_scene
from engine.settings import RenderSettings
from engine.shaders.arrays import PROGRAM_FLAGS, PROGRAM_MAY_BE_TRANSPARENT, ShaderArrays


@dataclass
class Scene:
    """Everything kernels read, for one view layer at one frame."""

    description: SceneDescription
    camera: CameraArrays
    geometry: GeometryArrays
    shaders: ShaderArrays
    tables: BsdfTables
    lights: LightArrays
    accelerator: Accelerator
    #: Row of ShaderArrays.programs of the world, -1 = black.
    world_program: int
    has_transparent_shadows: bool
    notices: list[Notice] = field(default_factory=list)


class SceneCache:
    """What a session keeps between frames, keyed by the description's own keys."""

    def __init__(self) -> None:
        self.geometry_key: object = None
        self.geometry: GeometryArrays | None = None
        self.accelerator: Accelerator | None = None
        self.shadow_masks: np.ndarray | None = None
        self.geometry_notices: list[Notice] = []


def _geometry_key(description: SceneDescription, attribute_names: tuple[str, ...]) -> object:
    """What geometry depends on. Of instances that is every field but their names."""
    instances = description.instances
    columns = [getattr(instances, item.name) for item in fields(instances) if item.name not in ("name", "motion")]
    return (
        attribute_names,
        tuple(mesh.key for mesh in description.meshes),
        tuple(None if column is None else np.ascontiguousarray(column).tobytes() for column in columns),
        tuple((index, steps.tobytes()) for index, steps in sorted(instances.motion.items())),
    )


def _shadow_masks(geometry: GeometryArrays, shaders: ShaderArrays, description: SceneDescription) -> np.ndarray:
    """MASK_SHADOW_* of every instance: opaque unless one of its materials may let light through."""
    table = geometry.instance_table
    may_pass = (shaders.programs[:, PROGRAM_FLAGS] & PROGRAM_MAY_BE_TRANSPARENT) != 0
    for index, material in enumerate(description.materials):
        if not material.use_transparent_shadow:
            may_pass[index] = False
    instances = description.instances
    material_passes = may_pass[geometry.instance_materials] if len(geometry.instance_materials) else np.zeros(0, bool)
    masks = np.zeros(len(table), np.uint32)
    if len(table):
        starts = instances.material_offset.astype(np.int64)
        sums = np.concatenate([[0], np.cumsum(material_passes)])
        slot_counts = _slot_counts(geometry)[table[:, INSTANCE_MESH]]
        ends = np.minimum(starts + slot_counts, len(material_passes))
        has_passing = sums[ends] > sums[starts]
        casts = (table[:, INSTANCE_VISIBILITY] & VISIBLE_SHADOW) != 0
        masks[casts & ~has_passing] = MASK_SHADOW_OPAQUE
        masks[casts & has_passing] = MASK_SHADOW_TRANSPARENT
    return masks


def _slot_counts(geometry: GeometryArrays) -> np.ndarray:
    """Material slots each mesh uses, one at least."""
    counts = np.ones(len(geometry.mesh_table), np.int64)
    for mesh, row in enumerate(geometry.mesh_table):
        first, count = int(row[MESH_FIRST_TRIANGLE]), int(row[MESH_TRIANGLE_COUNT])
        if count:
            counts[mesh] = int(geometry.material_slots[first : first + count].max()) + 1
    return counts


def build_scene(
    description: SceneDescription,
    settings: RenderSettings,
    cache: SceneCache,
    *,
    threads: int = 0,
    check_cancel: Callable[[], None] = lambda: None,
) -> Scene:
    """Flatten a description and build what tracing needs.

    Parameters
    ----------
    description : SceneDescription
    settings : RenderSettings
        Pixel filter.
    cache : SceneCache
        Updated: geometry and its acceleration structure are kept while nothing in them changed.
    threads : int
        For Embree's build, 0 = all.
    check_cancel : callable
        Called between steps; what it raises ends the build.

    Raises
    ------
    ValueError
        Naming what cannot be rendered and what to do.
    """
    check_frame(description.frame)
    notices = list(description.notices)
    programs = compile_scene(description)
    notices += programs.notices
    # Programs ask for a mesh's default UV map and colour without knowing their names.
    defaults = {name for mesh in description.meshes for name in (mesh.default_uv, mesh.default_color) if name}
    attribute_names = (*programs.attribute_names, *sorted(defaults.difference(programs.attribute_names)))

    check_cancel()
    key = _geometry_key(description, attribute_names)
    if cache.geometry is None or cache.geometry_key != key:
        cache.accelerator = None
        geometry_notices: list[Notice] = []
        cache.geometry = build_geometry(description, attribute_names, geometry_notices)
        cache.geometry_notices = geometry_notices
        cache.geometry_key = key
    geometry = cache.geometry
    # Slots without a material render with the default program.
    materials = description.instances.materials
    materials = np.where(materials >= 0, materials, programs.default_program)
    geometry = geometry._replace(instance_materials=np.ascontiguousarray(materials, np.int32))
    notices += cache.geometry_notices

    check_cancel()
    shaders = programs.arrays
    masks = _shadow_masks(geometry, shaders, description)
    if cache.accelerator is None or cache.shadow_masks is None or not np.array_equal(cache.shadow_masks, masks):
        cache.accelerator = build_accelerator(geometry, masks, threads)
        cache.shadow_masks = masks
    check_cancel()
    tables = load_tables()
    background = programs.background_grid(geometry, tables)
    check_cancel()
    lights = build_lights(description, geometry, programs.program_info(), background, notices)
    return Scene(
        description=description,
        camera=build_camera(
            description.camera, description.frame, settings.pixel_filter, settings.filter_width,
            description.shutter_curve, description.rolling_shutter_duration,
        ),
        geometry=geometry,
        shaders=shaders,
        tables=tables,
        lights=lights,
        accelerator=cache.accelerator,
        world_program=programs.world_program,
        has_transparent_shadows=bool((masks == MASK_SHADOW_TRANSPARENT).any()),
        notices=notices,
    )
