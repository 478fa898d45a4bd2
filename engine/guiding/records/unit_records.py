# SPDX-License-Identifier: GPL-3.0-or-later
"""What a unit of work has recorded, for all that learn."""

from __future__ import annotations

from typing import NamedTuple

from engine.guiding.records.taught import TaughtRecords
from engine.guiding.records.vertices import VertexRecords


class UnitRecords(NamedTuple):
    """Records of a unit.

    vertices : VertexRecords, for what guides paths
    taught : TaughtRecords, for the radiance cache
    """

    vertices: VertexRecords
    taught: TaughtRecords
