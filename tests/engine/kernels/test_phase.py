# SPDX-License-Identifier: GPL-3.0-or-later
"""Phase functions: values against formulas, and the sampler against its density.

The chi-square tests reject at 1e-4 for all of them together; samples are fixed.
"""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.bsdf.fournier_forand import sample_fournier_forand
from engine.kernels.bsdf.phase import add_phase, eval_phase_lobe, sample_phase_lobe
from engine.runtime.jit import kernel
from engine.shaders.media import fournier_forand_parameters
from engine.state.lanes import allocate_closures
from tests.helpers.chi2 import cell_integrals, histogram, p_value, sidak

WO = (np.float32(0.0), np.float32(0.6), np.float32(0.8))
NO_NORMAL = (np.float32(0.0), np.float32(0.0), np.float32(0.0))
G = (-0.9, -0.3, 0.0, 0.0005, 0.5, 0.95)
SAMPLES = 200_000


@kernel
def _values(param, channels, wo, normal, directions, out, pdfs):
    for row in range(directions.shape[0]):
        wi = (directions[row, 0], directions[row, 1], directions[row, 2])
        pdfs[row] = eval_phase_lobe(param, channels, 0, 0, normal, wo, wi, np.float32(1.0), out, row)


@kernel
def _draw(param, wo, normal, numbers, out):
    for row in range(numbers.shape[0]):
        wi = sample_phase_lobe(param, 0, 0, normal, wo, numbers[row, 0], numbers[row, 1])
        out[row, 0], out[row, 1], out[row, 2] = wi


def _lobe(g, alpha=0.0, delta=0.0):
    closures = allocate_closures(1)
    add_phase(closures, 0, np.float32(1.0), np.float32(g), np.float32(alpha), np.float32(delta))
    return closures


def _evaluate(g, alpha, directions, delta=0.0):
    """Value, float (N,), and density of the sampler, float (N,)."""
    closures = _lobe(g, alpha, delta)
    out, pdfs = np.zeros((len(directions), 3), np.float32), np.zeros(len(directions), np.float32)
    _values(closures.param, closures.channels, WO, NO_NORMAL, np.asarray(directions, np.float32), out, pdfs)
    return out[:, 0], pdfs


@pytest.mark.parametrize("g", G)
@pytest.mark.parametrize("alpha", [0.0, 0.5, 1.0, 30.0])
def test_phase_functions_are_normalised_with_the_mean_cosine_that_draine_gives(g, alpha):
    def value(directions):
        return _evaluate(g, alpha, directions)[0]

    def cosine(directions):
        return -value(directions) * (directions @ np.array(WO))

    total, mean = (cell_integrals(of, 32, 8, subdivisions=4).sum() for of in (value, cosine))
    expected = g * (1.0 + alpha * (3.0 + 2.0 * g * g) / 5.0) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)
    assert total == pytest.approx(1.0, abs=2e-3)
    assert mean == pytest.approx(expected, abs=4e-3)


