# SPDX-License-Identifier: GPL-3.0-or-later
"""Glass that is rougher along one direction than across it (Blender 5.3).

Such a lobe is linked (`linked.py`), whose kernels refract at anisotropic facets; it is appended as if it were as rough
in all directions, and stretched then. Its energy is that of the geometric mean of its alphas, as of other lobes.
"""

import math

from engine.kernels.bsdf.kinds import ALPHA_X, ALPHA_Y
from engine.kernels.bsdf.linked import TANGENT_ANGLE
from engine.kernels.limits import clamp_unit
from engine.kernels.vector import cross, dot, orthonormal_basis
from engine.runtime.jit import kernel


@kernel
def mean_alpha(alpha_x, alpha_y):
    """Alpha in all directions of facets that are to be stretched."""
    return math.sqrt(clamp_unit(alpha_x) * clamp_unit(alpha_y))


@kernel
def stretch_facets(param, lane, i, n, tangent, alpha_x, alpha_y):
    """Give a linked lobe of facets two alphas.

    Parameters
    ----------
    i : int, the lobe; -1: nothing happens
    n, tangent : tuple of 3 float32
        The lobe's normal, and the direction of `alpha_x`; world space. The tangent need not be orthogonal to `n`; if
        it is parallel or zero the lobe stays as it is.
    alpha_x, alpha_y : float32
    """
    across = cross(n, tangent)
    if i < 0 or not dot(across, across) > 1e-12:
        return
    first, second = orthonormal_basis(n)
    param[lane, i, TANGENT_ANGLE] = math.atan2(dot(tangent, second), dot(tangent, first))
    param[lane, i, ALPHA_X] = clamp_unit(alpha_x)
    param[lane, i, ALPHA_Y] = clamp_unit(alpha_y)
