# SPDX-License-Identifier: GPL-3.0-or-later
"""The Principled Hair BSDF of Huang: a fibre of elliptical cross section whose surface is made of facets.

What such a fibre scatters is an integral over where across it a ray arrives, and over the facets that it meets inside.
Some ways through the fibre are drawn when its closures are added, one for each (`huang_path`). Given a way, each lobe
is that of the facets where light leaves, so that value and density have closed forms, and light samples, BSDF samples
and guides agree exactly. The mean over what is drawn is the model.

References
----------
Huang, Hullin and Hanika 2022, "A Microfacet-based Hair Scattering Model"; Chiang et al. 2016 for what is reflected
inside more than once.
"""

import math

import numpy as np

from engine.kernels.bsdf.chiang import cos_of, longitudinal, sample_longitudinal
from engine.kernels.bsdf.closures import append_closure, read3, store_color
from engine.kernels.bsdf.fibre_color import absorption, passed_along_radius
from engine.kernels.bsdf.fresnel import fresnel_dielectric
from engine.kernels.bsdf.hair import HAIR_TANGENT, fibre_tangent
from engine.kernels.bsdf.huang_path import (
    angle_of,
    angles,
    energy_scale,
    facet_numbers,
    facing,
    first_facet,
    refracted,
    sample_facet,
    second_facet,
    shadowing,
    side_at,
    side_of,
    spherical,
    third_facet,
    tilted,
)
from engine.kernels.bsdf.kinds import HUANG, HUANG_ALPHA
from engine.kernels.bsdf.lobe import HairLobe
from engine.kernels.bsdf.no_lobes import add_transparent
from engine.kernels.constants import INV_PI, PI
from engine.kernels.memory import read3 as read_operand
from engine.kernels.rng import hash_combine
from engine.kernels.vector import (
    add,
    cross,
    dot,
    negate,
    normalize,
    orthonormal_basis,
    scale,
    subtract,
    to_local,
    to_world,
)
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_KIND_PARAMS, CLOSURE_N, CLOSURE_WEIGHT, MAX_CLOSURES

# Columns of Closures.param.
_TURN = CLOSURE_KIND_PARAMS + 4  # from the tangent's own basis to the major axis [rad]
_PASSED = CLOSURE_KIND_PARAMS + 5  # along a radius: exp(-absorption), a colour
_GAMMA = CLOSURE_KIND_PARAMS + 9  # where the ray enters, see `huang_path`
_THETA = CLOSURE_KIND_PARAMS + 10  # its way inside
_PHI = CLOSURE_KIND_PARAMS + 11
_THETA_BACK = CLOSURE_KIND_PARAMS + 12  # that after it was reflected, backwards
_PHI_BACK = CLOSURE_KIND_PARAMS + 13
# Factors of the lobes but for what happens where light leaves, and for absorption: R, TT, TRT, all others.
_R, _TT, _TRT, _REST = (CLOSURE_KIND_PARAMS + 14 + k for k in range(4))
_LEAVES = CLOSURE_KIND_PARAMS + 18  # of the light that is left after TRT, at each further facet
_ASPECT = CLOSURE_KIND_PARAMS + 19  # minor axis over major axis
_TILT = CLOSURE_KIND_PARAMS + 20  # of the scales [rad]
_ETA = CLOSURE_KIND_PARAMS + 21

_INV_TWO_PI = np.float32(0.5 / math.pi)
_TWO_PI = np.float32(2.0 * math.pi)
#: A refractive index so near to 1 bends nothing, and its lobes would be deltas.
_LEAST_STEP = np.float32(1e-3)
#: Ways through the fibre, spread evenly across it (docs/decisions/kernels-and-speed.md).
_WAY_COUNT = 8
#: Least share of the light at a facet by which lobes are chosen: facets differ.
_LEAST_SHARE = np.float32(0.05)


