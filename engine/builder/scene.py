# SPDX-License-Identifier: GPL-3.0-or-later
"""Description to arrays: geometry, shader programs, lights, camera, acceleration structure."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from engine.accel.accelerator import Accelerator, build_accelerator
from engine.accel.hierarchies import MeshHierarchies
from engine.accel.local_rays import LocalScenes, build_local_scenes
from engine.accel.masks import MASK_MEDIUM, MASK_RAYCAST, MASK_SHADOW_OPAQUE, MASK_SHADOW_TRANSPARENT
from engine.builder.bake import build_bake
from engine.builder.blockers import find_blockers
from engine.builder.boundaries import separate_boundaries, touching_boundaries
from engine.builder.camera import build_camera
from engine.builder.camera_spaces import camera_matrices
from engine.builder.casters import KeptCasters
from engine.builder.displacement import KeptDisplacements, displace_meshes
from engine.builder.emission import ProgramInfo
from engine.builder.environment import EnvironmentMap, build_environment_map, without_discs
from engine.builder.geometry import GeometryCache, build_geometry
from engine.builder.lamps import places_of_flat
from engine.builder.lights import build_lights
from engine.builder.majorants import KeptBounds
from engine.builder.marked_geometry import MarkedGeometry
from engine.builder.media import SceneMedia, build_media
from engine.builder.programs import Programs, compile_scene
from engine.builder.same_place import SamePlace, find_same_place
from engine.builder.sky_suns import find_sky_suns
from engine.kernels.bsdf import BsdfTables, load_tables
from engine.kernels.bsdf.linked_lobes import link_used
from engine.scene.attribute_names import UNDEFORMED
from engine.scene.content import Kept, Versions
from engine.scene.description import (
    VISIBLE_ALL,
    VISIBLE_RAYCAST,
    VISIBLE_SHADOW,
    Camera,
    Frame,
    Mesh,
    Notice,
    SceneDescription,
)
from engine.scene.digest import content_digest
from engine.scene.limits import check_frame, check_links, check_memory
from engine.settings import RenderSettings
from engine.shaders.program_cache import ProgramCache
from engine.spectral.wavelengths import WAVELENGTH_COUNT
from engine.state.bake import BakeArrays
from engine.state.camera import CameraArrays
from engine.state.geometry import (
    INSTANCE_FIRST_KEY,
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAG_IN_PLACE,
    INSTANCE_FLAGS,
    INSTANCE_KEY_COUNT,
    INSTANCE_MATERIAL_OFFSET,
    INSTANCE_MESH,
    INSTANCE_VISIBILITY,
    GeometryArrays,
)
from engine.state.lanes import RGB
from engine.state.lights import HEADER_SOURCES, LAMP_FLAG_IN_SURFACE, LAMP_FLAGS, LAMP_LIGHT, LightArrays
from engine.state.photons import CasterArrays
from engine.state.shaders import (
    PROGRAM_FLAGS,
    PROGRAM_HAS_PORTAL,
    PROGRAM_HAS_SUBSURFACE,
    PROGRAM_IS_BOUNDARY,
    PROGRAM_MAY_BE_TRANSPARENT,
    PROGRAM_TRACES,
    PROGRAM_TRACES_LOCALLY,
    ShaderArrays,
)

#: The columns of an instance on which hierarchies depend.
_ACCELERATOR_COLUMNS = [INSTANCE_MESH, INSTANCE_VISIBILITY, INSTANCE_FLAGS, INSTANCE_FIRST_KEY, INSTANCE_KEY_COUNT]


@dataclass
class Scene:
    """Everything kernels read, for one view layer at one frame."""

    description: SceneDescription
    camera: CameraArrays
    bake: BakeArrays
    geometry: GeometryArrays
    shaders: ShaderArrays
    tables: BsdfTables
    lights: LightArrays
    media: SceneMedia
    accelerator: Accelerator
    local_scenes: LocalScenes
    casters: CasterArrays
    #: Row of ShaderArrays.programs of the world, -1 = black.
    world_program: int
    has_transparent_shadows: bool
    has_subsurface: bool
    has_portals: bool
    #: Whether a material has nodes that trace rays.
    traces: bool
    notices: list[Notice] = field(default_factory=list)

    @property
    def has_catchers(self) -> bool:
        """Whether there are shadow catchers."""
        return self.description.instances.has_catchers


class SceneCache:
    """What a session keeps between frames: each step's newest result, by the content it was made from.

    Parameters
    ----------
    expects_moves : bool
        See `GeometryCache`.
    """

    def __init__(self, *, expects_moves: bool = False) -> None:
        self.programs = ProgramCache()
        self.geometry = GeometryCache(expects_moves=expects_moves)
        self.displacements = KeptDisplacements()
        self.placed_meshes = Versions()
        self.same_place: Kept[SamePlace] = Kept()
        self.marked_geometry = MarkedGeometry()
        self.boundaries: Kept[dict[int, float]] = Kept()
        self.media: Kept[SceneMedia] = Kept()
        self.local_scenes: Kept[LocalScenes] = Kept()
        self.bounds = KeptBounds()
        self.environment: Kept[EnvironmentMap | None] = Kept()
        self.lights: Kept[tuple[LightArrays, list[Notice]]] = Kept()
        self.camera: Kept[CameraArrays] = Kept()
        self.casters = KeptCasters()

    def give_up(self, meshes: Sequence[Mesh]) -> None:
        """Free the arrays of the newest description's meshes (`GeometryCache.give_up`), and what was made of them."""
        self.placed_meshes.forget()
        self.displacements.forget()
        self.geometry.give_up(meshes)


