# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement of meshes that are empty, torn or tangled, and by what is too much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.builder.fans import split_at_fans
from engine.builder.scene import Scene, SceneCache, build_scene
from engine.scene.attribute_names import FANS, SMOOTH, VERTEX_NORMALS
from engine.scene.description import Attribute, Link, Material, Mesh, Node, NodeGraph
from engine.scene.dicing import Dicing
from engine.scene.instances import plain_instances
from engine.settings import RenderSettings
from engine.state.geometry import (
    ATTRIBUTE_COMPONENTS,
    ATTRIBUTE_OFFSET,
    INSTANCE_MESH,
    MESH_FIRST_VERTEX,
    MESH_VERTEX_COUNT,
)
from engine.state.lanes import LANE_COUNT
from tests.helpers.small_scenes import floor_scene


def dicing(length: float, level: int = 8) -> Dicing:
    return Dicing(level, np.eye(3, 4), length, 0.0, np.zeros((0, 4)), 0.0)


def raised(height: float = 1.0, **properties: str) -> Material:
    """A diffuse material that is displaced along the normal."""
    inputs = {"Height": height, "Midlevel": 0.0, "Scale": 1.0}
    nodes = [Node("ShaderNodeBsdfDiffuse", "Diffuse"), Node("ShaderNodeDisplacement", "Displace", inputs, properties)]
    shown = NodeGraph(nodes, surface=Link(0, "BSDF"), displacement=Link(1, "Displacement"))
    return Material("m", "m", shown, displacement_method="DISPLACEMENT")


def shape(vertices: list, triangles: list, **attributes: Attribute) -> Mesh:
    count = len(triangles)
    return Mesh(
        "shape", "shape", np.array(vertices, np.float32).reshape(-1, 3), np.array(triangles, np.uint32).reshape(-1, 3),
        None, np.zeros(count, np.int32), dict(attributes),
    )  # fmt: skip


def built(mesh: Mesh, material: Material | None = None, cache: SceneCache | None = None, threads: int = 1) -> Scene:
    description = replace(
        floor_scene(), meshes=[mesh], materials=[material or raised()], instances=plain_instances(np.eye(4))
    )
    return build_scene(description, RenderSettings(), cache or SceneCache(), threads=threads)


def vertices_of(scene: Scene) -> np.ndarray:
    mesh = scene.geometry.mesh_table[scene.geometry.instance_table[0, INSTANCE_MESH]]
    first, count = mesh[[MESH_FIRST_VERTEX, MESH_VERTEX_COUNT]]
    return scene.geometry.vertices[first : first + count]


def test_nothing_is_diced_and_displaced_to_nothing() -> None:
    for vertices in ([], [(0, 0, 0)]):
        scene = built(replace(shape(vertices, []), dicing=dicing(0.1)))
        assert len(scene.geometry.triangles) == 0


def test_three_faces_at_an_edge_stay_together() -> None:
    """An edge that is not manifold is halved once, for all of its faces."""
    fins = shape(
        [(0, 0, 0), (0, 0, 2), (2, 0, 1), (-1, 2, 1), (-1, -2, 1)], [(0, 1, 2), (0, 1, 3), (1, 0, 4)]
    )
    scene = built(replace(fins, dicing=dicing(0.4)), raised(0.0))
    found = vertices_of(scene)
    assert len(np.unique(found, axis=0)) == len(found)
    triangles = scene.geometry.triangles
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    different, counts = np.unique(edges, axis=0, return_counts=True)
    on_axis = (np.abs(scene.geometry.vertices[different][:, :, :2]) < 1e-6).all(axis=(1, 2))
    assert on_axis.sum() > 2 and (counts[on_axis] == 3).all()


def test_a_vertex_of_no_face_and_a_face_of_no_area_do_no_harm() -> None:
    broken = shape([(0, 0, 0), (1, 0, 0), (0, 1, 0), (9, 9, 9)], [(0, 1, 2), (0, 1, 1)])
    scene = built(replace(broken, dicing=dicing(0.3)))
    used = scene.geometry.vertices[scene.geometry.triangles]
    assert len(used) > 8 and np.isfinite(used).all() and (used[..., :2] <= 1.0).all()


@pytest.mark.parametrize("height", [1e30, np.inf, np.nan])
def test_what_is_out_of_reach_is_named(height: float) -> None:
    scene = built(replace(shape([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)]), dicing=dicing(0.3)), raised(height))
    assert [notice.subject for notice in scene.notices] == ["mesh shape"]
    problem = scene.notices[0].problem
    assert ("too far away" if np.isfinite(height) else "NaN or infinite") in problem


def test_a_surface_may_fold_over_itself() -> None:
    sharp = shape([(0, 0, 0), (1, 0, 0), (1, 1, 0.9), (0, 1, 0.9)], [(0, 1, 2), (0, 2, 3)])
    scene = built(replace(sharp, dicing=dicing(0.1)), raised(-50.0))
    assert np.isfinite(vertices_of(scene)).all() and not scene.notices
    assert len(scene.geometry.triangles) > 200


