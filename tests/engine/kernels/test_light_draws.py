# SPDX-License-Identifier: GPL-3.0-or-later
"""Light samples that are drawn eight side by side are those that are drawn one by one."""

from __future__ import annotations

import numpy as np
import pytest

import tests.helpers.light_probe as probe
from engine.kernels.lights import (
    choose_emitter,
    draw_triangle,
    drawn_triangle,
    group_of_few,
    pick_among_few,
    put_triangle,
    sample_triangles,
    triangle_of,
)
from engine.runtime.jit import kernel
from engine.state.geometry import GeometryArrays
from engine.state.lanes import (
    DRAW_EMITTER,
    DRAW_N,
    DRAW_P,
    DRAW_PMF,
    DRAW_TRANSMITS,
    DRAW_U0,
    DRAW_U1,
    DRAW_U_PICK,
    DRAW_WIDTH,
    allocate_light_draws,
)
from engine.state.lights import LightArrays


@kernel
def _draw_both(lights, geometry, draws, receivers, u, out, side_by_side):
    few = group_of_few(lights)
    for first in range(0, receivers.shape[0], DRAW_WIDTH):
        for k in range(DRAW_WIDTH):
            for c in range(3):
                draws.real[0, DRAW_P + c, k] = receivers[first + k, c]
                draws.real[0, DRAW_N + c, k] = receivers[first + k, 3 + c]
            draws.real[0, DRAW_TRANSMITS, k] = receivers[first + k, 6]
            draws.real[0, DRAW_U_PICK, k] = u[first + k, 0]
            draws.real[0, DRAW_U0, k] = u[first + k, 1]
            draws.real[0, DRAW_U1, k] = u[first + k, 2]
        pick_among_few(lights, few, draws)
        for k in range(DRAW_WIDTH):
            i = first + k
            p, n = (
                (receivers[i, 0], receivers[i, 1], receivers[i, 2]),
                (receivers[i, 3], receivers[i, 4], receivers[i, 5]),
            )
            emitter, pmf, _ = choose_emitter(lights, 0, p, n, receivers[i, 6] > 0.0, u[i, 0])
            if not pmf > 0.0:
                emitter = -1
            pdf, wi, distance, a, b = draw_triangle(lights, geometry, emitter, p, 0.5, u[i, 1], u[i, 2])
            out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4], out[i, 5] = emitter, pmf, pdf, distance, a, b
            out[i, 6], out[i, 7], out[i, 8] = wi
            side_by_side[i, 0] = draws.integer[DRAW_EMITTER, k]
            side_by_side[i, 1] = draws.real[0, DRAW_PMF, k]
            _, (v0, edge1, edge2) = triangle_of(lights, geometry, emitter, 0.5)
            put_triangle(draws, k, v0, edge1, edge2, p)
        sample_triangles(draws)
        for k in range(DRAW_WIDTH):
            i = first + k
            pdf, wi, distance, a, b = drawn_triangle(draws, k)
            side_by_side[i, 2], side_by_side[i, 3], side_by_side[i, 4], side_by_side[i, 5] = pdf, distance, a, b
            side_by_side[i, 6], side_by_side[i, 7], side_by_side[i, 8] = wi


def _triangles(count: int) -> tuple[LightArrays, GeometryArrays]:
    rng = np.random.default_rng(count)
    vertices = rng.normal(0.0, 1.0, (3 * count, 3)) * np.repeat(rng.choice([0.2, 0.5, 2.0], (count, 1)), 3, axis=0)
    vertices += np.repeat(rng.uniform(-3.0, 3.0, (count, 3)), 3, axis=0)
    return probe.build(*probe.emissive_scene(vertices, np.arange(3 * count).reshape(count, 3)))


@pytest.mark.parametrize("count", [2, 3, 8])
def test_they_are_those_drawn_one_by_one(count: int) -> None:
    lights, geometry = _triangles(count)
    rng = np.random.default_rng(2)
    rows = 8192
    receivers = np.zeros((rows, 7), np.float32)
    receivers[:, :3] = rng.uniform(-4.0, 4.0, (rows, 3))
    normals = rng.normal(size=(rows, 3))
    receivers[:, 3:6] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    receivers[:, 6] = rng.random(rows) < 0.3
    one_by_one, side_by_side = np.zeros((2, rows, 9), np.float32)
    _draw_both(
        lights, geometry, allocate_light_draws(), receivers, rng.random((rows, 3), np.float32), one_by_one, side_by_side
    )
    # Rounding decides where a number falls between two emitters.
    same = one_by_one[:, 0] == side_by_side[:, 0]
    assert same.mean() > 0.999
    assert len(np.unique(one_by_one[:, 0])) >= count
    np.testing.assert_allclose(side_by_side[same, 1], one_by_one[same, 1], rtol=2e-4, atol=1e-6)
    # And, seldom, which of two measures serves.
    is_lit = one_by_one[:, 0] >= 0
    ours, theirs = side_by_side[is_lit, 2:], one_by_one[is_lit, 2:]
    differs = np.abs(ours - theirs) > 1e-4 + 2e-3 * np.abs(theirs)
    assert differs.any(axis=1).mean() < 2e-3
    assert (theirs[:, 0] > 0.0).mean() > 0.9


def test_many_and_distant_emitters_are_not_few() -> None:
    assert group_of_few(_triangles(8)[0]) == 1
    assert group_of_few(_triangles(40)[0]) == -1
    assert group_of_few(_triangles(1)[0]) == -1
    lamps = probe.make_description([probe.lamp("AREA", (0, 0, 1), size_x=1.0), probe.lamp("SUN", angle=0.1)])
    assert group_of_few(probe.build(lamps)[0]) == -1
