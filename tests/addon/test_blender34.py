# SPDX-License-Identifier: GPL-3.0-or-later
"""Debian's Blender 3.4, the real binary, with the add-on enabled as a user of it would have it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from tests.helpers.blender_profile import installed

ROOT = Path(__file__).resolve().parents[2]
BLENDER = shutil.which("blender")

#: Run by Blender 3.4: files saved by 5.0 do not open there, the other way round they do.
BUILD_SCENE = """
import bpy, sys
bpy.ops.wm.read_homefile(use_empty=True)
scene = bpy.context.scene

def material(name, **inputs):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    for key, value in inputs.items():
        shader.inputs[key.replace("_", " ")].default_value = value
    return made, shader

def add(operator, surface, **arguments):
    operator(**arguments)
    bpy.context.object.data.materials.append(surface)

floor, shader = material("Floor", Roughness=0.6)
checker = floor.node_tree.nodes.new("ShaderNodeTexChecker")
checker.inputs["Scale"].default_value = 6.0
floor.node_tree.links.new(checker.outputs["Color"], shader.inputs["Base Color"])
add(bpy.ops.mesh.primitive_plane_add, floor, size=10.0)
add(bpy.ops.mesh.primitive_cube_add, material("Paint", Base_Color=(0.8, 0.2, 0.1, 1.0), Roughness=0.4)[0],
    size=1.4, location=(-1.0, 0.3, 0.7), rotation=(0.0, 0.0, 0.5))
add(bpy.ops.mesh.primitive_uv_sphere_add, material("Metal", Metallic=1.0, Roughness=0.3)[0],
    radius=0.8, location=(1.0, 0.0, 0.8))
bpy.ops.object.shade_smooth()

def link(name, data, location, rotation):
    item = bpy.data.objects.new(name, data)
    item.location, item.rotation_euler = location, rotation
    scene.collection.objects.link(item)
    return item

area = bpy.data.lights.new("Area", "AREA")
area.energy, area.size = 250.0, 1.5
link("Area", area, (1.5, -2.0, 4.0), (0.45, 0.3, 0.0))
point = bpy.data.lights.new("Point", "POINT")
point.energy, point.shadow_soft_size, point.color = 60.0, 0.2, (0.4, 0.6, 1.0)
link("Point", point, (-3.0, -1.0, 2.0), (0.0, 0.0, 0.0))
scene.world = bpy.data.worlds.new("World")
scene.world.use_nodes = True
scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.1, 0.12, 0.15, 1.0)
scene.camera = link("Camera", bpy.data.cameras.new("Camera"), (0.0, -7.0, 3.0), (1.2, 0.0, 0.0))
render = scene.render
render.resolution_x, render.resolution_y, render.resolution_percentage = 64, 48, 100
render.filepath = "//out_"
render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
render.image_settings.color_depth = "32"
scene.neuralguide.samples = 64
scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
scene.neuralguide.seed = 1
# Variances below are those of paths that find all light themselves.
scene.neuralguide.radiance_cache = "OFF"
scene.view_layers[0].neuralguide.use_pass_variance = True
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[-1])
"""

pytestmark = pytest.mark.skipif(BLENDER is None, reason="no blender binary; .ci/run installs Debian's")


def channels(path: Path) -> dict[str, np.ndarray]:
    """Single channels by the end of their names: 'Combined.R'; 3.4 writes one part, 5.0 several."""
    found = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            for name, channel in part.channels.items():
                found[".".join(name.split(".")[-2:])] = np.array(channel.pixels, np.float64)
    return found


def image(path: Path, name: str, letters: str = "RGB") -> np.ndarray:
    found = channels(path)
    return np.stack([found[f"{name}.{letter}"] for letter in letters], axis=-1)


@pytest.fixture(scope="module")
def profile(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Environment of a user of Blender 3.4 who has installed and enabled the add-on."""
    return installed(str(BLENDER), tmp_path_factory.mktemp("profile"))