def _have_some(geometry: GeometryArrays, slot_counts: np.ndarray, programs: np.ndarray) -> np.ndarray:
    """Which instances have some of these programs, bool (M,) by program, among their materials: bool (I,)."""
    table, materials = geometry.instance_table, geometry.instance_materials
    sums = np.concatenate([[0], np.cumsum(programs[materials])]) if len(materials) else np.zeros(1, np.int64)
    starts = table[:, INSTANCE_MATERIAL_OFFSET].astype(np.int64)
    ends = np.minimum(starts + slot_counts[table[:, INSTANCE_MESH]], len(materials))
    has: np.ndarray = sums[ends] > sums[starts]
    return has


def _shadow_masks(
    geometry: GeometryArrays, slot_counts: np.ndarray, shaders: ShaderArrays, description: SceneDescription,
    media: SceneMedia, notices: list[Notice],
) -> np.ndarray:
    """MASK_SHADOW_* of every instance: opaque unless one of its materials may let light through.

    What has a medium inside has MASK_MEDIUM besides, and stops no light if it is nothing but the medium's boundary.
    """
    blockers = find_blockers(description.linking, has_catchers=description.instances.has_catchers)
    if blockers is not None:
        notices += blockers.notices
    table = geometry.instance_table
    flags = shaders.programs[:, PROGRAM_FLAGS]
    may_pass = (flags & PROGRAM_MAY_BE_TRANSPARENT) != 0
    for index, material in enumerate(description.materials):
        if not material.use_transparent_shadow and not flags[index] & PROGRAM_IS_BOUNDARY:
            may_pass[index] = False
    masks = np.zeros(len(table), np.uint32)
    if len(table):
        has_passing = _have_some(geometry, slot_counts, may_pass)
        casts = (table[:, INSTANCE_VISIBILITY] & VISIBLE_SHADOW) != 0
        masks[casts & ~has_passing] = MASK_SHADOW_OPAQUE
        masks[casts & has_passing] = MASK_SHADOW_TRANSPARENT
        masks[media.is_boundary] = 0
        if blockers is not None:
            masks[masks != 0] |= blockers.bits[masks != 0]
        masks[media.has_inside & (table[:, INSTANCE_VISIBILITY] & VISIBLE_ALL != 0)] |= MASK_MEDIUM
        masks[table[:, INSTANCE_VISIBILITY] & VISIBLE_RAYCAST != 0] |= MASK_RAYCAST
    return masks


def _find_same_place(cache: SceneCache, description: SceneDescription, geometry: GeometryArrays) -> SamePlace:
    """Where rays start and end in place: what is at hand where neither geometry nor lamps are others."""
    names = tuple(description.instances.name)
    kinds = np.array([(program.refracts, program.lets_through) for program in cache.programs.compiled], bool)
    is_glass, is_clear = (
        _have_some(geometry, cache.geometry.slot_counts, which) for which in kinds.reshape(-1, 2).T
    )
    lamps = content_digest(places_of_flat(description.lights))
    return cache.same_place.get(
        (cache.geometry.geometry.version, names, lamps, is_glass.tobytes(), is_clear.tobytes()),
        lambda: find_same_place(geometry, description.lights, names, is_glass, is_clear),
    )


