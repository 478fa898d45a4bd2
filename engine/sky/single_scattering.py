# SPDX-License-Identifier: GPL-3.0-or-later
"""A sky whose light is scattered once, as Blender's since 2.90.

Reference: Nishita, Sirai, Tadamura and Nakamae 1993, "Display of the Earth Taking into Account Atmospheric Scattering".
Wavelengths are 380, 400, ... 780 nm.
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, FloatArray
from engine.sky.sky_maps import MAP_HEIGHT, MAP_WIDTH, Atmosphere, mirrored

#: Of the earth and of its air [m].
_EARTH_RADIUS = 6_360_000.0
_AIR_RADIUS = 6_420_000.0
_STEPS = 32
_STEP_OF_WAVELENGTHS = 20.0
_MIE = 2e-5
_ANISOTROPY = 0.76
#: Of the sun outside of the air [W m^-2 nm^-1].
_IRRADIANCE = np.array(
    [
        1.45756829855592995, 1.56596305559738380, 1.65148449067670455, 1.71496242737209315, 1.75797983805020541,
        1.78256407885924539, 1.79095108475838560, 1.78541550133410665, 1.76815554864306845, 1.74122069647250410,
        1.70647127164943679, 1.66556087452739887, 1.61993437242451854, 1.57083597368892081, 1.51932335059305479,
        1.46628494965214396, 1.41245852740172451, 1.35844961970384093, 1.30474913844739282, 1.25174963272610817,
        1.19975998755420621,
    ]
)  # fmt: skip
#: Scattering by molecules, and absorption by ozone [m^-1].
_RAYLEIGH = 1e-5 * np.array(
    [
        5.424820087636473, 4.418549866505454, 3.635151910165377, 3.017929012024763, 2.526320226989157,
        2.130859310621843, 1.809838025320633, 1.547057129129042, 1.330284977336850, 1.150184784075764,
        0.999557429990163, 0.872799973630707, 0.765513700977967, 0.674217203751443, 0.596134125832052,
        0.529034598065810, 0.471115687557433, 0.420910481110487, 0.377218381260133, 0.339051255477280,
        0.305591531679811,
    ]
)  # fmt: skip
_OZONE = 1e-8 * np.array(
    [
        0.325126849861, 0.585395365047, 1.977191155085, 7.309568762914, 20.084561514287, 40.383958096161,
        63.551335912363, 96.707017041180, 154.797400424410, 209.038647223331, 246.128056164565, 273.551299461512,
        215.125863128643, 159.051840791988, 112.356197979857, 73.527551487574, 46.450130357806, 33.096079921048,
        22.512612292678, 14.879129266490, 16.828623364192,
    ]
)  # fmt: skip
#: The CIE 1931 observer.
_TO_XYZ = _STEP_OF_WAVELENGTHS * np.array(
    [
        [0.001368, 0.000039, 0.006450001], [0.01431, 0.000396, 0.06785001], [0.13438, 0.004, 0.6456],
        [0.34828, 0.023, 1.74706], [0.2908, 0.06, 1.6692], [0.09564, 0.13902, 0.8129501], [0.0049, 0.323, 0.272],
        [0.06327, 0.71, 0.07824999], [0.2904, 0.954, 0.0203], [0.5945, 0.995, 0.0039], [0.9163, 0.87, 0.001650001],
        [1.0622, 0.631, 0.0008], [0.8544499, 0.381, 0.00019], [0.4479, 0.175, 0.00002], [0.1649, 0.061, 0.0],
        [0.04677, 0.017, 0.0], [0.01135916, 0.004102, 0.0], [0.002899327, 0.001047, 0.0],
        [0.0006900786, 0.0002492, 0.0], [0.0001661505, 0.00006, 0.0], [0.00004150994, 0.00001499, 0.0],
    ]
)  # fmt: skip
#: Gauss-Laguerre quadrature of depths that fall off exponentially, its nodes scaled into the air (8 of 50 nodes).
_NODES = (
    0.006811185292, 0.03614807107, 0.09004346519, 0.1706680068, 0.2818362161, 0.4303406404, 0.6296271457, 0.9145252695
)  # fmt: skip
_WEIGHTS = (
    0.01750893642, 0.04135477391, 0.06678839063, 0.09507698807, 0.1283416365, 0.1707430204, 0.2327233347, 0.3562490486
)  # fmt: skip


def _densities(height: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of molecules, aerosols and ozone at heights [m], relative to the most."""
    # Rays through the earth, whose light does not count, would leave the range of numbers.
    height = np.maximum(height, -1000.0)
    ozone = np.maximum(0.0, 1.0 - np.abs(height - 25_000.0) / 15_000.0)
    return np.exp(-height / 8000.0), np.exp(-height / 1200.0), ozone


def _way_out(centre: FloatArray, upwards: FloatArray) -> FloatArray:
    """Distance to the end of the air [m], from so far off the earth's centre, by the cosine to the zenith."""
    along = centre * upwards
    return -along + np.sqrt(along * along - centre * centre + _AIR_RADIUS * _AIR_RADIUS)


