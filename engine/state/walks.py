# SPDX-License-Identifier: GPL-3.0-or-later
"""What walks below surfaces need (`engine.wavefront.walk_subsurface`)."""

from __future__ import annotations

from engine.array_types import Float32Array, Int32Array
from engine.runtime.bundle import Bundle
from engine.state.columns import allocate, column

# Rows of WalkLanes.real: extinction and scattering [1/m], the same of even scattering by similarity, single-scattering
# albedo, throughput, with which probability a channel draws, and the weight of a hit, or how much comes through a step.
WALK_EXTINCTION = 0
WALK_SCATTERING = 1
WALK_REDUCED_EXTINCTION = 2
WALK_REDUCED_SCATTERING = 3
WALK_ALBEDO = 4
WALK_THROUGHPUT = 5
WALK_CHANNEL = 6
WALK_HIT = 7
WALK_ROWS = 8


class WalkLanes(Bundle):
    """What walks below surfaces need, L lanes of C channels."""

    lobe: Int32Array = column("subsurface lobe that the path has taken", "L")
    real: Float32Array = column("a thread's scratch, by WALK_*", WALK_ROWS, "C")


def allocate_walk_lanes(lane_count: int, channel_count: int) -> WalkLanes:
    """Zeroed `WalkLanes` for `lane_count` lanes."""
    return allocate(WalkLanes, {"L": lane_count, "C": channel_count})
