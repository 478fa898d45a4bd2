# SPDX-License-Identifier: GPL-3.0-or-later
"""How soon a viewport answers, and what it leaves behind: drives the process as a window would, without a window."""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scene_files import SceneSource, open_scene
from benchmarks.viewport_edits import measure_edits
from engine.scene.description import SceneDescription
from engine.settings import RenderSettings
from engine.viewport.handle import ViewProcess
from engine.viewport.protocol import DEAD, DONE, FAILED, ViewImage
from engine.viewport.view import Plane, Update, View

#: Between two updates of a view that turns [s], as a window that is drawn 60 times a second sends them.
_FRAME_SECONDS = 1.0 / 60.0
_PATIENCE = 300.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("scene", nargs="?", default="builtin:evening-room", help="default: %(default)s")
    parser.add_argument("--width", type=int, default=960, help="of the window (default: %(default)s)")
    parser.add_argument("--height", type=int, default=540, help="of the window (default: %(default)s)")
    parser.add_argument("--moves", type=int, default=20, help="of the camera (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=5.0, help="of turning (default: %(default)s)")
    parser.add_argument("--restarts", type=int, default=200, help="for memory (default: %(default)s)")
    parser.add_argument("--edits", type=int, default=50, help="for memory (default: %(default)s)")
    parser.add_argument(
        "--edits-of-a-kind", type=int, default=5, help="for the time to a picture (default: %(default)s)"
    )
    parser.add_argument("--out", type=Path, default=Path("out/viewport.json"), help="default: %(default)s")


class Window:
    """A window of a size, whose camera can be turned about the scene's origin."""

    def __init__(self, description: SceneDescription, width: int, height: int) -> None:
        self.process = ViewProcess()
        self.scene = description
        self._width, self._height = width, height

    def view(self, angle: float = 0.0) -> View:
        """What is seen from the scene's camera, turned by an angle [rad]."""
        camera = self.scene.camera
        turn = np.eye(4, dtype=np.float32)
        turn[0, 0] = turn[1, 1] = math.cos(angle)
        turn[0, 1], turn[1, 0] = -math.sin(angle), math.sin(angle)
        half, up = 0.5 * camera.sensor_width / camera.lens, 0.5 * camera.sensor_height / camera.lens
        is_vertical = camera.sensor_fit == "VERTICAL"
        if camera.sensor_fit == "AUTO" and self._height > self._width:
            is_vertical, up = True, half
        if is_vertical:
            half = up * self._width / self._height
        else:
            up = half * self._height / self._width
        longest = 2.0 * (up if is_vertical else half)
        x, y = longest * camera.shift_x, longest * camera.shift_y
        plane = Plane(x - half, x + half, y - up, y + up)
        region = (0, 0, self._width, self._height)
        moved = replace(camera, transform=(turn @ camera.transform).astype(np.float32))
        return View(moved, plane, self._width, self._height, region, self.scene.frame.exposure)

    def first_picture(self, update: Update) -> tuple[float, ViewImage]:
        """Send an update, wait for its first picture; the time that took [s]."""
        started = time.perf_counter()
        self.process.send(update)
        while True:
            image = self.next_picture(started)
            if image.update >= self.process.sent:
                return time.perf_counter() - started, image

    def next_picture(self, started: float) -> ViewImage:
        """Wait for a picture, as often as a window's timer looks or more.

        Raises
        ------
        RuntimeError
            If none comes.
        """
        while True:
            status = self.process.poll()
            image = self.process.read_image()
            if image is not None:
                return image
            if status.state in (DEAD, FAILED) or time.perf_counter() - started > _PATIENCE:
                raise RuntimeError(f"no picture: {status}")
            time.sleep(0.002)

    def settle(self, seconds: float) -> None:
        """Let it render."""
        until = time.perf_counter() + seconds
        while time.perf_counter() < until and self.process.poll().state != DONE:
            self.process.read_image()
            time.sleep(0.005)

    def turn(self, seconds: float) -> tuple[float, float]:
        """Turn without a pause; pictures a second, and the mean divider."""
        started = time.perf_counter()
        step = 0
        dividers: list[int] = []
        while time.perf_counter() - started < seconds:
            following = time.perf_counter() + _FRAME_SECONDS
            self.process.send(Update(view=self.view(0.01 * step)))
            step += 1
            while time.perf_counter() < following:
                self.process.poll()
                image = self.process.read_image()
                if image is not None:
                    dividers.append(image.divider)
                time.sleep(0.002)
        return len(dividers) / seconds, statistics.fmean(dividers) if dividers else 0.0


def resident(process: int | str = "self") -> float:
    """Resident memory of a process [MiB] (Linux)."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def processor_seconds(process: int) -> float:
    """Processor time of a process so far [s] (Linux)."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure_memory(window: Window, count: int, change: Callable[[int], Update]) -> dict[str, list[float]]:
    """Memory of process and host after each of many restarts [MiB]: the tenth is what the others are held against."""
    process = window.process
    assert process.process_id is not None
    found: dict[str, list[float]] = {"process": [], "host": []}
    for number in range(count):
        window.first_picture(change(number))
        found["process"].append(resident(process.process_id))
        found["host"].append(resident())
    return found


def growth(values: list[float]) -> float:
    """How much more the last ten take than the tenth: a ratio."""
    return statistics.fmean(values[-10:]) / values[9]


def edited(scene: SceneDescription, number: int) -> SceneDescription:
    """The scene with a lamp, an object or a material changed, by turns."""
    if number % 3 == 0 and scene.lights:
        first = replace(scene.lights[0], energy=scene.lights[0].energy * (1.0 + 0.01 * number))
        return replace(scene, lights=[first, *scene.lights[1:]])
    if number % 3 == 1:
        transform = scene.instances.transform.copy()
        transform[0, 2, 3] += 0.001 * number
        return replace(scene, instances=replace(scene.instances, transform=transform))
    materials = list(scene.materials)
    materials[0] = replace(materials[0], key=("edited", number), pass_index=number)
    return replace(scene, materials=materials)


def dense_scene() -> Any:
    """A new file with 100,000 triangles; returns its scene."""
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=320, ring_count=158)
    paint = bpy.data.materials.new("Paint")
    if paint.node_tree is None:
        paint.use_nodes = True
    bpy.context.object.data.materials.append(paint)
    bpy.ops.mesh.primitive_plane_add(size=20.0, location=(0.0, 0.0, -1.0))
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "AREA"))
    lamp.location, lamp.data.energy, lamp.data.size = (2.0, -2.0, 4.0), 400.0, 2.0
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler = (0.0, -5.0, 1.5), (1.3, 0.0, 0.0)
    for item in (lamp, camera):
        scene.collection.objects.link(item)
    scene.camera = camera
    return scene


