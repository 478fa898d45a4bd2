# SPDX-License-Identifier: GPL-3.0-or-later
"""Directional tables: what they learn, and what must not break them."""

import numpy as np

from engine.guiding.fields.table import TABLE_SIDE, TableModel, direction_to_cell, predict_table
from engine.guiding.fields.vmm.model import VmmModel, VmmSettings
from engine.runtime.jit import kernel
from tests.helpers.guiding_harness import sphere_grid, uniform_records

BOX = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))


@kernel
def _cells(directions, out):
    for k in range(directions.shape[0]):
        out[k] = direction_to_cell((directions[k, 0], directions[k, 1], directions[k, 2]))


@kernel
def _predictions(table, region, directions, out):
    for k in range(directions.shape[0]):
        predict_table(table, region, (directions[k, 0], directions[k, 1], directions[k, 2]), out, k)


def predictions(table, region, directions):
    out = np.zeros((len(directions), 3), np.float32)
    _predictions(table, region, np.asarray(directions, np.float32), out)
    return out


def colors(d):
    """Red from above, green from the +x side, dim blue elsewhere."""
    return np.stack([4.0 * (d[:, 2] > 0.8), 2.0 * (d[:, 0] > 0.7), np.full(len(d), 0.3)], 1)


def learn(updates, count=30_000, settings=None, spoil=None):
    rng = np.random.default_rng(1)
    model, tables = VmmModel(BOX, settings), TableModel()
    for _ in range(updates):
        records = uniform_records(rng, count, colors)
        if spoil is not None:
            spoil(records)
        model.update(records, count)
        tables.update(model)
    return model, tables.field


def test_cells_have_equal_solid_angles():
    directions = sphere_grid(1000, 2000)
    cells = np.zeros(len(directions), np.int64)
    _cells(directions.astype(np.float32), cells)
    counts = np.bincount(cells, minlength=TABLE_SIDE**2)
    assert np.abs(counts / counts.mean() - 1.0).max() < 0.03


def test_colours_are_learned():
    model, table = learn(3)
    directions = sphere_grid(60, 120)
    # Away from the two edges, where cells average.
    clear = (np.abs(directions[:, 2] - 0.8) > 0.15) & (np.abs(directions[:, 0] - 0.7) > 0.2)
    truth = colors(directions)
    for region in range(model.region_count):
        found = predictions(table, region, directions)
        assert np.abs(found - truth)[clear].mean() < 0.06
        assert (found > 0.0).all()


def test_regions_that_are_cut_pass_their_tables_on():
    model, table = learn(4, 8000, VmmSettings(2000))
    assert model.region_count > 8
    found = np.stack([predictions(table, region, [(0.0, 0.0, 1.0)])[0] for region in range(model.region_count)])
    assert np.abs(found / found.mean(0) - 1.0)[:, [0, 2]].max() < 0.35


def test_a_single_bright_sample_stays_small():
    def spoil(records):
        records.radiance[77] = 1e6
        records.direction[77] = (0.0, 0.0, -1.0)

    _, table = learn(1, spoil=spoil)
    assert predictions(table, 0, [(0.0, 0.0, -1.0)])[0].max() < 40.0
    assert predictions(table, 0, [(0.0, -1.0, 0.0)])[0].max() < 0.5


def test_light_beyond_all_bounds_is_forgotten():
    """Candidates weighed by no number would be lost."""
    def spoil(records):
        records.radiance[:700] = 1e38
        records.pdf[:700] = 1e-3

    model, table = learn(1, spoil=spoil)
    assert np.isfinite(table.values).all()


def test_no_light_predicts_none():
    model, tables = VmmModel(BOX), TableModel()
    model.update(uniform_records(np.random.default_rng(2), 2000, lambda d: np.zeros(len(d))), 2000)
    tables.update(model)
    assert (predictions(tables.field, 0, [(0.0, 0.0, 1.0)]) == 0.0).all()
