# SPDX-License-Identifier: GPL-3.0-or-later
"""Value, density, samples and albedo of all lobes of a lane together.

Lobes are chosen by sample weight; the density of a direction is the mixture's (Veach 1997, section 9.2.4: one-sample
model with the balance heuristic).
"""

import math

from engine.kernels.bsdf.closures import read3
from engine.kernels.bsdf.dispersion import delta_channels, set_channel
from engine.kernels.bsdf.energy import albedo_blends, reflected_albedo
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    BUMP,
    CLOSURE_DISPERSES,
    DELTA_ALPHA_SQUARED,
    DIFFUSE,
    ENERGY_SCALE,
    ETA,
    FIRST_HAIR,
    FIRST_MICROFACET,
    FIRST_TRANSLUCENT,
    GLASS,
    HAIR_REFLECTION,
    HAIR_TRANSMISSION,
    HUANG,
    LAST_DIFFUSE,
    LAST_MICROFACET,
    LINKED_GLASS,
    PHASE,
    REFRACTION,
    SUBSURFACE,
    THIN_GLASS,
    TRANSPARENT,
)
from engine.kernels.bsdf.linked import albedo_linked, eval_linked, is_linked, linked_label, sample_linked
from engine.kernels.bsdf.lobes import eval_lobe, hair_albedo, hair_roughness, sample_hair, sample_lobe
from engine.kernels.bsdf.microfacet import eval_microfacet, lobe_color, sample_microfacet
from engine.kernels.bsdf.normals import shift_shading, terminator_factor
from engine.kernels.bsdf.warp import sample_cosine_hemisphere
from engine.kernels.constants import INV_PI, ONE_MINUS_EPSILON
from engine.kernels.vector import dot, negate, scale
from engine.runtime.jit import kernel
from engine.state.lanes import (
    CLOSURE_N,
    CLOSURE_SAMPLE_WEIGHT,
    CLOSURE_WEIGHT,
    RAY_DIFFUSE,
    RAY_GLOSSY,
    RAY_REFLECT,
    RAY_SINGULAR,
    RAY_SUBSURFACE,
    RAY_TRANSMIT,
    RAY_TRANSPARENT,
    RAY_VOLUME,
    RGB,
)

#: Mask that hides no lobe.
EVERY_KIND = RAY_DIFFUSE | RAY_GLOSSY | RAY_TRANSMIT | RAY_VOLUME

#: From which bit on a label holds the number of a subsurface lobe.
LABEL_LOBE = 24

# What has proposed a direction where no lobe has.
BY_LIGHT = -1
BY_GUIDE = -2

# Which lobes `sample_lobes` chooses among.
EVERY_LOBE = 0
ROUGH_LOBES = 1
DELTA_LOBES = 2


@kernel
def is_visible(kind, visibility):
    """Whether lobes of `kind` may see a light of RAY_* mask `visibility`; glass needs either kind of ray (Cycles)."""
    if FIRST_HAIR <= kind <= LAST_DIFFUSE:
        transmits = kind == HAIR_TRANSMISSION or kind == THIN_GLASS
        return visibility & (RAY_TRANSMIT if transmits else RAY_GLOSSY) != 0
    if kind <= LAST_DIFFUSE:
        return visibility & (RAY_VOLUME if kind == PHASE else RAY_DIFFUSE) != 0
    if kind < REFRACTION:
        return visibility & RAY_GLOSSY != 0
    if kind == GLASS or kind == LINKED_GLASS:
        return visibility & (RAY_GLOSSY | RAY_TRANSMIT) != 0
    return visibility & RAY_TRANSMIT != 0


@kernel
def hair_label(kind):
    """Kind of a ray that a fibre has scattered: as transmitted counts what was not reflected at once, and with Chiang's
    model all, since that is nearly all; with Huang's, as in Cycles, nothing.
    """
    return RAY_GLOSSY | (RAY_REFLECT if kind == HAIR_REFLECTION or kind == HUANG else RAY_TRANSMIT)


