# SPDX-License-Identifier: GPL-3.0-or-later
"""Puts the parts of a `SceneDescription` together."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np

from engine.scene.description import Camera, Frame, Instances, Light, Mesh, Portal, SceneDescription

from .applied_transforms import move_normals
from .camera import export_camera, export_frame, find_camera, in_middle
from .caustics import asks_for_caustics
from .colorspaces import blender_to_xyz, working_space
from .context import ExportCache, ExportContext, Window
from .culling import cull, culls, view_of_render
from .fast_gi import export_fast_gi
from .gases import export_gas
from .geometry import export_mesh
from .images import ImageExporter
from .instances import Appearance, Appearances, gather_appearances, is_invertible
from .lights import LightExporter
from .linking import export_linking
from .materials import AttributeRequest, MaterialExporter
from .motion import add_motion
from .nodes import GraphExporter
from .particle_hair import ParticleHair
from .pass_motion import find_pass_motion
from .pass_settings import export_pass_settings, read_requests
from .rounds import export_rounds
from .shutter import Clock, Shutter, read_rolling_shutter, read_shutter, read_shutter_curve
from .studio_light import export_studio_light
from .subdivision import cap_levels, dice_in_window
from .unsupported import notice_scene
from .volumes import export_volume, medium_density
from .world import export_world


def export_scene(
    depsgraph: bpy.types.Depsgraph,
    *,
    engine: bpy.types.RenderEngine | None = None,
    view_layer: bpy.types.ViewLayer | None = None,
    cache: ExportCache | None = None,
    should_cancel: Callable[[], bool] | None = None,
    window: Window | None = None,
    updated: frozenset[int] | None = None,
    texture_memory: int | None = None,
    bakes: bool = False,
) -> SceneDescription:
    """Describe what `depsgraph` shows.

    Parameters
    ----------
    engine : RenderEngine, optional
        Asked for the camera's matrix and shift where there is one.
    view_layer : ViewLayer, optional
        Evaluated; the dependency graph's own by default.
    cache : ExportCache, optional
        Kept by the caller between frames: what did not change comes back as the same object with the same key.
    should_cancel : callable, optional
        Asked often.
    window : Window, optional
        What a window shows, without motion blur, as Cycles has it; camera and frame are the window's business.
    updated : frozenset of int, optional
        For a window: addresses of all original datablocks that may have changed since the last export with `cache`.
    texture_memory : int, optional
        Memory for pixels of images, before they lie in files [bytes]; None: all that they need.
    bakes : bool
        Whether places on a mesh are looked at, which needs no camera. Meshes are then as Blender hands them to a bake:
        not diced, and without motion blur. Nothing is culled.

    Raises
    ------
    ValueError
        If the scene has no camera, and neither a window nor a bake asks; if images fit neither into memory nor onto the
        disk.
    ExportCancelled
        Once `should_cancel()` is true.
    """
    cache = ExportCache() if cache is None else cache
    context = ExportContext(
        depsgraph=depsgraph,
        scene=depsgraph.scene_eval,
        view_layer=view_layer or depsgraph.view_layer_eval,
        engine=engine,
        cache=cache,
        should_cancel=should_cancel,
        window=window,
        texture_memory=texture_memory,
        bakes=bakes,
    )
    shutter = read_shutter(context) if window is None and not bakes else None
    context.is_blurred = shutter is not None
    if window is not None:
        context.updated = updated
    elif not bakes:
        read_requests(context)
        if shutter is None:
            context.updated = _updated_datablocks(depsgraph, engine, cache)
    cache.begin()
    clock = Clock(context)
    try:
        description = _describe(context, clock, shutter)
    finally:
        clock.restore()
    # Going to other times flags whatever is animated: what the next export is told says nothing about this one.
    has_moved = shutter is not None or context.wants_vectors
    cache.finish(0 if has_moved else depsgraph.as_pointer())
    return description


def _describe(context: ExportContext, clock: Clock, shutter: Shutter | None) -> SceneDescription:
    context.check_cancel()
    frame_current = context.scene.frame_current + context.scene.frame_subframe
    camera_object = find_camera(context) if context.needs_camera else None
    camera = Camera() if camera_object is None else export_camera(context, camera_object)
    to_xyz = _set_working_space(context)
    images = ImageExporter(context)
    graphs = GraphExporter(context, images)
    materials = MaterialExporter(context, graphs, images)
    studio = None if context.window is None else context.window.studio
    world = export_world(context, graphs) if studio is None else export_studio_light(context, images, studio)
    frame = export_frame(context) if context.window is None else Frame(1, 1, (0, 0, 1, 1))
    if camera_object is not None and not context.bakes:
        cap_levels(context, camera_object, frame)
    elif context.window is not None:
        dice_in_window(context, context.window)
    curve, rolling = None, 1.0
    if shutter is not None and camera_object is not None:
        curve, rolling = read_shutter_curve(context.scene.render), read_rolling_shutter(context.scene)
        if shutter.centre != shutter.frame:
            # As Cycles: materials, world and most of the camera are those of the frame itself, everything else is that
            # of the middle of the shutter.
            gather_appearances(context, materials)
            clock.go_to(shutter.centre)
            camera = in_middle(camera, export_camera(context, camera_object))
    appearances = gather_appearances(context, materials)
    if culls(context.scene) and not context.bakes:
        if camera_object is not None:
            cull(context, view_of_render(context, camera_object, frame), appearances)
        elif context.window is not None and context.window.culling_view is not None:
            cull(context, context.window.culling_view, appearances)
    meshes, instances, chosen = _export_instances(context, materials, appearances)
    mesh_of = instances.mesh
    lights, lamps, portals = _export_lights(context, graphs, appearances)
    if world is not None and studio is None:
        world.portals = portals
    images.close()
    notice_scene(context)
    description = SceneDescription(
        camera=camera,
        frame=frame,
        meshes=meshes,
        instances=instances,
        materials=materials.materials,
        images=images.images,
        lights=lights,
        world=world,
        working_space=context.working_space,
        to_xyz=to_xyz,
        frame_current=frame_current,
        shutter=None if shutter is None else (shutter.time(-1.0), shutter.time(1.0)),
        shutter_curve=curve,
        rolling_shutter_duration=rolling,
        passes=export_pass_settings(context),
        light_groups=context.light_groups,
        fast_gi=export_fast_gi(context),
        asks_for_caustics=asks_for_caustics(context),
        linking=export_linking(context, appearances.kinds, appearances.kind[chosen], lamps),
    )
    if context.wants_vectors:
        description.passes.motion = find_pass_motion(context, description, appearances, chosen, camera_object)
    if shutter is not None and camera_object is not None:
        add_motion(context, clock, shutter, description, appearances, chosen, camera_object)
    move_normals(context, description, appearances.kinds, mesh_of, appearances.kind[chosen])
    description.notices = context.notices
    return description


def _updated_datablocks(
    depsgraph: bpy.types.Depsgraph, engine: bpy.types.RenderEngine | None, cache: ExportCache
) -> frozenset[int] | None:
    """Addresses of original datablocks changed since the last export, None if Blender cannot tell.

    Only a dependency graph that a render kept from frame to frame has flags worth trusting: they are cleared when the
    engine is done, and nowhere else.
    """
    if engine is None or cache.depsgraph != depsgraph.as_pointer():
        return None
    if not depsgraph.scene.render.use_persistent_data:
        return None
    return frozenset(update.id.original.as_pointer() for update in depsgraph.updates)


def _set_working_space(context: ExportContext) -> np.ndarray | None:
    """Take over the file's working space; returns its matrix to XYZ, None for Rec.709."""
    settings = getattr(bpy.data, "colorspace", None)
    if settings is None:
        return None
    name = settings.working_space
    known = working_space(name)
    if known is None:
        # The one of a user's own configuration of OpenColorIO: Blender converts images to it.
        context.working_space = name
        return blender_to_xyz()
    context.working_space, to_xyz = known
    return to_xyz


