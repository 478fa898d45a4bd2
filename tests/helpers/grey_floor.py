# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene of Blender's with a grey floor that fills the picture, and no light."""

from __future__ import annotations

from typing import Any

from benchmarks.scenes import studio


def open_grey_floor(blender: Any, width: int, height: int) -> Any:
    """The open scene: the floor, seen from 2 m above, by a picture of that size."""
    blender.ops.wm.read_homefile(use_empty=True)
    studio.resolution(width, height)
    studio.world((0.0, 0.0, 0.0))
    studio.add_object("Floor", studio.quad("Floor", studio.diffuse((0.5, 0.4, 0.3)), 8.0, 8.0))
    studio.camera((0.0, -0.5, 2.0), (0.0, 0.0, 0.0), 50.0)
    return blender.context.scene
