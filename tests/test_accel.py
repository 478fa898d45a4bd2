# SPDX-License-Identifier: GPL-3.0-or-later
"""Embree through kernels: hits, ids, instances, masks."""

import numpy as np
import pytest

from engine.accel import MASK_SHADOW_OPAQUE, RayScratch, build_accelerator, trace_closest, trace_occluded
from engine.jit import kernel
from engine.scene.description import VISIBLE_ALL, VISIBLE_CAMERA, Camera, Frame, Mesh, SceneDescription
from engine.scene.geometry import build_geometry, empty_instances, plain_instances

_QUAD = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)
_QUAD_TRIANGLES = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)


@kernel
def _closest(scene, ray, bits, address, ox, oy, oz, mask):
    hit = trace_closest(scene, ray, bits, address, (ox, oy, oz), (0.0, 0.0, -1.0), 0.0, np.float32(np.inf), 0.0, mask)
    return hit, ray[8], np.int64(bits[17]), np.int64(bits[18]), np.int64(bits[19])


@kernel
def _occluded(scene, ray, bits, address, ox, oy, oz, far, mask):
    return trace_occluded(scene, ray, bits, address, (ox, oy, oz), (0.0, 0.0, -1.0), 0.0, far, 0.0, mask)


def quad_scene(transforms, visibility=None, vertices=_QUAD, triangles=_QUAD_TRIANGLES):
    """Description of a quad instanced by each of `transforms`."""
    instances = plain_instances(transforms, materials=-1)
    instances.name = [f"Quad {i}" for i in range(len(transforms))]
    if visibility is not None:
        instances.visibility = np.asarray(visibility, np.uint32)
    assert empty_instances().mesh.size == 0
    mesh = Mesh("quad", "Quad", vertices, triangles, None, np.zeros(len(triangles), np.int32))
    return SceneDescription(Camera(), Frame(4, 4, (0, 0, 4, 4)), [mesh], instances, [], [], [], None)


def at(x, y, z, scale=(1.0, 1.0, 1.0)):
    matrix = np.diag([*scale, 1.0])
    matrix[:3, 3] = x, y, z
    return matrix


def built(description, notices=None):
    geometry = build_geometry(description, (), [] if notices is None else notices)
    masks = np.full(len(geometry.instance_table), MASK_SHADOW_OPAQUE, np.uint32)
    return geometry, build_accelerator(geometry, masks, 1)


def trace(accelerator, origin, mask=VISIBLE_CAMERA):
    s = RayScratch()
    x, y, z = (np.float32(v) for v in origin)
    return _closest(accelerator.handle, s.ray, s.bits, s.address, x, y, z, np.uint32(mask))


@pytest.mark.parametrize("count", [1, 3])
def test_a_ray_finds_the_right_instance(count):
    """One user is baked into the world, several are instanced; both give the same distances and ids."""
    _, accelerator = built(quad_scene([at(4.0 * i, 0, i) for i in range(count)]))
    for i in range(count):
        hit, distance, triangle, geometry, instance = trace(accelerator, (4.0 * i + 0.5, -0.5, 10.0))
        assert hit
        assert distance == pytest.approx(10.0 - i, abs=1e-5)
        assert triangle == 0
        assert (geometry if instance == 0xFFFFFFFF else instance) == i
    assert not trace(accelerator, (2.0, 0.0, 10.0))[0]


def test_visibility_selects_what_rays_see():
    visibility = [VISIBLE_ALL & ~VISIBLE_CAMERA, VISIBLE_ALL]
    _, accelerator = built(quad_scene([at(0, 0, 2), at(0, 0, 0)], visibility=visibility))
    assert trace(accelerator, (0.5, 0.2, 5.0))[1] == pytest.approx(5.0)
    assert trace(accelerator, (0.5, 0.2, 5.0), mask=2)[1] == pytest.approx(3.0)


def test_occlusion_respects_distance_and_mask():
    _, accelerator = built(quad_scene([at(0, 0, 0)]))
    s = RayScratch()
    arguments = (accelerator.handle, s.ray, s.bits, s.address, np.float32(0.5), np.float32(0.2), np.float32(5.0))
    assert _occluded(*arguments, np.float32(6.0), np.uint32(MASK_SHADOW_OPAQUE))
    assert not _occluded(*arguments, np.float32(4.9), np.uint32(MASK_SHADOW_OPAQUE))
    assert not _occluded(*arguments, np.float32(6.0), np.uint32(128))


def test_nan_vertices_are_left_out_and_reported():
    vertices = _QUAD.copy()
    vertices[3] = np.nan
    notices = []
    geometry, accelerator = built(quad_scene([at(0, 0, 0)], vertices=vertices), notices)
    assert len(geometry.triangles) == 1
    assert "NaN" in notices[0].problem
    assert trace(accelerator, (0.5, -0.5, 5.0))[0]
    assert not trace(accelerator, (-0.5, 0.5, 5.0))[0]


def test_vertex_indices_out_of_range_are_left_out():
    triangles = np.array([(0, 1, 2), (0, 2, 9)], np.uint32)
    notices = []
    geometry, _ = built(quad_scene([at(0, 0, 0)], triangles=triangles), notices)
    assert len(geometry.triangles) == 1
    assert notices


def test_flattened_objects_are_seen_and_singular_instances_are_reported():
    notices = []
    _, accelerator = built(quad_scene([at(0, 0, 0, scale=(1, 1, 0))]), notices)
    assert trace(accelerator, (0.5, -0.5, 5.0))[0]
    geometry, accelerator = built(quad_scene([at(0, 0, 0, scale=(1, 0, 1)), at(0, 0, 0, scale=(1, 1, 1))]), notices)
    assert any("Quad 0" in notice.subject for notice in notices)
    assert trace(accelerator, (0.5, -0.5, 5.0))[1] == pytest.approx(5.0)


def test_an_empty_scene_hits_nothing():
    description = quad_scene([at(0, 0, 0)])
    description.meshes, description.instances = [], empty_instances()
    _, accelerator = built(description)
    assert not trace(accelerator, (0.0, 0.0, 5.0))[0]