def test_rayleigh_scattering_is_draines_function_without_asymmetry():
    directions = np.random.default_rng(1).normal(size=(64, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    cosine = directions @ np.array(WO)
    assert np.allclose(_evaluate(0.0, 1.0, directions)[0], 3.0 / (16.0 * np.pi) * (1.0 + cosine**2), rtol=1e-5)


@pytest.mark.parametrize("g", G)
def test_directions_are_drawn_by_the_density(g):
    closures = _lobe(g)
    numbers = np.random.default_rng(7).random((SAMPLES, 2), np.float32)
    drawn = np.zeros((SAMPLES, 3), np.float32)
    _draw(closures.param, WO, NO_NORMAL, numbers, drawn)
    assert np.allclose(np.linalg.norm(drawn, axis=1), 1.0, atol=1e-5)
    probability = cell_integrals(lambda directions: _evaluate(g, 0.0, directions)[1], 24, 24, subdivisions=4)
    assert p_value(histogram(drawn, 24, 24), probability, SAMPLES) > sidak(1e-4, len(G))


#: Refractive indices and shares of light that goes back: the node's own, the ends of what it takes, and one where the
#: angle at which Fournier and Forand's formula is 0 / 0 lies in the middle.
PARTICLES = [(1.33, 0.1), (1.05, 0.02), (1.0, 0.3), (2.0, 0.45), (1.577, 0.2), (1.1, 0.5), (1.8165, 0.1)]


def _ahead_of(s):
    """Directions that light is scattered to by angles of these squared half sines."""
    s = np.asarray(s, np.float64)
    across = np.array([1.0, 0.0, 0.0])
    return np.outer(2.0 * s - 1.0, np.array(WO)) + np.outer(2.0 * np.sqrt(s * (1.0 - s)), across)


def _fournier_and_jonasz(s, ior, backscatter):
    """Density [sr^-1] as Fournier and Jonasz 1999 write it, in double precision, and how much is scattered by less."""
    delta, at_90, at_180 = (4.0 * x / (3.0 * (ior - 1.0) ** 2) for x in (s, 0.5, 1.0))
    v = -np.log(2.0 * backscatter * (at_90 - 1.0) + 1.0) / np.log(at_90)
    power, cosine = delta**v, 1.0 - 2.0 * s
    value = v * (1.0 - delta) - (1.0 - power) + (delta * (1.0 - power) - v * (1.0 - delta)) / s
    value /= 4.0 * np.pi * (1.0 - delta) ** 2 * power
    value += (1.0 - at_180**v) / (16.0 * np.pi * (at_180 - 1.0) * at_180**v) * (3.0 * cosine**2 - 1.0)
    less = (1.0 - delta * power - (1.0 - power) * s) / ((1.0 - delta) * power)
    less += (1.0 - at_180**v) / (8.0 * (at_180 - 1.0) * at_180**v) * cosine * (1.0 - cosine**2)
    return value, less


@pytest.mark.parametrize(("ior", "backscatter"), [case for case in PARTICLES if case[0] > 1.0 and case[1] < 0.5])
def test_particles_in_water_scatter_by_fournier_and_forands_formula(ior, backscatter):
    g, exponent, delta = fournier_forand_parameters(ior, backscatter)
    s = np.concatenate([np.logspace(-9.0, -2.0, 50), np.linspace(0.0101, 0.999, 399)])
    # The formula itself is 0 / 0 there.
    s = s[np.abs(delta * s - 1.0) > 1e-4]
    expected, _ = _fournier_and_jonasz(s, ior, backscatter)
    value, pdf = _evaluate(g, exponent, _ahead_of(s), delta)
    assert (value == pdf).all()
    assert np.allclose(value, expected, rtol=1e-3)


@kernel
def _draw_angles(numbers, exponent, delta, out):
    for row in range(len(numbers)):
        out[row] = sample_fournier_forand(numbers[row], exponent, delta)


@pytest.mark.parametrize(("ior", "backscatter"), PARTICLES)
def test_angles_of_particles_are_those_that_random_numbers_mean(ior, backscatter):
    exponent, delta = np.array(fournier_forand_parameters(ior, backscatter)[1:], np.float32).astype(np.float64)
    numbers = np.concatenate([np.linspace(0.0, 0.99999, 3001), np.logspace(-7.0, -1.0, 101)]).astype(np.float32)
    angles = np.zeros(len(numbers), np.float32)
    _draw_angles(numbers, np.float32(exponent), np.float32(delta), angles)
    assert (angles >= 0.0).all() and (angles <= 1.0).all() and angles[0] == 0.0
    found = angles > 1e-16
    at = angles[found].astype(np.float64)
    x = delta * at
    less = (x**exponent * (1.0 - at) + at - x) / (1.0 - x)
    less += (delta**exponent - 1.0) / (delta - 1.0) * at * (1.0 - at) * (1.0 - 2.0 * at) / 2.0
    is_plain = np.abs(x - 1.0) > 1e-5
    assert np.allclose(less[is_plain], numbers[found][is_plain], rtol=0.0, atol=1e-5)


@pytest.mark.parametrize(("ior", "backscatter"), PARTICLES)
def test_particles_send_as_much_back_as_they_are_told_and_have_the_mean_cosine_that_is_computed(ior, backscatter):
    g, exponent, delta = fournier_forand_parameters(ior, backscatter)
    # Much lies at angles that no even grid resolves, so the fourth root of s is taken in equal steps.
    root = (np.arange(20_000) + 0.5) / 20_000
    s = root**4
    value = _evaluate(g, exponent, _ahead_of(s), delta)[0].astype(np.float64) * 4.0 * np.pi * 4.0 * root**3 / 20_000
    kept = min(backscatter, 0.499)
    assert value[s > 0.5].sum() == pytest.approx(kept, abs=1e-3)
    assert (value * 2.0 * s).sum() == pytest.approx(1.0 - g, abs=2e-3)
    assert value.sum() == pytest.approx(1.0, abs=6e-3)


@pytest.mark.parametrize(("ior", "backscatter"), [(1.33, 0.1), (1.0, 0.3), (2.0, 0.45), (1.577, 0.2)])
def test_directions_off_particles_are_drawn_by_the_density(ior, backscatter):
    g, exponent, delta = fournier_forand_parameters(ior, backscatter)
    closures = _lobe(g, exponent, delta)
    numbers = np.random.default_rng(7).random((SAMPLES, 2), np.float32)
    drawn = np.zeros((SAMPLES, 3), np.float32)
    _draw(closures.param, WO, NO_NORMAL, numbers, drawn)
    assert np.allclose(np.linalg.norm(drawn, axis=1), 1.0, atol=1e-5)
    # In layers by angle and sectors around: the peak is no larger than its layer.
    ahead = -drawn.astype(np.float64) @ np.array(WO)
    s = np.clip(0.5 - 0.5 * ahead, 0.0, 1.0)
    edges = np.concatenate([[0.0], np.linspace(0.02, 1.0, 50)])
    layer = np.clip(np.searchsorted(edges, s, side="right") - 1, 0, 49)
    sideways = np.cross(np.array(WO), [1.0, 0.0, 0.0])
    sector = np.floor(np.arctan2(drawn @ sideways, drawn[:, 0]) / (2.0 * np.pi) * 8.0).astype(np.int64) % 8
    x = delta * edges[1:]
    less = (x**exponent * (1.0 - edges[1:]) + edges[1:] - x) / (1.0 - x)
    less += (delta**exponent - 1.0) / (delta - 1.0) * edges[1:] * (1.0 - edges[1:]) * (1.0 - 2.0 * edges[1:]) / 2.0
    probability = np.repeat(np.diff(less, prepend=0.0) / 8.0, 8)
    counts = np.bincount(layer * 8 + sector, minlength=400)
    assert p_value(counts, probability, SAMPLES) > sidak(1e-4, 4)
