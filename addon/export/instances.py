# SPDX-License-Identifier: GPL-3.0-or-later
"""What the dependency graph shows: every appearance of a mesh or light, gathered with as little Python as possible.

Items of `object_instances` must not be kept, and are partly rewritten in place by the iterator: everything wanted of
them is read at once, and only datablocks that outlive the iteration are remembered.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array
from engine.scene.attribute_names import PARTICLE
from engine.scene.description import (
    VISIBLE_ALL,
    VISIBLE_CAMERA,
    VISIBLE_DIFFUSE,
    VISIBLE_GLOSSY,
    VISIBLE_RAYCAST,
    VISIBLE_SHADOW,
    VISIBLE_TRANSMISSION,
    VISIBLE_VOLUME,
)

from ..versions import read_setting
from .caustics import note_caustics
from .context import ExportContext
from .fast_gi import occlusion_distance
from .gases import Gas, gas_of
from .hashes import lookup3
from .instance_attributes import PATH_LENGTH, InstanceAttributes, can_read_instances
from .materials import MaterialExporter
from .object_properties import NOTHING, Value, find_property
from .particle_hair import ParticleHair, hair_systems
from .particles import read_particles
from .shutter import VECTOR_STEPS, motion_step_count, uses_deform_motion
from .unsupported import notice_object

_RAY_VISIBILITY = (
    ("visible_camera", VISIBLE_CAMERA),
    ("visible_diffuse", VISIBLE_DIFFUSE),
    ("visible_glossy", VISIBLE_GLOSSY),
    ("visible_transmission", VISIBLE_TRANSMISSION),
    ("visible_volume_scatter", VISIBLE_VOLUME),
    ("visible_shadow", VISIBLE_SHADOW),
)

#: Object types nothing is made of yet. Curves, text, surfaces and metaballs appear a second time, as meshes.
_UNSUPPORTED = {
    "POINTCLOUD": "Gaussian splats are",
    "GPENCIL": "grease pencil is",
    "GREASEPENCIL": "grease pencil is",
}


def _rounds_of(shown: bpy.types.Object) -> Any | None:
    """Curves or points of an evaluated object, None: it has none."""
    data = shown.data
    is_splat = getattr(data, "type", "") == "GAUSSIAN_SPLAT"  # From Blender 5.3 on.
    is_round = isinstance(data, (bpy.types.Curves, bpy.types.PointCloud)) and not is_splat
    return data if is_round else None


#: Appearances between two questions whether to stop.
_CANCEL_INTERVAL = 4096

#: Data, object or its address, instancer, whether the object itself is shown.
Key = tuple[Any, Any, Any, bool]


@dataclass
class Appearance:
    """What all instances of one object by one instancer have in common."""

    name: str
    #: Curves, points or hair to show.
    rounds: Any | None
    #: Mesh to show, None for lights and all that has another field.
    mesh: bpy.types.Mesh | None
    #: Simulated smoke and fire to show.
    gas: Gas | None
    #: Volume to show.
    volume: bpy.types.Volume | None
    #: Light object to show, None for meshes.
    light: bpy.types.Object | None
    #: The object whose evaluation made the mesh.
    owner: bpy.types.Object
    visibility: int
    pass_index: int
    color: tuple[float, ...]
    is_holdout: bool
    #: Shadow Terminator Geometry Offset.
    terminator_offset: float
    #: Shadow Terminator Shading Offset.
    shading_offset: float
    occlusion_distance: float
    is_instance: bool
    #: Index into the view layer's light groups, -1 = none.
    light_group: int
    is_shadow_catcher: bool
    #: Indices into the exported materials, one a slot.
    materials: tuple[int, ...]
    #: Values of properties that materials read, by the names the engine has for them.
    properties: dict[str, Value] = field(default_factory=dict)
    #: Those of them that attributes of instances come before.
    of_instances: tuple[str, ...] = ()
    #: What makes the instances, None for objects that are none.
    instancer: bpy.types.Object | None = None
    #: Names of the mesh's vertex groups.
    vertex_groups: tuple[str, ...] = ()
    #: Times of the shutter it is looked at, 0 if it is not blurred.
    motion_step_count: int = 0
    use_deform_motion: bool = False
    is_particle: bool = False
    #: Name of the topmost parent.
    asset: str = ""


@dataclass
class Appearances:
    """Appearances and where each is seen, in the order of the dependency graph.

    Attributes
    ----------
    kinds : list of Appearance
    kind : int32 (N,)
        Row of `kinds`, -1 for what is not shown.
    transform : float32 (N, 4, 4)
    random : float32 (N,)
    generated : float32 (N, 3), uv : float32 (N, 2)
        Texture coordinates of the instancer, as Cycles scales them; zero where no material reads them.
    properties : dict of float32 (N, 4)
        What materials read of objects and instancers, by the names the engine has for it; zeros where none does.
    """

    kinds: list[Appearance] = field(default_factory=list)
    kind: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    transform: Float32Array = field(default_factory=lambda: np.zeros((0, 4, 4), np.float32))
    random: Float32Array = field(default_factory=lambda: np.zeros(0, np.float32))
    generated: Float32Array = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    uv: Float32Array = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    properties: dict[str, Float32Array] = field(default_factory=dict)
    #: int32 (N,), what Blender shows that as: hair is shown as what it grows on.
    item: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))


def gather_appearances(context: ExportContext, materials: MaterialExporter) -> Appearances:
    """Walk the instances of the dependency graph once for objects, then once for each array."""
    result = Appearances()
    rows: dict[Key, int] = {}
    #: Rows of `kinds` of what has a key, and of its hair.
    shown_as: list[int] = []
    hair_as: list[int] = []
    numbers: list[int] = []
    append = numbers.append
    countdown = 0
    for item in context.depsgraph.object_instances:
        if countdown == 0:
            context.check_cancel()
            countdown = _CANCEL_INTERVAL
        countdown -= 1
        # Datablocks as keys are compared by address, which costs half of asking for the addresses.
        source = item.instance_object
        key = (item.object.data, source or item.object.as_pointer(), item.parent, item.show_self)
        row = rows.get(key)
        if row is None:
            row = rows[key] = len(shown_as)
            shown_as.append(_classify(context, materials, item, result.kinds))
            hair_as.append(_classify_hair(context, materials, item, result.kinds))
        append(row)
    context.check_cancel()
    rows_of = np.array(numbers, np.int32)
    result.kind = np.array(shown_as, np.int32)[rows_of]
    _read_arrays(context, materials, result)
    _read_properties(context, result)
    _add_hair(result, np.array(hair_as, np.int32)[rows_of])
    return result


def _add_hair(result: Appearances, hair: np.ndarray) -> None:
    """Show each item's hair beside it; `hair` int32 (N,) are rows of `kinds`, -1 = none."""
    grown = np.flatnonzero(hair >= 0)
    result.item = np.concatenate([np.arange(len(hair)), grown])
    if not len(grown):
        return
    result.kind = np.concatenate([result.kind, hair[grown]])
    for name in ("transform", "random", "generated", "uv"):
        values = getattr(result, name)
        setattr(result, name, np.concatenate([values, values[grown]]))
    result.properties = {name: np.concatenate([values, values[grown]]) for name, values in result.properties.items()}


