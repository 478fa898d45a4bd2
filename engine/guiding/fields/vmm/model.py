# SPDX-License-Identifier: GPL-3.0-or-later
"""The field's host side: owns the tree and the regions' statistics, learns from records, publishes snapshots."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array, Int64Array
from engine.guiding.fields.state import State
from engine.guiding.fields.update import PIECES_PER_THREAD, Runner, balance, grown, make_runner, padded_bounds
from engine.guiding.fields.vmm import fit, tree
from engine.guiding.fields.vmm import store as columns
from engine.guiding.fields.vmm.field import NEIGHBOR_COUNT, VmmField
from engine.guiding.fields.vmm.regions import RegionTree
from engine.guiding.fields.vmm.state import VmmState, unsound_regions
from engine.guiding.fields.vmm.store import (
    PARAMETER_WIDTH,
    TOTAL_COUNT,
    TOTAL_FLUENCE,
    FitScratch,
    RegionStore,
    allocate_scratch,
    allocate_store,
    start_mixture,
)
from engine.guiding.records.light import Records

#: Look-ups reach for half the distance to the neighbour of this rank.
_REACH_RANK = 3
REACH = 0.5


@dataclass(frozen=True)
class VmmSettings:
    """How the field learns. Numbers are Open PGL's unless a comment says otherwise."""

    #: A leaf that has seen more samples than this is cut (Open PGL: 32000; our renders are short,
    #: docs/decisions/mixture-field.md).
    samples_per_region: int = 2000
    max_depth: int = 32
    max_region_count: int = 16384
    #: What a child keeps of its parent's statistics.
    inherited_share: float = 0.25
    first_iterations: int = 24
    #: Later iterations of a render come by themselves (two cost 2 to 4% more divergence than four, and half the time).
    max_iterations: int = 2
    tolerance: float = 0.005
    #: Open PGL: 16; in small cells fewer do as well, at half the cost of a look-up.
    initial_lobes: int = 8
    #: Wide lobes of 0.5 all stay alike for long, and end in worse optima.
    initial_kappa: float = 5.0
    weight_prior: float = 0.01
    #: Open PGL: 0.2, which keeps lobes of lamps too wide for too long.
    cosine_prior: float = 0.05
    max_kappa: float = 32000.0
    split_threshold: float = 0.5
    split_interval: int = 4000
    merge_threshold: float = 0.025
    merge_interval: int = 8000
    refit_iterations: int = 4
    min_samples: int = 8
    decay: float = 1.0
    statistics_limit: float = 32000.0
    #: Not in Open PGL: see `gather_samples`.
    weight_share: float = 0.02
    min_pdf: float = 0.01


def _parameters(settings: VmmSettings) -> npt.NDArray[np.float64]:
    parameters = np.zeros(PARAMETER_WIDTH)
    for field in fields(settings):
        index = getattr(columns, f"PARAMETER_{field.name.upper()}", None)
        if index is not None:
            parameters[index] = getattr(settings, field.name)
    return parameters


def _reach(pivot: Float32Array, neighbors: Int32Array, neighbor_pivots: Float32Array) -> Float32Array:
    """Half the distance to a region's third neighbour (the last, if there are fewer)."""
    last = np.clip((neighbors >= 0).sum(1) - 1, 0, _REACH_RANK)
    farthest = np.take_along_axis(neighbor_pivots, last[:, None, None], 2)[:, :, 0]
    distance = np.linalg.norm(farthest - pivot, axis=1)
    return np.where(last > 0, REACH * distance, 0.0).astype(np.float32)


