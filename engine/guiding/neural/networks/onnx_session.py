# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance network asked through onnxruntime: a session of a snapshot, on the best provider that works.

Nothing here raises while a render goes on. A provider that fails is not asked again in the render, and the next one is
taken; when none is left, whoever asked is told, and asks the kernel.
"""

from __future__ import annotations

import importlib
import re
import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from engine.array_types import Float32Array, Int64Array
from engine.guiding.neural.networks.onnx_files.files import StoredNetwork, network_to_onnx
from engine.guiding.neural.networks.radiance import NetworkShape, Snapshot
from engine.runtime.jit import kernel
from engine.spectral.wavelengths import WAVELENGTH_COUNT, hero_quarter

#: onnxruntime's providers in the order they are tried, and what people call them.
PROVIDERS = {
    "CUDAExecutionProvider": "CUDA",
    "DmlExecutionProvider": "DirectML",
    "CoreMLExecutionProvider": "CoreML",
    "OpenVINOExecutionProvider": "OpenVINO",
    "CPUExecutionProvider": "CPU",
}
#: The oldest onnxruntime that reads our models (`messages.OPSET`).
OLDEST = (1, 20)
#: Providers whose sessions take one call at a time.
_ONE_AT_A_TIME = frozenset({"DmlExecutionProvider"})
#: Of onnxruntime's log: what it has to say is in the exceptions.
_FATAL = 4


class Failure(NamedTuple):
    """Something that did not work: what, and why, each a part of a sentence."""

    what: str
    why: str


class RuntimeProviders:
    """What onnxruntime offers on this machine, as far as it has not failed in this render.

    Parameters
    ----------
    wanted : of PROVIDERS, in the order they are tried; those that are not installed are left out

    Attributes
    ----------
    failures : list of Failure
        What has failed since the list was last emptied.
    """

    def __init__(self, wanted: Sequence[str] = tuple(PROVIDERS)) -> None:
        self.failures: list[Failure] = []
        self._wanted = wanted
        self.lock = threading.Lock()
        self._remaining: list[str] | None = None
        self._runtime: Any = None

    @property
    def best(self) -> str:
        """The provider to take, a key of PROVIDERS; '' if there is none."""
        if self._remaining is None:
            self._remaining = self._find()
        return self._remaining[0] if self._remaining else ""

    def _find(self) -> list[str]:
        """Providers that are installed; none without an onnxruntime that will do."""
        try:
            self._runtime = importlib.import_module("onnxruntime")
            version = tuple(int(part) for part in re.findall(r"\d+", self._runtime.__version__)[:2])
            available = self._runtime.get_available_providers()
        except Exception as error:  # a package that is not whole may raise anything
            self.failures.append(Failure("onnxruntime cannot be loaded", _reason(error)))
            return []
        if version < OLDEST:
            oldest = ".".join(map(str, OLDEST))
            self.failures.append(
                Failure(f"onnxruntime {self._runtime.__version__} is too old", f"{oldest} or later reads the network")
            )
            return []
        return [name for name in self._wanted if name in available]

    def fail(self, provider: str, error: Exception) -> None:
        """Do without a provider from now on."""
        if self._remaining is not None and provider in self._remaining:
            self._remaining.remove(provider)
            self.failures.append(Failure(f"onnxruntime's provider {PROVIDERS[provider]} failed", _reason(error)))

    def open(self, provider: str, model: bytes) -> Any:
        """onnxruntime's session of a model.

        Raises
        ------
        Exception
            Whatever onnxruntime raises, and RuntimeError where it would quietly take another provider.
        """
        runtime = self._runtime
        options = runtime.SessionOptions()
        # The calling thread does the work: the renderer has one for each core already.
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = _FATAL
        if provider in _ONE_AT_A_TIME:
            options.enable_mem_pattern = False
        session = runtime.InferenceSession(model, options, providers=[provider])
        if provider not in session.get_providers():
            raise RuntimeError("onnxruntime does not take it here")
        return session


def _reason(error: Exception) -> str:
    """The first line of an exception, cut to what people read."""
    lines = str(error).strip().splitlines()
    return (lines[0] if lines else type(error).__name__)[:200]


class _Opened(NamedTuple):
    provider: str
    session: Any
    lock: threading.Lock | None


class RadianceSession:
    """A snapshot of the radiance network, ready to be asked by any number of threads.

    Parameters
    ----------
    providers : RuntimeProviders
        The render's.
    shape : NetworkShape
    snapshot : Snapshot

    Raises
    ------
    ValueError
        If the snapshot is not valid for `shape` (`Snapshot.validate`).
    """

    def __init__(self, providers: RuntimeProviders, shape: NetworkShape, snapshot: Snapshot) -> None:
        self._providers, self._shape = providers, shape
        self._model = network_to_onnx(StoredNetwork(shape, snapshot))
        self._local = threading.local()
        with providers.lock:
            self._opened = self._open()

    @property
    def provider(self) -> str:
        """The provider in use, a key of PROVIDERS; '' if none works: ask the kernel."""
        opened = self._opened
        return "" if opened is None else opened.provider

    def _open(self) -> _Opened | None:
        """The best provider that works, if any does. What is in use changes in one step: other threads go on by it."""
        while provider := self._providers.best:
            try:
                session = self._providers.open(provider, self._model)
            except Exception as error:  # onnxruntime raises classes of its own, and drivers what they like
                self._providers.fail(provider, error)
            else:
                return _Opened(provider, session, threading.Lock() if provider in _ONE_AT_A_TIME else None)
        return None

    def predict(
        self, positions: Float32Array, time: Float32Array, hero: Float32Array, candidate_vertex: Int64Array,
        directions: Float32Array, vertex_count: int, row_count: int, out: Float32Array,
    ) -> bool:
        """Incident radiance from candidate directions: `radiance_query.predict_network` through onnxruntime.

        Parameters
        ----------
        positions, time, hero, candidate_vertex, directions : arrays
            As `predict_network` takes them; C-contiguous.
        vertex_count, row_count : int
            Rows of the first three in use, and of the others.
        out : float32 (>= row_count, C), C-contiguous
            Its first rows are written.

        Returns
        -------
        bool
            False if no provider works; what is in `out` then is worth nothing.
        """
        if row_count == 0:
            return True
        while (opened := self._opened) is not None:
            try:
                self._run(opened, positions, time, hero, candidate_vertex, directions, vertex_count, row_count, out)
                return True
            except Exception as error:  # onnxruntime raises classes of its own, and drivers what they like
                with self._providers.lock:
                    # Another thread may have met the same failure before.
                    if self._opened is opened:
                        self._providers.fail(opened.provider, error)
                        self._opened = self._open()
        return False

    def _run(
        self, opened: _Opened, positions: Float32Array, time: Float32Array, hero: Float32Array, vertices: Int64Array,
        directions: Float32Array, vertex_count: int, row_count: int, out: Float32Array,
    ) -> None:
        shape, binding = self._shape, self._binding(opened)
        inputs: dict[str, np.ndarray] = {
            "position": positions[:vertex_count], "direction": directions[:row_count], "vertex": vertices[:row_count],
        }
        quarter = np.zeros(0, np.int64)
        if shape.by_quarter:
            quarter, u = np.zeros(vertex_count, np.int64), np.zeros(vertex_count, np.float32)
            _split_heroes(hero, vertex_count, quarter, u)
            inputs["u"] = u
        elif shape.u_width:
            inputs["u"] = time[:vertex_count]
        for name, array in inputs.items():
            binding.bind_input(name, "cpu", 0, array.dtype, array.shape, array.ctypes.data)
        binding.bind_output("radiance", "cpu", 0, np.float32, (row_count, shape.channel_count), out.ctypes.data)
        if opened.lock is None:
            opened.session.run_with_iobinding(binding)
        else:
            with opened.lock:
                opened.session.run_with_iobinding(binding)
        if shape.by_quarter:
            _rotate(quarter, vertices, row_count, out)

    def _binding(self, opened: _Opened) -> Any:
        """The calling thread's own."""
        local = self._local
        if getattr(local, "opened", None) is not opened:
            local.opened, local.binding = opened, opened.session.io_binding()
        return local.binding


@kernel
def _split_heroes(hero, vertex_count, quarter, offset):
    """Quarters of heroes, and how far within them."""
    for row in range(vertex_count):
        quarter[row], offset[row] = hero_quarter(hero[row])


@kernel
def _rotate(quarter, vertices, row_count, out):
    """Radiance by quarter (N, 4) to radiance by a path's own wavelengths, in place."""
    for row in range(row_count):
        first = quarter[vertices[row]]
        a, b, c, d = out[row, 0], out[row, 1], out[row, 2], out[row, 3]
        for index in range(WAVELENGTH_COUNT):
            place = (first + index) % WAVELENGTH_COUNT
            out[row, index] = a if place == 0 else (b if place == 1 else (c if place == 2 else d))
