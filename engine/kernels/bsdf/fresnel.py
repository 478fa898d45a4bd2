# SPDX-License-Identifier: GPL-3.0-or-later
"""Fresnel terms. `eta` is the refractive index behind the interface over the one in front, where the viewer is."""

import math

from engine.runtime.jit import kernel


@kernel
def fresnel_dielectric(cos_i, eta):
    """Unpolarised reflectance, and the cosine (negative) of the refracted direction with the facet's normal.

    Total internal reflection returns (1, 0).
    """
    cos_i = abs(cos_i)
    squared = eta * eta - 1.0 + cos_i * cos_i
    if squared <= 0.0:
        return 1.0, 0.0
    eta_cos_t = math.sqrt(squared)
    # Both amplitudes by one division: divisions that wait for each other were most of the time.
    dense_cos_i = eta * eta * cos_i
    below_s = cos_i + eta_cos_t
    below_p = dense_cos_i + eta_cos_t
    inverse = 1.0 / max(below_s * below_p, 1e-30)
    r_s = (cos_i - eta_cos_t) * below_p * inverse
    r_p = (dense_cos_i - eta_cos_t) * below_s * inverse
    return 0.5 * (r_s * r_s + r_p * r_p), -eta_cos_t / eta


@kernel
def f0_of_eta(eta):
    """Reflectance at perpendicular incidence."""
    ratio = (eta - 1.0) / (eta + 1.0)
    return ratio * ratio


@kernel
def eta_of_f0(f0):
    """Refractive index (at least 1) of a reflectance at perpendicular incidence, which is clamped to 0.99."""
    root = math.sqrt(min(max(f0, 0.0), 0.99))
    return (1.0 + root) / (1.0 - root)


@kernel
def fresnel_mean(eta):
    """Cosine-weighted mean of `fresnel_dielectric` over the hemisphere (a fit).

    References: Kulla and Conty 2017, "Revisiting Physically Based Shading at Imageworks".
    """
    if eta < 1.0:
        return 0.997118 + eta * (0.1014 - eta * (0.965241 + eta * 0.130607))
    return (eta - 1.0) / (4.08567 + 1.00071 * eta)


@kernel
def interface_mean_blend(eta):
    """Cosine-weighted mean of (F - F0) / (1 - F0) over the hemisphere."""
    f0 = f0_of_eta(eta)
    return min(max((fresnel_mean(eta) - f0) / max(1.0 - f0, 1e-6), 0.0), 1.0)


@kernel
def f82_b(f0, tint):
    """Coefficient of the F82 term for one channel; `tint` scales Schlick's curve at arccos(1/7).

    References: Kutz, Hasan and Edmondson 2021, "Novel aspects of the Adobe Standard Material".
    """
    f = 6.0 / 7.0
    f5 = f * f * f * f * f
    return (f0 + (1.0 - f0) * f5) * (7.0 / (f5 * f)) * (1.0 - tint)


@kernel
def f82_mean(f0, b):
    """Cosine-weighted mean of the F82 curve over the hemisphere."""
    return f0 + (1.0 - f0) * (1.0 / 21.0) - b * (1.0 / 126.0)
