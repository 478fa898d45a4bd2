# SPDX-License-Identifier: GPL-3.0-or-later
"""Embree through kernels: hits, ids, instances, masks."""

import dataclasses
import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from engine.accel.accelerator import build_accelerator
from engine.accel.hierarchies import MeshHierarchies
from engine.accel.library import library_path
from engine.accel.masks import MASK_SHADOW_OPAQUE, MASK_SHADOW_TRANSPARENT
from engine.accel.passing import limit_passing, prepare_filters, trace_passing
from engine.accel.rays import trace_closest, trace_occluded
from engine.accel.scratch import RayScratch
from engine.builder.geometry import build_geometry
from engine.runtime.jit import kernel
from engine.scene.description import VISIBLE_ALL, VISIBLE_CAMERA
from engine.scene.instances import empty_instances
from tests.helpers.placed_quads import QUAD, at, built, quad_scene


@kernel
def _closest(scene, ray, bits, address, ox, oy, oz, mask):
    hit = trace_closest(scene, ray, bits, address, (ox, oy, oz), (0.0, 0.0, -1.0), 0.0, np.float32(np.inf), 0.0, mask)
    return hit, ray[8], np.int64(bits[17]), np.int64(bits[18]), np.int64(bits[19])


@kernel
def _occluded(scene, ray, bits, address, ox, oy, oz, far, mask):
    return trace_occluded(scene, ray, bits, address, (ox, oy, oz), (0.0, 0.0, -1.0), 0.0, far, 0.0, mask)


@kernel
def _passed(scene, ray, bits, address, ox, oy, oz, far, mask):
    return trace_passing(scene, ray, bits, address, (ox, oy, oz), (0.0, 0.0, -1.0), 0.0, far, 0.0, mask)


@kernel
def _prepare(bits, masks, count, most):
    prepare_filters(bits, masks, count)
    limit_passing(bits, most)


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


@pytest.mark.parametrize(("opaque_count", "is_apart"), [(19, True), (18, False)])
def test_few_transparent_casters_have_a_hierarchy_of_their_own(opaque_count, is_apart):
    """Up to a twentieth of the triangles; what is found there has the ids that it has among all."""
    description = quad_scene([at(4.0 * i, 0, 0) for i in range(opaque_count + 1)])
    geometry = build_geometry(description, (), [])
    masks = np.array([MASK_SHADOW_OPAQUE] * opaque_count + [MASK_SHADOW_TRANSPARENT], np.uint32)
    accelerator = build_accelerator(geometry, masks, MeshHierarchies(1))
    assert (accelerator.transparent is not accelerator.top) == is_apart
    s = RayScratch()
    for i, mask in enumerate(masks):
        arguments = (s.ray, s.bits, s.address, np.float32(4.0 * i + 0.5), np.float32(-0.5), np.float32(5.0), mask)
        among_all = _closest(accelerator.handle, *arguments)
        assert among_all[0]
        if mask == MASK_SHADOW_TRANSPARENT:
            assert _closest(accelerator.transparent_handle, *arguments) == among_all
        elif is_apart:
            assert not _closest(accelerator.transparent_handle, *arguments)[0]


@pytest.mark.parametrize("user_count", [1, 2])
@pytest.mark.parametrize("shapes_key", [None, "shapes"])
def test_one_search_counts_what_a_shadow_ray_passes_and_finds_what_stops_it(user_count, shapes_key):
    """Quads one above the other, the lowest opaque; with one user each, or beside others that are all opaque."""
    heights = [0.0, 1.0, 2.0, 3.0]
    scene = quad_scene([at(6.0 * user, 0, z) for user in range(user_count) for z in heights])
    if user_count == 1:
        # Meshes of their own are placed in the world.
        scene.meshes = [dataclasses.replace(scene.meshes[0], key=f"quad {i}", name=f"Quad {i}") for i in range(4)]
        scene.instances.mesh = np.arange(4, dtype=np.int32)
    geometry = build_geometry(scene, (), [])
    opaque, transparent = MASK_SHADOW_OPAQUE, MASK_SHADOW_TRANSPARENT
    masks = np.array([opaque] + [transparent] * 3 + [opaque] * (4 * (user_count - 1)), np.uint32)
    accelerator = build_accelerator(geometry, masks, MeshHierarchies(1), shapes_key=shapes_key)
    s = RayScratch()

    def passed(x, y, z, far, mask=opaque | transparent, most=9):
        _prepare(s.bits, accelerator.mask_handle, len(geometry.instance_table), most)
        numbers = (np.float32(value) for value in (x, y, z, far))
        return _passed(accelerator.handle, s.ray, s.bits, s.address, *numbers, np.uint32(mask))

    assert passed(0.5, -0.4, 5.0, 1.9) == 0
    assert passed(0.5, -0.4, 5.0, 2.1) == 1
    assert passed(0.5, -0.4, 5.0, 4.9) == 3
    assert passed(0.5, -0.4, 5.0, 5.1) == -1
    assert passed(0.5, -0.4, 2.5, 2.4) == 2
    assert passed(3.0, 0.0, 5.0, 9.0) == 0
    assert passed(0.5, -0.4, 5.0, 9.0, transparent) == 3
    assert passed(0.5, -0.4, 5.0, 9.0, opaque) == -1
    assert [passed(0.5, -0.4, 5.0, 4.9, most=most) for most in (-1, 0, 2, 3)] == [-1, -1, -1, 3]
    if user_count == 2:
        assert passed(6.5, -0.4, 5.0, 2.1) == -1


def test_nan_vertices_are_left_out_and_reported():
    vertices = QUAD.copy()
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


#: Memory is overwritten as it is freed.
GARBAGE = """
import gc
import numpy as np
from engine.accel.accelerator import build_accelerator
from engine.accel.hierarchies import MeshHierarchies
from engine.accel.masks import MASK_SHADOW_OPAQUE
from engine.builder.geometry import build_geometry
from tests.helpers.placed_quads import at, quad_scene

for _ in range(20):
    geometry, hierarchies = build_geometry(quad_scene([at(0, 0, 0), at(4, 0, 0)]), (), []), MeshHierarchies(2)
    cycle = [hierarchies, build_accelerator(geometry, np.full(2, MASK_SHADOW_OPAQUE, np.uint32), hierarchies)]
    cycle.append(cycle)
    del cycle, hierarchies
    gc.collect()
"""


def test_scenes_and_their_device_can_be_garbage_of_one_cycle():
    """As a failed render leaves it. It is finalized in any order, but Embree's device must be released last."""
    environment = {**os.environ, "MALLOC_PERTURB_": "85"}
    subprocess.run([sys.executable, "-c", GARBAGE], env=environment, cwd=Path(__file__).parents[3], check=True)


def test_a_process_that_finds_the_scripts_named_bpy_first_loads_the_same_library():
    """Blender's scripts have a package `bpy` too, which comes first in processes that `bpy` has started."""
    spec = importlib.util.find_spec("bpy")
    if spec is None or spec.origin is None:
        pytest.skip("there is no bpy")
    (scripts,) = Path(spec.origin).parent.glob("*/scripts/modules")
    program = "import sys; sys.path.insert(0, sys.argv[1]); import engine.accel.library as it; print(it.library_path())"
    command = [sys.executable, "-c", program, str(scripts)]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert shown.strip() == library_path()
