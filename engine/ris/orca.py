# SPDX-License-Identifier: GPL-3.0-or-later
"""Optimised resampling candidate allocation: how many candidates a vertex is worth.

References: Rath, Manzi et al. 2025, "Neural Resampling with Optimized Candidate Allocation", section 4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from engine.array_types import Float32Array
from engine.ris.candidates import MAX_CANDIDATES
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel

#: Candidates a vertex of a recorded path gets on average without a reason for more: enough resampling to keep the
#: estimates coming. Others bring none, and get one.
FLOOR = np.float32(1.125)
#: Variance that a candidate must save, over what its cost is worth: savings along a path do not add up, and samples
#: spread evenly over a pixel have less to save than single ones (docs/decisions/candidates.md).
LEAST_RETURN = 2.0
#: Where more variance than any would be saved by a candidate: kernels have float32 for it.
_LARGEST_SCALE = 1e30
#: Mean radiance of an image, as far as its square fits float32.
_DARKEST, _BRIGHTEST = 1e-15, 1e15
#: Added to the squared pixel value (over the image's mean) in the relative error.
RELATIVE_EPSILON = np.float32(0.01)
#: Share of the vertices of recorded paths at which allocation is tried while it is not in use.
PROBED_SHARE = 0.25
#: Estimates a region needs before they are believed.
MIN_ESTIMATES = 32
#: Largest share of a region's sum that a single estimate may have.
OUTLIER_SHARE = 0.1
#: Iterations whose estimates are kept: the fields they judge change.
KEPT_ITERATIONS = 3


class Allocation(Bundle):
    """What `candidate_count` reads.

    variance_delta : float32 (R,), mean over a region's vertices of the variance of the reflected radiance under source
        sampling less that under target sampling, Eq. (19); NaN where there are no estimates
    constants : float32 (2,): cost of the image over its variance and over the cost of a candidate,
        C_I / (V_I K0) of Eq. (13), by LEAST_RETURN, and the least count worth resampling for, `least_count`
    """

    variance_delta: Float32Array
    constants: Float32Array


def no_allocation() -> Allocation:
    """An allocation without estimates, to stand where there is none."""
    return Allocation(np.full(1, np.nan, np.float32), np.zeros(2, np.float32))


@kernel
def candidate_count(allocation, leaf, throughput_squared, is_recorded, u):
    """Candidates of a vertex: the fixed point of Eq. (13), the switch to source sampling, stochastic rounding.

    Parameters
    ----------
    leaf : int, region the vertex lies in; -1 = none
    throughput_squared : float32
        Squared throughput of the path before the vertex, mean over channels, over the squared pixel value for the
        relative error.
    is_recorded : bool, whether it yields an estimate
    u : float32 in [0, 1)
    """
    count = FLOOR if is_recorded else np.float32(1.0)
    if leaf >= 0:
        squared = throughput_squared * allocation.variance_delta[leaf] * allocation.constants[0]
        # NaN (no estimates) and a target worse than the source fail here.
        if squared > 0.0:
            wanted = np.float32(math.sqrt(squared))
            if wanted > allocation.constants[1]:
                count = min(max(wanted, count), np.float32(MAX_CANDIDATES))
    whole = int(count)
    if u < count - whole:
        whole += 1
    return min(whole, MAX_CANDIDATES)


@dataclass
class CandidateCosts:
    """Costs in rays: the time of each divided by all time per ray.

    per_candidate, per_vertex : K0 and K1 of Eq. (12); per_source_sample : of a vertex with one candidate

    The defaults are what the statistical fields cost in a render of a room on two cores; they stand in for clocks where
    an image must not depend on any, or before there is anything to measure.
    """

    per_candidate: float = 0.3
    per_vertex: float = 0.25
    per_source_sample: float = 0.3


def least_count(costs: CandidateCosts) -> float:
    """Count from which on resampling is more efficient than source sampling, Eqs. (11), (12) and (21) solved for it.

    Resampling `c` candidates saves (1 - 1 / c) of the variance delta for c K0 + K1, and source sampling costs Ks, so it
    pays from the c with c^2 - 2 c = (K1 - Ks) / K0 on. Eq. (22), c = sqrt(K1 / K0), leaves out the candidates' own cost
    and that of source sampling; with it vertices were resampled that cost more than they saved
    (docs/decisions/candidates.md).
    """
    return 1.0 + math.sqrt(max(1.0 + (costs.per_vertex - costs.per_source_sample) / costs.per_candidate, 0.0))


@dataclass
class VarianceDeltas:
    """Estimates of Eq. (19) by position, binned anew into the regions of each field."""

    positions: list[np.ndarray] = field(default_factory=list)
    estimates: list[np.ndarray] = field(default_factory=list)

    def add(self, position: np.ndarray, estimate: np.ndarray) -> None:
        """Take an iteration's records; rows whose estimate is not finite are skipped.

        Parameters
        ----------
        position : float32 (R, 3); estimate : float32 (R,)
        """
        known = np.isfinite(estimate)
        self.positions = [*self.positions, position[known].copy()][-KEPT_ITERATIONS:]
        self.estimates = [*self.estimates, estimate[known].copy()][-KEPT_ITERATIONS:]

    def gathered(self) -> tuple[np.ndarray, np.ndarray]:
        """All kept positions (R, 3) and estimates (R,)."""
        if not self.positions:
            return np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
        return np.ascontiguousarray(np.concatenate(self.positions)), np.concatenate(self.estimates)


def mean_by_region(leaf: np.ndarray, estimate: np.ndarray, region_count: int) -> np.ndarray:
    """Mean estimate of each region, no estimate weighing more than OUTLIER_SHARE of its region's absolute sum.

    Parameters
    ----------
    leaf : int32 (R,), region of each estimate, -1 = none

    Returns
    -------
    float32 (region_count,), NaN where there are fewer than MIN_ESTIMATES
    """
    inside = leaf >= 0
    leaf, estimate = leaf[inside], estimate[inside].astype(np.float64)
    count = np.bincount(leaf, minlength=region_count)
    total = np.bincount(leaf, weights=np.abs(estimate), minlength=region_count)
    limit = OUTLIER_SHARE * total[leaf]
    clipped = np.clip(estimate, -limit, limit)
    mean = np.bincount(leaf, weights=clipped, minlength=region_count) / np.maximum(count, 1)
    mean[count < MIN_ESTIMATES] = np.nan
    return mean.astype(np.float32)


def pixel_weights(mean: np.ndarray) -> np.ndarray:
    """Weight of each pixel's variance: 1 / (filtered value^2 + 0.01), values over the image's mean.

    Parameters
    ----------
    mean : float32 (height, width, C), the image so far

    Returns
    -------
    float32 (height * width,), times 1 / mean^2, so that variances times these have no unit
    """
    value = np.clip(mean, -_BRIGHTEST, _BRIGHTEST).mean(axis=2, dtype=np.float64)
    # Within what its inverse square has room for: an image may be black.
    scale = min(max(float(value.mean()), _DARKEST), _BRIGHTEST)
    value = value / scale
    padded = np.pad(value, 2, mode="edge") / 25.0
    height, width = value.shape
    smooth = np.zeros_like(value)
    for row in range(5):
        for column in range(5):
            smooth += padded[row : row + height, column : column + width]
    return (1.0 / (smooth**2 + RELATIVE_EPSILON) / scale**2).astype(np.float32).ravel()


def sample_variance(mean: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Variance of one sample by its moments, mean over channels.

    Parameters
    ----------
    mean, square : float32 (P, C), first and second moment of a sample

    Returns
    -------
    float64 (P,)
    """
    return np.maximum(square.astype(np.float64) - mean.astype(np.float64) ** 2, 0.0).mean(axis=1)


