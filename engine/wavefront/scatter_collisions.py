# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages around light sampling at collisions with media: set up the points, and send paths on by the phase functions.

Between the two, collisions lie behind the surfaces in `work.surface`, so that one pass over all of them samples lights.
"""

import math

from engine.guiding.records.vertices import Scattering, log_collision
from engine.kernels.bsdf.phase import (
    PHASE_ALPHA,
    PHASE_DELTA,
    PHASE_G,
    add_phase,
    eval_phases,
    phase_roughness,
    sample_phases,
)
from engine.kernels.clamping import settle_roulette
from engine.kernels.collision import add_uniform_lobes, place_collision, scatter_throughput, set_lobes, share_out
from engine.kernels.constants import NAN
from engine.kernels.path import leave_collision, real_3
from engine.kernels.rng import SETS_PER_VERTEX
from engine.kernels.spectrum import to_rgb
from engine.runtime.jit import kernel
from engine.state.film import DENOISING_ALBEDO, DENOISING_NORMAL
from engine.state.lanes import CLOSURE_SAMPLE_WEIGHT, CLOSURE_WEIGHT, FEATURES_DONE, POINT_WO, RGB
from engine.wavefront.columns import SCENE_HAS_VARYING_MEDIA, UNIT_GUIDES_MEDIA, UNIT_SPLITS_LIGHT, UNIT_USE_DENOISING


@kernel
def _set_chosen_lobes(scene, work, lane):
    """Set the closures to the phase functions of the medium that a tracked path has collided with."""
    closures, found, arrays = work.closures, work.light_closures, scene.media
    medium = work.media.medium[lane, work.tracking.chosen[lane]]
    closures.count[lane] = 0
    closures.flags[lane] = 0
    if arrays.program[medium] >= 0:
        for source in range(found.count[lane]):
            param = found.param
            i = add_phase(
                closures, lane, param[lane, source, CLOSURE_SAMPLE_WEIGHT], param[lane, source, PHASE_G],
                param[lane, source, PHASE_ALPHA], param[lane, source, PHASE_DELTA],
            )
            if i >= 0:
                for c in range(RGB):
                    closures.param[lane, i, CLOSURE_WEIGHT + c] = param[lane, source, CLOSURE_WEIGHT + c]
    else:
        add_uniform_lobes(arrays, closures, lane, medium)
    share_out(closures, lane)


@kernel
def _write_denoising(scene, unit, work, lane):
    """Let denoisers see the medium that the camera sees: what it scatters as albedo, a normal that faces the camera."""
    through, film, paths = work.features.throughput, unit.film.denoising, work.paths
    if through[lane, 0] == FEATURES_DONE:
        return
    pixel = paths.pixel[lane]
    color = to_rgb(scene.spectrum, paths, lane, paths.throughput, lane)
    seen = (through[lane, 0] * color[0], through[lane, 1] * color[1], through[lane, 2] * color[2])
    through[lane, 0] = FEATURES_DONE
    if not math.isfinite(seen[0] + seen[1] + seen[2]):
        return
    for c in range(RGB):
        film[pixel, DENOISING_ALBEDO + c] += seen[c]
    film[pixel, DENOISING_NORMAL + 2] -= 1.0


@kernel
def prepare_collisions(scene, unit, work, queue):
    """Set up points and closures of collisions, and append them to `work.surface`.

    Parameters
    ----------
    queue : LaneQueue
        `work.collided`.
    """
    paths, points, closures, media = work.paths, work.points, work.closures, work.media
    samples, guided = work.samples, work.guided
    use_denoising, splits_light = unit.header[UNIT_USE_DENOISING] != 0, unit.header[UNIT_SPLITS_LIGHT] != 0
    varies = scene.header[SCENE_HAS_VARYING_MEDIA] != 0
    lanes, lane_count = queue.lanes, queue.count[0]
    surface, surface_count = work.surface.lanes, work.surface.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        settle_roulette(paths, lane)
        place_collision(paths, points, lane, paths.hit_distance[lane])
        if varies and work.tracking.is_tracked[lane] != 0:
            _set_chosen_lobes(scene, work, lane)
        else:
            set_lobes(scene, closures, media, lane)
        guided.rough_share[lane] = 0.0
        # Where the whole segment has been lit, its light is not looked for again.
        samples.weight[lane] = 0.0 if media.is_lit[lane] != 0 else 1.0
        samples.guide_pdf[lane] = 0.0
        samples.bsdf_share[lane] = 1.0
        if use_denoising:
            _write_denoising(scene, unit, work, lane)
        if splits_light and paths.depth[lane] == 0:
            work.passes.is_volume[lane] = 1
        surface[surface_count] = lane
        surface_count += 1
    work.surface.count[0] = surface_count


@kernel
def scatter_collisions(scene, unit, work, queue):
    """Send paths on from collisions by the phase functions, and take them from `work.surface` again.

    Those that `guide_collisions` has sent on are gone by now. Recorded paths make records of them, if they are to be
    guided by these.

    Parameters
    ----------
    queue : LaneQueue
        `work.collided`.
    """
    options, paths, points, closures, f_cos = scene.options, work.paths, work.points, work.closures, work.f_cos
    log, media, guides_media = work.log, work.media, unit.header[UNIT_GUIDES_MEDIA] != 0
    lanes, lane_count = queue.lanes, queue.count[0]
    work.surface.count[0] -= lane_count
    for k in range(lane_count):
        lane = lanes[k]
        work.samples.weight[lane] = 1.0
        wo = real_3(points, lane, POINT_WO)
        wi = sample_phases(closures, lane, wo, paths.random[lane, 0], paths.random[lane, 1], paths.random[lane, 2])
        pdf = eval_phases(closures, lane, wo, wi, f_cos, lane)
        if not pdf > 0.0 or not scatter_throughput(paths, lane, f_cos, 1.0 / pdf) > 0.0:
            paths.alive[lane] = 0
            continue
        paths.survival[lane] = -1.0
        paths.dimension[lane] += SETS_PER_VERTEX
        if log.is_recording[lane] != 0:
            # A roughness of 0 makes no record.
            roughness = phase_roughness(closures, lane) if guides_media else 0.0
            scattering = Scattering(wi, pdf, roughness, 1.0, NAN, NAN, NAN)
            log_collision(log, paths, points, closures, work.samples, lane, scattering, f_cos)
        leave_collision(options, scene.lights, paths, points, media, lane, wi, pdf, pdf)
