# SPDX-License-Identifier: GPL-3.0-or-later
"""A sky whose light is scattered repeatedly, as Blender 5.0's.

References: Fernando Garcia Linan 2024, "Spectral rendering of the sky with four wavelengths"
(fgarlin.com/posts/2024-12-06-spectral_sky); Hillaire 2016, "Physically Based Sky, Atmosphere and Cloud Rendering in
Frostbite", eq. 28 (light scattered within a step).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, FloatArray, IntpArray
from engine.sky.sky_maps import MAP_HEIGHT, MAP_WIDTH, Atmosphere, mirrored, row_elevations

#: Of the earth and of its air [km].
_EARTH_RADIUS = 6371.0
_THICKNESS = 100.0
_STEPS = 64
#: Of the table of transmittances: by height, and by the cosine of the angle to the zenith.
_HEIGHTS, _COSINES = 64, 256
_ALBEDO = 0.3
_ANISOTROPY = 0.8
#: At 630, 560, 490 and 430 nm: irradiance outside of the air [W m^-2 nm^-1], coefficients [km^-1] and cross sections.
_SUN = np.array([1.679, 1.828, 1.986, 1.307])
_MOLECULES = np.array([6.605e-3, 1.067e-2, 1.842e-2, 3.156e-2])
_OZONE = np.array([3.472e-25, 3.914e-25, 1.349e-25, 11.03e-27]) * 334.5
_AEROSOL_ABSORPTION = np.array([2.8722e-24, 4.6168e-24, 7.9706e-24, 1.3578e-23])
_AEROSOL_SCATTERING = np.array([1.5908e-22, 1.7711e-22, 2.0942e-22, 2.4033e-22])
#: Fit of what the air sends on a second time and oftener.
_REPEATED = 0.02 * np.array([0.217, 0.347, 0.594, 1.0])
_TO_XYZ = np.array(
    [
        [53.386917738564668, 22.981337506691025, 0.0],
        [43.904844466369358, 71.347795700053394, 0.102506867965741],
        [1.6137278251608962, 18.422960591455485, 31.742921188390806],
        [20.762668673810577, 2.3614213523314369, 110.48009643252140],
    ]
)


def _densities(height: npt.NDArray[np.floating]) -> tuple[npt.NDArray[np.floating], ...]:
    """Of molecules, aerosols and ozone at heights [km]: what coefficients and cross sections are multiplied by."""
    height = np.maximum(height, 1e-4)
    logarithm = np.log(height)
    molecules = np.exp(-0.07771971 * np.exp(1.16364243 * logarithm))
    aerosols = 1.3681e20 * np.exp(height * (-1.0 / 0.73)) + 2e6
    ozone = 3.78547397e20 * np.exp(-np.square(logarithm - 3.22261) * 5.55555555 - logarithm)
    return molecules, aerosols, ozone


def _coefficients(height: FloatArray, atmosphere: Atmosphere) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Extinction, scattering by molecules and by aerosols [km^-1] of heights [km]: (..., 4) each."""
    molecules, aerosols, ozone = (density[..., None] for density in _densities(height))
    by_molecules = _MOLECULES * atmosphere.air_density * molecules
    by_aerosols = _AEROSOL_SCATTERING * atmosphere.aerosol_density * aerosols
    absorbed = _AEROSOL_ABSORPTION * atmosphere.aerosol_density * aerosols + _OZONE * atmosphere.ozone_density * ozone
    extinction = np.asarray(absorbed + by_aerosols + by_molecules, np.float64)
    return extinction, np.asarray(by_molecules), np.asarray(by_aerosols)


def _leaves_at(origin: FloatArray, upwards: FloatArray, radius: float) -> FloatArray:
    """Distance to a sphere around the earth's centre [km], from so far off it, by the cosine to the zenith; -1: none.

    From within it is where the ray leaves, from without where it enters.
    """
    along = origin * upwards
    outside = origin * origin - radius * radius
    discriminant = along * along - outside
    root = np.sqrt(np.maximum(discriminant, 0.0))
    distance = np.where(outside <= 0.0, -along + root, -along - root)
    return np.where((discriminant < 0.0) | ((outside > 0.0) & (along > 0.0)), -1.0, distance)


