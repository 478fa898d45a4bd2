# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance network outlives a render too: as an `.onnx` file within the field's, from which training goes on."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.guiding.fields.state import StateError, part
from engine.guiding.models.report import GuidingReport
from engine.guiding.neural.models.network_predictor import NetworkPredictor, stored_network
from engine.guiding.neural.networks.onnx_files.files import StoredNetwork, network_from_onnx, network_to_onnx
from engine.guiding.neural.networks.radiance import Snapshot
from engine.guiding.saved.file import FieldFileError, load_field, save_field
from engine.guiding.saved.learned import LearnedField
from engine.render.session import Session
from engine.settings import RenderSettings
from tests.helpers.learned_fields import learned_field
from tests.helpers.radiance_networks import BOUNDS, SHAPE, random_snapshot, synthetic_rows
from tests.helpers.seeded_renders import Z_LIMIT, z_score
from tests.helpers.small_scenes import pit_scene
from tests.helpers.training import require_torch

NETWORK = {
    "guiding_method": "NEURAL_RIS", "max_bounces": 6, "threads": 1, "guiding_trial": False, "deterministic": True,
    "candidate_allocation": "FIXED", "candidate_count": 2, "training_steps": 8,
}  # fmt: skip


@pytest.fixture
def session() -> Iterator[Session]:
    """A session with the pit, rendered by a network that is trained in step with it."""
    require_torch()
    made = Session(RenderSettings(samples=15, seed=1, **NETWORK))
    made.load(pit_scene())
    yield made
    made.close()


def image(result: Any) -> np.ndarray:
    return result.passes["Combined"][..., :3]


def network_of(learned: LearnedField | None) -> Snapshot:
    assert learned is not None
    return stored_network(part(learned.state, "network")).snapshot


def with_network(learned: LearnedField, data: bytes) -> LearnedField:
    return replace(learned, state=learned.state | {"network.onnx": np.frombuffer(data, np.uint8)})


def test_a_render_goes_on_from_the_network_of_another(session: Session) -> None:
    first = session.render(keep=True)
    before = network_of(first.learned)
    second = session.render(start=first.learned, keep=True)
    after = network_of(second.learned)
    assert after.version > before.version and np.array_equal(after.bounds, before.bounds)
    assert after.scale == before.scale
    assert not np.array_equal(after.parameters, before.parameters)
    # What was trained for a few dozen steps more is closer to where it began than to another beginning.
    other = Session(replace(session.settings, seed=99))
    other.load(pit_scene())
    anew = network_of(other.render(keep=True).learned)
    other.close()
    distance = np.linalg.norm(after.parameters - before.parameters)
    assert distance < 0.5 * np.linalg.norm(anew.parameters - before.parameters)


def test_the_first_sample_is_weighed_by_it(session: Session) -> None:
    learned = session.render(keep=True).learned
    session.settings = replace(session.settings, samples=1)
    started = session.render(start=learned)
    assert started.guidance is not None and started.guidance.model is not None
    anew = session.render()
    assert anew.guidance is not None and anew.guidance.model is None


def test_a_network_of_another_shape_is_left_out(session: Session) -> None:
    learned = session.render(keep=True).learned
    session.settings = replace(session.settings, samples=1, network_size="PAPER")
    result = session.render(start=learned)
    assert result.guidance is not None and result.guidance.model is None and result.report.guiding.started_from
    assert result.report.notices == []


@pytest.mark.slow
def test_the_mean_is_right_from_its_own_network(session: Session) -> None:
    """Within Z_LIMIT standard errors of renders that know nothing, eight seeds each."""
    started, anew = [], []
    for seed in range(8):
        session.settings = replace(session.settings, samples=3, seed=seed)
        first = session.render(keep=True)
        anew.append(float(image(first).mean()))
        # The same seed: the field's digest keeps them apart.
        started.append(float(image(session.render(start=first.learned)).mean()))
    assert z_score(np.array(started), np.array(anew)) < Z_LIMIT


def test_training_goes_on_from_a_snapshot() -> None:
    require_torch()
    from engine.guiding.neural.networks.radiance import TrainingSettings
    from engine.guiding.neural.worker.radiance_training import RadianceTraining

    snapshot = random_snapshot()
    training = RadianceTraining(SHAPE, TrainingSettings(), seed=3)
    training.go_on_from(snapshot)
    training.add(synthetic_rows(5000, 1))
    found = training.snapshot()
    assert found.version == snapshot.version + 1 and found.scale == snapshot.scale
    assert np.array_equal(found.bounds, BOUNDS) and np.array_equal(found.parameters, snapshot.parameters)


def test_the_file_holds_an_onnx_file(tmp_path: Path) -> None:
    data = network_to_onnx(StoredNetwork(SHAPE, random_snapshot()))
    path = tmp_path / "room.ngfield"
    save_field(path, with_network(learned_field(), data))
    with zipfile.ZipFile(path) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith("network.onnx"))
        assert archive.read(name) == data
        assert network_from_onnx(archive.read(name)).shape == SHAPE
    assert np.array_equal(network_of(load_field(path)).parameters, random_snapshot().parameters)


def test_a_file_with_a_damaged_network_is_refused(tmp_path: Path) -> None:
    data = bytearray(network_to_onnx(StoredNetwork(SHAPE, random_snapshot())))
    data[len(data) // 2] ^= 1
    path = tmp_path / "room.ngfield"
    save_field(path, with_network(learned_field(), bytes(data)))
    with pytest.raises(FieldFileError, match="network"):
        load_field(path)
    with pytest.raises(StateError, match="its network cannot be used"):
        NetworkPredictor(RenderSettings(), GuidingReport(), []).resume(
            {"onnx": np.frombuffer(bytes(data), np.uint8)}, 1
        )
