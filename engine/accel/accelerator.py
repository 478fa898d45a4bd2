# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene's acceleration structure: of two levels, over arrays whose memory it shares."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from engine.accel.flattened import are_flattened, attach_flattened
from engine.accel.geometry_calls import (
    FORMAT_FLOAT3X4_ROW_MAJOR,
    GEOMETRY_INSTANCE,
    attach,
    commit,
    new_geometry,
    release,
    set_instanced_scene,
    set_mask,
    set_time_steps,
    set_transform,
)
from engine.accel.hierarchies import Device, EmbreeScene, MeshHierarchies
from engine.accel.library import embree
from engine.accel.masks import CATCHER_MASK_SHIFT, MASK_MEDIUM, MASK_SHADOW_TRANSPARENT
from engine.accel.ray_words import NONE
from engine.runtime.jit import kernel
from engine.state.geometry import (
    INSTANCE_FIRST_KEY,
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAG_CATCHER,
    INSTANCE_FLAGS,
    INSTANCE_KEY_COUNT,
    INSTANCE_MESH,
    INSTANCE_VISIBILITY,
    MESH_TRIANGLE_COUNT,
    GeometryArrays,
)

_TRANSFORM_BYTES = 48
#: Up to this share of a scene's triangles, transparent casters of shadows get a hierarchy of their own.
_LARGEST_TRANSPARENT_SHARE = 0.05

_IDENTITY = np.eye(3, 4, dtype=np.float32)


@dataclass
class Accelerator:
    """Embree scenes over `GeometryArrays`, whose buffers they share.

    Attributes
    ----------
    top : EmbreeScene
        Triangles that are stored in world space or flattened (`flattened.py`), and instances of other meshes.
    meshes : list of EmbreeScene
        Hierarchies of the instanced meshes, and of what stands still, where that is not in `top`.
    transparent : EmbreeScene
        What shadow rays can pass once more, by itself, if it is a small part; else `top`.
    masks : uint32 (I,)
        By which rays each instance is found.
    """

    top: EmbreeScene
    meshes: list[EmbreeScene]
    transparent: EmbreeScene
    masks: np.ndarray

    @property
    def handle(self) -> int:
        """The top-level scene's address, for kernels; valid as long as this object lives."""
        return self.top.address

    @property
    def transparent_handle(self) -> int:
        """The address of `transparent`, which may be `handle`."""
        return self.transparent.address

    @property
    def mask_handle(self) -> int:
        """The address of `masks`."""
        return int(self.masks.ctypes.data)


@kernel
def _attach_instances(device, top, indices, scenes, transforms, key_counts, masks):
    """Attach instance geometries; scenes and transforms, intp (K,), are addresses, of so many keys in a row."""
    for k in range(indices.shape[0]):
        handle = new_geometry(device, np.int32(GEOMETRY_INSTANCE))
        set_instanced_scene(handle, scenes[k])
        set_time_steps(handle, np.uint32(key_counts[k]))
        for key in range(key_counts[k]):
            address = transforms[k] + key * _TRANSFORM_BYTES
            set_transform(handle, np.uint32(key), np.int32(FORMAT_FLOAT3X4_ROW_MAJOR), address)
        set_mask(handle, masks[k])
        commit(handle)
        attach(top, handle, np.uint32(indices[k]))
        release(handle)


def _attach_standing(
    scene: EmbreeScene, geometry: GeometryArrays, rows: np.ndarray, masks: np.ndarray
) -> None:
    """Attach meshes that are stored in world space; `rows` are their instances, and their ids."""
    for index in rows.tolist():
        mesh, mask = int(geometry.instance_table[index, INSTANCE_MESH]), int(masks[index])
        scene.add(geometry, mesh, index, mask, is_filtered=mask & (MASK_SHADOW_TRANSPARENT | MASK_MEDIUM) != 0)


def build_standing(
    device: Device, geometry: GeometryArrays, rows: np.ndarray, masks: np.ndarray
) -> EmbreeScene:
    """A hierarchy of triangles that are stored in world space; `rows` are their instances, and their ids."""
    scene = EmbreeScene(device, geometry)
    _attach_standing(scene, geometry, rows, masks)
    embree.rtcCommitScene(scene.address)
    return scene


def _attach_moved(
    device: Device, scene: EmbreeScene, geometry: GeometryArrays, rows: np.ndarray, masks: np.ndarray,
    addresses: np.ndarray,
) -> None:
    """Attach instances of meshes; `rows` are their ids, and `addresses` the hierarchies of all meshes."""
    if not len(rows):
        return
    table = geometry.instance_table
    key_counts = table[rows, INSTANCE_KEY_COUNT].astype(np.int64)
    first_keys = table[rows, INSTANCE_FIRST_KEY].astype(np.int64)
    moving = geometry.motion_transforms.ctypes.data + first_keys * _TRANSFORM_BYTES
    standing = geometry.transforms.ctypes.data + rows * _TRANSFORM_BYTES
    _attach_instances(
        device.address, scene.address, rows, addresses[table[rows, INSTANCE_MESH]],
        np.where(key_counts > 0, moving, standing).astype(np.intp), np.maximum(key_counts, 1), masks[rows],
    )


