# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions of space that records fall into: cut where there are many, and never given up."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array, Int64Array
from engine.guiding.fields.update import (
    REJECT_WIDTH,
    Runner,
    UpdateReport,
    chunk_count,
    grown,
    inherit,
    log_splits,
    padded_bounds,
    places_by_region,
    run_chunks,
)
from engine.guiding.fields.vmm import tree
from engine.guiding.fields.vmm.store import MOMENT_WIDTH, SAMPLE_WIDTH
from engine.guiding.records.light import Records
from engine.kernels.binary_tree import LEAF, NODE_AXIS, NODE_CHILD
from engine.runtime.bundle import Bundle

_FIRST_CAPACITY = 64
#: Records after which leaves are cut later, by the square root of how many more there are.
_EARLY_RECORDS = 1 << 20


class RegionNodes(Bundle):
    """Where regions are, as kernels look them up (`engine.kernels.binary_tree`).

    node_split : float32 (N,)
    node_link : int32 (N, 2)
    bounds : float32 (2, 3)
    grid : int32 (GRID_SIDE**3,)
    grid_scale : float32 (3,)
    """

    node_split: Float32Array
    node_link: Int32Array
    bounds: Float32Array
    grid: Int32Array
    grid_scale: Float32Array


class RegionTree:
    """Regions that grow in number with the records that they have seen.

    Parameters
    ----------
    bounds : float (2, 3)
        Lowest and highest corner of the scene; a little is added. Records outside are left out.
    samples_per_region : int
        A leaf that has seen more records than this is cut.
    max_depth, max_region_count : int
    min_pdf : float [sr^-1]
        A sample's weight divides by no less.

    Attributes
    ----------
    region_count : int
    nodes : tree.TreeNodes, with room for more than there are
    node_count : int
    region_leaf : int32 (capacity,), each region's node
    moments : float64 (capacity, MOMENT_WIDTH), of each region's positions
    split_log : int32 (S, 2)
        Regions made by the last update and the region each was cut from, in order.
    batch, batch_rows : float32 (M, SAMPLE_WIDTH), int64 (regions, 2)
        The last update's samples sorted by region, and each region's rows.
    report : UpdateReport
        Who updates it adds the time.
    """

    def __init__(
        self, bounds: npt.ArrayLike, *, samples_per_region: int = 2000, max_depth: int = 32,
        max_region_count: int = 16384, min_pdf: float = 0.01,
    ) -> None:
        self._samples_per_region, self._max_depth, self._max_region_count = (
            samples_per_region, max_depth, max_region_count
        )
        self._min_pdf = np.float32(min_pdf)
        self.region_count = self.node_count = 1
        self.split_log: Int32Array = np.zeros((0, 2), np.int32)
        self.batch: Float32Array = np.zeros((0, SAMPLE_WIDTH), np.float32)
        self.batch_rows: Int64Array = np.zeros((1, 2), np.int64)
        self.report = UpdateReport()
        self.moments = np.zeros((_FIRST_CAPACITY, MOMENT_WIDTH))
        self.region_leaf = np.zeros(_FIRST_CAPACITY, np.int32)
        self.nodes = tree.TreeNodes(
            np.zeros(2 * _FIRST_CAPACITY, np.float32),
            np.zeros((2 * _FIRST_CAPACITY, 2), np.int32),
            np.zeros(2 * _FIRST_CAPACITY, np.int32),
            padded_bounds(bounds).astype(np.float32),
        )
        self.nodes.node_link[0, NODE_AXIS] = LEAF
        self.nodes.node_link[0, NODE_CHILD] = 0
        self._published: RegionNodes | None = None

    def resume(self, nodes: tree.TreeNodes, region_leaf: Int32Array, moments: np.ndarray, record_count: int) -> None:
        """Go on from what another tree knew; all is in use."""
        self.nodes, self.region_leaf, self.moments = nodes, region_leaf, moments
        self.node_count, self.region_count = len(nodes.node_split), len(region_leaf)
        self.batch_rows = np.zeros((self.region_count, 2), np.int64)
        self.report.record_count = record_count
        self._published = None

    @property
    def capacity(self) -> int:
        """Regions that there is room for."""
        return len(self.moments)

    @property
    def nodes_in_use(self) -> tree.TreeNodes:
        """The nodes without the room for more."""
        count, nodes = self.node_count, self.nodes
        return tree.TreeNodes(
            nodes.node_split[:count], nodes.node_link[:count], nodes.node_depth[:count], nodes.bounds
        )

    @property
    def published(self) -> RegionNodes:
        """What kernels read; every update makes a new one and leaves the old as it was."""
        if self._published is None:
            grid, grid_scale = tree.make_grid(self.nodes)
            used = self.nodes_in_use
            self._published = RegionNodes(
                used.node_split.copy(), used.node_link.copy(), used.bounds, grid, grid_scale
            )
        return self._published

    def widen(self, bounds: npt.ArrayLike) -> None:
        """Reach as far as `bounds`, float (2, 3): the cells at the border grow. The next update publishes it."""
        corners = padded_bounds(bounds)
        old = self.nodes.bounds
        wider = np.stack([np.minimum(old[0], corners[0]), np.maximum(old[1], corners[1])]).astype(np.float32)
        self.nodes = self.nodes._replace(bounds=wider)

    def update(self, records: Records, row_count: int, run: Runner) -> None:
        """Sort the first `row_count` rows of `records` into regions, and cut those that have seen enough."""
        self._sort(records, row_count, run)
        self._grow(row_count)
        self.report.update_count += 1
        self.report.record_count += row_count
        self._published = None

    def inherited(self, sums: np.ndarray, share: float) -> np.ndarray:
        """What a model has summed up by region, carried over the last update.

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

    def _sort(self, records: Records, row_count: int, run: Runner) -> None:
        """Write usable records to the batch, region by region."""
        region_of = np.empty(row_count, np.int32)
        counts = np.zeros((chunk_count(row_count), self.region_count), np.int32)
        rejects = np.zeros((len(counts), REJECT_WIDTH), np.int64)

        def classify(start: int, stop: int, chunk: int) -> None:
            tree.classify_records(records, start, stop, self.nodes, region_of, counts, chunk, rejects)

        run_chunks(run, row_count, classify)
        offsets, self.batch_rows = places_by_region(counts)
        total = int(self.batch_rows[-1, 1])
        if self.batch.shape[0] < total:
            self.batch = np.zeros((total, SAMPLE_WIDTH), np.float32)

        def scatter(start: int, stop: int, chunk: int) -> None:
            tree.scatter_records(records, start, stop, region_of, offsets, chunk, self._min_pdf, self.batch)

        run_chunks(run, row_count, scatter)
        self.report.count_rejects(rejects)

    def _grow(self, row_count: int) -> None:
        """Cut leaves that have seen enough."""
        wanted = self.region_count + 4 * row_count // self._samples_per_region + 2
        self._reserve(min(wanted, max(self._max_region_count, 1)))
        rows = grown(self.batch_rows, self.capacity)
        parents = np.full(rows.shape[0], -1, np.int32)
        growth = max(self.report.record_count / _EARLY_RECORDS, 1.0) ** 0.5
        limits = np.array([growth * self._samples_per_region, self._max_depth], np.float64)
        old_count = self.region_count
        self.node_count, self.region_count = tree.split_leaves(
            self.batch, self.nodes, self.node_count, self.moments, rows, self.region_leaf, old_count, parents, limits
        )
        self.batch_rows = np.ascontiguousarray(rows[: self.region_count])
        self.split_log = log_splits(parents, old_count, self.region_count)

    def _reserve(self, region_capacity: int) -> None:
        """Make room for this many regions and their nodes."""
        old = self.capacity
        if region_capacity <= old:
            return
        new = max(region_capacity, min(2 * old, self._max_region_count))
        self.moments, self.region_leaf = grown(self.moments, new), grown(self.region_leaf, new)
        self.nodes = tree.TreeNodes(
            grown(self.nodes.node_split, 2 * new),
            grown(self.nodes.node_link, 2 * new),
            grown(self.nodes.node_depth, 2 * new),
            self.nodes.bounds,
        )