def _depths(centre: FloatArray, upwards: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Optical depths of molecules, aerosols and ozone towards the sun, over their coefficients [m]."""
    length = _way_out(centre, upwards)
    total = [np.zeros(np.broadcast(centre, upwards).shape) for _ in range(3)]
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        t = node * length
        height = np.sqrt(centre * centre + t * t + 2.0 * centre * t * upwards) - _EARTH_RADIUS
        for sum_, density in zip(total, _densities(height), strict=True):
            sum_ += weight * density
    return total[0] * length, total[1] * length, total[2] * length


def sky_map(atmosphere: Atmosphere) -> Float32Array:
    """Radiance of the sky in CIE XYZ; as `engine.sky.multiple_scattering.sky_map`, but that rows are level at l = 0."""
    height, width = MAP_HEIGHT // 2, MAP_WIDTH // 2
    altitude = min(max(atmosphere.altitude, 1.0), 59_999.0)
    origin = _EARTH_RADIUS + altitude
    azimuth = 2.0 * np.pi * np.arange(width) / MAP_WIDTH - np.pi
    elevation = 0.5 * np.pi * np.square(np.arange(height) / height)
    sun_across, sun_up = np.cos(atmosphere.sun_elevation), np.sin(atmosphere.sun_elevation)
    upper = np.empty((height, width, 3), np.float32)
    extinctions = np.array(
        [
            _RAYLEIGH * atmosphere.air_density,
            np.full(len(_RAYLEIGH), 1.11 * _MIE * atmosphere.aerosol_density),
            _OZONE * atmosphere.ozone_density,
        ],
        np.float32,
    )
    for row in range(height):
        upwards, across = np.sin(elevation[row]), np.cos(elevation[row])
        step = _way_out(np.array(origin), upwards) / _STEPS
        t = (np.arange(_STEPS) + 0.5) * step
        centre = np.sqrt(origin * origin + t * t + 2.0 * origin * t * upwards)
        densities = np.stack(_densities(centre - _EARTH_RADIUS))
        before = np.cumsum(densities, axis=1) * step
        sun = (t * across)[:, None] * np.cos(azimuth) * sun_across + ((origin + t * upwards) * sun_up)[:, None]
        sun /= centre[:, None]
        # The earth is in the way of what is below its edge.
        is_lit = (sun_up >= 0.0) | (np.square(centre[:, None]) * (1.0 - sun * sun) > _EARTH_RADIUS**2)
        depths = (np.stack(_depths(centre[:, None], sun)) + before[:, :, None]).astype(np.float32)
        mu = across * np.cos(azimuth) * sun_across + upwards * sun_up
        squared = _ANISOTROPY * _ANISOTROPY
        rayleigh_phase = 3.0 / (16.0 * np.pi) * (1.0 + mu * mu)
        mie_phase = 3.0 * (1.0 - squared) * (1.0 + mu * mu)
        mie_phase /= 8.0 * np.pi * (2.0 + squared) * (1.0 + squared - 2.0 * _ANISOTROPY * mu) ** 1.5
        molecules = (densities[0] * atmosphere.air_density * step).astype(np.float32)
        aerosols = (densities[1] * atmosphere.aerosol_density * step).astype(np.float32)
        spectrum = np.empty((len(_RAYLEIGH), width))
        for k in range(len(_RAYLEIGH)):
            rayleigh, mie, ozone = extinctions[:, k]
            left = np.exp(-(rayleigh * depths[0] + mie * depths[1] + ozone * depths[2])) * is_lit
            spectrum[k] = _RAYLEIGH[k] * rayleigh_phase * (molecules @ left) + _MIE * mie_phase * (aerosols @ left)
        upper[row] = (spectrum * _IRRADIANCE[:, None]).T @ _TO_XYZ
    whole = np.empty((MAP_HEIGHT, MAP_WIDTH, 3), np.float32)
    whole[height:] = mirrored(upper)
    # Below the horizon it fades.
    down = np.sin(0.5 * np.pi * np.square(np.arange(height) / height - 1.0))
    fade = np.where(down < 0.4, (1.0 - 2.5 * down) ** 3, 0.0)
    whole[:height] = whole[height] * fade[:, None, None]
    return whole


def sun_ends(atmosphere: Atmosphere, diameter: float) -> FloatArray:
    """As `engine.sky.multiple_scattering.sun_ends`; black where the sun has set."""
    altitude = min(max(atmosphere.altitude, 1.0), 59_999.0)
    elevation = np.maximum(atmosphere.sun_elevation + np.array([-0.5, 0.5]) * diameter, 0.0)
    if not elevation[1] > 0.0:
        return np.zeros((2, 3))
    molecules, aerosols, _ = _depths(np.full(2, _EARTH_RADIUS + altitude), np.sin(elevation))
    depth = molecules[:, None] * _RAYLEIGH * atmosphere.air_density
    depth += aerosols[:, None] * 1.11 * _MIE * atmosphere.aerosol_density
    solid_angle = 2.0 * np.pi * (1.0 - np.cos(0.5 * diameter))
    return _IRRADIANCE * np.exp(-depth) / solid_angle @ _TO_XYZ
