# SPDX-License-Identifier: GPL-3.0-or-later
"""The flow over directions: sampling against density, kernels against torch, learning, and what must not break it."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from engine.guiding.neural.networks.flow import field as fields
from engine.guiding.neural.networks.flow import query
from engine.guiding.neural.networks.flow.shape import (
    MIN_WIDTH,
    UNIFORM_SHARE,
    FlowSettings,
    FlowShape,
    initial_flow_parameters,
)
from engine.guiding.neural.networks.radiance import Snapshot
from engine.guiding.records.training_rows import (
    ROW_NORMAL,
    ROW_PDF,
    ROW_POSITION,
    ROW_RADIANCE,
    ROW_REFLECTANCE,
    ROW_ROUGHNESS,
    ROW_WI,
    ROW_WIDTH,
    ROW_WO,
    is_fit,
)
from engine.runtime.jit import kernel
from tests.helpers import chi2
from tests.helpers.guiding_harness import mixture_density, sphere_grid, uniform_directions, unit
from tests.helpers.some_cases import every
from tests.helpers.training import require_torch

#: The paper's, and one that is learned in seconds.
SHAPE = FlowShape()
SMALL = FlowShape(position_bins=8, direction_bins=8, width=32, hidden_layers=2)
DEEP = FlowShape(layer_count=4, bin_count=8, blob_bins=16, position_bins=4, width=24, hidden_layers=1)
BOUNDS = np.array(((-1.0, -2.0, 0.0), (1.0, 2.0, 3.0)), np.float32)
UP = (0.0, 0.0, 1.0)
FOUR_PI = 4.0 * np.pi

#: Family-wise significance of the chi-square tests.
SIGNIFICANCE = 0.01
CHI2_TESTS = 9


@kernel
def _densities(guide, lane, directions, out):
    for k in range(directions.shape[0]):
        out[k] = query.eval_flow(guide, lane, (directions[k, 0], directions[k, 1], directions[k, 2]))


@kernel
def _samples(guide, lane, u, out):
    for k in range(u.shape[0]):
        out[k, 0], out[k, 1], out[k, 2] = query.sample_flow(guide, lane, u[k, 0], u[k, 1], u[k, 2])


@kernel
def _there_and_back(guide, lane, u, out):
    for k in range(u.shape[0]):
        a, b = query.flow_from_uniform(guide, lane, u[k, 0], u[k, 1])
        out[k, 0], out[k, 1], out[k, 2] = query.flow_to_uniform(guide, lane, a, b)


@kernel
def _by_row(guide, rows, out):
    for k in range(rows.shape[0]):
        p = (rows[k, 0], rows[k, 1], rows[k, 2])
        wi = (rows[k, 3], rows[k, 4], rows[k, 5])
        wo = (rows[k, 6], rows[k, 7], rows[k, 8])
        n = (rows[k, 9], rows[k, 10], rows[k, 11])
        query.prepare_flow(guide, k % guide.latent.shape[0], p, n, wo, rows[k, 12], 1.0)
        out[k] = query.eval_flow(guide, k % guide.latent.shape[0], wi)


def prepare(guide, lane=0, p=(0.2, 0.3, 1.0), n=UP, wo=(0.6, 0.0, 0.8), roughness=0.5, fluence=1.0):
    """`prepare_flow` from Python."""
    vectors = [tuple(np.float32(value) for value in vector) for vector in (p, n, wo)]
    query.prepare_flow(guide, lane, *vectors, np.float32(roughness), np.float32(fluence))


def guide_of(shape, parameters, lane_count=1, **vertex):
    """A guide with all lanes at one vertex."""
    guide = fields.allocate_flow_guide(fields.view_flow_field(shape, BOUNDS, parameters, True), lane_count)
    for lane in range(lane_count):
        prepare(guide, lane, **vertex)
    return guide


def densities(guide, directions, lane=0):
    """`eval_flow` at directions: float64 (N,)."""
    out = np.zeros(len(directions), np.float32)
    _densities(guide, lane, np.asarray(directions, np.float32), out)
    return out.astype(np.float64)


def samples(guide, rng, count, lane=0):
    """Directions from `sample_flow`: float64 (count, 3)."""
    out = np.zeros((count, 3), np.float32)
    _samples(guide, lane, rng.random((count, 3)).astype(np.float32), out)
    return out.astype(np.float64)


def random_parameters(shape, seed=0, strength=1.0):
    """Parameters of a flow that is far from uniform: outputs `strength` wide."""
    parameters = initial_flow_parameters(shape, seed)
    rng = np.random.default_rng(seed)
    arrays = shape.split(parameters)
    # As if trained: what the bins say differs from bin to bin.
    for name in ("condition_weights", "passed_weights"):
        arrays[name] *= 4.0
    arrays["output_weights"] *= 10.0 * strength
    arrays["output_bias"][...] = 0.5 * strength * rng.normal(size=arrays["output_bias"].shape)
    return parameters


# ---------------------------------------------------------------------------------------------------------------------
# A known product of light and surface

LIGHT = [(0.6, 20.0, (0.8, 0.3, 0.5)), (0.3, 60.0, (-0.5, 0.7, 0.5)), (0.1, 0.0, UP)]
NORMALS = np.array([unit(n) for n in ((0.0, 0.0, 1.0), (0.9, -0.2, 0.4), (-0.7, 0.7, 0.1))])


def make_rows(rng, count):
    """Records of `LIGHT` on diffuse surfaces of three normals, in uniform directions."""
    rows = np.zeros((count, ROW_WIDTH), np.float32)
    directions = uniform_directions(rng, count)
    normals = NORMALS[rng.integers(0, len(NORMALS), count)]
    rows[:, ROW_POSITION : ROW_POSITION + 3] = rng.uniform(BOUNDS[0], BOUNDS[1], (count, 3))
    rows[:, ROW_WI : ROW_WI + 3] = directions
    rows[:, ROW_WO : ROW_WO + 3] = uniform_directions(rng, count)
    rows[:, ROW_NORMAL : ROW_NORMAL + 3] = normals
    rows[:, ROW_ROUGHNESS] = rng.random(count)
    rows[:, ROW_RADIANCE] = mixture_density(directions, LIGHT)
    rows[:, ROW_REFLECTANCE] = np.maximum((directions * normals).sum(axis=1), 0.0) / np.pi
    rows[:, ROW_PDF] = 1.0 / FOUR_PI
    return rows


def divergence(truth, density, directions):
    """Kullback-Leibler divergence [nats] of a density from `truth`, both (N,) over a grid of the sphere."""
    truth = truth / (truth.mean() * FOUR_PI)
    lit = truth > 0.0
    return float((truth[lit] * np.log(truth[lit] / density[lit])).sum() * FOUR_PI / len(directions))


def divergences(shape, parameters, with_cosine=True):
    """Divergence of the flow, and of the uniform density, from the truth: the mean over normals."""
    grid = sphere_grid(60, 120)
    learned, uniform = [], []
    for n in NORMALS:
        truth = mixture_density(grid, LIGHT) * (np.maximum(grid @ n, 0.0) if with_cosine else 1.0)
        learned.append(divergence(truth, densities(guide_of(shape, parameters, n=n), grid), grid))
        uniform.append(divergence(truth, np.full(len(grid), 1.0 / FOUR_PI), grid))
    return np.mean(learned), np.mean(uniform)


def train(rows, steps, shape=SMALL, seed=1, **settings):
    """A training that has taken `steps` steps on `rows`."""
    require_torch()
    from engine.guiding.neural.worker.flow_training import FlowTraining

    training = FlowTraining(
        shape, FlowSettings(**{"batch_size": 1024, "learning_rate": 3e-3, **settings}), seed, bounds=BOUNDS
    )
    training.add(rows)
    for _ in range(steps):
        training.step()
    return training


@pytest.fixture(scope="module")
def trained():
    """After 300 steps of 1024 records."""
    return train(make_rows(np.random.default_rng(1), 200_000), 300)


# ---------------------------------------------------------------------------------------------------------------------
# Sampling and density


def check_sampling(guide, seed, subdivisions=6):
    count = 50_000
    drawn = samples(guide, np.random.default_rng(seed), count)
    assert np.abs(np.linalg.norm(drawn, axis=1) - 1.0).max() < 1e-6
    probability = chi2.cell_integrals(lambda d: densities(guide, d), 16, 32, points=4, subdivisions=subdivisions)
    assert probability.sum() == pytest.approx(1.0, abs=1e-3)
    assert probability.max() > 2.5 * probability.mean()
    assert chi2.p_value(chi2.histogram(drawn, 16, 32), probability, count) > chi2.sidak(SIGNIFICANCE, CHI2_TESTS)


@pytest.mark.parametrize("shape", [SHAPE, SMALL, DEEP])
def test_samples_follow_the_density(shape):
    check_sampling(guide_of(shape, random_parameters(shape, 3, 0.4)), 4)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [SHAPE, SMALL, DEEP])
def test_samples_follow_a_jagged_density(shape):
    check_sampling(guide_of(shape, random_parameters(shape, 3)), 4, 20)


def test_samples_of_a_trained_flow_follow_its_density(trained):
    check_sampling(guide_of(SMALL, trained.snapshot().parameters, n=NORMALS[1]), 5)


@pytest.mark.parametrize("case", ["outputs", "everything", "overflow", "infinite", "nan", "one nan"])
def test_extreme_parameters_still_give_a_density(case):
    """Too narrow for a grid: drawn half by the flow, half evenly, the balance heuristic's weights are at most 2.

    Each octant's share of the flow must come out the same by counting samples and by weighing all of them, and the
    shares must sum to one: five standard errors, nine figures.
    """
    parameters = random_parameters(SMALL, 5)
    arrays = SMALL.split(parameters)
    if case == "outputs":
        arrays["output_weights"] *= 1e3
    elif case == "everything":
        parameters *= 30.0
    elif case == "overflow":
        parameters *= np.float32(1e30)
    elif case == "infinite":
        parameters[::3] = np.inf
        parameters[1::3] = -np.inf
    elif case == "nan":
        parameters[...] = np.nan
    else:
        parameters[::97] = np.nan
    guide = guide_of(SMALL, parameters)
    rng = np.random.default_rng(6)
    count = 40_000
    drawn, even = samples(guide, rng, count), uniform_directions(rng, count)
    assert np.isfinite(drawn).all()
    assert np.abs(np.linalg.norm(drawn, axis=1) - 1.0).max() < 1e-6
    both = np.concatenate((drawn, even)).astype(np.float32)
    pdf = densities(guide, both)
    assert (pdf >= UNIFORM_SHARE**2 / FOUR_PI * 0.999).all()
    assert (pdf <= (2.0 / MIN_WIDTH) ** 2 / FOUR_PI).all()
    weight = pdf / (0.5 * pdf + 0.5 / FOUR_PI)
    octant = (both > 0.0) @ np.array((1, 2, 4))
    for part in [np.ones(2 * count, bool)] + [octant == k for k in range(8)]:
        counted = part[:count].astype(np.float64)
        first, second = (weight * part)[:count], (weight * part)[count:]
        # The same samples are counted and weighed: their difference is what has an error.
        difference = 0.5 * first - counted
        error = math.sqrt(difference.var() / count + 0.25 * second.var() / count)
        assert abs(difference.mean() + 0.5 * second.mean()) < 5.0 * error + 1e-5


def test_layers_are_inverted():
    u = np.random.default_rng(7).random((20_000, 2)).astype(np.float32)
    u[:4] = ((0.0, 0.0), (0.0, 0.999), (1.0 - 2.0**-24, 0.0), (1.0 - 2.0**-24, 1.0 - 2.0**-24))
    for shape in (SHAPE, SMALL, DEEP):
        guide = guide_of(shape, random_parameters(shape, 8))
        out = np.zeros((len(u), 3), np.float32)
        _there_and_back(guide, 0, u, out)
        # A step of float32 where the density is ten moves ten steps on; each layer adds its own.
        assert np.abs(out[:, :2] - u).max() < 1e-4
        assert np.abs(out[:, :2] - u).mean() < 1e-6


def test_directions_and_the_square_are_inverse():
    rng = np.random.default_rng(9)
    directions = np.concatenate((uniform_directions(rng, 2000), np.eye(3), -np.eye(3))).astype(np.float32)
    # Next to the poles, where 1 - |z| is less than z can tell.
    for height in (1.0, -1.0):
        for sine in (1e-2, 1e-3):
            phi = rng.uniform(0.0, 2.0 * np.pi, 50)
            near = np.stack((sine * np.cos(phi), sine * np.sin(phi), np.full(50, height * math.sqrt(1 - sine**2))), 1)
            directions = np.concatenate((directions, near.astype(np.float32)))
    for direction in directions:
        a, b = query.direction_to_square(tuple(direction))
        assert 0.0 <= a < 1.0 and 0.0 <= b < 1.0
        again = query.square_to_direction(np.float32(a), np.float32(b))
        # A step of b is 4e-7 of the circle; one of a near z = -1 is that over the sine, a step's root at the pole.
        sine = math.hypot(direction[0], direction[1])
        step = 4e-7 * min(1.0 / max(sine, 1e-9), 1250.0) if direction[2] < 0.0 else 0.0
        assert np.abs(np.subtract(again, direction)).max() < 8e-7 + step


def test_density_at_the_poles_and_across_the_seam():
    guide = guide_of(SHAPE, random_parameters(SHAPE, 10))
    tiny = np.float32(1e-40)
    poles = [(0, 0, 1), (0, 0, -1), (-0.0, -0.0, 1), (tiny, -tiny, 1), (1, 0, 0), (1, -tiny, 0), (-1, 0, 0)]
    pdf = densities(guide, np.array(poles, np.float32))
    assert np.isfinite(pdf).all() and (pdf > 0.0).all()
    # Samples right at the edges of the square are directions with a density.
    ends = np.array([0.0, 2.0**-24, 0.5, 1.0 - 2.0**-24], np.float32)
    u = np.stack(np.meshgrid(ends, ends, [0.5]), -1).reshape(-1, 3).astype(np.float32)
    drawn = np.zeros_like(u)
    _samples(guide, 0, u, drawn)
    assert np.abs(np.linalg.norm(drawn, axis=1) - 1.0).max() < 1e-6
    assert (densities(guide, drawn) > 0.0).all()
    # Caps and slices next to poles and seam get their share of samples: their mass is integrated in the square.
    rng = np.random.default_rng(11)
    count = 200_000
    drawn = samples(guide, rng, count)
    for low_a, high_a, low_b, high_b in (
        (0.0, 0.005, 0.0, 1.0), (0.995, 1.0, 0.0, 1.0), (0.0, 1.0, 0.0, 0.01), (0.0, 1.0, 0.99, 1.0)
    ):
        a = low_a + (high_a - low_a) * (np.arange(256) + 0.5) / 256
        b = low_b + (high_b - low_b) * (np.arange(256) + 0.5) / 256
        a, b = (grid.ravel() for grid in np.meshgrid(a, b))
        sine = 2.0 * np.sqrt(a * (1.0 - a))
        grid = np.stack((sine * np.cos(2 * np.pi * b), sine * np.sin(2 * np.pi * b), 1.0 - 2.0 * a), 1)
        mass = densities(guide, grid).mean() * FOUR_PI * (high_a - low_a) * (high_b - low_b)
        height = 0.5 * (1.0 - drawn[:, 2])
        azimuth = np.arctan2(drawn[:, 1], drawn[:, 0]) / (2 * np.pi) % 1.0
        inside = (height >= low_a) & (height < high_a) & (azimuth >= low_b) & (azimuth < high_b)
        assert abs(inside.mean() - mass) < 5.0 * math.sqrt(mass / count)


def test_no_field_is_uniform():
    guide = fields.allocate_flow_guide(fields.no_flow_field(SHAPE), 2)
    assert guide.network.is_ready[0] == 0
    prepare(guide, 1)
    rng = np.random.default_rng(12)
    np.testing.assert_allclose(densities(guide, uniform_directions(rng, 500), 1), 1.0 / FOUR_PI, rtol=1e-5)
    u = rng.random((500, 3)).astype(np.float32)
    drawn = np.zeros_like(u)
    _samples(guide, 1, u, drawn)
    np.testing.assert_allclose(drawn[:, 2], 1.0 - 2.0 * u[:, 0], atol=1e-6)
    np.testing.assert_allclose(np.arctan2(drawn[:, 1], drawn[:, 0]) % (2 * np.pi), 2 * np.pi * u[:, 1], atol=1e-3)


def test_whatever_comes_in_nothing_but_numbers_come_out():
    rng = np.random.default_rng(13)
    bad = np.array([np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-40, 0.0, 0.3], np.float32)
    guide = guide_of(SMALL, random_parameters(SMALL, 14))
    out = np.zeros(1, np.float32)
    drawn = np.zeros((1, 3), np.float32)
    grid = sphere_grid(50, 100)
    for trial in range(200):
        p, n, wo, wi, u = (tuple(bad[rng.integers(0, len(bad), 3)]) for _ in range(5))
        roughness, fluence, guide_pdf = bad[rng.integers(0, len(bad), 3)]
        query.prepare_flow(guide, 0, p, n, wo, roughness, fluence)
        assert np.isfinite(guide.latent).all() and np.isfinite(guide.fluence).all()
        _densities(guide, 0, np.array([wi]), out)
        assert np.isfinite(out).all() and out[0] >= 0.0
        if not np.isfinite(wi).all():
            assert out[0] == 0.0
        _samples(guide, 0, np.array([u]), drawn)
        assert np.linalg.norm(drawn) == pytest.approx(1.0, abs=1e-5)
        predicted = query.predict_flow(guide, 0, wi, guide_pdf)
        assert math.isfinite(predicted) and predicted >= 0.0
        if trial < 10:
            assert densities(guide, grid).mean() * FOUR_PI == pytest.approx(1.0, abs=0.03)


def test_prediction_is_fluence_times_density_and_partly_even():
    guide = guide_of(SMALL, random_parameters(SMALL, 15), fluence=7.0)
    for direction in uniform_directions(np.random.default_rng(16), 20).astype(np.float32):
        pdf = densities(guide, direction[None])[0]
        predicted = query.predict_flow(guide, 0, tuple(direction), np.float32(pdf))
        assert predicted == pytest.approx(7.0 * (0.7 * pdf + 0.3 / FOUR_PI), rel=1e-5)


def test_lanes_and_threads_do_not_meet():
    guide = fields.allocate_flow_guide(fields.view_flow_field(SMALL, BOUNDS, random_parameters(SMALL, 17), True), 4)
    normals = uniform_directions(np.random.default_rng(18), 4)
    for lane in range(4):
        prepare(guide, lane, n=normals[lane])
    directions = uniform_directions(np.random.default_rng(19), 5000)
    alone = [densities(guide, directions, lane) for lane in range(4)]
    assert not np.allclose(alone[0], alone[1], rtol=0.1)
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda lane: densities(guide, directions, lane), range(4)))
    np.testing.assert_array_equal(alone, together)


# ---------------------------------------------------------------------------------------------------------------------
# Shape and snapshots


def test_layout_fills_the_parameter_vector():
    parameters = np.arange(SHAPE.parameter_count, dtype=np.float32)
    arrays = SHAPE.split(parameters)
    assert list(arrays) == list(SHAPE.layout)
    np.testing.assert_array_equal(np.concatenate([array.ravel() for array in arrays.values()]), parameters)
    assert arrays["output_weights"].shape == (2, 64, 65)
    assert SHAPE.condition_width == 3 * 32 + 6 * 16 + 8
    np.testing.assert_array_equal(initial_flow_parameters(SHAPE, 3), initial_flow_parameters(SHAPE, 3))


@pytest.mark.parametrize("size", [{"layer_count": 1}, {"bin_count": 1}, {"width": 12}, {"hidden_layers": 0}])
def test_sizes_out_of_range_are_refused(size):
    with pytest.raises(ValueError, match=next(iter(size))):
        FlowShape(**size)


@pytest.mark.parametrize("setting", [{"target": "LIGHT"}, {"divergence": "JS"}])
def test_unknown_settings_are_refused(setting):
    with pytest.raises(ValueError, match=next(iter(setting))):
        FlowSettings(**setting)


def test_broken_snapshots_are_refused():
    parameters = initial_flow_parameters(SMALL, 1)
    good = Snapshot(1, 10, 0.5, 1.0, BOUNDS, parameters)
    field = fields.make_flow_field(SMALL, good)
    assert field.is_ready[0] == 1
    # Training goes on in the same memory.
    parameters[...] = 0.0
    assert np.abs(field.condition_weights).max() > 0.0
    for value in (np.nan, np.inf):
        broken = parameters.copy()
        broken[123] = value
        with pytest.raises(ValueError):
            fields.make_flow_field(SMALL, Snapshot(1, 10, 0.5, 1.0, BOUNDS, broken))
    with pytest.raises(ValueError):
        fields.make_flow_field(SHAPE, good)


# ---------------------------------------------------------------------------------------------------------------------
# Training


@pytest.mark.parametrize("shape", [SHAPE, DEEP])
def test_kernels_and_torch_agree(shape):
    require_torch()
    training = train(make_rows(np.random.default_rng(20), 2000), 0, shape)
    # They are those that the training goes by.
    training.snapshot().parameters[:] = random_parameters(shape, 21)
    compare_densities(shape, training)


def test_kernels_and_torch_agree_after_training(trained):
    compare_densities(SMALL, trained)


def compare_densities(shape, training):
    rows = make_rows(np.random.default_rng(22), 2000)
    rows[:50, ROW_POSITION : ROW_POSITION + 3] *= 1e4
    rows[50:60, ROW_POSITION] = np.nan
    rows[60, ROW_WI : ROW_WI + 3] = UP
    rows[61, ROW_WI : ROW_WI + 3] = (0, 0, -1)
    rows[62, ROW_WI : ROW_WI + 3] = (1, 0, 0)
    guide = fields.allocate_flow_guide(fields.make_flow_field(shape, training.snapshot()), 3)
    out = np.zeros(len(rows), np.float32)
    _by_row(guide, rows, out)
    expected = training.density(rows)
    assert expected.max() > 10.0 * expected.min()
    np.testing.assert_allclose(out, expected, rtol=2e-3)
    assert np.abs(np.log(out / expected)).mean() < 5e-5


def test_a_product_is_learned(trained):
    """In 300 steps of 1024 records: a divergence of 0.14 nats, where the uniform density has 2.7."""
    learned, uniform = divergences(SMALL, trained.snapshot().parameters)
    assert uniform > 2.5
    assert learned < 0.14


def drawn_unevenly(rng, count):
    """Records drawn ten times as often in one hemisphere, and a pdf that says so."""
    rows = make_rows(rng, count)
    rows = rows[(rows[:, ROW_WI] > 0.0) | (rng.random(count) < 0.1)]
    rows[:, ROW_PDF] = np.where(rows[:, ROW_WI] > 0.0, 10.0, 1.0) / (5.5 * FOUR_PI)
    return rows


def test_radiance_alone_is_learned():
    """In 120 steps: 0.25 nats, where the uniform density has 1.9, whatever density drew the records.

    Reflectance must not matter, even where it is 0.
    """
    training = train(drawn_unevenly(np.random.default_rng(23), 100_000), 120, target="RADIANCE")
    learned, uniform = divergences(SMALL, training.snapshot().parameters, with_cosine=False)
    assert uniform > 1.5
    assert learned < 0.25


def test_chi_square_is_learned():
    """The target's mean over the density, 1 at best, falls to 1.3 in 150 steps, where the uniform density has 15."""
    training = train(make_rows(np.random.default_rng(24), 100_000), 150, divergence="CHI2")
    guide = guide_of(SMALL, training.snapshot().parameters, n=NORMALS[0])
    grid = sphere_grid(60, 120)
    truth = mixture_density(grid, LIGHT) * np.maximum(grid @ NORMALS[0], 0.0)
    truth /= truth.mean() * FOUR_PI
    learned = (truth**2 / densities(guide, grid)).mean() * FOUR_PI
    assert (truth**2).mean() * FOUR_PI**2 > 15.0
    assert 1.0 < learned < 1.3


