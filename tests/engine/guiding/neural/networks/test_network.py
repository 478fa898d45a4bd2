# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance network: encoding against plain numpy, gradients, kernels against torch, and that training learns."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from engine.guiding.neural.networks.encoding import (
    backpropagate_positions,
    contract,
    encode_directions,
    encode_positions,
    make_encoding,
)
from engine.guiding.neural.networks.radiance import NetworkShape, robust_bounds
from engine.guiding.neural.networks.radiance_query import make_network_field
from engine.guiding.neural.trainer.channel import pack_rows
from engine.guiding.records.light import allocate_records
from tests.helpers.guiding_harness import random_directions
from tests.helpers.radiance_networks import (
    BOUNDS,
    FAST,
    SHAPE,
    predict,
    random_parameters,
    random_positions,
    random_snapshot,
    reference_radiance,
    synthetic_rows,
)
from tests.helpers.training import require_torch


def reference_features(shape, parameters, positions):
    """Hash grid in plain numpy, float64: one position, level, corner at a time."""
    table = shape.split(parameters)["table"].astype(np.float64)
    middle, half = BOUNDS.mean(axis=0, dtype=np.float64), 0.5 * (BOUNDS[1] - BOUNDS[0]).astype(np.float64)
    features = np.zeros((len(positions), shape.level_count, shape.level_features))
    for row, position in enumerate(positions.astype(np.float64)):
        u = (position - middle) / half
        u = np.where(np.abs(u) <= 1.0, 0.9 * u, np.sign(u) * (1.0 - 0.1 / np.maximum(np.abs(u), 1.0)))
        u = 0.5 + 0.5 * u
        for level, resolution in enumerate(shape.resolutions):
            cell = np.minimum((u * resolution).astype(np.int64), resolution - 1)
            fraction = u * resolution - cell
            for corner in np.ndindex(2, 2, 2):
                share = np.prod(np.where(np.array(corner) == 1, fraction, 1.0 - fraction))
                x, y, z = (int(c) for c in cell + corner)
                if (resolution + 1) ** 3 <= shape.table_size:
                    entry = x + (resolution + 1) * (y + (resolution + 1) * z)
                else:
                    entry = (x ^ (y * 2654435761 % 2**32) ^ (z * 805459861 % 2**32)) % shape.table_size
                features[row, level] += share * table[shape.level_offsets[level] + entry]
    return features.reshape(len(positions), -1)


def test_shape_is_the_papers():
    shape = NetworkShape()
    assert shape.resolutions[0] == 8 and shape.resolutions[-1] == 2048
    assert shape.level_offsets[1] == 9**3
    assert shape.level_offsets[-1] - shape.level_offsets[-2] == 1 << 16
    views = shape.split(np.zeros(shape.parameter_count, np.float32))
    assert views["hidden_weights"].shape == (2, 64, 64) and views["output_weights"].shape == (64, 3)
    assert sum(view.size for view in views.values()) == shape.parameter_count


