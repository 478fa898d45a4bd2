# SPDX-License-Identifier: GPL-3.0-or-later
"""Directional tables: incident radiance by region and direction, learned from the samples of the mixture field.

The cheapest predictor of coloured incident radiance: one look-up in an equal-area map of the sphere. Cells with few
samples lean on the mean of the larger cell around them.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.fields.state import State, require, take
from engine.guiding.fields.update import balance, make_runner
from engine.guiding.fields.vmm.model import VmmModel
from engine.guiding.fields.vmm.store import SAMPLE_DIRECTION, SAMPLE_PDF, SAMPLE_RADIANCE
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel

#: Cells a side of a map, a power of two.
TABLE_SIDE = 16
_LEVEL_COUNT = TABLE_SIDE.bit_length()
_CELL_COUNT = TABLE_SIDE * TABLE_SIDE

#: A cell's own samples count against this many of the mean around it.
_PRIOR_COUNT = np.float32(8.0)
#: Share of the region's mean radiance below which no cell falls: nothing is known to be black.
_FLOOR_SHARE = np.float32(0.01)
#: No sample may hold a larger share of a batch's radiance.
_RADIANCE_SHARE = np.float32(0.02)
#: A sample divides by no smaller density.
_MIN_PDF = np.float32(0.01)

# Columns of the sums, after the channels.
_SUM_INVERSE_PDF = 0
_SUM_COUNT = 1
_SUM_EXTRA = 2


class TableField(Bundle):
    """Incident radiance by region and direction.

    values : float32 (R, TABLE_SIDE * TABLE_SIDE, C), radiance, positive in regions that have seen light, else 0
    """

    values: Float32Array


def no_table(channel_count: int = 3) -> TableField:
    """A table of no region, to stand where there is none."""
    return TableField(np.zeros((0, TABLE_SIDE * TABLE_SIDE, channel_count), np.float32))


@kernel
def direction_to_cell(wi):
    """Cell of the equal-area map that holds a unit direction.

    References: Clarberg 2008, "Fast Equal-Area Mapping of the (Hemi)Sphere using SIMD".
    """
    x = abs(wi[0])
    y = abs(wi[1])
    z = abs(wi[2])
    r = math.sqrt(max(1.0 - z, 0.0))
    largest = max(x, y)
    t = min(x, y) / largest if largest > 0.0 else np.float32(0.0)
    # 2 / pi * atan(t) over [0, 1], odd polynomial, error below 1e-5.
    s = t * t
    phi = -0.007456 * s + 0.033555
    phi = phi * s - 0.074190
    phi = phi * s + 0.123434
    phi = phi * s - 0.211959
    phi = (phi * s + 0.636615) * t
    phi = 1.0 - phi if x < y else phi
    v = phi * r
    u = r - v
    below = wi[2] < 0.0
    folded_u = 1.0 - v if below else u
    folded_v = 1.0 - u if below else v
    a = 0.5 + 0.5 * math.copysign(folded_u, wi[0])
    b = 0.5 + 0.5 * math.copysign(folded_v, wi[1])
    side = np.float32(TABLE_SIDE)
    column = min(max(int(a * side), 0), TABLE_SIDE - 1)
    row = min(max(int(b * side), 0), TABLE_SIDE - 1)
    return row * TABLE_SIDE + column


@kernel
def predict_table(table, region, wi, out, row):
    """Write the learned incident radiance along unit direction wi to out[row, c].

    Parameters
    ----------
    table : TableField
    region : int, of `find_region` or `find_leaf` on the field that the table belongs to
    wi : float32 tuple, unit
    out : float32 (L, >= C), written
    row : int
    """
    cell = direction_to_cell(wi)
    for c in range(table.values.shape[2]):
        out[row, c] = table.values[region, cell, c]


@kernel
def _learn_regions(batch, rows, first, last, sums, limit):
    """Add a sorted batch to the sums of regions [first, last), older samples fading beyond `limit` of them."""
    channel_count = sums.shape[2] - _SUM_EXTRA
    for region in range(first, last):
        start = rows[region, 0]
        stop = rows[region, 1]
        if stop <= start:
            continue
        known = np.float64(0.0)
        for cell in range(_CELL_COUNT):
            known += np.float64(sums[region, cell, channel_count + _SUM_COUNT])
        fade = np.float32(min(1.0, limit / max(known, 1.0)))
        if fade < 1.0:
            for cell in range(_CELL_COUNT):
                for column in range(sums.shape[2]):
                    sums[region, cell, column] *= fade
        total = np.float64(0.0)
        lit_count = 0
        for k in range(start, stop):
            brightest = np.float32(0.0)
            for c in range(channel_count):
                brightest = max(brightest, batch[k, SAMPLE_RADIANCE + c])
            total += np.float64(brightest)
            if brightest > 0.0:
                lit_count += 1
        share = max(_RADIANCE_SHARE, 2.0 / np.float32(max(lit_count, 1)))
        cap = total * share
        for _round in range(2):
            total = np.float64(0.0)
            for k in range(start, stop):
                brightest = np.float32(0.0)
                for c in range(channel_count):
                    brightest = max(brightest, batch[k, SAMPLE_RADIANCE + c])
                total += min(np.float64(brightest), cap)
            cap = total * share
        for k in range(start, stop):
            brightest = np.float32(0.0)
            for c in range(channel_count):
                brightest = max(brightest, batch[k, SAMPLE_RADIANCE + c])
            cell = direction_to_cell(
                (batch[k, SAMPLE_DIRECTION], batch[k, SAMPLE_DIRECTION + 1], batch[k, SAMPLE_DIRECTION + 2])
            )
            inverse_pdf = 1.0 / max(batch[k, SAMPLE_PDF], _MIN_PDF)
            kept = np.float32(min(np.float64(1.0), cap / max(brightest, np.float32(1e-30))))
            for c in range(channel_count):
                sums[region, cell, c] += batch[k, SAMPLE_RADIANCE + c] * kept * inverse_pdf
            sums[region, cell, channel_count + _SUM_INVERSE_PDF] += inverse_pdf
            sums[region, cell, channel_count + _SUM_COUNT] += 1.0


@kernel
def _publish_regions(first, last, sums, pyramid, values):
    """Estimates of regions [first, last) from their sums; `pyramid` is one thread's workspace."""
    channel_count = sums.shape[2] - _SUM_EXTRA
    for region in range(first, last):
        # Level by level from the whole sphere: level l has 4^l cells, of which the estimates of the level above are
        # the prior. Only the whole sphere has none.
        base = 0
        for level in range(_LEVEL_COUNT):
            side = 1 << level
            step = TABLE_SIDE // side
            above = base - side * side // 4
            for y in range(side):
                for x in range(side):
                    weight = np.float32(0.0)
                    count = np.float32(0.0)
                    for c in range(channel_count):
                        pyramid[base + y * side + x, c] = 0.0
                    for j in range(y * step, y * step + step):
                        for i in range(x * step, x * step + step):
                            cell = j * TABLE_SIDE + i
                            for c in range(channel_count):
                                pyramid[base + y * side + x, c] += sums[region, cell, c]
                            weight += sums[region, cell, channel_count + _SUM_INVERSE_PDF]
                            count += sums[region, cell, channel_count + _SUM_COUNT]
                    own = count / (count + _PRIOR_COUNT) if level > 0 else np.float32(1.0)
                    scale = own / weight if weight > 0.0 else np.float32(0.0)
                    for c in range(channel_count):
                        prior = np.float32(0.0)
                        if level > 0:
                            prior = pyramid[above + (y // 2) * (side // 2) + x // 2, c]
                        estimate = pyramid[base + y * side + x, c] * scale + (1.0 - own) * prior
                        pyramid[base + y * side + x, c] = estimate
            base += side * side
        base -= _CELL_COUNT
        for c in range(channel_count):
            floor = _FLOOR_SHARE * pyramid[0, c]
            for cell in range(_CELL_COUNT):
                values[region, cell, c] = max(pyramid[base + cell, c], floor)


class TableModel:
    """Learns tables for the regions of a `VmmModel`; update it after every update of that model.

    Parameters
    ----------
    region_count : int
        Regions of the model before its update that is the first to learn from.
    channel_count : int
    statistics_limit : float
        Samples a region remembers; `inherited_share` of them pass to its children when it is cut.

    Attributes
    ----------
    field : TableField
        For kernels; every update makes a new one.
    update_count : int
    """

    def __init__(
        self, region_count: int = 1, channel_count: int = 3, statistics_limit: float = 65536.0,
        inherited_share: float = 0.25,
    ) -> None:
        self._limit = statistics_limit
        self._inherited_share = inherited_share
        self._sums = np.zeros((region_count, _CELL_COUNT, channel_count + _SUM_EXTRA), np.float32)
        self.field = TableField(np.zeros((region_count, _CELL_COUNT, channel_count), np.float32))
        self.update_count = 0

    @staticmethod
    def is_state(state: State, channel_count: int) -> bool:
        """Whether `state` is of a table with so many channels: there may be none, or one of another kind of render."""
        return "sums" in state and state["sums"].shape[-1] == channel_count + _SUM_EXTRA

    @classmethod
    def of_state(cls, state: State, region_count: int, channel_count: int) -> TableModel:
        """The model that `state` was asked of, on so many regions.

        Raises
        ------
        StateError
            If the arrays are no state of a model.
        """
        model = cls(region_count, channel_count)
        model._sums = take(state, "sums", np.float32, (region_count, _CELL_COUNT, channel_count + _SUM_EXTRA))
        model.update_count = int(take(state, "update_count", np.int64, (1,))[0])
        require((model._sums >= 0.0).all(), "a table's sums are negative")
        values = np.empty_like(model.field.values)
        _publish_regions(0, region_count, model._sums, np.zeros((2 * _CELL_COUNT, channel_count), np.float32), values)
        model.field = TableField(values)
        return model

    def state(self) -> State:
        """All that it knows, as arrays."""
        return {"sums": self._sums.copy(), "update_count": np.array([self.update_count], np.int64)}

    def update(self, model: VmmModel, executor: ThreadPoolExecutor | None = None, thread_count: int = 1) -> None:
        """Learn from the batch of the model's last update and publish a new field."""
        count = model.region_count
        sums = self._sums = model.inherited(self._sums, share=self._inherited_share)
        values = np.empty((count, _CELL_COUNT, sums.shape[2] - _SUM_EXTRA), np.float32)
        run = make_runner(executor, thread_count)
        pieces = balance(model.batch_rows[:, 1] - model.batch_rows[:, 0] + 1, thread_count)

        def work(piece: int) -> None:
            first, last = int(pieces[piece]), int(pieces[piece + 1])
            pyramid = np.zeros((2 * _CELL_COUNT, values.shape[2]), np.float32)
            _learn_regions(model.batch, model.batch_rows, first, last, sums, self._limit)
            _publish_regions(first, last, sums, pyramid, values)

        run(work, pieces.size - 1)
        with np.errstate(all="ignore"):
            is_sound = np.isfinite(values.sum(axis=(1, 2)))
        # As regions that have seen nothing: candidates weighed by no number would be lost.
        sums[~is_sound] = values[~is_sound] = 0.0
        self.field = TableField(values)
        self.update_count += 1
