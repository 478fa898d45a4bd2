# SPDX-License-Identifier: GPL-3.0-or-later
"""Embree: the only module that touches it.

Blender's own `libembree4` is used inside Blender or `bpy`, else the one the `embreex` wheel carries. Ray queries are
LLVM symbols, so that kernels calling them can be cached on disk (a ctypes pointer baked into a kernel could not).
"""

from __future__ import annotations

import ctypes
import glob
import importlib.util
import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numba import types

from engine.jit import kernel
from engine.scene.arrays import (
    INSTANCE_FIRST_KEY,
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAGS,
    INSTANCE_KEY_COUNT,
    INSTANCE_MESH,
    INSTANCE_VISIBILITY,
    MESH_FIRST_TRIANGLE,
    MESH_FIRST_VERTEX,
    MESH_MOTION,
    MESH_TRIANGLE_COUNT,
    MESH_VERTEX_COUNT,
    MOTION_FIRST_VERTEX,
    MOTION_STEP_COUNT,
    GeometryArrays,
)

# Embree 4 API constants (rtcore headers).
_GEOMETRY_TRIANGLE = 0
_GEOMETRY_INSTANCE = 121
_BUFFER_INDEX = 0
_BUFFER_VERTEX = 1
_FORMAT_UINT3 = 0x5003
_FORMAT_FLOAT3 = 0x9003
_FORMAT_FLOAT3X4_ROW_MAJOR = 0x9134
_SCENE_ROBUST = 1 << 2
_BUILD_QUALITY_HIGH = 2
_DEVICE_PROPERTY_RAY_MASK = 64
_TRANSFORM_BYTES = 48

#: floats in an RTCRayHit with one level of instancing, padded to 16 bytes
RAY_HIT_FLOATS = 24
#: rays a shadow ray's mask selects: blockers whose every material is opaque, and the others
MASK_SHADOW_OPAQUE = 64
MASK_SHADOW_TRANSPARENT = 128


def _library() -> ctypes.CDLL:
    """Load libembree4.

    Raises
    ------
    RuntimeError
        When neither Blender's library folder nor `embreex` has it.
    """
    candidates: list[Path] = []
    bpy_spec = importlib.util.find_spec("bpy")
    roots = []
    if bpy_spec is not None and bpy_spec.origin:
        roots.append(Path(bpy_spec.origin).parent / "lib")
    roots.append(Path(sys.executable).parent / "lib")
    for root in roots:
        candidates += [Path(p) for p in glob.glob(str(root / "libembree4*"))]
        candidates += [Path(p) for p in glob.glob(str(root / "embree4*.dll"))]
    embreex_spec = importlib.util.find_spec("embreex")
    if embreex_spec is not None and embreex_spec.origin:
        package = Path(embreex_spec.origin).parent
        for folder in (package, package.parent / "embreex.libs", package / ".dylibs"):
            candidates += [Path(p) for p in glob.glob(str(folder / "*embree4*"))]
    problems = []
    for candidate in candidates:
        try:
            for tbb in glob.glob(str(candidate.parent / "libtbb.so*")):
                ctypes.CDLL(tbb, ctypes.RTLD_GLOBAL)
            return ctypes.CDLL(str(candidate))
        except OSError as error:
            problems.append(f"{candidate.name}: {error}")
    raise RuntimeError("Embree 4 was not found: install the wheel `embreex`. " + "; ".join(problems))


