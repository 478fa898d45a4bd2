# SPDX-License-Identifier: GPL-3.0-or-later
"""The Hair BSDF: light off a fibre on the side that it came from, or through it, in cones about the tangent.

References
----------
Marschner et al. 2003, "Light Scattering from Human Hair Fibers"; its lobes as Cycles fits them, by a Cauchy
distribution along the fibre.

Which side of the fibre light comes out on is asked of light samples alone, as in Cycles: they find nothing on the side
that a component does not send light to. Scattered rays, whoever proposed them, go to either side of the normal and
carry all of it, else white fur would lose a part of its light each time that a ray meets a fibre.
"""

import math

import numpy as np

from engine.kernels.bsdf.closures import append_closure, read3
from engine.kernels.bsdf.kinds import CHIANG, HAIR_REFLECTION, HAIR_TRANSMISSION, HUANG
from engine.kernels.bsdf.lobe import HairLobe
from engine.kernels.bsdf.normals import valid_specular_normal
from engine.kernels.constants import PI
from engine.kernels.memory import read3 as read_operand
from engine.kernels.vector import add, cross, dot, normalize, orthonormal_basis, scale, subtract
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_KIND_PARAMS, CLOSURE_N, CLOSURE_WEIGHT

# Columns of Closures.param.
HAIR_TANGENT = CLOSURE_KIND_PARAMS + 1  # 3 columns, of all kinds of fibres
_ALONG = CLOSURE_KIND_PARAMS + 4  # roughness along the fibre, and around it
_AROUND = CLOSURE_KIND_PARAMS + 5
_OFFSET = CLOSURE_KIND_PARAMS + 6  # tilt of the scales [rad]

_HALF_PI = np.float32(0.5 * math.pi)
#: So near to the tangent nothing is scattered [rad].
_LEAST_ANGLE = np.float32(1e-3)


@kernel
def safe_asin(x):
    """Arc sine of what rounding may have made larger than one."""
    return math.asin(min(max(x, -1.0), 1.0))


@kernel
def fibre_tangent(view, edge):
    """Unit tangent of the fibre that a closure is on; on other surfaces an edge of the triangle, else any along it."""
    if dot(view.tangent, view.tangent) > 0.0:
        return normalize(view.tangent)
    if dot(edge, edge) > 0.0:
        return normalize(edge)
    tangent, _ = orthonormal_basis(view.ns)
    return tangent


