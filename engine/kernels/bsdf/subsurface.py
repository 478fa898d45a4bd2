# SPDX-License-Identifier: GPL-3.0-or-later
"""The lobe of light that goes in below the surface, and the Subsurface Scattering node.

It has no value in any direction: it is sampled only, and what it has sent in comes out elsewhere
(`engine.wavefront.walk_subsurface`). Channels whose radius is next to nothing are Lambert's lobe. All as in Cycles.

References
----------
Jensen et al. 2001, "A Practical Model for Subsurface Light Transport", Eq. (5) and the fit of the mean Fresnel
reflectance: what makes skin's radius a mean free path.
"""

import math
from typing import NamedTuple

import numpy as np

from engine.kernels.bsdf.closures import append_closure, average
from engine.kernels.bsdf.closures import read3 as read_param
from engine.kernels.bsdf.kinds import CLOSURE_IS_BEHIND_DIFFUSE, DIFFUSE, SUBSURFACE, WEIGHT_CUTOFF
from engine.kernels.bsdf.normals import safe_normal, valid_specular_normal
from engine.kernels.constants import INV_PI
from engine.kernels.memory import read3
from engine.kernels.vector import scale
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_KIND_PARAMS, CLOSURE_N, CLOSURE_SAMPLE_WEIGHT, CLOSURE_WEIGHT

# Values of SUBSURFACE_METHOD.
BURLEY = 0
RANDOM_WALK = 1
RANDOM_WALK_LEGACY = 2
RANDOM_WALK_SKIN = 3

# Columns of Closures.param.
SUBSURFACE_METHOD = CLOSURE_KIND_PARAMS + 1
SUBSURFACE_IOR = CLOSURE_KIND_PARAMS + 2
SUBSURFACE_ALPHA = CLOSURE_KIND_PARAMS + 3
SUBSURFACE_G = CLOSURE_KIND_PARAMS + 4
#: Mean free path of the channel that goes farthest [m], and those of all over it (4).
SUBSURFACE_SCALE = CLOSURE_KIND_PARAMS + 5
SUBSURFACE_ALBEDO = CLOSURE_KIND_PARAMS + 6
SUBSURFACE_RADIUS = CLOSURE_KIND_PARAMS + 10
#: 1 where the material has bumps, which what comes out has too.
SUBSURFACE_IS_BUMPED = CLOSURE_KIND_PARAMS + 14

#: Shorter radii are none [m] (Cycles' threshold).
_LEAST_RADIUS = np.float32(1e-8)
#: By which Burley's radius and that of older walks are shortened, to look like older models (Cycles).
_OLD_SCALE = np.float32(0.25) * INV_PI
_BISECTIONS = 12


class SubsurfaceInputs(NamedTuple):
    """A node's inputs as they come: `add_subsurface` clamps them as Cycles does.

    Attributes
    ----------
    method : int, BURLEY to RANDOM_WALK_SKIN
    weight : float32, the share of the Principled BSDF's base
    radius : tuple of 3 float32, in units of `scale`
    scale : float32 [m]
    ior, anisotropy : float32
    """

    method: int
    weight: float
    radius: tuple[float, float, float]
    scale: float
    ior: float
    anisotropy: float


@kernel
def _reduced_albedo(reflectance, boundary):
    """Reduced single-scattering albedo of a half-space that sends back `reflectance`: Jensen et al., inverted.

    Parameters
    ----------
    boundary : float32, 4/3 of A
    """
    if reflectance < 1e-4:
        return np.float32(0.0)
    if reflectance >= 0.995:
        return np.float32(0.999999)
    low, high, middle = np.float32(0.0), np.float32(1.0), np.float32(0.0)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        s = math.sqrt(3.0 * (1.0 - middle))
        if 0.5 * middle * (1.0 + math.exp(-boundary * s)) * math.exp(-s) < reflectance:
            low = middle
        else:
            high = middle
    return middle


@kernel
def _mean_free_paths(method, radius, albedo, ior):
    """Mean free paths [m] of a node's radii, 3-tuples."""
    if method == RANDOM_WALK:
        return radius
    if method != RANDOM_WALK_SKIN:
        return scale(radius, _OLD_SCALE)
    inverse = 1.0 / ior
    reflected = inverse * (0.71 - 1.44 * inverse) + 0.668 + 0.0636 * ior
    boundary = (4.0 / 3.0) * (1.0 + reflected) / (1.0 - reflected)
    return (
        radius[0] * math.sqrt(3.0 * (1.0 - _reduced_albedo(albedo[0], boundary))),
        radius[1] * math.sqrt(3.0 * (1.0 - _reduced_albedo(albedo[1], boundary))),
        radius[2] * math.sqrt(3.0 * (1.0 - _reduced_albedo(albedo[2], boundary))),
    )