def test_records_that_are_broken_or_huge_do_no_harm():
    clean = make_rows(np.random.default_rng(26), 100_000)
    reference, _ = divergences(SMALL, train(clean, 100).snapshot().parameters)
    rng = np.random.default_rng(27)
    broken = clean.copy()
    picks = rng.choice(len(clean), 2000, replace=False)
    columns = rng.integers(0, ROW_WIDTH, 2000)
    broken[picks, columns] = rng.choice(np.array([np.nan, np.inf, -np.inf, -1.0, 3e38, 1e-42], np.float32), 2000)
    broken[7, ROW_RADIANCE] = 1e9
    broken[8, ROW_POSITION] = 1e30
    with np.errstate(all="raise"):
        training = train(broken, 100)
    snapshot = training.snapshot()
    snapshot.validate(SMALL)
    # Those not fit to learn from are nothing that has been seen of the scene.
    assert training.rows_received == is_fit(broken).sum() < 100_000
    learned, _ = divergences(SMALL, snapshot.parameters)
    assert learned < 1.15 * reference + 0.03


def test_bounds_are_found_among_broken_positions():
    require_torch()
    from engine.guiding.neural.worker.flow_training import FlowTraining

    rows = make_rows(np.random.default_rng(28), 3000)
    rows[::3, ROW_POSITION : ROW_POSITION + 3] = 3e38
    rows[1::3, ROW_POSITION] = -3e38
    training = FlowTraining(SMALL, FlowSettings(batch_size=256), 1)
    training.add(rows)
    training.step()
    training.snapshot().validate(SMALL)
    assert np.isfinite(training.density(rows)).all()