def is_invertible(transform: Float32Array) -> npt.NDArray[np.bool_]:
    """Whether transforms, float32 (N, 4, 4), are finite and flatten nothing."""
    with np.errstate(invalid="ignore", over="ignore"):
        a, b, c = (transform[:, :3, i].astype(np.float64) for i in range(3))
        determinant = np.einsum("ni,ni->n", a, np.cross(b, c))
        return np.isfinite(transform).all(axis=(1, 2)) & (determinant != 0.0)


def random_of_name(name: str) -> int:
    """Cycles' random number of an object that is no instance: a hash of its name."""
    text = 0
    for byte in name.encode():
        text = (text * 37 + byte) & 0xFFFFFFFF
    return int(lookup3(text))


def _classify(
    context: ExportContext,
    materials: MaterialExporter,
    item: bpy.types.DepsgraphObjectInstance,
    kinds: list[Appearance],
) -> int:
    """Decide what an object is shown as; append that to `kinds` and return its row, -1 for nothing."""
    shown = item.object
    if shown.data is None or not item.show_self:
        return -1
    return _describe(context, materials, item, _rounds_of(shown), kinds)


def _classify_hair(
    context: ExportContext, materials: MaterialExporter, item: bpy.types.DepsgraphObjectInstance,
    kinds: list[Appearance],
) -> int:
    """As `_classify`, for the hair that grows on an object."""
    shown = item.object
    if not item.show_particles or not isinstance(shown.data, bpy.types.Mesh) or not shown.particle_systems:
        return -1
    owner = item.instance_object if item.is_instance else shown.original.evaluated_get(context.depsgraph)
    if not hair_systems(owner, is_final=context.depsgraph.mode == "RENDER"):
        return -1
    return _describe(context, materials, item, ParticleHair(owner), kinds)


