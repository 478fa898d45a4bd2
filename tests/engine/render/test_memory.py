# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory of renders that are over is the system's again, in a process that renders many of them."""

from __future__ import annotations

import gc
import sys
import weakref
from pathlib import Path

import numpy as np
import pytest

from engine.render.batch import Batch
from engine.render.session import Session
from engine.runtime import heap
from engine.scene.limits import resident_memory
from engine.settings import RenderSettings
from tests.helpers.small_scenes import corner_scene

linux = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads /proc")


def render(seed: int) -> None:
    session = Session(RenderSettings(samples=8, threads=4, guiding_method="VMM", guiding_trial=False, seed=seed))
    session.load(corner_scene(size=(96, 64)))
    session.render()
    session.close()


def test_nothing_of_a_render_waits_for_the_garbage_collector(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numba's objects are so many that it seldom looks at all of them."""
    batches: list[weakref.ref[Batch]] = []
    begin = Batch.__init__

    def remember(self: Batch, *args: object, **named: object) -> None:
        begin(self, *args, **named)  # type: ignore[arg-type]
        batches.append(weakref.ref(self))

    monkeypatch.setattr(Batch, "__init__", remember)
    gc.collect()
    gc.disable()
    try:
        render(0)
        assert len(batches) == 4
        assert [batch() for batch in batches] == [None] * 4
    finally:
        gc.enable()


@linux
def test_memory_does_not_grow_with_the_number_of_guided_renders() -> None:
    # What the last renders held goes back one or two later, sooner or later as the machine is busy: memory goes up and
    # down. What is never given back raises all of the least, the middle and the most.
    held = []
    for _ in range(3):
        after = []
        for seed in range(24):
            render(seed)
            after.append(resident_memory())
        held.append(np.quantile(after, [0.0, 0.5, 1.0]))
    assert (held[2] - held[1]).min() < 40 << 20


@linux
@pytest.mark.skipif(sys.platform != "linux", reason="the C library of others gives back by itself")
def test_free_memory_below_what_is_used_goes_back() -> None:
    held = [np.ones(4 << 10, np.float32) for _ in range(1 << 12)]  # too small for mappings of their own
    last = held[-1]
    full = resident_memory()
    del held
    heap.give_back()
    assert full - resident_memory() > 40 << 20
    assert last.all()
