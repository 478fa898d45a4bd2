# SPDX-License-Identifier: GPL-3.0-or-later
"""Learned fields without a render: mixtures and a table of random records."""

from __future__ import annotations

import numpy as np

from engine.guiding.fields.state import prefixed
from engine.guiding.fields.table import TableModel
from engine.guiding.models.regions import RegionModels
from engine.guiding.records.vertices import VertexRecords, allocate_vertex_records
from engine.guiding.saved.learned import LearnedField


def random_records(seed: int, count: int = 12_000) -> VertexRecords:
    """Records of a box, lit from above and a little from everywhere, with all that shares are learned from."""
    rng = np.random.default_rng(seed)
    records = allocate_vertex_records(count, 3)
    direction = rng.normal(size=(count, 3))
    records.position[:] = rng.random((count, 3))
    records.direction[:] = direction / np.linalg.norm(direction, axis=1)[:, None]
    records.normal[:] = (0.0, 0.0, 1.0)
    records.radiance[:] = (0.1 + 4.0 * (records.direction[:, 2] > 0.7))[:, None]
    for column in (records.distance, records.roughness):
        column[:] = 1.0
    for column in (records.pdf, records.bsdf_pdf, records.guide_pdf):
        column[:] = 0.25 / np.pi
    records.contribution_squared[:] = rng.random(count)
    records.light_squared[:] = 0.1 * rng.random(count)
    records.benefit[:] = rng.random(count)
    return records


def learned_models(seed: int, updates: int = 2) -> tuple[RegionModels, TableModel]:
    """What was learned of random records."""
    regions = None
    table = TableModel()
    for update in range(updates):
        records = random_records(1000 * seed + update)
        count = len(records.pdf)
        if regions is None:
            regions = RegionModels.of_records(records, count, 0.5)
        regions.fit(records, count)
        table.update(regions.mixture)
        regions.add_deltas(records, count)
        regions.learn_shares(records, count, variance=1.0, ray_count=4.0, was_guided=True)
    assert regions is not None
    return regions, table


def learned_field(seed: int = 0, light_digest: str = "0" * 32) -> LearnedField:
    """A field of two updates with random records."""
    regions, table = learned_models(seed)
    state = {**regions.state(), **prefixed("table", table.state())}
    return LearnedField(state, light_digest, "TABLE_RIS", "WON", 1.75, 12.0, 3.5, 7.25, 0.5, 0.25)
