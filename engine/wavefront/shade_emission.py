# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: light that a surface emits towards the path that found it, holdouts, and what roulette owes."""

import math

import numpy as np

from engine.guiding.records.vertices import log_arrival
from engine.kernels.bsdf import blur_glossy
from engine.kernels.bsdf.kinds import TRANSPARENT
from engine.kernels.caustics import caster_receiver, rays_find, sends_photons_on, share_of_path
from engine.kernels.clamping import found_alone, settle_roulette
from engine.kernels.lights import (
    Receiver,
    has_blockers,
    links_shadows,
    surface_shines,
    tree_of_ray,
    triangle_emitter,
    triangle_emitter_pdf,
)
from engine.kernels.prefetch import ask_for_closures, ask_for_history, ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.radiance import add_emission, add_seen, weigh_found
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.film import FEATURE_EMISSION
from engine.state.geometry import INSTANCE_FLAG_HOLDOUT, INSTANCE_FLAGS, INSTANCE_LIGHT_GROUP
from engine.state.lanes import (
    CLOSURE_CHANNELS,
    CLOSURE_WIDTH,
    RAY_CAUSTIC,
    RAY_MIS_HAD_TRANSMISSION,
    RAY_MIS_SKIP,
    RAY_TERMINATE_AFTER_TRANSPARENT,
    RAY_TERMINATE_ON_NEXT_SURFACE,
    RAY_TRANSPARENT_BACKGROUND,
)
from engine.wavefront.columns import UNIT_USE_DENOISING, UNIT_USE_FEATURES

#: Of a sum near 1.
_LAST_BITS = np.float32(3e-7)


@kernel
def keep_transparent(closures, lane):
    """Drop every lobe but the transparent one."""
    kept = 0
    for i in range(closures.count[lane]):
        if closures.kind[lane, i] == TRANSPARENT:
            closures.kind[lane, 0] = TRANSPARENT
            for column in range(CLOSURE_WIDTH):
                closures.param[lane, 0, column] = closures.param[lane, i, column]
            kept = 1
    closures.count[lane] = kept


@kernel
def _hold_out(closures, lane):
    """Leave nothing of an object that is held out but its transparency; returns how much of it is a hole."""
    keep_transparent(closures, lane)
    if closures.count[lane] == 0:
        return np.float32(1.0)
    for c in range(CLOSURE_CHANNELS):
        closures.emission[lane, c] = 0.0
    passed = closures.transparency[lane, 0] + closures.transparency[lane, 1] + closures.transparency[lane, 2]
    return np.float32(1.0) - passed * np.float32(1.0 / 3.0)


@kernel
def _share_of_surface(scene, work, lane):
    """What a path counts of a glowing surface that photons find too."""
    paths, lights = work.paths, scene.casters.lights
    asking, cosine = caster_receiver(paths, lane, lights)
    emitter = triangle_emitter(lights, asking.tree, paths.hit_instance[lane], paths.hit_triangle[lane])
    if links_shadows(lights) and emitter >= 0 and not rays_find(lights, emitter):
        # Photons find it through what casts no shadow too.
        return np.float32(0.0)
    pdf = triangle_emitter_pdf(
        lights, scene.geometry, asking, paths.hit_instance[lane], paths.hit_triangle[lane], load(paths.direction, lane),
        paths.mis_distance[lane] + paths.hit_distance[lane], paths.time[lane],
    )
    return share_of_path(scene, work, lane, pdf, cosine)


@kernel
def shade_emission(scene, unit, work, queue):
    """Add emission with the MIS weight of having found it by scattering; then divide by the survival probability.

    Lanes flagged RAY_TERMINATE_ON_NEXT_SURFACE, and those whose holdout is complete, end here; those flagged
    RAY_TERMINATE_AFTER_TRANSPARENT keep their transparent lobe only. Recorded paths that go on note how much they have
    gathered so far.
    """
    lights, geometry, spectrum, options = scene.lights, scene.geometry, scene.spectrum, scene.options
    paths, closures, film, log = work.paths, work.closures, unit.film, work.log
    use_features = unit.header[UNIT_USE_FEATURES] != 0
    use_denoising = unit.header[UNIT_USE_DENOISING] != 0
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        ask_for_closures(closures, ahead)
        flags = paths.flags[lane]
        instance = paths.hit_instance[lane]
        if flags & RAY_TRANSPARENT_BACKGROUND:
            holdout = closures.holdout[lane]
            if geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_HOLDOUT:
                holdout = _hold_out(closures, lane)
            if holdout > 0.0:
                average = 0.0
                for c in range(len(paths.channels)):
                    average += paths.throughput[lane, c]
                paths.alpha[lane] -= holdout * average / np.float32(len(paths.channels))
                # Where holdouts sum to a little less or to more than a hole the rest is seen, as in Cycles.
                if abs(holdout - 1.0) < _LAST_BITS:
                    paths.alive[lane] = 0
                    continue
        emitted = 0.0
        for c in range(len(paths.channels)):
            emitted = max(emitted, abs(closures.emission[lane, c]))
        if emitted > 0.0 and surface_shines(lights, flags, instance):
            weight = np.float32(1.0)
            unguided, caustic = found_alone(paths.unguided[lane]), np.float32(1.0)
            if flags & RAY_CAUSTIC:
                caustic = _share_of_surface(scene, work, lane)
            if options.use_nee != 0 and not flags & RAY_MIS_SKIP:
                receiver = Receiver(
                    load(paths.mis_origin, lane), load(paths.mis_normal, lane),
                    (flags & RAY_MIS_HAD_TRANSMISSION) != 0, False, tree_of_ray(lights, flags),
                )  # fmt: skip
                pdf = triangle_emitter_pdf(
                    lights, geometry, receiver, instance, paths.hit_triangle[lane], load(paths.direction, lane),
                    paths.mis_distance[lane] + paths.hit_distance[lane], paths.time[lane],
                )
                if pdf > 0.0:
                    emitter = triangle_emitter(lights, receiver.tree, instance, paths.hit_triangle[lane])
                    weight, unguided = weigh_found(options, lights, paths, lane, emitter, False, pdf)
                    if has_blockers(lights, emitter):
                        weight = np.float32(0.0)
            share = add_emission(
                options, spectrum, paths, work.passes, lane, closures.emission, caustic * weight, unguided,
                geometry.instance_table[instance, INSTANCE_LIGHT_GROUP], film, FEATURE_EMISSION, use_features,
            )
            if use_denoising:
                add_seen(spectrum, paths, work.features, lane, closures.emission, share, film)
        if flags & RAY_TERMINATE_ON_NEXT_SURFACE:
            paths.alive[lane] = 0
            continue
        if flags & RAY_TERMINATE_AFTER_TRANSPARENT:
            keep_transparent(closures, lane)
            if closures.count[lane] == 0:
                paths.alive[lane] = 0
                continue
        if log.is_recording[lane] != 0:
            log_arrival(log, paths, lane)
        settle_roulette(paths, lane)
        if options.filter_glossy > 0.0:
            # Cycles' Filter Glossy: behind a blurry bounce lobes are made at least this rough, to tame caustics.
            blur = paths.min_pdf[lane] / options.filter_glossy
            # Where there are photons, lobes that send them on stay sharp: photons know nothing of blurring.
            if blur < 1.0 and (options.blurs_delta != 0 or not sends_photons_on(closures, lane)):
                blur_glossy(closures, lane, math.sqrt(1.0 - blur) * 0.5, options.blurs_delta)
