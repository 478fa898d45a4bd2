# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixtures of lobes in torch, to train the networks whose outputs `engine.guiding.neural.networks.lobes` decodes.

Columns, constants and decoding are those of `engine.guiding.neural.networks.lobes.vmf` and
`engine.guiding.neural.networks.lobes.nasg`. Values and gradients are finite whatever the outputs and directions are, in
float32 and float64.

- A clamped output keeps the gradient of a loss that falls towards the inside and loses that of one that falls further
  out: what is differentiated must be minimised, and no lobe gets stuck.
- A lobe with a NaN among its outputs is uniform, and none of its outputs has a gradient.
- A direction that is none (NaN, or not of unit length) has the uniform density, without gradient.

References
----------
Dong et al. 2023, "Neural Parametric Mixtures for Path Guiding", Eqs. (3), (4), table 1. Huang et al. 2024, "Online
Neural Path Guiding with Normalized Anisotropic Spherical Gaussians", Eqs. (10) to (13), table 2.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, SupportsFloat

import torch

from engine.guiding.fields.vmm.numeric import UNIFORM_KAPPA
from engine.guiding.fields.vmm.query import COSINE_LOBE_KAPPA, LEAST_PRODUCT
from engine.guiding.neural.networks.lobes import nasg, vmf

_LOG_FOUR_PI = math.log(4.0 * math.pi)
#: Below this kappa the normalisation is its series; what that leaves out is below 3e-12.
_SERIES_KAPPA = 0.25
#: Squared lengths of what passes for a direction.
_DIRECTION_SQUARED = (0.5, 2.0)


class LobeModel(NamedTuple):
    """Outputs a lobe, and how many lobes a mixture has unless told otherwise."""

    output_count: int
    lobe_count: int


#: 'sg', normalised spherical Gaussians, are von Mises-Fisher lobes, as many as Huang et al. 2024 compare NASG with.
LOBE_MODELS = {
    "vmf": LobeModel(vmf.VMF_OUTPUTS, 8),
    "nasg": LobeModel(nasg.NASG_OUTPUTS, 8),
    "sg": LobeModel(vmf.VMF_OUTPUTS, 14),
}


class Lobes(NamedTuple):
    """N mixtures of K lobes, world axes.

    log_weight : (N, K), weights add up to 1
    kappa : (N, K), concentration; lambda of NASG
    mean : (N, K, 3), unit; axis z of NASG
    a, x : (N, K) and (N, K, 3), eccentricity and axis x of NASG; None: von Mises-Fisher
    """

    log_weight: torch.Tensor
    kappa: torch.Tensor
    mean: torch.Tensor
    a: torch.Tensor | None = None
    x: torch.Tensor | None = None


class _Clamp(torch.autograd.Function):
    """Clamping, but that outside the bounds a descent of the loss may still step inwards."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, low: float, high: float) -> torch.Tensor:
        ctx.save_for_backward(x)
        ctx.bounds = low, high
        return x.clamp(low, high)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        (x,), (low, high), (gradient,) = ctx.saved_tensors, ctx.bounds, gradients
        leads_out = ((x < low) & (gradient > 0.0)) | ((x > high) & (gradient < 0.0))
        return gradient.masked_fill(leads_out, 0.0), None, None


def _exp(x: torch.Tensor, low: SupportsFloat, high: SupportsFloat, is_nan: torch.Tensor) -> torch.Tensor:
    """exp of x clamped, 0 in lobes that are to be uniform."""
    return torch.exp(_Clamp.apply(x, float(low), float(high))).masked_fill(is_nan, 0.0)


def _log_spread(kappa: torch.Tensor) -> torch.Tensor:
    """log((1 - exp(-2 kappa)) / (2 kappa)): the normalisation is 1 / (4 pi spread), kappa 0 included."""
    is_small = kappa < _SERIES_KAPPA
    small = torch.where(is_small, kappa, 0.0)
    large = torch.where(is_small, 1.0, kappa)
    squared = small * small
    # log(sinh(kappa) / kappa) - kappa, whose derivative coth(kappa) - 1 / kappa - 1 cancels otherwise.
    series = squared * (1 / 6 + squared * (-1 / 180 + squared * (1 / 2835 - squared / 37800))) - small
    return torch.where(is_small, series, torch.log(-torch.expm1(-2.0 * large)) - torch.log(2.0 * large))


def _unit_pair(sine: torch.Tensor, cosine: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Sine and cosine in their ratio, squares adding up to 1; (0, 1) without gradient if there is no ratio."""
    squared = sine * sine + cosine * cosine
    is_none = squared < float(nasg.LEAST_PAIR)
    inverse_length = torch.where(is_none, 1.0, squared).rsqrt()
    return torch.where(is_none, 0.0, sine * inverse_length), torch.where(is_none, 1.0, cosine * inverse_length)


