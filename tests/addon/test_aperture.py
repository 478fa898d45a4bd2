# SPDX-License-Identifier: GPL-3.0-or-later
"""The shape of what is out of focus, beside Cycles: a polygon's sides, how it is turned, and how wide it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.blender_scenes import empty_scene
from tests.helpers.pass_scenes import render_both


@pytest.mark.parametrize("blades, rotation, ratio", [(3, 0.0, 1.0), (3, 0.4, 1.6), (5, 0.2, 1.0), (6, 0.0, 0.7)])
def test_the_polygon_lies_as_in_cycles(
    blades: int, rotation: float, ratio: float, blender: Any, tmp_path: Path
) -> None:
    bpy = blender
    scene = empty_scene()
    scene.render.resolution_x = scene.render.resolution_y = 32
    scene.render.resolution_percentage = 100
    lens = scene.camera.data
    lens.dof.use_dof = True
    lens.dof.focus_distance, lens.dof.aperture_fstop = 1.0, 0.2
    lens.dof.aperture_blades, lens.dof.aperture_rotation, lens.dof.aperture_ratio = blades, rotation, ratio
    bpy.ops.mesh.primitive_plane_add(size=0.05, location=(0.0, 0.0, -3.0))
    glow = bpy.data.materials.new("Glow")
    if glow.node_tree is None:
        glow.use_nodes = True
    nodes, links = glow.node_tree.nodes, glow.node_tree.links
    nodes.clear()
    emission, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    emission.inputs["Strength"].default_value = 1000.0
    links.new(emission.outputs[0], output.inputs["Surface"])
    bpy.context.object.data.materials.append(glow)
    scene.cycles.sample_clamp_direct = 0.0
    (ours, _), (theirs, _) = render_both(scene, tmp_path, 1024)
    red = next(name for name in ours if name.endswith("Combined.R"))
    cells = [image[red].reshape(8, 4, 8, 4).mean(axis=(1, 3)) for image in (ours, theirs)]
    assert cells[1].max() > 0.0
    lit = [cell > 0.2 * cell.max() for cell in cells]
    assert (lit[0] != lit[1]).sum() <= 2
    # Turned by half a side, sides would be where corners are.
    assert np.abs(cells[0] - cells[1]).sum() < 0.15 * cells[1].sum()
