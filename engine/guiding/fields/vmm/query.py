# SPDX-License-Identifier: GPL-3.0-or-later
"""Looking up the field at a point, and sampling what is found there.

References: Ruppert et al. 2020, "Robust Fitting of Parallax-Aware Mixtures for Path Guiding".
"""

import math

import numpy as np

from engine.guiding.fields.vmm.field import (
    COSINE_FLUENCE,
    COSINE_KAPPA,
    COSINE_NORMAL,
    COSINE_RADIANCE,
    GUIDE_COEFFICIENT,
    GUIDE_KAPPA,
    GUIDE_WEIGHT,
    GUIDE_X,
    GUIDE_Y,
    GUIDE_Z,
    LOBE_COEFFICIENT,
    LOBE_INVERSE_DISTANCE,
    LOBE_KAPPA,
    LOBE_X,
    LOBE_Y,
    LOBE_Z,
    NEIGHBOR_COUNT,
)
from engine.guiding.fields.vmm.numeric import UNIFORM_KAPPA, exp_nonpositive, spread
from engine.kernels.constants import FOUR_PI, ONE_MINUS_EPSILON, TWO_PI
from engine.kernels.vector import orthonormal_basis
from engine.runtime.jit import kernel

#: The lobe closest to max(cos, 0) / pi, and its density at its centre.
COSINE_LOBE_KAPPA = np.float32(2.18853)
COSINE_LOBE_NORM = np.float32(2.18853 / (2.0 * np.pi * (1.0 - np.exp(-2.0 * 2.18853))))
#: Mean cosines of phase functions below which they count as even, and beyond which their lobe gets no sharper.
_LEAST_MEAN_COSINE = np.float32(0.02)
_MOST_MEAN_COSINE = np.float32(0.95)
#: Squared length of kappa_a mean_a + kappa_b mean_b below which a product of lobes is uniform.
LEAST_PRODUCT = np.float32(1e-7)

#: Squared distance [m^2] beyond which a cached neighbour is none.
_NO_NEIGHBOR = np.float32(1e35)

#: Part of the predicted radiance that comes evenly from all directions.
EVEN_SHARE = np.float32(0.3)
_TEN_BITS = np.float32(1.0 / 512.0)


@kernel
def find_region(field, leaf, p, u):
    """Region to guide with at point p: the one closest to a point drawn near p.

    Paths that meet at a border between cells then see both mixtures, and the border does not show.

    Parameters
    ----------
    field : VmmField
    leaf : int, of `find_leaf`
    p : float32 tuple, world
    u : uint32
        Random bits, ten for each coordinate.

    Returns
    -------
    int, -1 = none: outside the bounds, or the leaf has never been fitted.
    """
    if leaf < 0 or field.is_ready[leaf] == 0:
        return -1
    step = field.reach[leaf] * _TEN_BITS
    x = p[0] + (np.float32(u & 1023) - 511.5) * step
    y = p[1] + (np.float32((u >> 10) & 1023) - 511.5) * step
    z = p[2] + (np.float32((u >> 20) & 1023) - 511.5) * step
    chosen = 0
    nearest = _NO_NEIGHBOR
    for k in range(NEIGHBOR_COUNT):
        to_x = field.neighbor_pivots[leaf, 0, k] - x
        to_y = field.neighbor_pivots[leaf, 1, k] - y
        to_z = field.neighbor_pivots[leaf, 2, k] - z
        squared = to_x * to_x + to_y * to_y + to_z * to_z
        if squared < nearest:
            nearest = squared
            chosen = k
    return np.int64(field.neighbors[leaf, chosen])


@kernel(forceinline=True)  # Loops over lobes stay vector code.
def multiply_lobe(mean, kappa_a, coefficient_a, n, kappa_b, norm_b, squared_chord):
    """Product of two von Mises-Fisher lobes, which is one again.

    Parameters
    ----------
    mean : float32 tuple, unit
    kappa_a : float32
    coefficient_a : float32 [sr^-1], the first lobe's value at its mean, its weight included
    n : float32 tuple, unit, mean of the second lobe
    kappa_b, norm_b : float32, the second lobe's concentration, and its value at its mean
    squared_chord : float32, |mean - n|^2

    Returns
    -------
    mean : float32 tuple, unit
    kappa, coefficient : float32
    weight : float32, integral of the product over the sphere

    References
    ----------
    Herholz et al. 2016, "Product Importance Sampling for Light Transport Path Guiding".
    """
    deficit = kappa_a * kappa_b * squared_chord
    kappa_sum = kappa_a + kappa_b
    kappa = math.sqrt(max(kappa_sum * kappa_sum - deficit, 0.0))
    x = kappa_a * mean[0] + kappa_b * n[0]
    y = kappa_a * mean[1] + kappa_b * n[1]
    z = kappa_a * mean[2] + kappa_b * n[2]
    squared = x * x + y * y + z * z
    is_uniform = kappa < UNIFORM_KAPPA or squared < LEAST_PRODUCT
    inverse_length = 1.0 / math.sqrt(1.0 if is_uniform else squared)
    kappa = 0.0 if is_uniform else kappa
    # kappa' - kappa_a - kappa_b without its cancellation.
    exponent = -deficit / max(kappa + kappa_sum, 1e-6)
    coefficient = coefficient_a * norm_b * exp_nonpositive(exponent)
    weight = coefficient * (FOUR_PI * spread(kappa))
    x = n[0] if is_uniform else x * inverse_length
    y = n[1] if is_uniform else y * inverse_length
    z = n[2] if is_uniform else z * inverse_length
    return (x, y, z), kappa, coefficient, weight