def run(command: list[str], folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run in `folder`; Blender believes PWD rather than the operating system."""
    return subprocess.run(
        command, cwd=folder, env=environment | {"PWD": str(folder)}, capture_output=True, text=True, timeout=900
    )


@pytest.mark.slow
def test_the_literal_command_renders_what_bpy_renders(profile: dict[str, str], tmp_path: Path) -> None:
    """Means over 8 x 8 pixel cells differ by no more than their noise allows: |z| < 5 in all of 144, so that chance
    fails the test once in 10,000 runs; and the root mean square of z is near 1."""
    (tmp_path / "build.py").write_text(BUILD_SCENE)
    scene = tmp_path / "scene.blend"
    built = run(["blender", "-b", "--python-exit-code", "1", "-P", "build.py", "--", str(scene)], tmp_path, profile)
    assert built.returncode == 0, built.stdout + built.stderr

    old = run(["blender", "-b", "scene.blend", "-E", "NEURALGUIDE", "-f", "1"], tmp_path, profile)
    assert old.returncode == 0 and "Traceback" not in old.stdout + old.stderr, old.stdout + old.stderr
    ours = tmp_path / "out_0001.exr"
    assert ours.is_file(), old.stdout + old.stderr
    ours = ours.rename(tmp_path / "blender34.exr")

    code = (
        "import sys, bpy, addon; addon.register(); bpy.ops.wm.open_mainfile(filepath=sys.argv[1]); "
        "bpy.context.scene.neuralguide.seed = 2; bpy.context.scene.render.engine = 'NEURALGUIDE'; "
        "bpy.context.scene.render.filepath = sys.argv[2]; bpy.ops.render.render(write_still=True)"
    )
    new = run([sys.executable, "-c", code, str(scene), str(tmp_path / "bpy.exr")], ROOT, dict(os.environ))
    assert new.returncode == 0, new.stderr

    first, second = image(ours, "Combined"), image(tmp_path / "bpy.exr", "Combined")
    assert first.shape == second.shape == (48, 64, 3)
    assert first.mean() > 0.02
    variance = image(ours, "Variance") + image(tmp_path / "bpy.exr", "Variance")

    def cells(pixels: np.ndarray) -> np.ndarray:
        return pixels.reshape(6, 8, 8, 8, 3).sum(axis=(1, 3))

    # Where only the even background is seen there is no variance but that of float32.
    z = cells(first - second) / np.sqrt(cells(variance + (1e-6 * first) ** 2))
    assert np.abs(z).max() < 5.0, z
    assert np.sqrt(np.mean(z**2)) < 1.35
    assert np.abs(first - second).max() > 0.0, "two seeds gave one image"


def test_an_error_is_a_sentence_in_the_real_binary_too(profile: dict[str, str], tmp_path: Path) -> None:
    code = (
        "import bpy; bpy.ops.wm.read_homefile(use_empty=True); "
        f"bpy.ops.wm.save_as_mainfile(filepath={str(tmp_path / 'empty.blend')!r})"
    )
    assert run(["blender", "-b", "--python-expr", code], tmp_path, profile).returncode == 0
    done = run(["blender", "-b", "empty.blend", "-E", "NEURALGUIDE", "-o", "//x_", "-f", "1"], tmp_path, profile)
    output = done.stdout + done.stderr
    assert "camera" in output.lower()
    assert "Traceback" not in output


def test_the_preferences_are_those_of_the_add_on_that_was_enabled(profile: dict[str, str], tmp_path: Path) -> None:
    code = (
        "import bpy; preferences = bpy.context.preferences.addons['neuralguide'].preferences; "
        "assert not bpy.types.NEURALGUIDE_PT_experiments.poll(bpy.context); "
        "preferences.show_experiments = True; bpy.context.scene.render.engine = 'NEURALGUIDE'; "
        "assert bpy.types.NEURALGUIDE_PT_experiments.poll(bpy.context)"
    )
    done = run(["blender", "-b", "--python-exit-code", "1", "--python-expr", code], tmp_path, profile)
    assert done.returncode == 0, done.stdout + done.stderr
