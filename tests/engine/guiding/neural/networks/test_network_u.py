# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance network where light depends on u: on the time, or on the wavelength, whose quarters it tells apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.guiding.neural.networks.encoding import backpropagate_u, encode_u, make_encoding
from engine.guiding.neural.networks.radiance import COARSE_U_ENCODINGS, COMPACT_SHAPE, NetworkShape, network_shape
from engine.guiding.neural.networks.radiance_query import make_network_field
from engine.guiding.neural.trainer.channel import pack_rows
from engine.guiding.neural.trainer.handle import NetworkTrainer
from engine.guiding.records.light import allocate_records
from engine.guiding.records.vertices import allocate_vertex_records, as_records_by_quarter
from engine.settings import NETWORK_U_ENCODINGS, RenderSettings
from engine.spectral.wavelengths import WAVELENGTH_COUNT, hero_quarter, rotate_hero
from tests.helpers.guiding_harness import random_directions
from tests.helpers.radiance_networks import (
    BOUNDS,
    FAST,
    predict,
    random_positions,
    random_snapshot,
    reference_radiance,
    synthetic_rows,
)
from tests.helpers.training import require_torch

SMALL = NetworkShape(level_count=2, finest_resolution=16, table_size=1 << 12, width=32, hidden_layers=2)
FREQUENCY, PLANES = (replace(SMALL, **COARSE_U_ENCODINGS[name]) for name in ("FREQUENCY", "PLANES"))
BOTH = replace(PLANES, u_frequencies=3)
BY_QUARTER = replace(PLANES, channel_count=WAVELENGTH_COUNT, by_quarter=True)


def test_a_shape_that_does_not_see_u_is_what_it_was():
    assert list(SMALL.layout) == [
        "table", "position_weights", "direction_weights", "hidden_weights", "output_weights"
    ]  # fmt: skip
    assert SMALL.row_width == 9 and SMALL.u_width == 0
    assert network_shape(RenderSettings(network_u="NONE", u_dimension="TIME")) == COMPACT_SHAPE


def test_a_shape_that_sees_u_has_room_for_it():
    assert FREQUENCY.u_width == 8 and PLANES.u_width == 18 and BOTH.u_width == 24
    assert FREQUENCY.row_width == PLANES.row_width == 10
    assert "planes" not in FREQUENCY.layout
    assert PLANES.layout["planes"] == (3 * (5**2 + 9**2 + 17**2), 2)
    assert BOTH.layout["u_weights"] == (24, 32)
    for shape in (FREQUENCY, PLANES, BOTH):
        assert shape.training_settings.learning_rate < SMALL.training_settings.learning_rate
        views = shape.split(np.zeros(shape.parameter_count, np.float32))
        assert sum(view.size for view in views.values()) == shape.parameter_count
    with pytest.raises(ValueError, match="plane_levels"):
        NetworkShape(plane_levels=10, plane_features=8)
    with pytest.raises(ValueError, match="channel_count"):
        NetworkShape(by_quarter=True)


@pytest.mark.parametrize("network_u", NETWORK_U_ENCODINGS)
def test_settings_say_what_is_seen(network_u):
    time = network_shape(RenderSettings(network_u=network_u, u_dimension="TIME", spectral="ON"))
    wavelength = network_shape(RenderSettings(network_u=network_u, u_dimension="WAVELENGTH", spectral="ON"))
    assert (time.u_width > 0) == (network_u in ("FREQUENCY", "PLANES"))
    assert (wavelength.u_width > 0) == wavelength.by_quarter == (network_u != "NONE")
    assert not time.by_quarter
    assert time.channel_count == wavelength.channel_count == 4


def encoded(shape, snapshot, positions, u):
    features = np.full((len(u), shape.u_width), np.nan, np.float32)
    encode_u(make_encoding(shape, BOUNDS, snapshot.parameters), positions, u, 0, len(u), features)
    return features


def with_planes(shape, seed=0):
    """A snapshot whose planes matter, unlike at the start of training."""
    snapshot = random_snapshot(shape)
    if shape.plane_levels:
        planes = shape.split(snapshot.parameters)["planes"]
        planes[...] = np.random.default_rng(seed).normal(size=planes.shape)
    return snapshot


def test_u_is_encoded_as_the_reference_says():
    """Planes and frequencies in plain numpy, float64."""
    rng = np.random.default_rng(1)
    positions, u = random_positions(rng, 50), rng.random(50).astype(np.float32)
    snapshot = with_planes(BOTH)
    planes = BOTH.split(snapshot.parameters)["planes"].astype(np.float64)
    place = 0.05 + 0.9 * (positions - BOUNDS[0]) / (BOUNDS[1] - BOUNDS[0])
    expected = []
    for level, resolution in enumerate(BOTH.plane_resolutions):
        side = resolution + 1
        for plane in range(3):
            first = BOTH.plane_offsets[level] + plane * side * side
            grid = planes[first : first + side * side].reshape(side, side, -1)  # u, then the coordinate
            x, y = place[:, plane] * resolution, u * resolution
            i, j = x.astype(int), y.astype(int)
            fx, fy = (x - i)[:, None], (y - j)[:, None]
            low = (1.0 - fx) * grid[j, i] + fx * grid[j, i + 1]
            high = (1.0 - fx) * grid[j + 1, i] + fx * grid[j + 1, i + 1]
            expected.append((1.0 - fy) * low + fy * high)
    for octave in range(3):
        angle = np.pi * 2.0**octave * u.astype(np.float64)[:, None]
        expected += [np.sin(angle), np.cos(angle)]
    np.testing.assert_allclose(encoded(BOTH, snapshot, positions, u), np.concatenate(expected, axis=1), atol=1e-4)