def test_a_batch_without_a_finite_gradient_changes_nothing():
    training = train(make_rows(np.random.default_rng(29), 5000), 1)
    # Every gradient depends on it.
    SMALL.split(training.snapshot().parameters)["output_bias"][-1, 0] = math.nan
    before = training.snapshot().parameters.copy()
    training.step()
    np.testing.assert_array_equal(training.snapshot().parameters, before)
    assert training.step_count == 2


def test_training_waits_for_light():
    require_torch()
    from engine.guiding.neural.worker.flow_training import FlowTraining

    training = FlowTraining(SMALL, FlowSettings(batch_size=256), 1)
    rows = make_rows(np.random.default_rng(30), 1000)
    dark = rows.copy()
    dark[:, ROW_RADIANCE] = 0.0
    training.add(dark)
    training.add(rows[:0])
    assert not training.can_train and math.isinf(training.improvement())
    with pytest.raises(ValueError):
        training.snapshot()
    training.add(rows)
    assert training.can_train and training.row_count > 400
    assert math.isinf(training.improvement())
    training.step()
    assert math.isfinite(training.improvement()) and math.isfinite(training.loss)


def test_training_is_deterministic():
    results = []
    for _ in range(2):
        training = train(make_rows(np.random.default_rng(31), 3000), 3, seed=9)
        training.add(make_rows(np.random.default_rng(32), 3000))
        training.step()
        results.append(training.snapshot().parameters.copy())
    assert np.array_equal(*results)
    other = train(make_rows(np.random.default_rng(31), 3000), 4, seed=8).snapshot().parameters
    assert not np.array_equal(results[0], other)


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize("divergence_name", every(["CHI2", "KL"], 2))
def test_the_papers_sizes_learn_the_product(divergence_name):
    """1200 steps of 2048 records at the default rate: below 0.08 nats by most seeds, of which six gave 0.03 to 0.09."""
    found = []  # one batch can spoil a snapshot
    for seed in (33, 34, 35):
        rows = make_rows(np.random.default_rng(seed), 800_000)
        training = train(rows, 1200, SHAPE, batch_size=2048, learning_rate=1e-3, divergence=divergence_name)
        parameters = training.snapshot().parameters
        found.append(divergences(SHAPE, parameters)[0] < 0.08)
        if sum(found) == 2 or found == [False, False]:
            break  # whatever a third seed brings
    assert sum(found) == 2
    check_sampling(guide_of(SHAPE, parameters, n=NORMALS[2]), 34)
