# SPDX-License-Identifier: GPL-3.0-or-later
"""How often regions sample lights: rule of the square root, nothing given up where nothing is known."""

import numpy as np
import pytest

from engine.guiding.fields.vmm.leaves import find_leaves
from engine.guiding.fields.vmm.model import VmmModel, VmmSettings
from engine.guiding.models.light_share import LEAST_SHARE, LIGHT_COST, LightShareModel
from engine.guiding.records.vertices import allocate_vertex_records, as_records

COUNT = 4000


def learn(squared_below, squared_above, *, variance, ray_count=10.0):
    """Shares of two regions, below and above x = 0, whose records found so much light."""
    rng = np.random.default_rng(7)
    records = allocate_vertex_records(2 * COUNT)
    records.position[:] = rng.uniform(-1, 1, (2 * COUNT, 3)) * (1.0, 0.1, 0.1)
    records.direction[:] = records.normal[:] = (0.0, 0.0, 1.0)
    for column in (records.radiance, records.pdf, records.distance, records.roughness):
        column[:] = 1.0
    is_above = records.position[:, 0] > 0.0
    records.light_squared[:] = np.where(is_above, squared_above, squared_below)
    vmm = VmmModel([[-1, -1, -1], [1, 1, 1]], VmmSettings(int(1.5 * COUNT)))
    vmm.update(as_records(records), 2 * COUNT)
    leaf = np.zeros(2 * COUNT, np.int32)
    find_leaves(vmm.field, records.position, leaf)
    model = LightShareModel()
    model.update(vmm, records, leaf, variance=variance, ray_count=ray_count)
    region = np.zeros(2, np.int32)
    find_leaves(vmm.field, np.array([[-0.5, 0, 0], [0.5, 0, 0]], np.float32), region)
    assert region[0] != region[1]
    return model.share[region]


def test_dark_regions_sample_lights_seldom_and_bright_ones_always():
    below, above = learn(0.0, 100.0, variance=1e4)
    assert below == pytest.approx(LEAST_SHARE)
    assert above == pytest.approx(np.sqrt(100.0 * 10.0 / (LIGHT_COST * 1e4)), rel=0.02)
    assert (learn(0.0, 100.0, variance=1.0)[1] == 1.0).all()


def test_nothing_is_given_up_in_an_image_without_variance():
    assert (learn(0.0, 1.0, variance=0.0) == 1.0).all()
    assert (learn(np.nan, np.nan, variance=1.0) == 1.0).all()
