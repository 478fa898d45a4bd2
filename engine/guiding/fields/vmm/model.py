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
from engine.guiding.fields.update import (
    PIECES_PER_THREAD,
    REJECT_WIDTH,
    Runner,
    UpdateReport,
    balance,
    chunk_count,
    grown,
    inherit,
    log_splits,
    make_runner,
    padded_bounds,
    places_by_region,
    run_chunks,
)
from engine.guiding.fields.vmm import fit, tree
from engine.guiding.fields.vmm.field import NEIGHBOR_COUNT, VmmField
from engine.guiding.fields.vmm.state import VmmState
from engine.guiding.records.light import Records
from engine.kernels.binary_tree import LEAF, NODE_AXIS, NODE_CHILD

_FIRST_CAPACITY = 64
#: Look-ups reach for half the distance to the neighbour of this rank.
_REACH_RANK = 3
REACH = 0.5
#: Records after which leaves are cut later, by the square root of how many more there are.
_EARLY_RECORDS = 1 << 20


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
    parameters = np.zeros(fit.PARAMETER_WIDTH)
    for field in fields(settings):
        index = getattr(fit, f"PARAMETER_{field.name.upper()}", None)
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
    split_log : int32 (S, 2)
        Regions made by the last update and the region each was cut from, in order.
    batch, batch_rows : float32 (M, SAMPLE_WIDTH), int64 (regions, 2)
        The last update's samples sorted by region, and each region's rows: for other models on the same regions.
    """

    def __init__(
        self, bounds: npt.ArrayLike, settings: VmmSettings | None = None, field: VmmField | None = None
    ) -> None:
        corners = padded_bounds(bounds)
        self.settings = settings or VmmSettings()
        self.region_count = 1
        self.split_log: Int32Array = np.zeros((0, 2), np.int32)
        self.batch: Float32Array = np.zeros((0, fit.SAMPLE_WIDTH), np.float32)
        self.batch_rows: Int64Array = np.zeros((1, 2), np.int64)
        self._totals = UpdateReport()
        self._parameters = _parameters(self.settings)
        self._start_lobes = fit.start_mixture(self.settings.initial_lobes, self.settings.initial_kappa)
        self._node_count = 1
        self._store = fit.allocate_store(_FIRST_CAPACITY)
        self._store.pivot[0] = corners.mean(0)
        self._region_leaf = np.zeros(_FIRST_CAPACITY, np.int32)
        self._tree = tree.TreeNodes(
            np.zeros(2 * _FIRST_CAPACITY, np.float32),
            np.zeros((2 * _FIRST_CAPACITY, 2), np.int32),
            np.zeros(2 * _FIRST_CAPACITY, np.int32),
            corners.astype(np.float32),
        )
        self._tree.node_link[0, NODE_AXIS] = LEAF
        self._tree.node_link[0, NODE_CHILD] = 0
        self._scratches: list[fit.FitScratch] = []
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
        model._tree, model._store, model._region_leaf = known.tree, known.store, known.region_leaf
        model._node_count, model.region_count = len(known.tree.node_split), len(known.region_leaf)
        model.batch_rows = np.zeros((model.region_count, 2), np.int64)
        model._totals.record_count = known.record_count
        if field is None:
            model.field = model._publish(make_runner(None, 1), 1)
        return model

    def state(self) -> State:
        """All that it knows, as arrays."""
        nodes, count, tree_nodes = self._node_count, self.region_count, self._tree
        return VmmState(
            tree.TreeNodes(
                tree_nodes.node_split[:nodes], tree_nodes.node_link[:nodes], tree_nodes.node_depth[:nodes],
                tree_nodes.bounds,
            ),
            fit.RegionStore(*(array[:count] for array in self._store)),
            self._region_leaf[:count],
            self._totals.record_count,
        ).arrays()

    def widen(self, bounds: npt.ArrayLike) -> None:
        """Reach as far as `bounds`, float (2, 3): the cells at the border grow. The next update publishes it."""
        corners = padded_bounds(bounds)
        old = self._tree.bounds
        wider = np.stack([np.minimum(old[0], corners[0]), np.maximum(old[1], corners[1])]).astype(np.float32)
        self._tree = self._tree._replace(bounds=wider)

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
        self._sort(records, row_count, run)
        self._grow_tree(row_count)
        self._fit(run, thread_count)
        self.field = self._publish(run, thread_count)
        self._totals.update_count += 1
        self._totals.record_count += row_count
        self._totals.seconds += time.perf_counter() - began

    def inherited(self, sums: np.ndarray, share: float) -> np.ndarray:
        """What another model has summed up by region, carried over the last update.

        Parameters
        ----------
        sums : array (R, ...), of the regions before the update
        share : float
            What a region that was cut passes to each of its halves.

        Returns
        -------
        array (region_count, ...), of the same type
        """
        return inherit(sums, self.split_log, self.region_count, share)

    def report(self) -> dict[str, float]:
        """Figures for the render's report: totals of all updates, and the state of the field."""
        ready = self.field.is_ready != 0
        totals = self._totals
        return {
            "regions": self.region_count,
            "regions_ready": int(ready.sum()),
            "lobes": float(self.field.lobe_count[ready].mean()) if ready.any() else 0.0,
            **totals.figures(),
        }

    def _sort(self, records: Records, row_count: int, run: Runner) -> None:
        """Write usable records to the batch, region by region."""
        region_of = np.empty(row_count, np.int32)
        counts = np.zeros((chunk_count(row_count), self.region_count), np.int32)
        rejects = np.zeros((len(counts), REJECT_WIDTH), np.int64)

        def classify(start: int, stop: int, chunk: int) -> None:
            tree.classify_records(records, start, stop, self._tree, region_of, counts, chunk, rejects)

        run_chunks(run, row_count, classify)
        offsets, self.batch_rows = places_by_region(counts)
        total = int(self.batch_rows[-1, 1])
        if self.batch.shape[0] < total:
            self.batch = np.zeros((total, fit.SAMPLE_WIDTH), np.float32)
        min_pdf = np.float32(self.settings.min_pdf)

        def scatter(start: int, stop: int, chunk: int) -> None:
            tree.scatter_records(records, start, stop, region_of, offsets, chunk, min_pdf, self.batch)

        run_chunks(run, row_count, scatter)
        self._totals.count_rejects(rejects)

    def _grow_tree(self, row_count: int) -> None:
        """Cut leaves that have seen enough, and give new regions what their parents know."""
        settings = self.settings
        wanted = self.region_count + 4 * row_count // settings.samples_per_region + 2
        self._reserve(min(wanted, max(settings.max_region_count, 1)))
        rows = grown(self.batch_rows, self._store.lobe_count.shape[0])
        parents = np.full(rows.shape[0], -1, np.int32)
        growth = max(self._totals.record_count / _EARLY_RECORDS, 1.0) ** 0.5
        limits = np.array([growth * settings.samples_per_region, settings.max_depth], np.float64)
        old_count = self.region_count
        self._node_count, self.region_count = tree.split_leaves(
            self.batch, self._tree, self._node_count, self._store.moments, rows, self._region_leaf, old_count,
            parents, limits,
        )
        self.batch_rows = np.ascontiguousarray(rows[: self.region_count])
        self.split_log = log_splits(parents, old_count, self.region_count)
        fit.copy_regions(self._store, self.split_log, settings.inherited_share)

    def _reserve(self, region_capacity: int) -> None:
        """Make room for this many regions and their nodes."""
        old = self._store.lobe_count.shape[0]
        if region_capacity <= old:
            return
        new = max(region_capacity, min(2 * old, self.settings.max_region_count))

        self._store = fit.RegionStore(*(grown(array, new) for array in self._store))
        self._region_leaf = grown(self._region_leaf, new)
        self._tree = tree.TreeNodes(
            grown(self._tree.node_split, 2 * new),
            grown(self._tree.node_link, 2 * new),
            grown(self._tree.node_depth, 2 * new),
            self._tree.bounds,
        )

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
            scratches.append(fit.allocate_scratch(largest))
        for index, scratch in enumerate(scratches):
            if scratch.samples.shape[0] < largest:
                scratches[index] = fit.allocate_scratch(2 * largest)

        def work(piece: int) -> None:
            fit.fit_regions(
                self.batch, self.batch_rows, busy, int(pieces[piece]), int(pieces[piece + 1]), self._store,
                self._start_lobes, self._parameters, scratches[piece],
            )

        run(work, pieces.size - 1)

    def _publish(self, run: Runner | None, thread_count: int) -> VmmField:
        """Copy what kernels need into a new field."""
        count, nodes, store = self.region_count, self._node_count, self._store
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
        grid, grid_scale = tree.make_grid(self._tree)
        fluence = totals[:, fit.TOTAL_FLUENCE] / np.maximum(totals[:, fit.TOTAL_COUNT], 1.0)
        return VmmField(
            self._tree.node_split[:nodes].copy(),
            self._tree.node_link[:nodes].copy(),
            self._tree.bounds,
            grid,
            grid_scale,
            store.lobes[:count].copy(),
            store.lobe_count[:count].copy(),
            pivot,
            fluence.astype(np.float32),
            is_ready,
            _reach(pivot, neighbors, neighbor_pivots),
            neighbors,
            neighbor_pivots,
        )
