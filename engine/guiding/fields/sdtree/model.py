# SPDX-License-Identifier: GPL-3.0-or-later
"""The SD-tree's host side: owns both trees and what they gather, learns from records, publishes snapshots.

What a quadtree is to be in proportion to. Guiding alone shall draw directions at a vertex, with density g, and a record
is a path of which the scattering has drawn wi with density p: its contribution to the pixel is C = T f_cos L / p, T the
throughput before, L an estimate of the incident radiance.

- Plain (Müller et al. 2017): g ~ E[L]. The estimate of its integral over a cell is the sum of L / p of the records in
  the cell.
- Variance-aware (Rath et al. 2020, the form for guides that know neither wo nor the BSDF): the second moment of the
  pixel's estimate, over the squared pixel value I^2, is the mean over paths of the integral of t^2(wi) / g(wi), with
  t^2 = E[(T f_cos L / I)^2]. It is least for g ~ t: the root of the second moment, marginalised over all that varies at
  vertices of a region. Records bring C^2 / I^2 (`VertexRecords.contribution_squared`) = (T f_cos L / I)^2 / p^2, and
  with p the chance to draw wi, the estimate of the integral of t^2 over a cell is the sum of p C^2 / I^2: one p more
  than in the plain tree, whose estimates are divided by p once. Within a cell g is constant, and the best share of a
  cell of solid angle A is sqrt(A times that sum), as in the paper. No cosine, no BSDF is divided out, and no mixture
  with the BSDF is reckoned with: the paper's own estimator accounts for what its mixture sampling did.

What an update adds is taken over its mean: the scale of I may change from one to the next (there is no pixel value
before the first), and squares of it stay within float32.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array, Int64Array
from engine.guiding.fields.sdtree import quadtree, space
from engine.guiding.fields.sdtree.field import QUAD_LEAF, SPLIT_WIDTH, SdTreeField
from engine.guiding.fields.sdtree.quadtree import QuadPool
from engine.guiding.fields.sdtree.query import find_sdtree_regions
from engine.guiding.fields.sdtree.refining import empty_pool, refine
from engine.guiding.fields.sdtree.space import SpaceTree
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
from engine.guiding.records.vertices import VertexRecords
from engine.kernels.binary_tree import LEAF, NODE_AXIS
from engine.kernels.rng import hash_combine

_FIRST_CAPACITY = 64
_MAX_REGIONS = 8192
#: Samples a pixel of a pass, for which the papers' thresholds are meant.
_PASS_SAMPLES = 4.0
#: An iteration longer than the last by this factor replaces what was known.
_LONGER = 1.5
#: Else it replaces this share.
_FORGOTTEN = 0.25


def _box(bounds: npt.ArrayLike) -> tuple[Float32Array, Float32Array]:
    """Bounds with a little margin, and the cube on them: float32 (2, 3) each."""
    box = padded_bounds(bounds).astype(np.float32)
    return box, np.stack([box[0], box[0] + (box[1] - box[0]).max()])


def _with_room(old: SpaceTree, region_capacity: int) -> SpaceTree:
    """The same tree with room for this many regions and their nodes."""
    if region_capacity <= len(old.region_node):
        return old
    count = max(region_capacity, min(2 * len(old.region_node), _MAX_REGIONS))
    return SpaceTree(
        grown(old.node_split, 2 * count), grown(old.node_link, 2 * count), old.bounds, old.box,
        grown(old.extent, count), grown(old.corner, count), grown(old.region_node, count),
    )


class SdTreeModel:
    """A spatial tree of directional quadtrees that learns from records.

    Two sets of quadtrees: one gathers, and at the end of an update becomes the published one, as it is; the next one to
    gather is refined from it. So the shape of a quadtree does not go by the newest records that fill it.

    Müller et al. throw away what was gathered when an iteration ends, as the next is as long as all before. Here
    iterations stop growing: then most of it is kept, as much as of four iterations, once the trees have taken shape. It
    fades all the same, since what a quadrant held before it was divided is spread evenly over its parts. Where few new
    records came, little is forgotten.

    Parameters
    ----------
    bounds : float (2, 3)
        Lowest and highest corner of the scene; a little is added. Records outside are left out, look-ups find nothing.
    spatial_threshold : float
        c: cells with more than c sqrt(S / 4) records are halved, S being the samples a pixel by which they came.
        Rath et al. 2020: 2000 for variance-aware trees.
    flux_share : float
        Quadrants with more than this share of the sphere's energy are divided. Rath et al. 2020: 0.005.
    max_quadtree_depth : int
    is_variance_aware : bool
    filters : bool
        Whether records are spread over their surroundings, in space and direction (Müller 2019).
    seed : int

    Attributes
    ----------
    field : SdTreeField
        What kernels read; every update makes a new one and leaves the old as it was.
    region_count : int
    split_log : int32 (S, 2)
        Regions made by the last update and the region each was cut from, in order.
    """

    def __init__(
        self, bounds: npt.ArrayLike, *, spatial_threshold: float = 12000.0, flux_share: float = 0.01,
        max_quadtree_depth: int = 20, is_variance_aware: bool = False, filters: bool = True, seed: int = 0,
    ) -> None:  # fmt: skip
        if not (spatial_threshold > 0.0 and flux_share > 0.0 and 1 <= max_quadtree_depth <= 20):
            raise ValueError("SD-tree thresholds must be positive, and its depth in 1 to 20")
        corners, box = _box(bounds)
        self.region_count = 1
        self.split_log: Int32Array = np.zeros((0, 2), np.int32)
        self._threshold = spatial_threshold
        self._flux_share = flux_share
        self._max_depth = max_quadtree_depth
        self._is_variance_aware = is_variance_aware
        self._filters = filters
        self._seed = seed
        self._samples = 0.0
        self._last_samples = 0.0
        self._report = UpdateReport()
        self._node_count = 1
        self._space = SpaceTree(
            np.zeros(2 * _FIRST_CAPACITY, np.float32), np.zeros((2 * _FIRST_CAPACITY, 2), np.int32), corners, box,
            np.zeros((_FIRST_CAPACITY, 3), np.float32), np.zeros((_FIRST_CAPACITY, 2, 3), np.float32),
            np.zeros(_FIRST_CAPACITY, np.int32),
        )  # fmt: skip
        self._space.node_link[0, NODE_AXIS] = LEAF
        self._space.corner[0] = box
        self._space.extent[0] = box[1] - box[0]
        self._totals = np.zeros((1, quadtree.TOTAL_WIDTH))
        # As fine as even light would have it.
        whole = QuadPool(
            np.array([0, 1], np.int32), np.full((1, 4), QUAD_LEAF, np.int32), np.zeros((1, 4), np.float32),
            np.zeros((1, 4), np.float32),
        )  # fmt: skip
        run = make_runner(None, 1)
        pieces = self._pieces(np.diff(whole.root), 1)
        self._pool = refine(whole, np.full((1, 4), 0.25), flux_share, max_quadtree_depth, run, pieces)
        self.field = self._publish(run, 1)

    def update(
        self, records: VertexRecords, row_count: int, samples: float, executor: ThreadPoolExecutor | None = None,
        thread_count: int = 1,
    ) -> None:  # fmt: skip
        """Learn from the first `row_count` rows of `records`, an iteration, and publish a new field.

        The result depends on the records and their order, not on the threads.

        Parameters
        ----------
        records : VertexRecords
        row_count : int
        samples : float
            Samples a pixel by which the records came; where only some paths are recorded, times their share.
        executor : ThreadPoolExecutor or None
            None: all in this thread.
        thread_count : int
            How many of the executor's threads to use.
        """
        if not 0.0 < samples < np.inf:
            raise ValueError(f"samples must be positive, not {samples}")
        began = time.perf_counter()
        run = make_runner(executor, thread_count)
        key = np.uint32(hash_combine(np.uint32(self._seed & 0xFFFFFFFF), np.uint32(self._report.update_count)))
        region_of, order, rows = self._sort(records, row_count, run)
        source, share = self._split(records, order, rows, samples)
        self._inherit(source, share, run, thread_count)
        batch, rows = self._gather(records, region_of, key, run)
        self._splat(batch, rows, run, thread_count)
        self.field = self._publish(run, thread_count)
        self._report.update_count += 1
        self._report.record_count += row_count
        self._report.seconds += time.perf_counter() - began

    def region_of(self, positions: npt.ArrayLike) -> Int32Array:
        """Region that each of positions (P, 3) lies in, -1 = outside: int32 (P,)."""
        points = np.ascontiguousarray(positions, np.float32).reshape(-1, 3)
        found = np.empty(len(points), np.int32)
        find_sdtree_regions(self.field, points, found)
        return found

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
        totals = self._report
        return {
            "regions": self.region_count,
            "regions_ready": int((self.field.is_ready != 0).sum()),
            "quadtree_nodes": len(self.field.quad_split),
            **totals.figures(),
        }

    def _pieces(self, sizes: np.ndarray, thread_count: int) -> Int64Array:
        return balance(sizes.astype(np.int64) + 1, PIECES_PER_THREAD * thread_count)

    def _sort(
        self, records: VertexRecords, row_count: int, run: Runner
    ) -> tuple[Int32Array, Int32Array, Int64Array]:
        """Region of each record, usable records in the order of regions, and each region's rows of those."""
        region_of = np.empty(row_count, np.int32)
        counts = np.zeros((chunk_count(row_count), self.region_count), np.int32)
        rejects = np.zeros((len(counts), REJECT_WIDTH), np.int64)

        def classify(start: int, stop: int, chunk: int) -> None:
            space.classify_records(
                records, start, stop, self._space, self._is_variance_aware, region_of, counts, chunk, rejects
            )

        run_chunks(run, row_count, classify)
        self._report.count_rejects(rejects)
        order, rows = self._order(region_of, counts, run)
        return region_of, order, rows

    def _order(self, region_of: Int32Array, counts: Int32Array, run: Runner) -> tuple[Int32Array, Int64Array]:
        """Rows of records in the order of regions, and each region's part, from counts by chunk and region."""
        offsets, rows = places_by_region(counts)
        order = np.empty(int(rows[-1, 1]), np.int32)

        def place(start: int, stop: int, chunk: int) -> None:
            space.order_records(start, stop, region_of, offsets, chunk, order)

        run_chunks(run, len(region_of), place)
        return order, rows

    def _split(
        self, records: VertexRecords, order: Int32Array, rows: Int64Array, samples: float
    ) -> tuple[Int32Array, Float32Array]:
        """Halve cells with many records; the old region that each region comes from, and what it keeps of its sums."""
        is_longer = samples > _LONGER * self._last_samples
        # The first records know no pixel value: their second moments are those of bright pixels.
        is_longer |= self._is_variance_aware and self._report.update_count == 1
        forgotten = 1.0 if is_longer else _FORGOTTEN
        self._samples = samples + (1.0 - forgotten) * self._samples
        self._last_samples = samples
        limit = self._threshold * (self._samples / _PASS_SAMPLES) ** 0.5
        count = self.region_count
        new = rows[:, 1] - rows[:, 0]
        known = self._totals[:, quadtree.TOTAL_COUNT]
        kept = 1.0 - forgotten * np.minimum(2.0 * new / np.maximum(known, 1.0), 1.0)
        capacity = min(count + 4 * int(len(order) / limit) + 128, _MAX_REGIONS)
        self._space = _with_room(self._space, capacity)
        room = max(capacity, count)
        source = grown(np.arange(count, dtype=np.int32), room)
        share = grown(kept.astype(np.float32), room)
        parents = np.zeros(room, np.int32)
        self._node_count, self.region_count = space.split_cells(
            records.position, order, grown(rows, room), self._space, self._node_count, count,
            grown(known * kept, room), source, share, parents, limit,
        )  # fmt: skip
        self.split_log = log_splits(parents, count, self.region_count)
        return source[: self.region_count].copy(), share[: self.region_count].copy()

    def _inherit(self, source: Int32Array, share: Float32Array, run: Runner, thread_count: int) -> None:
        """Give every region its part of what was gathered before."""
        old = self._pool
        sizes = np.diff(old.root)[source]
        root = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
        pool = empty_pool(root)
        pieces = self._pieces(sizes, thread_count)

        def work(piece: int) -> None:
            quadtree.copy_trees(int(pieces[piece]), int(pieces[piece + 1]), source, share, old, pool)

        run(work, pieces.size - 1)
        self._pool = pool
        self._totals = self._totals[source] * share[:, None]

    def _gather(
        self, records: VertexRecords, region_of: Int32Array, key: np.uint32, run: Runner
    ) -> tuple[Float32Array, Int64Array]:
        """What quadtrees learn from the records, region by region, and each region's rows."""
        counts = np.zeros((chunk_count(len(region_of)), self.region_count), np.int32)

        def classify(start: int, stop: int, chunk: int) -> None:
            space.classify_blurred(records, start, stop, self._space, key, self._filters, region_of, counts, chunk)

        run_chunks(run, len(region_of), classify)
        order, rows = self._order(region_of, counts, run)
        batch = np.empty((len(order), space.BATCH_WIDTH), np.float32)

        def gather(start: int, stop: int, _chunk: int) -> None:
            space.gather_records(records, start, stop, key, self._filters, order, batch)

        run_chunks(run, len(order), gather)
        return batch, rows

    def _splat(self, batch: Float32Array, rows: Int64Array, run: Runner, thread_count: int) -> None:
        """Add the batch to the quadtrees."""
        measures = np.zeros((self.region_count, quadtree.MEASURE_WIDTH))
        sizes = rows[:, 1] - rows[:, 0]
        pieces = self._pieces(sizes, thread_count)

        def measure(piece: int) -> None:
            first, last = int(pieces[piece]), int(pieces[piece + 1])
            quadtree.measure_regions(batch, rows, first, last, self._is_variance_aware, measures)

        run(measure, pieces.size - 1)
        self._totals[:, quadtree.TOTAL_COUNT] += sizes
        self._totals[:, quadtree.TOTAL_ENERGY] += measures[:, quadtree.MEASURE_ENERGY]
        column, limit_column, total_column = space.BATCH_ENERGY, quadtree.MEASURE_ENERGY_LIMIT, quadtree.MEASURE_ENERGY
        if self._is_variance_aware:
            column, limit_column = space.BATCH_SQUARE, quadtree.MEASURE_SQUARE_LIMIT
            total_column = quadtree.MEASURE_SQUARE
        mean = float(measures[:, total_column].sum()) / max(len(batch), 1)
        # A mean too small for float32 is no light.
        scale = 1.0 / mean if mean > 1e-30 else 0.0

        def splat(piece: int) -> None:
            quadtree.splat_regions(
                batch, rows, int(pieces[piece]), int(pieces[piece + 1]), column, limit_column, np.float32(scale),
                measures, self._pool,
            )

        run(splat, pieces.size - 1)

    def _publish(self, run: Runner, thread_count: int) -> SdTreeField:
        """Make the field of what was gathered, and refine the trees that gather next."""
        pool = self._pool
        root, child = pool.root, pool.child
        count, nodes = self.region_count, self._node_count
        values = np.empty((len(child), 4))
        areas = np.empty(len(child), np.float32)
        split = np.empty((len(child), SPLIT_WIDTH), np.float32)
        is_ready = np.empty(count, np.uint8)
        pieces = self._pieces(np.diff(root), thread_count)

        def collect(piece: int) -> None:
            quadtree.collect_trees(
                int(pieces[piece]), int(pieces[piece + 1]), self._is_variance_aware, self._totals, pool, values, areas,
                split, is_ready,
            )

        run(collect, pieces.size - 1)
        self._pool = refine(pool, values, self._flux_share, self._max_depth, run, pieces)
        known = np.maximum(self._totals[:, quadtree.TOTAL_COUNT], 1.0)
        return SdTreeField(
            self._space.node_split[:nodes].copy(),
            self._space.node_link[:nodes].copy(),
            self._space.bounds,
            self._space.box,
            self._space.extent[:count].copy(),
            root[:-1].copy(),
            split,
            child,
            (self._totals[:, quadtree.TOTAL_ENERGY] / known).astype(np.float32),
            is_ready,
        )
