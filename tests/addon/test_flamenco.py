# SPDX-License-Identifier: GPL-3.0-or-later
"""The job type for Flamenco: a JavaScript engine compiles jobs by it, and Blender runs the command lines that come out.

Flamenco itself is not here. What a job compiler script is given is written down below as Flamenco 3 documents it.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.blender_profile import installed

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "docs" / "farm" / "neuralguide_render.js"
NODE, BLENDER = shutil.which("node"), shutil.which("blender")
#: What Flamenco's manager gives a script, as far as ours asks for it; then the job, and what became of it.
HARNESS = """
const [, , script, settings] = process.argv;
globalThis.author = {
    Task: (name, type) => ({
        name, type, commands: [], dependencies: [],
        addCommand(command) { this.commands.push(command); },
        addDependency(task) { this.dependencies.push(task.name); },
    }),
    Command: (name, parameters) => ({ name, parameters }),
};
globalThis.frameChunker = (text, size) => {
    const frames = [];
    for (const part of text.split(",")) {
        const [first, last = first] = part.trim().split("-").map(Number);
        for (let frame = first; frame <= last; frame++) frames.push(frame);
    }
    const chunks = [];
    for (let start = 0; start < frames.length; start += size) {
        const chunk = frames.slice(start, start + size), whole = chunk[chunk.length - 1] - chunk[0] + 1;
        const isRange = chunk.length > 1 && whole === chunk.length;
        chunks.push(isRange ? `${chunk[0]}-${chunk[chunk.length - 1]}` : chunk.join(","));
    }
    return chunks;
};
const tasks = [];
const job = { settings: JSON.parse(settings), addTask: task => tasks.push(task) };
const source = require("fs").readFileSync(script, "utf-8");
new Function("job", source + "; compileJob(job); return JOB_TYPE;")(job);
console.log(JSON.stringify({ tasks, type: new Function(source + "; return JOB_TYPE;")() }));
"""

pytestmark = pytest.mark.skipif(NODE is None, reason="no node to run the script")


def compiled(**changes: Any) -> Any:
    """A job of some settings as Flamenco would have it."""
    settings = {
        "frames": "1-4, 7", "chunk_size": 2, "keep_existing": True, "learned_field": "", "format": "OPEN_EXR",
        "blendfile": "/shots/scene.blend", "render_output_path": "/renders/######",
    }
    done = subprocess.run(
        [str(NODE), "-e", HARNESS, "harness", str(SCRIPT), json.dumps(settings | changes)],
        capture_output=True, text=True,
    )  # fmt: skip
    if done.returncode:
        raise ValueError(done.stderr)
    return json.loads(done.stdout)


def frames_of(task: Any) -> str:
    arguments = task["commands"][0]["parameters"]["args"]
    return str(arguments[arguments.index("--render-frame") + 1])


def test_every_setting_has_what_flamenco_asks_for() -> None:
    job_type = compiled()["type"]
    assert job_type["label"]
    for setting in job_type["settings"]:
        assert {"key", "type"} <= setting.keys() and setting["type"] in {"string", "int32", "float", "bool"}
        if "eval" in setting:
            compile(setting["eval"], setting["key"], "eval")


def test_frames_are_independent_without_a_field() -> None:
    tasks = compiled()["tasks"]
    assert [frames_of(task) for task in tasks] == ["1,2", "3,4", "7"]
    assert all(task["type"] == "blender" and not task["dependencies"] for task in tasks)
    assert not any("field" in argument for task in tasks for argument in task["commands"][0]["parameters"]["args"])


def test_the_first_frame_makes_the_field_that_all_others_wait_for() -> None:
    first, *others = compiled(learned_field='/shots/"one".ngfield')["tasks"]
    assert frames_of(first) == "1" and [frames_of(task) for task in others] == ["2,3", "4,7"]
    assert not first["dependencies"] and all(task["dependencies"] == [first["name"]] for task in others)


def test_python_in_the_command_lines_is_python() -> None:
    for task in compiled(learned_field='/shots/"one" \\ two.ngfield')["tasks"]:
        arguments = task["commands"][0]["parameters"]["args"]
        for index, argument in enumerate(arguments):
            if argument == "--python-expr":
                compile(arguments[index + 1], "expression", "exec")


def test_movies_are_refused() -> None:
    with pytest.raises(ValueError, match="renders images"):
        compiled(format="FFMPEG")


BUILD = """
import bpy, sys
bpy.ops.wm.read_homefile(use_empty=True)
scene = bpy.context.scene
bpy.ops.mesh.primitive_plane_add(size=4.0)
light = bpy.data.objects.new("Light", bpy.data.lights.new("Light", "POINT"))
light.location = 0.0, 0.0, 2.0
camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
camera.location = 0.0, 0.0, 5.0
for item in (light, camera):
    scene.collection.objects.link(item)
scene.camera = camera
render = scene.render
render.resolution_x, render.resolution_y, render.resolution_percentage = 32, 32, 100
render.image_settings.file_format = "OPEN_EXR"
scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
ours = scene.neuralguide
ours.guiding_method, ours.samples, ours.guiding_trial = "VMM", 15, False
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[-1])
"""


@pytest.mark.slow
@pytest.mark.skipif(BLENDER is None, reason="no blender binary; .ci/run installs Debian's")
def test_blender_runs_what_comes_out(tmp_path: Path) -> None:
    environment = installed(str(BLENDER), tmp_path / "profile") | {"PWD": str(tmp_path)}

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [str(BLENDER), *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300
        )

    scene, field = tmp_path / "scene.blend", tmp_path / "shot.ngfield"
    built = run("-b", "--python-exit-code", "1", "--python-expr", BUILD, "--", str(scene))
    assert built.returncode == 0, built.stdout + built.stderr
    first, second = compiled(
        frames="1-2", blendfile=str(scene), learned_field=str(field), render_output_path=str(tmp_path / "out_####")
    )["tasks"]

    def perform(task: Any, leave_out: str = "") -> subprocess.CompletedProcess[str]:
        """As Flamenco's worker puts a command line together."""
        parameters = task["commands"][0]["parameters"]
        arguments = list(parameters["args"])
        if leave_out:
            del arguments[arguments.index(leave_out) : arguments.index(leave_out) + 2]
        return run(*parameters["argsBefore"], parameters["blendfile"], *arguments)

    unrendered = perform(second, "--render-frame")
    assert unrendered.returncode == 1 and "not rendered" in unrendered.stdout + unrendered.stderr
    learned = perform(first)
    assert learned.returncode == 0 and field.is_file(), learned.stdout + learned.stderr
    written = field.stat().st_mtime_ns
    followed = perform(second)
    assert followed.returncode == 0 and "started from" in followed.stdout + followed.stderr
    assert field.stat().st_mtime_ns == written
    pictures = sorted(tmp_path.glob("out_*"))
    pictures[1].write_bytes(b"")  # as a worker leaves one that is killed, by another program's placeholder
    assert perform(second).returncode == 0 and pictures[1].stat().st_size > 0
    assert [path.name for path in pictures] == ["out_0001.exr", "out_0002.exr"]
    times = [path.stat().st_mtime_ns for path in pictures]
    again = perform(second)
    assert again.returncode == 0 and [path.stat().st_mtime_ns for path in pictures] == times
