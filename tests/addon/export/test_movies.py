# SPDX-License-Identifier: GPL-3.0-or-later
"""Movies of texture nodes: which frame they show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from benchmarks.scenes.movie_files import write_movie  # noqa: E402
from tests.helpers.blender_scenes import empty_scene, export  # noqa: E402


def test_movies_follow_the_frame(tmp_path: Path) -> None:
    frames = np.zeros((3, 2, 5, 3), np.uint8)
    frames[:] = np.array([10, 20, 30])[:, None, None, None]
    frames[:, 1, 4] = (40, 50, 60)
    write_movie(tmp_path / "movie.avi", frames)
    empty_scene()
    world = bpy.context.scene.world = bpy.data.worlds.new("World")
    world.use_nodes = True
    node = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    world.node_tree.links.new(node.outputs[0], world.node_tree.nodes["Background"].inputs[0])
    node.image = bpy.data.images.load(str(tmp_path / "movie.avi"))
    user = node.image_user
    user.frame_duration, user.frame_start = 3, 5

    def value(frame: int) -> int:
        bpy.context.scene.frame_set(frame)
        description = export()
        (exported,) = description.images
        assert not description.notices
        assert (exported.encoding, exported.name) == ("SRGB", "movie.avi")
        assert exported.pixels[1, 4].tolist() == [40, 50, 60, 255]
        return int(exported.pixels[0, 0, 0])

    assert [value(frame) for frame in (1, 5, 6, 7, 9)] == [10, 10, 20, 30, 30]
    user.use_cyclic = True
    assert [value(frame) for frame in (4, 8, 9)] == [30, 10, 20]
    user.use_cyclic, user.frame_offset = False, 1
    assert [value(frame) for frame in (5, 6, 7)] == [20, 30, 30]
    assert len(bpy.data.images) == 1 and not bpy.data.textures
