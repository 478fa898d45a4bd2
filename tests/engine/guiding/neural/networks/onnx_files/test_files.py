# SPDX-License-Identifier: GPL-3.0-or-later
"""Networks saved as ONNX: the same snapshot comes back, and what is no such file is refused with a reason."""

from __future__ import annotations

import dataclasses
import json
import math
import os

import numpy as np
import pytest

from engine.guiding.neural.networks.mixture import shape as shapes
from engine.guiding.neural.networks.onnx_files import files
from engine.guiding.neural.networks.onnx_files.files import (
    NetworkFileError,
    StoredNetwork,
    load_network,
    network_from_onnx,
    network_to_onnx,
    save_network,
)
from engine.guiding.neural.networks.onnx_files.messages import Model, read_model, write_model
from engine.guiding.neural.networks.radiance import COMPACT_SHAPE, NetworkShape, Snapshot, initial_parameters
from tests.helpers.mixture_networks import SHAPES as MIXTURES

BOUNDS = np.array(((-1.0, 0.1, 2.0), (3.0, 1.0, 4.0)), np.float32)
SMALL = NetworkShape(level_count=2, finest_resolution=16, table_size=1 << 8, width=8, hidden_layers=2)
RADIANCE = {
    "compact": COMPACT_SHAPE,
    "one hidden layer": dataclasses.replace(SMALL, hidden_layers=1),
    "by quarter": dataclasses.replace(SMALL, channel_count=4, by_quarter=True, u_frequencies=2),
    "planes": dataclasses.replace(SMALL, plane_levels=2),
}


def stored(shape, span=(0.0, 1.0)):
    module = shapes if isinstance(shape, shapes.MixtureShape) else None
    parameters = (module.initial_parameters if module else initial_parameters)(shape, 3)
    return StoredNetwork(shape, Snapshot(7, 1200, math.nan, 0.1 + 0.2, BOUNDS, parameters), span)


def with_metadata(data, **changes):
    """A file with some of its metadata changed, or left out where None."""
    model = read_model(data)
    metadata = {**model.metadata, **{f"neuralguide.{name}": value for name, value in changes.items()}}
    return write_model(dataclasses.replace(model, metadata={k: v for k, v in metadata.items() if v is not None}))


@pytest.mark.parametrize("shape", [*RADIANCE.values(), *MIXTURES.values()], ids=[*RADIANCE, *MIXTURES])
def test_snapshots_come_back_bit_for_bit(shape, tmp_path):
    network = stored(shape, span=(0.25, 0.3))
    save_network(tmp_path / "network.onnx", network)
    back = load_network(tmp_path / "network.onnx")
    assert back.shape == shape and type(back.shape) is type(shape) and back.span == (0.25, 0.3)
    before, after = network.snapshot, back.snapshot
    assert (after.version, after.step, after.scale) == (7, 1200, 0.1 + 0.2) and math.isnan(after.loss)
    assert after.parameters.tobytes() == before.parameters.tobytes() and after.parameters.dtype == np.float32
    assert after.bounds.tobytes() == before.bounds.tobytes()
    # A loaded network is saved as the same bytes.
    assert network_to_onnx(back) == (tmp_path / "network.onnx").read_bytes()


def test_every_bit_of_the_weights_counts():
    data = bytearray(network_to_onnx(stored(SMALL)))
    at = data.find(stored(SMALL).snapshot.parameters[5:9].tobytes())
    assert at > 0
    data[at] ^= 1
    with pytest.raises(NetworkFileError, match=r"damaged.*checksum"):
        network_from_onnx(bytes(data))


