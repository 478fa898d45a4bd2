# SPDX-License-Identifier: GPL-3.0-or-later
"""What a real window draws, and what it leaves behind."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.helpers.blender_window import NEEDS_WINDOW, run_in_window

pytestmark = NEEDS_WINDOW

#: A white plane without shading fills the camera's view, then turns red.
DRIVE = """
def steps():
    scene = fill_with_a_plane(100.0, (0.2, 0.2, 0.2, 1.0))
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0.0, 0.0, 5.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
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
    yield from until("grey", (124, 124, 124), found["middle"])
    paint((1.0, 0.0, 0.0, 1.0))
    yield from until("red", (255, 0, 0), found["middle"])
    os.kill(next(processes()), signal.SIGKILL)
    yield 1.5
    shot("killed")
    found["after kill"] = children()
    paint((0.0, 0.0, 1.0, 1.0))
    yield from until("blue", (0, 0, 255), found["middle"])
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
    yield 1.0
    found["reloaded"] = list(processes())
    import addon_utils
    addon_utils.disable("neuralguide")
    found["disabled"] = children()
    end()
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a Blender with a window has seen of itself."""
    return run_in_window(tmp_path_factory.mktemp("window"), DRIVE)


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