@pytest.mark.parametrize("wrong", [{"table_size": 1000}, {"width": 20}, {"hidden_layers": 0}, {"level_features": 3}])
def test_shape_refuses(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        NetworkShape(**wrong)


@pytest.mark.parametrize("spread", [0.99, 50.0])
def test_positions_are_encoded_as_the_reference_says(spread):
    rng = np.random.default_rng(3)
    positions = random_positions(rng, 40, spread)
    parameters = random_parameters()
    out = np.zeros((40, SHAPE.position_width), np.float32)
    encode_positions(make_encoding(SHAPE, BOUNDS, parameters), positions, 0, 40, out)
    # At 2048 cells an axis, float32 tells 1/8000 of a cell; corners differ by about one.
    np.testing.assert_allclose(out, reference_features(SHAPE, parameters, positions), atol=3e-3)


def test_contraction_takes_anything():
    center, inverse = np.float32(1.0), np.float32(0.5)
    values = [contract(np.float32(x), center, inverse) for x in (-np.inf, -1e30, -50, -1, 0, 1, 3, 50, 1e30, np.inf)]
    assert all(0.0 <= v <= 1.0 for v in values)
    assert np.all(np.diff(values) >= 0.0)
    np.testing.assert_allclose(values[3:7], (0.05, 0.275, 0.5, 0.95), atol=1e-6)
    assert contract(np.float32(np.nan), center, inverse) == 0.5


def test_directions_spread_over_three_bins():
    rng = np.random.default_rng(4)
    directions = np.concatenate((random_directions(rng, 1000), np.eye(3), -np.eye(3))).astype(np.float32)
    bins = 8
    out = np.full((len(directions), 3 * bins), np.nan, np.float32)
    encode_directions(directions, bins, 0, len(directions), out)
    per_axis = out.reshape(-1, 3, bins)
    np.testing.assert_allclose(per_axis.sum(axis=2), 1.0, atol=1e-6)
    assert (per_axis >= 0.0).all() and ((per_axis > 0.0).sum(axis=2) <= 3).all()
    # The mean bin is linear in the coordinate: nothing is lost between bins or at the ends.
    mean = (per_axis * (np.arange(bins) - 0.5)).sum(axis=2) / (bins - 2)
    np.testing.assert_allclose(2.0 * mean - 1.0, directions, atol=1e-6)


def test_gradient_of_the_grid_is_that_of_torch():
    torch = require_torch()
    from engine.guiding.neural.worker.torch_encoding import encode_positions_torch

    rng = np.random.default_rng(5)
    positions = random_positions(rng, 200, 1.5)
    parameters = random_parameters()
    encoding = make_encoding(SHAPE, BOUNDS, parameters)
    table = torch.from_numpy(encoding.table.copy()).requires_grad_()
    tensors = (torch.from_numpy(a) for a in (encoding.level, encoding.center, encoding.inverse_extent))
    features = encode_positions_torch(*tensors, table, torch.from_numpy(positions))
    ours = np.zeros((200, SHAPE.position_width), np.float32)
    encode_positions(encoding, positions, 0, 200, ours)
    np.testing.assert_allclose(features.detach().numpy(), ours, atol=3e-3)
    cotangent = rng.normal(size=ours.shape).astype(np.float32)
    features.backward(torch.from_numpy(cotangent))
    gradient = np.zeros_like(encoding.table)
    for level in range(SHAPE.level_count):
        backpropagate_positions(encoding, positions, positions[:, 0], 200, cotangent, 0, level, level + 1, gradient)
    np.testing.assert_allclose(gradient, table.grad.numpy(), atol=3e-3)
    # The encoding is linear in the table, so this finite difference is exact.
    step = rng.normal(size=gradient.shape).astype(np.float32)
    moved = np.zeros_like(ours)
    encode_positions(encoding._replace(table=encoding.table + step), positions, 0, 200, moved)
    assert math.isclose(np.sum((moved - ours) * cotangent, dtype=np.float64), np.sum(gradient * step), rel_tol=1e-3)


@pytest.mark.parametrize("hidden_layers", [1, 3])
def test_inference_is_the_network(hidden_layers):
    shape = dataclasses.replace(SHAPE, hidden_layers=hidden_layers, width=32)
    rng = np.random.default_rng(6)
    snapshot = random_snapshot(shape)
    positions = random_positions(rng, 100, 2.0)
    counts = rng.integers(0, 6, 100)  # Candidates come in groups of any size, none among them.
    vertices = np.repeat(np.arange(100), counts).astype(np.int32)
    directions = random_directions(rng, len(vertices))
    out = np.full((len(vertices) + 3, 3), -1.0, np.float32)
    predict(shape, snapshot, positions, vertices, directions, out)
    expected = reference_radiance(snapshot, shape, positions[vertices], directions)
    np.testing.assert_allclose(out[: len(vertices)], expected, rtol=1e-4)
    assert (out[len(vertices) :] == -1.0).all()
    # Order and grouping change the cost, not the result.
    shuffled = rng.permutation(len(vertices))
    again = np.zeros((len(vertices), 3), np.float32)
    predict(shape, snapshot, positions, vertices[shuffled], directions[shuffled], again)
    np.testing.assert_allclose(again, out[shuffled], rtol=1e-5)


def test_inference_stays_positive_and_finite():
    """Whatever the parameters and the inputs: RIS needs a target above zero."""
    snapshot = random_snapshot()
    SHAPE.split(snapshot.parameters)["output_weights"][...] *= 1e6
    positions = np.array(((0, 0, 0), (1e30, 0, 0), (np.inf, -np.inf, 0), (np.nan, 0, 0)), np.float32)
    out = np.zeros((4, 3), np.float32)
    predict(SHAPE, snapshot, positions, np.arange(4), random_directions(np.random.default_rng(7), 4), out)
    assert np.isfinite(out).all() and (out > 0.0).all()


@pytest.mark.parametrize(
    "wrong",
    [
        lambda s: dataclasses.replace(s, parameters=np.where(np.arange(s.parameters.size) == 7, np.nan, s.parameters)),
        lambda s: dataclasses.replace(
            s, parameters=np.where(np.arange(s.parameters.size) == 7, np.inf, s.parameters).astype(np.float32)
        ),
        lambda s: dataclasses.replace(s, parameters=s.parameters[1:]),
        lambda s: dataclasses.replace(s, scale=math.nan),
        lambda s: dataclasses.replace(s, scale=0.0),
        lambda s: dataclasses.replace(s, bounds=np.zeros((2, 3), np.float32)),
        lambda s: dataclasses.replace(s, bounds=np.full((2, 3), np.nan, np.float32)),
    ],
)
def test_bad_snapshots_are_refused(wrong):
    good = random_snapshot()
    good.validate(SHAPE)
    with pytest.raises(ValueError, match="snapshot 1"):
        make_network_field(SHAPE, wrong(good))


def test_bounds_forget_the_horizon():
    rng = np.random.default_rng(8)
    room = rng.uniform(-2.0, 2.0, (10_000, 3)).astype(np.float32)
    room[:20] = 1e6
    room[20:30] = np.nan
    lower, upper = robust_bounds(room)
    assert (lower < -1.9).all() and (lower > -3).all() and (upper > 1.9).all() and (upper < 3).all()
    flat = room[100:] * np.array((1, 1, 0), np.float32)
    assert (np.diff(robust_bounds(flat), axis=0) > 0.0).all()
    assert (np.diff(robust_bounds(np.full((5, 3), 1e6, np.float32)), axis=0) > 0.0).all()
    assert (np.diff(robust_bounds(np.full((5, 3), np.nan, np.float32)), axis=0) > 0.0).all()


# Training


def relative_error(prediction, truth):
    scale = truth.mean()
    return np.mean((prediction - truth) ** 2 / (truth**2 + 0.01 * scale**2))


@pytest.fixture(scope="module")
def trained():
    require_torch()
    from engine.guiding.neural.worker.radiance_training import RadianceTraining

    training = RadianceTraining(SHAPE, FAST, seed=1, bounds=BOUNDS)
    training.add(synthetic_rows(400_000, 1))
    first = training.improvement()
    for _ in range(400):
        training.step()
    return training, first, training.improvement()


def test_training_learns(trained):
    training, first, improvement = trained
    held_out = synthetic_rows(5000, 2, noise=False)
    truth = held_out[:, 6:]
    # The best that knows nothing of position and direction, found by trying.
    constant = min(relative_error(np.full_like(truth, c), truth) for c in np.linspace(0.05, 1, 40) * truth.mean())
    assert relative_error(training.predict(held_out), truth) < 0.5 * constant
    assert math.isinf(first) and 0.0 < improvement < 1.0 and math.isfinite(training.loss)


def test_training_and_inference_agree(trained):
    training = trained[0]
    rows = synthetic_rows(500, 3)
    out = np.zeros((500, 3), np.float32)
    predict(SHAPE, training.snapshot(), rows[:, :3].copy(), np.arange(500), rows[:, 3:6].copy(), out)
    np.testing.assert_allclose(out, training.predict(rows), rtol=1e-4)


def test_one_firefly_does_not_bend_the_field(trained):
    from engine.guiding.neural.worker.radiance_training import RadianceTraining

    predictions = []
    rows = synthetic_rows(20_000, 4)
    test = synthetic_rows(2000, 5, noise=False)
    for brightest in (rows[123, 6:].copy(), 1e6):
        rows[123, 6:] = brightest
        training = RadianceTraining(SHAPE, FAST, seed=1, bounds=BOUNDS)
        training.add(rows)
        training.scale = 1.0
        for _ in range(60):
            training.step()
        predictions.append(training.predict(test))
    calm, shaken = predictions
    truth = test[:, 6:]
    assert relative_error(shaken, truth) < 1.3 * relative_error(calm, truth) + 0.02


def test_training_is_deterministic():
    require_torch()
    from engine.guiding.neural.worker.radiance_training import RadianceTraining

    results = []
    for _ in range(2):
        training = RadianceTraining(SHAPE, FAST, seed=9, bounds=BOUNDS)
        for part in range(3):
            training.add(synthetic_rows(3000, part))
            for _ in range(3):
                training.step()
        results.append(training.snapshot().parameters.copy())
    assert np.array_equal(*results)


def test_training_waits_for_light():
    require_torch()
    from engine.guiding.neural.worker.radiance_training import RadianceTraining

    training = RadianceTraining(SHAPE, FAST, seed=9)
    rows = synthetic_rows(1000, 1)
    dark = rows.copy()
    dark[:, 6:] = 0.0
    training.add(dark)
    assert not training.can_train
    training.add(rows)
    assert training.can_train
    training.step()
    training.snapshot().validate(SHAPE)


def test_records_that_are_not_finite_are_left_out():
    records = allocate_records(100)
    records.radiance[:] = np.arange(100, dtype=np.float32)[:, None]
    records.radiance[7, 1] = np.nan
    records.direction[9, 2] = np.inf
    records.position[11, 0] = -np.inf
    records.radiance[13] = -1.0
    out = np.zeros((100, SHAPE.row_width), np.float32)
    assert pack_rows(records, 100, 100, np.uint32(1), False, out) == 97
    assert out[:97, 6].tolist() == [0.0 if k == 13 else k for k in range(100) if k not in (7, 9, 11)]


def test_too_many_records_are_thinned_evenly():
    records = allocate_records(1000)
    records.radiance[:] = np.arange(1000, dtype=np.float32)[:, None]
    out = np.zeros((100, SHAPE.row_width), np.float32)
    assert pack_rows(records, 1000, 100, np.uint32(1), False, out) == 100
    picked = out[:, 6].astype(int)
    assert (picked // 10 == np.arange(100)).all() and len(set(picked % 10)) == 10