class VmmModel:
    """A mixture field that learns from records.

    Parameters
    ----------
    bounds : float (2, 3)
        Lowest and highest corner of the scene; a little is added. Records outside are left out, look-ups find nothing.
    settings : VmmSettings
    field : VmmField, optional
        That of the model, for who has it already (`of_state`).

    Attributes
    ----------
    field : VmmField
        What kernels read; every update makes a new one and leaves the old as it was.
    regions : RegionTree
        For other models on the same regions too.
    """

    def __init__(
        self, bounds: npt.ArrayLike, settings: VmmSettings | None = None, field: VmmField | None = None
    ) -> None:
        self.settings = settings = settings or VmmSettings()
        self.regions = RegionTree(
            bounds, samples_per_region=settings.samples_per_region, max_depth=settings.max_depth,
            max_region_count=settings.max_region_count, min_pdf=settings.min_pdf,
        )
        self._parameters = _parameters(settings)
        self._start_lobes = start_mixture(settings.initial_lobes, settings.initial_kappa)
        self._store = allocate_store(self.regions.capacity)._replace(moments=self.regions.moments)
        self._store.pivot[0] = padded_bounds(bounds).mean(0)
        self._scratches: list[FitScratch] = []
        self.field = self._publish(None, 1) if field is None else field

    @classmethod
    def of_state(
        cls, state: State, settings: VmmSettings | None = None, field: VmmField | None = None
    ) -> VmmModel:
        """The model that `state` was asked of; it goes on learning as that one would.

        Parameters
        ----------
        state : State
        settings : VmmSettings, optional
        field : VmmField, optional
            What an earlier model of this very state has published: it is not made again.

        Raises
        ------
        StateError
            If the arrays are no state of a model.
        """
        settings = settings or VmmSettings()
        known = VmmState.of_arrays(state, settings.max_kappa)
        model = cls(known.tree.bounds, settings, field)
        model.regions.resume(known.tree, known.region_leaf, known.store.moments, known.record_count)
        model._store = known.store
        if field is None:
            model.field = model._publish(make_runner(None, 1), 1)
        return model

    def state(self) -> State:
        """All that it knows, as arrays."""
        regions, count = self.regions, self.region_count
        return VmmState(
            regions.nodes_in_use,
            RegionStore(*(array[:count] for array in self._store)),
            regions.region_leaf[:count],
            regions.report.record_count,
        ).arrays()

    def widen(self, bounds: npt.ArrayLike) -> None:
        """Reach as far as `bounds`, float (2, 3): the cells at the border grow. The next update publishes it."""
        self.regions.widen(bounds)

    @property
    def region_count(self) -> int:
        """How many regions there are."""
        return self.regions.region_count

    @property
    def split_log(self) -> Int32Array:
        """`RegionTree.split_log`."""
        return self.regions.split_log

    @property
    def batch(self) -> Float32Array:
        """`RegionTree.batch`."""
        return self.regions.batch

    @property
    def batch_rows(self) -> Int64Array:
        """`RegionTree.batch_rows`."""
        return self.regions.batch_rows

    def update(
        self, records: Records, row_count: int, executor: ThreadPoolExecutor | None = None, thread_count: int = 1
    ) -> None:
        """Learn from the first `row_count` rows of `records` and publish a new field.

        The result depends on the records and their order, not on the threads.

        Parameters
        ----------
        records : Records
        row_count : int
        executor : ThreadPoolExecutor or None
            None: all in this thread.
        thread_count : int
            How many of the executor's threads to use.
        """
        began = time.perf_counter()
        run = make_runner(executor, thread_count)
        self.regions.update(records, row_count, run)
        self._follow_cuts()
        self._fit(run, thread_count)
        self._forget_unsound()
        self.field = self._publish(run, thread_count)
        self.regions.report.seconds += time.perf_counter() - began

    def inherited(self, sums: np.ndarray, share: float) -> np.ndarray:
        """As `RegionTree.inherited`."""
        return self.regions.inherited(sums, share)

    def report(self) -> dict[str, float]:
        """Figures for the render's report: totals of all updates, and the state of the field."""
        ready = self.field.is_ready != 0
        return {
            "regions": self.region_count,
            "regions_ready": int(ready.sum()),
            "lobes": float(self.field.lobe_count[ready].mean()) if ready.any() else 0.0,
            **self.regions.report.figures(),
        }

    def _follow_cuts(self) -> None:
        """Make room for new regions, and give them what their parents know."""
        capacity = self.regions.capacity
        if capacity > self._store.lobe_count.shape[0]:
            self._store = RegionStore(*(grown(array, capacity) for array in self._store))
        self._store = self._store._replace(moments=self.regions.moments)
        fit.copy_regions(self._store, self.split_log, self.settings.inherited_share)

    def _fit(self, run: Runner, thread_count: int) -> None:
        """Fit every region that has new samples."""
        sizes = self.batch_rows[:, 1] - self.batch_rows[:, 0]
        busy = np.flatnonzero(sizes > 0).astype(np.int32)
        if busy.size == 0:
            return
        largest = int(sizes.max())
        pieces = balance(sizes[busy], PIECES_PER_THREAD * thread_count)
        scratches = self._scratches
        while len(scratches) < pieces.size - 1:
            scratches.append(allocate_scratch(largest))
        for index, scratch in enumerate(scratches):
            if scratch.samples.shape[0] < largest:
                scratches[index] = allocate_scratch(2 * largest)

        def work(piece: int) -> None:
            fit.fit_regions(
                self.batch, self.batch_rows, busy, int(pieces[piece]), int(pieces[piece + 1]), self._store,
                self._start_lobes, self._parameters, scratches[piece],
            )

        run(work, pieces.size - 1)

    def _forget_unsound(self) -> None:
        """Have regions begin anew whose fit has come to nothing: kernels would draw directions from no density, and
        the picture would lack what they bring.
        """
        rows = RegionStore(*(array[: self.region_count] for array in self._store))
        unsound = np.flatnonzero(unsound_regions(rows, self.settings.max_kappa))
        for array in rows if unsound.size else ():
            array[unsound] = 0
        self.regions.report.unsound_count += unsound.size

    def _publish(self, run: Runner | None, thread_count: int) -> VmmField:
        """Copy what kernels need into a new field."""
        count, store, nodes = self.region_count, self._store, self.regions.published
        neighbors = np.full((count, NEIGHBOR_COUNT), -1, np.int32)
        neighbor_pivots = np.zeros((count, 3, NEIGHBOR_COUNT), np.float32)
        is_ready = store.is_ready[:count].copy()
        pivot = store.pivot[:count].copy()
        if run is not None:
            pieces = np.linspace(0, count, min(PIECES_PER_THREAD * thread_count, count) + 1).astype(int)

            def work(piece: int) -> None:
                tree.find_neighbors(
                    pivot, is_ready, int(pieces[piece]), int(pieces[piece + 1]), neighbors, neighbor_pivots
                )

            run(work, pieces.size - 1)
        totals = store.totals[:count]
        fluence = totals[:, TOTAL_FLUENCE] / np.maximum(totals[:, TOTAL_COUNT], 1.0)
        return VmmField(
            nodes.node_split,
            nodes.node_link,
            nodes.bounds,
            nodes.grid,
            nodes.grid_scale,
            store.lobes[:count].copy(),
            store.lobe_count[:count].copy(),
            pivot,
            fluence.astype(np.float32),
            is_ready,
            _reach(pivot, neighbors, neighbor_pivots),
            neighbors,
            neighbor_pivots,
        )
