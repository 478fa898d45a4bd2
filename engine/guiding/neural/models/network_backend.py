# SPDX-License-Identifier: GPL-3.0-or-later
"""By what a render asks its radiance network: the kernel, or onnxruntime."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from engine.array_types import Float32Array, Int64Array
from engine.guiding.neural.networks.onnx_session import PROVIDERS, RadianceSession, RuntimeProviders
from engine.guiding.neural.networks.perceptron import MAX_WIDTH, allocate_scratch
from engine.guiding.neural.networks.radiance import NetworkShape, Snapshot
from engine.guiding.neural.networks.radiance_query import NetworkField, predict_network
from engine.ris.candidates import CANDIDATE_ROWS
from engine.scene.description import Notice
from engine.settings import RenderSettings

#: Candidates of a vertex that `AUTO` asks both about, and how often.
_PER_VERTEX = 4
_REPEATS = 5


class Probe(NamedTuple):
    """Candidates to ask about: what `predict_network` takes of them."""

    positions: Float32Array
    time: Float32Array
    hero: Float32Array
    candidate_vertex: Int64Array
    directions: Float32Array


def make_probe(bounds: Float32Array, row_count: int, per_vertex: int = _PER_VERTEX) -> Probe:
    """Candidates at random positions within bounds float32 (2, 3) [m], so many a vertex; always the same ones."""
    rng = np.random.default_rng(0)
    vertex_count = -(-row_count // per_vertex)
    positions = bounds[0] + (bounds[1] - bounds[0]) * rng.random((vertex_count, 3))
    directions = rng.normal(size=(row_count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    instants, heroes = rng.random((2, vertex_count)).astype(np.float32)
    vertices = np.arange(row_count) // per_vertex
    return Probe(positions.astype(np.float32), instants, heroes, vertices, directions.astype(np.float32))


def kernel_call(field: NetworkField, probe: Probe, out: Float32Array) -> Callable[[], bool]:
    """A call of the kernel on candidates."""
    latent, scratch = np.zeros((2, MAX_WIDTH), np.float32), allocate_scratch(MAX_WIDTH)

    def ask() -> bool:
        predict_network(field, *probe, len(probe.directions), latent, scratch, out)
        return True

    return ask


def session_call(session: RadianceSession, probe: Probe, out: Float32Array) -> Callable[[], bool]:
    """A call of onnxruntime on the same candidates."""
    return lambda: session.predict(*probe, len(probe.positions), len(probe.directions), out)


def least_seconds(
    calls: Sequence[Callable[[], bool]], repeats: int = _REPEATS, clock: Callable[[], float] = time.perf_counter
) -> list[float]:
    """The least time [s] that each of some calls takes by a clock, in turns; infinite where one says False.

    A first call of each, which compiles or allocates, does not count.
    """
    least = [np.inf if not call() else 0.0 for call in calls]
    times = [[] if one == 0.0 else [one] for one in least]
    for _ in range(repeats):
        for call, taken in zip(calls, times, strict=True):
            started = clock()
            is_done = call()
            taken.append(clock() - started if is_done else np.inf)
    return [float(min(taken)) for taken in times]


class NetworkBackend:
    """What `network_backend` asks for, and what has become of it.

    Parameters
    ----------
    settings : RenderSettings
    shape : NetworkShape
    """

    def __init__(self, settings: RenderSettings, shape: NetworkShape) -> None:
        self._shape = shape
        self._providers = RuntimeProviders()
        # The clock must not decide where the image is to be the same every time.
        self._measures = settings.network_backend == "AUTO" and not settings.deterministic
        self._asks_runtime = settings.network_backend == "ONNXRUNTIME" or self._measures
        self._session: RadianceSession | None = None
        self._costs = ""

    def take(self, snapshot: Snapshot, field: NetworkField) -> RadianceSession | None:
        """What asks a snapshot, which `field` is the kernel's form of; None: the kernel.

        Raises
        ------
        ValueError
            If the snapshot is not valid.
        """
        self._session = None
        if self._asks_runtime:
            session = RadianceSession(self._providers, self._shape, snapshot)
            if session.provider and self._measures:
                self._measure(session, snapshot, field)
            if session.provider and self._asks_runtime:
                self._session = session
            else:
                self._asks_runtime = False
        return self._session

    def _measure(self, session: RadianceSession, snapshot: Snapshot, field: NetworkField) -> None:
        """Time both on a batch of candidates, once in a render, and go on with the faster one."""
        self._measures = False
        probe = make_probe(snapshot.bounds, CANDIDATE_ROWS)
        out = np.zeros((CANDIDATE_ROWS, self._shape.channel_count), np.float32)
        by_kernel, by_session = least_seconds([kernel_call(field, probe, out), session_call(session, probe, out)])
        self._asks_runtime = by_session < by_kernel
        scale = 1e6 / CANDIDATE_ROWS
        self._costs = f": {by_kernel * scale:.2f} us a candidate by the kernel, {by_session * scale:.2f} by onnxruntime"

    @property
    def words(self) -> str:
        """By what the network was asked last, and what both cost if that was measured."""
        provider = self._session.provider if self._session is not None else ""
        return (f"onnxruntime on {PROVIDERS[provider]}" if provider else "the kernel") + self._costs

    def take_notices(self) -> list[Notice]:
        """What failed since this was last asked."""
        failures, self._providers.failures = self._providers.failures, []
        instead = self._providers.best if failures else ""
        effect = f"the provider {PROVIDERS[instead]} is asked" if instead else "the kernel is asked"
        return [Notice("Guiding / radiance network", f"{failure.what}: {failure.why}", effect) for failure in failures]
