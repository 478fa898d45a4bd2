# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes that geometry nodes give to instances, beside Cycles: of all types, and of instances in instances."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from addon.export import instances as exported_instances  # noqa: E402
from tests.helpers.attribute_scenes import render_points  # noqa: E402
from tests.helpers.blender_scenes import empty_scene, export  # noqa: E402
from tests.helpers.pass_scenes import add_aov, make_material  # noqa: E402

#: What materials ask instances for.
NAMES = (
    "tint", "place", "color", "bytes", "flag", "small", "pair", "turn", "position", "id", "outer", "of the object",
    "of the instancer", "missing", "instance_transform",
)  # fmt: skip

pytestmark = pytest.mark.skipif(
    not hasattr(bpy.types.Object, "evaluated_geometry"), reason="this Blender shows Python no instances"
)


def asking() -> Any:
    """A material with an AOV for each name, and one for its alpha."""

    def surface(tree: Any) -> Any:
        emission = tree.nodes.new("ShaderNodeEmission")
        for name in NAMES:
            node = tree.nodes.new("ShaderNodeAttribute")
            node.attribute_type, node.attribute_name = "INSTANCER", name
            tree.links.new(node.outputs["Color"], add_aov(tree, name).inputs["Color"])
            tree.links.new(node.outputs["Alpha"], add_aov(tree, f"alpha of {name}").inputs["Value"])
            if name == "tint":
                tree.links.new(node.outputs["Color"], emission.inputs["Color"])
        return emission.outputs[0]

    return make_material("Asking", surface)


class Nodes:
    """Geometry nodes of an object on points: instances on them, which have attributes."""

    def __init__(self, scene: Any, name: str, points: list[tuple[float, float, float]]) -> None:
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(points, [], [])
        self.object = bpy.data.objects.new(name, mesh)
        scene.collection.objects.link(self.object)
        self.object["of the instancer"] = 0.33
        self.tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
        for direction in ("INPUT", "OUTPUT"):
            self.tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
        source, self._output = self.tree.nodes.new("NodeGroupInput"), self.tree.nodes.new("NodeGroupOutput")
        self.instances = self.tree.nodes.new("GeometryNodeInstanceOnPoints")
        self.link(source.outputs[0], self.instances.inputs["Points"])
        self._last = self.instances.outputs[0]
        self.object.modifiers.new("Nodes", "NODES").node_group = self.tree

    def link(self, socket: Any, to: Any) -> None:
        self.tree.links.new(socket, to)

    def node(self, kind: str) -> Any:
        return self.tree.nodes.new(f"GeometryNode{kind}")

    def show(self, node: Any) -> None:
        """Make instances of the geometry that a node gives."""
        geometry = next(socket for socket in node.outputs if socket.type == "GEOMETRY")
        self.link(geometry, self.instances.inputs["Instance"])

    def store(self, name: str, kind: str, value: Any) -> None:
        """Give instances an attribute: of a socket's value, or of one number."""
        node = self.node("StoreNamedAttribute")
        node.domain, node.data_type = "INSTANCE", kind
        node.inputs["Name"].default_value = name
        socket = next(socket for socket in node.inputs if socket.name == "Value" and socket.enabled)
        if isinstance(value, (int, float)):
            socket.default_value = value
        elif value is not None:
            self.link(value, socket)
        self.then(node)

    def then(self, node: Any) -> None:
        """Send the geometry through a node."""
        self.link(self._last, node.inputs["Geometry"])
        self._last = node.outputs[0]

    def finish(self) -> Any:
        self.link(self._last, self._output.inputs[0])
        return self.object


def square_nodes(scene: Any, of: str = "object", *, repeats_ids: bool = False) -> Nodes:
    """25 instances of a square far away, or of a collection of it and a disk, with an attribute of each type."""
    bpy.ops.mesh.primitive_plane_add(size=0.5, location=(100.0, 0.0, 0.0))
    square = bpy.context.object
    square.data.materials.append(asking())
    square["of the object"] = 0.77
    nodes = Nodes(scene, "Squares", [(x, y, 0.0) for x in range(-2, 3) for y in range(-2, 3)])
    if of == "collection":
        shown = nodes.node("CollectionInfo")
        both = [square, disk(square, (100.3, 0.3, 0.1))]
        shown.inputs["Collection"].default_value = collected(both, (100.0, 0.0, 0.0))
    elif of == "grid":
        grid, shown = nodes.node("MeshGrid"), nodes.node("SetMaterial")
        grid.inputs["Size X"].default_value = grid.inputs["Size Y"].default_value = 0.5
        shown.inputs["Material"].default_value = square.data.materials[0]
        nodes.link(grid.outputs[0], shown.inputs["Geometry"])
    else:
        shown = nodes.node("ObjectInfo")
        shown.inputs["Object"].default_value, shown.inputs["As Instance"].default_value = square, True
    nodes.show(shown)
    index, place = nodes.node("InputIndex").outputs[0], nodes.node("InputPosition").outputs[0]
    for name, kind, value in (
        ("tint", "FLOAT", index), ("place", "FLOAT_VECTOR", place), ("color", "FLOAT_COLOR", place),
        ("bytes", "BYTE_COLOR", place), ("flag", "BOOLEAN", place), ("small", "INT8", index), ("pair", "FLOAT2", place),
        ("turn", "QUATERNION", None),
    ):  # fmt: skip
        nodes.store(name, kind, value)
    if repeats_ids:
        fold, ids = nodes.tree.nodes.new("ShaderNodeMath"), nodes.node("SetID")
        fold.operation = "MODULO"
        fold.inputs[1].default_value = 7.0
        nodes.link(index, fold.inputs[0])
        nodes.link(fold.outputs[0], ids.inputs["ID"])
        nodes.then(ids)
    return nodes


