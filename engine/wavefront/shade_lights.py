# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: light of lamps that a ray crosses before its closest surface, and of suns where it leaves the scene.

Lamps do not stop rays: each one crossed adds its light. As in Cycles, camera rays see the lamps that are visible to the
camera, other rays only those with multiple importance sampling; suns without it are never seen. Those whose emission
a program tells have stages of their own (`varying_lamps.py`).
"""


from engine.kernels.clamping import found_alone
from engine.kernels.constants import DISTANT
from engine.kernels.lights import (
    Receiver,
    distant_lamp_is_hit,
    distant_lamp_leaving,
    distant_lamp_pdf,
    is_seen_by,
    lamp_emitter,
    lamp_hit,
    lamp_is_hidden,
    lamp_leaving,
    lamp_pdf,
    lamp_shines,
    tree_of_ray,
)
from engine.kernels.prefetch import ask_for_history, ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.radiance import weigh_found
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.lanes import (
    RAY_CAMERA,
    RAY_CAUSTIC,
    RAY_MIS_HAD_TRANSMISSION,
    RAY_MIS_SKIP,
)
from engine.state.lights import (
    HEADER_FIRST_DISTANT,
    HEADER_HITTABLE,
    HEADER_LAST_DISTANT,
    LAMP_FLAG_MIS,
    LAMP_FLAGS,
    LAMP_PROGRAM,
    LAMP_VISIBILITY,
)
from engine.wavefront.found_lamps import add_lamp, share_of_lamp, write_lamp_radiance


@kernel
def shade_lights(scene, unit, work, queue):
    """Add the light of lamps and suns to rays that `intersect_closest` has traced, MIS-weighted.

    The hit and its density are found from `mis_origin`, where the light sample they are weighed against was drawn;
    transparent surfaces since then only move the range of distances (`mis_distance`, `hit_distance`). Without
    light sampling (`use_nee` 0) every lamp counts whole, those without multiple importance sampling included.
    """
    lights, options, paths = scene.lights, scene.options, work.paths
    lanes, lane_count = queue.lanes, queue.count[0]
    hittable_count = lights.header[HEADER_HITTABLE]
    first_distant, last_distant = lights.header[HEADER_FIRST_DISTANT], lights.header[HEADER_LAST_DISTANT]
    if hittable_count == 0 and first_distant == last_distant:
        return
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        flags = paths.flags[lane]
        is_camera = flags & RAY_CAMERA
        counts_whole = options.use_nee == 0 or (flags & RAY_MIS_SKIP) != 0
        had_transmission = (flags & RAY_MIS_HAD_TRANSMISSION) != 0
        origin, wi = load(paths.mis_origin, lane), load(paths.direction, lane)
        tree = tree_of_ray(lights, flags)
        receiver = Receiver(origin, load(paths.mis_normal, lane), had_transmission, False, tree)
        t_min = paths.mis_distance[lane]
        # Media may go on behind the end of a short ray.
        t_max = min(t_min + paths.hit_distance[lane], paths.reach[lane])
        for row in range(hittable_count):
            if not (lights.lamp_table[row, LAMP_FLAGS] & LAMP_FLAG_MIS or is_camera or options.use_nee == 0):
                continue
            if lights.lamp_table[row, LAMP_PROGRAM] >= 0:
                # `meet_varying_lamps` does that.
                continue
            if not is_seen_by(flags, lights.lamp_table[row, LAMP_VISIBILITY]) or not lamp_shines(lights, flags, row):
                continue
            if options.use_nee != 0 and not is_camera and lamp_is_hidden(lights, row):
                continue
            distance = lamp_hit(lights, row, origin, wi, t_min, t_max)
            if distance < 0.0:
                continue
            factor = lamp_leaving(lights, row, origin, wi)
            if not factor > 0.0:
                continue
            unguided = found_alone(paths.unguided[lane])
            if flags & RAY_CAUSTIC:
                factor *= share_of_lamp(scene, work, lane, row, wi, distance)
            if not counts_whole:
                pdf = lamp_pdf(lights, row, receiver, wi, distance)
                emitter = lamp_emitter(lights, tree, row)
                weight, unguided = weigh_found(options, lights, paths, lane, emitter, False, pdf)
                factor *= weight
            write_lamp_radiance(scene, paths, lane, row, factor, work.f_cos, lane)
            add_lamp(scene, unit, work, lane, row, distance - t_min, unguided)
        if first_distant == last_distant or paths.hit_instance[lane] >= 0:
            continue
        for row in range(first_distant, last_distant):
            if not (lights.lamp_table[row, LAMP_FLAGS] & LAMP_FLAG_MIS or options.use_nee == 0):
                continue
            if lights.lamp_table[row, LAMP_PROGRAM] >= 0:
                continue
            if not is_seen_by(flags, lights.lamp_table[row, LAMP_VISIBILITY]) or not lamp_shines(lights, flags, row):
                continue
            if options.use_nee != 0 and lamp_is_hidden(lights, row):
                # As in Cycles, not even the camera sees it.
                continue
            if not distant_lamp_is_hit(lights, row, origin, wi, t_min):
                continue
            factor = distant_lamp_leaving(lights, row, origin, wi)
            unguided = found_alone(paths.unguided[lane])
            if flags & RAY_CAUSTIC:
                factor *= share_of_lamp(scene, work, lane, row, wi, DISTANT)
            if not counts_whole:
                pdf = distant_lamp_pdf(lights, row, receiver, wi)
                emitter = lamp_emitter(lights, tree, row)
                weight, unguided = weigh_found(options, lights, paths, lane, emitter, False, pdf)
                factor *= weight
            write_lamp_radiance(scene, paths, lane, row, factor, work.f_cos, lane)
            add_lamp(scene, unit, work, lane, row, DISTANT, unguided)
