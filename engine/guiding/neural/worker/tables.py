# SPDX-License-Identifier: GPL-3.0-or-later
"""A table of features in training: gradient, optimiser and running average, all by the engine's kernels."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.neural.networks.encoding import Encoding
from engine.guiding.neural.networks.grids import catch_up, step_table
from engine.guiding.neural.networks.mixture.features import MixtureEncoding
from engine.guiding.neural.worker.adam import BETAS, TABLE_EPSILON

_DECAY_POWERS = 1 << 10


class LearnedTable:
    """A hash grid, grids or planes in training on the CPU.

    Parameters
    ----------
    parameters : float32 (entries, features)
        Changed in place.
    backpropagate : kernel
        That of the encoding that reads the table: `backpropagate_positions` and others of its signature.
    level_count : int
    learning_rate : float
    first_column : int
        Where its features begin.
    average : float32 (entries, features) or None
        Running average of the parameters, changed in place; None: there is none.
    averaging : float
        Share of its past that the average keeps at every step.
    """

    def __init__(
        self, parameters: Float32Array, backpropagate: Callable[..., None], *, level_count: int, learning_rate: float,
        first_column: int = 0, average: Float32Array | None = None, averaging: float = 0.0,
    ) -> None:
        self.parameters = parameters
        self._backpropagate = backpropagate
        self._first_column = first_column
        self._level_count = level_count
        self._learning_rate = learning_rate
        self._average = parameters if average is None else average
        self._average_step = np.zeros(parameters.shape[0], np.int32)
        self._decay = (averaging ** np.arange(_DECAY_POWERS)).astype(np.float32)
        if average is None:
            self._decay[:] = 0.0
        self._gradient = np.zeros_like(parameters)
        self._moments = np.zeros_like(parameters), np.zeros_like(parameters)

    def step(
        self, encoding: Encoding | MixtureEncoding, position: Float32Array, u: Float32Array, gradient: Float32Array,
        step: int, over_ranges: Callable[[Callable[[int, int], None], int], None],
    ) -> None:
        """Carry the gradient of features on to the table, and step that.

        Parameters
        ----------
        position : float32 (N, 3) [m]; u : float32 (N,)
        gradient : float32 (N, features)
        step : int
            From 1.
        over_ranges : callable
            Calls its first argument with (start, stop) for ranges of the second, on all threads.
        """
        over_ranges(
            lambda first, last: self._backpropagate(
                encoding, position, u, position.shape[0], gradient, self._first_column, first, last, self._gradient
            ),
            self._level_count,
        )
        correction = math.sqrt(1.0 - BETAS[1] ** step) / (1.0 - BETAS[0] ** step)
        step_table(
            self.parameters, self._gradient, *self._moments, self._average, self._average_step, self._decay, step,
            np.float32(self._learning_rate * correction), np.float32(BETAS[0]), np.float32(BETAS[1]),
            np.float32(TABLE_EPSILON),
        )

    def catch_up(self, step: int) -> None:
        """Bring the running average of every entry to `step`."""
        catch_up(self.parameters, self._average, self._average_step, self._decay, step)
