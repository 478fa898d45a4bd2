# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands before lights and cameras, beside Cycles: holdouts, surfaces that count and measure, bumps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.helpers.blender_scenes import empty_scene  # noqa: E402
from tests.helpers.pass_scenes import render_both  # noqa: E402


def material(name: str) -> tuple[Any, Any, Any]:
    """A material with nothing but its output: it, its nodes, its links."""
    made = bpy.data.materials.new(name)
    if made.node_tree is None:
        made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    nodes.new("ShaderNodeOutputMaterial")
    return made, nodes, links


def mixed(name: str, number: str, threshold: float) -> Any:
    """Transparent up to a number of Light Path, black behind it."""
    made, nodes, links = material(name)
    path, compare, mix = (nodes.new(kind) for kind in ("ShaderNodeLightPath", "ShaderNodeMath", "ShaderNodeMixShader"))
    compare.operation = "GREATER_THAN"
    compare.inputs[1].default_value = threshold
    links.new(path.outputs[number], compare.inputs[0])
    links.new(compare.outputs[0], mix.inputs[0])
    links.new(nodes.new("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[1])
    links.new(nodes.new("ShaderNodeEmission").outputs[0], mix.inputs[2])
    nodes["Emission"].inputs["Strength"].default_value = 0.0
    links.new(mix.outputs[0], nodes["Material Output"].inputs["Surface"])
    return made


def holdout() -> Any:
    made, nodes, links = material("Holdout")
    links.new(nodes.new("ShaderNodeHoldout").outputs[0], nodes["Material Output"].inputs["Surface"])
    return made


def lengths() -> Any:
    """Glows by the length of the ray."""
    made, nodes, links = material("Lengths")
    path, glow = nodes.new("ShaderNodeLightPath"), nodes.new("ShaderNodeEmission")
    links.new(path.outputs["Ray Length"], glow.inputs["Strength"])
    links.new(glow.outputs[0], nodes["Material Output"].inputs["Surface"])
    return made


def bumped() -> Any:
    """Steep displacement that is shown as bump."""
    made, nodes, links = material("Bumped")
    wave, displacement = nodes.new("ShaderNodeTexWave"), nodes.new("ShaderNodeDisplacement")
    wave.inputs["Scale"].default_value = 0.5
    displacement.inputs["Scale"].default_value = 30.0
    links.new(wave.outputs["Fac"], displacement.inputs["Height"])
    links.new(nodes.new("ShaderNodeBsdfDiffuse").outputs[0], nodes["Material Output"].inputs["Surface"])
    links.new(displacement.outputs[0], nodes["Material Output"].inputs["Displacement"])
    return made


def plane(size: float, location: tuple[float, float, float], of: Any = None) -> None:
    bpy.ops.mesh.primitive_plane_add(size=size, location=location)
    if of is not None:
        bpy.context.object.data.materials.append(of)


CASES: dict[str, tuple[Callable[[], Any] | None, list[tuple[float, Callable[[], Any]]]]] = {
    "holdout": (None, [(1.0, holdout)]),
    "transparent depth": (None, [(1.0, lambda: mixed("Counted", "Transparent Depth", 0.5))]),
    "second transparent depth": (
        None, [(height, lambda: mixed("Counted", "Transparent Depth", 0.5)) for height in (1.0, 1.5)],
    ),
    "ray depth": (None, [(1.0, lambda: mixed("Counted", "Ray Depth", 0.5))]),
    "length of shadow rays": (
        None, [(1.0, lambda: mixed("Counted", "Is Camera Ray", 2.0)), (2.0, lambda: mixed("Far", "Ray Length", 1.5))],
    ),
    "length": (lengths, [(height, lambda: mixed("Clear", "Is Camera Ray", 2.0)) for height in (1.0, 2.0)]),
    "bump": (bumped, []),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_the_picture_is_that_of_cycles(name: str, blender: Any, tmp_path: Path) -> None:
    floor, blockers = CASES[name]
    scene = empty_scene()
    scene.camera.location, scene.camera.data.lens = (0.0, 0.0, 6.0), 30.0
    scene.camera.data.clip_start = 0.5
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 24, 24, 100
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.rotation_euler = 3.0, (0.5, 0.2, 0.0)
    scene.collection.objects.link(sun)
    plane(6.0, (0.0, 0.0, 0.0), None if floor is None else floor())
    for height, of in blockers:
        plane(2.0, (0.0, 0.5, height), of())
        # Else the camera would see little but them.
        bpy.context.object.visible_camera = name in ("holdout", "length")
    scene.cycles.sample_clamp_indirect = 0.0
    (ours, _), (theirs, _) = render_both(scene, tmp_path, 64)
    name_of_red = next(channel for channel in ours if channel.endswith("Combined.R"))
    cells = [image[name_of_red].reshape(6, 4, 6, 4).mean(axis=(1, 3)) for image in (ours, theirs)]
    assert cells[1].max() > 1.3 * cells[1].min() + 0.01, "there is something to see"
    np.testing.assert_allclose(cells[0], cells[1], rtol=0.05, atol=0.02 * cells[1].max())
    assert cells[0].mean() == pytest.approx(cells[1].mean(), rel=0.015)
