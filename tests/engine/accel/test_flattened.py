# SPDX-License-Identifier: GPL-3.0-or-later
"""Instances that Embree has as triangles in the world are met where they are met as instances."""

from __future__ import annotations

import numpy as np
import pytest

from engine.accel.accelerator import build_accelerator
from engine.accel.flattened import are_flattened
from engine.accel.hierarchies import MeshHierarchies
from engine.accel.masks import MASK_MEDIUM, MASK_SHADOW_OPAQUE, MASK_SHADOW_TRANSPARENT
from engine.accel.rays import read_hit, trace_closest
from engine.accel.scratch import RayScratch
from engine.builder.geometry import build_geometry
from engine.runtime.jit import kernel
from engine.scene.description import VISIBLE_CAMERA, Mesh
from tests.helpers.placed_quads import QUAD, QUAD_TRIANGLES, at, quad_scene, steps


@kernel
def _hit(scene, geometry, ray, bits, address, origin, direction, found):
    """Write instance, triangle, distance, u, v of the closest hit; instance -1 where there is none."""
    found[0] = -1.0
    if trace_closest(
        scene, ray, bits, address, (origin[0], origin[1], origin[2]), (direction[0], direction[1], direction[2]), 0.0,
        np.float32(np.inf), 0.0, np.uint32(VISIBLE_CAMERA),
    ):
        found[0], found[1], found[2], found[3], found[4] = read_hit(ray, bits, geometry)


def _many(seed=3, count=200):
    """Two quads, one of them somewhere else in its own space, at random places: turned, stretched, mirrored."""
    rng = np.random.default_rng(seed)
    transforms = np.zeros((count, 4, 4))
    turns = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    transforms[:, :3, :3] = turns * rng.uniform(0.2, 0.6, (count, 1, 3)) * rng.choice([-1.0, 1.0], (count, 1, 3))
    transforms[:, :3, 3] = rng.uniform(-3.0, 3.0, (count, 3))
    transforms[:, 3, 3] = 1.0
    description = quad_scene(list(transforms))
    slots = np.zeros(2, np.int32)
    description.meshes.append(Mesh("other", "Other", QUAD + np.float32(0.5), QUAD_TRIANGLES, None, slots))
    description.instances.mesh = (np.arange(count) % 2).astype(np.int32)
    return description


def test_rays_meet_the_same_triangles():
    geometry = build_geometry(_many(), (), [])
    masks = np.where(np.arange(200) % 3 == 0, MASK_SHADOW_TRANSPARENT, MASK_SHADOW_OPAQUE).astype(np.uint32)
    assert are_flattened(geometry, masks).all()
    # With a key things are expected to move: they stay instances.
    flat, moved = (build_accelerator(geometry, masks, MeshHierarchies(1), shapes_key=key) for key in (None, "moves"))
    assert not flat.meshes and len(moved.meshes) == 2
    rng, s, hits = np.random.default_rng(5), RayScratch(), 0
    for _ in range(2000):
        origin, direction = rng.uniform(-4.0, 4.0, 3).astype(np.float32), rng.normal(size=3).astype(np.float32)
        found = np.zeros((2, 5))
        for row, accelerator in zip(found, (flat, moved), strict=True):
            _hit(accelerator.handle, geometry, s.ray, s.bits, s.address, origin, direction, row)
        # The same instance and triangle, but where a ray goes along an edge.
        assert found[0] == pytest.approx(found[1], abs=2e-4)
        hits += found[0, 0] >= 0.0
    assert hits > 500


def test_what_moves_or_has_a_medium_inside_stays_an_instance():
    description = quad_scene([at(4.0 * i, 0, 0) for i in range(4)])
    description.instances.motion = {1: steps(at(4, 0, 0), at(4, 0, 1))}
    geometry = build_geometry(description, (), [])
    masks = np.full(4, MASK_SHADOW_OPAQUE, np.uint32)
    masks[2] |= np.uint32(MASK_MEDIUM)
    assert are_flattened(geometry, masks).tolist() == [True, False, False, True]


def test_large_meshes_stay_instances_where_all_of_them_would_take_much_memory():
    """Of meshes of 20 triangles, 60,000 times, and of 18, twice, the former are more than a million triangles."""
    description = quad_scene([at(0, 0, 0)] * 60_002)
    meshes = [
        Mesh(name, name, QUAD, np.tile(QUAD_TRIANGLES, (pairs, 1)), None, np.zeros(2 * pairs, np.int32))
        for name, pairs in (("many", 10), ("few", 9))
    ]
    description.meshes = meshes
    description.instances.mesh = (np.arange(60_002) >= 60_000).astype(np.int32)
    geometry = build_geometry(description, (), [])
    masks = np.full(60_002, MASK_SHADOW_OPAQUE, np.uint32)
    assert not are_flattened(geometry, masks)[:60_000].any()
    assert are_flattened(geometry, masks)[60_000:].all()