@kernel
def prepare_vmm(field, region, p, n, cosine_lobe, guide, row):
    """Write the mixture to sample on a surface into lane `row` of `guide`, times the lobe nearest to the clamped cosine
    about `n` if `cosine_lobe`; see `prepare_product`."""
    kappa_b = COSINE_LOBE_KAPPA if cosine_lobe else np.float32(0.0)
    norm_b = COSINE_LOBE_NORM if cosine_lobe else np.float32(1.0)
    prepare_product(field, region, p, n, kappa_b, norm_b, guide, row)


@kernel
def prepare_phase(field, region, p, forward, mean_cosine, guide, row):
    """Write the mixture to sample within a medium, times the lobe that scatters ahead as much as its phase functions.

    Parameters
    ----------
    forward : float32 tuple, unit, where the path was going
    mean_cosine : float32, of the phase functions; < 0: they scatter back

    References
    ----------
    Banerjee et al. 2005, "Clustering on the Unit Hypersphere using von Mises-Fisher Distributions", Eq. (4.4), for the
    sharpness of a mean cosine; Herholz et al. 2019, "Volume Path Guiding Based on Zero-Variance Random Walk Theory",
    for the product.
    """
    g = min(abs(mean_cosine), _MOST_MEAN_COSINE)
    n = forward
    if mean_cosine < 0.0:
        n = (-forward[0], -forward[1], -forward[2])
    if g < _LEAST_MEAN_COSINE:
        prepare_product(field, region, p, n, np.float32(0.0), np.float32(1.0), guide, row)
        return
    kappa = g * (3.0 - g * g) / (1.0 - g * g)
    norm = kappa / (TWO_PI * (1.0 - math.exp(-2.0 * kappa)))
    prepare_product(field, region, p, n, kappa, norm, guide, row)


@kernel
def prepare_product(field, region, p, n, kappa_b, norm_b, guide, row):
    """Write the mixture to sample at a point, times a lobe, into lane `row` of `guide`.

    Lobes turn towards where their light comes from, as seen from p instead of the pivot; their product with a lobe is
    again a mixture in closed form.

    Parameters
    ----------
    field : VmmField
    region : int, of `find_region`
    p : float32 tuple, world
    n : float32 tuple, unit, axis of the lobe
    kappa_b, norm_b : float32, its sharpness and largest density; 0 and 1: there is none
    guide : GuideLobes
    row : int

    References
    ----------
    Ruppert et al. 2020, section 5 (parallax).
    """
    count = (np.int64(field.lobe_count[region]) + 7) & ~7
    offset_x = field.pivot[region, 0] - p[0]
    offset_y = field.pivot[region, 1] - p[1]
    offset_z = field.pivot[region, 2] - p[2]
    total = np.float32(0.0)
    for k in range(count):
        # mu' ~ mu d + (pivot - p), divided by d.
        inverse_distance = field.lobes[region, LOBE_INVERSE_DISTANCE, k]
        x = field.lobes[region, LOBE_X, k] + offset_x * inverse_distance
        y = field.lobes[region, LOBE_Y, k] + offset_y * inverse_distance
        z = field.lobes[region, LOBE_Z, k] + offset_z * inverse_distance
        squared = x * x + y * y + z * z
        # p is where the light comes from: no direction is better than another.
        at_source = not (squared > 1e-6 and squared < 1e30)
        inverse_length = 1.0 / math.sqrt(1.0 if at_source else squared)
        x = field.lobes[region, LOBE_X, k] if at_source else x * inverse_length
        y = field.lobes[region, LOBE_Y, k] if at_source else y * inverse_length
        z = field.lobes[region, LOBE_Z, k] if at_source else z * inverse_length

        chord_x = x - n[0]
        chord_y = y - n[1]
        chord_z = z - n[2]
        squared_chord = chord_x * chord_x + chord_y * chord_y + chord_z * chord_z
        mean, kappa, coefficient, weight = multiply_lobe(
            (x, y, z), field.lobes[region, LOBE_KAPPA, k], field.lobes[region, LOBE_COEFFICIENT, k],
            n, kappa_b, norm_b, squared_chord,
        )
        guide.lobes[row, GUIDE_X, k] = mean[0]
        guide.lobes[row, GUIDE_Y, k] = mean[1]
        guide.lobes[row, GUIDE_Z, k] = mean[2]
        guide.lobes[row, GUIDE_KAPPA, k] = kappa
        guide.lobes[row, GUIDE_COEFFICIENT, k] = coefficient
        guide.lobes[row, GUIDE_WEIGHT, k] = weight
        total += weight
    scale = 1.0 / total if total > 0.0 else np.float32(0.0)
    for k in range(count):
        guide.lobes[row, GUIDE_COEFFICIENT, k] *= scale
        guide.lobes[row, GUIDE_WEIGHT, k] *= scale
    guide.count[row] = count
    guide.cosine[row, COSINE_NORMAL] = n[0]
    guide.cosine[row, COSINE_NORMAL + 1] = n[1]
    guide.cosine[row, COSINE_NORMAL + 2] = n[2]
    guide.cosine[row, COSINE_KAPPA] = kappa_b
    guide.cosine[row, COSINE_FLUENCE] = field.fluence[region]
    guide.cosine[row, COSINE_RADIANCE] = field.fluence[region] * total / norm_b


