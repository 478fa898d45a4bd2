# SPDX-License-Identifier: GPL-3.0-or-later
"""What records say that light sampling brought is what it brought, not what scattering found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.guiding.models.record_sink import RowSink
from engine.guiding.records.vertices import VertexRecords
from engine.render.session import Session
from engine.scene.description import Light, SceneDescription
from engine.settings import RenderSettings
from tests.helpers.small_scenes import pit_scene

RADIUS, HEIGHT = 1.0, 3.0


class _Sink(RowSink):
    """Keeps what guided paths say of light samples."""

    def __init__(self) -> None:
        super().__init__((0.0, 1.0))
        self.found: list[np.ndarray] = []
        self.contributions: list[np.ndarray] = []

    def take(self, records: VertexRecords, row_count: int) -> None:
        self.found.append(records.light_squared[:row_count].copy())
        self.contributions.append(records.contribution_squared[:row_count].copy())


def lamp_scene() -> SceneDescription:
    """A pit of white walls around a large lamp, which paths pass and go on."""
    transform = np.eye(4, dtype=np.float32)
    transform[2, 3] = HEIGHT
    lamp = Light("lamp", "Lamp", "POINT", transform, (1.0, 1.0, 1.0), 500.0, radius=RADIUS)
    return replace(pit_scene(), lights=[lamp])


@pytest.mark.parametrize("use_nee", [False, True])
def test_lamps_that_paths_pass_are_no_gain_of_light_sampling(use_nee: bool) -> None:
    settings = RenderSettings(
        guiding_method="VMM", guiding_trial=False, samples=7, max_bounces=4, use_nee=use_nee, deterministic=True
    )
    sink = _Sink()
    session = Session(settings)
    session.load(lamp_scene())
    session.render(sink=sink)
    session.close()
    # Those of the first iteration are not guided, and nobody asks them.
    found, contributions = (np.concatenate(columns[1:]) for columns in (sink.found, sink.contributions))
    assert np.isfinite(found).all() and contributions.mean() > 0.0
    if use_nee:
        assert (found > 0.0).mean() > 0.5
    else:
        assert (found == 0.0).all()
