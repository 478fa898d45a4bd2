# SPDX-License-Identifier: GPL-3.0-or-later
"""Learns what directions are drawn from, where that is not the mixture field: one interface for trees and networks."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from engine.guiding.records.vertices import VertexRecords
from engine.runtime.bundle import Bundle
from engine.scene.description import Notice


class SourceModel:
    """Learns a field that directions are drawn from, by the records of each iteration; this one learns nothing.

    Attributes
    ----------
    field : Bundle or None
        What has been learned; None while nothing has.
    seconds : float
        Processor time of learning in other processes [s].
    notices : list of Notice
        For the user; who reads them clears them.
    is_asynchronous : bool
        Learning goes on beside the render, so that the image depends on the clock.
    has_stand_in : bool
        The mixture field guides while there is no field, and goes on if this one is given up.
    """

    is_asynchronous = False
    has_stand_in = False

    def __init__(self) -> None:
        self.field: Bundle | None = None
        self.seconds = 0.0
        self.notices: list[Notice] = []

    @property
    def step_count(self) -> int:
        """Steps of training so far, of what a process trains."""
        return 0

    @property
    def is_learning(self) -> bool:
        """Whether a process trains it that has not yet learned all that there is to learn from."""
        return False

    def learn(
        self, records: VertexRecords, row_count: int, samples: float, recorded_share: float,
        executor: ThreadPoolExecutor, thread_count: int,
    ) -> None:
        """Learn from the records of `samples` samples a pixel, of which a share of the paths was recorded."""

    def rehearse(self, records: VertexRecords, row_count: int, executor: ThreadPoolExecutor) -> None:
        """Load (or compile) the kernels of learning."""

    def describe(self) -> str:
        """What was learned, in a line for people."""
        return ""

    def close(self) -> None:
        """Stop learning; what was learned stays."""


class TrainedSource(SourceModel):
    """A network that was trained before the render; it learns nothing more.

    Parameters
    ----------
    field : Bundle or None
        None: the mixture field guides.
    u_dimension : str
        What the network knows, 'TIME' or 'NONE' (`engine.settings.U_DIMENSIONS`).
    description : str
        What was trained, in a line for people.
    """

    has_stand_in = True

    def __init__(self, field: Bundle | None, u_dimension: str, description: str = "") -> None:
        super().__init__()
        self.field = field
        self.u_dimension = u_dimension
        self._description = description

    def describe(self) -> str:
        return self._description
