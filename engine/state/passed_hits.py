# SPDX-License-Identifier: GPL-3.0-or-later
"""Hits of shadow rays on what may let light through, kept from the one search that finds them until they are shaded."""

from __future__ import annotations

from engine.array_types import Float32Array, Int32Array
from engine.runtime.bundle import Bundle
from engine.state.columns import allocate, column

#: Room for hits, a lane. Rays for whose hits there is none look for them again.
HITS_PER_LANE = 8


class PassedHits(Bundle):
    """Hits of shadow rays on what may let light through, H in all; L rows of shadow rays."""

    next: Int32Array = column("the first hit of the row that lies ahead", "L")
    end: Int32Array = column("behind the row's last", "L")
    gone: Float32Array = column("how far the ray has come since its hits were found [m]", "L")
    distance: Float32Array = column("from where the search began [m]; a row's are in order", "H")
    u: Float32Array = column("barycentric, as Embree has it", "H")
    v: Float32Array = column("likewise", "H")
    instance: Int32Array = column("that was hit", "H")
    triangle: Int32Array = column("likewise", "H")


def allocate_passed_hits(lane_count: int) -> PassedHits:
    """Zeroed `PassedHits` for `lane_count` lanes."""
    return allocate(PassedHits, {"L": lane_count, "H": HITS_PER_LANE * lane_count})
