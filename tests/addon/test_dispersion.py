# SPDX-License-Identifier: GPL-3.0-or-later
"""Dispersion of materials: from Blender's panel to what kernels read."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from engine.builder.programs import compile_scene
from engine.scene.description import Material, SceneDescription
from engine.spectral.dispersion import dispersion_from_abbe, dispersion_from_cauchy
from tests.helpers.blender_scenes import stand_in


@pytest.fixture
def glass(cube_scene: Any) -> Any:
    """A glass material on the cube."""
    return _material(cube_scene, "ShaderNodeBsdfGlass")


def _material(scene: Any, kind: str, tree: Any = None) -> Any:
    import bpy

    material = bpy.data.materials.new("Material")
    scene.objects["Cube"].data.materials.clear()
    scene.objects["Cube"].data.materials.append(material)
    nodes = material.node_tree.nodes
    nodes.clear()
    node = nodes.new(kind)
    if tree is not None:
        node.node_tree = tree
    material.node_tree.links.new(node.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return material


def _export() -> SceneDescription:
    import bpy

    from addon.export import export_scene

    return export_scene(bpy.context.evaluated_depsgraph_get())


def _only_material() -> Material:
    return _export().materials[0]


def test_nothing_disperses_unless_asked(glass: Any) -> None:
    description = _export()
    assert description.materials[0].dispersion == 0.0 and not description.has_dispersion
    assert not compile_scene(description).arrays.program_dispersion.any()


def test_an_abbe_number_reaches_the_programs(glass: Any) -> None:
    plain = _only_material().key
    glass.neuralguide.dispersion = "ABBE"
    glass.neuralguide.abbe_number = 30.0
    description = _export()
    assert description.has_dispersion
    assert description.materials[0].dispersion == pytest.approx(dispersion_from_abbe(30.0))
    assert description.materials[0].key != plain, "a kept program would not disperse"
    programs = compile_scene(description)
    dispersion = programs.arrays.program_dispersion
    assert dispersion.dtype == np.float32 and len(dispersion) == len(programs.arrays.programs)
    assert dispersion[0] == pytest.approx(dispersion_from_abbe(30.0)) and not dispersion[1:].any()


def test_cauchy_coefficients_reach_the_description(glass: Any) -> None:
    glass.neuralguide.dispersion = "CAUCHY"
    glass.neuralguide.cauchy_a, glass.neuralguide.cauchy_b = 1.7, 0.013
    assert _only_material().dispersion == pytest.approx(dispersion_from_cauchy(1.7, 0.013), rel=1e-6)
    glass.neuralguide.cauchy_b = 0.0
    assert not _export().has_dispersion


def test_only_what_refracts_disperses(cube_scene: Any) -> None:
    import bpy

    from addon.dispersion import can_disperse

    for kind, refracts in (
        ("ShaderNodeBsdfDiffuse", False),
        ("ShaderNodeBsdfRefraction", True),
        ("ShaderNodeBsdfPrincipled", False),
    ):
        material = _material(cube_scene, kind)
        material.neuralguide.dispersion = "ABBE"
        assert can_disperse(material) == refracts == _export().has_dispersion, kind
    principled = next(node for node in material.node_tree.nodes if "Transmission Weight" in node.inputs)
    principled.inputs["Transmission Weight"].default_value = 0.3
    assert _export().has_dispersion
    principled.inputs["Transmission Weight"].default_value = 0.0
    value = material.node_tree.nodes.new("ShaderNodeValue")
    material.node_tree.links.new(value.outputs[0], principled.inputs["Transmission Weight"])
    assert _export().has_dispersion
    principled.mute = True
    assert not can_disperse(material)

    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    group.interface.new_socket("BSDF", in_out="OUTPUT", socket_type="NodeSocketShader")
    inner = group.nodes.new("ShaderNodeBsdfGlass")
    group.links.new(inner.outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    material = _material(cube_scene, "ShaderNodeGroup", group)
    material.neuralguide.dispersion = "ABBE"
    assert _export().has_dispersion


def test_the_panel_shows_what_the_kind_needs(glass: Any) -> None:
    from addon import ui

    drawn: list[str] = []

    class Layout:
        def prop(self, owner: Any, name: str, text: str = "") -> None:
            getattr(owner, name)
            drawn.append(name)

        def column(self) -> Any:
            return self

    import bpy

    drawer = stand_in(ui.NEURALGUIDE_PT_dispersion, Layout())
    for kind, rest in (("NONE", []), ("ABBE", ["abbe_number"]), ("CAUCHY", ["cauchy_a", "cauchy_b"])):
        drawn.clear()
        glass.neuralguide.dispersion = kind
        ui.NEURALGUIDE_PT_dispersion.draw(drawer, SimpleNamespace(material=glass))
        assert drawn == ["dispersion", *rest]
    poll = bpy.types.NEURALGUIDE_PT_dispersion.poll
    assert poll(SimpleNamespace(engine="NEURALGUIDE", material=glass))
    assert not poll(SimpleNamespace(engine="CYCLES", material=glass))
    assert not poll(SimpleNamespace(engine="NEURALGUIDE", material=None))
    assert not poll(SimpleNamespace(engine="NEURALGUIDE", material=bpy.data.materials.new("Plain")))


def test_the_setting_is_saved_with_the_file(glass: Any, tmp_path: Any) -> None:
    import bpy

    glass.neuralguide.dispersion, glass.neuralguide.abbe_number = "ABBE", 42.0
    path = str(tmp_path / "glass.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    settings = bpy.data.materials["Material"].neuralguide
    assert (settings.dispersion, settings.abbe_number) == ("ABBE", 42.0)


def test_broken_numbers_do_not_disperse(glass: Any) -> None:
    description = _export()
    for value in (float("nan"), float("inf")):
        description.materials[0].dispersion = value
        assert not compile_scene(description).arrays.program_dispersion.any()


@pytest.fixture
def principled(cube_scene: Any) -> Any:
    """The inputs of a Principled BSDF on the cube, of glass."""
    material = _material(cube_scene, "ShaderNodeBsdfPrincipled")
    inputs = next(node for node in material.node_tree.nodes if "Transmission Weight" in node.inputs).inputs
    if "Transmission Dispersion Scale" not in inputs:
        pytest.skip("Blender 5.3 has dispersion")
    inputs["Transmission Weight"].default_value = 1.0
    return inputs


def _problems() -> list[tuple[str, str, str]]:
    return [(notice.subject, notice.problem, notice.fallback) for notice in _export().notices]


@pytest.mark.parametrize("scale, abbe_number, acts", [(1.0, 30.0, 30.0), (0.5, 30.0, 60.0), (3.0, 20.0, 20.0)])
def test_a_principled_surface_disperses_as_its_inputs_say(
    principled: Any, scale: float, abbe_number: float, acts: float
) -> None:
    principled["Transmission Dispersion Scale"].default_value = scale
    principled["Transmission Dispersion Abbe Number"].default_value = abbe_number
    description = _export()
    assert description.has_dispersion and description.notices == []
    assert description.materials[0].dispersion == pytest.approx(dispersion_from_abbe(acts), rel=1e-6)
    assert compile_scene(description).notices == []


def test_a_principled_surface_does_not_disperse_unless_asked(principled: Any) -> None:
    assert not _export().has_dispersion
    principled["Transmission Dispersion Scale"].default_value = 1.0
    principled["Transmission Dispersion Abbe Number"].default_value = 0.0
    assert not _export().has_dispersion
    principled["Transmission Dispersion Abbe Number"].default_value = 20.0
    principled["Transmission Weight"].default_value = 0.0
    assert not _export().has_dispersion


def test_the_node_counts_before_the_panel_which_is_said(principled: Any) -> None:
    import bpy

    material = bpy.data.materials["Material"]
    material.neuralguide.dispersion, material.neuralguide.abbe_number = "ABBE", 50.0
    assert _only_material().dispersion == pytest.approx(dispersion_from_abbe(50.0)), "the panel remains"
    assert _problems() == []
    principled["Transmission Dispersion Scale"].default_value = 1.0
    principled["Transmission Dispersion Abbe Number"].default_value = 30.0
    assert _only_material().dispersion == pytest.approx(dispersion_from_abbe(30.0))
    assert _problems() == [
        ("Cube / Material", "its Dispersion panel is not read", "dispersion as its Principled BSDF says")
    ]


def test_the_panel_says_that_the_node_counts(principled: Any) -> None:
    import bpy

    from addon.dispersion import disperses_by_node

    assert not disperses_by_node(bpy.data.materials["Material"])
    principled["Transmission Dispersion Scale"].default_value = 1.0
    assert disperses_by_node(bpy.data.materials["Material"])


@pytest.mark.parametrize("kind", ["ShaderNodeValue", "ShaderNodeTexNoise"])
def test_a_linked_scale_is_read_or_named(principled: Any, kind: str) -> None:
    import bpy

    tree = bpy.data.materials["Material"].node_tree
    source = tree.nodes.new(kind)
    tree.links.new(source.outputs[0], principled["Transmission Dispersion Scale"])
    if kind == "ShaderNodeValue":
        source.outputs[0].default_value = 0.5
        assert _only_material().dispersion == pytest.approx(dispersion_from_abbe(40.0))
        assert _problems() == []
        return
    assert not _export().has_dispersion
    assert [problem for _, problem, _ in _problems()] == [
        "dispersion of 'Principled BSDF' that varies over the surface is not supported"
    ]


def test_nodes_that_disperse_differently_in_one_material_are_named(principled: Any) -> None:
    import bpy

    principled["Transmission Dispersion Scale"].default_value = 1.0
    tree = bpy.data.materials["Material"].node_tree
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    mix, glass = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfGlass")
    tree.links.new(output.inputs["Surface"].links[0].from_socket, mix.inputs[1])
    tree.links.new(glass.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    assert _only_material().dispersion == pytest.approx(dispersion_from_abbe(20.0))
    assert _problems() == [(
        "Cube / Material", "nodes that disperse differently in one material are not supported",
        "all as the strongest of them",
    )]  # fmt: skip