@kernel
def clear_vmm(guide, row):
    """Leave lane `row` of `guide` without lobes: no light is predicted, and there is nothing to sample."""
    guide.count[row] = 0
    guide.cosine[row, COSINE_KAPPA] = 0.0
    guide.cosine[row, COSINE_FLUENCE] = 0.0
    guide.cosine[row, COSINE_RADIANCE] = 0.0


@kernel
def eval_vmm(guide, row, wi):
    """Density of `sample_vmm` at unit direction wi: float32 [sr^-1]."""
    pdf = np.float32(0.0)
    for k in range(guide.count[row]):
        x = wi[0] - guide.lobes[row, GUIDE_X, k]
        y = wi[1] - guide.lobes[row, GUIDE_Y, k]
        z = wi[2] - guide.lobes[row, GUIDE_Z, k]
        exponent = -0.5 * guide.lobes[row, GUIDE_KAPPA, k] * (x * x + y * y + z * z)
        pdf += guide.lobes[row, GUIDE_COEFFICIENT, k] * exp_nonpositive(exponent)
    return pdf


@kernel
def sample_vmm(guide, row, u0, u1, u2):
    """Draw a unit direction from lane `row` of `guide`: float32 tuple.

    Parameters
    ----------
    guide : GuideLobes
    row : int
    u0, u1, u2 : float32 in [0, 1): which lobe, how far from its centre, which way
    """
    chosen = 0
    left = u0
    for k in range(guide.count[row]):
        weight = guide.lobes[row, GUIDE_WEIGHT, k]
        if weight > 0.0:
            chosen = k
            if left < weight:
                break
        left -= weight
    kappa = guide.lobes[row, GUIDE_KAPPA, chosen]
    # 1 - cos, by inversion: log1p keeps what is small small.
    below = 2.0 * (1.0 - u1)
    if kappa > 0.0:
        below = -math.log1p(-min(below * kappa * spread(kappa), ONE_MINUS_EPSILON)) / kappa
    below = min(below, 2.0)
    sine = math.sqrt(below * (2.0 - below))
    mean = (
        guide.lobes[row, GUIDE_X, chosen],
        guide.lobes[row, GUIDE_Y, chosen],
        guide.lobes[row, GUIDE_Z, chosen],
    )
    tangent, bitangent = orthonormal_basis(mean)
    a = sine * math.cos(TWO_PI * u2)
    b = sine * math.sin(TWO_PI * u2)
    c = 1.0 - below
    return (
        a * tangent[0] + b * bitangent[0] + c * mean[0],
        a * tangent[1] + b * bitangent[1] + c * mean[1],
        a * tangent[2] + b * bitangent[2] + c * mean[2],
    )


@kernel
def predict_vmm(guide, row, wi, guide_pdf):
    """Incident radiance (mean over channels) along unit direction wi, given `guide_pdf` = `eval_vmm` there.

    The cosine lobe is divided out again: fluence times the density of incident radiance alone, part of it held even:
    where no lobe reaches, little is known, and a target of nothing there would leave what comes to rare, heavy samples.
    """
    x = wi[0] - guide.cosine[row, COSINE_NORMAL]
    y = wi[1] - guide.cosine[row, COSINE_NORMAL + 1]
    z = wi[2] - guide.cosine[row, COSINE_NORMAL + 2]
    exponent = -0.5 * guide.cosine[row, COSINE_KAPPA] * (x * x + y * y + z * z)
    density = guide_pdf * guide.cosine[row, COSINE_RADIANCE] / exp_nonpositive(exponent)
    even = guide.cosine[row, COSINE_FLUENCE] / FOUR_PI
    return (1.0 - EVEN_SHARE) * density + EVEN_SHARE * even
