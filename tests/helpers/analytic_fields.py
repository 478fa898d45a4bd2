# SPDX-License-Identifier: GPL-3.0-or-later
"""A field of light over the plane z = 0 that can be written down, records of it, and a small network to learn it."""

from __future__ import annotations

import dataclasses

import numpy as np

from engine.guiding.neural.networks.mixture.shape import MixtureShape
from engine.guiding.records.training_rows import make_rows
from tests.helpers.guiding_harness import uniform_directions

#: Of the plane and what is above it [m].
BOUNDS = np.array(((-1.0, -1.0, -0.2), (1.0, 1.0, 1.2)), np.float32)
GRIDS = {"level_count": 4, "base_resolution": 4, "growth": 1.6, "width": 32}
NPM = MixtureShape(**GRIDS)
_LIGHTS = np.array(((0.5, 0.3, 0.6), (-0.6, -0.4, 0.4)))
_POWERS = np.array((3.0, 1.5))


def hemisphere(rng, count):
    """Random unit directions of the upper half, float64 (count, 3)."""
    directions = uniform_directions(rng, count)
    directions[:, 2] = np.abs(directions[:, 2])
    return directions


def plane(rng, count):
    """Random points of the plane within the bounds, float64 (count, 3)."""
    return np.column_stack((rng.uniform(-1.0, 1.0, (count, 2)), np.zeros(count)))


def radiance(position, wi):
    """Two glows above a plane, in front of a faint background."""
    to_light = _LIGHTS - position[:, None]
    distance = np.linalg.norm(to_light, axis=2)
    cosine = (to_light * wi[:, None]).sum(axis=2) / distance
    return (_POWERS * np.exp((distance / 0.15) ** 2 * (cosine - 1.0))).sum(axis=1) + 0.02


def rows_of(count, seed, reflectance=None):
    """Noisy estimates in uniform directions of the hemisphere."""
    rng = np.random.default_rng(seed)
    position, wi, wo = plane(rng, count), hemisphere(rng, count), hemisphere(rng, count)
    normal = np.tile((0.0, 0.0, 1.0), (count, 1))
    noise = rng.exponential(size=count)
    return make_rows(
        position, wi, wo, normal, roughness=0.2, radiance=radiance(position, wi) * noise,
        reflectance=wi[:, 2] / np.pi if reflectance is None else reflectance(wo, wi), pdf=0.5 / np.pi,
        bsdf_pdf=wi[:, 2] / np.pi,
    )


def settings_of(shape, **changes):
    """How the shape is trained, with smaller batches."""
    return dataclasses.replace(shape.training_settings, **{"batch_size": 1024, **changes})
