# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: note in the lobes of surfaces by how much their shadow terminator is shifted.

The Shadow Terminator Shading Offset is an object's, and lobes are evaluated by their own normals in many places: each
lobe carries it. Scenes without one have no such stage.
"""

import numpy as np

from engine.kernels.bsdf.kinds import BUMP
from engine.kernels.prefetch import ask_for_closures, ask_for_ray, lane_ahead
from engine.runtime.jit import kernel
from engine.state.geometry import VALUE_SHADING_OFFSET


@kernel
def shift_terminator(scene, unit, work, queue):
    """Add half the offset of the object that was hit to column BUMP of its lobes, which holds no fraction before.

    Parameters
    ----------
    queue : LaneQueue
        `work.surface`, shaded.
    """
    values, paths, closures = scene.geometry.instance_values, work.paths, work.shaded
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_closures(closures, ahead)
        half_offset = np.float32(0.5) * values[paths.hit_instance[lane], VALUE_SHADING_OFFSET]
        if half_offset > 0.0:
            for i in range(closures.count[lane]):
                closures.param[lane, i, BUMP] += half_offset