def test_what_is_refused_leaves_what_was_built() -> None:
    cache = SceneCache()
    good = replace(shape([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)]), dicing=dicing(0.3))
    first = built(good, cache=cache)
    with pytest.raises(ValueError, match=r"would be about \d+,[\d,]+ triangles.*raise the dicing rate"):
        built(replace(good, dicing=dicing(1e-9, level=24)), cache=cache)
    # The session shows the last scene on, and builds the next.
    assert np.array_equal(vertices_of(built(good, cache=cache)), vertices_of(first))


def test_any_number_of_threads_displaces_alike() -> None:
    material = raised()
    assert material.graph is not None
    material.graph.nodes += [Node("ShaderNodeTexNoise", "Noise", {"Scale": 3.0, "Detail": 2.0})]
    material.graph.nodes[1].inputs["Height"] = Link(2, "Fac")
    fine = replace(shape([(0, 0, 0), (4, 0, 0), (0, 4, 0)], [(0, 1, 2)]), dicing=dicing(0.01, level=12))
    one, three = (built(fine, material, threads=threads) for threads in (1, 3))
    assert len(vertices_of(one)) > 2 * 16 * LANE_COUNT
    assert np.array_equal(vertices_of(one), vertices_of(three))
    assert np.ptp(vertices_of(one)[:, 2]) > 0.1


def roof(fans: list[float]) -> Mesh:
    """Two slopes that share a ridge along y, whose corners have their faces' normals, by fan."""
    normals = np.repeat(np.array([[[-0.6, 0.0, 0.8]], [[0.6, 0.0, 0.8]]], np.float32), 3, axis=1)
    ridge = shape(
        [(0, 0, 1), (0, 1, 1), (-4, 0, -2), (4, 0, -2)], [(0, 1, 2), (0, 3, 1)],
        **{FANS: Attribute("CORNER", np.array(fans, np.float32)[:, None]),
           SMOOTH: Attribute("FACE", np.ones((2, 1), np.float32)),
           "Weight": Attribute("POINT", np.array([[1.0], [2.0], [3.0], [4.0]], np.float32))},
    )  # fmt: skip
    return replace(ridge, corner_normals=normals)


def test_meshes_tear_where_corners_part() -> None:
    apart = split_at_fans(roof([0, 0, 0, 1, 0, 1]))
    assert len(apart.vertices) == 6 and FANS not in apart.attributes
    assert sorted(apart.attributes["Weight"].data[:, 0]) == [1, 1, 2, 2, 3, 4]
    moved = vertices_of(built(roof([0, 0, 0, 1, 0, 1])))
    at_ridge = np.unique(moved[np.abs(moved[:, 1] - 1.0) < 1e-6].round(5), axis=0)
    assert np.allclose(at_ridge, [(-0.6, 1.0, 1.8), (0.6, 1.0, 1.8)], atol=1e-5)
    together = vertices_of(built(roof([0, 0, 0, 0, 0, 0])))
    assert len(together) == 4
    plain = roof([0] * 6)
    del plain.attributes[FANS]
    assert split_at_fans(plain) is plain


def test_tangents_are_those_of_what_has_been_displaced() -> None:
    material = raised()
    assert material.graph is not None
    graph = material.graph
    graph.nodes += [
        Node("ShaderNodeTangent", "Along", {}, {"direction_type": "UV_MAP", "uv_map": "UV"}),
        Node("ShaderNodeTexCoord", "Place"), Node("ShaderNodeSeparateXYZ", "x", {"Vector": Link(3, "Object")}),
    ]  # fmt: skip
    graph.nodes[0] = Node(
        "ShaderNodeBsdfAnisotropic", "Brushed", {"Tangent": Link(2, "Tangent"), "Anisotropy": 0.8, "Roughness": 0.3}
    )
    graph.nodes[1].inputs["Height"] = Link(4, "X")
    square = shape([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3)])
    up = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    square.attributes[VERTEX_NORMALS] = Attribute("POINT", up)
    square.attributes["UV"] = Attribute("CORNER", square.vertices[square.triangles.reshape(-1), :2])
    square = replace(square, corner_normals=np.tile(up[0], (2, 3, 1)), default_uv="UV")
    geometry = built(square, material).geometry
    (found,) = geometry.attribute_table[geometry.attribute_table[:, ATTRIBUTE_COMPONENTS] == 4]
    start = int(found[ATTRIBUTE_OFFSET])
    tangents = geometry.attribute_data[start : start + 24].reshape(6, 4)
    # The square has become a slope of 45 degrees along x.
    assert np.allclose(tangents[:, :3], (np.sqrt(0.5), 0.0, np.sqrt(0.5)), atol=1e-5)