@kernel
def _major_axis(view, tangent, normal, aspect):
    """The ellipse's major axis: the strand's normal; of circles and on other surfaces, across to the viewer."""
    axis = normalize(cross(tangent, view.wo))
    if aspect != 1.0 and dot(view.tangent, view.tangent) > 0.0:
        axis = normalize(cross(tangent, normalize(cross(normal, tangent))))
    if dot(axis, axis) > 0.5:
        return axis
    x, y, z = tangent
    other = (z - y, x - z, y - x)
    if x == y and x == z:
        other = (z - y, x + z, -y - x)
    return cross(tangent, normalize(other))


@kernel
def _meeting(view, aspect, normal, edge):
    """The axes, the viewer's direction in them, where across the fibre the ray meets it, and the ellipse's half width.

    The last two are in the half width of a circle.
    """
    tangent = fibre_tangent(view, edge)
    x = _major_axis(view, tangent, normal, aspect)
    z = normalize(cross(x, tangent))
    v = to_local(view.wo, x, tangent, z)
    h = -dot(normalize(cross(tangent, view.wo)), view.ns)
    across = v[0] * v[0] + v[2] * v[2]
    width = math.sqrt(max(1.0 - (1.0 - aspect * aspect) * v[0] * v[0] / max(across, 1e-20), 0.0))
    return tangent, x, z, v, h, width


@kernel
def _aspect_of(value, view):
    """Minor over major axis; on other surfaces than strands it may be more than 1."""
    if value > 1.0 and dot(view.tangent, view.tangent) > 0.0:
        value = 1.0 / value
    return max(value, 1e-3)


