# SPDX-License-Identifier: GPL-3.0-or-later
"""Previews of materials, which Blender asks for when it shows them in lists and in the properties editor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from addon import engine, material_preview
from engine.array_types import Float32Array


@pytest.fixture
def regions(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Any]]:
    """Regions of the previews that NeuralGuide has rendered, in order."""
    seen: list[Any] = []
    render = material_preview.render_preview

    def noting(*arguments: Any) -> None:
        seen.append(arguments[2].frame.region)
        render(*arguments)

    monkeypatch.setattr(material_preview, "render_preview", noting)
    yield seen
    material_preview.forget_session()


def _preview(bpy: Any, name: str) -> Float32Array:
    """Blender's preview of a red, shiny material by the engine of that name."""
    bpy.context.scene.render.engine = name
    material = bpy.data.materials.new("Red")
    material.use_nodes = True
    inputs = material.node_tree.nodes["Principled BSDF"].inputs
    inputs["Base Color"].default_value, inputs["Roughness"].default_value = (0.8, 0.02, 0.02, 1.0), 0.4
    material.asset_generate_preview()
    width, height = material.preview.image_size
    return np.array(material.preview.image_pixels_float, np.float32).reshape(height, width, 4)


def test_a_preview_is_that_of_cycles(blender: Any, regions: list[Any]) -> None:
    """Both have some noise: 64 samples leave less than 1% in the mean of the 16,384 pixels."""
    count = engine.outcome_count()
    ours = _preview(blender, "NEURALGUIDE")
    assert regions == [(0, 0, 128, 128)]
    theirs = _preview(blender, "CYCLES")
    assert len(regions) == 1
    np.testing.assert_allclose(ours.mean((0, 1)), theirs.mean((0, 1)), rtol=0.01)
    assert np.abs(ours - theirs).mean() < 0.01
    assert engine.outcome_count() == count, "a preview is no render that the Last Render panel shows"


def _matter(bpy: Any, kind: str) -> Any:
    """A material of skin, or of Principled Hair which is previewed on strands."""
    material = bpy.data.materials.new(kind)
    material.use_nodes = True
    tree = material.node_tree
    if kind == "skin":
        inputs = tree.nodes["Principled BSDF"].inputs
        inputs["Base Color"].default_value, inputs["Subsurface Weight"].default_value = (0.8, 0.5, 0.4, 1.0), 1.0
        inputs["Subsurface Scale"].default_value = 0.3
        return material
    hair = tree.nodes.new("ShaderNodeBsdfHairPrincipled")
    hair.model = "CHIANG"
    tree.links.new(hair.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    material.preview_render_type = "HAIR"
    return material


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["skin", "hair"])
def test_skin_and_hair_have_previews(
    blender: Any, regions: list[Any], kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of their colours. Cycles takes minutes for its own."""
    settings = material_preview.preview_settings
    monkeypatch.setattr(material_preview, "preview_settings", lambda scene: replace(settings(scene), samples=4))
    blender.context.scene.render.engine = "NEURALGUIDE"
    material = _matter(blender, kind)
    material.asset_generate_preview()
    width, height = material.preview.image_size
    image = np.array(material.preview.image_pixels_float, np.float32).reshape(height, width, 4)
    assert len(regions) == 1 and np.isfinite(image).all()
    red, _, blue = image[height // 3 : -height // 3, width // 3 : -width // 3, :3].mean((0, 1))
    assert red > 1.15 * blue > 0.0


def test_previews_take_little_whatever_the_scene_asks_for(blender: Any) -> None:
    scene = blender.context.scene
    scene.cycles.samples, scene.neuralguide.guiding_method = 4096, "NEURAL_RIS"
    scene.neuralguide.radiance_cache = "CONVERGING"
    settings = material_preview.preview_settings(scene)
    assert settings.samples <= 64
    assert (settings.guiding_method, settings.radiance_cache) == ("OFF", "OFF")