def _address_of_shape(kind: Appearance) -> int:
    """What tells apart what appearances show; 0 = nothing that has a shape."""
    if isinstance(kind.rounds, ParticleHair):
        return -kind.rounds.owner.as_pointer()
    shape = kind.gas.mesh if kind.gas is not None else kind.mesh or kind.volume or kind.rounds
    return 0 if shape is None else shape.as_pointer()


def _export_meshes(
    context: ExportContext, materials: MaterialExporter, kinds: list[Appearance]
) -> tuple[list[Mesh], list[int]]:
    """Meshes, and for each of `kinds` the number of its own, -1 = none."""
    # One mesh serves all its instances: it carries what any of their materials asks for.
    requests: dict[int, AttributeRequest] = {}
    of_all = AttributeRequest(frozenset().union(*(one.elsewhere for one in materials.requests)))
    addresses = [_address_of_shape(kind) for kind in kinds]
    for address, kind in zip(addresses, kinds, strict=True):
        request = requests.get(address, of_all)
        for index in kind.materials:
            if index >= 0:
                request |= materials.requests[index]
        requests[address] = request

    meshes: list[Mesh] = []
    exported: dict[int, Mesh | None] = {0: None}
    rows: dict[int, int] = {}
    mesh_of_kind: list[int] = []
    for address, kind in zip(addresses, kinds, strict=True):
        if address not in exported:
            context.check_cancel()
            if kind.volume is not None:
                exported[address] = export_volume(
                    context, kind.volume, kind.owner, requests[address], is_blurred=kind.motion_step_count > 0
                )
            elif kind.gas is not None:
                exported[address] = export_gas(
                    context, kind.gas, kind.owner, requests[address], is_blurred=kind.motion_step_count > 0
                )
            elif kind.rounds is not None:
                exported[address] = export_rounds(context, kind.rounds, kind.owner, requests[address])
            elif kind.mesh is not None:
                exported[address] = export_mesh(
                    context, kind.mesh, kind.owner, requests[address], kind.vertex_groups
                )
        mesh = exported[address]
        if mesh is None:
            rows[address] = -1
        elif address not in rows:
            rows[address] = len(meshes)
            meshes.append(mesh)
        mesh_of_kind.append(rows[address])
    return meshes, mesh_of_kind


