# SPDX-License-Identifier: GPL-3.0-or-later
"""What paths record once nothing is guided."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from engine.guiding.models.light_selection import LightSelectionModel
from engine.guiding.policy.recording import UnguidedRecording
from engine.guiding.policy.request import NOTHING_ASKED
from engine.guiding.policy.rules import RULES
from engine.guiding.records.vertices import allocate_vertex_records
from engine.settings import RenderSettings

WEIGHTS = np.full(16, 3.0, np.float32)


@pytest.mark.parametrize("after_guiding", [False, True])
def test_lights_are_learned_by_what_they_bring_to_pixels(after_guiding: bool) -> None:
    facts: Any = SimpleNamespace(
        settings=RenderSettings(samples=64), unit_pixels=16, rules=RULES, request=NOTHING_ASKED,
        report=SimpleNamespace(record_count=0),
    )
    lights: Any = SimpleNamespace(pays=True)
    iteration: Any = SimpleNamespace(next_sample=8, next_range=(8, 8), image=SimpleNamespace(weights=WEIGHTS))
    agenda: Any = SimpleNamespace(challenger=None, way=SimpleNamespace(ends_by_learned=False))
    recording = UnguidedRecording(facts, 16, lights, None, after_guiding=after_guiding)
    guidance = recording.next(iteration, agenda)
    assert not recording.is_over and guidance.record_threshold > 0
    np.testing.assert_array_equal(guidance.pixel_weight, WEIGHTS)


def test_records_without_a_weight_make_regions_forget_their_lights() -> None:
    """Why it matters: what brings nothing is no contribution, and what was known fades."""
    regions: Any = SimpleNamespace(inherited=lambda values, share: values)
    records = allocate_vertex_records(64)
    records.light_cluster[:], records.light_pmf[:], records.tree_pmf[:] = 0, 0.5, 0.5
    leaf = np.zeros(64, np.int32)
    models = []
    for squared in (1.0, 0.0):
        model = LightSelectionModel(np.ones(2, bool))
        records.light_squared[:] = 1.0
        model.update(regions, records, leaf)
        records.light_squared[:] = squared
        model.update(regions, records, leaf)
        models.append(model)
    weighed, forgotten = models
    assert weighed.known[0] > 64.0 > forgotten.known[0]