def _transmittance(cosine: FloatArray, height: FloatArray, atmosphere: Atmosphere) -> FloatArray:
    """Of the air between a height, as a share of its thickness, and the sun at a cosine to the zenith: (..., 4)."""
    origin = _EARTH_RADIUS + _THICKNESS * height
    step = _leaves_at(origin, cosine, _EARTH_RADIUS + _THICKNESS) / _STEPS
    columns = [np.zeros(np.broadcast(cosine, height).shape) for _ in range(3)]
    for k in range(_STEPS):
        t = (k + 0.5) * step
        centre = np.sqrt(origin * origin + t * t + 2.0 * origin * t * cosine)
        for column, density in zip(columns, _densities((centre - _EARTH_RADIUS).astype(np.float32)), strict=True):
            column += density
    molecules, aerosols, ozone = (column * step for column in columns)
    depth = np.multiply.outer(molecules, _MOLECULES * atmosphere.air_density)
    depth += np.multiply.outer(aerosols, (_AEROSOL_ABSORPTION + _AEROSOL_SCATTERING) * atmosphere.aerosol_density)
    depth += np.multiply.outer(ozone, _OZONE * atmosphere.ozone_density)
    return np.exp(-depth)


def _transmittances(atmosphere: Atmosphere) -> FloatArray:
    """The table of `_transmittance`, (heights, cosines, 4): both rise evenly."""
    cosine = np.linspace(-1.0, 1.0, _COSINES)
    height = np.linspace(0.0, 1.0, _HEIGHTS)[:, None]
    return _transmittance(cosine, height, atmosphere)


def _between(values: Float32Array, first: IntpArray, part: Float32Array) -> Float32Array:
    """What lies so far between each entry (of flattened `values`) and the next."""
    flat = values.ravel()
    before = flat.take(first, mode="clip")
    after = flat[1:].take(first, mode="clip")
    after -= before
    after *= part
    after += before
    return after