def _export_instances(
    context: ExportContext, materials: MaterialExporter, appearances: Appearances
) -> tuple[list[Mesh], Instances, np.ndarray]:
    """Meshes, instances, and the rows of `appearances` that these are."""
    kinds = appearances.kinds
    meshes, mesh_of_kind = _export_meshes(context, materials, kinds)
    slots: list[int] = []
    kind_mesh = np.array([*mesh_of_kind, -1], np.int32)
    kind_offset = np.zeros(len(kinds) + 1, np.int32)
    for row, kind in enumerate(kinds):
        if kind_mesh[row] < 0:
            continue
        kind_offset[row] = len(slots)
        slots.extend(kind.materials)
        # A face's slot beyond the object's last is its last.
        needed = int(meshes[kind_mesh[row]].material_slots.max()) + 1
        slots.extend([kind.materials[-1]] * (needed - len(kind.materials)))

    chosen = np.flatnonzero(kind_mesh[appearances.kind] >= 0)
    transform = np.ascontiguousarray(appearances.transform[chosen])
    chosen, transform = _drop_broken(context, appearances, chosen, transform)
    kind_of = appearances.kind[chosen]
    names = [kind.name for kind in kinds]

    def column(values: list, dtype: type, width: int = 0) -> np.ndarray:
        shape = (len(kinds), width) if width else (len(kinds),)
        return np.array(values, dtype).reshape(shape)[kind_of]

    instances = Instances(
        mesh=kind_mesh[kind_of],
        transform=transform,
        material_offset=kind_offset[kind_of],
        materials=np.array(slots, np.int32),
        visibility=column([kind.visibility for kind in kinds], np.uint32),
        pass_index=column([kind.pass_index for kind in kinds], np.int32),
        random=appearances.random[chosen],
        color=column([kind.color for kind in kinds], np.float32, 4),
        is_holdout=column([kind.is_holdout for kind in kinds], np.bool_),
        name=[names[row] for row in kind_of.tolist()],
        dupli_generated=appearances.generated[chosen],
        dupli_uv=appearances.uv[chosen],
        terminator_offset=column([kind.terminator_offset for kind in kinds], np.float32),
        shading_offset=column([kind.shading_offset for kind in kinds], np.float32),
        occlusion_distance=column([kind.occlusion_distance for kind in kinds], np.float32),
        medium_density=_medium_density(kinds, kind_of, transform),
        is_shadow_catcher=column([kind.is_shadow_catcher for kind in kinds], np.bool_),
        asset=[kinds[row].asset for row in kind_of.tolist()] if context.wants_assets else None,
        light_group=column([kind.light_group for kind in kinds], np.int32) if context.light_groups else None,
        properties={name: values[chosen] for name, values in appearances.properties.items()},
    )
    return meshes, instances, chosen


def _medium_density(kinds: list[Appearance], kind_of: np.ndarray, transform: np.ndarray) -> np.ndarray | None:
    """`Instances.medium_density`."""
    factors = None
    for row, kind in enumerate(kinds):
        if kind.volume is not None:
            factors = np.ones(len(kind_of), np.float32) if factors is None else factors
            mine = kind_of == row
            factors[mine] = medium_density(kind.volume, transform[mine])
    return factors


def _drop_broken(
    context: ExportContext, appearances: Appearances, chosen: np.ndarray, transform: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Leave out instances whose transform cannot be inverted; Cycles shows nothing of them either."""
    is_good = is_invertible(transform)
    if is_good.all():
        return chosen, transform
    for row in np.unique(appearances.kind[chosen[~is_good]]).tolist():
        name = appearances.kinds[row].name
        context.notice(name, "has a transform that is not finite or flattens it (zero scale)", "left out")
    return chosen[is_good], transform[is_good]


def _export_lights(
    context: ExportContext, graphs: GraphExporter, appearances: Appearances
) -> tuple[list[Light], list[Appearance], list[Portal]]:
    """Lights, what each is an appearance of, and light portals."""
    lights: list[Light] = []
    lamps: list[Appearance] = []
    exporter = LightExporter(context, graphs)
    is_light = np.array([kind.light is not None for kind in appearances.kinds] + [False], bool)
    counts: dict[str, int] = {}
    for item in np.flatnonzero(is_light[appearances.kind]).tolist():
        kind = appearances.kinds[appearances.kind[item]]
        if kind.light is None:
            continue
        context.check_cancel()
        number = counts[kind.light.name_full] = counts.get(kind.light.name_full, -1) + 1
        transform = np.ascontiguousarray(appearances.transform[item])
        if not np.isfinite(transform).all():
            context.notice(kind.name, "has a transform that is not finite", "left out")
            continue
        light = exporter.export(
            kind.light,
            transform,
            kind.visibility,
            kind.light_group,
            float(appearances.random[item]),
            (kind.light.name_full, number),
        )
        if light is not None:
            lights.append(light)
            lamps.append(kind)
    return lights, lamps, exporter.portals
