# SPDX-License-Identifier: GPL-3.0-or-later
"""Fibres by Huang's model: samples follow the density, given what a closure draws; the mean keeps the energy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from engine.kernels.bsdf import fibre_color, hair, huang
from engine.kernels.bsdf.fresnel import fresnel_dielectric
from engine.kernels.bsdf.kinds import HUANG, TRANSPARENT
from engine.kernels.bsdf.lobe import View
from engine.kernels.bsdf.tables import load_tables
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_KIND_PARAMS, CLOSURE_WEIGHT, LANE_COUNT, MAX_CLOSURES, allocate_closures
from tests.helpers.chi2 import histogram, p_value, sidak
from tests.helpers.closure_operands import pack_operands
from tests.helpers.fibre_cells import cell_integrals

#: Along the axis of the cells.
TANGENT = (0.0, 0.0, 2.0)
SAMPLES = 40_000
ROWS, COLUMNS = 12, 24
#: Closures of a node that is alone, one for each way through the fibre.
WAYS = 8
_CLEAR = (0.0, 0.0, 0.0)


@kernel
def _add(closures, tables, lanes, memory, code, wo, ns, tangent, randoms, footprint):
    for k in range(lanes):
        normal = (ns[k, 0], ns[k, 1], ns[k, 2])
        view = View(wo, normal, normal, False, tangent, randoms[k], footprint)
        huang.run_huang(closures, tables, k, view, 1.0, memory, code, 0)


@kernel
def _evaluate(param, channels, lane, count, wo, directions, pdfs, values):
    for k in range(directions.shape[0]):
        wi = (directions[k, 0], directions[k, 1], directions[k, 2])
        pdfs[k] = 0.0
        for c in range(3):
            values[k, c] = 0.0
        for i in range(count):
            pdfs[k] += huang.eval_huang(param, channels, lane, i, wo, wo, wi, 1.0, values, k) / count


@kernel
def _sample(param, channels, lane, count, wo, u, directions):
    for k in range(u.shape[0]):
        scaled = u[k, 0] * np.float32(count)
        i = min(int(scaled), count - 1)
        wi = huang.sample_huang(param, channels, lane, i, wo, scaled - np.float32(i), u[k, 1], u[k, 2])
        for c in range(3):
            directions[k, c] = wi[c]


def _unit(vector: Any) -> tuple[np.float32, ...]:
    return tuple(np.float32(np.asarray(vector) / np.linalg.norm(vector)))


#: What the node is given, and from how far the camera sees it.
_DEFAULTS = {
    "alpha": 0.3, "tilt": 0.035, "ior": 1.55, "aspect": 1.0, "lobes": (1.0, 1.0, 1.0), "axis": _CLEAR,
    "thickness": 0.0, "footprint": -1.0,
}  # fmt: skip


def _closures(
    wo: Any, sigma: Any = _CLEAR, *, across: Any = None, count: int = LANE_COUNT, tangent: Any = TANGENT,
    onto: Any = None, **given: Any,
) -> Any:  # fmt: skip
    """Closures that differ by what they draw; `across` are where rays meet the round strand, -1 to 1.

    They are added to those of `onto`.
    """
    assert set(given) <= set(_DEFAULTS)
    node = {**_DEFAULTS, **given}
    rng = np.random.default_rng(3)
    closures = allocate_closures(count) if onto is None else onto
    across = rng.uniform(-1.0, 1.0, count) if across is None else np.broadcast_to(across, count)
    side = np.cross(TANGENT, wo)
    side /= np.linalg.norm(side)
    front = np.cross(side, TANGENT) / 2.0
    ns = (-across[:, None] * side + np.sqrt(1.0 - across[:, None] ** 2) * front).astype(np.float32)
    # Color, tint, melanin, redness, its randomness, roughness, its randomness, offset, ior, random, aspect ratio,
    # lobes, thickness, normal, edge.
    operands = [
        sigma, (1.0, 1.0, 1.0), 0.0, 0.0, 0.0, node["alpha"], 0.0, node["tilt"], node["ior"], 0.5, node["aspect"],
        *node["lobes"], node["thickness"], node["axis"], _CLEAR,
    ]  # fmt: skip
    memory, code = pack_operands(operands, fibre_color.FIBRE_ABSORPTION)
    randoms = ((np.arange(count) + rng.random()) / count).astype(np.float32)
    tangent = tuple(np.float32(tangent))
    _add(closures, load_tables(), count, memory, code, wo, ns, tangent, randoms, np.float32(node["footprint"]))
    return closures


def _values(closures: Any, lane: int, wo: Any, directions: Any) -> tuple[Any, Any]:
    directions = np.ascontiguousarray(directions, np.float32)
    pdfs, values = np.zeros(len(directions), np.float32), np.zeros((len(directions), 3), np.float32)
    _evaluate(closures.param, closures.channels, lane, closures.count[lane], wo, directions, pdfs, values)
    return pdfs, values


def _samples(closures: Any, lane: int, wo: Any, count: int, seed: int) -> Any:
    u = np.random.default_rng(seed).random((count, 3), np.float32)
    directions = np.zeros((count, 3), np.float32)
    _sample(closures.param, closures.channels, lane, closures.count[lane], wo, u, directions)
    return directions


WO = _unit((0.6, 0.64, 0.48))
CASES = {
    "round": {"alpha": 0.4},
    "tinted": {"alpha": 0.5, "sigma": (0.1, 0.5, 2.0)},
    "elliptical": {"alpha": 0.5, "aspect": 0.6, "axis": (1.0, 0.2, 0.1), "across": 0.1},
    "thin": {"alpha": 0.5, "ior": 0.7},
    "tilted": {"alpha": 0.4, "tilt": 0.3},
}


@pytest.mark.parametrize("name", CASES)
def test_samples_follow_the_density(name: str) -> None:
    closures = _closures(WO, **CASES[name], count=64)
    lanes = range(0, 64, 13)
    for lane in lanes:
        directions = _samples(closures, lane, WO, SAMPLES, 11 + lane)
        kept = directions[np.linalg.norm(directions, axis=1) > 0.5]
        assert np.abs(np.linalg.norm(kept, axis=1) - 1.0).max() < 1e-5
        cells = cell_integrals(lambda d, k=lane: _values(closures, k, WO, d)[0], ROWS, COLUMNS)
        assert p_value(histogram(kept, ROWS, COLUMNS), cells, SAMPLES) > sidak(1e-3, len(CASES) * len(lanes))


def _albedo(wo: Any, **settings: Any) -> float:
    """What a fibre sends back of the same light from everywhere."""
    closures = _closures(wo, **settings)
    total = 0.0
    for lane in range(LANE_COUNT):
        assert closures.kind[lane, 0] == HUANG
        directions = _samples(closures, lane, wo, 8, lane)
        pdfs, values = _values(closures, lane, wo, directions)
        kept = (np.linalg.norm(directions, axis=1) > 0.5) & (pdfs > 0.0)
        total += (values[kept, 0] / pdfs[kept]).sum() / 8
    return total / LANE_COUNT


@pytest.mark.parametrize(("alpha", "excess"), [(0.05, 0.01), (0.3, 0.04), (1.0, 0.1)])
def test_a_clear_fibre_loses_nothing(alpha: float, excess: float) -> None:
    """Rough ones gain a little, as in Cycles: what is reflected inside for the third time is not lost to facets."""
    for slope in (0.0, 1.0):
        wo = _unit((0.6, 0.8, slope))
        for settings in ({}, {"aspect": 0.6, "axis": (1.0, 0.3, 0.0), "across": 0.1}):
            albedo = _albedo(wo, alpha=alpha, tilt=0.0, **settings)
            assert 0.99 <= albedo <= 1.0 + excess, (slope, settings, albedo)


def test_lobes_are_weighed_apart() -> None:
    whole = _albedo(WO, alpha=0.2)
    parts = [_albedo(WO, alpha=0.2, lobes=lobes) for lobes in np.eye(3)]
    # What is reflected more than once inside comes with TRT.
    assert np.isclose(sum(parts), whole, atol=0.02)
    assert parts[1] > parts[0] > 0.03
    assert np.isclose(_albedo(WO, alpha=0.2, lobes=(2.0, 0.0, 0.0)), 2.0 * parts[0], atol=0.01)


def test_pigment_absorbs_by_the_way_inside() -> None:
    closures = _closures(WO, (0.0, 1.0, 100.0), alpha=0.1, lobes=(0.0, 1.0, 0.0), across=0.0, tilt=0.0)
    lanes = range(0, LANE_COUNT, 64)
    for lane in lanes:
        directions = _samples(closures, lane, WO, 16, lane)
        _, values = _values(closures, lane, WO, directions)
        lit = values[:, 0] > 1e-3
        # No way is longer than two radii over the cosine inside, and light that misses the middle has shorter ones.
        share = values[lit, 1] / values[lit, 0]
        assert (share > math.exp(-2.6)).all()
        assert (share < 1.0).all()
        assert (values[lit, 2] < 1e-3 * values[lit, 0]).all()


def test_rays_pass_beside_a_narrow_ellipse() -> None:
    """By twice the cosine that such a ray meets the strand at."""
    for across, kind in ((0.3, HUANG), (0.7, TRANSPARENT)):
        # The major axis points to the viewer.
        closures = _closures(_unit((0.0, 1.0, 0.3)), aspect=0.5, axis=(0.0, 1.0, 0.0), across=across, count=16)
        assert (closures.count == (1 if kind == TRANSPARENT else WAYS)).all()
        assert (closures.kind[:16, : closures.count[0]] == kind).all()
    # No matter which of both axes is the longer one.
    wide = _closures(_unit((0.0, 1.0, 0.3)), aspect=2.0, axis=(0.0, 1.0, 0.0), across=0.7, count=16)
    assert (wide.kind[:16, 0] == TRANSPARENT).all()


def test_fibres_seen_near_keep_to_where_the_ray_meets_them() -> None:
    near, far = (
        _closures(_unit((0.0, 1.0, 0.0)), across=0.5, tilt=0.0, thickness=2.0, footprint=footprint)
        for footprint in (0.1, 4.0)
    )
    first = CLOSURE_KIND_PARAMS + 9
    at = -np.sin(near.param[:, :WAYS, first])
    assert ((at > 0.44) & (at < 0.56)).all()
    spread = np.sort(-np.sin(far.param[:, :WAYS, first]), axis=1)
    assert spread.min() < -0.99
    assert spread.max() > 0.99
    assert np.allclose(np.diff(spread, axis=1), 2.0 / WAYS, atol=1e-3), "not spread evenly"


def test_nodes_that_come_later_find_room() -> None:
    """Each leaves half of what is free, and so none is lost."""
    closures = _closures(WO, count=4)
    weights = [closures.param[:, : closures.count[0], CLOSURE_WEIGHT].sum(axis=1)]
    for _ in range(4):
        _closures(WO, count=4, onto=closures)
        weights.append(closures.param[:, : closures.count[0], CLOSURE_WEIGHT].sum(axis=1))
    assert (closures.count == MAX_CLOSURES).all()
    assert np.allclose(np.diff(weights, axis=0, prepend=0.0), 1.0)


@pytest.mark.parametrize("alpha", [0.0, 1.0, -1.0])
@pytest.mark.parametrize("ior", [0.0, 0.5, 1.0, 100.0])
@pytest.mark.parametrize("aspect", [0.0, 1.0, 50.0])
def test_bad_input_gives_numbers(alpha: float, ior: float, aspect: float) -> None:
    for wo, tangent, sigma in (
        (WO, TANGENT, (0.0, 1e30, -1.0)), (_unit(TANGENT), TANGENT, _CLEAR), (WO, _CLEAR, _CLEAR),
    ):  # fmt: skip
        side = _closures(WO, sigma, alpha=alpha, ior=ior, aspect=aspect, tilt=3.0, count=32, tangent=tangent)
        for lane in np.flatnonzero(side.kind[:32, 0] == HUANG):
            assert np.isfinite(side.param[lane, : side.count[lane]]).all()
            directions = _samples(side, lane, wo, 16, lane)
            pdfs, values = _values(side, lane, wo, np.concatenate([directions, -directions, np.eye(3)]))
            assert np.isfinite(directions).all()
            assert np.isfinite(pdfs).all()
            assert np.isfinite(values).all()
            assert (values >= 0.0).all()


def test_the_albedo_is_a_series_of_reflections() -> None:
    """Of the smooth fibre: what is reflected at once, and what leaves after passing through it once, twice, ..."""
    absorbed = (0.0, 0.4, 1e4)
    closures = _closures(WO, absorbed, across=0.3, tilt=0.0, count=1)
    cosine = math.sqrt(1.0 - 0.3**2) * math.sqrt(1.0 - WO[2] ** 2)
    reflected, cos_inside = fresnel_dielectric(cosine, 1.55)
    along = WO[2] / 1.55
    for c, sigma in enumerate(absorbed):
        passed = math.exp(-2.0 * sigma * abs(cos_inside) / (1.0 - along * along))
        series = sum((1.0 - reflected) ** 2 * passed * (reflected * passed) ** k for k in range(30))
        assert math.isclose(huang.huang_albedo(closures.param, 0, 0, WO, c), reflected + series, rel_tol=1e-4)


def test_denoisers_are_told_the_direction_along_fibres() -> None:
    closures = _closures(WO, count=1)
    assert np.allclose(hair.feature_normal(closures, 0, 0, WO), (0.0, 0.0, 1.0), atol=1e-6)
