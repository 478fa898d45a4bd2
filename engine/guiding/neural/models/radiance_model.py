# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance network as what weighs candidates: asked by a kernel, or through onnxruntime."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.neural.networks.onnx_session import RadianceSession
from engine.guiding.neural.networks.perceptron import MAX_WIDTH, allocate_scratch
from engine.guiding.neural.networks.radiance_query import NetworkField, predict_network
from engine.ris.candidates import Candidates
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel


class NetworkMemory(Bundle):
    """A network, and one thread's activations.

    latent, hidden : float32, as `predict_network` takes them
    """

    network: NetworkField
    latent: Float32Array
    hidden: Float32Array


@kernel
def predict_candidates(memory, candidates, vertex_count, row_count):
    """Fill `candidates.radiance` by the network."""
    predict_network(
        memory.network, candidates.position, candidates.time, candidates.hero, candidates.vertex,
        candidates.direction, row_count, memory.latent, memory.hidden, candidates.radiance,
    )


class RadianceModel:
    """A snapshot of the radiance network, ready to be asked (`engine.guiding.models.candidate_model.CandidateModel`).

    Parameters
    ----------
    field : NetworkField
    session : RadianceSession or None
        What asks the same network if not the kernel.
    """

    kernel: Callable[..., Any] = staticmethod(predict_candidates)

    def __init__(self, field: NetworkField, session: RadianceSession | None = None) -> None:
        self._field, self._session = field, session

    def memory(self, former: Bundle | None) -> NetworkMemory:
        """For one thread, with the scratch that it had."""
        if isinstance(former, NetworkMemory):
            return former._replace(network=self._field)
        return NetworkMemory(self._field, np.zeros((2, MAX_WIDTH), np.float32), allocate_scratch(MAX_WIDTH))

    @property
    def ask_elsewhere(self) -> Callable[[Candidates, int, int], bool] | None:
        """onnxruntime, where a provider works."""
        session = self._session
        if session is None or not session.provider:
            return None

        def ask(candidates: Candidates, vertex_count: int, row_count: int) -> bool:
            return session.predict(
                candidates.position, candidates.time, candidates.hero, candidates.vertex, candidates.direction,
                vertex_count, row_count, candidates.radiance,
            )

        return ask

    def predict(
        self, positions: Float32Array, time: Float32Array, hero: Float32Array, directions: Float32Array,
        out: np.ndarray,
    ) -> None:
        """Radiance from N directions at N vertices, by the kernel."""
        memory, count = self.memory(None), len(positions)
        predict_network(
            self._field, positions, time, hero, np.arange(count), directions, count, memory.latent, memory.hidden, out
        )
