# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps on the way of rays: how far away, what is seen of them, and adding it. Shared by the stages that find them."""

import numpy as np

from engine.kernels.caustics import caster_receiver, share_of_path
from engine.kernels.clamping import found_alone
from engine.kernels.constants import DISTANT, FAR
from engine.kernels.lights import (
    Receiver,
    any_lamp_pdf,
    distant_lamp_is_hit,
    distant_lamp_leaving,
    lamp_emitter,
    lamp_hit,
    lamp_leaving,
    tree_of_ray,
)
from engine.kernels.media import attenuate
from engine.kernels.radiance import add_found, add_seen, weigh_found
from engine.kernels.spectrum import upsample_light
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.film import FEATURE_EMISSION
from engine.state.lanes import (
    RAY_CAUSTIC,
    RAY_MIS_HAD_TRANSMISSION,
    RAY_MIS_SKIP,
    RGB,
)
from engine.state.lights import (
    HEADER_HITTABLE,
    LAMP_ESTIMATE,
    LAMP_LIGHT_GROUP,
    LAMP_PROGRAM,
    LAMP_RADIANCE,
    LAMP_TEMPERATURE,
)
from engine.wavefront.columns import SCENE_HAS_MEDIA, SCENE_HAS_VARYING_MEDIA, UNIT_USE_DENOISING, UNIT_USE_FEATURES


@kernel
def takes_next(count, u):
    """Whether the `count`-th of several takes the place of the one before, each with the same probability.

    Returns
    -------
    bool
    u : float32 in [0, 1), what is left of the number: uniform again
    """
    u *= np.float32(count)
    if u < 1.0:
        return True, u
    return False, (u - 1.0) / np.float32(count - 1)


@kernel
def distance_to_lamp(lights, row, origin, wi, t_min, t_max, is_endless):
    """How far away a ray meets a lamp, -1 = not; DISTANT of one that is infinitely far away."""
    if row < lights.header[HEADER_HITTABLE]:
        return lamp_hit(lights, row, origin, wi, t_min, t_max)
    if is_endless and distant_lamp_is_hit(lights, row, origin, wi, t_min):
        return DISTANT
    return np.float32(-1.0)


@kernel
def share_of_lamp(scene, work, lane, row, wi, distance):
    """What a path counts of a lamp that photons find too; `distance` as `distance_to_lamp` says [m]."""
    lights = scene.casters.lights
    asking, cosine = caster_receiver(work.paths, lane, lights)
    return share_of_path(scene, work, lane, any_lamp_pdf(lights, row, asking, wi, distance), cosine)


@kernel
def weigh_lamp(scene, work, lane, row, origin, wi, distance):
    """What leaves a lamp towards a ray, MIS weight included, and how clamping sees it."""
    paths = work.paths
    lights, options, flags = scene.lights, scene.options, paths.flags[lane]
    is_local = row < lights.header[HEADER_HITTABLE]
    factor = lamp_leaving(lights, row, origin, wi) if is_local else distant_lamp_leaving(lights, row, origin, wi)
    unguided = found_alone(paths.unguided[lane])
    if factor > 0.0 and flags & RAY_CAUSTIC:
        factor *= share_of_lamp(scene, work, lane, row, wi, distance)
    if factor > 0.0 and options.use_nee != 0 and not flags & RAY_MIS_SKIP:
        tree = tree_of_ray(lights, flags)
        had_transmission = (flags & RAY_MIS_HAD_TRANSMISSION) != 0
        receiver = Receiver(origin, load(paths.mis_normal, lane), had_transmission, False, tree)
        pdf = any_lamp_pdf(lights, row, receiver, wi, distance)
        weight, unguided = weigh_found(options, lights, paths, lane, lamp_emitter(lights, tree, row), False, pdf)
        factor *= weight
    return factor, unguided


@kernel
def write_lamp_radiance(scene, paths, lane, row, factor, out, out_row):
    """Write a lamp's radiance times `factor` and throughput into a row of `out`, without what its program says."""
    lamps = scene.lights.lamps
    for c in range(RGB):
        out[out_row, c] = lamps[row, LAMP_RADIANCE + c]
        if scene.lights.lamp_table[row, LAMP_PROGRAM] < 0:
            out[out_row, c] *= lamps[row, LAMP_ESTIMATE + c]
    if len(paths.channels) > RGB:
        upsample_light(
            scene.spectrum, paths, lane, out[out_row, 0], out[out_row, 1], out[out_row, 2],
            lamps[row, LAMP_TEMPERATURE], out, out_row,
        )
    for c in range(len(paths.channels)):
        out[out_row, c] *= factor * paths.throughput[lane, c]


@kernel
def _see_through(work, lane, row, distance):
    """Multiply a lamp's light in `work.f_cos` by what the ray that was tracked to it has left there.

    One lamp on the way was picked, and stands for all; a sun is behind everything, where the ray has not collided.
    """
    tracking, scratch = work.tracking, work.f_cos
    for c in range(len(work.paths.channels)):
        factor = 0.0
        if distance >= FAR:
            factor = tracking.weight[lane, c] if tracking.collision[lane] < 0.0 else 0.0
        elif tracking.lamp[lane] == row:
            factor = tracking.lamp_weight[lane, c] * np.float32(tracking.lamp_count[lane])
        scratch[lane, c] *= factor


@kernel
def add_lamp(scene, unit, work, lane, row, distance, unguided):
    """Add row `lane` of `work.f_cos`, what is seen of a lamp, clamped like all light found, and show it in passes.

    `distance` is that from the ray's origin, which media may lie on.
    """
    spectrum, paths, scratch = scene.spectrum, work.paths, work.f_cos
    if scene.header[SCENE_HAS_VARYING_MEDIA] != 0 and work.tracking.is_tracked[lane] != 0:
        _see_through(work, lane, row, distance)
    elif scene.header[SCENE_HAS_MEDIA] != 0:
        attenuate(scene, paths, work.media, lane, lane, distance, scratch, lane)
    share = add_found(
        scene.options, spectrum, paths, work.passes, lane, scratch, unguided,
        scene.lights.lamp_table[row, LAMP_LIGHT_GROUP], unit.film, FEATURE_EMISSION,
        unit.header[UNIT_USE_FEATURES] != 0,
    )
    if unit.header[UNIT_USE_DENOISING] != 0:
        add_seen(spectrum, paths, work.features, lane, scratch, share, unit.film)


