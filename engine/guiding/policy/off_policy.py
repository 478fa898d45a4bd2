# SPDX-License-Identifier: GPL-3.0-or-later
"""What a predictor would bring to resampling, told by records of paths that knew nothing of it: nothing is rendered.

Given infinite candidates, resampling picks directions by p_t = alpha p̂ / Z + (1 - alpha) q: p̂ is what the predictor
says, times the BSDF, Z its integral, and the rest is the defensive part (Rath et al. 2025, Eq. 8) of the source density
q. A vertex then adds the second moment M = integral (T f L)^2 / p_t, under source sampling integral (T f L)^2 / q. A
record that was taken with weight W is an estimate of both, from the same direction: c^2 / (W p_t), c being what it
brought to its pixel. Z is the mean of W p̂ over those of a region whose surfaces face alike. Without the defensive part
M = Z integral (T f L)^2 / p̂.

Directions that are black leave no record, so Z comes out a little large, and the promise small.

Where the albedo differs within a region so does Z. So the BSDF in p̂ is taken over its albedo, which is the density of
BSDF sampling: that integrates to one at each vertex.

Records must be held out: those that a predictor has learned from flatter it.

References: Rath, Manzi et al. 2025, "Neural Resampling with Optimized Candidate Allocation", Eqs. (8), (11) to (13) and
(16) to (19); Owen and Zhou 2000, "Safe and Effective Importance Sampling", on what the defensive part bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.array_types import Float32Array, Int32Array, Int64Array
from engine.guiding.fields.table import predict_table
from engine.guiding.fields.vmm.field import VmmField, allocate_guide
from engine.guiding.fields.vmm.leaves import find_leaves
from engine.guiding.fields.vmm.query import eval_vmm, predict_vmm, prepare_vmm
from engine.guiding.models.predictors import Predictions
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.records.collisions import is_collision
from engine.guiding.records.vertices import VertexRecords
from engine.kernels.vector import load
from engine.ris.candidates import MAX_CANDIDATES, MIXTURE_SHARE
from engine.ris.orca import LEAST_RETURN, OUTLIER_SHARE, CandidateCosts, least_count
from engine.runtime.jit import kernel

#: Densities below this share of the other one's count as this: estimates, not bounds.
_LEAST_SHARE = np.float32(1e-3)
#: Of a cube.
_SIDES = 6


@kernel
def _predict_mixtures(field, leaf, positions, normals, directions, guide, out):
    """Radiance by the regions' mixtures, 0 where there is none."""
    for row in range(leaf.shape[0]):
        out[row] = 0.0
        if leaf[row] < 0 or field.is_ready[leaf[row]] == 0:
            continue
        wi = load(directions, row)
        prepare_vmm(field, leaf[row], load(positions, row), load(normals, row), False, guide, 0)
        out[row] = predict_vmm(guide, 0, wi, eval_vmm(guide, 0, wi))


@kernel
def _predict_tables(table, leaf, directions, out):
    """Radiance by the regions' tables, 0 where there is none."""
    for row in range(leaf.shape[0]):
        for c in range(out.shape[1]):
            out[row, c] = 0.0
        if leaf[row] >= 0:
            predict_table(table, leaf[row], load(directions, row), out, row)


def predict(predictions: Predictions, field: VmmField, records: VertexRecords, leaf: Int32Array) -> Float32Array:
    """Incident radiance along the records' directions as resampling would weigh by it, mean over channels.

    Parameters
    ----------
    predictions : Predictions
        Without table and model the mixture alone predicts.
    field : VmmField
    records : VertexRecords, R rows
    leaf : int32 (R,)
        Region of `field` that each lies in, -1 = none.

    Returns
    -------
    float32 (R,)
        Not negative and finite, whatever a model says.
    """
    count = len(leaf)
    mixture = np.zeros(count, np.float32)
    _predict_mixtures(field, leaf, records.position, records.normal, records.direction, allocate_guide(1), mixture)
    out = np.zeros((count, records.radiance.shape[1]), np.float32)
    if predictions.model is not None:
        predictions.model.predict(records.position, records.time, records.hero, records.direction, out)
    elif predictions.table is not None:
        _predict_tables(predictions.table, leaf, records.direction, out)
    else:
        return mixture
    learned = np.where((out > 0.0) & np.isfinite(out), out, np.float32(0.0)).mean(axis=1)
    return (learned + MIXTURE_SHARE * (mixture - learned)).astype(np.float32)