def _build_accelerator(cache: GeometryCache, geometry: GeometryArrays, masks: np.ndarray, threads: int) -> Accelerator:
    """The hierarchies at hand where they are of the same shapes in the same places."""
    if cache.hierarchies is None or cache.hierarchies.threads != threads:
        cache.hierarchies = MeshHierarchies(threads)
        cache.accelerator.drop()
    hierarchies, keys = cache.hierarchies, cache.mesh_keys
    columns = geometry.instance_table[:, _ACCELERATOR_COLUMNS]
    # Where rays start in place decides only whether an instance is flattened.
    flags = columns[:, _ACCELERATOR_COLUMNS.index(INSTANCE_FLAGS)]
    flags[flags & INSTANCE_FLAG_BAKED != 0] &= ~INSTANCE_FLAG_IN_PLACE
    placed = (columns, geometry.transforms, geometry.motion_transforms, masks)
    if not cache.has_moved:
        hierarchies.standing.drop()
    accelerator = cache.accelerator.get(
        (cache.shapes.version, *(array.tobytes() for array in placed)),
        lambda: build_accelerator(
            geometry, masks, hierarchies, keys, cache.shapes.version if cache.has_moved else None
        ),
    )
    hierarchies.keep_only(keys)
    return accelerator


def _build_marked(
    cache: SceneCache, same_place: SamePlace, unmarked: GeometryArrays, masks: np.ndarray, threads: int,
    check_cancel: Callable[[], None],
) -> tuple[GeometryArrays, Accelerator]:
    """The geometry with the instances marked on which rays start and end in place, and the hierarchies."""
    return cache.marked_geometry.build(
        (cache.geometry.geometry.version, cache.same_place.version), same_place, unmarked, masks,
        lambda marked: _build_accelerator(cache.geometry, marked, masks, threads), check_cancel,
    )


def _have_flag(cache: SceneCache, geometry: GeometryArrays, shaders: ShaderArrays, flags: int) -> np.ndarray:
    """Which instances have a material whose program has some of the flags, bool (I,)."""
    programs = (shaders.programs[:, PROGRAM_FLAGS] & flags) != 0
    return _have_some(geometry, cache.geometry.slot_counts, programs)


def _facts(cache: SceneCache, geometry: GeometryArrays, shaders: ShaderArrays) -> dict[str, bool]:
    """What is so of a `Scene` where some instance has a material of that kind."""
    flags = {"has_subsurface": PROGRAM_HAS_SUBSURFACE, "has_portals": PROGRAM_HAS_PORTAL, "traces": PROGRAM_TRACES}
    return {name: bool(_have_flag(cache, geometry, shaders, flag).any()) for name, flag in flags.items()}


def _build_local_scenes(cache: SceneCache, geometry: GeometryArrays, shaders: ShaderArrays) -> LocalScenes:
    """Hierarchies of the instances that light goes into, or whose nodes look for themselves; those at hand if they are
    of the same shapes.
    """
    is_wanted = _have_flag(cache, geometry, shaders, PROGRAM_HAS_SUBSURFACE | PROGRAM_TRACES_LOCALLY)
    hierarchies, keys = cache.geometry.hierarchies, cache.geometry.mesh_keys
    assert hierarchies is not None
    columns = geometry.instance_table[:, [INSTANCE_MESH, INSTANCE_FLAGS]]
    return cache.local_scenes.get(
        (cache.geometry.shapes.version, hierarchies.threads, columns.tobytes(), is_wanted.tobytes()),
        lambda: build_local_scenes(geometry, hierarchies, keys, is_wanted),
    )


def _build_environment(
    cache: SceneCache, programs: Programs, geometry: GeometryArrays, tables: BsdfTables, threads: int
) -> EnvironmentMap | None:
    """The map by which the world is sampled: the one at hand while its program, and what that sees, is the same."""
    width = programs.background_width
    if not width:
        return cache.environment.get(None, lambda: None)
    program = cache.programs.compiled[programs.world_program]
    seen = programs.arrays.camera.tobytes() if program.sees_camera else b""
    return cache.environment.get(
        (program, cache.programs.images.version, width, seen),
        lambda: _map_environment(programs, width, geometry, tables, threads),
    )


def _map_environment(
    programs: Programs, width: int, geometry: GeometryArrays, tables: BsdfTables, threads: int
) -> EnvironmentMap:
    """The map of the world without the suns of its sky, which are sampled apart."""
    suns = find_sky_suns(programs.description.world)
    discs = suns.discs()
    grid = programs.background_grid(width, geometry, tables, threads)
    environment = build_environment_map(without_discs(grid, discs))
    if not len(discs):
        return environment
    points = suns.points()
    radiance = programs.background_radiance(points.reshape(-1, 3), geometry, tables)
    mean = radiance.reshape(len(discs), -1).mean(axis=1)
    shines = mean > 0.0
    return replace(environment, discs=discs[shines], disc_radiance=mean[shines])


