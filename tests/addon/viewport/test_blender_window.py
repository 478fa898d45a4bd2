# SPDX-License-Identifier: GPL-3.0-or-later
"""Debian's Blender 3.4 with a real window, under Xvfb with software GL: what it draws, and what it leaves behind."""

from __future__ import annotations

import json
import shutil
import subprocess
from typing import Any

import numpy as np
import pytest

from tests.helpers.blender_profile import installed

BLENDER = shutil.which("blender")
NEEDED = ("Xvfb", "xvfb-run", "import", "convert")

#: Run by Blender in its window. A white plane without shading fills the camera's view, then turns red.
DRIVE = """
import bpy, json, os, signal, subprocess, sys, time, traceback

folder = sys.argv[-1]
found = {}

def shot(name):
    subprocess.run(["import", "-window", "root", os.path.join(folder, name + ".png")], check=True)

def processes():
    for entry in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{entry}/stat") as stat, open(f"/proc/{entry}/cmdline") as command:
                if int(stat.read().rpartition(")")[2].split()[1]) == os.getpid():
                    if "processes/__main__" in command.read():
                        yield int(entry)
        except OSError:
            pass

def children():
    return len(list(processes()))

def paint(color):
    tree = bpy.data.materials["Paint"].node_tree
    tree.nodes["Emission"].inputs["Color"].default_value = color

def steps():
    scene = bpy.context.scene
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item)
    bpy.ops.mesh.primitive_plane_add(size=100.0)
    material = bpy.data.materials.new("Paint")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    emission, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(emission.outputs[0], output.inputs[0])
    bpy.context.object.data.materials.append(material)
    paint((0.2, 0.2, 0.2, 1.0))
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0.0, 0.0, 5.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "NEURALGUIDE"
    scene.view_settings.view_transform = "Standard"
    scene.cycles.preview_samples = 2
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    space = area.spaces.active
    space.overlay.show_overlays = False
    space.show_gizmo = False
    bpy.ops.wm.save_as_mainfile(filepath=os.path.join(folder, "scene.blend"))
    space.region_3d.view_perspective = "CAMERA"
    space.shading.type = "RENDERED"
    region = next(region for region in area.regions if region.type == "WINDOW")
    found["middle"] = [region.x + region.width // 2, window.height - region.y - region.height // 2]
    yield from until("grey")
    paint((1.0, 0.0, 0.0, 1.0))
    yield from until("red")
    os.kill(next(processes()), signal.SIGKILL)
    yield 1.5
    shot("killed")
    found["after kill"] = children()
    paint((0.0, 0.0, 1.0, 1.0))
    yield from until("blue")
    found["rendered"] = children()
    space.shading.type = "SOLID"
    yield 1.0
    found["solid"] = children()
    scene.render.engine = "CYCLES"
    yield 1.5
    found["other engine"] = children()
    scene.render.engine = "NEURALGUIDE"
    space.shading.type = "RENDERED"
    yield 1.0
    found["again"] = list(processes())
    bpy.ops.wm.open_mainfile(filepath=os.path.join(folder, "scene.blend"), load_ui=False)

def until(name):
    # Long, for the sake of kernels that have to be compiled; what is seen decides.
    for _ in range(120):
        yield 0.5
        shot(name)
        if looks(name):
            return

def looks(name):
    x, y = found["middle"]
    text = subprocess.run(
        ["convert", os.path.join(folder, name + ".png"), "-crop", f"9x9+{x - 4}+{y - 4}", "-resize", "1x1!",
         "-depth", "8", "rgb:-"], capture_output=True, check=True,
    ).stdout
    found[name] = list(text[:3])
    wanted = {"grey": (124, 124, 124), "red": (255, 0, 0), "blue": (0, 0, 255)}[name]
    return max(abs(a - b) for a, b in zip(text, wanted)) <= 6

def after():
    found["reloaded"] = list(processes())
    import addon_utils
    addon_utils.disable("neuralguide")
    found["disabled"] = children()
    end()

def end():
    with open(os.path.join(folder, "found.json"), "w") as file:
        json.dump(found, file)
    bpy.ops.wm.quit_blender()

def run():
    try:
        return next(generator)
    except StopIteration:
        return None
    except BaseException:
        found["error"] = traceback.format_exc()
        end()

@bpy.app.handlers.persistent
def loaded(*_):
    if "again" in found:
        bpy.app.timers.register(after, first_interval=1.0)

generator = steps()
bpy.app.handlers.load_post.append(loaded)
bpy.app.timers.register(run, first_interval=1.0)
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BLENDER is None, reason="no blender binary; .ci/run installs Debian's"),
    pytest.mark.skipif(
        not all(map(shutil.which, NEEDED)), reason="no Xvfb or ImageMagick; .ci/run installs Debian's"
    ),
]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a Blender with a window has seen of itself."""
    folder = tmp_path_factory.mktemp("window")
    environment = installed(str(BLENDER), folder)
    code = "import bpy; bpy.context.preferences.view.show_splash = False; bpy.ops.wm.save_userpref()"
    subprocess.run([str(BLENDER), "-b", "--python-expr", code], check=True, capture_output=True, env=environment)
    (folder / "drive.py").write_text(DRIVE)
    environment |= {"PWD": str(folder), "LIBGL_ALWAYS_SOFTWARE": "1"}
    command = ["xvfb-run", "-a", "-s", "-screen 0 640x480x24", "blender", "--window-geometry", "0", "0", "640", "480"]
    done = subprocess.run(
        [*command, "-P", str(folder / "drive.py"), "--", str(folder)], cwd=folder, env=environment,
        capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    result = folder / "found.json"
    assert result.is_file(), done.stdout + done.stderr
    seen = json.loads(result.read_text())
    assert "error" not in seen, seen["error"]
    return seen


def test_the_window_shows_the_scene_and_its_edits(found: dict[str, Any]) -> None:
    """Emission of 0.2 in sRGB is 124; the process that was killed is followed by one that shows the next edit."""
    for name, color in (("grey", (124, 124, 124)), ("red", (255, 0, 0)), ("blue", (0, 0, 255))):
        assert np.abs(np.subtract(found[name], color)).max() <= 6, found


def test_processes_end_with_what_they_are_for(found: dict[str, Any]) -> None:
    assert found["after kill"] == 0
    assert found["rendered"] == len(found["again"]) == 1
    assert found["solid"] == 1, "one is kept for the next window"
    assert found["other engine"] == found["disabled"] == 0
    # The window stays as it was over the other file, and has a process of its own again.
    assert not set(found["again"]) & set(found["reloaded"])