@kernel(forceinline=True)
def eval_lobe_of(kinds, param, channels, lane, i, wo, wi, visibility, sampled, out, row):
    """Add f |cos| of a lane's lobe `i`, if it is not delta, to out[row] and return its density; see `eval_lobes`."""
    kind = kinds[lane, i]
    n = read3(param, lane, i, CLOSURE_N)
    factor = 1.0
    if param[lane, i, BUMP] != 0.0:
        factor = terminator_factor(param, lane, i, n, wi, kind <= LAST_DIFFUSE, i == sampled)
    if not is_visible(kind, visibility):
        factor = 0.0
    if is_linked(kind):
        return eval_linked(param, channels, lane, i, n, wo, wi, factor, out, row)
    if kind <= LAST_DIFFUSE:
        if kind == HAIR_REFLECTION or kind == HAIR_TRANSMISSION:
            # Sides are asked of light samples alone (`hair.py`).
            if sampled != BY_LIGHT:
                n = scale(n, 0.0)
            elif (dot(n, wi) < 0.0) != (kind == HAIR_TRANSMISSION):
                factor = 0.0
        return eval_lobe(kind, param, channels, lane, i, n, wo, wi, factor, out, row)
    if kind <= LAST_MICROFACET:
        return eval_microfacet(param, channels, lane, i, kind, n, wo, wi, factor, out, row)
    return 0.0


@kernel
def eval_lobes(kinds, param, count, channels, lane, wo, wi, visibility, sampled, u, out, row):
    """Write f |cos| of a lane's non-delta lobes into out[row]; return the mixture's pdf and a lobe picked by it.

    Takes the arrays of `Closures` it needs, since each further one costs every call.
    `sampled` is the index of the lobe that proposed `wi`, BY_LIGHT or BY_GUIDE if none did. With `u` in [0, 1) a lobe
    is drawn with the probability that it, of all, would have proposed `wi`; without (`u` < 0) it is -1.
    """
    picked = -1
    for c in range(len(channels)):
        out[row, c] = 0.0
    pdf = 0.0
    weight_sum = 0.0
    for i in range(count):
        sample_weight = param[lane, i, CLOSURE_SAMPLE_WEIGHT]
        weight_sum += sample_weight
        lobe_pdf = sample_weight * eval_lobe_of(
            kinds, param, channels, lane, i, wo, wi, visibility, sampled, out, row
        )
        pdf += lobe_pdf
        if u >= 0.0 and lobe_pdf > 0.0:
            # One number decides all picks: what is left of it after each is uniform again.
            share = lobe_pdf / pdf
            if u < share:
                picked = i
                u = u / share
            else:
                u = (u - share) / (1.0 - share)
    return pdf / weight_sum if weight_sum > 0.0 else 0.0, picked


@kernel
def eval_channels(closures, lane, wo, wi, visibility, sampled, u, out, row):
    """`eval_lobes`, where the lane disperses every channel with its own refractive index.

    The density is then the mean over the channels' shares in the path's, and columns C to 2 C of out[row] hold that of
    each.
    """
    count = len(closures.channels)
    # Without wavelengths one evaluation is all.
    last = 0
    if count > RGB and closures.flags[lane] & CLOSURE_DISPERSES != 0:
        last = count - 1
    mean = 0.0
    pdf = 0.0
    picked = -1
    # The hero comes last, and leaves the lobes as they were.
    for c in range(last, -1, -1):
        if last > 0:
            set_channel(closures, lane, c)
        pdf, picked = eval_lobes(
            closures.kind, closures.param, closures.count[lane], closures.channels, lane, wo, wi, visibility, sampled,
            u, out, row,
        )
        if last > 0:
            mean += closures.share[lane, c] * pdf
            out[row, count + c] = pdf
            out[row, 2 * count + c] = out[row, c]
    if last > 0:
        pdf = mean
        for c in range(count):
            out[row, c] = out[row, 2 * count + c]
    return pdf, picked


