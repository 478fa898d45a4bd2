# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of the last render: what was said, once each, and the objects that it was said of."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from engine.guiding.models.report import GuidingReport


@pytest.fixture
def named(blender: Any) -> Any:
    """A scene with objects, a material and a lamp to be named."""
    scene = blender.context.scene
    mesh = blender.data.meshes.new("Box data")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    mesh.materials.append(blender.data.materials.new("Glass"))
    for name in ("Box", "Box twin"):
        scene.collection.objects.link(blender.data.objects.new(name, mesh))
    lamp = blender.data.lights.new("Lamp data", "POINT")
    scene.collection.objects.link(blender.data.objects.new("Lamp", lamp))
    blender.context.view_layer.update()
    return scene


@pytest.mark.parametrize(
    ("subject", "names"),
    [
        ("Box", ["Box"]),
        ("object Box", ["Box"]),
        ("Box twin / Glass / Wave Texture", ["Box twin"]),
        ("Glass / Wave Texture", ["Box", "Box twin"]),
        ("mesh Box data", ["Box", "Box twin"]),
        ("light Lamp", ["Lamp"]),
        ("Lamp data", ["Lamp"]),
        ("Learned field", []),
    ],
)
def test_a_subject_leads_to_its_objects(named: Any, subject: str, names: list[str]) -> None:
    from addon.last_render import objects_of

    assert [item.name for item in objects_of(named, subject)] == names


def test_one_click_selects_what_a_message_is_about(named: Any, blender: Any) -> None:
    bpy = blender
    assert bpy.ops.neuralguide.select_subject(subject="Glass / Wave Texture") == {"FINISHED"}
    assert [item.name for item in named.objects if item.select_get()] == ["Box", "Box twin"]
    assert bpy.context.view_layer.objects.active.name == "Box"
    assert bpy.ops.neuralguide.select_subject(subject="Lamp") == {"FINISHED"}
    assert [item.name for item in named.objects if item.select_get()] == ["Lamp"]
    assert bpy.ops.neuralguide.select_subject(subject="nothing") == {"CANCELLED"}


def test_what_a_threshold_on_the_denoised_picture_came_to_is_said(blender: Any, monkeypatch: Any) -> None:
    from addon import engine, last_render
    from engine.render.report import RenderReport

    report = RenderReport(ended_by="DENOISED_THRESHOLD", denoised_error=0.01234, denoised_look=81)
    name = blender.context.scene.name
    said = SimpleNamespace(scene=name, view_layer="ViewLayer", frame=1, report=report, notices=[], status="FINISHED")
    monkeypatch.setattr(engine, "outcomes", [said])
    expected = "denoised picture: stopped at sample 81, error about 0.012"
    assert last_render.denoised_sentence(blender.context.scene) == expected
    said.report = RenderReport()
    assert last_render.denoised_sentence(blender.context.scene) == ""


def test_the_last_render_alone_counts(blender: Any) -> None:
    from addon import engine, last_render
    from engine.scene.description import Notice

    scene = blender.context.scene
    assert last_render.last_outcomes(scene) == [] and last_render.guiding_sentence(scene) == ""
    old, new, both = (Notice(subject, "is odd", "it is even") for subject in ("Old", "New", "Both"))
    guiding = GuidingReport(sentence="chose plain mixtures", cache_sentence="some paths ended early")
    report = SimpleNamespace(guiding=guiding, sample_count=8.0, render_seconds=1.0)
    for layer, frame, notices in (("A", 1, (old,)), ("A", 2, (new, both)), ("B", 2, (both,))):
        engine.outcomes.append(
            engine.Outcome(scene.name, layer, frame, "FINISHED", report=report, notices=notices)
        )
    engine.outcomes.append(engine.Outcome("another scene", "A", 2, "FINISHED", notices=(old,)))
    assert [outcome.view_layer for outcome in last_render.last_outcomes(scene)] == ["A", "B"]
    assert last_render.last_notices(scene) == [new, both]
    assert last_render.guiding_sentence(scene) == "chose plain mixtures"
    assert last_render.cache_sentence(scene) == "some paths ended early"
    # A scene of another file may have the same name.
    blender.ops.wm.read_homefile(use_empty=True)
    assert blender.context.scene.name == "Scene" and last_render.last_outcomes(blender.context.scene) == []


def test_a_render_leaves_what_it_said_for_the_panel(cube_scene: Any) -> None:
    import bpy

    from addon import last_render

    cube = cube_scene.objects["Cube"]
    material = bpy.data.materials.new("Clay")
    material.use_nodes = True
    cube.data.materials.append(material)
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    tree.links.new(tree.nodes.new("ShaderNodeTexIES").outputs[0], shader.inputs["Roughness"])
    cube_scene.neuralguide.guiding_method = "AUTO"
    bpy.ops.render.render()
    (outcome,) = last_render.last_outcomes(cube_scene)
    assert outcome.status == "FINISHED" and outcome.notices == tuple(last_render.last_notices(cube_scene))
    assert "without guiding" in last_render.guiding_sentence(cube_scene)
    subjects = [notice.subject for notice in outcome.notices]
    assert any(last_render.objects_of(cube_scene, subject) == [cube] for subject in subjects), subjects


def test_long_texts_are_wrapped_to_the_region() -> None:
    from addon.last_render import wrapped

    text = "words " * 40
    narrow = wrapped(text, SimpleNamespace(width=200))
    wide = wrapped(text, SimpleNamespace(width=800))
    assert len(narrow) > len(wide) > 1
    assert " ".join(wide) == " ".join(narrow) == text.strip()
