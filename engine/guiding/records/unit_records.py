# SPDX-License-Identifier: GPL-3.0-or-later
"""What a unit of work has recorded, for all that learn."""

from __future__ import annotations

from typing import NamedTuple

from engine.guiding.records.cache_records import CacheRecords
from engine.guiding.records.vertices import VertexRecords


class UnitRecords(NamedTuple):
    """Records of a unit.

    vertices : VertexRecords, for what guides paths
    cache_records : CacheRecords, for the radiance cache
    """

    vertices: VertexRecords
    cache_records: CacheRecords