def image_variance(variance: np.ndarray, weights: np.ndarray) -> float:
    """Weighted variance of one sample of a pixel, averaged over the image with its worst 0.1% cut off.

    Parameters
    ----------
    variance : float64 (P,), of one sample, NaN where it is not known
    weights : float32 (P,), of `pixel_weights`

    Returns
    -------
    float
        0 where it is known nowhere.
    """
    known = np.isfinite(variance)
    weighted = variance[known] * weights[known]
    return float(np.minimum(weighted, np.quantile(weighted, 0.999)).mean()) if weighted.size else 0.0


def make_allocation(
    variance_delta: np.ndarray, *, ray_count: float, variance: float, costs: CandidateCosts
) -> Allocation:
    """Allocation for the next iteration.

    Parameters
    ----------
    variance_delta : float32 (R,)
    ray_count : float
        Cost of a path in rays, C_I over the number of paths of one sample.
    variance : float
        `image_variance`, V_I over the number of pixels.
    """
    saved, least = LEAST_RETURN * variance * costs.per_candidate, ray_count / _LARGEST_SCALE
    scale = ray_count / max(saved, least) if variance > 0.0 and least > 0.0 else 0.0
    delta = variance_delta if len(variance_delta) else np.full(1, np.nan, np.float32)
    return Allocation(np.ascontiguousarray(delta, np.float32), np.array([scale, least_count(costs)], np.float32))
