# SPDX-License-Identifier: GPL-3.0-or-later
"""Area lamps whose axes are not at right angles: which are, and where rays meet them."""

from __future__ import annotations

import numpy as np

import tests.helpers.light_probe as probe
from engine.kernels.lights import area
from engine.state.lights import LAMP_FLAGS, LAMP_P

#: Images of x, y and z.
SHEARED = np.array([(1.0, 0.1, 0.0), (0.5, 0.8, 0.2), (0.2, -0.1, 1.2)])


def test_axes_that_rounding_has_turned_are_at_right_angles() -> None:
    turned = np.array([(0.8, 0.0, -0.6), (0.0, 1.0, 1e-6), (0.6, 0.0, 0.8)])
    for columns, is_sheared in ((turned, False), (turned * ((2.0,), (0.5,), (3.0,)), False), (SHEARED, True)):
        lights, _ = probe.build(probe.make_description([probe.lamp("AREA", (0, 0, 1), columns, size_x=1.0)]))
        assert bool(lights.lamp_table[0, LAMP_FLAGS] & area.FLAG_SHEARED) == is_sheared


def test_what_rays_meet_lies_across_the_lamps_direction_within_half_its_lengths() -> None:
    """As in Cycles: in the plane across the lamp's own z, by the distances along its unit x and y."""
    lamp = probe.lamp("AREA", (0.2, 0.1, 1.5), SHEARED, shape="RECTANGLE", size_x=1.2, size_y=0.7)
    lights, _ = probe.build(probe.make_description([lamp]))
    rng = np.random.default_rng(5)
    wi = rng.normal(size=(400, 3)) * (0.4, 0.4, 0.1) + (0.0, 0.0, 1.0)
    wi /= np.linalg.norm(wi, axis=1, keepdims=True)
    found = probe.hits(lights, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), wi).distance
    u, v, w = SHEARED / np.linalg.norm(SHEARED, axis=1, keepdims=True)
    centre = lights.lamps[0, LAMP_P : LAMP_P + 3].astype(np.float64)
    distance = (centre @ w) / (wi @ w)
    place = wi * distance[:, None] - centre
    lengths = np.linalg.norm(SHEARED, axis=1)[:2] * (1.2, 0.7)
    is_met = (np.abs(place @ u) <= 0.5 * lengths[0]) & (np.abs(place @ v) <= 0.5 * lengths[1])
    assert 20 < is_met.sum() < 380
    np.testing.assert_array_equal(found >= 0.0, is_met)