def test_u_may_be_anything():
    positions = random_positions(np.random.default_rng(2), 4)
    features = encoded(BOTH, with_planes(BOTH), positions, np.array((np.nan, -1.0, 2.0, np.inf), np.float32))
    assert np.isfinite(features).all()


def test_gradient_of_the_planes_is_that_of_torch():
    torch = require_torch()
    from engine.guiding.neural.worker.torch_encoding import encode_u_torch

    rng = np.random.default_rng(3)
    positions, u = random_positions(rng, 100, 1.5), rng.random(100).astype(np.float32)
    snapshot = with_planes(BOTH)
    encoding = make_encoding(BOTH, BOUNDS, snapshot.parameters)
    planes = torch.from_numpy(encoding.planes.copy()).requires_grad_()
    level, center, inverse = (
        torch.from_numpy(a) for a in (encoding.plane_level, encoding.center, encoding.inverse_extent)
    )
    features = encode_u_torch(
        level, center, inverse, planes, BOTH.u_frequencies, torch.from_numpy(positions), torch.from_numpy(u)
    )
    np.testing.assert_allclose(features.detach().numpy(), encoded(BOTH, snapshot, positions, u), atol=1e-4)
    cotangent = rng.normal(size=features.shape).astype(np.float32)
    features.backward(torch.from_numpy(cotangent))
    gradient = np.zeros_like(encoding.planes)
    for index in range(BOTH.plane_levels):
        backpropagate_u(encoding, positions, u, 100, cotangent, 0, index, index + 1, gradient)
    np.testing.assert_allclose(gradient, planes.grad.numpy(), atol=1e-4)


@pytest.mark.parametrize("shape", [FREQUENCY, PLANES, BOTH], ids=["frequency", "planes", "both"])
def test_inference_is_the_network(shape):
    rng = np.random.default_rng(4)
    snapshot, positions = with_planes(shape), random_positions(rng, 60)
    time = rng.random(60).astype(np.float32)
    vertices = np.repeat(np.arange(60), rng.integers(0, 5, 60))
    directions = random_directions(rng, len(vertices))
    out = np.zeros((len(vertices), 3), np.float32)
    predict(shape, snapshot, positions, vertices, directions, out, time)
    features = encoded(shape, snapshot, positions, time)[vertices]
    expected = reference_radiance(snapshot, shape, positions[vertices], directions, features)
    np.testing.assert_allclose(out, expected, rtol=1e-4)


def test_a_path_gets_the_quarters_of_its_wavelengths():
    """Channel c is that of the quarter that c's number lies in, u how far within."""
    rng = np.random.default_rng(5)
    snapshot, positions = with_planes(BY_QUARTER), random_positions(rng, 60)
    directions, hero = random_directions(rng, 60), rng.random(60).astype(np.float32)
    out = np.zeros((60, 4), np.float32)
    predict(BY_QUARTER, snapshot, positions, np.arange(60), directions, out, hero=hero)
    features = encoded(BY_QUARTER, snapshot, positions, np.float32(4.0) * hero % 1.0)
    by_quarter = reference_radiance(snapshot, BY_QUARTER, positions, directions, features)
    numbers = np.array([[rotate_hero(h, c) for c in range(4)] for h in hero])
    expected = np.take_along_axis(by_quarter, (4.0 * numbers).astype(int), axis=1)
    np.testing.assert_allclose(out, expected, rtol=1e-4)


def test_quarters_of_heroes_take_anything():
    for u, quarter in ((np.nan, 0), (-1.0, 0), (0.0, 0), (0.3, 1), (np.float32(1.0), 3), (np.inf, 3)):
        found, offset = hero_quarter(np.float32(u))
        assert found == quarter and 0.0 <= offset <= 1.0


def test_wavelengths_are_recorded_by_quarter():
    records = allocate_vertex_records(3, 4)
    records.hero[:] = 0.1, 0.6, 0.99
    records.spectrum[:] = [(1, 2, 3, 4), (1, np.nan, np.nan, np.nan), (1, 2, np.nan, 4)]
    sorted_records = as_records_by_quarter(records, 3)
    np.testing.assert_array_equal(
        sorted_records.radiance, [(1, 2, 3, 4), (np.nan, np.nan, 1, np.nan), (2, np.nan, 4, 1)]
    )
    np.testing.assert_allclose(sorted_records.time, (0.4, 0.4, 0.96), atol=1e-6)


