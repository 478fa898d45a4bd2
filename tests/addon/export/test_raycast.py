# SPDX-License-Identifier: GPL-3.0-or-later
"""What Raycast nodes meet, and what they read there."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("bpy")

import bpy

from engine.scene.description import VISIBLE_ALL, VISIBLE_RAYCAST
from tests.helpers.blender_scenes import empty_scene, export
from tests.helpers.plain_meshes import add_square


@pytest.fixture
def scene() -> Any:
    return empty_scene()


def look_at_heat(seen: Any) -> Any:
    """Give an object a material that is as coloured as attribute "heat" of what its rays hit; the node's output."""
    material = bpy.data.materials.new("Looks")
    nodes = material.node_tree.nodes
    node = nodes.new("ShaderNodeRaycast")
    node.sample_attribute_items.new("FLOAT", "Named")
    next(socket for socket in node.inputs if socket.type == "STRING").default_value = "heat"
    output = next(socket for socket in node.outputs if socket.name == "Named")
    material.node_tree.links.new(output, nodes["Principled BSDF"].inputs["Base Color"])
    seen.data.materials.append(material)
    return output


def test_visibility_to_raycast_nodes(scene: Any) -> None:
    for name in ("Unseen", "Met alone", "Nothing"):
        square = add_square(name)
        kinds = ("camera", "diffuse", "glossy", "transmission", "volume_scatter", "shadow")
        if name != "Unseen":
            for kind in kinds:
                setattr(square, f"visible_{kind}", False)
        if bpy.app.version >= (5, 3):
            square.visible_raycast = name == "Met alone"
    instances = export().instances
    visibility = dict(zip(instances.name, instances.visibility.tolist(), strict=True))
    if bpy.app.version >= (5, 3):
        assert visibility == {"Unseen": VISIBLE_ALL, "Met alone": VISIBLE_RAYCAST}
    else:
        assert visibility == {"Unseen": VISIBLE_ALL | VISIBLE_RAYCAST}


def test_attributes_of_what_is_hit_are_asked_of_every_mesh(scene: Any) -> None:
    if not hasattr(bpy.types, "ShaderNodeRaycast"):
        pytest.skip("Blender 5.1 has the node")
    seen, hit = add_square("Seen"), add_square("Hit")
    for name, kind in (("heat", "FLOAT"), ("other", "FLOAT")):
        hit.data.attributes.new(name, kind, "POINT")
    output = look_at_heat(seen)
    description = export()
    assert {mesh.name: sorted(mesh.attributes) for mesh in description.meshes}["Hit"] == ["heat"]
    raycast = next(one for one in description.materials[0].graph.nodes if one.kind == "ShaderNodeRaycast")
    assert raycast.properties["attributes"] == ((output.identifier, "heat", "VALUE"),)
    assert description.notices == []


def test_vertex_groups_of_what_is_hit(scene: Any) -> None:
    """No material of the mesh reads one, and the material that does is met after it."""
    if not hasattr(bpy.types, "ShaderNodeRaycast"):
        pytest.skip("Blender 5.1 has the node")
    hit, seen = add_square("Hit"), add_square("Seen")
    hit.vertex_groups.new(name="heat").add([0, 2], 0.25, "REPLACE")
    look_at_heat(seen)
    description = export()
    attribute = next(mesh for mesh in description.meshes if mesh.name == "Hit").attributes["heat"]
    assert attribute.domain == "POINT" and attribute.data[:, 0].tolist() == [0.25, 0.0, 0.25, 0.0]
