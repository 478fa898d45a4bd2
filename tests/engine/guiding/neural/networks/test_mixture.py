# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixture networks without torch: shapes, rows, features and their gradient, the perceptron, inference."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise

import numba
import numpy as np
import pytest

from engine.guiding.neural.networks.encoding import contract
from engine.guiding.neural.networks.grids import catch_up, step_table
from engine.guiding.neural.networks.mixture import shape as shapes
from engine.guiding.neural.networks.mixture.features import (
    backpropagate_grids,
    backpropagate_hashes,
    backpropagate_planes,
    encode_features,
    make_mixture_encoding,
)
from engine.guiding.neural.networks.mixture.inference import (
    RAW_LIMIT,
    allocate_mixture_scratch,
    evaluate_mixtures,
    make_mixture_network,
    no_mixture_network,
    selection_probability,
)
from engine.guiding.neural.networks.mixture.shape import MixtureShape, selection_blend
from engine.guiding.neural.networks.perceptron import CHUNK_ROWS, allocate_scratch, evaluate_perceptron, pack_perceptron
from engine.guiding.neural.networks.radiance import Snapshot
from engine.guiding.neural.sources import network_design
from engine.guiding.records.training_rows import (
    ROW_GUIDE_PDF,
    ROW_PDF,
    ROW_RADIANCE,
    ROW_U,
    ROW_WIDTH,
    is_fit,
    make_rows,
    pack_training_rows,
)
from engine.settings import RenderSettings
from tests.helpers.mixture_networks import BOUNDS, SHAPES, random_parameters, random_points, random_snapshot


@pytest.mark.parametrize(
    "preset, declared", [("PAPER", shapes.NPM_SETTINGS), ("OFFICIAL", shapes.NPM_OFFICIAL_SETTINGS)]
)
def test_presets_are_trained_as_declared(preset, declared):
    """What a preset's record says takes effect; only the BSDF's share is the render's."""
    found = network_design(RenderSettings(guiding_method="NPM", mixture_preset=preset)).training
    assert found == dataclasses.replace(declared, bsdf_share=found.bsdf_share)


@pytest.fixture(params=list(SHAPES))
def shape(request):
    return SHAPES[request.param]


def encoding_of(shape, parameters):
    return make_mixture_encoding(shape, BOUNDS, shape.split(parameters))


def features_of(shape, parameters, points):
    out = np.full((points[0].shape[0], shape.feature_width), np.nan, np.float32)
    encode_features(encoding_of(shape, parameters), *points, 0, out.shape[0], out)
    return out


# Shapes


def test_presets_are_the_papers():
    assert shapes.NPM.resolutions == (8, 11, 15, 22, 31, 43, 61, 86)
    assert shapes.NPM.used_width == shapes.NPM.feature_width == 32 + 4 + 4 and shapes.NPM.output_width == 32
    assert [matrix[1] for name, matrix in shapes.NPM.layout.items() if name != "table"] == [64, 64, 32]
    assert shapes.NPM_OFFICIAL.used_width == 32 + 12 + 4 + 4
    assert shapes.NASG_PRODUCT.used_width == 63 and shapes.NASG_PRODUCT.feature_width == 64
    assert shapes.NASG.used_width == 60 and shapes.NASG.feature_width == 64
    assert shapes.NASG.output_width == 8 * 8 + 1 and shapes.NASG.selection_column == 64
    assert shapes.SG.output_width == 14 * 4 + 1 and shapes.NPM.selection_column == -1
    assert shapes.NASG.parameter_count == 128 * (64 + 3 * 128 + 65)