@kernel(forceinline=True)
def run_hair(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, color, roughness along, roughness around, offset, tangent, edge | is transmission`.

    A tangent of zero is that of the curve. On other surfaces it is the edge, and nothing is tilted there, as in Cycles.
    """
    kind = HAIR_TRANSMISSION if code[pc + 9] != 0 else HAIR_REFLECTION
    n = valid_specular_normal(closures, lane, view.ng, view.wo, view.ns)
    i = append_closure(closures, lane, kind, scale(read_operand(memory, code[pc + 3]), weight), n)
    if i < 0:
        return
    param = closures.param
    tangent = read_operand(memory, code[pc + 7])
    offset = -memory[code[pc + 6]]
    if dot(tangent, tangent) > 0.0:
        tangent = normalize(tangent)
    else:
        tangent = fibre_tangent(view, read_operand(memory, code[pc + 8]))
        if not dot(view.tangent, view.tangent) > 0.0:
            offset = 0.0
    for k in range(3):
        param[lane, i, HAIR_TANGENT + k] = tangent[k]
    param[lane, i, _ALONG] = min(max(memory[code[pc + 4]], 0.001), 1.0)
    param[lane, i, _AROUND] = min(max(memory[code[pc + 5]], 0.001), 1.0)
    param[lane, i, _OFFSET] = offset


@kernel
def _bounds(param, lane, i, theta_o):
    """The Cauchy distribution's angles at the ends of the fibre."""
    along, offset = param[lane, i, _ALONG], param[lane, i, _OFFSET]
    high = math.atan((0.5 * (_HALF_PI + theta_o) - offset) / along)
    low = math.atan((0.5 * (theta_o - _HALF_PI) - offset) / along)
    return low, high


@kernel
def _density_along(param, lane, i, theta_o, theta_i):
    """Density by the angle to the normal plane, over the circle's length there."""
    along = param[lane, i, _ALONG]
    low, high = _bounds(param, lane, i, theta_o)
    t = 0.5 * (theta_i + theta_o) - param[lane, i, _OFFSET]
    return along / (2.0 * (t * t + along * along) * (high - low) * math.cos(theta_i))


@kernel
def _around(param, lane, i, wo, wi):
    """Angles to the normal plane of both directions, and the cosine of that between them around the fibre."""
    tangent = read3(param, lane, i, HAIR_TANGENT)
    sin_o, sin_i = dot(tangent, wo), dot(tangent, wi)
    o = normalize(subtract(wo, scale(tangent, sin_o)))
    a = normalize(subtract(wi, scale(tangent, sin_i)))
    return safe_asin(sin_o), safe_asin(sin_i), min(max(dot(a, o), -1.0), 1.0)


@kernel
def _add(param, channels, lane, i, pdf, value, factor, out, row):
    for c in range(len(channels)):
        out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * value * factor
    return pdf


@kernel
def eval_hair_reflection(param, channels, lane, i, n, wo, wi, factor, out, row):
    """See `Lobe.evaluate`."""
    theta_o, theta_i, cos_phi = _around(param, lane, i, wo, wi)
    if cos_phi < 0.0 or _HALF_PI - abs(theta_i) < _LEAST_ANGLE:
        return 0.0
    around = param[lane, i, _AROUND]
    phi = min(math.acos(cos_phi) / around, PI)
    pdf = math.cos(0.5 * phi) * 0.25 / around * _density_along(param, lane, i, theta_o, theta_i)
    return _add(param, channels, lane, i, pdf, pdf, factor, out, row)


@kernel
def eval_hair_transmission(param, channels, lane, i, n, wo, wi, factor, out, row):
    """See `Lobe.evaluate`."""
    theta_o, theta_i, cos_phi = _around(param, lane, i, wo, wi)
    if _HALF_PI - abs(theta_i) < _LEAST_ANGLE:
        return 0.0
    around = param[lane, i, _AROUND]
    rest = PI - math.acos(cos_phi)
    whole = 2.0 * math.atan(_HALF_PI / around)
    value = around / (whole * (rest * rest + around * around)) * _density_along(param, lane, i, theta_o, theta_i)
    # Beyond half a turn no ray goes. Light samples do (Cycles).
    pdf = value if rest <= _HALF_PI else 0.0
    return _add(param, channels, lane, i, pdf, value if dot(n, n) > 0.0 else pdf, factor, out, row)


@kernel
def _direction(param, lane, i, wo, theta_o, phi, u):
    """A direction at an angle around the fibre from the viewer's, and along it as the Cauchy distribution has it."""
    tangent = read3(param, lane, i, HAIR_TANGENT)
    low, high = _bounds(param, lane, i, theta_o)
    t = param[lane, i, _ALONG] * math.tan(u * (high - low) + low)
    theta_i = 2.0 * (t + param[lane, i, _OFFSET]) - theta_o
    y = normalize(subtract(wo, scale(tangent, dot(tangent, wo))))
    x = cross(y, tangent)
    across = add(scale(y, math.cos(phi)), scale(x, -math.sin(phi)))
    return normalize(add(scale(across, math.cos(theta_i)), scale(tangent, math.sin(theta_i))))


@kernel
def hair_roughness(param, lane, i):
    """Geometric mean of both roughnesses."""
    return math.sqrt(param[lane, i, _ALONG] * param[lane, i, _AROUND])


@kernel
def feature_normal(closures, lane, i, wo):
    """What closure `i` says of its surface to denoisers: its normal, as a rule.

    Of fibres by Chiang's model it is the direction across them; by Huang's, which are seen from afar, that along
    them (Cycles).
    """
    kind = closures.kind[lane, i]
    if kind == HUANG:
        return read3(closures.param, lane, i, HAIR_TANGENT)
    if kind == CHIANG:
        return normalize(cross(read3(closures.param, lane, i, HAIR_TANGENT), wo))
    return read3(closures.param, lane, i, CLOSURE_N)


@kernel
def whole_albedo(param, lane, i, wo, c):
    """That of a lobe which loses nothing."""
    return 1.0 + 0.0 * wo[0]


@kernel
def sample_hair_reflection(param, channels, lane, i, wo, u0, u1, u2):
    """See `HairLobe.sample`."""
    theta_o = safe_asin(dot(read3(param, lane, i, HAIR_TANGENT), wo))
    phi = 2.0 * safe_asin(1.0 - 2.0 * u2) * param[lane, i, _AROUND]
    return _direction(param, lane, i, wo, theta_o, phi, u1)


@kernel
def sample_hair_transmission(param, channels, lane, i, wo, u0, u1, u2):
    """See `HairLobe.sample`."""
    theta_o = safe_asin(dot(read3(param, lane, i, HAIR_TANGENT), wo))
    around = param[lane, i, _AROUND]
    whole = 2.0 * math.atan(_HALF_PI / around)
    phi = PI + around * math.tan(whole * (u2 - 0.5))
    return _direction(param, lane, i, wo, theta_o, phi, u1)


LOBES = (
    HairLobe(HAIR_REFLECTION, eval_hair_reflection, sample_hair_reflection, hair_roughness, whole_albedo),
    HairLobe(HAIR_TRANSMISSION, eval_hair_transmission, sample_hair_transmission, hair_roughness, whole_albedo),
)
