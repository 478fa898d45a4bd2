# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that materials displace: where vertices go, which normals follow, what instances share."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.builder.displacement import KeptDisplacements
from engine.builder.scene import Scene, SceneCache, build_scene
from engine.scene.attribute_names import SMOOTH, VERTEX_NORMALS
from engine.scene.description import Attribute, Link, Material, Mesh, Node, NodeGraph
from engine.scene.dicing import Dicing
from engine.scene.instances import plain_instances, select_instances
from engine.settings import RenderSettings
from engine.state.geometry import INSTANCE_MESH, MESH_FIRST_NORMAL, MESH_FIRST_VERTEX, MESH_VERTEX_COUNT
from tests.helpers.small_scenes import floor_scene


def graph(kind: str = "ShaderNodeDisplacement", by: Any = 0.75, **properties: Any) -> NodeGraph:
    """Diffuse, displaced by a node whose first input is `by`."""
    name = {"ShaderNodeDisplacement": "Height"}.get(kind, "Vector")
    displacement = Node(kind, "Displace", {name: by, "Midlevel": 0.25, "Scale": 2.0}, properties)
    nodes = [Node("ShaderNodeBsdfDiffuse", "Diffuse"), displacement]
    return NodeGraph(nodes, surface=Link(0, "BSDF"), displacement=Link(1, "Displacement"))


def square(is_smooth: bool = True) -> Mesh:
    """Two triangles in the plane z = 0, facing up."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    up = np.array([0.0, 0.0, 1.0], np.float32)
    return Mesh(
        "square", "square", vertices, np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
        np.tile(up, (2, 3, 1)) if is_smooth else None, np.zeros(2, np.int32),
        {
            VERTEX_NORMALS: Attribute("POINT", np.tile(up, (4, 1))),
            SMOOTH: Attribute("FACE", np.ones((2, 1), np.float32)),
            "UV": Attribute("CORNER", np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]], np.float32)),
        },
        "UV",
    )  # fmt: skip


def built(mesh: Mesh, materials: list[Material], instances: Any = None, cache: SceneCache | None = None) -> Scene:
    instances = plain_instances(np.eye(4)) if instances is None else instances
    description = replace(floor_scene(), meshes=[mesh], materials=materials, instances=instances)
    return build_scene(description, RenderSettings(), cache or SceneCache(), threads=1)


def displaced(by: NodeGraph, method: str = "DISPLACEMENT") -> Material:
    return Material("m", "m", by, displacement_method=method)


def vertices_of(scene: Scene, instance: int = 0) -> np.ndarray:
    mesh = scene.geometry.mesh_table[scene.geometry.instance_table[instance, INSTANCE_MESH]]
    first, count = mesh[[MESH_FIRST_VERTEX, MESH_VERTEX_COUNT]]
    return scene.geometry.vertices[first : first + count]


@pytest.mark.parametrize("height", [0.75, -0.25, 1e6])
def test_heights_move_vertices_along_their_normals(height: float) -> None:
    scene = built(square(), [displaced(graph(by=height))])
    assert np.allclose(vertices_of(scene), square().vertices + (0, 0, 2.0 * (height - 0.25)), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("space", ["OBJECT", "WORLD", "TANGENT"])
def test_vectors_move_vertices_along_the_axes_of_their_space(space: str) -> None:
    turned = np.eye(4)
    turned[:3, :3] = [[0, -2, 0], [2, 0, 0], [0, 0, 2]]  # a quarter turn, twice as large
    vector = graph("ShaderNodeVectorDisplacement", (1.25, 0.25, 0.25), space=space)
    scene = built(square(), [displaced(vector)], plain_instances(turned))
    moved = vertices_of(scene) - square().vertices @ turned[:3, :3].T
    along = {"OBJECT": (0, 4, 0), "WORLD": (2, 0, 0), "TANGENT": (0, 4, 0)}[space]
    assert np.allclose(moved, along, atol=1e-5)


def test_bump_moves_nothing() -> None:
    scene = built(square(), [displaced(graph(), "BUMP")])
    assert np.array_equal(vertices_of(scene), square().vertices)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_what_is_no_number_moves_nothing_and_is_named(bad: float) -> None:
    scene = built(square(), [displaced(graph(by=bad))])
    assert np.array_equal(vertices_of(scene)[:, :2], square().vertices[:, :2])
    assert np.isfinite(vertices_of(scene)).all()
    assert ["its displacement is NaN" in notice.problem for notice in scene.notices] == [True]


def slope() -> NodeGraph:
    """Displaced along z by x of the object's coordinates."""
    by_x = graph(by=Link(3, "X"))
    by_x.nodes.append(Node("ShaderNodeTexCoord", "Place"))
    by_x.nodes.append(Node("ShaderNodeSeparateXYZ", "x", {"Vector": Link(2, "Object")}))
    by_x.nodes[1].inputs["Midlevel"] = 0.0
    by_x.nodes[1].inputs["Scale"] = 1.0
    return by_x


