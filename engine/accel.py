# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds Embree's scenes and casts rays; no other module touches Embree.

Blender's own `libembree4` is used inside Blender or `bpy`, else the one the `embreex` wheel carries. Ray queries are
LLVM symbols, so that kernels calling them can be cached on disk (a ctypes pointer baked into a kernel could not).
Embree calls kernels back (`_skip`, `_count_passed`, `_keep_boundary`), whose addresses it gets with the ray.

Rays start a rounding error off the surface that they leave, and end as far before the light they look for. Where that
shows (`engine.builder.same_place`) they start and end in place instead, and skip the very triangles that they start and
end on, and no other (`start_on`, `end_on`): this is Cycles' rule for all rays.
"""

from __future__ import annotations

import ctypes
import glob
import os
import weakref
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numba import types

from engine.kernels.addresses import read_half, read_word, write_half
from engine.runtime.blender_folders import find_libraries, package_folder
from engine.runtime.jit import BoundKernel, Kernel, kernel
from engine.scene.content import Kept
from engine.state.geometry import (
    INSTANCE_FIRST_KEY,
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAG_CATCHER,
    INSTANCE_FLAG_MIRRORED,
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
_DEVICE_PROPERTY_FILTER_FUNCTION = 66
_ERROR_OUT_OF_MEMORY = 4
_RAY_CALLS_FILTER = 1 << 1
_TRANSFORM_BYTES = 48

#: rays a shadow ray's mask selects: blockers whose every material is opaque, and the others
MASK_SHADOW_OPAQUE = 64
MASK_SHADOW_TRANSPARENT = 128
#: what has a medium inside: its boundaries are looked for apart from all else
MASK_MEDIUM = 256
#: By so many bits higher are the masks of rays that see shadow catchers only.
CATCHER_MASK_SHIFT = 16
#: Up to this share of a scene's triangles, transparent casters of shadows get a hierarchy of their own.
_LARGEST_TRANSPARENT_SHARE = 0.05


#: The library on Linux and macOS, on Windows, and in wheels, which give it a name of their own.
_NAMES = ("libembree4*", "embree4*.dll", "*embree4*")


def _library() -> ctypes.CDLL:
    """Load libembree4.

    Raises
    ------
    RuntimeError
        When neither Blender's library folder nor `embreex` has it.
    """
    embreex = package_folder("embreex")
    further = () if embreex is None else (embreex, embreex.parent / "embreex.libs", embreex / ".dylibs")
    candidates = find_libraries(_NAMES, further)
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
    ("rtcSetGeometryEnableFilterFunctionFromArguments", None, [_POINTER, ctypes.c_bool]),
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
_IDENTITY = np.eye(3, 4, dtype=np.float32)

# Words of an RTCRayHit that hold the answer; the distance is the ray's length before.
_HIT_DISTANCE = 8
_HIT_U = 15
_HIT_TRIANGLE = 17  # within its mesh
_HIT_GEOMETRY = 18
_HIT_INSTANCE = 19

# Behind the RTCRayHit in a thread's scratch, in words: the arguments of searches that skip the triangles at their ends,
# of those that count what they pass, and of those for boundaries of media; their context, of which Embree knows the
# first two words; boundaries that were found; and numbers of these in the order of the distance.
_SKIPPING_ARGUMENTS = 32
_PASSING_ARGUMENTS = 48
_BOUNDARY_ARGUMENTS = 64
_CONTEXT = 80
_CONTEXT_COUNT = _CONTEXT + 2
_CONTEXT_INSTANCE_COUNT = _CONTEXT + 3
_CONTEXT_MASKS = _CONTEXT + 4  # address
# The triangles that the ray starts and ends on, by instance and number within their mesh.
_CONTEXT_OWN = _CONTEXT + 6
_CONTEXT_LIGHT = _CONTEXT + 8
_FIRST_BOUNDARY = _CONTEXT + 16
#: Boundaries that a search finds at once.
MOST_BOUNDARIES = 128
# A boundary has distance, u, v, triangle within its mesh, instance, normal, the ray's direction in the same space.
_BOUNDARY_WIDTH = 12
_BOUNDARY_ORDER = _FIRST_BOUNDARY + MOST_BOUNDARIES * _BOUNDARY_WIDTH
_SCRATCH_WORDS = _BOUNDARY_ORDER + MOST_BOUNDARIES
_EVERY_FEATURE = np.uint32(0xFFFFFFFF)
_WORD_BYTES = 4

# Bytes of an RTCFilterFunctionNArguments, of the RTCRay and of the RTCHit it points to, and of the context.
_FILTER_VALID, _FILTER_CONTEXT, _FILTER_RAY, _FILTER_HIT = 0, 16, 24, 32
_RAY_DIRECTION, _RAY_END = 16, 32
_FOUND_NORMAL, _FOUND_U, _FOUND_V, _FOUND_TRIANGLE, _FOUND_GEOMETRY, _FOUND_INSTANCE = 0, 12, 16, 20, 24, 28
_FOUND_COUNT = (_CONTEXT_COUNT - _CONTEXT) * _WORD_BYTES
_INSTANCE_COUNT = (_CONTEXT_INSTANCE_COUNT - _CONTEXT) * _WORD_BYTES
_MASKS = (_CONTEXT_MASKS - _CONTEXT) * _WORD_BYTES
_OWN = (_CONTEXT_OWN - _CONTEXT) * _WORD_BYTES
_LIGHT = (_CONTEXT_LIGHT - _CONTEXT) * _WORD_BYTES
_ROWS = (_FIRST_BOUNDARY - _CONTEXT) * _WORD_BYTES


@kernel
def _filtered_instance(context, hit):
    """Which instance Embree's filter function was called for."""
    instance = read_half(hit, _FOUND_INSTANCE)
    # As in `read_hit`.
    if instance >= read_half(context, _INSTANCE_COUNT):
        instance = read_half(hit, _FOUND_GEOMETRY)
    return instance


