# SPDX-License-Identifier: GPL-3.0-or-later
"""More lamps with blockers of their own than collections that fit the lowest bits of a ray's mask."""

from __future__ import annotations

import math

import bpy

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import add_object, box, diffuse, light, stage, world


@scene("linked-shadows-many")
def shadows_many() -> None:
    """Ten lamps around posts, in the light of each of which other posts cast no shadows."""
    stage()
    world((0.02, 0.02, 0.03))
    posts = []
    for number in range(5):
        place = (0.7 * (number - 2), 0.3 * (number % 2), 0.6)
        posts.append(add_object("post", box("post", diffuse((0.7, 0.6, 0.5)), (0.25, 0.25, 1.2)), place))
    for number in range(10):
        turn = 2.0 * math.pi * number / 10
        color = [0.55 + 0.45 * math.cos(turn - 2.1 * channel) for channel in range(3)]
        place = (3.0 * math.cos(turn), 2.5 * math.sin(turn), 2.2)
        lamp = light("POINT", 40.0, place, color=color, shadow_soft_size=0.1)
        left_out = bpy.data.collections.new(f"of lamp {number}")
        for post in {number % 5, (number + 2) % 5 if number >= 5 else number % 5}:
            left_out.objects.link(posts[post])
        for entry in left_out.collection_objects:
            entry.light_linking.link_state = "EXCLUDE"
        lamp.light_linking.blocker_collection = left_out
