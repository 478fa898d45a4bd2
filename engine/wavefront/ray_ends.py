# SPDX-License-Identifier: GPL-3.0-or-later
"""What shadow rays skip: the triangles they start and end on."""

from engine.accel import end_on, start_on
from engine.runtime.jit import kernel
from engine.state.lights import EMITTER_INSTANCE, EMITTER_TRIANGLE


@kernel
def name_ends(scene, work, row):
    """Say which triangles a shadow ray starts and ends on: it skips these, and no others."""
    paths, shadows, emitters, bits = work.paths, work.shadows, scene.lights.emitters, work.ray_bits
    lane, emitter = shadows.lane[row], shadows.emitter[row]
    instance = paths.hit_instance[lane] if shadows.starts_on[row] else -1
    start_on(bits, scene.geometry, instance, paths.hit_triangle[lane])
    if emitter >= 0:
        end_on(bits, scene.geometry, emitters[emitter, EMITTER_INSTANCE], emitters[emitter, EMITTER_TRIANGLE])