@kernel
def _filtered_mask(context, instance):
    """By which rays an instance is found."""
    return read_half(read_word(context, _MASKS), instance * _WORD_BYTES)


@kernel
def _is_skipped(context, hit):
    """Whether a hit is on the very triangle that the ray starts on, or on that which it ends on."""
    triangle = read_half(hit, _FOUND_TRIANGLE)
    is_own = triangle == read_half(context, _OWN + 4)
    is_light = triangle == read_half(context, _LIGHT + 4)
    if not (is_own or is_light):
        return False
    instance = _filtered_instance(context, hit)
    return (is_own and instance == read_half(context, _OWN)) or (is_light and instance == read_half(context, _LIGHT))


@kernel(called_by_c=True)
def _skip(arguments):
    """Embree's filter function: pass the triangles that the ray starts and ends on.

    Parameters
    ----------
    arguments : intp
        Address of an RTCFilterFunctionNArguments of one ray.
    """
    if _is_skipped(read_word(arguments, _FILTER_CONTEXT), read_word(arguments, _FILTER_HIT)):
        write_half(read_word(arguments, _FILTER_VALID), 0, 0)


@kernel(called_by_c=True)
def _count_passed(arguments):
    """Embree's filter function: count a hit on what shadow rays may pass, and have the search go on.

    Parameters
    ----------
    arguments : intp
        Address of an RTCFilterFunctionNArguments of one ray.
    """
    context, hit = read_word(arguments, _FILTER_CONTEXT), read_word(arguments, _FILTER_HIT)
    if _is_skipped(context, hit):
        write_half(read_word(arguments, _FILTER_VALID), 0, 0)
    elif _filtered_mask(context, _filtered_instance(context, hit)) & MASK_SHADOW_TRANSPARENT:
        write_half(context, _FOUND_COUNT, read_half(context, _FOUND_COUNT) + 1)
        write_half(read_word(arguments, _FILTER_VALID), 0, 0)


