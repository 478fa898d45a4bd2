# SPDX-License-Identifier: GPL-3.0-or-later
"""Microfacet closures of the Glossy, Refraction and Glass BSDF. (Being built: lobes are diffuse for now.)"""

from engine.jit import kernel
from engine.kernels.bsdf.closures import append_closure
from engine.kernels.bsdf.kinds import DIFFUSE


@kernel
def add_glossy(
    closures, tables, lane, weight, color, wo, n, tangent, distribution, roughness, anisotropy, rotation
):
    weight = (weight[0] * color[0], weight[1] * color[1], weight[2] * color[2])
    append_closure(closures, lane, DIFFUSE, weight, n)


@kernel
def add_refraction(closures, tables, lane, weight, color, wo, n, distribution, roughness, ior, is_backfacing):
    weight = (weight[0] * color[0], weight[1] * color[1], weight[2] * color[2])
    append_closure(closures, lane, DIFFUSE, weight, n)


@kernel
def add_glass(closures, tables, lane, weight, color, wo, n, distribution, roughness, ior, is_backfacing):
    weight = (weight[0] * color[0], weight[1] * color[1], weight[2] * color[2])
    append_closure(closures, lane, DIFFUSE, weight, n)
