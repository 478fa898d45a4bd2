# SPDX-License-Identifier: GPL-3.0-or-later
"""Synthetic records and known mixtures, shared by the tests of guiding."""

from __future__ import annotations

import numpy as np

from engine.guiding.fields.vmm import query
from engine.guiding.fields.vmm.field import (
    LOBE_COEFFICIENT,
    LOBE_INVERSE_DISTANCE,
    LOBE_KAPPA,
    LOBE_ROWS,
    LOBE_WEIGHT,
    LOBE_X,
    LOBE_Z,
    MAX_LOBES,
    NEIGHBOR_COUNT,
    GuideLobes,
    VmmField,
    allocate_guide,
)
from engine.guiding.records.light import Records, allocate_records
from engine.kernels.binary_tree import GRID_SIDE, LEAF, find_leaf, locate_leaf
from engine.runtime.jit import kernel

FAR = 1e4


def unit(vector):
    """Unit float64 vector."""
    vector = np.asarray(vector, np.float64)
    return vector / np.linalg.norm(vector)


def vmf_norm(kappa):
    """Density of a lobe at its centre."""
    return kappa / (2.0 * np.pi * -np.expm1(-2.0 * kappa)) if kappa > 0.0 else 0.25 / np.pi


def vmf_density(directions, mean, kappa):
    """von Mises-Fisher density, in float64: an oracle for the kernels."""
    return vmf_norm(kappa) * np.exp(-0.5 * kappa * ((directions - unit(mean)) ** 2).sum(-1))


def mixture_density(directions, lobes):
    """Density of [(weight, kappa, mean), ...]."""
    return sum(weight * vmf_density(directions, mean, kappa) for weight, kappa, mean in lobes)


def uniform_directions(rng, count):
    """Random unit directions, float64 (count, 3)."""
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def random_directions(rng, count):
    """Random unit directions, float32 (count, 3)."""
    return uniform_directions(rng, count).astype(np.float32)


def sphere_grid(rows=200, columns=400):
    """Directions of equal solid angle covering the sphere: float64 (rows * columns, 3)."""
    z = 1.0 - 2.0 * (np.arange(rows) + 0.5) / rows
    phi = 2.0 * np.pi * (np.arange(columns) + 0.5) / columns
    sine = np.sqrt(1.0 - z**2)
    grid = [np.outer(sine, np.cos(phi)), np.outer(sine, np.sin(phi)), np.repeat(z[:, None], columns, 1)]
    return np.stack(grid, -1).reshape(-1, 3)


def make_records(position, direction, radiance, pdf, distance=FAR) -> Records:
    """Records of the given columns; `radiance` is grey if it has one."""
    direction = np.asarray(direction, np.float64)
    records = allocate_records(len(direction), 3)
    records.position[:] = position
    records.direction[:] = direction
    radiance = np.asarray(radiance, np.float64)
    records.radiance[:] = radiance[:, None] if radiance.ndim == 1 else radiance
    records.pdf[:] = pdf
    records.distance[:] = distance
    records.normal[:, 2] = 1.0
    records.roughness[:] = 1.0
    return records


def uniform_records(rng, count, radiance, low=(-1.0, -1.0, -1.0), high=(1.0, 1.0, 1.0)) -> Records:
    """Records at random places of a box in random directions, lit by `radiance(directions)` from far away."""
    directions = uniform_directions(rng, count)
    return make_records(rng.uniform(low, high, (count, 3)), directions, radiance(directions), 0.25 / np.pi)


