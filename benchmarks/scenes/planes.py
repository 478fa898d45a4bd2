# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes without extent along an axis."""

from __future__ import annotations

import numpy as np

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import HEIGHT, WIDTH, add_object, camera, diffuse, image, quad, resolution, world_nodes


@scene("fail-plane", samples=128)
def plane() -> None:
    """Everything in one plane: positions have no extent along an axis. No faces overlap, which would be black."""
    resolution(WIDTH, HEIGHT)
    for index in range(2):
        floor = quad(f"Floor {index}", diffuse((0.7, 0.6, 0.5), f"floor {index}"), 6.0, 3.0)
        add_object(f"Floor {index}", floor, (0.0, 3.0 * index - 1.5, 0.0))
    rows, columns = np.mgrid[0:32, 0:64]
    pixels = np.full((32, 64, 4), 0.2, np.float32)
    pixels[(rows > 18) & (rows < 26) & (columns > 38) & (columns < 46), :3] = (5.0, 4.0, 3.0)
    sky = image("Sky", pixels, is_float=True, colorspace="Linear Rec.709")
    sky_world = world_nodes(
        lambda nodes: nodes("Background", Color=nodes("TexEnvironment", {"image": sky}, Vector=nodes("TexCoord")))
    )
    # No light samples: there is nothing else to learn on a plane.
    sky_world.cycles.sampling_method = "NONE"
    camera((0.0, -3.0, 2.4), (0.0, 0.0, 0.0), 50.0)
