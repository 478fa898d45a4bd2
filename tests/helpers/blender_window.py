# SPDX-License-Identifier: GPL-3.0-or-later
"""Debian's Blender 3.4 with a real window, under Xvfb with software GL, driven by a script of the test's."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.blender_profile import installed

BLENDER = shutil.which("blender")
_NEEDED = ("Xvfb", "xvfb-run", "import", "convert")

#: For tests that need the window.
NEEDS_WINDOW = [
    pytest.mark.slow,
    pytest.mark.skipif(BLENDER is None, reason="no blender binary; .ci/run installs Debian's"),
    pytest.mark.skipif(
        not all(map(shutil.which, _NEEDED)), reason="no Xvfb or ImageMagick; .ci/run installs Debian's"
    ),
]

#: Comes before a test's script, which has a generator `steps()`: what it yields is how long Blender goes on before the
#: next step [s]. What it puts into `found` is what the test gets.
_PRELUDE = """
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

def color_at(name, x, y):
    return list(subprocess.run(
        ["convert", os.path.join(folder, name + ".png"), "-crop", f"9x9+{x - 4}+{y - 4}", "-resize", "1x1!",
         "-depth", "8", "rgb:-"], capture_output=True, check=True,
    ).stdout[:3])

def until(name, wanted, place):
    # Long, for the sake of kernels that have to be compiled; what is seen decides.
    for _ in range(120):
        yield 0.5
        shot(name)
        found[name] = color_at(name, *place)
        if max(abs(a - b) for a, b in zip(found[name], wanted)) <= 6:
            return

def fill_with_a_plane(size, color):
    scene = bpy.context.scene
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item)
    bpy.ops.mesh.primitive_plane_add(size=size)
    material = bpy.data.materials.new("Paint")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    emission, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(emission.outputs[0], output.inputs[0])
    bpy.context.object.data.materials.append(material)
    paint(color)
    scene.render.engine = "NEURALGUIDE"
    scene.view_settings.view_transform = "Standard"
    return scene

def paint(color):
    tree = bpy.data.materials["Paint"].node_tree
    tree.nodes["Emission"].inputs["Color"].default_value = color

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
"""
_START = """
generator = steps()
bpy.app.timers.register(run, first_interval=1.0, persistent=True)
"""


def run_in_window(folder: Path, script: str) -> dict[str, Any]:
    """What a script has found out in a window of 640 x 480, which it closes by `end()`.

    Parameters
    ----------
    folder : Path
        Empty; screenshots stay there.
    script : str
    """
    environment = installed(str(BLENDER), folder)
    code = "import bpy; bpy.context.preferences.view.show_splash = False; bpy.ops.wm.save_userpref()"
    subprocess.run([str(BLENDER), "-b", "--python-expr", code], check=True, capture_output=True, env=environment)
    (folder / "drive.py").write_text(_PRELUDE + script + _START)
    environment |= {"PWD": str(folder), "LIBGL_ALWAYS_SOFTWARE": "1"}
    command = ["xvfb-run", "-a", "-s", "-screen 0 640x480x24", "blender", "--window-geometry", "0", "0", "640", "480"]
    done = subprocess.run(
        [*command, "-P", str(folder / "drive.py"), "--", str(folder)], cwd=folder, env=environment,
        capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    result = folder / "found.json"
    assert result.is_file(), done.stdout + done.stderr
    found = json.loads(result.read_text())
    assert "error" not in found, found["error"]
    found["code"], found["log"] = done.returncode, done.stdout + done.stderr
    return found
