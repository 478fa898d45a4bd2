# SPDX-License-Identifier: GPL-3.0-or-later
"""The stand-in surface that programs run on at compile time."""

from __future__ import annotations

from numba import typeof

from engine.builder.scene import SceneCache, build_scene
from engine.settings import RenderSettings
from engine.shaders.folding import stand_in_geometry
from tests.helpers.small_scenes import corner_scene


def test_the_stand_in_is_of_the_types_of_scenes() -> None:
    """Else the interpreter is compiled once more for it: a minute of each first render."""
    built = build_scene(corner_scene(), RenderSettings(), SceneCache())
    assert typeof(stand_in_geometry(1)) == typeof(built.geometry)