_lib = _library()
_POINTER, _UINT, _SIZE = ctypes.c_void_p, ctypes.c_uint, ctypes.c_size_t
for _name, _result, _arguments in (
    ("rtcNewDevice", _POINTER, [ctypes.c_char_p]),
    ("rtcReleaseDevice", None, [_POINTER]),
    ("rtcGetDeviceError", ctypes.c_int, [_POINTER]),
    ("rtcGetDeviceProperty", ctypes.c_ssize_t, [_POINTER, ctypes.c_int]),
    ("rtcNewScene", _POINTER, [_POINTER]),
    ("rtcReleaseScene", None, [_POINTER]),
    ("rtcSetSceneFlags", None, [_POINTER, ctypes.c_int]),
    ("rtcSetSceneBuildQuality", None, [_POINTER, ctypes.c_int]),
    ("rtcCommitScene", None, [_POINTER]),
    ("rtcNewGeometry", _POINTER, [_POINTER, ctypes.c_int]),
    ("rtcReleaseGeometry", None, [_POINTER]),
    ("rtcSetSharedGeometryBuffer", None, [_POINTER, ctypes.c_int, _UINT, _UINT, _POINTER, _SIZE, _SIZE, _SIZE]),
    ("rtcSetGeometryMask", None, [_POINTER, _UINT]),
    ("rtcSetGeometryInstancedScene", None, [_POINTER, _POINTER]),
    ("rtcSetGeometryTimeStepCount", None, [_POINTER, _UINT]),
    ("rtcSetGeometryTransform", None, [_POINTER, _UINT, _UINT, _POINTER]),
    ("rtcCommitGeometry", None, [_POINTER]),
    ("rtcAttachGeometryByID", None, [_POINTER, _POINTER, _UINT]),
):
    _function = getattr(_lib, _name)
    _function.restype, _function.argtypes = _result, _arguments



def _external(name: str, signature: Any) -> types.ExternalFunction:
    """An Embree function that kernels can call and still be cached on disk."""
    symbol = f"neuralguide_{name}"
    llvm.add_symbol(symbol, ctypes.cast(getattr(_lib, name), ctypes.c_void_p).value)
    return types.ExternalFunction(symbol, signature)


_rtc_intersect = _external("rtcIntersect1", types.void(types.intp, types.intp, types.intp))
_rtc_occluded = _external("rtcOccluded1", types.void(types.intp, types.intp, types.intp))
# A hundred thousand instances are attached by a kernel: through ctypes it would take longer than building the tree.
_new_geometry = _external("rtcNewGeometry", types.intp(types.intp, types.int32))
_set_instanced_scene = _external("rtcSetGeometryInstancedScene", types.void(types.intp, types.intp))
_set_time_steps = _external("rtcSetGeometryTimeStepCount", types.void(types.intp, types.uint32))
_set_transform = _external("rtcSetGeometryTransform", types.void(types.intp, types.uint32, types.int32, types.intp))
_set_mask = _external("rtcSetGeometryMask", types.void(types.intp, types.uint32))
_commit = _external("rtcCommitGeometry", types.void(types.intp))
_attach = _external("rtcAttachGeometryByID", types.void(types.intp, types.intp, types.uint32))
_release = _external("rtcReleaseGeometry", types.void(types.intp))

_NONE = np.uint32(0xFFFFFFFF)


