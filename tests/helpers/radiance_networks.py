# SPDX-License-Identifier: GPL-3.0-or-later
"""Small radiance networks, their answers in plain numpy, and a field of light that they learn."""

from __future__ import annotations

import numpy as np

from engine.guiding.neural.networks.encoding import encode_directions, encode_positions, make_encoding
from engine.guiding.neural.networks.perceptron import MAX_WIDTH, allocate_scratch
from engine.guiding.neural.networks.radiance import NetworkShape, Snapshot, TrainingSettings, initial_parameters
from engine.guiding.neural.networks.radiance_query import make_network_field, predict_network
from tests.helpers.guiding_harness import random_directions

SHAPE = NetworkShape(table_size=1 << 12)
BOUNDS = np.array(((-1.0, 0.0, 2.0), (3.0, 1.0, 4.0)), np.float32)


def random_positions(rng, count, spread=1.0):
    """Uniform in the bounds, or in a box `spread` times as large."""
    middle, half = BOUNDS.mean(axis=0), 0.5 * (BOUNDS[1] - BOUNDS[0])
    return (middle + spread * half * rng.uniform(-1.0, 1.0, (count, 3))).astype(np.float32)


def random_parameters(shape=SHAPE, seed=0):
    """Parameters whose grid matters, unlike at the start of training."""
    parameters = initial_parameters(shape, seed)
    table = shape.split(parameters)["table"]
    table[...] = np.random.default_rng(seed).normal(size=table.shape)
    return parameters


def predict(shape, snapshot, positions, vertices, directions, out, time=None, hero=None):
    """Radiance from every direction into the first rows of `out`."""
    latent, hidden = np.zeros((2, MAX_WIDTH), np.float32), allocate_scratch(MAX_WIDTH)
    field = make_network_field(shape, snapshot)
    nowhere = np.full(len(positions), np.nan, np.float32)
    time, hero = (nowhere if values is None else values for values in (time, hero))
    predict_network(
        field, positions, time, hero, vertices.astype(np.int64), directions, len(vertices), latent, hidden, out
    )


def random_snapshot(shape=SHAPE, scale=2.0):
    """A snapshot of `random_parameters`."""
    return Snapshot(1, 10, 0.5, scale, BOUNDS, random_parameters(shape))


def reference_radiance(snapshot, shape, positions, directions, u_features=None):
    """The whole network in numpy, float64 but for the encoding."""
    arrays = {name: array.astype(np.float64) for name, array in shape.split(snapshot.parameters).items()}
    blobs = np.zeros((len(directions), shape.direction_width), np.float32)
    encode_directions(directions, shape.direction_bins, 0, len(directions), blobs)
    features = np.zeros((len(positions), shape.position_width), np.float32)
    encode_positions(make_encoding(shape, snapshot.bounds, snapshot.parameters), positions, 0, len(positions), features)
    value = features @ arrays["position_weights"] + blobs @ arrays["direction_weights"]
    if u_features is not None:
        value += u_features @ arrays["u_weights"]
    value = np.maximum(value, 0.0)
    for weights in arrays["hidden_weights"]:
        value = np.maximum(value @ weights, 0.0)
    return snapshot.scale * np.exp(np.clip(value @ arrays["output_weights"], -10.0, 10.0))


def synthetic_radiance(positions, directions):
    """A smooth room with a lamp: radiance (N, 3) at any position (in BOUNDS) and direction."""
    u = (positions - BOUNDS[0]) / (BOUNDS[1] - BOUNDS[0])
    lamp = np.array((0.4, 0.3, 0.9)) - u
    lamp /= np.linalg.norm(lamp, axis=1, keepdims=True)
    glow = np.exp(12.0 * ((lamp * directions).sum(axis=1, keepdims=True) - 1.0))
    wall = 0.1 + 0.5 * u[:, :1] * np.maximum(directions[:, 2:], 0.0)
    return (wall + 3.0 * glow) * np.array((1.0, 0.8, 0.4))


def synthetic_rows(count, seed, noise=True):
    """Training rows of `synthetic_radiance`, five times as bright, noisy or exact."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((count, SHAPE.row_width), np.float32)
    rows[:, :3] = random_positions(rng, count)
    rows[:, 3:6] = random_directions(rng, count)
    radiance = synthetic_radiance(rows[:, :3].astype(np.float64), rows[:, 3:6].astype(np.float64))
    rows[:, 6:] = 5.0 * radiance * (rng.exponential(size=(count, 1)) if noise else 1.0)
    return rows


FAST = TrainingSettings(batch_size=2048)
