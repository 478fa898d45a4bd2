# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: propose directions by the guide and by the BSDF."""

from engine.guiding.vmm.field import GUIDE_LINES
from engine.guiding.vmm.query import eval_guide, sample_guide
from engine.jit import kernel
from engine.kernels.bsdf import ROUGH_LOBES, eval_guided, sample_among
from engine.kernels.path import real_3
from engine.kernels.prefetch import (
    ask_for_closures,
    ask_for_point,
    ask_for_throughput,
    lane_ahead,
    prefetch_lines,
)
from engine.kernels.rng import sample_4d
from engine.kernels.vector import normalize, store
from engine.ris.candidates import MAX_CANDIDATES
from engine.state import POINT_NG, POINT_P, POINT_WO

#: Offset of a vertex's candidates among the path's dimensions, far from those of its vertices.
SET_CANDIDATES = 1 << 16


@kernel
def propose(paths, points, closures, guided, guide, lane, j, f_cos, row):
    """The lane's j-th candidate, by the guide with the lane's guiding probability, else by the BSDF's rough lobes.

    Parameters
    ----------
    f_cos : float32 (>= row + 1, C)
        The BSDF's value times the cosine goes to its row `row`.

    Returns
    -------
    wi : tuple of 3 float32, unit
    source_pdf : float32 [sr^-1]
        Density of the mixture, Eq. (7).
    bsdf_pdf, guide_pdf : float32 [sr^-1]
    label : int; roughness, eta : float32
        As `sample_bsdf` returns them.
    is_valid : bool
        False: there is no such candidate, it counts as one of value 0.
    """
    wo = real_3(points, lane, POINT_WO)
    ng = real_3(points, lane, POINT_NG)
    probability = guided.probability[lane]
    u0, u1, u2, u3 = sample_4d(
        paths.rng[lane], paths.sample[lane] * MAX_CANDIDATES + j, paths.dimension[lane] + SET_CANDIDATES
    )
    if u0 < probability:
        wi = sample_guide(guide, lane, u0 / probability, u1, u2)
        bsdf_pdf, label, roughness, eta = eval_guided(closures, lane, wo, wi, ng, u3, f_cos, row)
    else:
        u0 = (u0 - probability) / (1.0 - probability)
        bsdf_pdf, wi, label, roughness, eta = sample_among(
            closures, lane, wo, ng, ROUGH_LOBES, u0, u1, u2, f_cos, row
        )
        wi = normalize(wi)
        if not bsdf_pdf > 0.0:
            label = 0
    guide_pdf = eval_guide(guide, lane, wi)
    source_pdf = probability * guided.rough_share[lane] * guide_pdf + (1.0 - probability) * bsdf_pdf
    largest = 0.0
    for c in range(len(paths.channels)):
        largest = max(largest, f_cos[row, c])
    # Written so that NaN fails.
    is_valid = label != 0 and largest > 0.0 and source_pdf > 0.0
    return wi, source_pdf, bsdf_pdf, guide_pdf, label, roughness, eta, is_valid


@kernel
def draw_candidates(paths, points, closures, guided, guide, candidates, lanes, first, lane_count):
    """Fill `candidates` for lanes from the `first`-th on, as many as fit (see `propose`).

    The candidates of a vertex are a stratified set.

    Parameters
    ----------
    lanes : int32 (>= lane_count,)
        Lanes to resample, with at least one candidate each.

    Returns
    -------
    next_lane : int
        Where to go on.
    vertex_count, row_count : int
    """
    row = 0
    vertex = 0
    k = first
    capacity = candidates.label.shape[0]
    while k < lane_count and row + guided.candidate_count[lanes[k]] <= capacity:
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_throughput(paths, ahead)
        ask_for_point(points, ahead)
        ask_for_closures(closures, ahead)
        prefetch_lines(guide.lobes, ahead, GUIDE_LINES)
        k += 1
        candidates.lane[vertex] = lane
        candidates.first[vertex] = row
        store(candidates.position, vertex, real_3(points, lane, POINT_P))
        for j in range(guided.candidate_count[lane]):
            wi, source_pdf, bsdf_pdf, guide_pdf, label, roughness, eta, is_valid = propose(
                paths, points, closures, guided, guide, lane, j, candidates.f_cos, row
            )
            candidates.vertex[row] = vertex
            store(candidates.direction, row, wi)
            candidates.source_pdf[row] = source_pdf
            candidates.bsdf_pdf[row] = bsdf_pdf
            candidates.guide_pdf[row] = guide_pdf
            candidates.label[row] = label
            candidates.roughness[row] = roughness
            candidates.eta[row] = eta
            candidates.is_valid[row] = 1 if is_valid else 0
            row += 1
        vertex += 1
    return k, vertex, row
