# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages of renders with wavelengths: what shaders and lights have left as RGB, at the paths' wavelengths."""

from engine.jit import kernel
from engine.kernels.bsdf.dispersion import begin_dispersion, disperses, set_channel
from engine.kernels.bsdf.kinds import (
    CLOSURE_DISPERSES,
    CLOSURE_IS_BACK,
    F0,
    F82_B,
    GLASS,
    GLOSSY_F82,
    GLOSSY_SCHLICK,
    OREN_MULTIPLE,
    OREN_NAYAR,
    REFLECTION_TINT,
    TRANSMISSION_TINT,
)
from engine.kernels.prefetch import ask_for_closures, ask_for_throughput, lane_ahead
from engine.kernels.spectrum import upsample_light, upsample_parameter
from engine.state import CLOSURE_WEIGHT, POINT_FLAG_BACKFACING, POINT_FLAGS, POINT_PROGRAM


@kernel
def upsample_emission(spectrum, program_temperature, program, paths, points, closures, lanes, lane_count):
    """Emission of the lanes' closures.

    Parameters
    ----------
    program_temperature : float32 (P,) [K]
        By shader program, see `engine.shaders.blackbody`.
    program : int
        What all lanes show, -1: the points tell.
    """
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_throughput(paths, ahead)
        ask_for_closures(closures, ahead)
        emission = closures.emission
        if emission[lane, 0] == 0.0 and emission[lane, 1] == 0.0 and emission[lane, 2] == 0.0:
            emission[lane, 3] = 0.0
            continue
        temperature = program_temperature[program if program >= 0 else points.integer[lane, POINT_PROGRAM]]
        upsample_light(
            spectrum, paths, lane, emission[lane, 0], emission[lane, 1], emission[lane, 2], temperature, emission, lane
        )


@kernel
def upsample_lights(spectrum, paths, samples, lit, lit_count):
    """Radiance of light samples; `choose_lights` has left the temperature of black bodies in the fourth channel."""
    for k in range(lit_count):
        lane = lit[k]
        radiance = samples.radiance
        upsample_light(
            spectrum, paths, lane, radiance[lane, 0], radiance[lane, 1], radiance[lane, 2], radiance[lane, 3], radiance,
            lane,
        )


@kernel
def upsample_closures(spectrum, program_dispersion, paths, points, closures, lanes, lane_count):
    """Colours of the lanes' lobes; where the material disperses, refractive indices by wavelength as well.

    Parameters
    ----------
    program_dispersion : float32 (P,) [um^2]
        By shader program, see `engine.spectral.dispersion`.
    """
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_throughput(paths, ahead)
        ask_for_closures(closures, ahead)
        param = closures.param
        has_index = False
        for i in range(closures.count[lane]):
            kind = closures.kind[lane, i]
            upsample_parameter(spectrum, paths, lane, param, i, CLOSURE_WEIGHT)
            has_index = has_index or disperses(kind)
            if kind == OREN_NAYAR:
                upsample_parameter(spectrum, paths, lane, param, i, OREN_MULTIPLE)
            elif kind == GLOSSY_SCHLICK or kind == GLOSSY_F82 or kind == GLASS:
                upsample_parameter(spectrum, paths, lane, param, i, F0)
                if kind == GLOSSY_F82:
                    upsample_parameter(spectrum, paths, lane, param, i, F82_B)
                elif kind == GLASS:
                    upsample_parameter(spectrum, paths, lane, param, i, REFLECTION_TINT)
                    upsample_parameter(spectrum, paths, lane, param, i, TRANSMISSION_TINT)
        dispersion = program_dispersion[points.integer[lane, POINT_PROGRAM]]
        if has_index and dispersion != 0.0:
            flags = closures.flags[lane] | CLOSURE_DISPERSES
            if points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING:
                flags |= CLOSURE_IS_BACK
            closures.flags[lane] = flags
            closures.dispersion[lane] = dispersion
            for c in range(len(paths.channels)):
                closures.wavelength[lane, c] = paths.wavelength[lane, c]
                closures.share[lane, c] = paths.share[lane, c]
            begin_dispersion(closures, lane)
            set_channel(closures, lane, 0)
