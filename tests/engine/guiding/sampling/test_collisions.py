# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions proposed at collisions with media: samples against the density that they are said to have."""

from __future__ import annotations

import numpy as np
import pytest

from engine.guiding.fields.vmm.field import GuideLobes, allocate_guide
from engine.guiding.fields.vmm.query import prepare_phase
from engine.guiding.sampling.collisions import propose_at_collision
from engine.kernels.bsdf.phase import add_phase
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel
from engine.state.lanes import (
    POINT_WO,
    Closures,
    GuidedLanes,
    ShadePoints,
    allocate_closures,
    allocate_guided_lanes,
    allocate_points,
)
from tests.helpers import chi2
from tests.helpers.guiding_harness import densities, field_of, unit

#: For all tests of the file together.
SIGNIFICANCE = 1e-4
MIXTURE = [(0.6, 30.0, (0.3, 0.2, 0.9), 5.0), (0.4, 4.0, (-0.8, 0.1, 0.1), 3.0)]
FORWARD = unit((0.4, -0.7, 0.5))
COUNT = 200_000


class Proposals(Bundle):
    """What the kernel reads of a thread's memory."""

    points: ShadePoints
    closures: Closures
    guided: GuidedLanes


@kernel
def _propose(work, guide, u, value, out):
    for k in range(u.shape[0]):
        candidate = propose_at_collision(work, guide, 0, u[k, 0], u[k, 1], u[k, 2], value, 0)
        for c in range(3):
            out[k, c] = candidate.wi[c]
        out[k, 3] = candidate.source_pdf
        out[k, 4] = candidate.phase_pdf
        out[k, 5] = candidate.guide_pdf
        out[k, 6] = value[0, 0]


def collision(probability: float, g: float) -> tuple[Proposals, GuideLobes]:
    """A collision with a medium of two phase functions, and the mixture to guide it by."""
    work = Proposals(allocate_points(1), allocate_closures(1), allocate_guided_lanes(1))
    work.points.real[0, POINT_WO : POINT_WO + 3] = -FORWARD
    add_phase(work.closures, 0, np.float32(0.7), np.float32(g), np.float32(0.0), np.float32(0.0))
    add_phase(work.closures, 0, np.float32(0.3), np.float32(-0.3), np.float32(0.0), np.float32(0.0))
    work.guided.probability[0] = probability
    guide = allocate_guide(1)
    forward = tuple(np.float32(value) for value in FORWARD)
    at = tuple(np.float32(value) for value in (0.3, 0.1, -0.2))
    prepare_phase(field_of(MIXTURE), 0, at, forward, np.float32(0.7 * g - 0.09), guide, 0)
    return work, guide


def henyey_greenstein(directions, g):
    cosine = directions @ FORWARD
    return 0.25 / np.pi * (1.0 - g * g) / (1.0 + g * g - 2.0 * g * cosine) ** 1.5


@pytest.mark.parametrize("probability", [0.0, 0.4, 0.95])
@pytest.mark.parametrize("g", [0.0, 0.8])
def test_what_is_proposed_follows_the_density_that_it_is_said_to_have(probability, g):
    work, guide = collision(probability, g)
    drawn = np.zeros((COUNT, 7), np.float32)
    numbers = np.random.default_rng(1).random((COUNT, 3)).astype(np.float32)
    _propose(work, guide, numbers, np.zeros((1, 9), np.float32), drawn)

    def phase(directions):
        return 0.7 * henyey_greenstein(directions, g) + 0.3 * henyey_greenstein(directions, -0.3)

    def density(directions):
        return probability * densities(guide, directions)[0] + (1.0 - probability) * phase(directions)

    wi = drawn[:, :3].astype(np.float64)
    np.testing.assert_allclose(drawn[:, 3], density(wi), rtol=2e-3, atol=1e-5)
    # Phase functions have no cosine and no colour of their own here.
    np.testing.assert_allclose(drawn[:, 4], phase(wi), rtol=2e-3)
    np.testing.assert_allclose(drawn[:, 6], phase(wi), rtol=2e-3)
    expected = chi2.cell_integrals(density, 24, 48, points=4, subdivisions=4)
    assert chi2.p_value(chi2.histogram(wi, 24, 48), expected, COUNT) > chi2.sidak(SIGNIFICANCE, 6)
    # And the test sees where a tenth of the samples are all drawn from one side.
    wrong = wi.copy()
    wrong[::10, 2] = -np.abs(wi[::10, 2])
    assert chi2.p_value(chi2.histogram(wrong, 24, 48), expected, COUNT) < chi2.sidak(SIGNIFICANCE, 6)
