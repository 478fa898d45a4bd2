# SPDX-License-Identifier: GPL-3.0-or-later
"""What shadow rays skip that start or end in place."""

from engine.accel.skipped_triangles import end_on, start_on
from engine.kernels.surface import starts_in_place
from engine.runtime.jit import kernel
from engine.state.lanes import LIGHT_ENDS_IN_PLACE, RAY_SHADOW_IN_PLACE
from engine.state.lights import EMITTER_INSTANCE, EMITTER_TRIANGLE


@kernel
def _name(scene, work, lane, instance, triangle):
    """Say what the shadow ray of a lane skips: a triangle, instance -1: none, and that of its light if it ends there.

    Returns
    -------
    bool
        Whether it skips any.
    """
    emitters, bits, samples = scene.lights.emitters, work.ray_bits, work.samples
    start_on(bits, scene.geometry, instance, triangle)
    if not work.paths.flags[lane] & RAY_SHADOW_IN_PLACE:
        return instance >= 0
    if samples.flags[lane] & LIGHT_ENDS_IN_PLACE:
        emitter = samples.emitter[lane]
        end_on(bits, scene.geometry, emitters[emitter, EMITTER_INSTANCE], emitters[emitter, EMITTER_TRIANGLE])
    return True


@kernel
def name_ends(scene, work, lane):
    """Say which triangles the shadow ray of a lane starts and ends on, if that is in place; returned: whether it is."""
    paths = work.paths
    is_in_place = paths.flags[lane] & RAY_SHADOW_IN_PLACE != 0
    return _name(scene, work, lane, paths.hit_instance[lane] if is_in_place else -1, paths.hit_triangle[lane])


@kernel
def name_passed(scene, work, lane, instance, triangle):
    """Say that the shadow ray of a lane goes on in place behind a triangle, if rays start in place on it.

    Returns
    -------
    bool
        Whether it skips any.
    """
    return _name(scene, work, lane, instance if starts_in_place(scene.geometry, instance) else -1, triangle)