@kernel
def is_delta_lobe(kinds, param, lane, i):
    """Whether lobe `i` is sampled only: transparent, subsurface, or a microfacet lobe of next to no roughness."""
    kind = kinds[lane, i]
    if kind < FIRST_MICROFACET:
        return False
    return kind > LAST_MICROFACET or not param[lane, i, ALPHA_X] * param[lane, i, ALPHA_Y] > DELTA_ALPHA_SQUARED


@kernel
def _pass_through(closures, lane, i, kind, pmf, out, row):
    """Write the value of a lobe that is no surface's, and return the kind of the ray."""
    channels = closures.channels
    for c in range(len(channels)):
        out[row, c] = closures.param[lane, i, CLOSURE_WEIGHT + c]
        if len(channels) > RGB:
            out[row, len(channels) + c] = pmf
    return RAY_SUBSURFACE | i << LABEL_LOBE if kind == SUBSURFACE else RAY_TRANSPARENT | RAY_TRANSMIT


@kernel
def _write_delta(param, channels, lane, i, kind, cosine, blend, is_refracted, out, row):
    """Write the value of a delta lobe; that of a linked one is there, without weight and energy scale."""
    scale = param[lane, i, ENERGY_SCALE]
    if param[lane, i, BUMP] != 0.0:
        scale *= shift_shading(param[lane, i, BUMP], cosine)
    for c in range(len(channels)):
        color = out[row, c] if is_linked(kind) else lobe_color(param, lane, i, kind, blend, is_refracted, c)
        out[row, c] = param[lane, i, CLOSURE_WEIGHT + c] * scale * color


@kernel
def sample_lobes(closures, lane, wo, ng, choice, u0, u1, u2, out, row):
    """`sample_bsdf` among the lobes of `choice` (EVERY_LOBE, ROUGH_LOBES, DELTA_LOBES); the returned probabilities are
    those of a choice among all.
    """
    kinds = closures.kind
    param = closures.param
    count = closures.count[lane]
    channels = closures.channels
    weight_sum = 0.0
    chosen_sum = 0.0
    for i in range(count):
        weight = param[lane, i, CLOSURE_SAMPLE_WEIGHT]
        weight_sum += weight
        if choice == EVERY_LOBE or is_delta_lobe(kinds, param, lane, i) == (choice == DELTA_LOBES):
            chosen_sum += weight
    remaining = u0 * chosen_sum
    chosen = -1
    for i in range(count):
        if choice == EVERY_LOBE or is_delta_lobe(kinds, param, lane, i) == (choice == DELTA_LOBES):
            # Rounding may leave a little behind the last one: it takes it.
            if chosen >= 0:
                weight = param[lane, chosen, CLOSURE_SAMPLE_WEIGHT]
                if remaining < weight:
                    break
                remaining -= weight
            chosen = i
    if chosen < 0:
        return 0.0, wo, 0, 1.0, 1.0
    sample_weight = param[lane, chosen, CLOSURE_SAMPLE_WEIGHT]
    kind = kinds[lane, chosen]
    n = read3(param, lane, chosen, CLOSURE_N)
    wi, label, roughness, eta = wo, 0, 1.0, 1.0
    if not sample_weight > 0.0:
        return 0.0, wi, label, roughness, eta
    u0 = min(remaining / sample_weight, ONE_MINUS_EPSILON)
    pmf = sample_weight / weight_sum
    is_delta = False
    is_refracted = False
    blend = 1.0
    if FIRST_HAIR <= kind <= LAST_DIFFUSE:
        # It looks at no geometric normal.
        wi = sample_hair(kind, param, channels, lane, chosen, wo, u0, u1, u2)
        if not dot(wi, wi) > 0.5:
            return 0.0, wo, label, roughness, eta
        pdf, _ = eval_channels(closures, lane, wo, wi, EVERY_KIND, chosen, -1.0, out, row)
        return pdf, wi, hair_label(kind), hair_roughness(kind, param, lane, chosen), eta
    if is_linked(kind):
        numbers = (u0, u1, u2)
        wi, is_refracted, is_delta, branch_pmf = sample_linked(param, channels, lane, chosen, n, wo, numbers, out, row)
        pmf *= branch_pmf
        label = linked_label(param, lane, chosen, kind)
        roughness = math.sqrt(param[lane, chosen, ALPHA_X] * param[lane, chosen, ALPHA_Y])
        if is_refracted:
            eta = param[lane, chosen, ETA]
    elif kind <= LAST_DIFFUSE:
        is_refracted = kind >= FIRST_TRANSLUCENT
        label = RAY_DIFFUSE
        wi = sample_lobe(kind, param, lane, chosen, n, wo, u1, u2)
    elif kind <= LAST_MICROFACET:
        wi, is_refracted, is_delta, blend, branch_pmf = sample_microfacet(
            param, channels, lane, chosen, kind, n, wo, u0, u1, u2
        )
        pmf *= branch_pmf
        label = RAY_GLOSSY
        roughness = math.sqrt(param[lane, chosen, ALPHA_X] * param[lane, chosen, ALPHA_Y])
        if is_refracted:
            eta = param[lane, chosen, ETA]
    else:
        return pmf, negate(wo), _pass_through(closures, lane, chosen, kind, pmf, out, row), 0.0, eta
    label |= RAY_TRANSMIT if is_refracted else RAY_REFLECT
    # Only samples are checked against the geometric normal: evaluation would show the facets of smooth meshes (Cycles).
    if pmf <= 0.0 or (dot(ng, wi) < 0.0) != is_refracted:
        return 0.0, wi, label, roughness, eta
    if is_delta:
        _write_delta(param, channels, lane, chosen, kind, dot(n, wi), blend, is_refracted, out, row)
        if len(channels) > RGB and closures.flags[lane] & CLOSURE_DISPERSES != 0:
            pmf = delta_channels(closures, lane, chosen, wo, sample_weight / weight_sum, pmf, is_refracted, out, row)
        return pmf, wi, label | RAY_SINGULAR, roughness, eta
    pdf, _ = eval_channels(closures, lane, wo, wi, EVERY_KIND, chosen, -1.0, out, row)
    return pdf, wi, label, roughness, eta