@kernel(forceinline=True)
def run_huang_outside(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, aspect ratio, normal`: lets light through where the ellipse is narrower than the strand."""
    if not dot(view.tangent, view.tangent) > 0.0:
        return
    aspect = _aspect_of(memory[code[pc + 3]], view)
    _, _, _, _, h, width = _meeting(view, aspect, read_operand(memory, code[pc + 4]), (0.0, 0.0, 0.0))
    if not abs(h) < width:
        add_transparent(closures, lane, (weight, weight, weight))


@kernel
def _seed_of(view):
    """What is drawn follows from this uint32."""
    seed = np.float32(view.random).view(np.uint32)
    for k in range(3):
        seed = hash_combine(seed, np.float32(view.wo[k]).view(np.uint32))
        seed = hash_combine(seed, np.float32(view.ns[k]).view(np.uint32))
    return seed


@kernel
def _drawn_gamma(view, v, aspect, h, width, thickness, random):
    """Where a ray enters: anywhere across the fibre, or within its pixel where the camera sees the fibre so wide.

    References: Yan et al. 2017, "An Efficient and Practical Near and Far Field Fur Reflectance Model".
    """
    low, high = -1.0 + 0.0 * h, 1.0 + 0.0 * h
    if view.footprint >= 0.0 and thickness > 0.0:
        half = view.footprint / thickness
        if width > half:
            low = max((h - half) / width, -1.0)
            high = min((h + half) / width, 1.0)
    at = min(max(low + random * (high - low), -1.0), 1.0)
    return math.atan2(v[2], -aspect * v[0]) - math.acos(-at)


@kernel
def _trace(param, data, lane, i, v, gamma, seed, number):
    """Draw the ray's way through the fibre and set the lobes' factors, which hold those of the node."""
    alpha, eta, b = param[lane, i, HUANG_ALPHA], param[lane, i, _ETA], param[lane, i, _ASPECT]
    tilt = (math.cos(param[lane, i, _TILT]), math.sin(param[lane, i, _TILT]))
    of_tt, of_trt = param[lane, i, _TT], param[lane, i, _TRT]
    param[lane, i, _GAMMA] = gamma
    for column in (_THETA, _PHI, _THETA_BACK, _PHI_BACK, _TT, _TRT, _REST, _LEAVES):
        param[lane, i, column] = 0.0
    side = side_at(gamma, b)
    scaled = energy_scale(data, dot(tilted(side, tilt), v), alpha, eta)
    param[lane, i, _R] *= scaled
    inside, share = first_facet(alpha, tilt, eta, side, v, facet_numbers(seed, number, 0))
    if not share > 0.0:
        return
    theta, phi = angles(inside)
    turn = angle_of(phi, b)
    w = negate(inside)
    side = side_at(2.0 * turn - gamma, b)
    tilt = (tilt[0], -tilt[1])
    back, reflected, shown = second_facet(alpha, tilt, eta, side, w, facet_numbers(seed, number, 1))
    if shown < 0.0:
        return
    share *= scaled * energy_scale(data, dot(tilted(side, tilt), w), alpha, 1.0 / eta)
    param[lane, i, _THETA] = theta
    param[lane, i, _PHI] = phi
    param[lane, i, _TT] = of_tt * share
    if not (of_trt > 0.0 and shown > 0.0):
        return
    theta, phi = angles(back)
    m = tilted(side_at(gamma - 2.0 * (turn - angle_of(phi, b)) + PI, b), tilt)
    if not dot(m, back) > 0.0:
        return
    again, stays = third_facet(alpha, m, eta, back, facet_numbers(seed, number, 2))
    share *= reflected * shown * energy_scale(data, dot(m, back), alpha, 1.0 / eta)
    param[lane, i, _THETA_BACK] = theta
    param[lane, i, _PHI_BACK] = phi
    param[lane, i, _TRT] = of_trt * share
    param[lane, i, _REST] = share * again * stays
    param[lane, i, _LEAVES] = max(0.5 * (1.0 - reflected + 1.0 - again), 1e-5)


@kernel(forceinline=True)
def run_huang(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, color or absorption, tint, melanin, redness, its randomness, roughness, its randomness,
    offset, ior, random, aspect ratio, R, TT, TRT, thickness, normal, edge | FIBRE_*`; the edge is of the
    triangle, where the surface is no strand.
    """
    of_r, of_tt, of_trt = memory[code[pc + 14]], memory[code[pc + 15]], memory[code[pc + 16]]
    if not max(of_r, of_tt, of_trt) > 0.0:
        return
    aspect = _aspect_of(memory[code[pc + 13]], view)
    tangent, x, _, v, h, width = _meeting(
        view, aspect, read_operand(memory, code[pc + 18]), read_operand(memory, code[pc + 19])
    )
    if not abs(h) < width:
        add_transparent(closures, lane, (weight, weight, weight))
        return
    random = 2.0 * (memory[code[pc + 12]] - 0.5)
    alpha = memory[code[pc + 8]] * (1.0 + random * memory[code[pc + 9]])
    sigma = absorption(code[pc + 20], memory, code, pc, random, alpha)
    first, second = orthonormal_basis(tangent)
    turn = math.atan2(dot(second, x), dot(first, x))
    passed = passed_along_radius(sigma)
    eta = max(memory[code[pc + 11]], 0.01)
    if abs(eta - 1.0) < _LEAST_STEP:
        eta = 1.0 + _LEAST_STEP
    seed = _seed_of(view)
    # Lobes of other nodes need a place too.
    count = max(min(_WAY_COUNT, (MAX_CLOSURES - closures.count[lane]) // 2), 1)
    weight /= np.float32(count)
    for k in range(count):
        i = append_closure(closures, lane, HUANG, (weight, weight, weight), view.ns)
        if i < 0:
            return
        param = closures.param
        for c in range(3):
            param[lane, i, HAIR_TANGENT + c] = tangent[c]
        param[lane, i, _TURN] = turn
        store_color(param, lane, i, _PASSED, passed)
        param[lane, i, HUANG_ALPHA] = min(max(alpha, 0.001), 1.0)
        param[lane, i, _ASPECT] = aspect
        param[lane, i, _TILT] = -memory[code[pc + 10]]
        param[lane, i, _ETA] = eta
        param[lane, i, _R] = max(of_r, 0.0)
        param[lane, i, _TT] = max(of_tt, 0.0)
        param[lane, i, _TRT] = max(of_trt, 0.0)
        across = view.random + np.float32(k) / np.float32(count)
        gamma = _drawn_gamma(view, v, aspect, h, width, memory[code[pc + 17]], across - math.floor(across))
        _trace(param, tables.data, lane, i, v, gamma, seed, k)


@kernel
def _axes(param, lane, i):
    tangent = (param[lane, i, HAIR_TANGENT], param[lane, i, HAIR_TANGENT + 1], param[lane, i, HAIR_TANGENT + 2])
    first, second = orthonormal_basis(tangent)
    turn = param[lane, i, _TURN]
    x = add(scale(first, math.cos(turn)), scale(second, math.sin(turn)))
    return x, tangent, cross(x, tangent)


@kernel
def _sides(param, lane, i):
    """Where light enters and leaves by TT and TRT: normals there (x, z), and the ways from each to the next [radii]."""
    gamma, b, phi = param[lane, i, _GAMMA], param[lane, i, _ASPECT], param[lane, i, _PHI]
    turn, turn_back = angle_of(phi, b), angle_of(param[lane, i, _PHI_BACK], b)
    gamma_2 = 2.0 * turn - gamma
    gamma_3 = gamma - 2.0 * (turn - turn_back) + PI
    s_1, c_1 = math.sin(gamma), math.cos(gamma)
    s_2, c_2 = math.sin(gamma_2), math.cos(gamma_2)
    s_3, c_3 = math.sin(gamma_3), math.cos(gamma_3)
    # The inward normal's parameter is that of the point on the other side.
    way = _distance(s_1 + s_2, b * (c_1 + c_2)) / max(math.cos(param[lane, i, _THETA]), 1e-6)
    way_back = _distance(s_2 - s_3, b * (c_2 - c_3)) / max(math.cos(param[lane, i, _THETA_BACK]), 1e-6)
    return side_of(s_1, c_1, b), side_of(s_2, c_2, b), side_of(s_3, c_3, b), way, way_back


@kernel
def _distance(x, z):
    return math.sqrt(x * x + z * z)


@kernel
def _left(param, lane, i, way, way_back, c):
    """What of a channel is not absorbed until light leaves: by TT, by TRT, later."""
    passed = param[lane, i, _PASSED + c]
    tt = passed**way
    trt = tt * passed**way_back
    mean, leaves = math.sqrt(trt), param[lane, i, _LEAVES]
    return tt, trt, trt * mean * leaves / max(1.0 - mean * (1.0 - leaves), 1e-6)


@kernel
def _shares(param, lane, i, v, w_2, w_3, sides, tilt, left):
    """How likely each lobe is chosen, but for the sum of all: about what it scatters.

    `w_2` and `w_3` are the ways inside, backwards, `left` what is not absorbed, in the mean.
    """
    eta = param[lane, i, _ETA]
    m, m_2, m_3, _, _ = sides
    back = (tilt[0], -tilt[1])
    first, _ = fresnel_dielectric(dot(tilted(m, tilt), v), eta)
    second, _ = fresnel_dielectric(dot(tilted(m_2, back), w_2), 1.0 / eta)
    third, _ = fresnel_dielectric(dot(tilted(m_3, back), w_3), 1.0 / eta)
    return (
        param[lane, i, _R] * max(first, _LEAST_SHARE),
        param[lane, i, _TT] * left[0] * max(1.0 - second, _LEAST_SHARE),
        param[lane, i, _TRT] * left[1] * max(1.0 - third, _LEAST_SHARE),
        param[lane, i, _REST] * left[2],
    )


@kernel
def _backwards(param, lane, i):
    """The ways inside to where light leaves by TT and TRT, backwards."""
    second = negate(spherical(param[lane, i, _THETA], param[lane, i, _PHI]))
    return second, spherical(param[lane, i, _THETA_BACK], param[lane, i, _PHI_BACK])


@kernel
def _facets(alpha, m, w, h, other):
    """Density of facets `h` about `m` of those visible from `w` [sr^-1], and what of light to `other` is not hidden."""
    squared = alpha * alpha
    cos_m, cos_h = dot(m, w), dot(m, h)
    if cos_m <= 0.0 or cos_h <= 0.0:
        return 0.0, 0.0
    sine = cross(m, h)
    slope = dot(sine, sine) + squared * cos_h * cos_h
    masked = 0.5 + 0.5 * math.sqrt(1.0 + squared * max(1.0 / (cos_m * cos_m) - 1.0, 0.0))
    density = squared * INV_PI / (slope * slope) * max(dot(w, h), 0.0) / (cos_m * masked)
    return density, shadowing(squared, cos_m, dot(m, other))


@kernel
def _eval_reflected(param, lane, i, side, tilt, v, wi):
    """Density and value of R."""
    h = normalize(add(v, wi))
    cos_h = dot(v, h)
    if cos_h <= 0.0 or facing(side, v) <= 0.0:
        return 0.0, 0.0
    density, shown = _facets(param[lane, i, HUANG_ALPHA], tilted(side, tilt), v, h, wi)
    density *= 0.25 / cos_h
    if facing(side, wi) <= 0.0:
        return density, 0.0
    reflected, _ = fresnel_dielectric(cos_h, param[lane, i, _ETA])
    return density, density * shown * reflected


@kernel
def _eval_leaving(param, lane, i, side, tilt, w, wi):
    """Density and value of TT or TRT, but for what is absorbed and for the lobe's factor."""
    eta = param[lane, i, _ETA]
    inverse = 1.0 / eta
    # Walter et al. 2007, equation 16, over the index inside.
    h = add(w, scale(wi, inverse))
    over_length = 1.0 / math.sqrt(max(dot(h, h), 1e-20))
    if eta < 1.0:
        h = negate(h)
    h = scale(h, over_length)
    cos_h, cos_out = dot(w, h), -dot(wi, h)
    if cos_h <= 0.0 or cos_out <= 0.0:
        return 0.0, 0.0
    out = negate(wi)
    m = tilted(side, (tilt[0], -tilt[1]))
    density, shown = _facets(param[lane, i, HUANG_ALPHA], m, w, h, out)
    density *= inverse * inverse * cos_out * over_length * over_length
    if dot(m, out) <= 0.0 or facing(side, out) <= 0.0:
        return density, 0.0
    reflected, _ = fresnel_dielectric(cos_h, inverse)
    return density, density * shown * (1.0 - reflected)


@kernel
def eval_huang(param, channels, lane, i, n, wo, wi, factor, out, row):
    """See `Lobe.evaluate`."""
    x, y, z = _axes(param, lane, i)
    v, local = to_local(wo, x, y, z), to_local(wi, x, y, z)
    sides = _sides(param, lane, i)
    tilt = (math.cos(param[lane, i, _TILT]), math.sin(param[lane, i, _TILT]))
    m, m_2, m_3, way, way_back = sides
    w_2, w_3 = _backwards(param, lane, i)
    density, value = _eval_reflected(param, lane, i, m, tilt, v, local)
    density_2, value_2, density_3, value_3, spread = 0.0, 0.0, 0.0, 0.0, 0.0
    if param[lane, i, _TT] > 0.0:
        density_2, value_2 = _eval_leaving(param, lane, i, m_2, tilt, w_2, local)
    if param[lane, i, _TRT] > 0.0:
        density_3, value_3 = _eval_leaving(param, lane, i, m_3, tilt, w_3, local)
    if param[lane, i, _REST] > 0.0:
        spread = _INV_TWO_PI * longitudinal(
            local[1], cos_of(local[1]), v[1], cos_of(v[1]), 4.0 * param[lane, i, HUANG_ALPHA]
        )
    value *= param[lane, i, _R]
    value_2 *= param[lane, i, _TT]
    value_3 *= param[lane, i, _TRT]
    left_2, left_3, left_rest = 0.0, 0.0, 0.0
    for c in range(len(channels)):
        tt, trt, rest = _left(param, lane, i, way, way_back, c)
        left_2 += tt
        left_3 += trt
        left_rest += rest
        scattered = value + tt * value_2 + trt * value_3 + rest * spread * param[lane, i, _REST]
        out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * factor * scattered
    over = 1.0 / np.float32(len(channels))
    shares = _shares(param, lane, i, v, w_2, w_3, sides, tilt, (left_2 * over, left_3 * over, left_rest * over))
    whole = shares[0] + shares[1] + shares[2] + shares[3]
    if not whole > 0.0:
        return 0.0
    return (shares[0] * density + shares[1] * density_2 + shares[2] * density_3 + shares[3] * spread) / whole


@kernel
def sample_huang(param, channels, lane, i, wo, u0, u1, u2):
    """See `HairLobe.sample`."""
    x, y, z = _axes(param, lane, i)
    v = to_local(wo, x, y, z)
    sides = _sides(param, lane, i)
    tilt = (math.cos(param[lane, i, _TILT]), math.sin(param[lane, i, _TILT]))
    m, m_2, m_3, way, way_back = sides
    w_2, w_3 = _backwards(param, lane, i)
    left_2, left_3, left_rest = 0.0, 0.0, 0.0
    for c in range(len(channels)):
        tt, trt, rest = _left(param, lane, i, way, way_back, c)
        left_2 += tt
        left_3 += trt
        left_rest += rest
    over = 1.0 / np.float32(len(channels))
    shares = _shares(param, lane, i, v, w_2, w_3, sides, tilt, (left_2 * over, left_3 * over, left_rest * over))
    left = u0 * (shares[0] + shares[1] + shares[2] + shares[3])
    order = 0
    while order < 3 and left >= shares[order]:
        left -= shares[order]
        order += 1
    nothing = (0.0 * u0, 0.0 * u0, 0.0 * u0)
    share = shares[order]
    if not share > 0.0:
        return nothing
    alpha, eta = param[lane, i, HUANG_ALPHA], param[lane, i, _ETA]
    if order == 3:
        sine = sample_longitudinal(v[1], cos_of(v[1]), 4.0 * alpha, left / share, u2)
        cosine, phi = cos_of(sine), _TWO_PI * u1
        return to_world((math.sin(phi) * cosine, sine, math.cos(phi) * cosine), x, y, z)
    if order == 0:
        normal = tilted(m, tilt)
        if dot(normal, v) <= 0.0:
            return nothing
        h = sample_facet(alpha, normal, v, u1, u2)
        return normalize(to_world(subtract(scale(h, 2.0 * dot(h, v)), v), x, y, z))
    w = w_2 if order == 1 else w_3
    normal = tilted(m_2 if order == 1 else m_3, (tilt[0], -tilt[1]))
    if dot(normal, w) <= 0.0:
        return nothing
    h = sample_facet(alpha, normal, w, u1, u2)
    reflected, cos_t = fresnel_dielectric(dot(w, h), 1.0 / eta)
    if reflected >= 1.0:
        return nothing
    return to_world(refracted(w, h, cos_t, 1.0 / eta), x, y, z)


@kernel
def huang_roughness(param, lane, i):
    """Alpha of the facets."""
    return param[lane, i, HUANG_ALPHA]


@kernel
def huang_albedo(param, lane, i, wo, c):
    """As Cycles gives it: all reflections inside a round, smooth fibre, where the ray meets the strand."""
    x, tangent, z = _axes(param, lane, i)
    v = to_local(wo, x, tangent, z)
    h = -dot(normalize(cross(tangent, wo)), read3(param, lane, i, CLOSURE_N))
    h = min(max(h, -1.0), 1.0)
    m = (h, 0.0 * h, cos_of(h))
    eta = param[lane, i, _ETA]
    reflected, cos_t = fresnel_dielectric(dot(m, v), eta)
    sine = v[1] / eta
    passed = param[lane, i, _PASSED + c] ** (-2.0 * cos_t / max(1.0 - sine * sine, 1e-6))
    return (passed - 2.0 * reflected * passed + reflected) / max(1.0 - reflected * passed, 1e-6)


LOBE = HairLobe(HUANG, eval_huang, sample_huang, huang_roughness, huang_albedo, (_PASSED,))
