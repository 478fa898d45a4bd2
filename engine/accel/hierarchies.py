# SPDX-License-Identifier: GPL-3.0-or-later
"""Embree's device, its scenes, and meshes in them."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable, Iterable

import numpy as np

from engine.accel.geometry_calls import (
    BUFFER_INDEX,
    BUFFER_VERTEX,
    FORMAT_FLOAT3,
    FORMAT_UINT3,
    GEOMETRY_TRIANGLE,
)
from engine.accel.library import embree
from engine.accel.rounds import round_geometry
from engine.scene.content import Kept
from engine.state.geometry import (
    MESH_FIRST_TRIANGLE,
    MESH_FIRST_VERTEX,
    MESH_MOTION,
    MESH_SHAPE,
    MESH_TRIANGLE_COUNT,
    MESH_VERTEX_COUNT,
    MOTION_FIRST_VERTEX,
    MOTION_STEP_COUNT,
    SHAPE_SPHERES,
    SHAPE_TRIANGLES,
    GeometryArrays,
)

# Embree 4 API constants (rtcore headers).
_SCENE_COMPACT = 1 << 1
_SCENE_ROBUST = 1 << 2
_BUILD_QUALITY_HIGH = 2
_DEVICE_PROPERTY_RAY_MASK = 64
_DEVICE_PROPERTY_FILTER_FUNCTION = 66
_ERROR_OUT_OF_MEMORY = 4


def _release_with(owner: object, release: Callable[[int], None], address: int, needed: object = None) -> None:
    """Have Embree release what is at an address once its owner is gone, and what that needs only afterwards.

    Garbage of one cycle is finalized in any order, so that a reference of the owner's would not do. Nothing is released
    at the end of the process, which takes all memory back: by then parts of the library may be gone.
    """
    weakref.finalize(owner, _release_before, release, address, needed).atexit = False


def _release_before(release: Callable[[int], None], address: int, _needed: object) -> None:
    release(address)


class Device:
    """Embree's memory and build threads; freed with the last of what was built by it."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        # One thread would leave TBB's worker spinning for as long as the device lives.
        self.address = embree.rtcNewDevice(f"threads={max(threads, 2)}".encode() if threads else b"")
        if not self.address:
            raise RuntimeError("Embree could not create a device")
        if not embree.rtcGetDeviceProperty(self.address, _DEVICE_PROPERTY_RAY_MASK):
            raise RuntimeError("this Embree library has no ray masks: visibility per ray kind would be lost")
        if not embree.rtcGetDeviceProperty(self.address, _DEVICE_PROPERTY_FILTER_FUNCTION):
            raise RuntimeError("this Embree library has no filter functions: glass and media would cast black shadows")
        _release_with(self, embree.rtcReleaseDevice, self.address)

    def check(self) -> None:
        """Raise what Embree has reported since the last call."""
        error = embree.rtcGetDeviceError(self.address)
        if error == _ERROR_OUT_OF_MEMORY:
            raise MemoryError("Embree could not build the scene: out of memory")
        if error:
            raise RuntimeError(f"Embree could not build the scene (error {error})")


class EmbreeScene:
    """A hierarchy, and the arrays whose memory it shares.

    Parameters
    ----------
    is_compact : bool
        Whether leaves have numbers of control points instead of copies: curves are traced as fast so, triangles slower.
    """

    def __init__(self, device: Device, geometry: GeometryArrays, *, is_compact: bool = False) -> None:
        self._device = device
        self._shared: list[np.ndarray] = [geometry.vertices, geometry.triangles]
        self.address = embree.rtcNewScene(device.address)
        embree.rtcSetSceneFlags(self.address, _SCENE_ROBUST | (_SCENE_COMPACT if is_compact else 0))
        embree.rtcSetSceneBuildQuality(self.address, _BUILD_QUALITY_HIGH)
        # Embree frees a scene's memory after the scene has let go of its device.
        _release_with(self, embree.rtcReleaseScene, self.address, device)

    def keep(self, shared: np.ndarray) -> None:
        """Keep the memory of an array that the hierarchy reads as long as the hierarchy itself."""
        self._shared.append(shared)

    def add(self, geometry: GeometryArrays, mesh: int, number: int, mask: int, *, is_filtered: bool) -> None:
        """Attach a mesh under a number; its memory stays as long as the hierarchy does.

        Parameters
        ----------
        mask : int
            Of the rays that find it.
        is_filtered : bool
            Whether searches' filter functions are called for it, whatever the ray says.
        """
        if geometry.mesh_table[mesh, MESH_SHAPE] == SHAPE_TRIANGLES:
            handle = triangle_geometry(self._device, geometry, mesh)
        else:
            handle, shared = round_geometry(self._device.address, geometry, mesh)
            self._shared += shared
        embree.rtcSetGeometryMask(handle, mask)
        embree.rtcSetGeometryEnableFilterFunctionFromArguments(handle, is_filtered)
        embree.rtcCommitGeometry(handle)
        embree.rtcAttachGeometryByID(self.address, handle, number)
        embree.rtcReleaseGeometry(handle)


