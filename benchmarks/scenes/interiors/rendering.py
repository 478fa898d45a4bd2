# SPDX-License-Identifier: GPL-3.0-or-later
"""How rooms are rendered."""

from __future__ import annotations

import bpy


def set_up(
    scene: bpy.types.Scene, size: tuple[int, int], samples: int, *, bounces: int, clamp_indirect: float, exposure: float
) -> None:
    """Settings that both engines go by, of NEURALGUIDE, which must be registered; `exposure` is that of the view."""
    render, cycles = scene.render, scene.cycles
    render.engine = "NEURALGUIDE"
    (render.resolution_x, render.resolution_y), render.resolution_percentage = size, 100
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = samples, False, False
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = bounces
    cycles.sample_clamp_indirect = clamp_indirect
    scene.view_settings.look = "AgX - Medium High Contrast"
    scene.view_settings.exposure = exposure
