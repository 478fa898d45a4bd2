# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages of renders with wavelengths: what shaders and lights have left as RGB, at the paths' wavelengths."""

from engine.kernels.bsdf.dispersion import begin_dispersion, disperses, set_channel
from engine.kernels.bsdf.kinds import CLOSURE_DISPERSES, CLOSURE_IS_BACK, F0
from engine.kernels.bsdf.linked import MODEL_MASK, TINT, address_of, is_linked
from engine.kernels.bsdf.linked_facets import has_colors, set_wavelengths
from engine.kernels.bsdf.lobes import COLOR_COLUMNS
from engine.kernels.prefetch import ask_for_closures, ask_for_throughput, lane_ahead
from engine.kernels.spectrum import upsample_light, upsample_parameter
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_WEIGHT, POINT_FLAG_BACKFACING, POINT_FLAGS, POINT_PROGRAM


@kernel
def upsample_emission(scene, work, points, closures, queue):
    """Emission of the lanes' closures: of surfaces, of the background and of lights alike.

    Parameters
    ----------
    points, closures : ShadePoints, Closures
        Those of `work` whose emission it is. Points without emission need no program.
    """
    spectrum, program_temperature, paths = scene.spectrum, scene.shaders.program_temperature, work.paths
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_throughput(paths, ahead)
        ask_for_closures(closures, ahead)
        emission = closures.emission
        if emission[lane, 0] == 0.0 and emission[lane, 1] == 0.0 and emission[lane, 2] == 0.0:
            emission[lane, 3] = 0.0
            continue
        temperature = program_temperature[points.integer[lane, POINT_PROGRAM]]
        upsample_light(
            spectrum, paths, lane, emission[lane, 0], emission[lane, 1], emission[lane, 2], temperature, emission, lane
        )


@kernel
def upsample_lights(scene, unit, work, queue):
    """Radiance of light samples; `choose_lights` has left the temperature of black bodies in the fourth channel."""
    spectrum, paths, samples = scene.spectrum, work.paths, work.samples
    lit, lit_count = queue.lanes, queue.count[0]
    for k in range(lit_count):
        lane = lit[k]
        radiance = samples.radiance
        upsample_light(
            spectrum, paths, lane, radiance[lane, 0], radiance[lane, 1], radiance[lane, 2], radiance[lane, 3], radiance,
            lane,
        )


@kernel
def upsample_closures(scene, unit, work, queue):
    """Colours of the lanes' lobes; where the material disperses, refractive indices by wavelength as well."""
    spectrum, program_dispersion = scene.spectrum, scene.shaders.program_dispersion
    paths, points, closures = work.paths, work.points, work.closures
    lanes, lane_count = queue.lanes, queue.count[0]
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
            if is_linked(kind):
                set_wavelengths(
                    param, lane, i, paths.wavelength[lane, 0], paths.wavelength[lane, 1], paths.wavelength[lane, 2],
                    paths.wavelength[lane, 3],
                )
                if has_colors(address_of(param, lane, i) & MODEL_MASK):
                    upsample_parameter(spectrum, paths, lane, param, i, F0)
                    upsample_parameter(spectrum, paths, lane, param, i, TINT)
                continue
            for k_color in range(COLOR_COLUMNS.shape[1]):
                column = COLOR_COLUMNS[kind, k_color]
                if column != 0:
                    upsample_parameter(spectrum, paths, lane, param, i, column)
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
