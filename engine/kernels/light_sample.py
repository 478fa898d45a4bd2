# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeping a light sample in its lane, and the point at which its light's program runs."""

import numpy as np

from engine.kernels.constants import FAR
from engine.kernels.path_depths import store_depths
from engine.kernels.surface import program_of, starts_in_place
from engine.kernels.vector import dot, store
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_LIGHT_GROUP
from engine.state.lanes import (
    LIGHT_CASTS_SHADOW,
    LIGHT_ENDS_IN_PLACE,
    LIGHT_HAS_PROGRAM,
    LIGHT_IS_LAMP,
    LIGHT_USES_MIS,
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_LIGHT,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_PROGRAM,
    POINT_RADIUS,
    POINT_RANDOM,
    POINT_RAY_FLAGS,
    POINT_RAY_LENGTH,
    POINT_TIME,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
    POINT_WO,
    RAY_EMISSION,
    RGB,
)
from engine.state.lights import (
    EMITTER_LAMP,
    HEADER_BACKGROUND_PROGRAM,
    LAMP_FLAG_IN_SURFACE,
    LAMP_FLAGS,
    LAMP_LIGHT_GROUP,
    LAMP_TEMPERATURE,
    LIGHT_BACKGROUND,
)

#: Bound on the relative rounding error of a point on a light.
_ERROR = np.float32(4.0 * 7.0 * 2.0**-24)


@kernel(forceinline=True)
def keep_light_sample(scene, work, lane, sample, bsdf_pdf, u, world_group, splits_light):
    """Write a light sample into `work.samples`, and what its program needs into `work.light_points`.

    Parameters
    ----------
    scene : SceneView; work : Work
    sample : LightSample
    bsdf_pdf : float32 [sr^-1], density of scattering in its direction
    u : float32 in [0, 1), for the roulette on dim light samples, and for the program
    world_group : int, light group of the world
    splits_light : bool, whether light passes want the light's group

    Returns
    -------
    bool
        Whether the light has a program to run.
    """
    lights, geometry, program_temperature = scene.lights, scene.geometry, scene.shaders.program_temperature
    paths, samples = work.paths, work.samples
    emitter, kind, wi, distance = sample.emitter, sample.kind, sample.wi, sample.distance
    instance, triangle, program = sample.instance, sample.triangle, sample.program
    store(samples.direction, lane, wi)
    samples.pdf[lane] = sample.pdf
    samples.bsdf_pdf[lane] = bsdf_pdf
    samples.terminate[lane] = u
    samples.visibility[lane] = sample.visibility
    for c in range(RGB):
        samples.radiance[lane, c] = sample.radiance[c]
    if len(paths.channels) > RGB:
        # For `upsample_lights`; programs are looked at where they have run.
        temperature = 0.0
        if program < 0 and instance >= 0:
            temperature = program_temperature[program_of(geometry, instance, triangle)]
        elif program < 0 and kind == LIGHT_BACKGROUND:
            temperature = program_temperature[lights.header[HEADER_BACKGROUND_PROGRAM]]
        elif program < 0:
            temperature = lights.lamps[lights.emitters[emitter, EMITTER_LAMP], LAMP_TEMPERATURE]
        samples.radiance[lane, RGB] = temperature
    if splits_light:
        group = world_group
        if instance >= 0:
            group = geometry.instance_table[instance, INSTANCE_LIGHT_GROUP]
        elif kind != LIGHT_BACKGROUND:
            group = lights.lamp_table[lights.emitters[emitter, EMITTER_LAMP], LAMP_LIGHT_GROUP]
        work.passes.group[lane] = group
    flags = (LIGHT_CASTS_SHADOW if sample.cast_shadow else 0) | (LIGHT_USES_MIS if sample.use_mis else 0)
    if instance < 0:
        flags |= LIGHT_IS_LAMP
        if kind != LIGHT_BACKGROUND and lights.lamp_table[lights.emitters[emitter, EMITTER_LAMP], LAMP_FLAGS] & (
            LAMP_FLAG_IN_SURFACE
        ):
            flags |= LIGHT_ENDS_IN_PLACE
    elif starts_in_place(geometry, instance):
        flags |= LIGHT_ENDS_IN_PLACE
    samples.emitter[lane] = emitter
    samples.distance[lane] = distance
    # How much too long the ray could be: rounding at the light and the shifted origin, seen at a slant there.
    if distance < FAR:
        point = sample.point
        slant = max(abs(dot(sample.ng, wi)), 0.004)
        extent = max(abs(point[0]), abs(point[1]), abs(point[2]), distance)
        samples.offset[lane] = (extent * _ERROR + paths.offset[lane]) / slant
    else:
        samples.offset[lane] = 0.0
    has_program = program >= 0
    if has_program:
        flags |= LIGHT_HAS_PROGRAM
        out, is_world = work.light_points.real, sample.kind == LIGHT_BACKGROUND
        # Normals face the receiver. A sun's place is where its light goes, as in Cycles, the world's where it is seen.
        for c in range(3):
            out[lane, POINT_P + c] = sample.point[c] if distance < FAR else (wi[c] if is_world else -wi[c])
            out[lane, POINT_WO + c] = -wi[c]
            out[lane, POINT_NG + c] = sample.ng[c]
            out[lane, POINT_NS + c] = sample.ng[c]
        out[lane, POINT_U] = sample.u
        out[lane, POINT_V] = sample.v
        out[lane, POINT_RAY_LENGTH] = distance
        out[lane, POINT_RADIUS] = 0.0
        out[lane, POINT_RANDOM] = u
        out[lane, POINT_TIME] = paths.time[lane]
        integer = work.light_points.integer
        integer[lane, POINT_INSTANCE] = instance
        integer[lane, POINT_TRIANGLE] = triangle
        integer[lane, POINT_PROGRAM] = program
        integer[lane, POINT_RAY_FLAGS] = (paths.flags[lane] & ~1) | RAY_EMISSION
        integer[lane, POINT_FLAGS] = POINT_FLAG_BACKFACING if sample.shows_back else 0
        store_depths(paths, lane, paths.transparent_depth[lane], work.light_points, lane)
        integer[lane, POINT_LIGHT] = -1 if instance >= 0 or is_world else 0
    samples.flags[lane] = flags
    return has_program
