# SPDX-License-Identifier: GPL-3.0-or-later
"""What Embree's geometries are made with: its numbers, and its functions as kernels call them.

A hundred thousand geometries are attached by a kernel: through ctypes it would take longer than building the tree.
"""

from __future__ import annotations

from numba import types

from engine.accel.library import external

# Embree 4 API constants (rtcore headers).
GEOMETRY_TRIANGLE = 0
GEOMETRY_INSTANCE = 121
BUFFER_INDEX = 0
BUFFER_VERTEX = 1
FORMAT_UINT = 0x5001
FORMAT_UINT3 = 0x5003
FORMAT_FLOAT3 = 0x9003
FORMAT_FLOAT4 = 0x9004
FORMAT_FLOAT3X4_ROW_MAJOR = 0x9134

new_geometry = external("rtcNewGeometry", types.intp(types.intp, types.int32))
set_buffer = external(
    "rtcSetSharedGeometryBuffer",
    types.void(types.intp, types.int32, types.uint32, types.int32, types.intp, types.intp, types.intp, types.intp),
)
set_instanced_scene = external("rtcSetGeometryInstancedScene", types.void(types.intp, types.intp))
set_time_steps = external("rtcSetGeometryTimeStepCount", types.void(types.intp, types.uint32))
set_transform = external("rtcSetGeometryTransform", types.void(types.intp, types.uint32, types.int32, types.intp))
set_mask = external("rtcSetGeometryMask", types.void(types.intp, types.uint32))
set_filtered = external("rtcSetGeometryEnableFilterFunctionFromArguments", types.void(types.intp, types.boolean))
commit = external("rtcCommitGeometry", types.void(types.intp))
attach = external("rtcAttachGeometryByID", types.void(types.intp, types.intp, types.uint32))
release = external("rtcReleaseGeometry", types.void(types.intp))
