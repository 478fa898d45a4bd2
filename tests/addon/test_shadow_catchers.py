# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow catchers beside Cycles: the picture with and without their pass, on a transparent film and before a world."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.rivals import Budget, find_rival
from tests.helpers.pass_files import ask_for_passes, render_passes


def catching(scene: Any) -> None:
    """The cube over a floor that catches its shadow, under the sun and a grey world; a second cube is seen in it."""
    import bpy

    bpy.ops.mesh.primitive_plane_add(size=12.0, location=(0.0, 0.0, -1.0))
    floor = bpy.context.object
    floor.is_shadow_catcher = True
    scene.objects["Cube"].location = (0.0, 0.0, 0.3)
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.1, 0.1, 0.1)
    scene.objects["Sun"].data.angle = 0.2


def compare(scene: Any, names: list[str], path: Path) -> None:
    """Means of cells of 4 x 4 pixels within 0.01 and 4.5 standard errors of 4 seeds, by the variances of pixels."""
    found: dict[str, dict[str, list[np.ndarray]]] = {name: {"OFF": [], "cycles": []} for name in names}
    for rival in ("OFF", "cycles"):
        for seed in range(4):
            find_rival(rival).configure(scene, Budget(64), seed, 0)
            ask_for_passes(scene)
            for name, image in render_passes(scene, path, names).items():
                found[name][rival].append(image.astype(np.float64))
    for name in names:
        ours, theirs = (np.stack(found[name][rival]) for rival in ("OFF", "cycles"))
        assert theirs[0].std() > 0.01

        def cells(pixels: np.ndarray) -> np.ndarray:
            return pixels.reshape(4, 4, 8, 4, -1).mean(axis=(1, 3))

        difference = cells(ours.mean(axis=0) - theirs.mean(axis=0))
        variance = (ours.var(axis=0, ddof=1) + theirs.var(axis=0, ddof=1)) / 4.0
        error = np.sqrt(cells(variance) / 16.0)
        assert (np.abs(difference) <= 0.01 + 4.5 * error).all(), (name, np.abs(difference).max())


@pytest.mark.parametrize("is_transparent", [True, False])
@pytest.mark.parametrize("has_pass", [True, False])
def test_catchers_are_those_of_cycles(
    cube_scene: Any, tmp_path: Path, is_transparent: bool, has_pass: bool
) -> None:
    scene = cube_scene
    catching(scene)
    scene.render.film_transparent = is_transparent
    scene.view_layers[0].cycles.use_pass_shadow_catcher = has_pass
    compare(scene, ["Combined", *(["Shadow Catcher"] if has_pass else [])], tmp_path / "i.exr")


@pytest.mark.slow
def test_smoke_that_varies_casts_the_shadow_of_cycles_on_a_catcher(cube_scene: Any, tmp_path: Path) -> None:
    scene = cube_scene
    catching(scene)
    import bpy

    smoke = bpy.data.materials.new("Smoke")
    smoke.use_nodes = True
    nodes, links = smoke.node_tree.nodes, smoke.node_tree.links
    nodes.clear()
    output, volume = nodes.new("ShaderNodeOutputMaterial"), nodes.new("ShaderNodeVolumeScatter")
    volume.inputs["Density"].default_value = 1.0
    # Coordinates of a box as they are: denser to one side and to the top, and nothing at all on the other.
    place, middle = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeVectorMath")
    middle.operation, middle.inputs[1].default_value = "DOT_PRODUCT", (1.5, 0.0, 0.5)
    links.new(place.outputs["Object"], middle.inputs[0])
    links.new(middle.outputs["Value"], volume.inputs["Density"])
    links.new(volume.outputs[0], output.inputs["Volume"])
    scene.objects["Cube"].data.materials.clear()
    scene.objects["Cube"].data.materials.append(smoke)
    scene.cycles.volume_bounces = 2
    scene.render.film_transparent = True
    scene.view_layers[0].cycles.use_pass_shadow_catcher = True
    compare(scene, ["Combined", "Shadow Catcher"], tmp_path / "i.exr")