def _describe(
    context: ExportContext, materials: MaterialExporter, item: bpy.types.DepsgraphObjectInstance, rounds: Any | None,
    kinds: list[Appearance],
) -> int:
    """What `_classify` returns; `rounds` is what is shown of the object if that is neither its mesh nor a volume."""
    shown = item.object
    is_mesh = rounds is None and isinstance(shown.data, bpy.types.Mesh)
    is_volume = isinstance(shown.data, bpy.types.Volume)
    has_shape = is_mesh or is_volume or rounds is not None
    if not has_shape and shown.type != "LIGHT":
        if shown.type in _UNSUPPORTED:
            context.notice(shown.name, f"{_UNSUPPORTED[shown.type]} not supported", "left out of the picture")
        return -1
    if rounds is not None and not isinstance(rounds, bpy.types.PointCloud) and not context.view_layer.use_strand:
        return -1
    if is_mesh and not context.view_layer.use_solid or is_volume and not context.view_layer.use_volumes:
        return -1
    window = context.window
    if window is not None:
        if not window.is_shown(item.parent if item.is_instance else shown) or not (has_shape or window.use_lights):
            return -1
    owner = item.instance_object if item.is_instance else shown.original.evaluated_get(context.depsgraph)
    parent = item.parent if item.is_instance else shown
    visibility, is_holdout = _ray_visibility(shown), False
    if has_shape:
        if item.is_instance:
            visibility &= _ray_visibility(parent)
        is_holdout = parent.is_holdout or parent.holdout_get(view_layer=context.view_layer)
        if not is_holdout and parent.indirect_only_get(view_layer=context.view_layer):
            visibility &= ~VISIBLE_CAMERA
        if visibility == 0:
            return -1
    else:
        visibility &= VISIBLE_ALL
    gas = gas_of(shown) if is_mesh else None
    if gas is not None and not context.view_layer.use_volumes:
        return -1
    notice_object(context, shown)
    note_caustics(context, shown)
    slots = _slots(context, materials, shown) if has_shape else ()
    if is_volume or gas is not None:
        slots = tuple(materials.default_volume() if slot < 0 else slot for slot in slots)
    requests = [materials.requests[index] for index in slots if index >= 0]
    found = {name: find_property(item, name) for name in sorted(set().union(*(one.properties for one in requests)))}
    kinds.append(
        Appearance(
            name=shown.name,
            rounds=rounds,
            mesh=shown.data if is_mesh and gas is None else None,
            gas=None if gas is None else Gas(shown.data, gas),
            volume=shown.data if is_volume else None,
            light=None if has_shape else owner,
            owner=owner,
            visibility=visibility,
            pass_index=shown.pass_index,
            # The instancer's colour, which `shown` has only where Python had not met what is instanced.
            color=tuple(parent.color),
            is_holdout=is_holdout,
            terminator_offset=context.finite(
                read_setting(shown, "shadow_terminator_geometry_offset"), 0.0, shown.name, "Geometry Offset"
            ),
            shading_offset=context.finite(
                read_setting(shown, "shadow_terminator_shading_offset"), 0.0, shown.name, "Shading Offset"
            ),
            occlusion_distance=occlusion_distance(context, shown, parent),
            is_instance=item.is_instance,
            light_group=_light_group(context, shown, parent),
            is_shadow_catcher=has_shape and (shown.is_shadow_catcher or parent.is_shadow_catcher),
            materials=slots,
            properties={name: value for name, (value, _) in found.items()},
            of_instances=tuple(name for name, (_, comes_after) in found.items() if comes_after),
            instancer=item.parent if item.is_instance else None,
            # A Raycast node of a material that is met later may read one.
            vertex_groups=tuple(shown.vertex_groups.keys()) if is_mesh else (),
        )
    )
    _set_motion(context, kinds[-1], item, parent)
    if context.wants_assets:
        kinds[-1].asset = _topmost(shown).name
    return len(kinds) - 1


def _set_motion(
    context: ExportContext, kind: Appearance, item: bpy.types.DepsgraphObjectInstance, parent: bpy.types.Object
) -> None:
    """Say when an object is looked at, if it may move."""
    if context.is_blurred:
        kind.motion_step_count = motion_step_count(item.object, parent)
        kind.use_deform_motion = uses_deform_motion(item.object, parent)
        kind.is_particle = item.particle_system is not None
    elif context.wants_vectors:
        # As Cycles: the frames before and after, whatever is blurred.
        kind.motion_step_count = VECTOR_STEPS
        kind.use_deform_motion = True


def _topmost(shown: bpy.types.Object) -> bpy.types.Object:
    while shown.parent is not None:
        shown = shown.parent
    return shown


def _light_group(context: ExportContext, shown: bpy.types.Object, parent: bpy.types.Object) -> int:
    """The light group of an object; an instance that has none is in that of what instances it, as in Cycles."""
    return context.light_group(shown if shown.lightgroup else parent)


def _ray_visibility(shown: bpy.types.Object) -> int:
    visibility = 0
    for name, bit in _RAY_VISIBILITY:
        if getattr(shown, name):
            visibility |= bit
    # Before there was a switch, whatever is there at all was met.
    meets_raycast = read_setting(shown, "visible_raycast")
    if visibility != 0 if meets_raycast is None else meets_raycast:
        visibility |= VISIBLE_RAYCAST
    return visibility