@pytest.mark.parametrize("method", ["DISPLACEMENT", "BOTH"])
def test_normals_follow_unless_the_material_bends_them(method: str) -> None:
    scene = built(square(), [displaced(slope(), method)])
    assert np.allclose(vertices_of(scene)[:, 2], square().vertices[:, 0], atol=1e-6)
    first = scene.geometry.mesh_table[0, MESH_FIRST_NORMAL]
    normals = scene.geometry.corner_normals[first : first + 2].reshape(-1, 3)
    wanted = (0, 0, 1) if method == "BOTH" else (-np.sqrt(0.5), 0, np.sqrt(0.5))
    assert np.allclose(normals, wanted, atol=1e-6)


def test_a_shared_mesh_is_displaced_once_for_each_way_it_is_displaced() -> None:
    materials = [displaced(graph()), Material("plain", "plain", None), displaced(graph(by=1.25))]
    instances = plain_instances(np.stack([np.eye(4)] * 4), materials=[0, 1, 2, 0])
    instances.material_offset[3] = 0
    scene = built(square(), materials, instances)
    heights = [vertices_of(scene, instance)[:, 2] for instance in range(4)]
    assert np.allclose(heights, [[1.0] * 4, [0.0] * 4, [2.0] * 4, [1.0] * 4], atol=1e-6)
    assert scene.geometry.instance_table[0, INSTANCE_MESH] == scene.geometry.instance_table[3, INSTANCE_MESH]


def test_motion_is_displaced_as_the_middle_is() -> None:
    moving = square()
    moving.motion_vertices = np.stack([moving.vertices, moving.vertices + np.float32(0.5)])
    moving.motion_normals = np.stack([moving.corner_normals] * 2)
    scene = built(moving, [displaced(graph())])
    steps = scene.geometry.vertices[4:12].reshape(2, 4, 3)
    assert np.allclose(steps, moving.motion_vertices + np.array([0, 0, 1.0], np.float32), atol=1e-6)


def test_what_has_not_changed_is_not_displaced_again() -> None:
    cache = SceneCache()
    first = built(square(), [displaced(graph())], cache=cache)
    again = built(square(), [displaced(graph())], cache=cache)
    assert again.geometry is first.geometry
    other = built(square(), [displaced(graph(by=1.25))], cache=cache)
    assert np.allclose(vertices_of(other)[:, 2], 2.0)
    plain = built(square(), [Material("m", "m", None)], cache=cache)
    assert np.array_equal(vertices_of(plain), square().vertices)


def test_what_has_not_changed_is_not_diced_again() -> None:
    kept = KeptDisplacements()

    def asked(name: str, length: float) -> Mesh:
        return replace(square(), key=name, dicing=Dicing(5, np.eye(3, 4), length, 0.0, np.zeros((0, 4)), 0.0))

    first, second = kept.diced([asked("a", 0.3), asked("b", 0.3)], lambda: None)
    assert len(first.triangles) > 2 and first.dicing is None
    again, other = kept.diced([asked("a", 0.3), asked("b", 0.1)], lambda: None)
    assert again is first and len(other.triangles) > len(second.triangles)
    # What nobody asks for any more is freed.
    gone = weakref.ref(first)
    del first, again
    kept.diced([asked("b", 0.1)], lambda: None)
    gc.collect()
    assert gone() is None


def test_a_loop_of_nodes_in_a_displacement_is_named() -> None:
    loop = graph(by=Link(2, "Value"))
    loop.nodes.append(Node("ShaderNodeMath", "Loop", {"Value": Link(2, "Value")}, {"operation": "ADD"}))
    scene = built(square(), [displaced(loop)])
    assert any("loop of links" in notice.problem for notice in scene.notices)
    assert np.isfinite(vertices_of(scene)).all()


def test_instances_can_be_chosen() -> None:
    instances = plain_instances(np.stack([np.eye(4)] * 3), materials=[0, 1, 2])
    instances.motion[1] = np.stack([np.eye(4, dtype=np.float32)] * 2)
    instances.properties["object:a"] = np.arange(12, dtype=np.float32).reshape(3, 4)
    chosen = select_instances(instances, np.array([1]))
    assert chosen.material_offset.tolist() == [1] and list(chosen.motion) == [0]
    assert chosen.properties["object:a"].tolist() == [[4, 5, 6, 7]]
