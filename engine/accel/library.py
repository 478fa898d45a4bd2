# SPDX-License-Identifier: GPL-3.0-or-later
"""Embree's library, and its functions for Python and for kernels.

Blender's own `libembree4` is used inside Blender or `bpy`, else the one the `embreex` wheel carries.
"""

from __future__ import annotations

import ctypes
import glob
import os
from typing import Any

import llvmlite.binding as llvm
from numba import types

from engine.runtime.blender_folders import find_libraries, package_folder

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


embree = _library()
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
    ("rtcSetGeometryTessellationRate", None, [_POINTER, ctypes.c_float]),
    ("rtcSetGeometryIntersectFilterFunction", None, [_POINTER, _POINTER]),
    ("rtcSetGeometryOccludedFilterFunction", None, [_POINTER, _POINTER]),
    ("rtcCommitGeometry", None, [_POINTER]),
    ("rtcAttachGeometryByID", None, [_POINTER, _POINTER, _UINT]),
):
    _function = getattr(embree, _name)
    _function.restype, _function.argtypes = _result, _arguments


def external(name: str, signature: Any) -> types.ExternalFunction:
    """An Embree function that kernels can call and still be cached on disk."""
    symbol = f"neuralguide_{name}"
    llvm.add_symbol(symbol, ctypes.cast(getattr(embree, name), ctypes.c_void_p).value)
    return types.ExternalFunction(symbol, signature)


rtc_intersect = external("rtcIntersect1", types.void(types.intp, types.intp, types.intp))
rtc_occluded = external("rtcOccluded1", types.void(types.intp, types.intp, types.intp))


def library_path() -> str:
    """File Embree was loaded from, for reports."""
    return os.fspath(embree._name)
