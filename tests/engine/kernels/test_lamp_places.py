# SPDX-License-Identifier: GPL-3.0-or-later
"""Where rays meet lamps their programs see what they see of the same point as a light sample."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.lights import lamp_place
from engine.runtime.jit import kernel
from engine.scene.description import Light
from engine.state.lights import EMITTER_LAMP, LAMP_PROGRAM
from tests.helpers.light_probe import DISTANCE, EMITTER, NG, PDF, WI, U, V, build, draw, stratified
from tests.helpers.small_scenes import floor_scene

_TILTED = np.array([[0.8, 0, 0.6, 0.3], [0, 1, 0, -0.2], [-0.6, 0, 0.8, 2], [0, 0, 0, 1]], np.float32)
#: A receiver in front of `_TILTED`.
_P, _N = (-0.5, 0.1, 0.0), (0.0, 0.0, 1.0)
_LAMPS = {
    "rectangle": Light("l", "L", "AREA", _TILTED, (1, 1, 1), 9.0, shape="RECTANGLE", size_x=1.4, size_y=0.6),
    "ellipse": Light("l", "L", "AREA", _TILTED, (1, 1, 1), 9.0, shape="ELLIPSE", size_x=1.4, size_y=0.6),
    "sphere": Light("l", "L", "POINT", _TILTED, (1, 1, 1), 9.0, radius=0.4, use_soft_falloff=False),
    "disc": Light("l", "L", "POINT", _TILTED, (1, 1, 1), 9.0, radius=0.4),
    "spot": Light("l", "L", "SPOT", _TILTED, (1, 1, 1), 9.0, radius=0.4, use_soft_falloff=False, spot_angle=1.8),
    "sun": Light("l", "L", "SUN", _TILTED, (1, 1, 1), 9.0, angle=0.2),
}


@kernel
def _places(lights, rows, p, wi, distance, out):
    for k in range(rows.shape[0]):
        direction = (wi[k, 0], wi[k, 1], wi[k, 2])
        ng, u, v = lamp_place(lights, np.int64(rows[k]), (p[0], p[1], p[2]), direction, distance[k])
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = ng[0], ng[1], ng[2], u, v


@pytest.mark.parametrize("name", _LAMPS)
def test_a_hit_is_where_a_sample_was(name: str) -> None:
    lights, geometry = build(floor_scene(lights=[_LAMPS[name]]))
    # As if there were one: only programs ask for coordinates.
    lights.lamp_table[:, LAMP_PROGRAM] = 0
    samples = draw(lights, geometry, _P, _N, stratified(64, 5))
    samples = samples[samples[:, PDF] > 0.0]
    assert len(samples) > 30
    rows = lights.emitters[samples[:, EMITTER].astype(int), EMITTER_LAMP].astype(np.int64)
    out = np.zeros((len(samples), 5), np.float32)
    wi, distance = np.ascontiguousarray(samples[:, WI : WI + 3]), np.ascontiguousarray(samples[:, DISTANCE])
    _places(lights, rows, np.array(_P, np.float32), wi, distance, out)
    np.testing.assert_allclose(out[:, :3], samples[:, NG : NG + 3], atol=2e-4)
    np.testing.assert_allclose(out[:, 3:], samples[:, [U, V]], atol=2e-5)
    np.testing.assert_allclose(out[:, 3:], _coordinates(name, samples), atol=2e-4)


def _coordinates(name: str, samples: np.ndarray) -> np.ndarray:
    """Barycentrics in Cycles' manner, (N, 2): of places on areas, angles of points, projections of spots and suns."""
    light = _LAMPS[name]
    axes, wi = _TILTED[:3, :3].astype(np.float64), samples[:, WI : WI + 3].astype(np.float64)
    if light.kind == "AREA":
        place = np.array(_P) + wi * samples[:, DISTANCE, None] - _TILTED[:3, 3]
        x, y = (place @ axes)[:, :2].T / [[light.size_x], [light.size_y]]
    elif light.kind == "POINT":
        x, y, z = (samples[:, NG : NG + 3] @ axes).T
        u, v = 0.5 - np.arctan2(x, y) / (2.0 * np.pi), 1.0 - np.arccos(z) / np.pi
        return np.stack([v, 1.0 - u - v], axis=1)
    elif light.kind == "SPOT":
        x, y, z = (wi @ axes).T
        x, y = -np.array([x, y]) / z * 0.5 / np.tan(0.5 * light.spot_angle)
    else:
        # Towards the sun is its own z.
        x, y, z = (wi @ axes).T
        angle = np.arccos(np.minimum(z, 1.0))
        radius = np.sin(0.5 * angle) / np.sin(0.25 * light.angle)
        x, y = 0.5 * radius * np.array([x, y]) / np.maximum(np.sin(angle), 1e-9)
    return np.stack([y + 0.5, -x - y], axis=1)