@kernel(called_by_c=True)
def _keep_boundary(arguments):
    """Embree's filter function: keep a hit on what has a medium inside, and have the search go on.

    Parameters
    ----------
    arguments : intp
        Address of an RTCFilterFunctionNArguments of one ray.
    """
    context, hit = read_word(arguments, _FILTER_CONTEXT), read_word(arguments, _FILTER_HIT)
    if _is_skipped(context, hit):
        write_half(read_word(arguments, _FILTER_VALID), 0, 0)
        return
    instance = _filtered_instance(context, hit)
    if _filtered_mask(context, instance) & MASK_MEDIUM == 0:
        return
    count = read_half(context, _FOUND_COUNT)
    if count < MOST_BOUNDARIES:
        row = context + _ROWS + count * (_WORD_BYTES * _BOUNDARY_WIDTH)
        ray = read_word(arguments, _FILTER_RAY)
        write_half(row, 0, read_half(ray, _RAY_END))
        write_half(row, 4, read_half(hit, _FOUND_U))
        write_half(row, 8, read_half(hit, _FOUND_V))
        write_half(row, 12, read_half(hit, _FOUND_TRIANGLE))
        write_half(row, 16, instance)
        for k in range(3):
            write_half(row, 20 + 4 * k, read_half(hit, _FOUND_NORMAL + 4 * k))
            write_half(row, 32 + 4 * k, read_half(ray, _RAY_DIRECTION + 4 * k))
    write_half(context, _FOUND_COUNT, count + 1)
    write_half(read_word(arguments, _FILTER_VALID), 0, 0)


@kernel
def _set_ray(ray, bits, origin, direction, near, far, time, mask):
    """Write what Embree reads of a ray; arguments as `trace_closest`."""
    ray[0], ray[1], ray[2] = origin
    ray[3] = near
    ray[4], ray[5], ray[6] = direction
    ray[7] = time
    ray[_HIT_DISTANCE] = far
    bits[9] = mask
    bits[10] = 0
    bits[11] = 0


@kernel
def _search_closest(scene, ray, bits, address, arguments, origin, direction, near, far, time, mask):
    """Whether Embree finds a closest hit; arguments as `trace_closest`, and the address of Embree's own or 0."""
    _set_ray(ray, bits, origin, direction, near, far, time, mask)
    bits[_HIT_TRIANGLE] = _NONE
    bits[_HIT_GEOMETRY] = _NONE
    bits[_HIT_INSTANCE] = _NONE
    _rtc_intersect(scene, address, arguments)
    return bits[_HIT_GEOMETRY] != _NONE


@kernel
def _name_triangle(bits, place, geometry, instance, triangle):
    """Write a triangle, instance -1: none, the way in which Embree's filter functions know it."""
    bits[_CONTEXT_INSTANCE_COUNT] = geometry.instance_table.shape[0]
    if instance < 0:
        bits[place] = _NONE
        bits[place + 1] = _NONE
        return
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    bits[place] = instance
    bits[place + 1] = triangle - geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE]


@kernel
def _call_filters(bits, flags):
    # Embree would call them for some of the instances only.
    bits[_SKIPPING_ARGUMENTS] = flags
    bits[_PASSING_ARGUMENTS] = flags
    bits[_BOUNDARY_ARGUMENTS] = flags


@kernel
def start_on(bits, geometry, instance, triangle):
    """Say which triangle the next rays start on, which they skip; instance -1: none. They end on none.

    What `trace_closest_from`, `trace_passing` and the like are told stays until they are told something else.
    """
    _name_triangle(bits, _CONTEXT_OWN, geometry, instance, triangle)
    bits[_CONTEXT_LIGHT] = _NONE
    bits[_CONTEXT_LIGHT + 1] = _NONE
    _call_filters(bits, _RAY_CALLS_FILTER if instance >= 0 else 0)


@kernel
def end_on(bits, geometry, instance, triangle):
    """Say which triangle the next rays end on, which they skip as well, instance -1: none; after `start_on`."""
    _name_triangle(bits, _CONTEXT_LIGHT, geometry, instance, triangle)
    if instance >= 0:
        _call_filters(bits, _RAY_CALLS_FILTER)


