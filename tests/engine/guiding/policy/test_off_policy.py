# SPDX-License-Identifier: GPL-3.0-or-later
"""What predictors promise by records, beside what is known of them on paper: nothing is rendered.

Figures are sums over records of fixed seeds; tolerances are four of their standard errors or more.
"""

from __future__ import annotations

import numpy as np
import pytest

from engine.guiding.fields.table import TABLE_SIDE, TableField, direction_to_cell
from engine.guiding.models.predictors import Predictions
from engine.guiding.neural.models.radiance_model import RadianceModel
from engine.guiding.neural.networks.radiance import NetworkShape, Snapshot
from engine.guiding.neural.networks.radiance_query import make_network_field
from engine.guiding.policy.off_policy import HeldOut, Moments, hold_out, moments, predict, promised_efficiency
from engine.guiding.policy.rules import RULES
from engine.guiding.records.vertices import allocate_vertex_records
from engine.ris.candidates import MAX_CANDIDATES
from engine.ris.orca import CandidateCosts
from tests.helpers.guiding_harness import densities, field_of, guide_at, mixture_density, sphere_grid, vmf_density
from tests.helpers.radiance_networks import BOUNDS, random_parameters
from tests.helpers.radiance_networks import predict as network_radiance

COUNT = 60_000
UP, LIGHT = (0.0, 0.0, 1.0), (0.6, 0.0, 0.8)
#: The field takes the light for wider than it is.
FIELD = field_of([(1.0, 4.0, LIGHT, 1e4)], fluence=1.0)
ALBEDO = 0.4


def light(directions: np.ndarray) -> np.ndarray:
    """Incident radiance: float64 (N,)."""
    return 0.2 + 3.0 * vmf_density(directions, LIGHT, 30.0)


def cosine_density(directions: np.ndarray) -> np.ndarray:
    return np.maximum(directions[:, 2], 0.0) / np.pi


def source_density(directions: np.ndarray) -> np.ndarray:
    return 0.5 * mixture_density(directions, [(1.0, 4.0, LIGHT)]) + 0.5 * cosine_density(directions)


def held_out(noise: float = 0.0, seed: int = 5) -> HeldOut:
    """Records of a diffuse vertex at the origin, drawn half by the mixture and half by the cosine."""
    rng = np.random.default_rng(seed)
    grid = sphere_grid(400, 800)
    density = source_density(grid)
    directions = grid[rng.choice(len(grid), COUNT, p=density / density.sum())]
    directions = directions[directions[:, 2] > 0.0]
    count = len(directions)
    records = allocate_vertex_records(count)
    records.direction[:], records.normal[:] = directions, UP
    records.pdf[:] = source_density(directions)
    records.bsdf_pdf[:] = cosine_density(directions)
    records.guide_pdf[:] = mixture_density(directions, [(1.0, 4.0, LIGHT)])
    found = light(directions) * np.maximum(1.0 + noise * rng.normal(size=count), 0.0)
    records.radiance[:] = found[:, None]
    records.reflectance[:] = ALBEDO * records.bsdf_pdf
    records.contribution_squared[:] = (records.reflectance * found / records.pdf) ** 2
    return hold_out(records, count, FIELD, np.full(1, 0.5, np.float32), float(COUNT))


@pytest.mark.parametrize("alpha", [1.0, 0.5])
def test_moments_are_those_of_the_densities(alpha: float) -> None:
    held, grid = held_out(), sphere_grid(400, 800)
    grid = grid[grid[:, 2] > 0.0]

    def whole(values: np.ndarray) -> float:
        return float(values.mean() * 2.0 * np.pi)

    reflected, source = ALBEDO * cosine_density(grid) * light(grid), source_density(grid)
    for predicted in (light, lambda directions: np.ones(len(directions)), lambda d: 1.0 + 5.0 * (d[:, 0] < 0.0)):
        target = cosine_density(grid) * predicted(grid)
        density = alpha * target / whole(target) + (1.0 - alpha) * source
        found = moments(held, predicted(held.records.direction.astype(np.float64)).astype(np.float32), alpha)
        # Directions below the remaining leave no record; they count as black.
        scale = found.count[0] / COUNT
        assert scale * found.source[0] == pytest.approx(whole(reflected**2 / source), rel=0.02)
        assert scale * found.target[0] == pytest.approx(whole(reflected**2 / density), rel=0.05)


def test_a_common_factor_does_not_matter_and_nonsense_is_bounded() -> None:
    held = held_out(noise=0.5)
    rng = np.random.default_rng(1)
    predicted = rng.random(len(held.leaf)).astype(np.float32)
    found, scaled = (moments(held, factor * predicted, 0.5) for factor in (1.0, 1e3))
    assert scaled.target[0] == pytest.approx(found.target[0], rel=1e-4)
    for nonsense in (np.zeros_like(predicted), 10.0 ** rng.uniform(-20, 20, len(predicted)).astype(np.float32)):
        found = moments(held, nonsense, 0.5)
        assert np.isfinite(found.target[0])
        # The defensive half.
        assert found.target[0] <= 2.0 * found.source[0] * 1.001
    # Black everywhere is no prediction.
    assert moments(held, np.zeros_like(predicted), 0.5).target[0] == pytest.approx(found.source[0], rel=1e-5)