def build_accelerator(
    geometry: GeometryArrays, shadow_masks: np.ndarray, hierarchies: MeshHierarchies,
    mesh_keys: Sequence[Hashable] | None = None, shapes_key: Hashable | None = None,
) -> Accelerator:
    """Build the two-level acceleration structure.

    Parameters
    ----------
    geometry : GeometryArrays
    shadow_masks : uint32 (I,)
        MASK_SHADOW_* bits of each instance (0 = casts no shadow); other mask bits come from its visibility.
    hierarchies : MeshHierarchies
        Those of instanced meshes are taken from here, or built and left here.
    mesh_keys : sequence of hashable (M,), optional
        Meshes of equal keys have the same shape, whenever they are built. None: each mesh is its own.
    shapes_key : hashable, optional
        Key of all triangles in world space. Given, they get a hierarchy of their own, which stays as long as the key
        and their masks do: builds are soon over then, and rays take a little longer. None: they are in the top level,
        and transparent casters of shadows, where they are few, in a second one besides.

    Raises
    ------
    MemoryError, RuntimeError
        When Embree reports an error.
    """
    device = hierarchies.device
    top = EmbreeScene(device, geometry)
    table = geometry.instance_table
    masks = (table[:, INSTANCE_VISIBILITY].astype(np.uint32) & np.uint32(31)) | shadow_masks.astype(np.uint32)
    is_catcher = (table[:, INSTANCE_FLAGS] & INSTANCE_FLAG_CATCHER) != 0
    masks |= np.where(is_catcher, masks << np.uint32(CATCHER_MASK_SHIFT), np.uint32(0))
    has_triangles = geometry.mesh_table[table[:, INSTANCE_MESH], MESH_TRIANGLE_COUNT] > 0
    wanted = has_triangles & (masks != 0)
    is_baked = (table[:, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED) != 0
    standing = np.flatnonzero(wanted & is_baked)
    meshes: list[EmbreeScene] = []
    if shapes_key is None:
        _attach_standing(top, geometry, standing, masks)
    elif len(standing):
        group = hierarchies.standing.get(
            (shapes_key, standing.tobytes(), table[standing, INSTANCE_MESH].tobytes(), masks[standing].tobytes()),
            lambda: build_standing(device, geometry, standing, masks),
        )
        meshes.append(group)
        _attach_instances(
            device.address, top.address, np.array([len(table)], np.int64), np.array([group.address], np.intp),
            np.array([_IDENTITY.ctypes.data], np.intp), np.ones(1, np.int64), np.array([NONE], np.uint32),
        )
    # What is moved often is attached anew each time: instances are attached sooner.
    is_flat = are_flattened(geometry, masks) if shapes_key is None else np.zeros(len(table), np.bool_)
    attach_flattened(device, top, geometry, np.flatnonzero(wanted & is_flat), masks)
    instanced = np.flatnonzero(wanted & ~is_baked & ~is_flat)
    addresses = np.zeros(len(geometry.mesh_table), np.intp)
    for mesh in np.unique(table[instanced, INSTANCE_MESH]).tolist():
        meshes.append(hierarchies.of(mesh if mesh_keys is None else mesh_keys[mesh], geometry, mesh))
        addresses[mesh] = meshes[-1].address
    _attach_moved(device, top, geometry, instanced, masks, addresses)
    embree.rtcCommitScene(top.address)
    transparent = top
    is_transparent = wanted & ((masks & np.uint32(MASK_SHADOW_TRANSPARENT)) != 0)
    sizes = geometry.mesh_table[table[:, INSTANCE_MESH], MESH_TRIANGLE_COUNT].astype(np.int64)
    is_small = 0 < sizes[is_transparent].sum() <= _LARGEST_TRANSPARENT_SHARE * sizes[wanted].sum()
    if is_small and shapes_key is None:
        transparent = EmbreeScene(device, geometry)
        _attach_standing(transparent, geometry, np.flatnonzero(is_transparent & is_baked), masks)
        attach_flattened(device, transparent, geometry, np.flatnonzero(is_transparent & is_flat), masks)
        moved = np.flatnonzero(is_transparent & ~is_baked & ~is_flat)
        _attach_moved(device, transparent, geometry, moved, masks, addresses)
        embree.rtcCommitScene(transparent.address)
    device.check()
    return Accelerator(top, meshes, transparent, masks)
