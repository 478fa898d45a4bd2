# SPDX-License-Identifier: GPL-3.0-or-later
"""Phase functions: values against formulas, and the sampler against its density.

The chi-square tests reject at 1e-4 for all of them together; samples are fixed.
"""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.bsdf.phase import add_phase, eval_phase, sample_phase
from engine.runtime.jit import kernel
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
        pdfs[row] = eval_phase(param, channels, 0, 0, normal, wo, wi, np.float32(1.0), out, row)


@kernel
def _draw(param, wo, normal, numbers, out):
    for row in range(numbers.shape[0]):
        wi = sample_phase(param, 0, 0, normal, wo, numbers[row, 0], numbers[row, 1])
        out[row, 0], out[row, 1], out[row, 2] = wi


def _lobe(g, alpha=0.0):
    closures = allocate_closures(1)
    add_phase(closures, 0, np.float32(1.0), np.float32(g), np.float32(alpha))
    return closures


def _evaluate(g, alpha, directions):
    """Value, float (N,), and density of the sampler, float (N,)."""
    closures = _lobe(g, alpha)
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
