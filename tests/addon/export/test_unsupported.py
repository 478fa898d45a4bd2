# SPDX-License-Identifier: GPL-3.0-or-later
"""Nothing is dropped in silence: whatever of a Cycles scene is not exported is named, once, with what has it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.blender_scenes import empty_scene


@pytest.fixture
def scene() -> Any:
    """A camera, a plane with a material that displaces, and a lamp; nothing in it is worth a notice."""
    import bpy

    scene = empty_scene()
    bpy.ops.mesh.primitive_plane_add()
    plane = bpy.context.object
    material = bpy.data.materials.new("Paint")
    material.use_nodes = True
    plane.data.materials.append(material)
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    scene.collection.objects.link(lamp)
    return scene


def displace(scene: Any, method: str) -> None:
    material = scene.objects["Plane"].data.materials[0]
    nodes = material.node_tree.nodes
    noise, displacement = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeDisplacement")
    output = next(node for node in nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    material.node_tree.links.new(noise.outputs[0], displacement.inputs["Height"])
    material.node_tree.links.new(displacement.outputs[0], output.inputs["Displacement"])
    material.displacement_method = method


def subdivide(scene: Any) -> None:
    scene.objects["Plane"].modifiers.new("Subdivision", "SUBSURF").use_adaptive_subdivision = True


def switch(owner: str, name: str, value: Any = True) -> Callable[[Any], None]:
    """Set `name` of what the expression `owner` gives for the scene."""

    def change(scene: Any) -> None:
        names = {"scene": scene, "lamp": scene.objects["Lamp"], "plane": scene.objects["Plane"]}
        setattr(eval(owner, names), name, value)

    return change


CASES = {
    "adaptive-subdivision": (subdivide, "Plane", "adaptive subdivision"),
    "texture-cache": (switch("scene.render", "use_auto_generate_texture_cache"), "Scene", "texture cache"),
}  # fmt: skip


#: Cases about what Blender 5.2 has and older ones have not.
NEW = {"texture-cache"}


def notices(scene: Any) -> list[Any]:
    import bpy

    from addon.export import export_scene
    from engine.builder.programs import compile_scene

    description = export_scene(bpy.context.evaluated_depsgraph_get())
    return description.notices + compile_scene(description).notices


@pytest.mark.parametrize("method", ["BUMP", "DISPLACEMENT", "BOTH"])
def test_the_plain_scene_has_no_notices(scene: Any, method: str) -> None:
    displace(scene, method)
    assert notices(scene) == []


@pytest.mark.parametrize("case", CASES)
def test_what_is_dropped_is_named_once(scene: Any, case: str) -> None:
    import bpy

    if case in NEW and bpy.app.version < (5, 2):
        pytest.skip("Blender 5.2 has that")
    change, subject, problem = CASES[case]
    change(scene)
    found = [notice for notice in notices(scene) if problem in notice.problem]
    assert [notice.subject for notice in found] == [subject]
    assert "not supported" in found[0].problem
    assert found[0].fallback


def test_a_texture_cache_is_named_where_cycles_would_use_it(scene: Any, tmp_path: Path) -> None:
    import bpy

    if bpy.app.version < (5, 3):
        pytest.skip("Blender 5.3 can leave a texture cache alone")

    def is_named() -> bool:
        return any("texture cache" in notice.problem for notice in notices(scene))

    image = bpy.data.images.new("Picture", 4, 4)
    image.filepath_raw, image.file_format = str(tmp_path / "picture.png"), "PNG"
    image.save()
    tree = scene.objects["Plane"].data.materials[0].node_tree
    tree.nodes.new("ShaderNodeTexImage").image = bpy.data.images.load(str(tmp_path / "picture.png"))
    assert not is_named()
    # One that was made by an earlier render, or by hand, is used without being asked for.
    (tmp_path / "blender_tx").mkdir()
    (tmp_path / "blender_tx" / "picture.tx").touch()
    assert is_named()
    scene.render.use_texture_cache = False
    assert not is_named()
    scene.render.use_auto_generate_texture_cache = True
    assert not is_named(), "no cache is used, whatever makes one"
    scene.render.use_texture_cache = True
    assert is_named()


TEXTURES = ["ShaderNodeTexIES"]


@pytest.mark.parametrize("kind", TEXTURES)
def test_nodes_that_are_missing_are_named(scene: Any, kind: str) -> None:
    tree = scene.objects["Plane"].data.materials[0].node_tree
    node = tree.nodes.new(kind)
    shader = next(item for item in tree.nodes if item.bl_idname == "ShaderNodeBsdfPrincipled")
    tree.links.new(next(socket for socket in node.outputs if socket.enabled), shader.inputs["Base Color"])
    found = notices(scene)
    assert [notice.subject for notice in found] == [f"Plane / Paint / {node.name}"]


@pytest.mark.parametrize("kind, strength, weight", [
    ("ShaderNodeBsdfGlass", "Anisotropy", None),
    ("ShaderNodeBsdfPrincipled", "Anisotropic", "Transmission Weight"),
])  # fmt: skip
def test_nothing_is_said_of_anisotropic_glass(scene: Any, kind: str, strength: str, weight: str | None) -> None:
    tree = scene.objects["Plane"].data.materials[0].node_tree
    node = tree.nodes.new(kind)
    if strength not in node.inputs:
        pytest.skip("Blender 5.3 has anisotropic glass")
    output = next(item for item in tree.nodes if item.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    node.inputs[strength].default_value = 0.5
    if weight is not None:
        node.inputs[weight].default_value = 1.0
    assert notices(scene) == []


@pytest.mark.parametrize("kind", ["Attribute", "LightInfo", "LightEvaluation", "LightAccumulation", "ShadowRaycast"])
def test_what_reads_lights_is_named(scene: Any, kind: str) -> None:
    import bpy

    if bpy.app.version < (5, 3):
        pytest.skip("Blender 5.3 has light loops")
    tree = scene.objects["Plane"].data.materials[0].node_tree
    node = tree.nodes.new(f"ShaderNode{kind}")
    if kind == "Attribute":
        node.attribute_type, node.attribute_name = "LIGHT", "energy"
    output = next(item for item in tree.nodes if item.bl_idname == "ShaderNodeOutputMaterial")
    shader = next(item for item in tree.nodes if item.bl_idname == "ShaderNodeBsdfPrincipled")
    is_shader = node.outputs[0].type == "SHADER"
    tree.links.new(node.outputs[0], output.inputs["Surface"] if is_shader else shader.inputs["Base Color"])
    (found,) = notices(scene)
    # Blender itself takes links from such nodes for invalid outside of a light loop.
    if tree.links[-1].is_valid:
        assert found.subject == f"Plane / Paint / {node.name}" and "not supported" in found.problem
    else:
        assert found.problem.startswith("has an invalid link")


def test_gaussian_splats_are_named(scene: Any) -> None:
    import bpy

    if bpy.app.version < (5, 3):
        pytest.skip("Blender 5.3 has Gaussian splats")
    points = bpy.data.pointclouds.new("Splats")
    points.type = "GAUSSIAN_SPLAT"
    scene.collection.objects.link(bpy.data.objects.new("Splats", points))
    assert [(notice.subject, notice.problem) for notice in notices(scene)] == [
        ("Splats", "Gaussian splats are not supported")
    ]


def test_what_a_volume_cannot_do_is_named(scene: Any) -> None:
    material = scene.objects["Plane"].data.materials[0]
    tree = material.node_tree
    output = next(item for item in tree.nodes if item.bl_idname.startswith("ShaderNodeOutput"))
    volume = tree.nodes.new("ShaderNodeVolumeScatter")
    tree.links.new(volume.outputs[0], output.inputs["Volume"])
    noise = tree.nodes.new("ShaderNodeTexNoise")
    tree.links.new(noise.outputs[0], volume.inputs["Density"])
    assert notices(scene) == []
    volume.phase = "MIE"
    tree.links.new(noise.outputs[0], volume.inputs["Diameter"])
    found = {notice.subject: notice.problem for notice in notices(scene)}
    assert "Diameter" in found[f"Plane / Paint / {volume.name}"]


def test_an_ies_lamp_is_named(scene: Any) -> None:
    data = scene.objects["Lamp"].data
    data.use_nodes = True
    tree = data.node_tree
    ies = tree.nodes.new("ShaderNodeTexIES")
    emission = next(item for item in tree.nodes if item.bl_idname == "ShaderNodeEmission")
    tree.links.new(ies.outputs[0], emission.inputs["Strength"])
    found = notices(scene)
    assert len(found) == 1 and "Lamp" in found[0].subject and ies.name in found[0].subject


def test_passes_of_cycles_are_named(scene: Any) -> None:
    from addon.passes import unsupported_passes

    layer = scene.view_layers[0]
    assert unsupported_passes(layer) == []
    layer.cycles.use_pass_volume_scatter = True
    layer.use_pass_subsurface_color = True
    assert unsupported_passes(layer) == ["Subsurface Color", "Volume Scatter"]