@kernel(forceinline=True)
def eval_bsdf(closures, tables, lane, wo, wi, ng, visibility, out, row):
    """Value and density of direction `wi`.

    Parameters
    ----------
    wo, wi, ng : tuple of 3 float32
        Unit, world space; the geometric normal is not looked at, as in Cycles (it would show facets of smooth meshes).
    visibility : int
        RAY_DIFFUSE, RAY_GLOSSY, RAY_TRANSMIT, RAY_VOLUME bits: lobes of another kind count into the pdf only.
    out : float32 (R, C)
        Row `row` receives f |cos| summed over non-delta lobes [sr^-1].

    Returns
    -------
    pdf : float32 [sr^-1]
        Density with which `sample_bsdf` chooses `wi`; delta lobes keep their share of the choice.
    """
    kinds = closures.kind
    param = closures.param
    count = closures.count[lane]
    if count == 1 and kinds[lane, 0] == DIFFUSE and param[lane, 0, BUMP] == 0.0:
        pdf = max(dot(read3(param, lane, 0, CLOSURE_N), wi), 0.0) * INV_PI
        value = pdf if visibility & RAY_DIFFUSE != 0 else 0.0
        for c in range(len(closures.channels)):
            out[row, c] = param[lane, 0, CLOSURE_WEIGHT + c] * value
        return pdf
    pdf, _ = eval_channels(closures, lane, wo, wi, visibility, BY_LIGHT, -1.0, out, row)
    return pdf