def test_files_that_end_too_early_are_refused():
    data = network_to_onnx(stored(SMALL))
    for size in (0, 1, 100, len(data) // 2, len(data) - 40, len(data) - 1):
        with pytest.raises(NetworkFileError, match=r"damaged|no network of NeuralGuide"):
            network_from_onnx(data[:size])


@pytest.mark.parametrize(
    "data", [b"", b"PK\x03\x04 a zip", b"hello, world", bytes(1000), np.arange(5000, dtype=np.uint8).tobytes()]
)
def test_other_files_are_refused(data, tmp_path):
    (tmp_path / "other.onnx").write_bytes(data)
    with pytest.raises(NetworkFileError, match=r"other\.onnx: it is (damaged|no network)"):
        load_network(tmp_path / "other.onnx")


def test_networks_of_others_are_refused():
    graph = read_model(network_to_onnx(stored(SMALL))).graph
    with pytest.raises(NetworkFileError, match="no network of NeuralGuide's"):
        network_from_onnx(write_model(Model(graph, {"author": "somebody"})))


def sized(**changes):
    return json.dumps({**dataclasses.asdict(SMALL), **changes})


@pytest.mark.parametrize(
    "changes, why",
    [
        ({"format": str(files.FORMAT + 1)}, "update NeuralGuide"),
        ({"kind": "TRANSFORMER"}, "update NeuralGuide"),
        ({"shape": sized(experts=4)}, r"experts.*update NeuralGuide"),
        ({"shape": sized(width="wide")}, "damaged.*width is 'wide'"),
        ({"shape": sized(width=8.0)}, "damaged.*width is 8.0"),
        ({"shape": sized(level_count=10**9)}, "damaged.*level_count"),
        # Sizes that would take 2 GiB are compared with what is there, not allocated.
        ({"shape": sized(table_size=1 << 22, level_count=16, level_features=8, finest_resolution=1 << 15)}, "damaged"),
        ({"shape": "[]"}, "damaged"),
        ({"shape": "{"}, "damaged"),
        ({"scale": "0.5"}, "damaged.*checksum"),
        ({"scale": None}, "damaged.*scale|damaged.*checksum"),
        ({"checksum": None}, "does not say its checksum"),
        ({"format": "first"}, "damaged"),
        ({"bounds": "[[0, 0, 0]]"}, "damaged"),
    ],
)
def test_metadata_are_checked(changes, why):
    with pytest.raises(NetworkFileError, match=why):
        network_from_onnx(with_metadata(network_to_onnx(stored(SMALL)), **changes))


@pytest.mark.parametrize("bounds", ["[" * 100_000, "[[1e999, 0, 0], [1, 1, 1]]", f"[[1{'0' * 400}, 0, 0], [1, 1, 1]]"])
def test_numbers_out_of_range_are_damage(bounds):
    with pytest.raises(NetworkFileError, match="damaged"):
        network_from_onnx(with_metadata(network_to_onnx(stored(SMALL)), bounds=bounds))


def test_damage_anywhere_is_found_or_does_not_matter():
    """A byte changed at random: the snapshot that was saved, or an error that says so; never another one."""
    whole = network_to_onnx(stored(SMALL))
    expected = stored(SMALL).snapshot.parameters.tobytes()
    rng = np.random.default_rng(1)
    refused = 0
    # Half of the changes hit the first part, the graph's nodes, the others anything.
    for at in np.concatenate((rng.integers(0, 6000, 300), rng.integers(0, len(whole), 300))):
        data = bytearray(whole)
        data[at] ^= 1 << rng.integers(8)
        try:
            back = network_from_onnx(bytes(data))
        except NetworkFileError:
            refused += 1
        else:
            assert back.shape == SMALL and back.snapshot.parameters.tobytes() == expected
            assert back.snapshot.scale == stored(SMALL).snapshot.scale and back.span == (0.0, 1.0)
            assert np.array_equal(back.snapshot.bounds, BOUNDS) and back.snapshot.step == 1200
    assert refused > 300


def test_huge_files_are_not_read(tmp_path):
    path = tmp_path / "huge.onnx"
    with path.open("wb") as file:
        file.truncate(files.MAX_FILE_BYTES + 1)
    with pytest.raises(NetworkFileError, match=r"huge\.onnx: it is larger than 2 GiB"):
        load_network(path)


def test_networks_that_do_not_fit_are_not_written():
    shape = shapes.MixtureShape(
        position_encoding="NONE", hash_levels=16, hash_features=8, hash_resolution=64, hash_growth=1.0
    )
    empty = np.zeros(0, np.float32)
    with pytest.raises(ValueError, match="2 GiB"):
        network_to_onnx(StoredNetwork(shape, Snapshot(1, 1, 0.0, 1.0, BOUNDS, empty)))


def test_bad_snapshots_are_not_written(tmp_path):
    network = stored(SMALL)
    network.snapshot.parameters[3] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        save_network(tmp_path / "bad.onnx", network)
    assert os.listdir(tmp_path) == []


def test_a_failed_save_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "network.onnx"
    save_network(path, stored(SMALL))
    before = path.read_bytes()

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        save_network(path, stored(COMPACT_SHAPE))
    assert path.read_bytes() == before and os.listdir(tmp_path) == ["network.onnx"]
