# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages of light that Fast GI adds: diffuse surfaces receive it from where nothing near hides the sky.

It is white, whatever the world shows, and comes on top of all other light, at every bounce. As in Cycles the picture
has it, and no other pass.
"""

import numpy as np

from engine.runtime.jit import kernel
from engine.wavefront.columns import SHADOW_ROWS
from engine.wavefront.hemisphere_rays import (
    aim_ray,
    diffuse_normal,
    diffuse_weight,
    hidden_share,
    mean_hidden_share,
)

#: Bit of `LightPassLanes.is_open` while a lane's ray is under way.
_IS_AIMED = 4


@kernel
def aim_added_light(scene, unit, work, queue):
    """Queue a ray for every surface that has diffuse lobes; what it brings is those lobes' weight times the light.

    Cycles clamps the ray's light before the weight, which `ShadowRays.own` makes up for.

    Parameters
    ----------
    queue : LaneQueue
        `work.surface`.
    """
    added, paths, closures, shadows = scene.options.added_light, work.paths, work.closures, work.shadows
    passes, has_parts = work.passes, work.passes.parts.shape[0] > 0
    lanes, lane_count = queue.lanes, queue.count[0]
    row = 0
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0:
            continue
        mean = mean_hidden_share(work.shaded, lane)
        total = weighted = np.float32(0.0)
        for c in range(len(paths.channels)):
            value = paths.throughput[lane, c] * hidden_share(paths, work.shaded, lane, c, mean)
            total += abs(value)
            value *= added * diffuse_weight(closures, lane, c)
            weighted += abs(value)
            shadows.radiance[row, c] = value
        if not weighted > 0.0:
            continue
        aim_ray(scene, work, lane, row, diffuse_normal(work.shaded, work.points, lane))
        shadows.own[row] *= total / weighted
        if has_parts:
            passes.is_open[lane] |= _IS_AIMED
        row += 1
    work.counts[SHADOW_ROWS] = row


@kernel
def leave_added_light(scene, unit, work, queue):
    """Let the paths' light be taken apart again."""
    passes = work.passes
    for row in range(work.counts[SHADOW_ROWS]):
        passes.is_open[work.shadows.lane[row]] &= ~_IS_AIMED
