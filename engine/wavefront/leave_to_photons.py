# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: leave to photons their share of the light samples that paths take at casters.

At a surface of sharp lobes which are no delta a path finds a lamp in two ways: it may hit it, or sample it. Photons
that have begun there find the same light, and are weighed against both (`engine.kernels.caustics`).
"""

import numpy as np

from engine.kernels.caster_pieces import start_at
from engine.kernels.caustics import (
    rays_find,
    receiver_on_caster,
    sends_photons_on,
    share_beside_photons,
    share_of_scattering,
)
from engine.kernels.lights import any_lamp_pdf, background_pdf, tree_of_receiver, triangle_emitter_pdf
from engine.kernels.path import real_3
from engine.kernels.photon_motion import density_of_start
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.lanes import LIGHT_USES_MIS, POINT_NS, POINT_P, RAY_GATHERED
from engine.state.lights import (
    EMITTER_INSTANCE,
    EMITTER_KIND,
    EMITTER_LAMP,
    EMITTER_TRIANGLE,
    LIGHT_BACKGROUND,
    LIGHT_TRIANGLE,
)
from engine.state.photons import MAP_RADIUS


@kernel
def _pdf_of_photons(lights, geometry, asking, emitter, wi, distance, time):
    """Density with which a photon's light sample would have been this one [sr^-1].

    Parameters
    ----------
    lights : LightArrays, of the casters
    asking : Receiver
    emitter : int, row of `lights.emitters`
    wi : tuple of 3 float32, unit; distance : float32 [m]
    """
    kind = lights.emitters[emitter, EMITTER_KIND]
    if kind == LIGHT_TRIANGLE:
        instance = np.int64(lights.emitters[emitter, EMITTER_INSTANCE])
        triangle = np.int64(lights.emitters[emitter, EMITTER_TRIANGLE])
        return triangle_emitter_pdf(lights, geometry, asking, instance, triangle, wi, distance, time)
    if kind == LIGHT_BACKGROUND:
        return background_pdf(lights, asking.tree, asking.p, asking.n, False, False, wi)
    row = np.int64(lights.emitters[emitter, EMITTER_LAMP])
    return any_lamp_pdf(lights, row, asking, wi, distance)


@kernel
def leave_to_photons(scene, unit, work, queue):
    """Multiply light samples by what they count beside photons.

    Parameters
    ----------
    queue : LaneQueue
        `work.lit`: `work.f_cos` and `samples.bsdf_pdf` hold what the BSDF says of its samples.
    """
    if not scene.photons.numbers[MAP_RADIUS] > 0.0:
        return
    paths, points, closures, samples, f_cos = work.paths, work.points, work.closures, work.samples, work.f_cos
    lights = scene.casters.lights
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        if not paths.flags[lane] & RAY_GATHERED or not samples.flags[lane] & LIGHT_USES_MIS:
            continue
        if not sends_photons_on(closures, lane) or not rays_find(scene.lights, np.int64(samples.emitter[lane])):
            continue
        wi = load(samples.direction, lane)
        start = start_at(scene.casters, paths, points, lane, wi)
        if start < 0:
            continue
        asking, cosine = receiver_on_caster(
            real_3(points, lane, POINT_P), real_3(points, lane, POINT_NS), wi,
            tree_of_receiver(lights, np.int64(paths.hit_instance[lane])),
        )
        pdf = _pdf_of_photons(
            lights, scene.geometry, asking, np.int64(samples.emitter[lane]), wi, samples.distance[lane],
            paths.time[lane],
        )
        if not pdf > 0.0:
            continue
        instance, triangle = np.int64(paths.hit_instance[lane]), np.int64(paths.hit_triangle[lane])
        density = pdf * density_of_start(scene, start, instance, triangle, paths.time[lane]) / cosine
        density *= share_of_scattering(samples.bsdf_pdf[lane], pdf)
        share = share_beside_photons(scene, work, lane, density)
        for c in range(len(paths.channels)):
            f_cos[lane, c] *= share
