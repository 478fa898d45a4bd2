# SPDX-License-Identifier: GPL-3.0-or-later
"""The export inside a Blender 3.x binary, where there is one: other names, other calls, the same description."""

from __future__ import annotations

import json
import os
import shutil
import site
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

_SCRIPT = '''
import json, sys
sys.path.insert(0, {root!r})
import bpy
from addon.export import export_scene
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
scene.collection.objects.link(scene.camera)
mesh = bpy.data.meshes.new("Roof")
mesh.from_pydata([(0, 0, 0), (1, 0, 1), (1, 1, 1), (0, 1, 0), (2, 0, 0), (2, 1, 0)], [], [(0, 1, 2, 3), (1, 4, 5, 2)])
mesh.polygons.foreach_set("use_smooth", [True, True])
layer = mesh.uv_layers.new(name="UV")
for loop in mesh.loops:
    layer.data[loop.index].uv = mesh.vertices[loop.vertex_index].co[:2]
item = bpy.data.objects.new("Roof", mesh)
scene.collection.objects.link(item)
material = bpy.data.materials.new("Old")
material.use_nodes = True
node = material.node_tree.nodes["Principled BSDF"]
node.inputs["Clearcoat"].default_value = 0.4
node.inputs["Emission"].default_value = (0.0, 1.0, 0.0, 1.0)
material.cycles.use_transparent_shadow = False
mesh.materials.append(material)
plain = bpy.data.materials.new("Plain")
plain.diffuse_color = (1.0, 0.5, 0.25, 1.0)
mesh.materials.append(plain)
bpy.ops.object.text_add()
bpy.ops.object.light_add(type="AREA")
bpy.context.object.data.cycles.cast_shadow = False
bpy.context.object.data.update_tag()  # Blender 3 does not notice an add-on's property.
scene.world = bpy.data.worlds.new("World")
scene.world.color = (0.1, 0.2, 0.3)
mesh.use_auto_smooth = {auto_smooth}
mesh.auto_smooth_angle = 0.5
description = export_scene(bpy.context.evaluated_depsgraph_get())
roof, text = description.meshes
graph = description.materials[0].graph
print("RESULT" + json.dumps(dict(
    normals=roof.corner_normals.reshape(-1, 3).tolist(),
    points=roof.vertices[roof.triangles.reshape(-1)].tolist(),
    uv=roof.attributes["UV"].data.tolist(),
    default_uv=roof.default_uv,
    text_triangles=len(text.triangles),
    inputs=graph.nodes[graph.surface.node].inputs,
    plain=description.materials[1].graph.nodes[0].inputs["Color"],
    transparent_shadow=description.materials[0].use_transparent_shadow,
    cast_shadow=description.lights[0].cast_shadow,
    world=[description.world.graph is None, *description.world.color],
    notices=len(description.notices),
)))
'''


@pytest.fixture(scope="module")
def blender3() -> str:
    """Path of a Blender 3 binary."""
    binary = shutil.which("blender")
    if binary is None:
        pytest.skip("no blender binary here")
    # With our environment, not that which bpy has set behind Python's back: its colours are none of Blender 3's.
    environment = dict(os.environ)
    command = [binary, "-b", "--factory-startup", "--python-expr", "import sys; print('PYTHON', *sys.version_info[:2])"]
    said = subprocess.run(command, capture_output=True, text=True, env=environment).stdout
    if "Blender 3." not in said:
        pytest.skip("the blender binary here is no Blender 3")
    if f"PYTHON {sys.version_info.major} {sys.version_info.minor}" not in said:
        pytest.skip("Blender 3's Python is not ours, so that it cannot use our packages")
    return binary


@pytest.mark.parametrize("auto_smooth", [False, True])
def test_export_in_blender_3(blender3: str, tmp_path: Path, auto_smooth: bool) -> None:
    script = tmp_path / "export.py"
    root = Path(__file__).resolve().parents[3]
    script.write_text(_SCRIPT.format(root=str(root), auto_smooth=auto_smooth))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(site.getsitepackages())}
    command = [blender3, "-b", "--python-use-system-env", "--factory-startup", "--python", str(script)]
    run = subprocess.run(command, capture_output=True, text=True, env=environment)
    lines = [line for line in run.stdout.splitlines() if line.startswith("RESULT")]
    assert lines, run.stdout + run.stderr
    result: dict[str, Any] = json.loads(lines[0].removeprefix("RESULT"))

    normals, points = np.array(result["normals"]), np.array(result["points"])
    ridge = points[:, 0] == 1.0
    if auto_smooth:
        assert (np.abs(normals[ridge][:, 0]) > 0.7).all()
    else:
        np.testing.assert_allclose(normals[ridge], [(0.0, 0.0, 1.0)] * int(ridge.sum()), atol=1e-3)
    np.testing.assert_allclose(result["uv"], points[:, :2], atol=1e-6)
    assert result["default_uv"] == "UV" and result["text_triangles"] > 10
    assert result["inputs"]["Coat Weight"] == pytest.approx(0.1) and result["inputs"]["Coat IOR"] == 1.5
    assert result["inputs"]["Emission Color"] == [0.0, 1.0, 0.0, 1.0]
    assert "Clearcoat" not in result["inputs"] and "Specular IOR Level" in result["inputs"]
    assert result["plain"] == [1.0, 0.5, 0.25, 1.0]
    assert result["transparent_shadow"] is False and result["cast_shadow"] is False
    assert result["world"] == pytest.approx([True, 0.1, 0.2, 0.3]) and result["notices"] == 0