def _build_lights(
    cache: SceneCache, description: SceneDescription, geometry: GeometryArrays, info: ProgramInfo,
    environment: EnvironmentMap | None, in_place: np.ndarray, media: SceneMedia,
) -> tuple[LightArrays, list[Notice]]:
    """Lights and what was found on the way: those at hand where nothing that emits, or has shape, is another."""

    def build() -> tuple[LightArrays, list[Notice]]:
        found: list[Notice] = []
        lights = build_lights(description, geometry, info, environment, found, media)
        lights.lamp_table[np.isin(lights.lamp_table[:, LAMP_LIGHT], in_place), LAMP_FLAGS] |= LAMP_FLAG_IN_SURFACE
        return lights, found

    world = description.world
    of_world = None if world is None else (
        world.visibility, world.max_bounces, world.cast_shadow, world.portals
    )
    emitting = content_digest((description.lights, of_world, info, description.linking))
    joins = () if description.linking is None else (media.has_inside.tobytes(), int(media.arrays.world[0]) >= 0)
    key = cache.geometry.geometry.version, cache.environment.version, emitting, in_place.tobytes(), joins
    lights, notices = cache.lights.get(key, build)
    if media.emits:
        # Paths find light where nothing else is.
        lights = lights._replace(header=lights.header.copy())
        lights.header[HEADER_SOURCES] = -1
    return lights, notices


def _attribute_names(description: SceneDescription, programs: Programs) -> tuple[str, ...]:
    """Attribute slots in the order the programs number them."""
    # Programs ask for a mesh's default UV map and colour without knowing their names, and for undeformed positions.
    defaults = {name for mesh in description.meshes for name in (mesh.default_uv, mesh.default_color) if name}
    if any(UNDEFORMED in mesh.attributes for mesh in description.meshes):
        defaults.add(UNDEFORMED)
    return (*programs.attribute_names, *sorted(defaults.difference(programs.attribute_names)))


def _displace(
    cache: SceneCache, description: SceneDescription, programs: Programs, attribute_names: Sequence[str],
    tables: BsdfTables, threads: int, check_cancel: Callable[[], None], notices: list[Notice],
) -> SceneDescription:
    """The description with its meshes divided, and where their materials move them."""
    if any(mesh.dicing is not None for mesh in description.meshes):
        description = replace(description, meshes=cache.displacements.diced(description.meshes, check_cancel))
        check_memory(description)
    compiled = cache.programs.compiled
    moving = [compiled[number] for number in programs.displacement_programs if number >= 0]
    seen = programs.arrays.camera.tobytes() if any(program.sees_camera for program in moving) else b""
    displaced, found = displace_meshes(
        description, programs, compiled, (cache.programs.images.version, seen), cache.displacements, tables,
        attribute_names=attribute_names, threads=threads or os.cpu_count() or 1, check_cancel=check_cancel,
    )  # fmt: skip
    notices += found
    return displaced


def _draw_apart(cache: SceneCache, description: SceneDescription) -> SceneDescription:
    """The description with boundaries of media drawn apart from what they touch."""
    compiled = cache.programs.compiled[: len(description.materials)]
    is_boundary = np.array([program.is_boundary and program.medium is not None for program in compiled], bool)
    instances = description.instances
    if not is_boundary[instances.materials[instances.materials >= 0]].any():
        return description
    columns = (instances.mesh, instances.transform, instances.material_offset, instances.materials)
    places = (cache.placed_meshes.of(description.meshes), *(column.tobytes() for column in columns))
    distances = cache.boundaries.get(
        (*places, is_boundary.tobytes()), lambda: touching_boundaries(description, is_boundary)
    )
    return separate_boundaries(description, distances)


def _build_media(
    cache: SceneCache, description: SceneDescription, programs: Programs, geometry: GeometryArrays, tables: BsdfTables
) -> SceneMedia:
    compiled = cache.programs.compiled
    inside = tuple((program.medium, program.is_boundary) for program in compiled)
    looked_up: tuple = ()
    if any(program.medium is not None and program.medium.varies for program in compiled):
        seen = programs.arrays.camera.tobytes() if any(program.sees_camera for program in compiled) else b""
        looked_up = (cache.programs.arrays.version, seen)
        cache.bounds.state = (cache.programs.images.version, seen)
    return cache.media.get(
        (content_digest(inside), programs.world_program, cache.geometry.geometry.version, looked_up),
        lambda: build_media(
            compiled, programs.world_program, geometry, cache.geometry.slot_counts, description.meshes,
            programs.arrays, tables, cache.bounds,
        ),
    )


