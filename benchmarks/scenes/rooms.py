# SPDX-License-Identifier: GPL-3.0-or-later
"""A whole room, hard in its lighting: what the small scenes are not."""

from __future__ import annotations

from benchmarks.scenes.registry import scene


@scene("evening-room", samples=256)
def evening_room() -> None:
    """The demo's room, whose lamps are all out of sight."""
    import bpy

    import addon
    from demo.build_scene import build

    addon.register()
    build(256, 144)
    cycles = bpy.context.scene.cycles
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = 12
    cycles.sample_clamp_indirect = 0.0