def export(scene: Any) -> tuple[SceneDescription, RenderSettings]:
    """The open scene for a viewport."""
    import bpy

    from addon.export import export_scene
    from addon.viewport.settings import preview_settings

    settings = replace(preview_settings(scene), use_adaptive_sampling=False, use_denoising=False)
    return export_scene(bpy.context.evaluated_depsgraph_get()), settings


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """All figures of a scene."""
    scene, settings = export(open_scene(SceneSource(arguments.scene), size=(arguments.width, arguments.height)))
    window = Window(scene, arguments.width, arguments.height)
    process = window.process
    started = time.perf_counter()
    process.start()
    window.first_picture(Update(view=window.view(), scene=scene, settings=settings, is_paused=False))
    figures: dict[str, Any] = {"cold start [s]": time.perf_counter() - started}
    window.settle(3.0)

    moves = []
    for number in range(arguments.moves):
        seconds, image = window.first_picture(Update(view=window.view(0.02 * number + 0.02)))
        moves.append((seconds, image.divider))
        window.settle(0.7)
    times = sorted(seconds for seconds, _ in moves)
    figures["camera move, median [ms]"] = 1e3 * statistics.median(times)
    figures["camera move, slowest [ms]"] = 1e3 * times[-1]
    figures["divider after a move"] = statistics.fmean(divider for _, divider in moves)
    figures["pictures a second while turning"], figures["divider while turning"] = window.turn(arguments.seconds)

    few = replace(settings, samples=1, guiding_method="OFF")
    memory = measure_memory(window, arguments.restarts, lambda number: Update(view=window.view(0.01 * number)))
    figures["memory after the 10th restart [MiB]"] = memory["process"][9]
    figures["memory of the process, last over 10th restart"] = growth(memory["process"])
    figures["memory of the host, last over 10th restart"] = growth(memory["host"])
    memory = measure_memory(window, arguments.edits, lambda number: Update(scene=edited(scene, number + 1)))
    figures["memory of the process, last over 10th edit"] = growth(memory["process"])
    figures["memory of the host, last over 10th edit"] = growth(memory["host"])

    window.first_picture(Update(settings=few, scene=scene))
    window.settle(60.0)
    time.sleep(0.5)
    assert process.process_id is not None
    before = processor_seconds(process.process_id)
    time.sleep(5.0)
    figures["idle, share of a processor"] = (processor_seconds(process.process_id) - before) / 5.0

    dense = dense_scene()
    started = time.perf_counter()
    window.scene, settings = export(dense)
    figures["triangles"] = sum(len(mesh.triangles) for mesh in window.scene.meshes)
    figures["export of a dense scene [s]"] = time.perf_counter() - started
    window.first_picture(Update(view=window.view(), scene=window.scene, settings=settings))
    figures["entering a dense scene, export included [s]"] = time.perf_counter() - started
    process.close()
    return figures | measure_edits(dense, arguments.width, arguments.height, arguments.edits_of_a_kind)


def main(arguments: argparse.Namespace) -> int:
    """Run the command: measure, print, save."""
    import addon

    addon.register()
    figures = measure(arguments)
    for name, value in figures.items():
        print(f"{name:55} {value:10.3f}")
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps({"scene": arguments.scene, **figures}, indent=2))
    return 0