@kernel
def add_subsurface(closures, lane, weight, albedo, n, valid_n, alpha, inputs):
    """Append the lobe, and Lambert's for channels whose radius is next to nothing.

    Parameters
    ----------
    weight : tuple of 3 float32
        The albedo included.
    albedo : tuple of 3 float32
        What a half-space is to send back.
    n, valid_n : tuple of 3 float32
        The node's normal, and what `valid_specular_normal` makes of it.
    alpha : float32
        Roughness of the surface that light goes in through.
    inputs : SubsurfaceInputs
    """
    radius = (
        max(inputs.radius[0] * inputs.scale, 0.0),
        max(inputs.radius[1] * inputs.scale, 0.0),
        max(inputs.radius[2] * inputs.scale, 0.0),
    )
    # Written so that NaN is none.
    if inputs.method == BURLEY and closures.flags[lane] & CLOSURE_IS_BEHIND_DIFFUSE:
        # There it would add noise, and little that is seen (Cycles).
        radius = (0.0 * radius[0], 0.0 * radius[1], 0.0 * radius[2])
    deep = (radius[0] >= _LEAST_RADIUS, radius[1] >= _LEAST_RADIUS, radius[2] >= _LEAST_RADIUS)
    if not abs(average(weight)) >= WEIGHT_CUTOFF:
        return
    flat = (
        0.0 if deep[0] else weight[0],
        0.0 if deep[1] else weight[1],
        0.0 if deep[2] else weight[2],
    )
    count = np.float32(0.0)
    for c in range(3):
        if deep[c]:
            count += 1.0
    if count < 3.0:
        append_closure(closures, lane, DIFFUSE, flat, valid_n)
        weight = (
            weight[0] if deep[0] else 0.0,
            weight[1] if deep[1] else 0.0,
            weight[2] if deep[2] else 0.0,
        )
    i = append_closure(closures, lane, SUBSURFACE, weight, valid_n)
    if i < 0:
        return
    param = closures.param
    ior = min(max(inputs.ior, 1.01), 3.8)
    most = 0.99 if inputs.method == RANDOM_WALK else 0.9
    paths = _mean_free_paths(inputs.method, radius, albedo, ior)
    longest = max(paths[0], paths[1], paths[2])
    param[lane, i, CLOSURE_SAMPLE_WEIGHT] = average(weight) * count
    param[lane, i, SUBSURFACE_METHOD] = np.float32(inputs.method)
    param[lane, i, SUBSURFACE_IOR] = ior
    param[lane, i, SUBSURFACE_ALPHA] = 1.0 if inputs.method == RANDOM_WALK_SKIN else alpha
    param[lane, i, SUBSURFACE_G] = min(max(inputs.anisotropy, -0.99), most)
    param[lane, i, SUBSURFACE_SCALE] = longest
    for c in range(3):
        param[lane, i, SUBSURFACE_ALBEDO + c] = albedo[c]
        share = paths[c] / longest if longest > 0.0 else 1.0
        param[lane, i, SUBSURFACE_RADIUS + c] = share if deep[c] else 0.0
    ns = closures.ns
    is_bumped = n[0] != ns[lane, 0] or n[1] != ns[lane, 1] or n[2] != ns[lane, 2]
    param[lane, i, SUBSURFACE_IS_BUMPED] = 1.0 if is_bumped else 0.0
    param[lane, i, SUBSURFACE_ALBEDO + 3] = 0.0
    param[lane, i, SUBSURFACE_RADIUS + 3] = 0.0


@kernel(forceinline=True)
def run_subsurface(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, normal, color, roughness, radius, scale, ior, anisotropy | method`."""
    n = safe_normal(read3(memory, code[pc + 3]), view.ns)
    valid_n = valid_specular_normal(closures, lane, view.ng, view.wo, n)
    color = read3(memory, code[pc + 4])
    alpha = min(max(memory[code[pc + 5]], 0.0), 1.0)
    inputs = SubsurfaceInputs(
        code[pc + 10], np.float32(1.0), read3(memory, code[pc + 6]), memory[code[pc + 7]], memory[code[pc + 8]],
        memory[code[pc + 9]],
    )
    add_subsurface(closures, lane, scale(color, weight), color, n, valid_n, alpha, inputs)


@kernel
def exit_normal(closures, lane):
    """Normal of a surface that lets light out: the mean of those of its bumped subsurface lobes, else the smooth one.
    """
    x = y = z = np.float32(0.0)
    for i in range(closures.count[lane]):
        if closures.kind[lane, i] == SUBSURFACE and closures.param[lane, i, SUBSURFACE_IS_BUMPED] != 0.0:
            n = read_param(closures.param, lane, i, CLOSURE_N)
            weight = average(read_param(closures.param, lane, i, CLOSURE_WEIGHT))
            x, y, z = x + weight * n[0], y + weight * n[1], z + weight * n[2]
    ns = (closures.ns[lane, 0], closures.ns[lane, 1], closures.ns[lane, 2])
    return safe_normal((x, y, z), ns)