def sky_map(atmosphere: Atmosphere) -> Float32Array:
    """Radiance of the sky in CIE XYZ, as `engine.sky.sky_maps` lays it out.

    Parameters
    ----------
    atmosphere : Atmosphere

    Returns
    -------
    float32 (MAP_HEIGHT, MAP_WIDTH, 3) [W m^-2 sr^-1 in the units of Blender]
    """
    table = _transmittances(atmosphere)
    by_channel = np.ascontiguousarray(table.transpose(2, 0, 1).astype(np.float32))
    at_ground = by_channel[:, 0, :]
    # From the height up to the ground, by those to the zenith.
    zenith = table[:, -1]
    altitude = min(max(atmosphere.altitude, 1.0), 99_999.0) / 1000.0
    origin = np.array(_EARTH_RADIUS + altitude)
    sun_sine, sun_cosine = np.cos(atmosphere.sun_elevation), np.sin(atmosphere.sun_elevation)
    azimuth = 2.0 * np.pi * (np.arange(MAP_WIDTH // 2) + 0.5) / MAP_WIDTH
    line = _COSINES * np.arange(_STEPS)[:, None]
    result = np.empty((MAP_HEIGHT, MAP_WIDTH // 2, 3), np.float32)
    for row, elevation in enumerate(row_elevations()):
        upwards, across = np.sin(elevation), np.cos(elevation)
        ground = _leaves_at(origin, upwards, _EARTH_RADIUS)
        length = ground if ground >= 0.0 else _leaves_at(origin, upwards, _EARTH_RADIUS + _THICKNESS)
        step = length / _STEPS
        t = (np.arange(_STEPS) + 0.5) * step
        centre = np.sqrt(origin * origin + t * t + 2.0 * origin * t * upwards)
        height = np.maximum(centre - _EARTH_RADIUS, 0.0)
        extinction, by_molecules, by_aerosols = _coefficients(height, atmosphere)
        within = np.exp(-step * extinction)
        before = np.concatenate([np.ones((1, 4)), np.cumprod(within, axis=0)[:-1]])
        share = _SUN * before * (1.0 - within) / np.maximum(extinction, 1e-7)

        # The sun's cosine to the zenith of each step, by azimuth: it stands at azimuth pi.
        cosine = (t * across)[:, None] * (-sun_sine * np.cos(azimuth)) + ((origin + t * upwards) * sun_cosine)[:, None]
        cosine = (cosine / centre[:, None]).astype(np.float32)
        place = np.clip(0.5 * cosine + 0.5, 0.0, 1.0) * np.float32(_COSINES - 1)
        first = np.minimum(place.astype(np.intp), _COSINES - 2)
        part = place - first.astype(np.float32)
        of_line = first + line

        level = np.clip(height / _THICKNESS, 0.0, 1.0) * (_HEIGHTS - 1)
        below = level.astype(np.int32)
        above = np.minimum(below + 1, _HEIGHTS - 1)
        rise = (level - below)[:, None]
        to_ground = zenith[0] / (zenith[below] + (zenith[above] - zenith[below]) * rise)
        omega = 2.0 * np.pi * (1.0 - np.sqrt(np.maximum(1.0 - np.square(_EARTH_RADIUS / centre), 0.0)))
        from_ground = (omega / (4.0 * np.pi))[:, None] * (_ALBEDO / np.pi) * to_ground
        repeated = 1.0 / (1.0 + 5.0 * np.exp(np.float32(-17.92) * cosine))

        mu = -(across * -sun_sine * np.cos(azimuth) + upwards * sun_cosine)
        molecular_phase = 3.0 / (16.0 * np.pi) * (1.0 + mu * mu)
        squared = _ANISOTROPY * _ANISOTROPY
        aerosol_phase = (1.0 - squared) / (4.0 * np.pi) / (1.0 + squared + 2.0 * _ANISOTROPY * mu) ** 1.5
        rise = rise.astype(np.float32)
        spectrum = np.empty((4, MAP_WIDTH // 2))
        for c in range(4):
            lines = by_channel[c, below] + (by_channel[c, above] - by_channel[c, below]) * rise
            sun = _between(lines, of_line, part)
            ground_sun = _between(at_ground[c], first, part) * cosine
            once = share[:, c].astype(np.float32)
            molecules = once * by_molecules[:, c].astype(np.float32)
            aerosols = once * by_aerosols[:, c].astype(np.float32)
            both = molecules + aerosols
            spectrum[c] = molecular_phase * (molecules @ sun) + aerosol_phase * (aerosols @ sun)
            spectrum[c] += _REPEATED[c] * (both @ repeated)
            spectrum[c] += (both * from_ground[:, c].astype(np.float32)) @ ground_sun
        result[row] = spectrum.T @ _TO_XYZ
    return mirrored(result)


def sun_ends(atmosphere: Atmosphere, diameter: float) -> FloatArray:
    """Radiance of the sun's disc in CIE XYZ at its lowest and at its highest point, without limb darkening.

    Parameters
    ----------
    atmosphere : Atmosphere
    diameter : float [rad]

    Returns
    -------
    float64 (2, 3)
    """
    altitude = min(max(atmosphere.altitude, 1.0), 99_999.0) / 1000.0
    elevation = atmosphere.sun_elevation + np.array([-0.5, 0.5]) * diameter
    transmittance = _transmittance(np.sin(elevation), np.full(2, altitude / _THICKNESS), atmosphere)
    solid_angle = 2.0 * np.pi * (1.0 - np.cos(0.5 * diameter))
    return _SUN * transmittance / solid_angle @ _TO_XYZ