def disk(like: Any, location: tuple[float, float, float]) -> Any:
    bpy.ops.mesh.primitive_circle_add(radius=0.2, fill_type="NGON", location=location)
    bpy.context.object.data.materials.append(like.data.materials[0])
    return bpy.context.object


def collected(objects: list[Any], offset: tuple[float, float, float]) -> Any:
    """A collection of the scene that has these objects alone to itself."""
    collection = bpy.data.collections.new("Collected")
    bpy.context.scene.collection.children.link(collection)
    for item in objects:
        for other in list(item.users_collection):
            other.objects.unlink(item)
        collection.objects.link(item)
    collection.instance_offset = offset
    return collection


def in_instances(scene: Any, through: str) -> None:
    """Instances of what makes instances: of the object, or of a collection that it is in."""
    inner = square_nodes(scene).finish()
    inner.location, inner.scale = (100.0, 50.0, 0.0), (0.2, 0.2, 0.2)
    nodes = Nodes(scene, "Outer", [(-1.5, -1.5, 0.0), (1.5, -1.5, 0.0), (0.0, 1.5, 0.0)])
    if through == "collection":
        square = next(item for item in scene.objects if item.name == "Plane")
        shown = nodes.node("CollectionInfo")
        shown.inputs["Collection"].default_value = collected(
            [disk(square, (100.6, 50.6, 0.1)), inner], (100.0, 50.0, 0.0)
        )
    else:
        shown = nodes.node("ObjectInfo")
        shown.inputs["Object"].default_value, shown.inputs["As Instance"].default_value = inner, True
    nodes.show(shown)
    nodes.store("outer", "INT", nodes.node("InputIndex").outputs[0])
    # The inner ones count.
    nodes.store("tint", "FLOAT", 55.0)
    nodes.finish()


def of_empties(scene: Any) -> None:
    """A collection with instances, itself an instance of three empties."""
    made = square_nodes(scene).finish()
    made.scale = (0.3, 0.3, 0.3)
    scene.collection.objects.unlink(made)
    collection = bpy.data.collections.new("Hidden")
    collection.objects.link(made)
    for number in range(3):
        empty = bpy.data.objects.new("Empty", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        empty.location = (2.0 * number - 2.0, 0.0, 0.0)
        empty["of the instancer"] = number / 10
        scene.collection.objects.link(empty)


def beside_curves(scene: Any) -> None:
    """Instances in a geometry that has curves too."""
    nodes = square_nodes(scene)
    join, circle = nodes.node("JoinGeometry"), nodes.node("CurvePrimitiveCircle")
    nodes.link(circle.outputs[0], join.inputs[0])
    nodes.then(join)
    nodes.finish()


SCENES: dict[str, Callable[[Any], Any]] = {
    "of an object": lambda scene: square_nodes(scene).finish(),
    "of repeated ids": lambda scene: square_nodes(scene, repeats_ids=True).finish(),
    "of a collection": lambda scene: square_nodes(scene, "collection").finish(),
    "of a made mesh": lambda scene: square_nodes(scene, "grid").finish(),
    "in instances": lambda scene: in_instances(scene, "object"),
    "in a collection in instances": lambda scene: in_instances(scene, "collection"),
    "of empties": of_empties,
    "beside curves": beside_curves,
}


@pytest.mark.parametrize("name", SCENES)
def test_attributes_of_instances_are_those_of_cycles(name: str, blender: Any, tmp_path: Path) -> None:
    scene = empty_scene()
    scene.camera.data.type, scene.camera.data.ortho_scale, scene.camera.location = "ORTHO", 6.0, (0.0, 0.0, 20.0)
    SCENES[name](scene)
    aovs = scene.view_layers[0].aovs
    for attribute in NAMES:
        for shown, kind in ((attribute, "COLOR"), (f"alpha of {attribute}", "VALUE")):
            aov = aovs.add()
            aov.name, aov.type = shown, kind
    scene.render.resolution_x = scene.render.resolution_y = 48
    ours, theirs = render_points(scene, tmp_path)
    channels = [channel for channel in theirs if channel.split(".")[0].removeprefix("alpha of ") in NAMES]
    assert len(channels) >= 4 * len(NAMES)
    # Edges may be seen or not.
    wrong = {channel: np.mean(np.abs(ours[channel] - theirs[channel]) > 1e-3) for channel in channels}
    assert {channel: share for channel, share in wrong.items() if share > 0.02} == {}
    assert len(np.unique(theirs["tint.R"])) > 10, "there is something to see"


def test_many_instances_share_one_mesh(blender: Any) -> None:
    scene = empty_scene()
    square_nodes(scene).finish()
    description = export()
    assert len(description.meshes) == 1 and len(description.instances.mesh) == 26
    np.testing.assert_array_equal(description.instances.properties["instancer:tint"][1:, 0], np.arange(25.0))
    assert description.notices == []


def test_a_blender_that_shows_no_instances_says_so(blender: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = empty_scene()
    square_nodes(scene).finish()
    monkeypatch.setattr(exported_instances, "can_read_instances", lambda: False)
    problems = [notice.problem for notice in export().notices]
    assert "attribute 'tint' of geometry nodes' instances cannot be read" in problems
