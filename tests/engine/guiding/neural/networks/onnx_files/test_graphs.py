# SPDX-License-Identifier: GPL-3.0-or-later
"""Networks as ONNX graphs: valid for package onnx, and in onnxruntime what the kernels give."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from engine.guiding.neural.networks.mixture import shape as shapes
from engine.guiding.neural.networks.mixture.inference import (
    allocate_mixture_scratch,
    evaluate_mixtures,
    make_mixture_network,
)
from engine.guiding.neural.networks.onnx_files.files import StoredNetwork, load_network, network_to_onnx, save_network
from engine.guiding.neural.networks.radiance import COMPACT_SHAPE, NetworkShape
from engine.spectral.wavelengths import hero_quarter
from tests.helpers import mixture_networks
from tests.helpers.guiding_harness import random_directions
from tests.helpers.radiance_networks import predict, random_positions, random_snapshot

#: Rows that both are asked.
ROWS = 1000
RADIANCE = {
    "compact": COMPACT_SHAPE,
    "paper": NetworkShape(),
    "wide": NetworkShape(width=128, table_size=1 << 12),
    "dense grids": NetworkShape(level_count=3, finest_resolution=16, table_size=1 << 14, hidden_layers=1),
    "hashed grids": NetworkShape(level_count=2, base_resolution=64, level_features=2, table_size=1 << 10),
    "frequencies": dataclasses.replace(COMPACT_SHAPE, u_frequencies=4),
    "planes": dataclasses.replace(COMPACT_SHAPE, plane_levels=3, plane_resolution=4, plane_features=4),
    "planes and frequencies": dataclasses.replace(COMPACT_SHAPE, plane_levels=1, u_frequencies=2, channel_count=4),
    "by quarter": dataclasses.replace(COMPACT_SHAPE, channel_count=4, by_quarter=True, u_frequencies=2),
}
MIXTURES = {
    **mixture_networks.SHAPES, "NPM": shapes.NPM, "NPM_PRODUCT": shapes.NPM_PRODUCT,
    "NPM_OFFICIAL": shapes.NPM_OFFICIAL, "NASG": shapes.NASG, "SG": shapes.SG,
}  # fmt: skip


def lively_snapshot(shape):
    """A network whose radiance spans orders of magnitude."""
    snapshot = random_snapshot(shape)
    shape.split(snapshot.parameters)["output_weights"][...] *= 30.0
    return snapshot


def run(data, feeds):
    """What onnxruntime makes of inputs that the model takes."""
    onnxruntime = pytest.importorskip("onnxruntime")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    return session.run(None, {item.name: feeds[item.name] for item in session.get_inputs()})[0]


def radiance_probe(shape, spread=1.5):
    """Positions, some outside of the bounds, with none to six directions each; times and heroes."""
    rng = np.random.default_rng(11)
    vertices = np.sort(rng.integers(0, ROWS // 3, ROWS))
    positions = random_positions(rng, ROWS // 3, spread)
    time, hero = rng.random((2, ROWS // 3)).astype(np.float32)
    return positions, vertices, random_directions(rng, ROWS), time, hero


@pytest.mark.parametrize("shape", [*RADIANCE.values(), *MIXTURES.values()], ids=[*RADIANCE, *MIXTURES])
def test_graphs_are_valid(shape):
    onnx = pytest.importorskip("onnx")
    radiance = isinstance(shape, NetworkShape)
    snapshot = random_snapshot(shape) if radiance else mixture_networks.random_snapshot(shape)
    onnx.checker.check_model(network_to_onnx(StoredNetwork(shape, snapshot)), full_check=True)


@pytest.mark.parametrize("shape", RADIANCE.values(), ids=RADIANCE)
def test_radiance_is_the_kernels(shape, tmp_path):
    save_network(tmp_path / "network.onnx", StoredNetwork(shape, lively_snapshot(shape)))
    snapshot = load_network(tmp_path / "network.onnx").snapshot
    positions, vertices, directions, time, hero = radiance_probe(shape)
    expected = np.zeros((ROWS, shape.channel_count), np.float32)
    predict(shape, snapshot, positions, vertices, directions, expected, time, hero)
    u = time
    if shape.by_quarter:
        quarter, u = (np.array(values) for values in zip(*map(hero_quarter, hero), strict=True))
    found = run(
        (tmp_path / "network.onnx").read_bytes(),
        {"position": positions, "direction": directions, "vertex": vertices, "u": u.astype(np.float32)},
    )
    if shape.by_quarter:
        channels = (quarter[vertices, None] + np.arange(4)) % 4
        found = np.take_along_axis(found, channels, axis=1)
    assert np.log(expected).std() > 0.5
    np.testing.assert_allclose(found, expected, rtol=2e-3)


def test_radiance_is_finite_whatever_goes_in():
    snapshot = random_snapshot(COMPACT_SHAPE)
    COMPACT_SHAPE.split(snapshot.parameters)["output_weights"][...] *= 1e30
    positions = np.array(((0, 0, 0), (1e30, 0, 0), (np.inf, -np.inf, 0), (np.nan, 0, 0)), np.float32)
    directions = random_directions(np.random.default_rng(7), 4)
    found = run(
        network_to_onnx(StoredNetwork(COMPACT_SHAPE, snapshot)),
        {"position": positions, "direction": directions, "vertex": np.arange(4)},
    )
    assert np.isfinite(found).all() and (found > 0.0).all()


@pytest.mark.parametrize("shape", MIXTURES.values(), ids=MIXTURES)
def test_mixtures_are_the_kernels(shape, tmp_path):
    save_network(tmp_path / "network.onnx", StoredNetwork(shape, mixture_networks.random_snapshot(shape)))
    snapshot = load_network(tmp_path / "network.onnx").snapshot
    points = mixture_networks.random_points(ROWS, seed=5)
    expected = np.zeros((ROWS, shape.output_width), np.float32)
    network = make_mixture_network(shape, snapshot)
    evaluate_mixtures(network, *points, ROWS, allocate_mixture_scratch(shape), expected)
    feeds = dict(zip(("position", "normal", "wo", "roughness", "u"), points, strict=True))
    found = run((tmp_path / "network.onnx").read_bytes(), feeds)
    assert expected.std() > 0.03
    np.testing.assert_allclose(found, expected, atol=1e-3 * expected.std(), rtol=1e-3)
