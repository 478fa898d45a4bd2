# SPDX-License-Identifier: GPL-3.0-or-later
"""Small mixture networks of every kind, and points to ask them at."""

from __future__ import annotations

import numpy as np

from engine.guiding.neural.networks.mixture import shape as shapes
from engine.guiding.neural.networks.mixture.shape import MixtureShape, initial_parameters
from engine.guiding.neural.networks.radiance import Snapshot
from tests.helpers.guiding_harness import random_directions

#: Of the snapshots below [m].
BOUNDS = np.array(((-1.0, 0.0, 2.0), (3.0, 1.0, 4.0)), np.float32)
SMALL_GRIDS = {"level_count": 3, "base_resolution": 4, "growth": 1.5}
#: Every way to see a point.
SHAPES = {
    "linear grids": MixtureShape(**SMALL_GRIDS),
    "smooth grids": MixtureShape(
        **SMALL_GRIDS, level_features=8, interpolation="SMOOTH", normal_encoding="BLOB", normal_size=4,
        wo_encoding="HARMONICS", wo_size=4, roughness_bins=4, target="PRODUCT", has_selection=True,
    ),
    "one-blob": shapes.NASG_PRODUCT,
    "frequencies": MixtureShape(position_encoding="BLOB", normal_encoding="RAW", u_frequencies=3),
    "planes": MixtureShape(**SMALL_GRIDS, normal_encoding="RAW", plane_levels=3, u_frequencies=2),
    "smooth planes": MixtureShape(
        position_encoding="BLOB", interpolation="SMOOTH", plane_levels=2, plane_features=4, plane_resolution=5,
        plane_growth=1.7,
    ),
    "four dimensions": MixtureShape(position_encoding="NONE", hash_levels=3, hash_resolution=4, hash_size=1 << 11),
    "smooth four dimensions": MixtureShape(
        **SMALL_GRIDS, interpolation="SMOOTH", plane_levels=1, hash_levels=2, hash_features=8, hash_resolution=3,
        hash_size=1 << 9,
    ),
}


def random_parameters(shape, seed=0):
    """Parameters whose grids matter, unlike at the start of training."""
    parameters = initial_parameters(shape, seed)
    rng = np.random.default_rng(seed)
    for name, array in shape.split(parameters).items():
        if name in shapes.TABLES:
            array[...] = rng.normal(size=array.shape)
    return parameters


def random_snapshot(shape, seed=0):
    """A snapshot of `random_parameters`."""
    return Snapshot(1, 10, 0.5, 1.0, BOUNDS, random_parameters(shape, seed))


def random_points(count, seed=0, spread=1.3):
    """Position (some outside the bounds), normal, wo, roughness, u."""
    rng = np.random.default_rng(seed)
    middle, half = BOUNDS.mean(axis=0), 0.5 * (BOUNDS[1] - BOUNDS[0])
    position = (middle + spread * half * rng.uniform(-1.0, 1.0, (count, 3))).astype(np.float32)
    roughness = rng.uniform(size=count).astype(np.float32)
    normal, wo = random_directions(rng, count), random_directions(rng, count)
    return position, normal, wo, roughness, rng.uniform(size=count).astype(np.float32)
