# SPDX-License-Identifier: GPL-3.0-or-later
"""What weighs candidates where neither a table nor the mixture does, as renders see it: they do not know what it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from engine.array_types import Float32Array
from engine.ris.candidates import Candidates
from engine.runtime.bundle import Bundle


class CandidateModel(Protocol):
    """Predicts the radiance that arrives along candidates; immutable, for any number of threads.

    Kernels of the main loop pass on what it gives as something opaque. Only `kernel` is compiled for its type.
    """

    @property
    def kernel(self) -> Callable[..., Any]:
        """Kernel (memory, candidates, vertex_count, row_count), which fills the first rows of `candidates.radiance`."""

    def memory(self, former: Bundle | None) -> Bundle:
        """What `kernel` takes first, for one thread.

        Parameters
        ----------
        former : Bundle or None
            What that thread had of another model; its scratch may be used again.
        """

    @property
    def ask_elsewhere(self) -> Callable[[Candidates, int, int], bool] | None:
        """Plain function (candidates, vertex_count, row_count) that does what `kernel` does; None: nothing else does.

        It returns False where it could not.
        """

    def predict(
        self, positions: Float32Array, time: Float32Array, hero: Float32Array, directions: Float32Array,
        out: np.ndarray,
    ) -> None:
        """Radiance from N directions at N vertices, called from Python.

        Parameters
        ----------
        positions, directions : float32 (N, 3), world [m], and unit
        time, hero : float32 (N,), of their paths, in [0, 1]
        out : float32 (N, C), written
        """