def field_of(lobes, pivot=(0.0, 0.0, 0.0), extent=10.0, fluence=1.0) -> VmmField:
    """A field of one region with the mixture [(weight, kappa, mean, distance), ...]."""
    stored = np.zeros((1, LOBE_ROWS, MAX_LOBES), np.float32)
    for k, (weight, kappa, mean, distance) in enumerate(lobes):
        stored[0, LOBE_WEIGHT, k] = weight
        stored[0, LOBE_KAPPA, k] = kappa
        stored[0, LOBE_X : LOBE_Z + 1, k] = unit(mean)
        stored[0, LOBE_INVERSE_DISTANCE, k] = 1.0 / distance
        stored[0, LOBE_COEFFICIENT, k] = weight * vmf_norm(kappa)
    neighbors = np.full((1, NEIGHBOR_COUNT), -1, np.int32)
    neighbors[0, 0] = 0
    return VmmField(
        np.zeros(1, np.float32),
        np.array([[LEAF, 0]], np.int32),
        np.array([[-extent] * 3, [extent] * 3], np.float32),
        np.zeros(GRID_SIDE**3, np.int32),
        np.full(3, 0.5 * GRID_SIDE / extent, np.float32),
        stored,
        np.array([len(lobes)], np.int32),
        np.array([pivot], np.float32),
        np.array([fluence], np.float32),
        np.ones(1, np.uint8),
        np.zeros(1, np.float32),
        neighbors,
        np.full((1, 3, NEIGHBOR_COUNT), 1e18, np.float32),
    )


@kernel
def _densities(guide, row, directions, out):
    for k in range(directions.shape[0]):
        wi = (directions[k, 0], directions[k, 1], directions[k, 2])
        out[k, 0] = query.eval_vmm(guide, row, wi)
        out[k, 1] = query.predict_vmm(guide, row, wi, out[k, 0])


@kernel
def _samples(guide, row, u, out):
    for k in range(u.shape[0]):
        wi = query.sample_vmm(guide, row, u[k, 0], u[k, 1], u[k, 2])
        out[k, 0] = wi[0]
        out[k, 1] = wi[1]
        out[k, 2] = wi[2]


@kernel
def _regions(field, points, u, out):
    for k in range(points.shape[0]):
        p = (points[k, 0], points[k, 1], points[k, 2])
        out[k, 0] = find_leaf(field, p)
        out[k, 2] = locate_leaf(field, p)
        out[k, 1] = query.find_region(field, out[k, 0], p, u[k])


def guide_at(field, p, n=(0.0, 0.0, 1.0), cosine_lobe=False, region=0) -> GuideLobes:
    """The mixture of a region at point p, in lane 0."""
    guide = allocate_guide(1)
    point = tuple(np.float32(value) for value in p)
    normal = tuple(np.float32(value) for value in unit(n))
    query.prepare_vmm(field, region, point, normal, cosine_lobe, guide, 0)
    return guide


def densities(guide, directions):
    """`eval_vmm` and `predict_vmm` at directions: two float64 (N,)."""
    out = np.zeros((len(directions), 2), np.float32)
    _densities(guide, 0, np.asarray(directions, np.float32), out)
    return out[:, 0].astype(np.float64), out[:, 1].astype(np.float64)


def samples(guide, rng, count):
    """Directions from `sample_vmm`: float64 (count, 3)."""
    out = np.zeros((count, 3), np.float32)
    _samples(guide, 0, rng.random((count, 3)).astype(np.float32), out)
    return out.astype(np.float64)


def regions(field, points, u):
    """`find_leaf` and `find_region` at points: two int (N,)."""
    out = np.zeros((len(points), 3), np.int32)
    bits = (np.asarray(u, np.float64) * 2**30).astype(np.uint32)
    _regions(field, np.asarray(points, np.float32).reshape(-1, 3), bits, out)
    np.testing.assert_array_equal(out[:, 2], out[:, 0])
    return out[:, 0], out[:, 1]


def divergence(truth, field, p=None, region=0):
    """Kullback-Leibler divergence of a region's mixture at p (its pivot) from the density `truth(directions)`."""
    directions = sphere_grid()
    pdf, _ = densities(guide_at(field, field.pivot[region] if p is None else p, region=region), directions)
    target = truth(directions)
    target = target / target.mean() * 0.25 / np.pi
    lit = target > 0.0
    logs = np.log(target[lit] / np.maximum(pdf[lit], 1e-30))
    return float((target[lit] * logs).sum() * 4.0 * np.pi / len(directions))