@kernel
def trace_closest(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """Closest hit along one ray; `read_hit` reads the answer.

    Parameters
    ----------
    scene, address : intp
        Embree's scene and the address of `ray`.
    ray, bits : float32 (_SCRATCH_WORDS,), 16-byte aligned, and the same memory as uint32
    origin, direction : 3-tuples, world; near, far : float32, in units of `direction`'s length

    Returns
    -------
    bool
        True on a hit.
    """
    return _search_closest(scene, ray, bits, address, 0, origin, direction, near, far, time, mask)


@kernel
def trace_closest_from(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """As `trace_closest`, but for what `start_on` and `end_on` have named."""
    arguments = address + _SKIPPING_ARGUMENTS * _WORD_BYTES
    return _search_closest(scene, ray, bits, address, arguments, origin, direction, near, far, time, mask)


@kernel
def read_hit(ray, bits, geometry):
    """What `trace_closest` has hit.

    Returns
    -------
    instance, triangle : int32
        Rows of `GeometryArrays.instance_table` and `triangles`.
    distance : float32, in units of the direction's length
    u, v : float32
        Barycentrics as Embree has them: P = (1 - u - v) v0 + u v1 + v v2.
    """
    # Triangles in world space have the id of their instance themselves: at top level, where the instance's id is all
    # ones, or in the hierarchy of what stands still, whose own id is the one behind the last.
    found = bits[_HIT_INSTANCE]
    if found >= np.uint32(geometry.instance_table.shape[0]):
        found = bits[_HIT_GEOMETRY]
    instance = np.int32(found)
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    triangle = np.int32(geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE] + np.int32(bits[_HIT_TRIANGLE]))
    return instance, triangle, ray[_HIT_DISTANCE], ray[_HIT_U], ray[_HIT_U + 1]


@kernel
def trace_occluded(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """True if anything the mask selects lies on the segment; arguments as `trace_closest`."""
    _set_ray(ray, bits, origin, direction, near, far, time, mask)
    _rtc_occluded(scene, address, 0)
    return ray[_HIT_DISTANCE] < 0.0


@kernel
def trace_occluded_from(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """As `trace_occluded`, but for what `start_on` and `end_on` have named."""
    _set_ray(ray, bits, origin, direction, near, far, time, mask)
    _rtc_occluded(scene, address, address + _SKIPPING_ARGUMENTS * _WORD_BYTES)
    return ray[_HIT_DISTANCE] < 0.0


@kernel
def prepare_filters(bits, masks, instance_count):
    """Say which instances are of what kind, for `trace_passing` and `trace_boundaries`.

    `masks` is `Accelerator.mask_handle`, an array of `instance_count` rows.
    """
    bits[_CONTEXT_MASKS] = masks & 0xFFFFFFFF
    bits[_CONTEXT_MASKS + 1] = masks >> 32
    bits[_CONTEXT_INSTANCE_COUNT] = instance_count


@kernel
def _search_through(scene, ray, bits, address, arguments, origin, direction, near, far, time, mask):
    """How often a filter function was called on a segment and let the search go on; -1 if the search was ended."""
    _set_ray(ray, bits, origin, direction, near, far, time, mask)
    bits[_CONTEXT_COUNT] = 0
    _rtc_occluded(scene, address, address + arguments * _WORD_BYTES)
    return np.int64(-1) if ray[_HIT_DISTANCE] < 0.0 else np.int64(bits[_CONTEXT_COUNT])


@kernel
def trace_passing(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """How many hits on the segment shadow rays may pass, of what the mask selects; -1 if anything else lies on it.

    Arguments as `trace_closest`; see `prepare_filters`. What `start_on` and `end_on` have named does not count.
    """
    return _search_through(scene, ray, bits, address, _PASSING_ARGUMENTS, origin, direction, near, far, time, mask)


@kernel
def trace_boundaries(scene, ray, bits, address, origin, direction, near, far, time, mask):
    """Find all hits of a segment on what has a medium inside; `read_boundary` reads them.

    Parameters
    ----------
    mask : int
        MASK_MEDIUM, and others that end the search where they meet anything else. The others: as `trace_closest`; see
        `prepare_filters`. What `start_on` and `end_on` have named does not count.

    Returns
    -------
    int
        How many there are, which may be more than the MOST_BOUNDARIES that are kept; -1 if anything else lies on the
        segment.
    """
    count = _search_through(scene, ray, bits, address, _BOUNDARY_ARGUMENTS, origin, direction, near, far, time, mask)
    for k in range(min(count, MOST_BOUNDARIES)):
        distance = ray[_FIRST_BOUNDARY + _BOUNDARY_WIDTH * k]
        place = k
        while place > 0:
            before = bits[_BOUNDARY_ORDER + place - 1]
            if not ray[_FIRST_BOUNDARY + _BOUNDARY_WIDTH * np.int64(before)] > distance:
                break
            bits[_BOUNDARY_ORDER + place] = before
            place -= 1
        bits[_BOUNDARY_ORDER + place] = k
    return count


@kernel
def read_boundary(ray, bits, geometry, k):
    """Hit number k, in the order of the distance, of those that `trace_boundaries` has kept.

    Returns
    -------
    instance, triangle, distance, u, v
        As of `read_hit`.
    is_back : bool
        Whether the triangle's normal points along the ray.
    """
    row = _FIRST_BOUNDARY + _BOUNDARY_WIDTH * np.int64(bits[_BOUNDARY_ORDER + k])
    instance = np.int64(bits[row + 4])
    mesh, flags = geometry.instance_table[instance, INSTANCE_MESH], geometry.instance_table[instance, INSTANCE_FLAGS]
    triangle = np.int64(geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE]) + np.int64(bits[row + 3])
    along = ray[row + 5] * ray[row + 8] + ray[row + 6] * ray[row + 9] + ray[row + 7] * ray[row + 10]
    # What is mirrored has been turned inside out where its triangles are stored in world space.
    is_turned = flags & INSTANCE_FLAG_BAKED != 0 and flags & INSTANCE_FLAG_MIRRORED != 0
    return instance, triangle, ray[row], ray[row + 1], ray[row + 2], along < 0.0 if is_turned else along > 0.0


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


@cache
def _address_of(called: Kernel) -> int:
    """Where Embree calls a kernel with the address of its arguments; 0 where nothing is compiled."""
    if not isinstance(called, Kernel):
        return 0
    bound = BoundKernel(called)
    bound.bind(0)
    return bound.c_address


class RayScratch:
    """One thread's aligned RTCRayHit, and what searches that do not end at a hit have besides."""

    def __init__(self) -> None:
        raw = np.zeros(_SCRATCH_WORDS + 16, np.float32)
        start = (-raw.ctypes.data % 64) // 4
        self.ray = raw[start : start + _SCRATCH_WORDS]
        self.bits = self.ray.view(np.uint32)
        self.address = self.ray.ctypes.data
        for first, function in (
            (_SKIPPING_ARGUMENTS, _skip), (_PASSING_ARGUMENTS, _count_passed), (_BOUNDARY_ARGUMENTS, _keep_boundary)
        ):
            # RTCIntersectArguments, or RTCOccludedArguments: flags, features, context, filter function, and nothing of
            # what is no triangle.
            called = self.address + _CONTEXT * _WORD_BYTES, _address_of(function)
            self.bits[first + 1] = _EVERY_FEATURE
            self.bits[first + 2 : first + 6].view(np.int64)[:] = called
        self.bits[_CONTEXT : _CONTEXT + 2] = _NONE
        self.bits[_CONTEXT_OWN : _CONTEXT_OWN + 4] = _NONE


def _release_with(owner: object, release: Callable[[int], None], address: int, needed: object = None) -> None:
    """Have Embree release what is at an address once its owner is gone, and what that needs only afterwards.

    Garbage of one cycle is finalized in any order, so that a reference of the owner's would not do. Nothing is released
    at the end of the process, which takes all memory back: by then parts of the library may be gone.
    """
    weakref.finalize(owner, _release_before, release, address, needed).atexit = False


def _release_before(release: Callable[[int], None], address: int, _needed: object) -> None:
    release(address)


class _Device:
    """Embree's memory and build threads; freed with the last of what was built by it."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        # One thread would leave TBB's worker spinning for as long as the device lives.
        self.address = _lib.rtcNewDevice(f"threads={max(threads, 2)}".encode() if threads else b"")
        if not self.address:
            raise RuntimeError("Embree could not create a device")
        if not _lib.rtcGetDeviceProperty(self.address, _DEVICE_PROPERTY_RAY_MASK):
            raise RuntimeError("this Embree library has no ray masks: visibility per ray kind would be lost")
        if not _lib.rtcGetDeviceProperty(self.address, _DEVICE_PROPERTY_FILTER_FUNCTION):
            raise RuntimeError("this Embree library has no filter functions: glass and media would cast black shadows")
        _release_with(self, _lib.rtcReleaseDevice, self.address)

    def check(self) -> None:
        """Raise what Embree has reported since the last call."""
        error = _lib.rtcGetDeviceError(self.address)
        if error == _ERROR_OUT_OF_MEMORY:
            raise MemoryError("Embree could not build the scene: out of memory")
        if error:
            raise RuntimeError(f"Embree could not build the scene (error {error})")


class _EmbreeScene:
    """A hierarchy, and the arrays whose memory it shares."""

    def __init__(self, device: _Device, geometry: GeometryArrays) -> None:
        self._device = device
        self._shared = geometry.vertices, geometry.triangles
        self.address = _lib.rtcNewScene(device.address)
        _lib.rtcSetSceneFlags(self.address, _SCENE_ROBUST)
        _lib.rtcSetSceneBuildQuality(self.address, _BUILD_QUALITY_HIGH)
        # Embree frees a scene's memory after the scene has let go of its device.
        _release_with(self, _lib.rtcReleaseScene, self.address, device)


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
        self.device = _Device(threads)
        self.scenes: dict[Hashable, _EmbreeScene] = {}
        #: Hierarchy of what stands still, where other things are moved about.
        self.standing: Kept[_EmbreeScene] = Kept()

    def keep_only(self, keys: Iterable[Hashable]) -> None:
        """Forget all but these, so that their memory is free before others are built."""
        kept = set(keys)
        self.scenes = {key: scene for key, scene in self.scenes.items() if key in kept}

    def of(self, key: Hashable, geometry: GeometryArrays, mesh: int) -> _EmbreeScene:
        """The hierarchy of one mesh in object space."""
        if key not in self.scenes:
            scene = _EmbreeScene(self.device, geometry)
            inner = _triangle_geometry(self.device, geometry, mesh)
            _lib.rtcSetGeometryMask(inner, 0xFFFFFFFF)
            # Which of its instances let light through, or have a medium inside, is not known here.
            _lib.rtcSetGeometryEnableFilterFunctionFromArguments(inner, True)
            _lib.rtcCommitGeometry(inner)
            _lib.rtcAttachGeometryByID(scene.address, inner, 0)
            _lib.rtcReleaseGeometry(inner)
            _lib.rtcCommitScene(scene.address)
            self.scenes[key] = scene
        return self.scenes[key]


@dataclass
class Accelerator:
    """Embree scenes over `GeometryArrays`, whose buffers they share.

    Attributes
    ----------
    top : _EmbreeScene
        Triangles that are stored in world space, and instances of meshes.
    meshes : list of _EmbreeScene
        Hierarchies of the instanced meshes, and of what stands still, where that is not in `top`.
    transparent : _EmbreeScene
        What shadow rays can pass once more, by itself, if it is a small part; else `top`.
    masks : uint32 (I,)
        By which rays each instance is found.
    """

    top: _EmbreeScene
    meshes: list[_EmbreeScene]
    transparent: _EmbreeScene
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


def _triangle_geometry(device: _Device, geometry: GeometryArrays, mesh: int) -> int:
    row = geometry.mesh_table[mesh]
    handle = _lib.rtcNewGeometry(device.address, _GEOMETRY_TRIANGLE)
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


def _attach_standing(
    device: _Device, scene: _EmbreeScene, geometry: GeometryArrays, rows: np.ndarray, masks: np.ndarray
) -> None:
    """Attach triangles that are stored in world space; `rows` are their instances, and their ids."""
    for index in rows.tolist():
        handle = _triangle_geometry(device, geometry, int(geometry.instance_table[index, INSTANCE_MESH]))
        _lib.rtcSetGeometryMask(handle, int(masks[index]))
        is_filtered = int(masks[index]) & (MASK_SHADOW_TRANSPARENT | MASK_MEDIUM) != 0
        _lib.rtcSetGeometryEnableFilterFunctionFromArguments(handle, is_filtered)
        _lib.rtcCommitGeometry(handle)
        _lib.rtcAttachGeometryByID(scene.address, handle, index)
        _lib.rtcReleaseGeometry(handle)


def _build_standing(
    device: _Device, geometry: GeometryArrays, rows: np.ndarray, masks: np.ndarray
) -> _EmbreeScene:
    scene = _EmbreeScene(device, geometry)
    _attach_standing(device, scene, geometry, rows, masks)
    _lib.rtcCommitScene(scene.address)
    return scene


def _attach_moved(
    device: _Device, scene: _EmbreeScene, geometry: GeometryArrays, rows: np.ndarray, masks: np.ndarray,
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
    top = _EmbreeScene(device, geometry)
    table = geometry.instance_table
    masks = (table[:, INSTANCE_VISIBILITY].astype(np.uint32) & np.uint32(31)) | shadow_masks.astype(np.uint32)
    is_catcher = (table[:, INSTANCE_FLAGS] & INSTANCE_FLAG_CATCHER) != 0
    masks |= np.where(is_catcher, masks << np.uint32(CATCHER_MASK_SHIFT), np.uint32(0))
    has_triangles = geometry.mesh_table[table[:, INSTANCE_MESH], MESH_TRIANGLE_COUNT] > 0
    wanted = has_triangles & (masks != 0)
    is_baked = (table[:, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED) != 0
    standing = np.flatnonzero(wanted & is_baked)
    meshes: list[_EmbreeScene] = []
    if shapes_key is None:
        _attach_standing(device, top, geometry, standing, masks)
    elif len(standing):
        group = hierarchies.standing.get(
            (shapes_key, standing.tobytes(), table[standing, INSTANCE_MESH].tobytes(), masks[standing].tobytes()),
            lambda: _build_standing(device, geometry, standing, masks),
        )
        meshes.append(group)
        _attach_instances(
            device.address, top.address, np.array([len(table)], np.int64), np.array([group.address], np.intp),
            np.array([_IDENTITY.ctypes.data], np.intp), np.ones(1, np.int64), np.array([_NONE], np.uint32),
        )
    instanced = np.flatnonzero(wanted & ~is_baked)
    addresses = np.zeros(len(geometry.mesh_table), np.intp)
    for mesh in np.unique(table[instanced, INSTANCE_MESH]).tolist():
        meshes.append(hierarchies.of(mesh if mesh_keys is None else mesh_keys[mesh], geometry, mesh))
        addresses[mesh] = meshes[-1].address
    _attach_moved(device, top, geometry, instanced, masks, addresses)
    _lib.rtcCommitScene(top.address)
    transparent = top
    is_transparent = wanted & ((masks & np.uint32(MASK_SHADOW_TRANSPARENT)) != 0)
    sizes = geometry.mesh_table[table[:, INSTANCE_MESH], MESH_TRIANGLE_COUNT].astype(np.int64)
    is_small = 0 < sizes[is_transparent].sum() <= _LARGEST_TRANSPARENT_SHARE * sizes[wanted].sum()
    if is_small and shapes_key is None:
        transparent = _EmbreeScene(device, geometry)
        _attach_standing(device, transparent, geometry, np.flatnonzero(is_transparent & is_baked), masks)
        _attach_moved(device, transparent, geometry, np.flatnonzero(is_transparent & ~is_baked), masks, addresses)
        _lib.rtcCommitScene(transparent.address)
    device.check()
    return Accelerator(top, meshes, transparent, masks)


def library_path() -> str:
    """File Embree was loaded from, for reports."""
    return os.fspath(_lib._name)
