# SPDX-License-Identifier: GPL-3.0-or-later
"""What rows weigh in the training of a mixture, in torch's operations: `row_weights.py` for a device."""

from __future__ import annotations

import torch

from engine.guiding.neural.networks.mixture.shape import MixtureSettings, MixtureShape
from engine.guiding.neural.worker.row_weights import LEAST_BEARERS, MOST_SHARE
from engine.guiding.records.training_rows import (
    ROW_BSDF_PDF,
    ROW_GUIDE_PDF,
    ROW_NORMAL,
    ROW_PDF,
    ROW_RADIANCE,
    ROW_REFLECTANCE,
    ROW_WI,
)


def targets_torch(shape: MixtureShape, rows: torch.Tensor) -> torch.Tensor:
    """`targets` of rows (N, ROW_WIDTH): float64 (N,)."""
    values = rows[:, ROW_RADIANCE].double()
    if shape.target == "PRODUCT":
        return values * rows[:, ROW_REFLECTANCE]
    if shape.target == "COSINE":
        normal = rows[:, ROW_NORMAL : ROW_NORMAL + 3].double()
        return values * (normal * rows[:, ROW_WI : ROW_WI + 3]).sum(dim=1).abs()
    return values


def row_weights_torch(shape: MixtureShape, settings: MixtureSettings, rows: torch.Tensor) -> torch.Tensor:
    """`row_weights` of rows (N, ROW_WIDTH): float32 (N,)."""
    weights = targets_torch(shape, rows) / (rows[:, ROW_PDF] + settings.epsilon)
    if settings.mis_compensation:
        guide = (1.0 - settings.bsdf_share) * rows[:, ROW_GUIDE_PDF].double()
        both = guide + settings.bsdf_share * rows[:, ROW_BSDF_PDF]
        weights = torch.where(guide > 0.0, weights * guide / both, weights)
    weights = limit_outliers_torch(weights.nan_to_num(0.0, 0.0, 0.0), settings.outlier_share, settings.kept_weight)
    mean = weights.mean()
    return torch.where(mean > 0.0, weights / mean, weights).float()


def limit_shares_torch(weights: torch.Tensor, share: float) -> torch.Tensor:
    """`limit_shares` of weights float64 (N,)."""
    count = len(weights)
    share = min(1.0, max(share, LEAST_BEARERS / max(count, 1)))
    descending = weights.sort(descending=True).values
    # With the k heaviest at the limit c: c = share * (k c + the rest).
    rest = descending.flip(0).cumsum(0).flip(0)
    free = 1.0 - share * torch.arange(count, dtype=torch.float64, device=weights.device)
    limits = share * rest / free
    fits = (free > 0.0) & (limits > 0.0) & (limits >= descending)
    # The first that fits; where none does, so few rows have light that no limit exists: let them weigh the same.
    limit = limits[fits.int().argmax()]
    return torch.where(fits.any(), torch.minimum(weights, limit), (weights > 0.0).double())


def limit_outliers_torch(weights: torch.Tensor, share: float, kept: float) -> torch.Tensor:
    """`limit_outliers` of weights float64 (N,)."""
    strict = limit_shares_torch(weights, share)
    if kept == 0.0:
        return strict
    total = weights.sum()
    descending = weights.sort(descending=True).values
    # With the k heaviest at the limit c: k c + the rest = kept * total; the first c that the next one is below.
    rest = total - descending.cumsum(0)
    limits = (kept * total - rest) / torch.arange(1, len(weights) + 1, dtype=torch.float64, device=weights.device)
    fits = limits >= torch.cat((descending[1:], descending.new_zeros(1)))
    mild = limit_shares_torch(torch.minimum(weights, limits[fits.int().argmax()]), max(share, MOST_SHARE))
    return torch.where(strict.sum() >= kept * total, strict, mild)
