# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders that learn, interrupted and taken up: no sample counts twice, and the mean stays."""

from collections import defaultdict
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from engine.guiding.saved.learned import LOST
from engine.render import checkpointing
from engine.render.checkpoint_file import load_checkpoint
from engine.render.render_loop import RenderLoop
from tests.helpers.interrupted import Renderer
from tests.helpers.small_scenes import pit_scene

SAMPLES = 64
#: Samples a pixel that one may have more than was asked for, each time that its render is interrupted.
MOST_MORE = 40
GUIDED = {"guiding_method": "VMM", "guiding_trial": False}
NOISE = GUIDED | {"use_adaptive_sampling": True, "adaptive_threshold": 0.03, "adaptive_min_samples": 20}
CACHED = {"guiding_method": "OFF", "radiance_cache": "CONVERGING"}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "x.ngcheckpoint"


@pytest.fixture
def seen(monkeypatch):
    """Samples that are put on the film by pixel, as ranges."""
    ranges = defaultdict(list)
    real = RenderLoop.keep_alike

    def keep_alike(loop, tasks, units, *others):
        for unit in units:
            for pixel in unit.film_index:
                ranges[int(pixel)].append((unit.sample_first, unit.sample_first + unit.sample_count))
        real(loop, tasks, units, *others)

    monkeypatch.setattr(RenderLoop, "keep_alike", keep_alike)
    return ranges


def renderer(monkeypatch, path, **settings):
    passes = {"Combined", "Variance", "Sample Count"}
    return Renderer(monkeypatch, pit_scene(size=(40, 34)), path, passes, **{"samples": SAMPLES, **settings})


def assert_same_mean(result, other):
    """By the pixels' own variances."""
    pictures = [one.passes["Combined"][..., :3].astype(np.float64) for one in (result, other)]
    variance = sum(one.passes["Variance"].astype(np.float64).sum() for one in (result, other))
    assert abs(pictures[0].sum() - pictures[1].sum()) < 4.0 * np.sqrt(3.0 * variance)


@pytest.mark.parametrize("settings", [GUIDED, CACHED, NOISE], ids=["guided", "cached", "noise threshold"])
def test_no_sample_counts_twice_and_the_mean_stays(monkeypatch, path, seen, settings):
    """Interrupted twice, by one thread: what it has put on the film by then is what is kept."""
    made = renderer(monkeypatch, path, **settings)
    whole = made.whole()
    seen.clear()
    assert made.interrupted(7).report.cancelled
    assert made.interrupted(23, resumes=True).report.cancelled
    assert (load_checkpoint(path).learned is not None) == (settings is not CACHED)
    result = made.taken_up()
    for pixel, ranges in seen.items():
        assert all(one[1] <= other[0] for one, other in pairwise(sorted(ranges))), pixel
    counts = result.passes["Sample Count"]
    # The first look is after two more than the least that each pixel gets.
    assert counts.min() >= (22 if settings is NOISE else SAMPLES) and counts.max() <= SAMPLES + 2 * MOST_MORE
    assert counts.sum() == sum(last - first for ranges in seen.values() for first, last in ranges)
    if settings is not CACHED:
        assert result.report.guiding.started_from
    assert_same_mean(result, whole)


def test_guiding_that_has_lost_is_not_tried_again(monkeypatch, path):
    made = renderer(monkeypatch, path, **GUIDED)
    made.interrupted(23)
    kept = load_checkpoint(path)
    made = renderer(monkeypatch, path, **GUIDED | {"guiding_trial": True})
    lost = replace(kept, learned=replace(kept.learned, verdict=LOST))
    lost = replace(lost, identity=replace(lost.identity, settings=lost.identity.settings | {"guiding_trial": True}))
    monkeypatch.setattr(checkpointing, "load_checkpoint", lambda _path: lost)
    result = made.taken_up()
    assert made.resumed > 0 and not made.notices
    assert not result.report.guiding.trials and result.passes["Sample Count"].min() >= SAMPLES