def test_every_predictor_is_asked_as_resampling_asks_it() -> None:
    held = held_out()
    directions = held.records.direction
    _, mixture = densities(guide_at(FIELD, (0.0, 0.0, 0.0)), directions)
    np.testing.assert_allclose(predict(Predictions(), FIELD, held.records, held.leaf), mixture, rtol=1e-3)

    values = np.random.default_rng(2).random((1, TABLE_SIDE * TABLE_SIDE, 3)).astype(np.float32)
    cells = np.array([direction_to_cell(tuple(wi)) for wi in directions[:500]])
    found = predict(Predictions(table=TableField(values)), FIELD, held.records, held.leaf)
    expected = 0.5 * values[0, cells].mean(axis=1) + 0.5 * mixture[:500]
    np.testing.assert_allclose(found[:500], expected, rtol=1e-3)

    shape = NetworkShape(table_size=1 << 12)
    snapshot = Snapshot(1, 10, 0.5, 2.0, BOUNDS, random_parameters(shape))
    said = np.zeros((500, 3), np.float32)
    network_radiance(shape, snapshot, np.zeros((500, 3), np.float32), np.arange(500), directions[:500], said)
    model = RadianceModel(make_network_field(shape, snapshot))
    found = predict(Predictions(model=model), FIELD, held.records, held.leaf)
    np.testing.assert_allclose(found[:500], 0.5 * said.mean(axis=1) + 0.5 * mixture[:500], rtol=1e-3)


def test_what_the_mixture_saves_says_nothing_of_what_a_better_predictor_would() -> None:
    """Directions come nearly from the mixture times the cosine already, by which resampling saves too little to pay."""
    held = held_out(noise=0.5)
    directions = held.records.direction.astype(np.float64)
    variance = 0.5 * float(moments(held, np.ones(len(directions), np.float32), 0.5).source[0])

    def promise(predicted: np.ndarray) -> float:
        found = moments(held, predicted.astype(np.float32), 0.5)
        return promised_efficiency(found, float(COUNT), variance=variance, ray_count=4.0, costs=CandidateCosts(0.4))

    assert promise(predict(Predictions(), FIELD, held.records, held.leaf)) < RULES.network_kept
    assert promise(light(directions)) > RULES.network_kept


def made(
    count: int, known: float, source: np.ndarray, target: np.ndarray, throughput: tuple[float, ...] = (1.0,)
) -> Moments:
    """Moments of regions whose paths have these squared throughputs before the vertex, as often each."""
    regions = len(source)
    squares = np.tile(throughput, regions)
    return Moments(
        np.full(regions, count), np.full(regions, known), source, target, source / np.mean(throughput),
        np.repeat(np.arange(regions, dtype=np.int32), len(throughput)), squares,
    )


def test_chance_promises_nothing() -> None:
    """Regions of few records, in which the moments differ by chance alone, go by those of all."""
    rng = np.random.default_rng(8)
    source = rng.exponential(size=4000)
    target = rng.permutation(source)

    def promised(known: float) -> float:
        found = made(40, known, source, target)
        return promised_efficiency(found, 40_000.0, variance=2.0, ray_count=4.0, costs=CandidateCosts())

    assert promised(3.0) == pytest.approx(1.0, abs=0.05)
    assert promised(1e4) > 1.15


def test_only_guided_vertices_in_the_field_are_held_out() -> None:
    records = allocate_vertex_records(4)
    records.direction[:] = UP
    records.pdf[:] = records.bsdf_pdf[:] = 1.0
    records.guide_pdf[:] = (0.5, np.nan, 2.0, 3.0)
    records.position[3] = 1e3
    held = hold_out(records, 4, FIELD, np.full(1, 0.25, np.float32), 2.0)
    np.testing.assert_allclose(held.source_pdf, [0.25 * 0.5 + 0.75, 0.25 * 2.0 + 0.75])


def test_efficiency_is_what_pays() -> None:
    costs = CandidateCosts(per_candidate=0.3, per_vertex=0.25, per_source_sample=0.3)

    def efficiency(target: float, variance: float = 1.0, throughput: tuple[float, ...] = (1.0,)) -> float:
        found = made(100, 90.0, np.ones(1), np.array([target]), throughput)
        return promised_efficiency(found, 100.0, variance=variance, ray_count=4.0, costs=costs)

    # Nothing to save, or too little of what the image has.
    assert efficiency(1.0) == efficiency(2.0) == 1.0
    assert efficiency(0.0, variance=100.0) == 1.0
    assert efficiency(0.0, variance=0.0) == 1.0
    count = np.sqrt(4.0 / (2.0 * 0.3))
    expected = (2.0 - 1.0 / count) / (1.0 + (0.3 * count + 0.25 - 0.3) / 4.0)
    assert efficiency(0.0) == pytest.approx(expected)
    # As many at most as there may be.
    most = (1.0 + 1e4 * (1.0 - 1.0 / MAX_CANDIDATES)) / (1.0 + (0.3 * MAX_CANDIDATES + 0.25 - 0.3) / 4.0)
    assert efficiency(0.0, variance=1e-4) == pytest.approx(most)
    # What all vertices are too light for may be saved at the few that are not.
    assert efficiency(0.9) == 1.0 < efficiency(0.9, throughput=(0.0,) * 9 + (10.0,))


def test_throughput_is_told_from_what_paths_brought() -> None:
    held = held_out()
    rng = np.random.default_rng(9)
    squared = np.where(rng.random(len(held.leaf)) < 0.5, 1.0, 4.0)
    held.records.contribution_squared[:] *= squared
    found = moments(held, np.ones(len(held.leaf), np.float32), 0.5)
    np.testing.assert_allclose(found.throughput_squared, squared, rtol=1e-3)
    assert found.reflected[0] * squared.mean() == pytest.approx(found.source[0], rel=0.02)