def _build_camera(cache: SceneCache, description: SceneDescription, settings: RenderSettings) -> CameraArrays:
    seen_by = (
        description.camera, description.frame, settings.pixel_filter, settings.filter_width, description.shutter_curve,
        description.rolling_shutter_duration,
    )
    return cache.camera.get(content_digest(seen_by), lambda: build_camera(*seen_by))


def build_scene(
    description: SceneDescription,
    settings: RenderSettings,
    cache: SceneCache,
    *,
    threads: int = 0,
    check_cancel: Callable[[], None] = lambda: None,
    keeps_meshes: bool = True,
) -> Scene:
    """Flatten a description and build what tracing needs.

    Parameters
    ----------
    description : SceneDescription
    settings : RenderSettings
        Pixel filter.
    cache : SceneCache
        Updated: what has not changed is not built again, and comes as the same objects.
    threads : int
        For what more than one can do, 0 = all.
    check_cancel : callable
        Called between steps; what it raises ends the build.
    keeps_meshes : bool
        False: nothing is built after this, so the description's meshes lose their arrays as soon as they are copied.

    Raises
    ------
    ValueError
        Naming what cannot be rendered and what to do.
    """
    check_frame(description.frame)
    check_links(description)
    check_memory(description)
    programs = compile_scene(description, cache.programs)
    notices = [*description.notices, *programs.notices]
    attribute_names = _attribute_names(description, programs)
    check_cancel()
    tables = load_tables(description.to_xyz)
    link_used(WAVELENGTH_COUNT if settings.spectral == "ON" or description.has_dispersion else RGB)
    displaced = _displace(cache, description, programs, attribute_names, tables, threads, check_cancel, notices)
    apart = _draw_apart(cache, displaced)
    geometry = build_geometry(
        apart, attribute_names, notices, default_program=programs.default_program, cache=cache.geometry
    )
    bake = build_bake(description, geometry)
    same_place = _find_same_place(cache, description, geometry)
    notices += same_place.notices
    check_cancel()
    media, shaders = _build_media(cache, apart, programs, geometry, tables), programs.arrays
    if not keeps_meshes:
        # Media that vary have asked for the boxes of theirs.
        cache.give_up([*description.meshes, *displaced.meshes, *apart.meshes])
    del apart, displaced
    masks = _shadow_masks(geometry, cache.geometry.slot_counts, shaders, description, media, notices)
    with ThreadPoolExecutor(1, thread_name_prefix="environment") as pool:
        # At the same time: neither needs the other, and they are most of the work.
        begun = pool.submit(_build_environment, cache, programs, geometry, tables, threads or os.cpu_count() or 1)
        geometry, accelerator = _build_marked(cache, same_place, geometry, masks, threads, check_cancel)
        environment = begun.result()
    check_cancel()
    info = programs.program_info()
    lights, found = _build_lights(cache, description, geometry, info, environment, same_place.lights, media)
    notices += found
    return Scene(
        description=description,
        camera=_build_camera(cache, description, settings),
        bake=bake,
        geometry=geometry,
        shaders=shaders,
        tables=tables,
        lights=lights,
        media=media,
        accelerator=accelerator,
        local_scenes=_build_local_scenes(cache, geometry, shaders),
        casters=cache.casters.get(cache.geometry, cache.programs, geometry, lights, settings),
        world_program=programs.world_program,
        **_facts(cache, geometry, shaders),
        has_transparent_shadows=bool((masks & MASK_SHADOW_TRANSPARENT).any()),
        notices=notices,
    )


def look_at(
    scene: Scene, camera: Camera, frame: Frame, settings: RenderSettings, cache: SceneCache
) -> Scene | None:
    """The scene as another camera sees it, or in another frame; None where more than the camera depends on these.

    Parameters
    ----------
    scene : Scene
        The newest that was built with `cache`.
    settings, cache
        As `build_scene`.

    Raises
    ------
    ValueError
        As `build_scene`.
    """
    if any(program.sees_camera for program in cache.programs.compiled):
        return None
    check_frame(frame)
    description = replace(scene.description, camera=camera, frame=frame)
    # No program reads them: they are there for whoever compares.
    shaders = scene.shaders._replace(camera=camera_matrices(camera, frame))
    return replace(
        scene, description=description, camera=_build_camera(cache, description, settings), shaders=shaders
    )