def test_rows_have_u_and_may_not_know_all_radiance():
    records = allocate_records(20, 4)
    records.radiance[:] = np.arange(20, dtype=np.float32)[:, None]
    records.time[:] = np.arange(20) / 20
    records.radiance[3, 1:] = np.nan
    records.radiance[5] = np.nan
    records.radiance[7, 2] = np.inf
    records.time[9] = np.nan
    out = np.zeros((20, BY_QUARTER.row_width), np.float32)
    count = pack_rows(records, 20, 20, np.uint32(1), True, out)
    kept = [k for k in range(20) if k not in (5, 7, 9)]
    np.testing.assert_array_equal(out[:count, 6], kept)
    np.testing.assert_allclose(out[:count, 10], np.array(kept) / 20)
    assert np.isnan(out[:count, 7:10]).sum() == 3 and np.isnan(out[3, 7:10]).all()


# Training

#: Of quarters.
COLOR = np.array((0.5, 1.0, 2.0, 0.5), np.float32)
#: Radiance when the light is on over that when it is not.
CONTRAST = 41.0


def blinking_rows(shape, count, seed, noise=True):
    """`synthetic_rows` whose light goes on with u; by quarter each has a colour, and rows know that of one."""
    rng = np.random.default_rng(seed)
    plain = synthetic_rows(count, seed, noise)
    u = rng.random(count).astype(np.float32)
    light = plain[:, 6:7] * np.where(is_on(u), CONTRAST, 1.0)[:, None]
    rows = np.zeros((count, shape.row_width), np.float32)
    rows[:, :6] = plain[:, :6]
    if shape.by_quarter:
        light = light * COLOR
        light[np.arange(4) != rng.integers(0, 4, count)[:, None]] = np.nan
    rows[:, 6 : 6 + shape.channel_count] = light
    if shape.u_width:
        rows[:, -1] = u
    return rows


def is_on(u):
    return u > 0.5


def trained(shape, steps=150):
    require_torch()
    from engine.guiding.neural.worker.radiance_training import RadianceTraining

    training = RadianceTraining(shape, FAST, seed=1, bounds=BOUNDS)
    training.add(blinking_rows(shape, 100_000, 1))
    for _ in range(steps):
        training.step()
    return training


def contrast(training, rows, u):
    """Predicted radiance when the light is on over that when it is not."""
    prediction = training.predict(rows)
    return prediction[is_on(u)].mean() / prediction[~is_on(u)].mean()


@pytest.mark.parametrize("shape", [FREQUENCY, PLANES], ids=["frequency", "planes"])
def test_training_learns_what_depends_on_u(shape):
    training, rows = trained(shape), blinking_rows(shape, 5000, 2)
    assert 0.4 * CONTRAST < contrast(training, rows, rows[:, -1]) < 2.0 * CONTRAST
    out = np.zeros((300, 3), np.float32)
    some, time = rows[:300], rows[:300, -1].copy()
    predict(shape, training.snapshot(), some[:, :3].copy(), np.arange(300), some[:, 3:6].copy(), out, time)
    np.testing.assert_allclose(out, training.predict(some), rtol=1e-3)


def test_training_without_u_learns_the_mean():
    rows = blinking_rows(SMALL, 5000, 2)
    u = blinking_rows(FREQUENCY, 5000, 2)[:, -1]
    assert contrast(trained(SMALL), rows, u) == pytest.approx(1.0, abs=0.2)


def test_training_by_quarter_learns_each_from_the_rows_that_know_it():
    training, rows = trained(BY_QUARTER), blinking_rows(BY_QUARTER, 5000, 2)
    assert contrast(training, rows, rows[:, -1]) > 0.4 * CONTRAST
    color = training.predict(rows).mean(axis=0)
    np.testing.assert_allclose(color / color.mean(), COLOR, rtol=0.4)
    assert np.isfinite(training.snapshot().parameters).all() and training.improvement() > 0.0
    assert np.isfinite(training.loss)


def test_training_that_sees_u_is_deterministic():
    first, again = (trained(PLANES, 5).snapshot().parameters.copy() for _ in range(2))
    assert np.array_equal(first, again)


def test_the_worker_trains_by_quarter():
    """Records with wavelengths that are not known get there, and the field made of the answer is by quarter."""
    require_torch()
    rng = np.random.default_rng(6)
    records = allocate_vertex_records(2000, 4)
    records.position[:], records.direction[:] = random_positions(rng, 2000), random_directions(rng, 2000)
    records.hero[:] = rng.random(2000)
    records.spectrum[:] = rng.exponential(size=(2000, 4))
    records.spectrum[::2, 1:] = np.nan
    with NetworkTrainer(BY_QUARTER, BOUNDS, settings=FAST, deterministic=True) as trainer:
        assert trainer.submit(as_records_by_quarter(records, 2000), 2000) == 2000
        snapshot = trainer.train_until(3)
    assert snapshot is not None and snapshot.step == 3 and 0.5 < snapshot.scale < 2.0 and np.isfinite(snapshot.loss)
    assert make_network_field(BY_QUARTER, snapshot).by_quarter[0] == 1
