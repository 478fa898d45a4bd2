# SPDX-License-Identifier: GPL-3.0-or-later
"""What sources predict is incident radiance: of directions drawn in proportion to its product with the BSDF, the
mixture field's lobes say it. Resampling and roulette multiply by the BSDF themselves.
"""

from __future__ import annotations

import numpy as np
import pytest

from engine.guiding.sampling.guide import (
    allocate_guide_of,
    eval_guide,
    predict_guide,
    query_guides,
    ready_guide,
    with_field,
)
from engine.kernels.bsdf import add_diffuse, reset_closures
from engine.runtime.jit import kernel
from engine.settings import RenderSettings
from engine.state.lanes import (
    POINT_NS,
    POINT_WO,
    allocate_closures,
    allocate_guided_lanes,
    allocate_paths,
    allocate_points,
)
from tests.helpers.guiding_harness import densities, field_of, guide_at, sphere_grid
from tests.helpers.untrained_networks import Untrained

FLUENCE = 3.0
FIELD = field_of([(0.7, 20.0, (0.6, 0.0, 0.8), 5.0), (0.3, 2.0, (-0.6, 0.0, 0.8), 5.0)], fluence=FLUENCE)
PRODUCTS = [
    {"guiding_method": "NPM_PRODUCT"},
    {"guiding_method": "NASG", "mixture_target": "PRODUCT"},
    {"guiding_method": "NASG", "mixture_target": "COSINE"},
    {"guiding_method": "FLOW"},
]


@kernel
def _predict(guide, field, region, guided, paths, points, closures, lanes, is_diffuse, directions, out):
    ready_guide(guide, 0, field, region, points, closures, is_diffuse, np.uint32(0))
    query_guides(guide, guided, paths, points, lanes, len(lanes))
    for k in range(directions.shape[0]):
        wi = directions[k, 0], directions[k, 1], directions[k, 2]
        out[k, 0] = eval_guide(guide, 0, wi)
        out[k, 1] = predict_guide(guide, 0, wi, out[k, 0])


def predicted(directions: np.ndarray, guide, region: int = 0, *, is_diffuse: bool = True) -> tuple[np.ndarray, ...]:
    """Densities and predictions at a point of a surface that faces up: float32 (N,)."""
    guided, paths, points, closures = (
        allocate_guided_lanes(1), allocate_paths(1), allocate_points(1), allocate_closures(1)
    )
    guided.rough_share[:] = 1.0
    points.real[:, POINT_NS + 2] = points.real[:, POINT_WO + 2] = 1.0
    up, white = (np.float32(0.0), np.float32(0.0), np.float32(1.0)), (np.float32(1.0),) * 3
    reset_closures(closures, 0, up, 0)
    add_diffuse(closures, 0, white, up, np.float32(0.0), white)
    out = np.zeros((len(directions), 2), np.float32)
    lanes = np.zeros(1, np.int32)
    _predict(
        guide, FIELD, region, guided, paths, points, closures, lanes, is_diffuse, directions.astype(np.float32), out
    )
    return out[:, 0], out[:, 1]


def guide_by(settings: RenderSettings):
    """A lane of a network that knows nothing, but says so loudly."""
    return with_field(allocate_guide_of(settings, 1), Untrained(settings, 8.0).field)


@pytest.mark.slow
@pytest.mark.parametrize("choices", PRODUCTS, ids=lambda choices: "-".join(choices.values()))
def test_of_products_the_mixture_field_predicts(choices: dict[str, str]) -> None:
    directions = sphere_grid(40, 80)
    _, expected = densities(guide_at(FIELD, (0.0, 0.0, 0.0)), directions)
    guide = guide_by(RenderSettings(**choices))
    for is_diffuse in (True, False):
        pdf, found = predicted(directions, guide, is_diffuse=is_diffuse)
        np.testing.assert_allclose(found, expected, rtol=1e-3)
    # The directions themselves are the network's.
    assert np.abs(np.corrcoef(pdf, expected)[0, 1]) < 0.5
    # What has not been seen yet is black, also where the lane has held another vertex.
    assert (predicted(directions, guide, -1)[1] == 0.0).all()


def test_of_radiance_the_mixture_itself_predicts() -> None:
    directions = sphere_grid(40, 80)
    settings = RenderSettings(guiding_method="NPM")
    pdf, found = predicted(directions, guide_by(settings), is_diffuse=False)
    np.testing.assert_allclose(found, FLUENCE * (0.7 * pdf + 0.3 / (4.0 * np.pi)), rtol=1e-3)


def test_without_a_network_the_mixture_field_predicts() -> None:
    directions = sphere_grid(40, 80)
    settings = RenderSettings(guiding_method="NPM_PRODUCT")
    _, expected = densities(guide_at(FIELD, (0.0, 0.0, 0.0)), directions)
    guide = with_field(allocate_guide_of(settings, 1), None)
    np.testing.assert_allclose(predicted(directions, guide)[1], expected, rtol=1e-2)
