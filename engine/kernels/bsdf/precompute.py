# SPDX-License-Identifier: GPL-3.0-or-later
"""Compute the file of tables: `python -m engine.kernels.bsdf.precompute` (half a minute).

Albedos are integrals over the visible normals of GGX, by Gauss-Legendre quadrature in the radius and the midpoint rule
in the angle of the spherical cap they are sampled from (Dupuy and Benyoub 2023). What each table means is Cycles'
definition, so that the same closures come out: the ends of the axes stand for 1e-4, and 0.99 for z.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numba
import numpy as np
import numpy.typing as npt

from engine.kernels.bsdf.tables import TABLE_SHAPES, TABLES_FILE

FloatArray = npt.NDArray[np.float64]

RADIUS_POINTS = 96
ANGLE_POINTS = 64
COSINE_POINTS = 32
#: Beyond this, and where eta is this close to 1, lobes are delta lobes (as in the kernels).
DELTA_ALPHA_SQUARED = 2e-10
MIN_ETA_STEP = 1e-4


@numba.njit(cache=True)
def _fresnel(cos_i: float, eta: float) -> tuple[float, float]:
    squared = eta * eta - 1.0 + cos_i * cos_i
    if squared <= 0.0:
        return 1.0, 0.0
    eta_cos_t = math.sqrt(squared)
    r_s = (cos_i - eta_cos_t) / (cos_i + eta_cos_t)
    r_p = (eta * eta * cos_i - eta_cos_t) / (eta * eta * cos_i + eta_cos_t)
    return 0.5 * (r_s * r_s + r_p * r_p), eta_cos_t / eta


@numba.njit(cache=True)
def _lambda(alpha: float, cosine: float) -> float:
    return 0.5 * (math.sqrt(1.0 + alpha * alpha * max(1.0 / (cosine * cosine) - 1.0, 0.0)) - 1.0)


@numba.njit(cache=True)
def _visible_mean(
    roughness: float, cosine: float, eta: float, mode: int, nodes: FloatArray, weights: FloatArray, angles: int
) -> float:
    """Mean over visible normals; `mode` 0 reflection, 1 glass, 2 blend of the Fresnel term, 3 Schlick's blend."""
    alpha = roughness * roughness
    is_delta = alpha * alpha <= DELTA_ALPHA_SQUARED
    sine = math.sqrt(1.0 - cosine * cosine)
    f0 = ((eta - 1.0) / (eta + 1.0)) ** 2
    length = math.sqrt(alpha * alpha * sine * sine + cosine * cosine)
    x_o, z_o = alpha * sine / length, cosine / length
    masking = 1.0 + _lambda(alpha, cosine)
    total = 0.0
    for a in range(angles):
        phi = math.pi * (a + 0.5) / angles
        for k in range(nodes.size):
            z = (1.0 - nodes[k]) * (1.0 + z_o) - z_o
            radius = math.sqrt(max(1.0 - z * z, 0.0))
            h_x, h_y, h_z = alpha * (radius * math.cos(phi) + x_o), alpha * radius * math.sin(phi), z + z_o
            if is_delta:
                h_x, h_y, h_z = 0.0, 0.0, 1.0
            scale = 1.0 / math.sqrt(h_x * h_x + h_y * h_y + h_z * h_z)
            h_x, h_z = h_x * scale, h_z * scale
            cos_h = h_x * sine + h_z * cosine
            reflected_z = 2.0 * cos_h * h_z - cosine
            value = 0.0
            if mode == 3:
                value = (1.0 - cos_h) ** 5 if reflected_z > 0.0 else 0.0
            else:
                f, cos_t = _fresnel(cos_h, eta)
                if mode == 2:
                    blend = (f - f0) / (1.0 - f0)
                    value = min(max(blend, 0.0), 1.0) if reflected_z > 0.0 else 0.0
                else:
                    if reflected_z > 0.0:
                        share = 1.0 if mode == 0 else f
                        value = share if is_delta else share * masking / (masking + _lambda(alpha, reflected_z))
                    if mode == 1 and f < 1.0:
                        refracted_z = (cos_h / eta - cos_t) * h_z - cosine / eta
                        # Refraction to the viewer's own side counts, although such samples are rejected: Cycles' table
                        # has it so, and with it the energy that glass seen from within loses at grazing angles.
                        if refracted_z != 0.0:
                            if is_delta or abs(eta - 1.0) < MIN_ETA_STEP:
                                value += 1.0 - f
                            else:
                                value += (1.0 - f) * masking / (masking + _lambda(alpha, refracted_z))
            total += weights[k] * value
    return total / angles


def _axis(count: int, last: float = 1.0) -> FloatArray:
    return np.clip(np.linspace(0.0, 1.0, count), 1e-4, last)


def _table(mode: int, etas: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    """Values (etas, cosines, roughnesses) and their averages over the cosine, (etas, roughnesses)."""
    nodes, weights = np.polynomial.legendre.leggauss(RADIUS_POINTS)
    nodes, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    cosines, cosine_weights = np.polynomial.legendre.leggauss(COSINE_POINTS)
    cosines, cosine_weights = 0.5 * (cosines + 1.0), 0.5 * cosine_weights

    def integrate(points: FloatArray) -> FloatArray:
        mean: Callable[..., float] = _visible_mean
        return np.array(
            [[[mean(r, m, e, mode, nodes, weights, ANGLE_POINTS) for r in _axis(size)] for m in points] for e in etas]
        )

    average = np.einsum("emr,m->er", integrate(cosines), 2.0 * cosines * cosine_weights)
    return integrate(_axis(size)), average


def compute_tables() -> dict[str, npt.NDArray[np.float32]]:
    """All tables but sheen, by the names of `TABLE_SHAPES`."""
    z = _axis(16, 0.99)
    etas = ((1.0 + z**2) / (1.0 - z**2)).astype(np.float32).astype(np.float64)
    glossy, glossy_mean = _table(0, np.ones(1), 32)
    above, above_mean = _table(1, etas, 16)
    below, below_mean = _table(1, 1.0 / etas, 16)
    tables = {
        "glossy_albedo": glossy,
        "glossy_mean": glossy_mean,
        "glass_albedo": np.concatenate([above, below]),
        "glass_mean": np.stack([above_mean, below_mean]),
        "fresnel_blend": _table(2, etas, 16)[0],
        "schlick_blend": _table(3, np.ones(1), 16)[0],
    }
    return {name: table.astype(np.float32).reshape(TABLE_SHAPES[name]) for name, table in tables.items()}


def main() -> None:
    """Write the file of tables anew, keeping the sheen fit that is in it."""
    sheen = np.zeros(TABLE_SHAPES["sheen"], np.float32)
    if TABLES_FILE.is_file():
        with np.load(TABLES_FILE) as stored:
            sheen = stored["sheen"]
    np.savez_compressed(TABLES_FILE, sheen=sheen, **compute_tables())


if __name__ == "__main__":
    main()