@kernel(forceinline=True)
def sample_among(closures, lane, wo, ng, choice, u0, u1, u2, out, row):
    """`sample_bsdf` among the lobes of `choice`: EVERY_LOBE, ROUGH_LOBES or DELTA_LOBES.

    The returned pdf (of a delta lobe the probability) is that of a choice among all lobes.
    """
    kinds = closures.kind
    param = closures.param
    count = closures.count[lane]
    if choice != DELTA_LOBES and count == 1 and kinds[lane, 0] == DIFFUSE and param[lane, 0, BUMP] == 0.0:
        wi, cos_i = sample_cosine_hemisphere(read3(param, lane, 0, CLOSURE_N), u1, u2)
        pdf = cos_i * INV_PI if dot(ng, wi) > 0.0 else 0.0
        for c in range(len(closures.channels)):
            out[row, c] = param[lane, 0, CLOSURE_WEIGHT + c] * pdf
        return pdf, wi, RAY_DIFFUSE | RAY_REFLECT, 1.0, 1.0
    return sample_lobes(closures, lane, wo, ng, choice, u0, u1, u2, out, row)


@kernel(forceinline=True)
def sample_bsdf(closures, tables, lane, wo, ng, u0, u1, u2, out, row):
    """Sample a direction.

    Parameters
    ----------
    u0, u1, u2 : float32 in [0, 1)
        `u0` picks the lobe, then reflection or refraction.
    out : float32 (R, C)
        Row `row` receives f |cos| of the mixture [sr^-1]; of a delta lobe what makes out / pdf the throughput.

    Returns
    -------
    pdf : float32 [sr^-1]
        Density of the mixture; for a delta lobe its probability; 0 = no sample.
    wi : tuple of 3 float32
    label : int
        RAY_DIFFUSE or RAY_GLOSSY, with RAY_REFLECT or RAY_TRANSMIT, RAY_SINGULAR for delta lobes; a transparent
        closure has RAY_TRANSPARENT | RAY_TRANSMIT; a subsurface lobe RAY_SUBSURFACE, without a direction, and its
        number in the bits from LABEL_LOBE on.
    roughness : float32
        Geometric mean of the lobe's alphas, 1 for diffuse kinds, 0 for a transparent closure.
    eta : float32
        Relative refractive index of the interface crossed, 1 if none.
    """
    return sample_among(closures, lane, wo, ng, EVERY_LOBE, u0, u1, u2, out, row)


@kernel
def add_albedo(closures, tables, lane, i, wo, looks_up_transmission, out, row):
    """Add the estimated directional albedo of a lane's lobe `i` to out[row]; see `albedo_blends`."""
    param = closures.param
    kind = closures.kind[lane, i]
    if FIRST_MICROFACET <= kind and is_linked(kind):
        shares = albedo_linked(param, closures.channels, tables, lane, i, wo)
        for c in range(len(closures.channels)):
            out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * (shares[c] + shares[4 + c])
        return
    is_microfacet = FIRST_MICROFACET <= kind <= LAST_MICROFACET
    reflected = 1.0
    refracted = 1.0
    if is_microfacet:
        reflected, refracted = albedo_blends(param, tables.data, lane, i, kind, wo, looks_up_transmission)
    for c in range(len(closures.channels)):
        share = 1.0
        if FIRST_HAIR <= kind <= LAST_DIFFUSE:
            share = hair_albedo(kind, param, lane, i, wo, c)
        elif is_microfacet:
            share = reflected_albedo(param, lane, i, kind, reflected, c)
            if kind >= REFRACTION:
                share += lobe_color(param, lane, i, kind, refracted, True, c)
        out[row, c] += param[lane, i, CLOSURE_WEIGHT + c] * share


@kernel
def albedo(closures, tables, lane, wo, looks_up_transmission, out, row):
    """Write the estimated directional albedo of all lobes into out[row]; transparent closures are left out."""
    for c in range(len(closures.channels)):
        out[row, c] = 0.0
    for i in range(closures.count[lane]):
        if closures.kind[lane, i] != TRANSPARENT:
            add_albedo(closures, tables, lane, i, wo, looks_up_transmission, out, row)