@pytest.mark.parametrize(
    "wrong",
    [
        {"lobe_model": "KENT"}, {"lobe_count": 0}, {"level_features": 6}, {"width": 12}, {"hidden_layers": 0},
        {"wo_encoding": "RAW"}, {"normal_size": 2, "normal_encoding": "BLOB"}, {"roughness_bins": 2}, {"growth": 3.0},
        {"target": "LIGHT"}, {"wo_size": 3}, {"plane_features": 3}, {"hash_size": 1000}, {"hash_features": 6},
        {"position_encoding": "NONE"}, {"plane_growth": 3.0, "plane_levels": 10}, {"u_frequencies": 17},
    ],
)
def test_wrong_shapes_are_named(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        MixtureShape(**wrong)


def test_split_covers_the_parameters(shape):
    parameters = np.arange(shape.parameter_count, dtype=np.float32)
    arrays = shape.split(parameters)
    assert np.array_equal(np.concatenate([array.ravel() for array in arrays.values()]), parameters)
    matrices = shape.matrices(parameters)
    assert len(matrices) == shape.hidden_layers + 1
    assert matrices[0].shape[0] == shape.feature_width and matrices[-1].shape[1] == shape.output_width
    assert all(np.shares_memory(matrix, parameters) for matrix in matrices)


def test_blend_grows_in_steps():
    assert [selection_blend(samples) for samples in (-1.0, 0.0, 3.9, 4.0, 128.0, 256.0, 1e9)] == [
        0.0, 0.0, 0.0, 1 / 64, 0.5, 1.0, 1.0,
    ]


# Rows


def bad_rows():
    """Rows, and which of them are good."""
    rng = np.random.default_rng(3)
    rows = rng.uniform(0.1, 1.0, (4000, ROW_WIDTH)).astype(np.float32)
    good = np.ones(4000, bool)
    for k, value in enumerate((np.nan, np.inf, -np.inf)):
        at = np.arange(k, 4000, 17)
        rows[at, rng.integers(0, ROW_WIDTH, at.size)] = value
        good[at] = False
    for column, value in ((ROW_PDF, 0.0), (ROW_RADIANCE, -1.0), (ROW_GUIDE_PDF, -1.0)):
        at = rng.integers(0, 4000, 50)
        rows[at, column] = value
        good[at] = False
    huge = rng.integers(0, 4000, 50)
    rows[huge] = np.where(np.isfinite(rows[huge]), np.copysign(np.float32(3e38), rows[huge]), rows[huge])
    return rows, good & (rows[:, ROW_PDF] > 0.0)


def test_bad_rows_are_found():
    rows, good = bad_rows()
    assert 100 < good.sum() < 3900
    assert np.array_equal(is_fit(rows), good)
    out = np.full((4000, ROW_WIDTH), -7.0, np.float32)
    assert pack_training_rows(rows, 4000, 4000, np.uint32(1), out) == good.sum()
    assert np.array_equal(out[: good.sum()], rows[good])


def test_rows_are_thinned_evenly():
    rows = np.ones((10_000, ROW_WIDTH), np.float32)
    rows[:, ROW_U] = np.arange(10_000)
    out = np.zeros((100, ROW_WIDTH), np.float32)
    assert pack_training_rows(rows, 10_000, 100, np.uint32(5), out) == 100
    assert np.array_equal(out[:, ROW_U] // 100, np.arange(100))
    assert len(np.unique(out[:, ROW_U] % 100)) > 40


def test_rows_of_arrays():
    vectors = np.eye(3)
    rows = make_rows(vectors, vectors, vectors, vectors, pdf=(0.5, 0.5, 0.5), radiance=(1.0, np.nan, 1e300))
    assert rows.shape == (1, ROW_WIDTH) and rows[0, ROW_PDF] == 0.5
    assert make_rows(vectors, vectors, vectors, vectors, radiance=1.0).shape[0] == 0


# Features


def in_unit_cube(position):
    """Contracted positions, float64."""
    middle, half = BOUNDS.mean(axis=0, dtype=np.float64), 0.5 * (BOUNDS[1] - BOUNDS[0]).astype(np.float64)
    u = (position.astype(np.float64) - middle) / half
    return 0.5 + 0.5 * np.where(abs(u) > 1.0, np.sign(u) * (1.0 - 0.1 / np.maximum(abs(u), 1.0)), 0.9 * u)


def interpolated(shape, entries, resolution, coordinates):
    """Features between the points of one grid of any dimension, in plain numpy; entries(points (N, D)) -> (N, F)."""
    cell = np.minimum(np.floor(coordinates * resolution), resolution - 1).astype(int)
    t = coordinates * resolution - cell
    if shape.interpolation == "SMOOTH":
        t = t * t * (3.0 - 2.0 * t)
    return sum(
        np.prod(np.where(corner, t, 1.0 - t), axis=1)[:, None] * entries(cell + corner)
        for corner in np.array([*np.ndindex(*(2,) * coordinates.shape[1])])
    )


def dense(table, resolution):
    """Entries of a grid that has one for every point, the first coordinate fastest."""
    return lambda points: table[(points * (resolution + 1) ** np.arange(points.shape[1])).sum(axis=1)]


def hashed(table):
    def entries(points):
        products = points * np.array((1, 2654435761, 805459861, 3674653429), np.uint64).astype(np.int64)
        return table[np.bitwise_xor.reduce(products, axis=1) % len(table)]

    return entries


def reference_learned(shape, parameters, points):
    """Features read from tables, of grids, planes and four-dimensional grids."""
    arrays = {name: array.astype(np.float64) for name, array in shape.split(parameters).items()}
    place = np.column_stack((in_unit_cube(points[0]), points[4].astype(np.float64)))
    columns = []
    for level, resolution in enumerate(shape.resolutions):
        grid = arrays["table"][slice(*shape.level_offsets[level : level + 2])]
        columns.append(interpolated(shape, dense(grid, resolution), resolution, place[:, :3]))
    for level, resolution in enumerate(shape.plane_resolutions):
        planes = arrays["planes"][slice(*shape.plane_offsets[level : level + 2])]
        for axis, plane in enumerate(np.split(planes, 3)):
            columns.append(interpolated(shape, dense(plane, resolution), resolution, place[:, (axis, 3)]))
    for level, resolution in enumerate(shape.hash_resolutions):
        grid = arrays["hashes"][slice(*shape.hash_offsets[level : level + 2])]
        is_hashed = len(grid) < (resolution + 1) ** 4
        entries = hashed(grid) if is_hashed else dense(grid, resolution)
        columns.append(interpolated(shape, entries, resolution, place))
    return np.concatenate(columns, axis=1)


def learned_columns(shape):
    first = 0 if shape.position_encoding == "GRID" else shape.position_width
    return slice(first, shape.position_width + shape.plane_width + shape.hash_width)


LEARNED = [name for name, shape in SHAPES.items() if set(shapes.TABLES) & shape.layout.keys()]


@pytest.mark.parametrize("name", LEARNED)
def test_tables_are_interpolated(name):
    shape = SHAPES[name]
    parameters, points = random_parameters(shape), random_points(200)
    points[4][:2] = 0.0, 1.0
    expected = reference_learned(shape, parameters, points)
    found = features_of(shape, parameters, points)[:, learned_columns(shape)]
    np.testing.assert_allclose(found, expected, atol=4e-5)


def test_four_dimensions_are_hashed_where_they_are_many():
    shape = SHAPES["four dimensions"]
    assert shape.hash_resolutions == (4, 5, 7)
    assert shape.hash_offsets == (0, 625, 625 + 1296, 625 + 1296 + 2048)


def test_features_have_their_places(shape):
    points = random_points(300)
    features = features_of(shape, random_parameters(shape), points)
    assert np.isfinite(features).all()
    assert (features[:, shape.used_width :] == 1.0).all()
    _, normal, wo, _, u = points
    column = shape.position_width
    if shape.position_encoding == "BLOB":
        bins = features[:, :column].reshape(-1, 3, shape.position_bins)
        np.testing.assert_allclose(bins.sum(axis=2), 1.0, atol=1e-6)
        # Bins are centred half a bin inside the two that lie outside.
        centers = (np.arange(shape.position_bins) - 0.5) / (shape.position_bins - 2)
        inverse = (2.0 / (BOUNDS[1] - BOUNDS[0])).astype(np.float32)
        inside = np.array(
            [[contract(p, c, i) for p, c, i in zip(row, BOUNDS.mean(axis=0), inverse)] for row in points[0]]
        )
        np.testing.assert_allclose(bins @ centers, inside, atol=1e-5)
    column += shape.plane_width + shape.hash_width
    if shape.normal_encoding == "RAW":
        np.testing.assert_array_equal(features[:, column : column + 3], normal)
    if shape.wo_encoding == "RAW":
        np.testing.assert_array_equal(features[:, column + 3 : column + 6], wo)
    if shape.u_frequencies:
        angle = math.pi * u[:, None].astype(np.float64) * 2.0 ** np.arange(shape.u_frequencies)
        waves = np.stack([np.sin(angle), np.cos(angle)], axis=2).reshape(len(u), -1)
        found = features[:, shape.used_width - 2 * shape.u_frequencies : shape.used_width]
        np.testing.assert_allclose(found, waves, atol=1e-5)
    if shape.normal_encoding == "BLOB":
        np.testing.assert_allclose(features[:, column : column + 12].reshape(-1, 3, 4).sum(axis=2), 1.0, atol=1e-6)
        np.testing.assert_allclose(features[:, shape.used_width - 4 : shape.used_width].sum(axis=1), 1.0, atol=1e-6)


def test_harmonics_are_orthonormal():
    shape = SHAPES["smooth grids"]
    # Gauss-Legendre in z, equal steps in azimuth: exact for products of these polynomials.
    z, z_weight = np.polynomial.legendre.leggauss(8)
    phi = np.arange(16) * (math.pi / 8)
    r = np.sqrt(1.0 - z * z)
    wo = np.stack(np.broadcast_arrays(r[:, None] * np.cos(phi), r[:, None] * np.sin(phi), z[:, None]), -1)
    wo = wo.reshape(-1, 3).astype(np.float32)
    weight = np.repeat(z_weight, 16) * math.pi / 8
    position, normal, _, roughness, u = random_points(wo.shape[0])
    features = features_of(shape, random_parameters(shape), (position, normal, wo, roughness, u))
    first = shape.position_width + 12
    harmonics = features[:, first : first + 16].astype(np.float64)
    np.testing.assert_allclose(harmonics.T @ (harmonics * weight[:, None]), np.eye(16), atol=1e-5)


def test_features_of_nonsense_are_finite(shape):
    points = [array.copy() for array in random_points(64)]
    rng = np.random.default_rng(1)
    for array in points:
        flat = array.reshape(-1)
        at = rng.integers(0, flat.size, flat.size // 2)
        flat[at] = rng.choice(np.array((np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-40), np.float32), at.size)
    features = features_of(shape, random_parameters(shape), points)
    assert np.isfinite(features).all() and np.abs(features).max() < 10.0


@pytest.mark.parametrize("name", LEARNED)
def test_gradients_of_tables(name):
    """Features are linear in a table: the gradient along a random change is the change of the features."""
    shape = SHAPES[name]
    parameters, points = random_parameters(shape), random_points(500)
    rng = np.random.default_rng(2)
    gradient = rng.normal(size=(500, shape.feature_width)).astype(np.float32)
    encoding = encoding_of(shape, parameters)
    planes, hashes = shape.position_width, shape.position_width + shape.plane_width
    for table, backpropagate, first, width, level_count in (
        ("table", backpropagate_grids, 0, shape.position_width, shape.level_count),
        ("planes", backpropagate_planes, planes, shape.plane_width, shape.plane_levels),
        ("hashes", backpropagate_hashes, hashes, shape.hash_width, shape.hash_levels),
    ):
        if table not in shape.layout:
            continue
        parts = [np.zeros(shape.layout[table], np.float32) for _ in range(2)]
        for edges, part in (((0, level_count),), parts[0]), (((0, 1), (1, level_count)), parts[1]):
            for edge in edges:
                backpropagate(encoding, points[0], points[4], 500, gradient, first, *edge, part)
        assert np.array_equal(*parts)
        change = rng.normal(size=shape.layout[table]).astype(np.float32)
        changed = make_mixture_encoding(shape, BOUNDS, {table: change})
        out = np.zeros((500, shape.feature_width), np.float32)
        encode_features(changed, *points, 0, 500, out)
        columns = slice(first, first + width)
        expected = float((out[:, columns].astype(np.float64) * gradient[:, columns]).sum())
        assert float((change.astype(np.float64) * parts[0]).sum()) == pytest.approx(expected, rel=1e-4)


def test_steps_of_the_grids_and_their_average():
    """Adam where there is a gradient; the average as if every entry were brought up to date at every step."""
    rng = np.random.default_rng(4)
    table = rng.normal(size=(50, 4)).astype(np.float32)
    average, average_step = table.copy(), np.zeros(50, np.int32)
    gradient, moments, variances = (np.zeros_like(table) for _ in range(3))
    decay = (0.9 ** np.arange(8)).astype(np.float32)
    decay_beyond = np.append(0.9 ** np.arange(8.0), 0.0)
    expected, m, v = table.astype(np.float64), np.zeros((50, 4)), np.zeros((50, 4))
    mean, last = expected.copy(), np.zeros(50, int)
    for step in range(1, 31):
        has_gradient = rng.uniform(size=50) < 0.2
        g = rng.normal(size=(50, 4)).astype(np.float32) * has_gradient[:, None]
        gradient[...] = g
        step_table(
            table, gradient, moments, variances, average, average_step, decay, step, np.float32(0.01), np.float32(0.9),
            np.float32(0.99), np.float32(1e-15),
        )
        assert not gradient.any()
        for entry in np.flatnonzero(has_gradient):
            missed = decay_beyond[min(step - 1 - last[entry], 8)]
            mean[entry] = expected[entry] + missed * (mean[entry] - expected[entry])
            last[entry] = step
            m[entry] = 0.9 * m[entry] + 0.1 * g[entry]
            v[entry] = 0.99 * v[entry] + 0.01 * g[entry] ** 2.0
            expected[entry] -= 0.01 * m[entry] / np.sqrt(v[entry])
            mean[entry] = expected[entry] + 0.9 * (mean[entry] - expected[entry])
    for entry in range(50):
        mean[entry] = expected[entry] + decay_beyond[min(30 - last[entry], 8)] * (mean[entry] - expected[entry])
    catch_up(table, average, average_step, decay, 30)
    np.testing.assert_allclose(table, expected, atol=1e-5)
    np.testing.assert_allclose(average, mean, atol=1e-5)


# Perceptron


def random_matrices(sizes, seed=0):
    rng = np.random.default_rng(seed)
    return [
        (rng.normal(size=(a, b)) * math.sqrt(2.0 / a)).astype(np.float32) for a, b in pairwise(sizes)
    ]


@pytest.mark.parametrize(
    "sizes", [(32, 64, 64, 32), (64, 128, 128, 128, 128, 65), (64, 64, 64, 3), (32, 32, 3), (8, 24, 1), (5, 7)]
)
def test_perceptron_against_numpy(sizes):
    matrices = random_matrices(sizes)
    perceptron, scratch = pack_perceptron(matrices), allocate_scratch(max(sizes))
    inputs = np.random.default_rng(1).normal(size=(2 * CHUNK_ROWS + 5, sizes[0])).astype(np.float32)
    expected = inputs.astype(np.float64)
    for matrix in matrices[:-1]:
        expected = np.maximum(expected @ matrix, 0.0)
    expected = expected @ matrices[-1]
    for row_count in (1, 5, 6, CHUNK_ROWS, inputs.shape[0]):
        scratch[...] = np.nan
        out = np.full((inputs.shape[0], sizes[-1]), -7.0, np.float32)
        evaluate_perceptron(perceptron, inputs, row_count, scratch, out)
        np.testing.assert_allclose(out[:row_count], expected[:row_count], atol=2e-5)
        assert (out[row_count:] == -7.0).all()


def test_a_row_does_not_see_its_neighbours():
    sizes = (16, 40, 40, 9)
    perceptron, scratch = pack_perceptron(random_matrices(sizes)), allocate_scratch(40)
    inputs = np.random.default_rng(1).normal(size=(200, 16)).astype(np.float32)
    together, alone = np.zeros((200, 9), np.float32), np.zeros((1, 9), np.float32)
    evaluate_perceptron(perceptron, inputs, 200, scratch, together)
    for row in (0, 1, 7, 47, 48, 199):
        evaluate_perceptron(perceptron, inputs[row : row + 1], 1, scratch, alone)
        assert np.array_equal(alone[0], together[row])


# Inference


def evaluate(shape, network, points, row_count=None):
    count = points[0].shape[0]
    raw = np.full((count, shape.output_width), -7.0, np.float32)
    scratch = allocate_mixture_scratch(shape)
    evaluate_mixtures(network, *points, count if row_count is None else row_count, scratch, raw)
    return raw


def test_network_against_numpy(shape):
    snapshot, points = random_snapshot(shape), random_points(150)
    expected = features_of(shape, snapshot.parameters, points).astype(np.float64)
    *hidden, last = shape.matrices(snapshot.parameters)
    for matrix in hidden:
        expected = np.maximum(expected @ matrix, 0.0)
    expected = expected @ last
    network = make_mixture_network(shape, snapshot)
    found = evaluate(shape, network, points)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)
    assert np.std(found) > 0.01
    few = evaluate(shape, network, points, 7)
    assert np.array_equal(few[:7], found[:7]) and (few[7:] == -7.0).all()


def test_no_network_is_one_for_the_compiler(shape):
    empty, network = no_mixture_network(shape), make_mixture_network(shape, random_snapshot(shape))
    assert numba.typeof(empty) == numba.typeof(network)
    assert not evaluate(shape, empty, random_points(60)).any()
    assert selection_probability(empty, np.full((1, shape.output_width), 9.0, np.float32), 0) == 0.0


@pytest.mark.parametrize("size", [1e4, 1e15, 1e30, 3e38])
def test_adversarial_parameters_give_finite_outputs(shape, size):
    rng = np.random.default_rng(6)
    parameters = (size * rng.choice((-1.0, 1.0), shape.parameter_count)).astype(np.float32)
    network = make_mixture_network(shape, Snapshot(1, 1, 0.0, 1.0, BOUNDS, parameters))
    points = [array.copy() for array in random_points(100)]
    points[0][:20] = np.nan
    points[1][20:40] = np.inf
    raw = evaluate(shape, network, points)
    assert np.isfinite(raw).all() and np.abs(raw).max() <= RAW_LIMIT
    for row in range(100):
        assert 0.0 <= selection_probability(network, raw, row) <= 1.0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_parameters_that_are_not_finite_are_refused(shape, value):
    snapshot = random_snapshot(shape)
    snapshot.parameters[shape.parameter_count // 2] = value
    with pytest.raises(ValueError, match="not finite"):
        make_mixture_network(shape, snapshot)


def test_selection_is_the_last_output():
    shape = SHAPES["one-blob"]
    snapshot = random_snapshot(shape)
    raw = np.zeros((3, shape.output_width), np.float32)
    raw[:, -1] = -2.0, 0.0, 3e38
    for blend in (0.0, 0.25, 1.0):
        network = make_mixture_network(shape, snapshot, blend)
        found = [selection_probability(network, raw, row) for row in range(3)]
        np.testing.assert_allclose(found, blend / (1.0 + np.exp([2.0, 0.0, -30.0])), rtol=1e-6)
    other = SHAPES["linear grids"]
    plain = make_mixture_network(other, random_snapshot(other))
    assert selection_probability(plain, np.ones((1, other.output_width), np.float32), 0) == 0.0
