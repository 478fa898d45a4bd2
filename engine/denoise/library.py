# SPDX-License-Identifier: GPL-3.0-or-later
"""Open Image Denoise: the only module that touches it.

Blender's own library is used inside Blender or `bpy`, else the one that the package `pyoidn` carries, if it is
installed. Any release of version 2 will do: all calls made here have been there since 2.0.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from engine.runtime.blender_folders import find_libraries, package_folder

# Constants of the library's header `oidn.h`.
_DEVICE_CPU = 1
_FORMAT_FLOAT3 = 3
_ERROR_CANCELLED = 6
#: Filter qualities by the names that Cycles gives them. Releases before 2.3 know no fast one.
QUALITIES = {"HIGH": 6, "BALANCED": 5, "FAST": 4}
_FIRST_WITH_FAST = 20300

_NAMES = ("libOpenImageDenoise.so.2", "libOpenImageDenoise*.dylib", "OpenImageDenoise.dll")

_ProgressMonitor = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_double)


class DenoiserMissing(RuntimeError):
    """There is no Open Image Denoise to be had; the message says what was tried and what to do."""


class DenoiserFailed(RuntimeError):
    """Open Image Denoise reported an error."""


def library_paths() -> list[Path]:
    """Files that may be the library, the best first."""
    pyoidn = package_folder("pyoidn")
    return find_libraries(_NAMES, () if pyoidn is None else (pyoidn / "oidn", pyoidn / "oidn" / "bin"))


_POINTER, _INT, _SIZE, _TEXT = ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t, ctypes.c_char_p
#: Result and arguments of every call.
_CALLS: dict[str, tuple[Any, list[Any]]] = {
    "oidnNewDevice": (_POINTER, [_INT]),
    "oidnReleaseDevice": (None, [_POINTER]),
    "oidnSetDeviceInt": (None, [_POINTER, _TEXT, _INT]),
    "oidnSetDeviceBool": (None, [_POINTER, _TEXT, ctypes.c_bool]),
    "oidnGetDeviceInt": (_INT, [_POINTER, _TEXT]),
    "oidnGetDeviceError": (_INT, [_POINTER, ctypes.POINTER(_TEXT)]),
    "oidnCommitDevice": (None, [_POINTER]),
    "oidnNewFilter": (_POINTER, [_POINTER, _TEXT]),
    "oidnReleaseFilter": (None, [_POINTER]),
    "oidnSetFilterInt": (None, [_POINTER, _TEXT, _INT]),
    "oidnSetFilterBool": (None, [_POINTER, _TEXT, ctypes.c_bool]),
    "oidnSetSharedFilterImage": (None, [_POINTER, _TEXT, _POINTER, _INT, *[_SIZE] * 5]),
    "oidnSetFilterProgressMonitorFunction": (None, [_POINTER, _ProgressMonitor, _POINTER]),
    "oidnCommitFilter": (None, [_POINTER]),
    "oidnExecuteFilter": (None, [_POINTER]),
}


@functools.cache
def _load() -> ctypes.CDLL | str:
    """The library with its calls declared, or why there is none. Looked for once a process."""
    problems = []
    for path in library_paths():
        try:
            library = ctypes.CDLL(str(path))
            for name, (result, arguments) in _CALLS.items():
                function = getattr(library, name)
                function.restype, function.argtypes = result, arguments
        except (OSError, AttributeError) as error:
            problems.append(f"{path.name}: {error}")
        else:
            return library
    tried = f" ({'; '.join(problems)})" if problems else ""
    return f"Open Image Denoise was not found: this Blender has none. The package pyoidn brings it{tried}"


def problem() -> str:
    """Why nothing can be denoised; '' where it can."""
    library = _load()
    return library if isinstance(library, str) else ""


class Device:
    """The processor as Open Image Denoise uses it; a context manager, which frees it and its filters.

    Parameters
    ----------
    threads : int
        0 = all.

    Raises
    ------
    DenoiserMissing
        Where there is no library.
    DenoiserFailed
        If it does not work on this processor.
    """

    def __init__(self, threads: int = 0) -> None:
        library = _load()
        if isinstance(library, str):
            raise DenoiserMissing(library)
        self._library = library
        self._filters: list[Any] = []
        self._handle = library.oidnNewDevice(_DEVICE_CPU)
        if threads:
            library.oidnSetDeviceInt(self._handle, b"numThreads", threads)
        # Threads stay where the system wants them: others have work too.
        library.oidnSetDeviceBool(self._handle, b"setAffinity", False)
        library.oidnCommitDevice(self._handle)
        self._check()

    def __enter__(self) -> Device:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for handle in self._filters:
            self._library.oidnReleaseFilter(handle)
        self._library.oidnReleaseDevice(self._handle)

    def _check(self) -> bool:
        """Whether nothing was cancelled since the last check; raises for whatever else went wrong."""
        message = ctypes.c_char_p()
        code = self._library.oidnGetDeviceError(self._handle, ctypes.byref(message))
        if code not in (0, _ERROR_CANCELLED):
            text = (message.value or b"").decode(errors="replace")
            raise DenoiserFailed(f"Open Image Denoise: {text or f'error {code}'}")
        return code == 0

    def run(
        self, images: dict[str, np.ndarray], flags: dict[str, bool], quality: str,
        should_cancel: Callable[[], bool] | None = None,
    ) -> bool:
        """Run the filter for ray tracing.

        Parameters
        ----------
        images : dict of float32 (height, width, >= 3)
            By the filter's names; 'output' is written. Pixels may have more channels, which are left alone.
        flags : dict of bool
            Switches by the filter's names.
        quality : str
            One of QUALITIES.
        should_cancel : callable, optional
            Asked now and then, in a thread of the library.

        Returns
        -------
        bool
            False: it was cancelled, and the output is half done.

        Raises
        ------
        DenoiserFailed
        """
        library = self._library
        handle = library.oidnNewFilter(self._handle, b"RT")
        self._check()
        self._filters.append(handle)
        for name, image in images.items():
            height, width = image.shape[:2]
            row, pixel = image.strides[:2]
            library.oidnSetSharedFilterImage(
                handle, name.encode(), image.ctypes.data, _FORMAT_FLOAT3, width, height, 0, pixel, row
            )
        for name, is_on in flags.items():
            library.oidnSetFilterBool(handle, name.encode(), is_on)
        if quality == "FAST" and library.oidnGetDeviceInt(self._handle, b"version") < _FIRST_WITH_FAST:
            quality = "BALANCED"
        library.oidnSetFilterInt(handle, b"quality", QUALITIES[quality])
        # Kept until the filter has run: the library holds no reference to it.
        monitor = _ProgressMonitor(lambda _data, _share: not (should_cancel is not None and should_cancel()))
        if should_cancel is not None:
            library.oidnSetFilterProgressMonitorFunction(handle, monitor, None)
        library.oidnCommitFilter(handle)
        library.oidnExecuteFilter(handle)
        return self._check()