def _slots(context: ExportContext, materials: MaterialExporter, shown: bpy.types.Object) -> tuple[int, ...]:
    override = context.view_layer.material_override
    if override is not None:
        override = override.evaluated_get(context.depsgraph)
        return (materials.index_of(override, shown.name),) * max(len(shown.material_slots), 1)
    return tuple(materials.index_of(slot.material, shown.name) for slot in shown.material_slots) or (-1,)


def _read_arrays(context: ExportContext, materials: MaterialExporter, result: Appearances) -> None:
    """Per-instance values, each in one call."""
    count = len(result.kind)
    instances = context.depsgraph.object_instances
    matrices = np.empty(count * 16, np.float32)
    identifiers = np.zeros(count, np.int32)
    result.generated = np.zeros((count, 3), np.float32)
    result.uv = np.zeros((count, 2), np.float32)
    instances.foreach_get("matrix_world", matrices)
    # Blender stores columns.
    result.transform = matrices.reshape(count, 4, 4).transpose(0, 2, 1)
    if any(kind.is_instance for kind in result.kinds):
        instances.foreach_get("random_id", identifiers)
        context.check_cancel()
        if any(request.instancer for request in materials.requests):
            orco = np.empty(count * 3, np.float32)
            instances.foreach_get("orco", orco)
            is_instance = np.zeros(len(result.kinds) + 1, bool)
            is_instance[:-1] = [kind.is_instance for kind in result.kinds]
            mask = is_instance[result.kind]
            result.generated[mask] = 0.5 * orco.reshape(count, 3)[mask] - 0.5
            uv = np.empty(count * 2, np.float32)
            instances.foreach_get("uv", uv)
            result.uv[mask] = uv.reshape(count, 2)[mask]
    numbers = identifiers.view(np.uint32)
    named = np.array([not kind.is_instance for kind in result.kinds] + [False], bool)[result.kind]
    hashes = [0 if kind.is_instance else random_of_name(kind.name) for kind in result.kinds]
    numbers[named] = np.array([*hashes, 0], np.uint32)[result.kind[named]]
    # 2^-32 as Cycles; its largest value, one, is just outside our interval.
    result.random = np.minimum(numbers.astype(np.float32) * np.float32(2.0**-32), np.float32(1.0 - 2.0**-24))


def _read_properties(context: ExportContext, result: Appearances) -> None:
    """What materials read of each instance: of its object or instancer, or before that what geometry nodes gave it."""
    kinds = result.kinds
    of_particles = sorted({name for kind in kinds for name in kind.properties if name.startswith(PARTICLE)})
    if of_particles:
        reads = np.array([any(name in kind.properties for name in of_particles) for kind in kinds] + [False])
        result.properties |= read_particles(context, reads[result.kind], of_particles)
    for name in sorted({name for kind in kinds for name in kind.properties} - set(of_particles)):
        of_kinds = np.array([*(kind.properties.get(name, NOTHING) for kind in kinds), NOTHING], np.float32)
        result.properties[name] = of_kinds[result.kind]
    makers = {kind.instancer.as_pointer(): kind.instancer for kind in kinds if kind.of_instances and kind.instancer}
    if not makers:
        return
    if not can_read_instances():
        for kind in kinds:
            for name in kind.of_instances:
                _notice_instances(context, kind.name, name)
        return
    paths = np.empty(len(result.kind) * PATH_LENGTH, np.int32)
    context.depsgraph.object_instances.foreach_get("persistent_id", paths)
    # What is not shown has identifiers too: where numbers are drawn their order counts.
    made_by = [0 if kind.instancer is None else kind.instancer.as_pointer() for kind in kinds]
    maker_of = np.array([*made_by, 0], np.uint64)[result.kind]
    for address, maker in makers.items():
        context.check_cancel()
        items = np.flatnonzero(maker_of == address)
        mine = [kind for kind, made in zip(kinds, made_by, strict=True) if made == address]
        names = sorted({name for kind in mine for name in kind.of_instances})
        read = InstanceAttributes(
            maker, paths.reshape(-1, PATH_LENGTH)[items], [name.partition(":")[2] for name in names],
            is_final=context.depsgraph.mode == "RENDER",
        )  # fmt: skip
        for name in names:
            comes_after = np.array([name in kind.of_instances for kind in kinds] + [False])[result.kind[items]]
            values, has = read.values[name.partition(":")[2]]
            has &= comes_after
            result.properties[name][items[has]] = values[has]
            if (read.is_lost & comes_after & ~has).any():
                _notice_instances(context, maker.name, name)


def _notice_instances(context: ExportContext, subject: str, name: str) -> None:
    attribute = name.partition(":")[2]
    problem = f"attribute {attribute!r} of geometry nodes' instances cannot be read"
    context.notice(subject, problem, "that of the object")
