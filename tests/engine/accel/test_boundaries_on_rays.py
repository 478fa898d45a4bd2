# SPDX-License-Identifier: GPL-3.0-or-later
"""All boundaries of media on a ray, found by one search of Embree."""

from __future__ import annotations

import numpy as np
import pytest

from engine.accel.accelerator import build_accelerator
from engine.accel.hierarchies import MeshHierarchies
from engine.accel.masks import MASK_MEDIUM, MASK_SHADOW_OPAQUE
from engine.accel.passing import prepare_filters, read_boundary, trace_boundaries
from engine.accel.ray_words import MOST_BOUNDARIES
from engine.accel.scratch import RayScratch
from engine.builder.geometry import build_geometry
from engine.kernels.surface import surface_point
from engine.kernels.vector import dot
from engine.runtime.jit import kernel
from tests.helpers.placed_quads import QUAD, QUAD_TRIANGLES, at, quad_scene, turned

FAR = np.float32(1e6)


@kernel
def _search(scene, masks, geometry, ray, bits, address, x, y, z, far, mask, numbers, places):
    origin, direction = (x, y, z), (0.0, 0.0, -1.0)
    prepare_filters(bits, masks, geometry.instance_table.shape[0])
    count = trace_boundaries(scene, ray, bits, address, origin, direction, 0.0, far, 0.0, mask)
    for k in range(min(count, MOST_BOUNDARIES)):
        instance, triangle, distance, u, v, is_back = read_boundary(ray, bits, geometry, k)
        p, ng, _ns, _error = surface_point(geometry, instance, triangle, u, v, 0.0)
        numbers[k, 0] = instance
        numbers[k, 1] = is_back
        numbers[k, 2] = dot(ng, direction) > 0.0
        places[k, 0] = distance
        places[k, 1] = z - p[2]
    return count


def _search_down(transforms, masks, x=0.3, y=-0.2, far=FAR, mask=MASK_MEDIUM | MASK_SHADOW_OPAQUE, **shape):
    """By a ray from a height of 10 m: how many there are; instance, side, its side by the normal; distances."""
    geometry = build_geometry(quad_scene(np.stack(transforms), **shape), (), [])
    accelerator = build_accelerator(geometry, np.array(masks, np.uint32), MeshHierarchies(1))
    scratch = RayScratch()
    numbers, places = np.zeros((MOST_BOUNDARIES, 3), np.int64), np.zeros((MOST_BOUNDARIES, 2), np.float32)
    count = _search(
        accelerator.handle, accelerator.mask_handle, geometry, scratch.ray, scratch.bits, scratch.address,
        np.float32(x), np.float32(y), np.float32(10.0), np.float32(far), np.uint32(mask), numbers, places,
    )
    return count, numbers[: max(count, 0)], places[: max(count, 0)]


def test_all_that_lie_on_a_ray_come_in_the_order_of_their_distance():
    heights = np.random.default_rng(1).permutation(40) * 0.2
    count, numbers, places = _search_down([at(0, 0, z) for z in heights], [MASK_MEDIUM] * 40)
    assert count == 40
    assert np.array_equal(numbers[:, 0], np.argsort(-heights))
    assert np.allclose(places[:, 0], 10.0 - np.sort(heights)[::-1], atol=1e-5)
    assert np.allclose(places[:, 0], places[:, 1], atol=1e-5)


@pytest.mark.parametrize("other", [[], [at(8.0, 0.0, 0.0)]], ids=["in world space", "instanced"])
@pytest.mark.parametrize(
    "transform", [at(0, 0, 1), turned(np.pi, 0), turned(0.6, 1), at(0, 0, 1, (-1, 1, 1)), at(0, 0, 1, (1, 1, -1)),
                  turned(np.pi, 0, scale=(1.0, -1.0, 1.0))],
    ids=["up", "down", "oblique", "mirrored", "mirrored up", "mirrored down"],
)  # fmt: skip
def test_sides_are_those_of_the_surface_s_normal(transform, other):
    for triangles in (QUAD_TRIANGLES, QUAD_TRIANGLES[:, ::-1].copy()):
        transforms = [transform, *other]
        count, numbers, places = _search_down(transforms, [MASK_MEDIUM] * len(transforms), triangles=triangles)
        assert count == 1 and numbers[0, 0] == 0
        assert numbers[0, 1] == numbers[0, 2]
        assert np.allclose(places[0, 0], places[0, 1], atol=1e-5)


def test_what_is_opaque_ends_the_search_wherever_it_lies_on_the_segment():
    transforms = [at(0, 0, 5), at(0, 0, 3), at(0, 0, 1)]
    masks = [MASK_MEDIUM, MASK_SHADOW_OPAQUE, MASK_MEDIUM]
    assert _search_down(transforms, masks)[0] == -1
    assert _search_down(transforms, masks, far=6.0)[0] == 1
    assert _search_down(transforms, masks, mask=MASK_MEDIUM)[0] == 2
    # The hit of an opaque instance with a medium inside is kept: its program knows which it is there.
    assert _search_down(transforms, [MASK_MEDIUM, MASK_SHADOW_OPAQUE | MASK_MEDIUM, MASK_MEDIUM])[0] == 3


def test_more_than_are_kept_are_counted():
    vertices = np.concatenate([QUAD + (0.0, 0.0, 0.01 * k) for k in range(200)]).astype(np.float32)
    triangles = np.concatenate([QUAD_TRIANGLES + 4 * k for k in range(200)]).astype(np.uint32)
    count, _, places = _search_down([at(0, 0, 0)], [MASK_MEDIUM], vertices=vertices, triangles=triangles)
    assert count >= 200
    found = places[:MOST_BOUNDARIES, 0]
    assert (np.diff(found) >= 0.0).all() and found.min() >= 10.0 - 1.99 - 1e-4 and found.max() <= 10.0 + 1e-4
