# SPDX-License-Identifier: GPL-3.0-or-later
"""Lobes of fibres: samples follow the density, and nothing is lost where nothing is absorbed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.kernels.bsdf import chiang, fibre_color, hair
from engine.kernels.bsdf.evaluate import BY_GUIDE, BY_LIGHT, EVERY_KIND, eval_channels
from engine.kernels.bsdf.fresnel import fresnel_dielectric
from engine.kernels.bsdf.lobe import View
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_N, allocate_closures
from tests.helpers.chi2 import histogram, p_value, sidak
from tests.helpers.closure_operands import pack_operands
from tests.helpers.fibre_cells import cell_integrals

WO = (np.float32(0.6), np.float32(0.64), np.float32(0.48))
NS = (np.float32(0.8), np.float32(0.6), np.float32(0.0))
#: Along the axis of the cells: about it densities change quickly.
TANGENT = (np.float32(0.0), np.float32(0.0), np.float32(2.0))
SAMPLES = 40_000
ROWS, COLUMNS = 12, 24


@kernel
def _add(closures, is_chiang, memory, code, wo, ns, tangent):
    view = View(wo, ns, ns, False, tangent, 0.5, -1.0)
    if is_chiang:
        chiang.run_chiang(closures, 0, 0, view, 1.0, memory, code, 0)
    else:
        hair.run_hair(closures, 0, 0, view, 1.0, memory, code, 0)


@kernel
def _evaluate(param, channels, kind, wo, ns, directions, pdfs, values):
    for k in range(directions.shape[0]):
        wi = (directions[k, 0], directions[k, 1], directions[k, 2])
        for c in range(3):
            values[k, c] = 0.0
        if kind == chiang.CHIANG:
            pdfs[k] = chiang.eval_chiang(param, channels, 0, 0, ns, wo, wi, 1.0, values, k)
        elif kind == hair.HAIR_REFLECTION:
            pdfs[k] = hair.eval_hair_reflection(param, channels, 0, 0, ns, wo, wi, 1.0, values, k)
        else:
            pdfs[k] = hair.eval_hair_transmission(param, channels, 0, 0, ns, wo, wi, 1.0, values, k)


@kernel
def _sample(param, channels, kind, wo, u, directions):
    for k in range(u.shape[0]):
        if kind == chiang.CHIANG:
            wi = chiang.sample_chiang(param, channels, 0, 0, wo, u[k, 0], u[k, 1], u[k, 2])
        elif kind == hair.HAIR_REFLECTION:
            wi = hair.sample_hair_reflection(param, channels, 0, 0, wo, u[k, 0], u[k, 1], u[k, 2])
        else:
            wi = hair.sample_hair_transmission(param, channels, 0, 0, wo, u[k, 0], u[k, 1], u[k, 2])
        for c in range(3):
            directions[k, c] = wi[c]


def _closure(is_chiang, operands, immediate, tangent=TANGENT):
    closures = allocate_closures(1)
    closures.ns[0] = NS
    memory, code = pack_operands(operands, immediate)
    _add(closures, is_chiang, memory, code, WO, NS, tangent)
    assert closures.count[0] == 1
    return closures


def _chiang(sigma, along, around, coat=0.0):
    # Color, tint, melanin, redness, randomness, roughnesses, randomness, coat, offset, ior, random, edge.
    operands = [sigma, (1.0, 1.0, 1.0), 0.0, 0.0, 0.0, along, around, 0.0, coat, 0.035, 1.55, 0.5, (0.0, 0.0, 0.0)]
    return _closure(True, operands, fibre_color.FIBRE_ABSORPTION)


def _hair(along, around, is_transmission):
    return _closure(False, [(1.0, 1.0, 1.0), along, around, 0.1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)], is_transmission)


CASES = {
    "reflection": lambda: _hair(0.4, 0.4, 0),
    "transmission": lambda: _hair(0.4, 0.5, 1),
    "chiang": lambda: _chiang((0.1, 0.5, 2.0), 0.4, 0.5),
    "chiang rough": lambda: _chiang((0.1, 0.5, 2.0), 0.8, 0.9, coat=0.3),
}


def _values(closures, directions, n=(np.float32(0.0),) * 3):
    directions = np.ascontiguousarray(directions, np.float32)
    pdfs, values = np.zeros(len(directions), np.float32), np.zeros((len(directions), 3), np.float32)
    _evaluate(closures.param, closures.channels, closures.kind[0, 0], WO, n, directions, pdfs, values)
    return pdfs, values


def _cell_integrals(closures, column=None):
    """Density, or a column of the value, over the cells of `histogram`."""

    def values_of(directions):
        pdfs, values = _values(closures, directions)
        return pdfs if column is None else values[:, column]

    return cell_integrals(values_of, ROWS, COLUMNS)


@pytest.mark.parametrize("name", CASES)
def test_samples_follow_the_density(name: str) -> None:
    closures = CASES[name]()
    u = np.random.default_rng(11).random((SAMPLES, 3), np.float32)
    directions = np.zeros((SAMPLES, 3), np.float32)
    _sample(closures.param, closures.channels, closures.kind[0, 0], WO, u, directions)
    assert np.abs(np.linalg.norm(directions, axis=1) - 1.0).max() < 1e-5
    # What a sample's own density does not know is rejected.
    kept = directions[_values(closures, directions)[0] > 0.0]
    assert p_value(histogram(kept, ROWS, COLUMNS), _cell_integrals(closures), SAMPLES) > sidak(1e-3, len(CASES))


@kernel
def _by(closures, wo, directions, sampled, out):
    for k in range(directions.shape[0]):
        wi = (directions[k, 0], directions[k, 1], directions[k, 2])
        eval_channels(closures, 0, wo, wi, EVERY_KIND, sampled, -1.0, out, k)


@pytest.mark.parametrize("is_transmission", [0, 1])
def test_rays_go_to_either_side_and_light_samples_do_not(is_transmission: int) -> None:
    """So a white fibre sends on all light that rays find, as in Cycles, whatever has proposed them."""
    closures = _hair(0.4, 0.5, is_transmission)
    n = (1.0, 0.0, 0.0)
    closures.param[0, 0, CLOSURE_N : CLOSURE_N + 3] = n
    u = np.random.default_rng(3).random((4096, 3), np.float32)
    directions = np.zeros((len(u), 3), np.float32)
    _sample(closures.param, closures.channels, closures.kind[0, 0], WO, u, directions)
    pdfs, _ = _values(closures, directions)
    assert (pdfs > 0.0).mean() > 0.998
    values = {by: np.zeros((len(u), 3), np.float32) for by in (0, BY_GUIDE, BY_LIGHT)}
    for by, out in values.items():
        _by(closures, WO, directions, by, out)
    assert np.array_equal(values[0][:, 0], pdfs)
    assert np.array_equal(values[BY_GUIDE], values[0])
    is_right = (directions @ np.array(n) < 0.0) == bool(is_transmission)
    assert 0.05 < 1.0 - is_right.mean() < 0.5
    assert np.array_equal(values[BY_LIGHT], np.where(is_right[:, None], values[0], 0.0))


def test_a_clear_fibre_loses_nothing() -> None:
    for roughness in (0.3, 0.6, 0.9):
        closures = _chiang((0.0, 0.0, 0.0), roughness, roughness)
        total = _cell_integrals(closures, 0).sum()
        assert math.isclose(total, 1.0, abs_tol=0.003), (roughness, total)


@pytest.mark.parametrize("given", [(0.0, 0.0, 0.0), (0.0, 3.0, 0.0)])
def test_on_triangles_the_tangent_is_an_edge(given: tuple[float, ...]) -> None:
    """Where the node is given none; then nothing is tilted either, as in Cycles."""
    none = (np.float32(0.0),) * 3
    edge = (0.0, 0.0, 4.0)
    param = _closure(False, [(1.0, 1.0, 1.0), 0.4, 0.4, 0.1, given, edge], 0, none).param[0, 0]
    column = hair.HAIR_TANGENT
    is_given = any(given)
    # Divisions may be by reciprocals, which round once more.
    expected = (0.0, 1.0, 0.0) if is_given else (0.0, 0.0, 1.0)
    assert np.allclose(param[column : column + 3], expected, rtol=0.0, atol=2.0**-23)
    assert np.isclose(param[column + 5], -0.1 if is_given else 0.0)


def test_the_albedo_of_chiangs_model_is_the_colour_that_its_absorption_comes_from():
    """Where roughness and variance are the same number, and besides what is reflected first."""
    absorbed = (0.0, 0.3, 1e4)
    closures = _chiang(absorbed, 0.4, 0.4)
    reflected, _ = fresnel_dielectric(float(np.dot(WO, NS)), 1.55)
    # Chiang et al. 2016, equations 7 and 9.
    variance = (0.726 * 0.4 + 0.812 * 0.4**2 + 3.7 * 0.4**20) ** 2
    fit = np.polyval((0.245, 5.574, -10.73, 2.532, -0.215, 5.969), variance)
    for c, sigma in enumerate(absorbed):
        found = chiang.chiang_albedo(closures.param, 0, 0, WO, c)
        assert np.isclose(found, np.exp(-np.sqrt(sigma) * fit) + reflected, rtol=1e-3)


def test_denoisers_are_told_the_direction_across_chiangs_fibres():
    closures = _chiang((0.1, 0.2, 0.3), 0.4, 0.4)
    across = np.cross(TANGENT, WO)
    assert np.allclose(hair.feature_normal(closures, 0, 0, WO), across / np.linalg.norm(across), atol=1e-6)
