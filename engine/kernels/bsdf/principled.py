# SPDX-License-Identifier: GPL-3.0-or-later
"""Principled BSDF. (Being built: only its diffuse part for now.)"""

from engine.jit import kernel
from engine.kernels.bsdf.closures import append_closure
from engine.kernels.bsdf.kinds import DIFFUSE


@kernel
def add_principled(
    closures,
    tables,
    lane,
    weight,
    wo,
    ng,
    n,
    coat_normal,
    tangent,
    is_backfacing,
    distribution,
    base_color,
    metallic,
    roughness,
    diffuse_roughness,
    ior,
    specular_level,
    specular_tint,
    anisotropic,
    anisotropic_rotation,
    transmission,
    coat_weight,
    coat_roughness,
    coat_ior,
    coat_tint,
    sheen_weight,
    sheen_roughness,
    sheen_tint,
    emission_color,
    emission_strength,
    alpha,
):
    weight = (weight[0] * base_color[0], weight[1] * base_color[1], weight[2] * base_color[2])
    append_closure(closures, lane, DIFFUSE, weight, n)
