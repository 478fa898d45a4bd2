# SPDX-License-Identifier: GPL-3.0-or-later
"""Working spaces that a configuration of OpenColorIO has; those of Blender's own are tested with images."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

_IN_ANOTHER_SPACE = """
import bpy
from tests.helpers.blender_scenes import empty_scene, export
empty_scene()
assert bpy.data.colorspace.working_space == "Linear DCI-P3 D65"
world = bpy.context.scene.world = bpy.data.worlds.new("World")
world.use_nodes = True
node = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
world.node_tree.links.new(node.outputs[0], world.node_tree.nodes["Background"].inputs[0])
node.image = bpy.data.images.new("Red", 1, 1)
node.image.pixels.foreach_set([1.0, 0.0, 0.0, 1.0])
node.image.update()
description = export()
assert not description.notices, description.notices
print("COLOUR", *description.images[0].pixels[0, 0], *description.to_xyz[1])
"""


def test_working_space_of_a_configuration(tmp_path: Path) -> None:
    """A user's own configuration of OpenColorIO (variable OCIO) may work in any space."""
    folder = Path(bpy.utils.system_resource("DATAFILES", path="colormanagement"))
    text = (folder / "config.ocio").read_text("utf-8").replace("_linear: Linear Rec.709", "_linear: Linear DCI-P3 D65")
    folders = [folder, *(path for path in folder.iterdir() if path.is_dir())]
    lines = [line for line in text.splitlines() if not line.startswith("search_path")]
    lines.insert(1, f"search_path: \"{':'.join(map(str, folders))}\"")
    (tmp_path / "config.ocio").write_text("\n".join(lines), "utf-8")
    environment = {**os.environ, "OCIO": str(tmp_path / "config.ocio")}
    command = [sys.executable, "-c", _IN_ANOTHER_SPACE]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    line = next(line for line in result.stdout.splitlines() if line.startswith("COLOUR"))
    numbers = np.array(line.split()[1:], np.float64)
    # Red of Rec.709 in P3 under D65, and the luminances of P3's primaries (SMPTE EG 432-1).
    np.testing.assert_allclose(numbers[:4], (0.8225, 0.0332, 0.0171, 1.0), atol=2e-4)
    np.testing.assert_allclose(numbers[4:], (0.2290, 0.6917, 0.0793), atol=2e-4)