@kernel
def trace_closest(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """Closest hit along one ray; the answer is read from `ray` and `bits` by `hit_*` columns.

    Parameters
    ----------
    scene, address : intp
        Embree's scene and the address of `ray`.
    ray, bits : float32 (RAY_HIT_FLOATS,), 16-byte aligned, and the same memory as uint32
    origin, direction : 3-tuples, world; near, far : float32, in units of `direction`'s length

    Returns
    -------
    bool
        True on a hit. Then ray[8] is the distance, ray[12:15] the unnormalised geometric normal (object space for
        instances), ray[15:17] barycentrics, bits[17] the triangle within its mesh, bits[18] the geometry and bits[19]
        the instance (all ones at top level).
    """
    ray[0], ray[1], ray[2] = origin
    ray[3] = near
    ray[4], ray[5], ray[6] = direction
    ray[7] = time
    ray[8] = far
    bits[9] = mask
    bits[10] = 0
    bits[11] = 0
    bits[17] = _NONE
    bits[18] = _NONE
    bits[19] = _NONE
    _rtc_intersect(scene, address, 0)
    return bits[18] != _NONE


@kernel
def trace_occluded(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """True if anything the mask selects lies on the segment; arguments as `trace_closest`."""
    ray[0], ray[1], ray[2] = origin
    ray[3] = near
    ray[4], ray[5], ray[6] = direction
    ray[7] = time
    ray[8] = far
    bits[9] = mask
    bits[10] = 0
    bits[11] = 0
    _rtc_occluded(scene, address, 0)
    return ray[8] < 0.0


@kernel
def _attach_instances(device, top, indices, scenes, transforms, key_counts, masks):
    """Attach instance geometries; scenes and transforms, intp (K,), are addresses, of so many keys in a row."""
    for k in range(indices.shape[0]):
        handle = _new_geometry(device, np.int32(_GEOMETRY_INSTANCE))
        _set_instanced_scene(handle, scenes[k])
        _set_time_steps(handle, np.uint32(key_counts[k]))
        for key in range(key_counts[k]):
            address = transforms[k] + key * _TRANSFORM_BYTES
            _set_transform(handle, np.uint32(key), np.int32(_FORMAT_FLOAT3X4_ROW_MAJOR), address)
        _set_mask(handle, masks[k])
        _commit(handle)
        _attach(top, handle, np.uint32(indices[k]))
        _release(handle)


class RayScratch:
    """One thread's aligned RTCRayHit."""

    def __init__(self) -> None:
        raw = np.zeros(RAY_HIT_FLOATS + 16, np.float32)
        start = (-raw.ctypes.data % 64) // 4
        self.ray = raw[start : start + RAY_HIT_FLOATS]
        self.bits = self.ray.view(np.uint32)
        self.address = self.ray.ctypes.data


@dataclass
class Accelerator:
    """Embree scenes over `GeometryArrays`, whose buffers they share: keep the arrays alive.

    `handle` is the top-level scene's address, for kernels.
    """

    device: int
    handle: int
    scenes: list[int] = field(default_factory=list)
    keep: list[Any] = field(default_factory=list)

    def release(self) -> None:
        """Free Embree's memory; the handle is invalid afterwards."""
        for scene in reversed(self.scenes):
            _lib.rtcReleaseScene(scene)
        self.scenes.clear()
        if self.device:
            _lib.rtcReleaseDevice(self.device)
        self.device = self.handle = 0
        self.keep.clear()

    def __del__(self) -> None:
        self.release()


def _triangle_geometry(device: int, geometry: GeometryArrays, mesh: int, indices: np.ndarray) -> int:
    row = geometry.mesh_table[mesh]
    handle = _lib.rtcNewGeometry(device, _GEOMETRY_TRIANGLE)
    vertices = geometry.vertices
    # Vertex numbers in `triangles` are global, so the whole vertex array is the buffer and nothing is copied.
    # So are those of a mesh's steps, seen from so far before that its numbers fit.
    count = int(row[MESH_FIRST_VERTEX] + row[MESH_VERTEX_COUNT])
    starts = [0]
    motion = int(row[MESH_MOTION])
    if motion >= 0:
        first = int(geometry.motion_table[motion, MOTION_FIRST_VERTEX] - row[MESH_FIRST_VERTEX])
        step_count = int(geometry.motion_table[motion, MOTION_STEP_COUNT])
        starts = [first + step * int(row[MESH_VERTEX_COUNT]) for step in range(step_count)]
        _lib.rtcSetGeometryTimeStepCount(handle, step_count)
    for step, start in enumerate(starts):
        address = vertices.ctypes.data + start * vertices.strides[0]
        _lib.rtcSetSharedGeometryBuffer(
            handle, _BUFFER_VERTEX, step, _FORMAT_FLOAT3, address, 0, vertices.strides[0], count
        )
    first = int(row[MESH_FIRST_TRIANGLE])
    _lib.rtcSetSharedGeometryBuffer(
        handle,
        _BUFFER_INDEX,
        0,
        _FORMAT_UINT3,
        indices.ctypes.data + first * indices.strides[0],
        0,
        indices.strides[0],
        int(row[MESH_TRIANGLE_COUNT]),
    )
    return handle


def build_accelerator(geometry: GeometryArrays, shadow_masks: np.ndarray, threads: int = 0) -> Accelerator:
    """Build the two-level acceleration structure.

    Parameters
    ----------
    geometry : GeometryArrays
    shadow_masks : uint32 (I,)
        MASK_SHADOW_* bits of each instance (0 = casts no shadow); other mask bits come from its visibility.
    threads : int
        Build threads, 0 = all.

    Raises
    ------
    RuntimeError
        When Embree reports an error, or was built without ray masks.
    """
    # One thread would leave TBB's worker spinning for as long as the device lives.
    device = _lib.rtcNewDevice(f"threads={max(threads, 2)}".encode() if threads else b"")
    if not device:
        raise RuntimeError("Embree could not create a device")
    if not _lib.rtcGetDeviceProperty(device, _DEVICE_PROPERTY_RAY_MASK):
        _lib.rtcReleaseDevice(device)
        raise RuntimeError("this Embree library has no ray masks: visibility per ray kind would be lost")
    top = _lib.rtcNewScene(device)
    accelerator = Accelerator(device, top, [top], [geometry])
    _lib.rtcSetSceneFlags(top, _SCENE_ROBUST)
    _lib.rtcSetSceneBuildQuality(top, _BUILD_QUALITY_HIGH)
    table = geometry.instance_table
    masks = (table[:, INSTANCE_VISIBILITY].astype(np.uint32) & np.uint32(31)) | shadow_masks.astype(np.uint32)
    has_triangles = geometry.mesh_table[table[:, INSTANCE_MESH], MESH_TRIANGLE_COUNT] > 0
    wanted = has_triangles & (masks != 0)
    is_baked = (table[:, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED) != 0
    for index in np.flatnonzero(wanted & is_baked):
        handle = _triangle_geometry(device, geometry, int(table[index, INSTANCE_MESH]), geometry.triangles)
        _lib.rtcSetGeometryMask(handle, int(masks[index]))
        _lib.rtcCommitGeometry(handle)
        _lib.rtcAttachGeometryByID(top, handle, int(index))
        _lib.rtcReleaseGeometry(handle)
    instanced = np.flatnonzero(wanted & ~is_baked)
    mesh_scenes = np.zeros(len(geometry.mesh_table), np.intp)
    for mesh in np.unique(table[instanced, INSTANCE_MESH]):
        scene = _lib.rtcNewScene(device)
        _lib.rtcSetSceneFlags(scene, _SCENE_ROBUST)
        _lib.rtcSetSceneBuildQuality(scene, _BUILD_QUALITY_HIGH)
        inner = _triangle_geometry(device, geometry, int(mesh), geometry.triangles)
        _lib.rtcSetGeometryMask(inner, 0xFFFFFFFF)
        _lib.rtcCommitGeometry(inner)
        _lib.rtcAttachGeometryByID(scene, inner, 0)
        _lib.rtcReleaseGeometry(inner)
        _lib.rtcCommitScene(scene)
        mesh_scenes[mesh] = scene
        accelerator.scenes.append(scene)
    if len(instanced):
        key_counts = table[instanced, INSTANCE_KEY_COUNT].astype(np.int64)
        first_keys = table[instanced, INSTANCE_FIRST_KEY].astype(np.int64)
        moving = geometry.motion_transforms.ctypes.data + first_keys * _TRANSFORM_BYTES
        standing = geometry.transforms.ctypes.data + instanced * _TRANSFORM_BYTES
        _attach_instances(
            device,
            top,
            instanced,
            mesh_scenes[table[instanced, INSTANCE_MESH]],
            np.where(key_counts > 0, moving, standing).astype(np.intp),
            np.maximum(key_counts, 1),
            masks[instanced],
        )
    _lib.rtcCommitScene(top)
    error = _lib.rtcGetDeviceError(device)
    if error:
        accelerator.release()
        raise RuntimeError(f"Embree could not build the scene (error {error}{', out of memory' if error == 4 else ''})")
    return accelerator


def library_path() -> str:
    """File Embree was loaded from, for reports."""
    return os.fspath(_lib._name)