class MeshHierarchies:
    """Hierarchies of instanced meshes, by key, and of what stands still: builds of a scene share them.

    Parameters
    ----------
    threads : int
        Build threads, 0 = all.

    Raises
    ------
    RuntimeError
        When Embree has no device, or was built without ray masks or filter functions.
    """

    def __init__(self, threads: int = 0) -> None:
        self.threads = threads
        self.device = Device(threads)
        self.scenes: dict[Hashable, EmbreeScene] = {}
        #: Hierarchy of what stands still, where other things are moved about.
        self.standing: Kept[EmbreeScene] = Kept()

    def keep_only(self, keys: Iterable[Hashable]) -> None:
        """Forget all but these, so that their memory is free before others are built."""
        kept = set(keys)
        self.scenes = {key: scene for key, scene in self.scenes.items() if key in kept}

    def of(self, key: Hashable, geometry: GeometryArrays, mesh: int) -> EmbreeScene:
        """The hierarchy of one mesh in object space."""
        if key not in self.scenes:
            is_compact = geometry.mesh_table[mesh, MESH_SHAPE] not in (SHAPE_TRIANGLES, SHAPE_SPHERES)
            scene = EmbreeScene(self.device, geometry, is_compact=is_compact)
            # Which of its instances let light through, or have a medium inside, is not known here.
            scene.add(geometry, mesh, 0, 0xFFFFFFFF, is_filtered=True)
            embree.rtcCommitScene(scene.address)
            self.scenes[key] = scene
        return self.scenes[key]


def triangle_geometry(device: Device, geometry: GeometryArrays, mesh: int) -> int:
    """Address of a new geometry of one mesh, in motion if it moves; the caller commits, attaches and releases it."""
    row = geometry.mesh_table[mesh]
    handle = embree.rtcNewGeometry(device.address, GEOMETRY_TRIANGLE)
    vertices, indices = geometry.vertices, geometry.triangles
    # Vertex numbers in `triangles` are global, so the whole vertex array is the buffer and nothing is copied.
    # So are those of a mesh's steps, seen from so far before that its numbers fit.
    count = int(row[MESH_FIRST_VERTEX] + row[MESH_VERTEX_COUNT])
    starts = [0]
    motion = int(row[MESH_MOTION])
    if motion >= 0:
        first = int(geometry.motion_table[motion, MOTION_FIRST_VERTEX] - row[MESH_FIRST_VERTEX])
        step_count = int(geometry.motion_table[motion, MOTION_STEP_COUNT])
        starts = [first + step * int(row[MESH_VERTEX_COUNT]) for step in range(step_count)]
        embree.rtcSetGeometryTimeStepCount(handle, step_count)
    for step, start in enumerate(starts):
        address = vertices.ctypes.data + start * vertices.strides[0]
        embree.rtcSetSharedGeometryBuffer(
            handle, BUFFER_VERTEX, step, FORMAT_FLOAT3, address, 0, vertices.strides[0], count
        )
    first = int(row[MESH_FIRST_TRIANGLE])
    embree.rtcSetSharedGeometryBuffer(
        handle,
        BUFFER_INDEX,
        0,
        FORMAT_UINT3,
        indices.ctypes.data + first * indices.strides[0],
        0,
        indices.strides[0],
        int(row[MESH_TRIANGLE_COUNT]),
    )
    return handle
