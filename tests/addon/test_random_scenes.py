# SPDX-License-Identifier: GPL-3.0-or-later
"""Random scenes render: finite, in time, without warnings, and as by Cycles unless a notice says why not.

`python -m tests.helpers.fuzz SEED` shows one of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("bpy")

from tests.helpers.fuzz.judge import judge
from tests.helpers.some_cases import has_all

SCENES_OF_A_TEST = 25
SCENES = 400 if has_all() else 75
#: Scenes whose means differ for a reason in docs/differences.md. 50: light that Cycles sends through glass of a
#: roughness of 0.93 by facets that there are not. 184: Vector Math's Modulo of a constant by zero.
EXPLAINED = {50, 184}


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize("first", range(0, SCENES, SCENES_OF_A_TEST))
def test_random_scenes(first: int, blender: Any, tmp_path: Path) -> None:
    verdicts = [
        judge(seed, tmp_path, is_explained=seed in EXPLAINED)
        for seed in range(first, first + SCENES_OF_A_TEST)
    ]
    assert {item.seed: item.problems for item in verdicts if item.problems and item.seed not in EXPLAINED} == {}
    # The test can fail: most scenes are compared, and many of them show something.
    compared = [item.theirs for item in verdicts if item.theirs is not None]
    assert sum(bool(image[..., :3].any()) for image in compared) >= SCENES_OF_A_TEST // 3
