# SPDX-License-Identifier: GPL-3.0-or-later
"""What shadow rays skip that start or end in place."""

from engine.accel.skipped_triangles import end_on, go_on_behind, start_on
from engine.kernels.surface import starts_in_place
from engine.runtime.jit import kernel
from engine.state.lanes import LIGHT_ENDS_IN_PLACE, RAY_SHADOW_IN_PLACE
from engine.state.lights import EMITTER_INSTANCE, EMITTER_TRIANGLE


@kernel
def _name_light(scene, work, lane, instance):
    """Say that the shadow ray of a lane skips its light too, if it ends there in place.

    Returns
    -------
    bool
        Whether it skips any; `instance` -1: it starts on nothing that it skips.
    """
    emitters, bits, samples = scene.lights.emitters, work.ray_bits, work.samples
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
    instance = paths.hit_instance[lane] if is_in_place else -1
    start_on(work.ray_bits, scene.geometry, instance, paths.hit_triangle[lane])
    return _name_light(scene, work, lane, instance)


@kernel
def name_passed(scene, work, lane, instance, triangle):
    """Say that the shadow ray of a lane goes on in place behind a triangle, if rays start in place on it.

    Returns
    -------
    bool
        Whether it skips any.
    """
    instance = instance if starts_in_place(scene.geometry, instance) else -1
    go_on_behind(work.ray_bits, scene.geometry, instance, triangle)
    return _name_light(scene, work, lane, instance)
