# SPDX-License-Identifier: GPL-3.0-or-later
"""Area lamps whose direction leans against their axes: which do, and where rays meet them."""

from __future__ import annotations

import numpy as np

import tests.helpers.light_probe as probe
from engine.kernels.lights import area
from engine.state.lights import LAMP_FLAGS, LAMP_P

#: Images of x, y and z.
LEANING = np.array([(1.0, 0.0, 0.2), (0.0, 0.8, 0.0), (0.2, -0.1, 1.2)])
SHEARED = np.array([(1.0, 0.1, 0.0), (0.5, 0.8, 0.2), (0.2, -0.1, 1.2)])


def test_neither_rounding_nor_sheared_axes_count_as_leaning() -> None:
    turned = np.array([(0.8, 0.0, -0.6), (0.0, 1.0, 1e-6), (0.6, 0.0, 0.8)])
    scaled = turned * ((2.0,), (0.5,), (3.0,))
    for columns, leans in ((turned, False), (scaled, False), (SHEARED, False), (LEANING, True)):
        lights, _ = probe.build(probe.make_description([probe.lamp("AREA", (0, 0, 1), columns, size_x=1.0)]))
        assert bool(lights.lamp_table[0, LAMP_FLAGS] & area.FLAG_LEANING) == leans


def test_what_rays_meet_lies_across_the_lamps_direction_within_half_its_lengths() -> None:
    """As in Cycles: in the plane across the lamp's own z, by the distances along its unit x and y."""
    lamp = probe.lamp("AREA", (0.2, 0.1, 1.5), LEANING, shape="RECTANGLE", size_x=1.2, size_y=0.7)
    lights, _ = probe.build(probe.make_description([lamp]))
    rng = np.random.default_rng(5)
    wi = rng.normal(size=(400, 3)) * (0.4, 0.4, 0.1) + (0.0, 0.0, 1.0)
    wi /= np.linalg.norm(wi, axis=1, keepdims=True)
    found = probe.hits(lights, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), wi).distance
    u, v, w = LEANING / np.linalg.norm(LEANING, axis=1, keepdims=True)
    centre = lights.lamps[0, LAMP_P : LAMP_P + 3].astype(np.float64)
    distance = (centre @ w) / (wi @ w)
    place = wi * distance[:, None] - centre
    lengths = np.linalg.norm(LEANING, axis=1)[:2] * (1.2, 0.7)
    is_met = (np.abs(place @ u) <= 0.5 * lengths[0]) & (np.abs(place @ v) <= 0.5 * lengths[1])
    assert 20 < is_met.sum() < 380
    np.testing.assert_array_equal(found >= 0.0, is_met)