@dataclass(frozen=True)
class HeldOut:
    """Records of guided vertices, and by what they were drawn.

    records : VertexRecords, R rows
    leaf : int32 (R,), region of each, none is -1
    source_pdf : float32 (R,) [sr^-1], q
    field : VmmField
    path_count : float, recorded paths that these are of
    """

    records: VertexRecords
    leaf: Int32Array
    source_pdf: Float32Array
    field: VmmField
    path_count: float


def hold_out(
    records: VertexRecords, row_count: int, field: VmmField, probability: Float32Array, path_count: float,
    rules: Rules = RULES,
) -> HeldOut:
    """Those records that a guided path can tell something by, or an even share of them.

    Parameters
    ----------
    records : VertexRecords
        Records of paths that were guided by `field` with `probability`; neither has learned from them.
    row_count : int
    probability : float32 (regions,) or twice as many, of guiding, as `RegionModels.probability`
    path_count : float
        Recorded paths that they are of.
    rules : Rules
    """
    leaf = np.full(row_count, -1, np.int32)
    find_leaves(field, records.position[:row_count], leaf)
    # NaN: vertices that were not guided.
    known = np.flatnonzero((leaf >= 0) & (records.guide_pdf[:row_count] >= 0.0))
    step = max(-(-len(known) // rules.held_out_records), 1)
    kept = known[::step]
    chosen = VertexRecords(*(np.ascontiguousarray(column[kept]) for column in records))
    # Media have rows of their own behind those of surfaces.
    of_media = np.where(is_collision(chosen, len(kept)), len(probability) - len(field.is_ready), 0)
    share = probability[leaf[kept] + of_media]
    bsdf_pdf = np.maximum(chosen.bsdf_pdf, _LEAST_SHARE * chosen.guide_pdf)
    source_pdf = share * chosen.guide_pdf + (1.0 - share) * bsdf_pdf
    return HeldOut(chosen, leaf[kept], source_pdf.astype(np.float32), field, path_count / step)


def _cut(estimate: np.ndarray, leaf: Int32Array, region_count: int) -> np.ndarray:
    """What is kept of each estimate so that none has more than its share of a region's sum: float64 (R,) in [0, 1]."""
    limit = OUTLIER_SHARE * np.bincount(leaf, estimate, region_count)
    return np.minimum(1.0, limit[leaf] / np.maximum(estimate, 1e-300))


def _side(normal: Float32Array) -> Int64Array:
    """Which of a cube's sides a normal points at: int64 (R,)."""
    axis = np.abs(normal).argmax(axis=1)
    return 2 * axis + (np.take_along_axis(normal, axis[:, None], axis=1)[:, 0] > 0.0)


@dataclass(frozen=True)
class Moments:
    """What vertices bring to their pixels' second moment, R regions.

    count : int64 (R,), records
    known : float64 (R,), the effective number of them: those that nearly all the moment comes from
    source, target : float64 (R,), mean over a region's records under source sampling, and under the target's density
    reflected : float64 (R,), the same under source sampling of paths of throughput one before the vertex
    lit_leaf : int32 (K,), regions of the records that have found light
    throughput_squared : float64 (K,), of their paths before the vertex, relative to their pixels
    """

    count: np.ndarray
    known: np.ndarray
    source: np.ndarray
    target: np.ndarray
    reflected: np.ndarray
    lit_leaf: np.ndarray
    throughput_squared: np.ndarray


def moments(held: HeldOut, predicted: Float32Array, alpha: float) -> Moments:
    """Second moments by region under source sampling, and under what a predictor would have resampling pick by.

    No record has more than a tenth of a region's second moment.

    Parameters
    ----------
    held : HeldOut
    predicted : float32 (R,)
        Incident radiance along the records' directions, in any unit.
    alpha : float in [0, 1]
        Share of the choice that goes by what was predicted (`RenderSettings.defensive_alpha`).
    """
    records, leaf = held.records, held.leaf
    region_count = len(held.field.is_ready)
    weight = 1.0 / np.maximum(records.pdf.astype(np.float64), 1e-20)
    # The BSDF over its albedo.
    bsdf_pdf = np.maximum(records.bsdf_pdf, _LEAST_SHARE * held.source_pdf).astype(np.float64)
    target = bsdf_pdf * predicted
    count = np.bincount(leaf, minlength=region_count)
    alike = _SIDES * leaf + _side(records.normal)
    norm = np.bincount(alike, target * weight, _SIDES * region_count)
    norm = (norm / np.maximum(np.bincount(alike, minlength=len(norm)), 1))[alike]
    # What predicts nothing anywhere leaves the choice to the defensive part, as `engine.ris.resample` does.
    share = np.where(norm > 0.0, alpha, 0.0)
    density = share * target / np.maximum(norm, 1e-300) + (1.0 - share) * held.source_pdf
    squared = np.nan_to_num(records.contribution_squared.astype(np.float64), nan=0.0, posinf=0.0)
    of_source = squared / (weight * np.maximum(held.source_pdf, 1e-20))
    kept = _cut(of_source, leaf, region_count)
    of_target = squared / (weight * np.maximum(density, 1e-20))

    def mean(estimate: np.ndarray) -> np.ndarray:
        return np.bincount(leaf, kept * estimate, region_count) / np.maximum(count, 1)

    source = mean(of_source)
    squares = np.bincount(leaf, (kept * of_source) ** 2, region_count)
    known = (count * source) ** 2 / np.maximum(squares, 1e-300)
    # What c is without the throughput.
    alone = (weight * records.reflectance * records.radiance.mean(axis=1)) ** 2
    lit = np.flatnonzero((alone > 0.0) & np.isfinite(alone) & (squared > 0.0))
    lit_leaf, throughput = leaf[lit], squared[lit] / alone[lit]
    reflected = np.bincount(lit_leaf, _cut(alone[lit], lit_leaf, region_count) * alone[lit], region_count)
    return Moments(
        count, known, source, mean(of_target), reflected / np.maximum(count, 1), lit_leaf,
        throughput * _cut(throughput, lit_leaf, region_count),
    )


def promised_efficiency(
    found: Moments, path_count: float, *, variance: float, ray_count: float, costs: CandidateCosts,
    rules: Rules = RULES,
) -> float:
    """Efficiency, 1 / (variance x cost), of the image with as many candidates by region as pay, over that with one.

    c candidates save (1 - 1 / c) of the difference of the moments (Eq. 11), and cost c K0 + K1 instead of the source
    sample (Eq. 12). c is what allocation would take (Eq. 13), vertex by vertex: most of what there is to save lies at
    the few whose paths weigh much. Vertices without light are taken to be like those with it. Regions that know little
    go by the ratio of the moments of all.

    Parameters
    ----------
    found : Moments
    path_count : float
        Paths that the records are of.
    variance : float
        Variance of a sample of a pixel, weighted as the records' contributions are (`image_variance`).
    ray_count : float
        Cost of a path in rays.
    costs : CandidateCosts
    rules : Rules
    """
    if not (variance > 0.0 and path_count > 0.0 and ray_count > 0.0):
        return 1.0
    ratio = found.target / np.maximum(found.source, 1e-300)
    whole = (found.count * found.target).sum() / max((found.count * found.source).sum(), 1e-300)
    ratio = (found.known * ratio + rules.held_out_prior * whole) / (found.known + rules.held_out_prior)
    gain = np.maximum(1.0 - ratio, 0.0)
    leaf, throughput = found.lit_leaf, found.throughput_squared
    scale = ray_count / max(LEAST_RETURN * variance * costs.per_candidate, 1e-300)
    wanted = np.sqrt(throughput * (found.reflected * gain)[leaf] * scale)
    several = wanted > least_count(costs)
    count = np.where(several, np.minimum(wanted, MAX_CANDIDATES), 1.0)
    spent = np.where(several, costs.per_candidate * count + costs.per_vertex - costs.per_source_sample, 0.0)
    region_count = len(found.count)

    def by_region(values: np.ndarray, weight: np.ndarray) -> np.ndarray:
        return np.bincount(leaf, weight * values, region_count) / np.maximum(
            np.bincount(leaf, weight, region_count), 1e-300
        )

    saved = found.count * found.source * gain * by_region(1.0 - 1.0 / count, throughput)
    cost = found.count * by_region(spent, np.ones(len(leaf)))
    return float((1.0 + saved.sum() / path_count / variance) / (1.0 + max(cost.sum() / path_count, 0.0) / ray_count))