def decode(model: str, raw: torch.Tensor) -> Lobes:
    """Mixtures that a network's outputs stand for.

    Parameters
    ----------
    model : str, key of `LOBE_MODELS`
    raw : float (N, K * outputs), lobe by lobe, whatever they are

    Raises
    ------
    ValueError : unknown model, or a width that is no multiple of its outputs.
    """
    if model not in LOBE_MODELS:
        raise ValueError(f"lobe model {model!r} is none of {', '.join(LOBE_MODELS)}")
    output_count = LOBE_MODELS[model].output_count
    if raw.ndim != 2 or raw.shape[1] == 0 or raw.shape[1] % output_count:
        raise ValueError(f"outputs of shape {tuple(raw.shape)} are no lobes of {output_count} each")
    lobes = raw.reshape(raw.shape[0], -1, output_count)
    is_nan = lobes.isnan().any(dim=-1)
    outputs = lobes.masked_fill(is_nan[..., None], 0.0).unbind(dim=-1)
    if model != "nasg":
        logit = outputs[vmf.VMF_LOGIT]
        kappa = _exp(outputs[vmf.VMF_LOG_KAPPA], vmf.LOG_KAPPA_LOW, vmf.LOG_KAPPA_HIGH, is_nan)
        theta = math.pi * torch.sigmoid(outputs[vmf.VMF_THETA])
        phi = 2.0 * math.pi * torch.sigmoid(outputs[vmf.VMF_PHI])
        sine = torch.sin(theta)
        mean = torch.stack([sine * torch.cos(phi), sine * torch.sin(phi), torch.cos(theta)], dim=-1)
        a = x = None
    else:
        logit = outputs[nasg.NASG_LOGIT]
        kappa = _exp(outputs[nasg.NASG_LOG_LAMBDA], nasg.LOG_LAMBDA_LOW, nasg.LOG_LAMBDA_HIGH, is_nan)
        a = _exp(outputs[nasg.NASG_LOG_A], nasg.LOG_A_LOW, nasg.LOG_A_HIGH, is_nan)
        half = 0.5 * outputs[nasg.NASG_COS_THETA]
        cos_theta = torch.tanh(half)
        # 1 / cosh: the square root of 1 - cos^2 cancels, and its gradient has no bound.
        e = torch.exp(-half.abs())
        sin_theta = 2.0 * e / (1.0 + e * e)
        sin_phi, cos_phi = _unit_pair(
            torch.tanh(0.5 * outputs[nasg.NASG_SIN_PHI]), torch.tanh(0.5 * outputs[nasg.NASG_COS_PHI])
        )
        sin_tau, cos_tau = _unit_pair(
            torch.tanh(0.5 * outputs[nasg.NASG_SIN_TAU]), torch.tanh(0.5 * outputs[nasg.NASG_COS_TAU])
        )
        # Eq. (13)
        mean = torch.stack([cos_phi * sin_theta, sin_phi * sin_theta, cos_theta], dim=-1)
        x = torch.stack(
            [
                cos_theta * cos_phi * cos_tau - sin_phi * sin_tau,
                cos_theta * sin_phi * cos_tau + cos_phi * sin_tau,
                -sin_theta * cos_tau,
            ],
            dim=-1,
        )
    logit = _Clamp.apply(logit, float(vmf.LOGIT_LOW), float(vmf.LOGIT_HIGH))
    return Lobes(torch.log_softmax(logit, dim=-1), kappa, mean, a, x)


