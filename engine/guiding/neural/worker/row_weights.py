# SPDX-License-Identifier: GPL-3.0-or-later
"""What rows weigh in the training of a mixture: their target over the density they were drawn with, outliers cut.

References
----------
Dong et al. 2023, "Neural Parametric Mixtures for Path Guiding", Eqs. 8 and 9.
Dong et al. 2024, "Efficient Neural Path Guiding with 4D Modeling", Eq. 12.
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.neural.networks.mixture.shape import MixtureSettings, MixtureShape
from engine.guiding.records.training_rows import (
    ROW_BSDF_PDF,
    ROW_GUIDE_PDF,
    ROW_NORMAL,
    ROW_PDF,
    ROW_RADIANCE,
    ROW_REFLECTANCE,
    ROW_WI,
)

#: Rows of a batch that must be able to bear all of its weight.
LEAST_BEARERS = 8
#: Share of the weight that a row has at most where few rows have nearly all of it.
MOST_SHARE = 1.0 / 128.0


def targets(shape: MixtureShape, rows: Float32Array) -> np.ndarray:
    """What the mixture is to be proportional to, at the direction of each row.

    Parameters
    ----------
    rows : float32 (N, ROW_WIDTH)

    Returns
    -------
    float64 (N,), not negative
    """
    values = rows[:, ROW_RADIANCE].astype(np.float64)
    if shape.target == "PRODUCT":
        return values * rows[:, ROW_REFLECTANCE]
    if shape.target == "COSINE":
        normal = rows[:, ROW_NORMAL : ROW_NORMAL + 3].astype(np.float64)
        return values * np.abs((normal * rows[:, ROW_WI : ROW_WI + 3]).sum(axis=1))
    return values


def row_weights(shape: MixtureShape, settings: MixtureSettings, rows: Float32Array) -> Float32Array:
    """Weights of a batch's rows: target over density, none above a share of them all, one on average.

    Parameters
    ----------
    rows : float32 (N, ROW_WIDTH)

    Returns
    -------
    float32 (N,), finite and not negative; all zero if no row has light
    """
    with np.errstate(all="ignore"):
        weights = targets(shape, rows) / (rows[:, ROW_PDF] + settings.epsilon)
        if settings.mis_compensation:
            # Eq. 12. Rows from before there was a guide, where the BSDF had to do alone, count in full.
            guide = (1.0 - settings.bsdf_share) * rows[:, ROW_GUIDE_PDF].astype(np.float64)
            both = guide + settings.bsdf_share * rows[:, ROW_BSDF_PDF]
            weights = np.where(guide > 0.0, weights * guide / both, weights)
    weights[~np.isfinite(weights)] = 0.0
    weights = limit_outliers(weights, settings.outlier_share, settings.kept_weight)
    mean = weights.mean()
    return (weights / mean if mean > 0.0 else weights).astype(np.float32)


def limit_shares(weights: np.ndarray, share: float) -> np.ndarray:
    """Cut weights so that none is above `share` of the sum of all, cut ones included.

    Parameters
    ----------
    weights : float64 (N,), finite and not negative
    share : float
        Raised where N is small, so that a few rows can always bear all the weight.

    Returns
    -------
    float64 (N,)
    """
    share = min(1.0, max(share, LEAST_BEARERS / max(weights.size, 1)))
    descending = np.sort(weights)[::-1]
    # With the k heaviest at the limit c: c = share * (k c + the rest).
    rest = np.concatenate((np.cumsum(descending[::-1])[::-1], (0.0,)))
    for k in range(weights.size):
        free = 1.0 - share * k
        if free <= 0.0:
            break
        limit = share * rest[k] / free
        if 0.0 < limit >= descending[k]:
            # The k heaviest are cut, and no other.
            return np.minimum(weights, limit)
    # So few rows have light that no limit exists: let them weigh the same.
    return (weights > 0.0).astype(np.float64)


def limit_outliers(weights: np.ndarray, share: float, kept: float) -> np.ndarray:
    """`limit_shares`, but less strict where it would cut away more than 1 - `kept` of all weight.

    A few rows may be noise. Where most of the light is in few rows it is a caustic, seldom found because it is not
    guided to yet: to cut those is to learn never to look there. Still, none weighs more than a share of MOST_SHARE.

    Parameters
    ----------
    weights : float64 (N,), finite and not negative
    share, kept : float in [0, 1]

    Returns
    -------
    float64 (N,)
    """
    strict = limit_shares(weights, share)
    total = weights.sum()
    if strict.sum() >= kept * total:
        return strict
    descending = np.sort(weights)[::-1]
    # With the k heaviest at the limit c: k c + the rest = kept * total; the first c that the next one is below.
    rest = total - np.cumsum(descending)
    limits = (kept * total - rest) / np.arange(1, weights.size + 1)
    fits = limits >= np.append(descending[1:], 0.0)
    return limit_shares(np.minimum(weights, limits[np.argmax(fits)]), max(share, MOST_SHARE))
