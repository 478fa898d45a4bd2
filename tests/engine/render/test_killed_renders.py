# SPDX-License-Identifier: GPL-3.0-or-later
"""A hundred renders killed at random moments: nothing is lost but what no checkpoint had, and no picture is wrong."""

from __future__ import annotations

import math
import os
import random
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.render.checkpoint_file import load_checkpoint
from tests.helpers.killed_renders import CHECKPOINT, FINISHED, RESUMED, WHOLE, KilledRenders

posix = pytest.mark.skipif(os.name != "posix", reason="signals")
#: Checkpoints that a render writes at most before it is killed.
LONGEST = 4.0
PLAIN = {"guiding_method": "OFF", "radiance_cache": "OFF", "samples": 600}
THRESHOLD = {"use_adaptive_sampling": True, "adaptive_threshold": 0.004, "adaptive_min_samples": 16}
NOISE = PLAIN | THRESHOLD | {"samples": 1500}
GUIDED = {"guiding_method": "VMM", "guiding_trial": False, "radiance_cache": "OFF", "samples": 300}


def kept_paths(path: Path) -> int:
    """Paths of the checkpoint, of which every byte is right; 0: there is none."""
    if not path.exists():
        return 0
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
    return load_checkpoint(path).state.path_count


def assert_same_bits(resumed: dict[str, Any], whole: dict[str, Any]) -> None:
    assert resumed.keys() == whole.keys()
    for name, picture in whole.items():
        assert np.array_equal(resumed[name], picture), name


def assert_same_mean(resumed: dict[str, Any], whole: dict[str, Any]) -> None:
    """By the pixels' own variances."""
    pictures = [one["Combined"][..., :3].astype(np.float64) for one in (resumed, whole)]
    variance = sum(one["Variance"].astype(np.float64).sum() for one in (resumed, whole))
    assert abs(pictures[0].sum() - pictures[1].sum()) < 5.0 * np.sqrt(3.0 * variance)
    assert resumed["Sample Count"].min() >= GUIDED["samples"]


def kill(renders: KilledRenders, kills: int, seed: int, check: Callable[[Any, Any], None]) -> None:
    """Kill frames so often, one after the other; the last of them is rendered to its end after that."""
    moments, path, whole = random.Random(seed), renders.folder / CHECKPOINT, renders.passes(WHOLE)
    killed = resumed = kept = 0
    is_over = False
    while not is_over:
        is_over = killed >= kills
        fate = renders.render(math.inf if is_over else LONGEST * moments.random())
        assert fate.orphans == 0
        before, kept = kept, kept_paths(path)
        killed, resumed = killed + fate.was_killed, resumed + (before > 0)
        if fate.announced != FINISHED:
            assert fate.was_killed and kept >= max(before, fate.announced)
            continue
        check(renders.passes(RESUMED), whole)
        if not fate.was_killed:
            assert sorted(item.name for item in renders.folder.iterdir()) == [RESUMED, WHOLE]
    assert resumed > kills / 4, "most of them are to go on from what was kept"


@posix
@pytest.mark.parametrize(
    ("settings", "check", "kills"),
    [
        pytest.param(PLAIN, assert_same_bits, 5, id="some"),
        pytest.param(PLAIN, assert_same_bits, 40, id="plain", marks=pytest.mark.slow),
        pytest.param(NOISE, assert_same_bits, 40, id="noise threshold", marks=pytest.mark.slow),
        pytest.param(GUIDED, assert_same_mean, 20, id="guided", marks=pytest.mark.slow),
    ],
)
def test_killed_renders_go_on(tmp_path: Path, settings: Any, check: Any, kills: int) -> None:
    renders = KilledRenders(tmp_path, **settings)
    kill(renders, kills, kills, check)
    renders.close()
