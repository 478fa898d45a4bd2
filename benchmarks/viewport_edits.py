# SPDX-License-Identifier: GPL-3.0-or-later
"""How long it is from an edit in Blender to its picture: a viewport's view without a window, and real edits."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from engine.viewport.protocol import DEAD, DONE, FAILED, ViewImage

_PATIENCE = 300.0


class NoCanvas:
    """Takes pictures, and draws none."""

    def __init__(self) -> None:
        self.image: ViewImage | None = None
        self.is_empty = True

    def take(self, image: ViewImage) -> None:
        """Keep a picture."""
        self.image = image

    def draw(self, _engine: Any, _scene: Any) -> None:
        """Draw nothing."""


class EditedWindow:
    """A window's view through the scene's camera, told by Blender of every edit.

    Parameters
    ----------
    width, height : int [pixels]
    """

    def __init__(self, width: int, height: int) -> None:
        import bpy

        from addon.viewport.window_view import WindowView

        self._canvas = NoCanvas()
        self._view = WindowView(self._canvas)  # type: ignore[arg-type]
        self._engine = SimpleNamespace(update_stats=lambda *_: None)
        camera = bpy.context.scene.camera
        depsgraph = bpy.context.evaluated_depsgraph_get()
        projection = camera.evaluated_get(depsgraph).calc_matrix_camera(depsgraph, x=width, y=height)
        region_3d = SimpleNamespace(
            window_matrix=np.array(projection, np.float32),
            view_matrix=np.array(camera.matrix_world.inverted(), np.float32),
            view_perspective="PERSP", is_perspective=camera.data.type != "ORTHO",
        )  # fmt: skip
        space = next(
            area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D"
        )
        space.shading.use_scene_lights_render = space.shading.use_scene_world_render = True
        self._context: Any = SimpleNamespace(
            region=SimpleNamespace(width=width, height=height), space_data=space, region_data=region_3d
        )
        bpy.app.handlers.depsgraph_update_post.append(self._updated)

    def close(self) -> None:
        """End the process."""
        import bpy

        from addon.viewport import host

        bpy.app.handlers.depsgraph_update_post.remove(self._updated)
        self._view.close()
        host.close_all()

    def _updated(self, _scene: Any, depsgraph: Any) -> None:
        self._view.update(depsgraph)

    @property
    def process(self) -> Any:
        """The process's handle."""
        return self._view.host.process

    def picture_after(self, edit: Callable[[], None]) -> tuple[float, float]:
        """Edit, and wait for the picture: seconds until it was sent, and until its first picture was there."""
        import bpy

        started = time.perf_counter()
        before = self.process.sent
        edit()
        bpy.context.view_layer.update()
        self._draw()
        sent = time.perf_counter() - started
        assert self.process.sent > before or self.process.is_waiting, "the edit changes nothing"
        number = self.process.sent
        while self._canvas.image is None or self._canvas.image.update < max(number, before + 1):
            if self.process.status.state in (DEAD, FAILED) or time.perf_counter() - started > _PATIENCE:
                raise RuntimeError(f"no picture: {self.process.status}")
            time.sleep(0.002)
            if self._view.tick()[0]:
                self._draw()
        return sent, time.perf_counter() - started

    def _draw(self) -> None:
        import bpy

        self._view.draw(self._engine, self._context, bpy.context.evaluated_depsgraph_get())  # type: ignore[arg-type]

    def settle(self, seconds: float) -> None:
        """Let it render, and learn."""
        until = time.perf_counter() + seconds
        while time.perf_counter() < until and self.process.status.state != DONE:
            if self._view.tick()[0]:
                self._draw()
            time.sleep(0.01)


def edits_of(scene: Any) -> dict[str, Callable[[int], None]]:
    """Edits of a scene, by kind; each takes a number that makes it another one."""
    meshes = [item for item in scene.objects if item.type == "MESH" and len(item.data.polygons) > 0]
    largest = max(meshes, key=lambda item: len(item.data.polygons))
    lamps = [item for item in scene.objects if item.type == "LIGHT"]
    found: dict[str, Callable[[int], None]] = {}

    def move(number: int) -> None:
        largest.location.z += 0.001 * (number + 1)

    def reshape(number: int) -> None:
        largest.data.vertices[0].co.x += 0.001 * (number + 1)
        largest.data.update()

    for item in meshes:
        sockets = [
            socket for slot in item.material_slots if slot.material is not None and slot.material.node_tree is not None
            for node in slot.material.node_tree.nodes for socket in node.inputs
            if socket.name in ("Base Color", "Color") and socket.type == "RGBA" and not socket.is_linked
            and node.type.startswith("BSDF")
        ]  # fmt: skip
        if sockets:
            socket = sockets[0]

            def paint(number: int, socket: Any = socket) -> None:
                socket.default_value[0] = 0.2 + 0.01 * number

            found["material"] = paint
            break
    if lamps:
        lamp = lamps[0].data

        def brighten(_number: int) -> None:
            lamp.energy *= 1.01

        found["light"] = brighten
    return found | {"transform": move, "mesh": reshape}


def measure_edits(scene: Any, width: int, height: int, count: int) -> dict[str, float]:
    """From an edit to its picture, by kind: the first of a kind, and the median of those after it [ms]."""
    window = EditedWindow(width, height)
    figures: dict[str, float] = {}
    window.picture_after(lambda: None)
    window.settle(3.0)
    for kind, edit in edits_of(scene).items():
        found = []
        for number in range(count + 1):
            found.append(window.picture_after(partial(edit, number)))
            window.settle(0.5)
        first, *others = found
        figures[f"{kind} edited, first [ms]"] = 1e3 * first[1]
        figures[f"{kind} edited, later ones [ms]"] = 1e3 * statistics.median(total for _, total in others)
        figures[f"{kind} edited, of these until sent [ms]"] = 1e3 * statistics.median(sent for sent, _ in others)
    window.close()
    return figures
