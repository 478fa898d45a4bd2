# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes in files, for tests of the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest


@pytest.fixture
def blend_file(cube_scene: Any, blender: Any, tmp_path: Path) -> Path:
    """The cube in a file, with a second scene called Two and frames 3 to 6."""
    cube_scene.frame_start, cube_scene.frame_end = 3, 6
    two = cube_scene.copy()
    two.name = "Two"
    two.use_fake_user = True
    path = tmp_path / "scene.blend"
    blender.ops.wm.save_as_mainfile(filepath=str(path))
    return path
