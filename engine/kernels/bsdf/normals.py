# SPDX-License-Identifier: GPL-3.0-or-later
"""What keeps bumped normals plausible: repair of the normal of specular lobes, softening of the terminator.

And what takes the terminator of smooth normals away from where triangles show (Shadow Terminator Shading Offset).
"""

import math

from engine.kernels.bsdf.kinds import BUMP, CLOSURE_IS_ON_STRAND, CLOSURE_NO_BUMP_CORRECTION, SMOOTH_N
from engine.kernels.vector import add, dot, normalize, scale, subtract
from engine.runtime.jit import kernel


@kernel
def safe_normal(n, fallback):
    """Unit vector along `n`, or `fallback` where `n` is zero or not finite."""
    squared = dot(n, n)
    if abs(squared - 1.0) < 1e-6:
        # As it is: a normal that differs from the smooth one in its last digit would count as bumped.
        return n
    if squared > 0.0 and squared < 1e37:
        return scale(n, 1.0 / math.sqrt(squared))
    return fallback


@kernel
def ensure_valid_specular_reflection(ng, wo, n):
    """Turn `n` towards `ng` just enough for the mirror direction of `wo` to leave the surface.

    Solves, in the plane of n and ng, for the normal whose mirror direction has the least elevation that is still
    accepted: 2 (n.wo) n.ng - wo.ng = min(0.9 wo.ng, 0.01), a quadratic in (n.ng)^2. As Cycles' function of that name.

    Parameters
    ----------
    ng, wo, n : tuple of 3 float32
        Geometric normal on the side of `wo`, direction to the viewer, wanted normal; all unit.
    """
    wo_z = dot(wo, ng)
    elevation = min(0.9 * wo_z, 0.01)
    mirrored_z = 2.0 * dot(n, wo) * dot(n, ng) - wo_z
    if mirrored_z >= elevation:
        return n
    across = normalize(subtract(n, scale(ng, dot(n, ng))))
    wo_x = dot(wo, across)
    a = max(wo_x * wo_x + wo_z * wo_z, 1e-20)
    b = 2.0 * (a + wo_z * elevation)
    c = (elevation + wo_z) * (elevation + wo_z)
    root = math.sqrt(max(b * b - 4.0 * a * c, 0.0))
    n_z_squared = 0.25 * (b + root if wo_x < 0.0 else b - root) / a
    n_x = math.sqrt(max(1.0 - n_z_squared, 0.0))
    n_z = math.sqrt(max(n_z_squared, 0.0))
    return add(scale(across, n_x), scale(ng, n_z))


@kernel
def valid_specular_normal(closures, lane, ng, wo, n):
    """`ensure_valid_specular_reflection` unless the material turned bump correction off, `n` is `ng`, or on curves."""
    if closures.flags[lane] & (CLOSURE_NO_BUMP_CORRECTION | CLOSURE_IS_ON_STRAND):
        return n
    if n[0] == ng[0] and n[1] == ng[1] and n[2] == ng[2]:
        return n
    return ensure_valid_specular_reflection(ng, wo, n)


@kernel
def bump_shadowing(param, lane, i, n, wi, is_diffuse, is_sampled):
    """Factor in [0, 1] on a bumped lobe: 0 where light would leak through, a soft terminator for diffuse lobes.

    A direction on one side of the bumped normal and on the other of the smooth one is rejected, except for a
    specular lobe's own sample. What a lobe itself has sent through the surface, a translucent one's sample too, is
    neither rejected nor softened (Cycles).

    Masking of Conty Estevez, Lecocq and Stein 2019, "A Microfacet-Based Shadowing Function
    to Solve the Bump Terminator Problem", in the unidirectional Smith form that Cycles uses.
    """
    if is_sampled and dot(n, wi) < 0.0:
        return 1.0
    ns = (param[lane, i, SMOOTH_N], param[lane, i, SMOOTH_N + 1], param[lane, i, SMOOTH_N + 2])
    cos_i = dot(ns, wi)
    cos_d = dot(ns, n)
    if cos_i * cos_d * dot(n, wi) < 0.0 and (is_diffuse or not is_sampled):
        return 0.0
    if not is_diffuse or param[lane, i, BUMP] >= 2.0:
        return 1.0
    cos_i *= cos_i
    cos_d *= cos_d
    if cos_d >= 1.0 or cos_i >= 1.0:
        return 1.0
    if cos_i < 1e-12:
        return 0.0
    alpha_squared = min(0.125 * (1.0 / cos_d - 1.0), 1.0)
    return 2.0 / (1.0 + math.sqrt(1.0 + alpha_squared * (1.0 / cos_i - 1.0)))


@kernel
def shift_shading(bump, cosine):
    """Factor in [0, 1] on what a lobe sends towards light that meets its normal at `cosine`.

    The angle of incidence counts as larger, so that the terminator lies where triangles do not show yet. As Cycles'
    `shift_cos_in`: cos(theta / (1 - offset / 2)) over cos(theta). What goes through the surface is as it was.

    Parameters
    ----------
    bump : float32
        Column BUMP of the lobe.
    """
    half_offset = bump - math.floor(bump)
    if half_offset == 0.0 or cosine <= 0.0:
        return 1.0
    cosine = min(cosine, 1.0)
    return max(math.cos(math.acos(cosine) / (1.0 - half_offset)), 0.0) / cosine


@kernel
def terminator_factor(param, lane, i, n, wi, is_diffuse, is_sampled):
    """Factor in [0, 1] on a lobe whose column BUMP is not 0: `bump_shadowing` and `shift_shading`."""
    bump = param[lane, i, BUMP]
    factor = shift_shading(bump, dot(n, wi))
    if bump >= 1.0:
        factor *= bump_shadowing(param, lane, i, n, wi, is_diffuse, is_sampled)
    return factor
