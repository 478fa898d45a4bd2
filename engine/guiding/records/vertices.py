# SPDX-License-Identifier: GPL-3.0-or-later
"""What a path in flight remembers of its vertices, and how that becomes records when it ends.

A path gathers its radiance in one sum. The light that came in along a vertex's direction is therefore what the sum
gained after the vertex, divided by the throughput behind it: two spectra kept per vertex, no walk back at every light.
Light found by the scattering itself is in the sum with its MIS weight, light sampling at the vertex came before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from engine.array_types import Float32Array, Int32Array, Uint8Array
from engine.guiding.records.light import Records
from engine.kernels.bsdf import mean_roughness
from engine.kernels.bsdf.phase import phase_roughness
from engine.kernels.constants import NAN
from engine.kernels.path import real_3
from engine.kernels.vector import dot
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel
from engine.spectral.wavelengths import WAVELENGTH_COUNT, hero_quarter
from engine.state.columns import RowLayout, allocate, column, joined
from engine.state.lanes import POINT_NS, POINT_P, POINT_PROGRAM, POINT_WO, RGB

#: Vertices remembered of a path; scatterings after these are not learned from.
MAX_VERTICES = 24
#: Records that a unit of work may make.
RECORD_ROWS = 1 << 16
#: Scatterings narrower than this pass the distance on: what is seen through them is where light is.
SMOOTH_ROUGHNESS = np.float32(0.3)
#: Scatterings up to this roughness are not learned from.
MIN_ROUGHNESS = np.float32(0.01)

#: Numbers of a cache line.
_CACHE_LINE = 16
# Columns of VertexLog.real; those of the spectra have one for each channel.
_vertex = RowLayout()
VERTEX_P = _vertex.take(3)
VERTEX_WI = _vertex.take(3)
VERTEX_NS = _vertex.take(3)
VERTEX_PDF = _vertex.take()
VERTEX_ROUGHNESS = _vertex.take()
VERTEX_TRAVEL = _vertex.take()  # distance from the vertex before, through transparent surfaces [m]
VERTEX_SCALE = _vertex.take()  # what refraction does to distances seen through this vertex
# Factor of Eq. (19) that turns the squared reflected radiance into the variance delta; NaN: none.
VERTEX_BENEFIT = _vertex.take()
VERTEX_BSDF_PDF = _vertex.take()  # of the direction under BSDF sampling
# And under the guide, with the probability of not taking a delta lobe; NaN: not guided.
VERTEX_GUIDE_PDF = _vertex.take()
VERTEX_BEFORE = _vertex.take(4)  # throughput before the scattering
VERTEX_THROUGHPUT = _vertex.take(4)  # and after
VERTEX_RADIANCE = _vertex.take(4)  # the path's sum at the scattering
VERTEX_LIGHT_SHARE = _vertex.take()  # probability with which this vertex sampled a light
VERTEX_WO = _vertex.take(3)
VERTEX_SURFACE_ROUGHNESS = _vertex.take()  # of all rough lobes together
VERTEX_ARRIVAL = _vertex.take(4)  # the path's sum before the vertex sampled a light
VERTEX_CLUSTER = _vertex.take()  # of the light that was sampled, -1 = none
VERTEX_CLUSTER_PMF = _vertex.take()  # with which probability the cluster was chosen
VERTEX_TREE_PMF = _vertex.take()  # and would have been by the light tree alone
VERTEX_PROGRAM = _vertex.take()  # of the surface's shader
VERTEX_WIDTH = _vertex.width(_CACHE_LINE)


class VertexLog(Bundle):
    """Vertices of the paths of L lanes, V rows."""

    real: Float32Array = column("row lane * MAX_VERTICES + vertex, by VERTEX_*", "V", VERTEX_WIDTH)
    count: Int32Array = column("vertices so far", "L")
    is_recording: Uint8Array = column("whether the lane's path is remembered", "L")


class VertexRecords(Records):
    """Records of finished paths with what else is learned from them, R rows.

    A column is declared here and nowhere else; `collect_records` fills it.
    """

    benefit: Float32Array = column(
        "estimate of the variance delta of the reflected radiance, Eq. (19); NaN where there is none", "R"
    )
    bsdf_pdf: Float32Array = column(
        "part of the source density that BSDF sampling has; NaN where the guide had none [sr^-1]", "R"
    )
    guide_pdf: Float32Array = column("part that the guide has, likewise [sr^-1]", "R")
    contribution_squared: Float32Array = column(
        "squared contribution of the path behind the vertex to its pixel, mean over channels, times the pixel's weight",
        "R",
    )
    light_squared: Float32Array = column(
        "the same of the light that the vertex found by light sampling, as if it had sampled a light for sure", "R"
    )
    light_cluster: Int32Array = column("of the light that was sampled, -1 = none", "R", fill=-1)
    light_pmf: Float32Array = column("probability with which the cluster was chosen", "R")
    tree_pmf: Float32Array = column("and with which it would have been by the light tree alone", "R")
    wo: Float32Array = column("unit, from the vertex to where the path came from", "R", 3)
    surface_roughness: Float32Array = column("of all rough lobes together (`mean_roughness`)", "R")
    reflectance: Float32Array = column("BSDF times cosine along `direction`, mean over channels [sr^-1]", "R")
    hero: Float32Array = column("what the path's wavelengths are made from (`state.PathState.hero`)", "R")
    spectrum: Float32Array = column(
        "incident radiance at each wavelength; NaN where the path had lost it before", "R", "wavelengths"
    )
    outgoing_radiance: Float32Array = column(
        "radiance that the surface sent back along the path, its light sample included, mean over channels "
        "(`log_arrival`)", "R",
    )
    cost: Float32Array = column("scatterings from this one to the end of the path", "R")
    program: Int32Array = column("of the surface's shader", "R")


def allocate_log(lane_count: int, *, use_vertices: bool) -> VertexLog:
    """Empty log of `lane_count` lanes; without `use_vertices` it can only tell that nothing is recorded."""
    return allocate(VertexLog, {"V": lane_count * MAX_VERTICES if use_vertices else 1, "L": lane_count})


@kernel
def distance_scale(n, wo, wi, eta):
    """Apparent over true distance of what is seen through a refracting surface; 1 where `eta` is.

    Geometric mean of the two focal distances of a flat interface: |cos_o| / (|cos_i| eta).
    """
    if eta == 1.0:
        return 1.0
    return min(abs(dot(n, wo)) / (max(abs(dot(n, wi)), 0.01) * eta), 100.0)


class Scattering(NamedTuple):
    """How a path has gone on from a vertex.

    Attributes
    ----------
    wi : tuple of 3 float32, unit
    pdf : float32 [sr^-1]
        1 / contribution weight.
    roughness, eta : float32
        As `sample_bsdf` returns them; roughness 0 for delta lobes.
    benefit : float32
        Factor of Eq. (19), NaN = none.
    bsdf_pdf, guide_pdf : float32 [sr^-1]
        NaN where not guided.
    """

    wi: tuple[float, float, float]
    pdf: float
    roughness: float
    eta: float
    benefit: np.float32
    bsdf_pdf: np.float32
    guide_pdf: np.float32


@kernel
def log_arrival(log, paths, lane):
    """Note what the path has gathered on arriving at a vertex: what comes on top is what its light sample brings.

    Call it before the vertex samples a light. Light that scattering found on the way, such as a lamp's that the path
    has passed, is not a gain of light sampling.
    """
    vertex = log.count[lane]
    if vertex >= MAX_VERTICES:
        return
    for c in range(len(paths.channels)):
        log.real[lane * MAX_VERTICES + vertex, VERTEX_ARRIVAL + c] = paths.radiance[lane, c]


@kernel
def log_vertex(log, paths, points, closures, samples, lane, scattering, before):
    """Append the scattering that has just updated `paths.throughput`.

    Parameters
    ----------
    samples : LightSamples
    scattering : Scattering
    before : float32 (L, C), throughput before it
    """
    vertex = log.count[lane]
    if vertex >= MAX_VERTICES:
        return
    log.count[lane] = vertex + 1
    row = lane * MAX_VERTICES + vertex
    real = log.real
    p = real_3(points, lane, POINT_P)
    wo = real_3(points, lane, POINT_WO)
    ns = real_3(points, lane, POINT_NS)
    for c in range(3):
        real[row, VERTEX_P + c] = p[c]
        real[row, VERTEX_WO + c] = wo[c]
        real[row, VERTEX_WI + c] = scattering.wi[c]
        real[row, VERTEX_NS + c] = ns[c]
    real[row, VERTEX_PDF] = scattering.pdf
    real[row, VERTEX_PROGRAM] = points.integer[lane, POINT_PROGRAM]
    real[row, VERTEX_ROUGHNESS] = scattering.roughness
    real[row, VERTEX_SURFACE_ROUGHNESS] = mean_roughness(closures, lane)
    real[row, VERTEX_SCALE] = distance_scale(ns, wo, scattering.wi, scattering.eta)
    real[row, VERTEX_TRAVEL] = paths.mis_distance[lane] + paths.hit_distance[lane]
    real[row, VERTEX_BENEFIT] = scattering.benefit
    real[row, VERTEX_BSDF_PDF] = scattering.bsdf_pdf
    real[row, VERTEX_GUIDE_PDF] = scattering.guide_pdf
    light_weight = samples.weight[lane]
    real[row, VERTEX_CLUSTER] = np.float32(samples.cluster[lane])
    real[row, VERTEX_CLUSTER_PMF] = samples.cluster_pmf[lane]
    real[row, VERTEX_TREE_PMF] = samples.tree_pmf[lane]
    real[row, VERTEX_LIGHT_SHARE] = 1.0 / light_weight if light_weight > 0.0 else np.float32(1.0)
    for c in range(len(paths.channels)):
        real[row, VERTEX_BEFORE + c] = before[lane, c]
        real[row, VERTEX_THROUGHPUT + c] = paths.throughput[lane, c]
        real[row, VERTEX_RADIANCE + c] = paths.radiance[lane, c]


@kernel
def log_collision(log, paths, points, closures, samples, lane, scattering, before):
    """`log_vertex` for a scattering within a medium, which has no normal and has sampled no light.

    Where the path was going stands for the normal. Regions learn from surfaces alone which lights they see. With a
    scale of 0, what is seen from here is as far away as here for those that see it through something narrow.
    """
    vertex = log.count[lane]
    if vertex >= MAX_VERTICES:
        return
    samples.cluster[lane] = -1
    log_vertex(log, paths, points, closures, samples, lane, scattering, before)
    row = lane * MAX_VERTICES + vertex
    wo = real_3(points, lane, POINT_WO)
    for c in range(3):
        log.real[row, VERTEX_NS + c] = -wo[c]
    for c in range(len(paths.channels)):
        log.real[row, VERTEX_ARRIVAL + c] = NAN
    log.real[row, VERTEX_SCALE] = 0.0
    log.real[row, VERTEX_SURFACE_ROUGHNESS] = phase_roughness(closures, lane)


@kernel
def collect_records(log, paths, pixel_weight, lanes, lane_count, max_distance, records, record_count):
    """Turn the vertices of ended paths among `lanes` into records; call before their lanes are freed.

    A channel that the scattering swallowed tells nothing of the light that came in: it gets the mean of the others.

    Parameters
    ----------
    pixel_weight : float32 (P,)
        Weights of the unit's pixels, see `engine.ris.orca.pixel_weights`.
    max_distance : float32 [m]
        Distances are cut off here; light from outside the scene has this one.
    records : VertexRecords; record_count : int
        Filled from row `record_count` on; what does not fit is dropped, and counted.

    Returns
    -------
    record_count : int
    reject_count : int
        Estimates that were not finite.
    dropped_count : int
        Vertices for whose records there was no room.
    """
    capacity = records.pdf.shape[0]
    channel_count = len(paths.channels)
    real = log.real
    reject_count = 0
    dropped_count = 0
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] != 0 or log.is_recording[lane] == 0:
            continue
        weight = pixel_weight[paths.pixel[lane]]
        distance = min(paths.mis_distance[lane] + paths.hit_distance[lane], max_distance)
        vertex = log.count[lane] - 1
        cost = 0.0
        log.count[lane] = 0
        while vertex >= 0:
            row = lane * MAX_VERTICES + vertex
            vertex -= 1
            cost += 1.0
            roughness = real[row, VERTEX_ROUGHNESS]
            if roughness > MIN_ROUGHNESS and record_count >= capacity:
                dropped_count += 1
            elif roughness > MIN_ROUGHNESS:
                total = 0.0
                known_count = 0
                squared = 0.0
                contribution = 0.0
                reflectance = 0.0
                light = 0.0
                arrived = 0.0
                sent_back = 0.0
                for c in range(records.spectrum.shape[1]):
                    records.spectrum[record_count, c] = NAN
                for c in range(channel_count):
                    # Rounding of the long sum may leave a little less than before.
                    gain = max(paths.radiance[lane, c] - real[row, VERTEX_RADIANCE + c], 0.0)
                    throughput = real[row, VERTEX_THROUGHPUT + c]
                    before = real[row, VERTEX_BEFORE + c]
                    contribution += gain * gain
                    sampled = real[row, VERTEX_RADIANCE + c] - real[row, VERTEX_ARRIVAL + c]
                    light += sampled * sampled
                    arrived += before
                    sent_back += max(paths.radiance[lane, c] - real[row, VERTEX_ARRIVAL + c], 0.0)
                    value = -1.0
                    if before > 0.0:
                        reflectance += throughput / before
                    if throughput > 0.0:
                        value = gain / throughput
                        total += value
                        known_count += 1
                        reflected = gain / before
                        squared += reflected * reflected
                        if channel_count > RGB:
                            records.spectrum[record_count, c] = value
                    records.radiance[record_count, c] = value
                if known_count > 0 and total < 1e30:
                    for c in range(channel_count):
                        # Only the mean over wavelengths is learned: each path has its own wavelengths.
                        if channel_count > RGB or records.radiance[record_count, c] < 0.0:
                            records.radiance[record_count, c] = total / known_count
                    for c in range(3):
                        records.position[record_count, c] = real[row, VERTEX_P + c]
                        records.direction[record_count, c] = real[row, VERTEX_WI + c]
                        records.normal[record_count, c] = real[row, VERTEX_NS + c]
                        records.wo[record_count, c] = real[row, VERTEX_WO + c]
                    records.pdf[record_count] = real[row, VERTEX_PDF]
                    records.distance[record_count] = distance
                    records.roughness[record_count] = roughness
                    records.surface_roughness[record_count] = real[row, VERTEX_SURFACE_ROUGHNESS]
                    # Throughput grew by the BSDF over the density.
                    records.reflectance[record_count] = reflectance * real[row, VERTEX_PDF] / channel_count
                    records.time[record_count] = paths.time[lane]
                    if channel_count > RGB:
                        records.hero[record_count] = paths.hero[lane]
                    squared /= channel_count
                    records.benefit[record_count] = real[row, VERTEX_BENEFIT] * squared
                    records.bsdf_pdf[record_count] = real[row, VERTEX_BSDF_PDF]
                    records.guide_pdf[record_count] = real[row, VERTEX_GUIDE_PDF]
                    records.contribution_squared[record_count] = contribution * weight / channel_count
                    light *= real[row, VERTEX_LIGHT_SHARE]
                    records.light_squared[record_count] = light * weight / channel_count
                    records.light_cluster[record_count] = int(real[row, VERTEX_CLUSTER])
                    records.light_pmf[record_count] = real[row, VERTEX_CLUSTER_PMF]
                    records.tree_pmf[record_count] = real[row, VERTEX_TREE_PMF]
                    records.outgoing_radiance[record_count] = sent_back / arrived
                    records.cost[record_count] = cost
                    records.program[record_count] = np.int32(real[row, VERTEX_PROGRAM])
                    record_count += 1
                else:
                    reject_count += 1
            travel = real[row, VERTEX_TRAVEL]
            if roughness < SMOOTH_ROUGHNESS:
                distance = min(travel + distance * real[row, VERTEX_SCALE], max_distance)
            else:
                distance = min(travel, max_distance)
    return record_count, reject_count, dropped_count


def allocate_vertex_records(row_count: int, channel_count: int = 3) -> VertexRecords:
    """Zeroed `VertexRecords` of `row_count` rows."""
    wavelengths = channel_count if channel_count > RGB else 0
    return allocate(VertexRecords, {"R": row_count, "C": channel_count, "wavelengths": wavelengths})


def join_records(units: Sequence[VertexRecords]) -> tuple[VertexRecords, int]:
    """Records of all units one after the other, and how many there are."""
    records = joined(units)
    return records, len(records.pdf)


def compensate(rows: VertexRecords, row_count: int, guiding_probability: float) -> VertexRecords:
    """Records for fields that are to learn what BSDF sampling leaves over: with the guide's part of the radiance.

    Those from before there was a guide, where the BSDF had to do alone, count in full.

    Parameters
    ----------
    guiding_probability : float
        Share of the directions that the guide proposes.

    References
    ----------
    Karlik et al. 2019, "MIS Compensation"; Dong et al. 2024, "Efficient Neural Path Guiding with 4D Modeling", Eq. 12.
    """
    guide = guiding_probability * rows.guide_pdf[:row_count]
    both = guide + (1.0 - guiding_probability) * rows.bsdf_pdf[:row_count]
    with np.errstate(invalid="ignore", divide="ignore"):
        part = np.where(both > 0.0, guide / both, np.where(np.isnan(both), 1.0, 0.0)).astype(np.float32)
    radiance = rows.radiance.copy()
    radiance[:row_count] *= part[:, None]
    return rows._replace(radiance=radiance)


def as_records(rows: VertexRecords) -> Records:
    """The same arrays as the fields take them."""
    return Records(*(getattr(rows, name) for name in Records._fields))


@kernel
def _sort_by_quarter(rows, row_count, radiance, offset):
    for row in range(row_count):
        quarter, offset[row] = hero_quarter(rows.hero[row])
        for c in range(WAVELENGTH_COUNT):
            radiance[row, (quarter + c) % WAVELENGTH_COUNT] = rows.spectrum[row, c]


def as_records_by_quarter(rows: VertexRecords, row_count: int) -> Records:
    """Records of wavelengths for a network that tells them apart (`NetworkShape.by_quarter`).

    Returns
    -------
    Records
        Of `row_count` rows. `radiance` is that of the wavelength in each quarter of [0, 1), NaN where the path had lost
        it; `time` is how far within their quarters they lie.
    """
    radiance, offset = np.zeros((row_count, WAVELENGTH_COUNT), np.float32), np.zeros(row_count, np.float32)
    _sort_by_quarter(rows, row_count, radiance, offset)
    return as_records(rows)._replace(radiance=radiance, time=offset)