def _valid_directions(directions: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Which rows are directions, (N,), and the rows (N, 3), with +z where they are none."""
    squared = directions.square().sum(dim=-1)
    is_valid = (squared > _DIRECTION_SQUARED[0]) & (squared < _DIRECTION_SQUARED[1])
    up = torch.tensor([0.0, 0.0, 1.0], dtype=directions.dtype, device=directions.device)
    return is_valid, torch.where(is_valid[:, None], directions, up)


def _decay(lobes: Lobes, wi: torch.Tensor) -> torch.Tensor:
    """Logarithm of each lobe's density over that at its centre: (N, K), <= 0."""
    wi = wi[:, None, :]
    if lobes.a is None or lobes.x is None:
        return -0.5 * lobes.kappa * (wi - lobes.mean).square().sum(dim=-1)
    # As in `eval_nasg`, step by step.
    is_front = (wi * lobes.mean).sum(dim=-1) >= 0.0
    sign = is_front.to(wi.dtype) * 2.0 - 1.0
    chord = wi - sign[..., None] * lobes.mean
    squared = 0.25 * chord.square().sum(dim=-1)
    least = torch.where(is_front, float(nasg.LEAST_SQUARED), float(nasg.LEAST_GAP))
    short = torch.maximum(squared, least.to(wi.dtype))
    along = (chord * lobes.x).sum(dim=-1)
    q = lobes.a * (along * along / (4.0 * short * (1.0 - short))).clamp(max=1.0)
    log_g = torch.where(is_front, torch.log1p(-short), torch.log(short))
    return 2.0 * lobes.kappa * torch.expm1((1.0 + q) * log_g) + q * log_g


def log_pdf(lobes: Lobes, wi: torch.Tensor) -> torch.Tensor:
    """Logarithm of the mixtures' densities.

    Parameters
    ----------
    lobes : Lobes
    wi : float (N, 3), unit, world; no gradient is meant to go there

    Returns
    -------
    (N,), log of sr^-1
    """
    is_valid, wi = _valid_directions(wi)
    log_density = lobes.log_weight - _log_spread(lobes.kappa) - _LOG_FOUR_PI + _decay(lobes, wi)
    if lobes.a is not None:
        log_density = log_density + 0.5 * torch.log1p(lobes.a)
    return torch.where(is_valid, torch.logsumexp(log_density, dim=-1), -_LOG_FOUR_PI)


def multiply_cosine(lobes: Lobes, n: torch.Tensor) -> Lobes:
    """Von Mises-Fisher mixtures times the lobe nearest to the clamped cosine about n, normalised.

    Parameters
    ----------
    lobes : Lobes, von Mises-Fisher
    n : float (N, 3), unit, world; mixtures stay as they are where it is no direction

    Raises
    ------
    ValueError : NASG, whose product has no closed form.

    References
    ----------
    Dong et al. 2023, section 4.3. Herholz et al. 2016, "Product Importance Sampling for Light Transport Path Guiding".
    """
    if lobes.a is not None:
        raise ValueError("the product of an anisotropic lobe with the cosine has no closed form")
    kappa_b = float(COSINE_LOBE_KAPPA)
    is_valid, n = _valid_directions(n)
    n = n[:, None, :]
    deficit = lobes.kappa * kappa_b * (lobes.mean - n).square().sum(dim=-1)
    kappa_sum = lobes.kappa + kappa_b
    squared_kappa = kappa_sum * kappa_sum - deficit
    vector = lobes.kappa[..., None] * lobes.mean + kappa_b * n
    squared = vector.square().sum(dim=-1)
    is_uniform = (squared_kappa < float(UNIFORM_KAPPA) ** 2) | (squared < float(LEAST_PRODUCT))
    kappa = torch.where(is_uniform, 0.0, torch.where(is_uniform, 1.0, squared_kappa).sqrt())
    inverse_length = torch.where(is_uniform, 1.0, squared).rsqrt()
    mean = torch.where(is_uniform[..., None], n, vector * inverse_length[..., None])
    # kappa' - kappa_a - kappa_b without its cancellation.
    exponent = -deficit / (kappa + kappa_sum)
    log_weight = lobes.log_weight - _log_spread(lobes.kappa) + exponent + _log_spread(kappa)
    log_weight = torch.log_softmax(log_weight, dim=-1)
    return Lobes(
        torch.where(is_valid[:, None], log_weight, lobes.log_weight),
        torch.where(is_valid[:, None], kappa, lobes.kappa),
        torch.where(is_valid[:, None, None], mean, lobes.mean),
    )
