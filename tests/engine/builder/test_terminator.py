# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow rays on a coarse smooth mesh: an octahedron shaded as a sphere, one of its triangles."""

from types import SimpleNamespace

import numpy as np
import pytest

from engine.builder.geometry import build_geometry
from engine.kernels.terminator import shadow_ray, smooth_offset
from engine.scene.description import Mesh
from engine.state import geometry as layout
from tests.helpers.placed_quads import at, quad_scene

_OFFSET = np.float32(1e-6)
_FAR = np.float32(1e30)


def triangle_of_a_sphere(cutoff=0.1, transforms=(np.eye(4),), is_smooth=True):
    corners = np.eye(3, dtype=np.float32)
    description = quad_scene(list(transforms))
    normals = corners.reshape(1, 3, 3) if is_smooth else None
    description.meshes = [Mesh("m", "M", corners, np.array([(0, 1, 2)], np.uint32), normals, np.zeros(1, np.int32))]
    description.instances.terminator_offset = np.full(len(transforms), cutoff, np.float32)
    return build_geometry(description, [], [])


def triple(values):
    return tuple(np.float32(value) for value in values)


def ray(geometry, wi, distance=_FAR, u=1 / 3, v=1 / 3, in_place=False):
    """From the triangle's point (u, v) towards `wi`, seen from outside."""
    p = np.array([1.0 - u - v, u, v])
    ns = p / np.linalg.norm(p)
    ng = np.ones(3) / np.sqrt(3.0)
    wi = np.asarray(wi) / np.linalg.norm(wi)
    result = shadow_ray(
        geometry, 0, 0, np.float32(u), np.float32(v), triple(p), triple(ng), triple(ns), triple(wi),
        np.float32(distance), _OFFSET, in_place, np.float32(0.5),
    )  # fmt: skip
    origin, direction, far, stays_in_place = result
    return SimpleNamespace(
        p=p, ng=ng, wi=wi, origin=np.array(origin), direction=np.array(direction), t=far, in_place=stays_in_place
    )


@pytest.mark.parametrize("transform", [np.eye(4), at(1.0, 2.0, 3.0, (2.0, 2.0, 2.0))])
def test_height_is_that_of_the_lowest_tangent_plane_along_the_normal(transform):
    """At the centre the three planes are 2/3 above and the normal is a third of (1, 1, 1), not normalised."""
    geometry = triangle_of_a_sphere(transforms=[transform, np.eye(4)])
    third = np.float32(1 / 3)
    size = transform[0, 0]
    up = smooth_offset(geometry, 0, 0, third, third, triple((1.0, 1.0, 1.0)), np.float32(0.5))
    down = smooth_offset(geometry, 0, 0, third, third, triple((-1.0, -1.0, -1.0)), np.float32(0.5))
    assert np.allclose(up, size * 2.0 / 9.0, rtol=1e-5)
    # Seen from behind the planes pass through the other corners: 1/3.
    assert np.allclose(down, -size / 9.0, rtol=1e-5)


def test_corners_stay_where_they_are():
    geometry = triangle_of_a_sphere()
    for u, v in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)):
        offset = smooth_offset(geometry, 0, 0, np.float32(u), np.float32(v), triple((1.0, 1.0, 1.0)), np.float32(0.5))
        assert np.allclose(offset, 0.0, atol=1e-6)


def test_flat_light_starts_above_the_triangle_and_steep_light_on_it():
    geometry = triangle_of_a_sphere()
    flat = np.array([1.0, -1.0, 0.0])
    grazing = ray(geometry, (1.0, -0.99, 0.0))
    assert np.allclose(grazing.origin, grazing.p + 2.0 / 9.0, atol=1e-5)
    steep = ray(geometry, (1.0, 1.0, 1.0))
    assert np.allclose(steep.origin, steep.p, atol=1e-5)
    # Cosine 0.075 with both normals is halfway through the fade at a cutoff of 0.1.
    half = ray(geometry, flat / np.sqrt(2.0) * np.sqrt(1 - 0.075**2) + 0.075 * np.ones(3) / np.sqrt(3.0))
    assert np.allclose(half.origin, half.p + 0.5 * 2.0 / 9.0, atol=1e-3)


def test_lifted_rays_end_at_the_same_light():
    geometry = triangle_of_a_sphere()
    found = ray(geometry, (1.0, -0.99, 0.0), distance=5.0)
    assert np.allclose(found.origin + found.t * found.direction, found.p + 5.0 * found.wi, atol=1e-4)
    assert np.linalg.norm(found.direction) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("settings", [{"cutoff": 0.0}, {"is_smooth": False}])
def test_flat_meshes_and_a_setting_of_zero_lift_nothing(settings):
    found = ray(triangle_of_a_sphere(**settings), (1.0, -0.99, 0.0))
    assert np.allclose(found.origin, found.p, atol=1e-5)
    assert np.allclose(found.direction, found.wi)


def test_column_of_the_instance():
    assert triangle_of_a_sphere(0.25).instance_values[0, layout.VALUE_TERMINATOR] == np.float32(0.25)
