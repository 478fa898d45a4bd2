# SPDX-License-Identifier: GPL-3.0-or-later
"""Where along segments within media light is sampled: densities against samples, choices against all that they choose
among, and the estimate against an integral.

Chi-square tests share a significance of 0.1%; means are compared at 4 standard errors. Seeds are fixed.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import integrate, stats

from engine.kernels.bsdf.phase import add_phase
from engine.kernels.distances import (
    choose_distance,
    collision_distance,
    collision_pdf,
    equiangular_distance,
    equiangular_pdf,
    weigh_distances,
)
from engine.kernels.lights.segments import lit_interval, pick_for_segment, subtended_angle
from engine.runtime.jit import kernel
from engine.state.lanes import allocate_closures
from engine.state.lights import EMITTER_NODE
from engine.state.media import COEFFICIENT_ROWS, EXTINCTION, SCATTERING
from tests.helpers.chi2 import sidak
from tests.helpers.light_probe import build, draw, lamp, make_description, stratified

SIGNIFICANCE = 0.001
DOWN = np.array([0.0, 0.0, -1.0])


@kernel
def _draw_by_angle(across, along, length, u, out):
    for i in range(u.shape[0]):
        angle = u[i] * subtended_angle(across, along, length)
        out[i] = equiangular_distance(across, along, length, math.sin(angle), math.cos(angle))


@kernel
def _draw_collisions(channels, coefficients, length, u, out):
    for i in range(u.shape[0]):
        out[i] = collision_distance(channels, coefficients, length, u[i])


def _p_value(samples, edges, pdf):
    """Significance of distances against a density [m^-1], by cells between `edges`."""
    fine = [np.linspace(a, b, 65) for a, b in itertools.pairwise(edges)]
    mass = np.array([integrate.simpson([pdf(x) for x in cell], x=cell) for cell in fine])
    assert mass.sum() == pytest.approx(1.0, rel=2e-3)
    expected = len(samples) * mass / mass.sum()
    found = np.histogram(samples, edges)[0]
    return stats.chi2.sf(((found - expected) ** 2 / expected).sum(), len(found) - 1)


def _edges(samples, length):
    """Cells that hold about as many samples each; these count no more."""
    edges = np.quantile(samples, np.linspace(0.0, 1.0, 33))
    edges[0], edges[-1] = 0.0, length
    return edges


# The lamp's distance from the line, its foot on it, and the segment's length.
@pytest.mark.parametrize(
    "across, along, length", [(1.0, 2.0, 5.0), (0.05, 4.0, 6.0), (3.0, -8.0, 1.0), (2.0, 0.0, 4.0)]
)
def test_distances_by_angle_follow_their_density(across, along, length):
    u = np.random.default_rng(3).random(50000).astype(np.float32)
    out = np.zeros_like(u)
    _draw_by_angle(np.float32(across), np.float32(along), np.float32(length), u, out)
    assert out.min() >= 0.0 and out.max() <= length

    angle = subtended_angle(np.float32(across), np.float32(along), np.float32(length))

    def pdf(distance):
        return equiangular_pdf(np.float32(across), np.float32(along), np.float32(angle), np.float32(distance))

    edges = _edges(out[:10000], length)
    assert _p_value(out[10000:], edges, pdf) > sidak(SIGNIFICANCE, 4)
    # And the test sees distances that are 2% off.
    assert _p_value(np.minimum(1.02 * out[10000:], length), edges, pdf) < sidak(SIGNIFICANCE, 4)


@pytest.mark.parametrize("length", [0.5, 40.0])
def test_distances_of_collisions_follow_their_density(length):
    channels, coefficients = (0, 1, 2), np.zeros((COEFFICIENT_ROWS, 3), np.float32)
    coefficients[EXTINCTION] = (0.1, 1.0, 4.0)
    coefficients[SCATTERING] = (0.1, 0.5, 2.0)
    throughput = np.array([[1.0, 0.5, 0.8]], np.float32)
    assert weigh_distances(channels, coefficients, throughput, 0, np.float32(0.3), np.float32(length)) > 0.0
    u = np.random.default_rng(4).random(50000).astype(np.float32)
    out = np.zeros_like(u)
    _draw_collisions(channels, coefficients, np.float32(length), u, out)
    edges = _edges(out[:10000], length)
    p_value = _p_value(out[10000:], edges, lambda t: collision_pdf(channels, coefficients, np.float32(t)))
    assert p_value > sidak(SIGNIFICANCE, 2)


@pytest.mark.parametrize("along", [-3e4, 0.5, 3e4])
def test_the_angle_of_a_segment_is_exact_from_far_away(along):
    across, length = 20.0, 0.25
    expected = np.arctan((length - along) / across) + np.arctan(along / across)
    found = subtended_angle(np.float32(across), np.float32(along), np.float32(length))
    assert found == pytest.approx(expected, rel=1e-4)


LAMPS = {
    "point": lamp("POINT", (0.5, 0.3, 0.0), radius=0.1),
    "spot": lamp("SPOT", (0.5, 0.3, 1.0), radius=0.2, spot_angle=0.7, spot_blend=0.3),
    "wide spot": lamp("SPOT", (0.5, 0.3, 1.0), spot_angle=2.9, spot_blend=0.1),
    "squeezed spot": lamp(
        "SPOT", (0.5, 0.3, 1.0), [(2.0, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 1.0)], radius=0.1, spot_angle=1.0,
        spot_blend=0.5,
    ),
    "area": lamp("AREA", (0.2, 0.1, 0.8), size_x=0.5),
    "narrow area": lamp("AREA", (0.2, 0.1, 0.8), size_x=0.5, spread=0.6),
}  # fmt: skip


@pytest.mark.parametrize("name", LAMPS)
def test_nothing_that_a_lamp_lights_lies_outside_of_its_interval(name):
    lights, geometry = build(make_description([LAMPS[name]]))
    node = int(lights.emitters[0, EMITTER_NODE])
    generator, u = np.random.default_rng(5), stratified(64, 6)
    outside = 0
    for _ in range(150):
        origin = generator.uniform(-3.0, 3.0, 3).astype(np.float32)
        direction = generator.normal(size=3)
        direction = (direction / np.linalg.norm(direction)).astype(np.float32)
        length = np.float32(generator.uniform(0.5, 10.0))
        start, end = lit_interval(lights.nodes, node, tuple(origin), tuple(direction), length)
        assert end <= length and (start >= 0.0)
        for t in generator.uniform(0.0, length, 8):
            if start <= t <= end:
                continue
            outside += 1
            samples = draw(lights, geometry, origin + np.float32(t) * direction, 1e6 * direction, u, True)
            lit = np.where(samples[:, 0] > 0.0, samples[:, 6], 0.0)
            assert lit.max() <= 1e-6 * 100.0
    # And the interval leaves something out where the lamp does not shine all around.
    assert (outside > 0) == (name != "point")


@kernel
def _pick_many(lights, origin, direction, length, u, emitters, pmfs):
    for i in range(u.shape[0]):
        emitters[i], pmfs[i] = pick_for_segment(lights, 0, origin, direction, length, length, u[i])


def test_lights_are_chosen_for_a_segment_with_the_probability_that_is_said():
    generator = np.random.default_rng(7)
    lamps = [lamp("POINT", generator.uniform(-4.0, 4.0, 3), radius=0.05) for _ in range(30)]
    lights, _ = build(make_description([*lamps, lamp("SUN")]))
    u = (np.arange(200000, dtype=np.float64) + 0.5) / 200000
    emitters, pmfs = np.zeros(len(u), np.int64), np.zeros(len(u), np.float32)
    _pick_many(
        lights, (np.float32(-2.0), np.float32(0.0), np.float32(0.0)),
        (np.float32(1.0), np.float32(0.0), np.float32(0.0)), np.float32(3.0), u.astype(np.float32), emitters, pmfs,
    )  # fmt: skip
    shares = np.bincount(emitters, minlength=31) / len(u)
    said = np.zeros(31)
    said[emitters] = pmfs
    assert (shares > 0.0).all()
    assert np.allclose(shares, said, atol=2e-4)


@kernel
def _estimate(lights, closures, coefficients, throughput, node, origin, direction, length, fills_all, u, out):
    for i in range(u.shape[0]):
        distance, weight = choose_distance(
            lights, closures, coefficients, throughput, 0, node, origin, direction, length, fills_all, u[i, 0], u[i, 1],
        )
        out[i, 0] = distance
        out[i, 1] = weight


@pytest.mark.parametrize("name", ["point", "spot", "narrow area", "sun"])
@pytest.mark.parametrize("fills_all", [False, True])
def test_distances_and_their_weights_estimate_any_integral_along_the_segment(name, fills_all):
    """What is integrated is none of the things that distances are chosen by, where the lamp shines."""
    scene = make_description([LAMPS.get(name, lamp("SUN"))])
    lights, _ = build(scene)
    node = int(lights.emitters[0, EMITTER_NODE])
    closures = allocate_closures(1)
    closures.count[0] = 0
    add_phase(closures, 0, np.float32(1.0), np.float32(0.95), np.float32(0.0), np.float32(0.0))
    coefficients = np.zeros((COEFFICIENT_ROWS, 3), np.float32)
    coefficients[EXTINCTION] = (0.1, 0.5, 1.5)
    coefficients[SCATTERING] = (0.1, 0.3, 0.5)
    origin, direction = np.array([-2.0, 0.2, -0.8], np.float32), np.array([1.0, 0.0, 0.0], np.float32)
    length = np.float32(5.0)
    samples = np.zeros((400000, 2), np.float32)
    u = np.random.default_rng(8).random((400000, 2)).astype(np.float32)
    _estimate(
        lights, closures, coefficients, np.ones((1, 3), np.float32), node, tuple(origin), tuple(direction), length,
        fills_all, u, samples,
    )  # fmt: skip
    start, end = (0.0, 5.0) if node < 0 else lit_interval(lights.nodes, node, tuple(origin), tuple(direction), length)
    middle = 0.5 * (float(start) + float(end))

    def value(t):
        # Within what the cone of the narrowest of these lamps lights for sure.
        return np.where(np.abs(t - middle) < 0.25, 1.0 + np.sin(3.0 * t), 0.0)

    found = value(samples[:, 0].astype(np.float64)) * samples[:, 1]
    expected = integrate.quad(value, middle - 0.25, middle + 0.25)[0]
    error = found.std() / np.sqrt(len(found))
    assert abs(found.mean() - expected) < 4.0 * error
    assert error < 0.01 * expected
