# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur: transforms and camera at exactly Cycles' times, whoever moves them, and Blender left as it was."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.helpers.blender_scenes import export
from tests.helpers.motion_scenes import add_cube, blurred_scene, curves_of, keyframe, matrix_at, open_shutter


@pytest.fixture
def scene() -> Any:
    return blurred_scene()


def times(length: float, position: str, steps: int, frame: float = 10.0) -> list[float]:
    centre = frame + {"START": 0.5, "CENTER": 0.0, "END": -0.5}[position] * length
    return [centre + 0.5 * length * rel for rel in np.linspace(-1.0, 1.0, 2**steps + 1)]


# ---------------------------------------------------------------------------------------------------------------------
# Times


@pytest.mark.parametrize("position", ["START", "CENTER", "END"])
@pytest.mark.parametrize("steps", [1, 2, 3])
def test_a_cube_is_seen_at_the_times_of_cycles(scene: Any, position: str, steps: int) -> None:
    cube = add_cube()
    keyframe(cube, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    keyframe(cube, "rotation_euler", {0: (0.0, 0.0, 0.0), 20: (0.0, 0.0, 3.0)})
    cube.cycles.motion_steps = steps
    open_shutter(scene, 0.5, position)
    scene.frame_set(10)
    description = export()
    expected = times(0.5, position, steps)
    np.testing.assert_allclose(description.instances.motion[0][:, 0, 3], expected, rtol=1e-6)
    for matrix, time in zip(description.instances.motion[0], expected, strict=True):
        np.testing.assert_allclose(matrix, matrix_at(cube, time), atol=1e-6)
    middle = description.instances.motion[0][2 ** (steps - 1)]
    np.testing.assert_array_equal(middle, description.instances.transform[0])
    assert (scene.frame_current, scene.frame_subframe) == (10, 0.0)
    assert description.frame_current == 10.0 and description.notices == []


def test_times_before_zero_and_subframes(scene: Any) -> None:
    cube = add_cube()
    keyframe(cube, "location", {-20: (-20.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    open_shutter(scene, 1.5)
    scene.frame_set(-1, subframe=0.75)
    motion = export().instances.motion[0]
    np.testing.assert_allclose(motion[:, 0, 3], [-1.0, -0.25, 0.5], atol=1e-6)
    # Blender itself calls this frame 0 less a quarter.
    assert scene.frame_current + scene.frame_subframe == -0.25


def test_splitting_of_times() -> None:
    from addon.export.shutter import split_time

    assert split_time(3.25) == (3, 0.25) and split_time(-0.25) == (-1, 0.75) and split_time(-2.0) == (-2, 0.0)
    # Blender keeps float32: just below a whole frame is that frame.
    assert split_time(2.9999999999) == (3, 0.0) and split_time(1e30)[0] == 1048574


@pytest.mark.parametrize("length", [0.0, 0.5])
def test_without_an_open_shutter_nothing_moves(scene: Any, length: float) -> None:
    cube = add_cube()
    keyframe(cube, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    keyframe(scene.camera, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    open_shutter(scene, length, "START")
    if length:
        scene.view_layers[0].use_motion_blur = False
    scene.frame_set(10)
    frames: list[int] = []
    import bpy

    def note(*_args: Any) -> None:
        frames.append(scene.frame_current)

    bpy.app.handlers.frame_change_post.append(note)
    try:
        description = export()
    finally:
        bpy.app.handlers.frame_change_post.remove(note)
    assert description.instances.motion == {} and description.camera.motion is None and frames == []
    assert description.instances.transform[0, 0, 3] == pytest.approx(10.0) and description.shutter_curve is None


def test_what_stands_still_has_no_motion(scene: Any) -> None:
    add_cube("Still")
    moving = add_cube("Moving")
    keyframe(moving, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    description = export()
    assert [description.instances.name[row] for row in description.instances.motion] == ["Moving"]


def test_steps_of_different_objects_share_the_times(scene: Any) -> None:
    visited: list[float] = []
    for name, steps in (("A", 1), ("B", 3), ("C", 2)):
        cube = add_cube(name)
        keyframe(cube, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
        cube.cycles.motion_steps = steps
    import bpy

    def note(*_args: Any) -> None:
        visited.append(scene.frame_current + scene.frame_subframe)

    bpy.app.handlers.frame_change_post.append(note)
    try:
        instances = export().instances
    finally:
        bpy.app.handlers.frame_change_post.remove(note)
    for row, steps in enumerate((1, 3, 2)):
        np.testing.assert_allclose(instances.motion[row][:, 0, 3], times(1.0, "CENTER", steps), rtol=1e-6)
    # Eight times besides the middle, and back.
    assert len(visited) == 9 and visited[-1] == 10.0


def test_switches_of_objects(scene: Any) -> None:
    for name in ("Off", "On"):
        keyframe(add_cube(name), "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    scene.objects["Off"].cycles.use_motion_blur = False
    scene.objects["On"].cycles.motion_steps = 2
    keyframe(scene.camera, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    scene.camera.cycles.use_motion_blur = False
    for item in scene.objects:
        item.update_tag()
    description = export()
    assert {description.instances.name[row]: len(motion) for row, motion in description.instances.motion.items()} == {
        "On": 5
    }
    assert description.camera.motion is None


def test_a_jump_and_a_way_back(scene: Any) -> None:
    jumping, returning = add_cube("Jumping"), add_cube("Returning")
    keyframe(jumping, "location", {0: (0.0, 0.0, 0.0), 10: (5.0, 0.0, 0.0)}, "CONSTANT")
    keyframe(returning, "location", {0: (20.0, 0.0, 0.0), 20: (0.0, 0.0, 0.0)})
    scene.frame_set(10)
    motion = export().instances.motion
    np.testing.assert_allclose(motion[0][:, 0, 3], [0.0, 5.0, 5.0], atol=1e-6)
    np.testing.assert_allclose(motion[1][:, 0, 3], [10.5, 10.0, 9.5], atol=1e-5)


# ---------------------------------------------------------------------------------------------------------------------
# Instances


def test_children_move_with_their_parents(scene: Any) -> None:
    import bpy

    parent = bpy.data.objects.new("Parent", None)
    scene.collection.objects.link(parent)
    cube = add_cube()
    cube.location = (3.0, 0.0, 0.0)
    cube.parent = parent
    keyframe(parent, "rotation_euler", {0: (0.0, 0.0, 0.0), 20: (0.0, 0.0, 20.0)})
    motion = export().instances.motion[0]
    np.testing.assert_allclose(motion[:, 0, 3], [3.0 * math.cos(time) for time in (9.5, 10.0, 10.5)], atol=1e-5)


def test_instances_of_a_collection_obey_their_instancer_too(scene: Any) -> None:
    import bpy

    cube = add_cube()
    cube.location = (0.0, 1.0, 0.0)
    collection = bpy.data.collections.new("Cubes")
    collection.objects.link(cube)
    scene.collection.objects.unlink(cube)
    for name, x in (("Slow", 1.0), ("Fast", 4.0), ("Off", 1.0)):
        empty = bpy.data.objects.new(name, None)
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        scene.collection.objects.link(empty)
        keyframe(empty, "location", {0: (0.0, 0.0, 0.0), 20: (20.0 * x, 0.0, 0.0)})
    scene.objects["Fast"].cycles.motion_steps = 2
    scene.objects["Off"].cycles.use_motion_blur = False
    instances = export().instances
    assert sorted(instances.motion) == [0, 1] and len(instances.mesh) == 3
    np.testing.assert_allclose(instances.motion[0][:, 0, 3], [9.5, 10.0, 10.5], atol=1e-5)
    np.testing.assert_allclose(instances.motion[1][:, 0, 3], [38.0, 39.0, 40.0, 41.0, 42.0], atol=1e-5)
    assert (instances.motion[0][:, 1, 3] == 1.0).all()


def test_an_object_that_vanishes_stays_where_it_is(scene: Any) -> None:
    ghost, cube = add_cube("Ghost"), add_cube()
    for item in (ghost, cube):
        keyframe(item, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    # Export here is that of the viewport.
    keyframe(ghost, "hide_viewport", {0: False, 10.25: True}, "CONSTANT")
    scene.frame_set(10)
    instances = export().instances
    assert instances.name == ["Ghost", "Cube"]
    np.testing.assert_allclose(instances.motion[0][:, 0, 3], [9.5, 10.0, 10.0], atol=1e-6)
    np.testing.assert_allclose(instances.motion[1][:, 0, 3], [9.5, 10.0, 10.5], atol=1e-6)


def test_an_object_that_appears_is_not_there(scene: Any) -> None:
    """As Cycles: what is shown is what is there in the middle."""
    keyframe(add_cube("Late"), "hide_viewport", {0: True, 10.25: False}, "CONSTANT")
    add_cube()
    scene.frame_set(10)
    instances = export().instances
    assert instances.name == ["Cube"] and instances.motion == {}


def test_items_are_found_again_in_another_order() -> None:
    from addon.export.moments import find_again

    before = np.array([[0, 1], [0, 2], [1, 0], [0, 1], [3, 3]], np.int32)
    now = np.array([[1, 0], [0, 1], [2, 2], [0, 2], [0, 1]], np.int32)
    assert find_again(before, now).tolist() == [1, 3, 0, 4, -1]
    assert find_again(before, before).tolist() == [0, 1, 2, 3, 4]
    assert find_again(before, now[:0]).tolist() == [-1] * 5


def test_particles_are_followed_and_those_that_are_born_or_die_are_left_out(scene: Any) -> None:
    """As Cycles: nobody knows where they come from or go."""
    shown, emitter = add_cube("Shown"), add_cube("Emitter")
    shown.location = (50.0, 0.0, 0.0)
    emitter.modifiers.new("Particles", "PARTICLE_SYSTEM")
    settings = emitter.particle_systems[0].settings
    # One every 0.9 frames, each for five frames, a metre a frame.
    settings.count, settings.frame_start, settings.frame_end, settings.lifetime = 10, 1, 10, 5
    settings.render_type, settings.instance_object = "OBJECT", shown
    settings.effector_weights.gravity = 0.0
    settings.normal_factor = scene.render.fps / scene.render.fps_base
    # Blender goes through the frames before it knows where particles are.
    for frame in range(1, 12):
        scene.frame_set(frame)
    counts = []
    for length in (0.5, 2.0):
        open_shutter(scene, length)
        scene.frame_set(9)
        instances = export().instances
        # The object itself stands still.
        assert sorted(instances.motion) == [row for row, name in enumerate(instances.name) if name == "Shown"][1:]
        for row, motion in instances.motion.items():
            moves = np.diff(motion[:, :3, 3], axis=0)
            np.testing.assert_allclose(moves[0], moves[1], atol=0.02)
            assert np.linalg.norm(moves[0]) == pytest.approx(0.5 * length, abs=0.05)
            np.testing.assert_array_equal(motion[1], instances.transform[row])
        counts.append(len(instances.motion))
    assert counts == [5, 3]


# ---------------------------------------------------------------------------------------------------------------------
# Camera and lamps


@pytest.mark.parametrize("position", ["START", "CENTER", "END"])
def test_camera(scene: Any, position: str) -> None:
    camera = scene.camera
    camera.scale = (2.0, 2.0, 2.0)
    keyframe(camera, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    camera.cycles.motion_steps = 2
    open_shutter(scene, 0.5, position)
    scene.frame_set(10)
    description = export()
    motion = description.camera.motion
    np.testing.assert_allclose(motion[:, 0, 3], times(0.5, position, 2), rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(motion[:, :3, :3], axis=1), 1.0, atol=1e-6)
    np.testing.assert_array_equal(motion[2], description.camera.transform)
    assert description.notices == []


def test_a_camera_of_another_time_is_not_used(scene: Any) -> None:
    import bpy

    other = bpy.data.objects.new("Other", bpy.data.cameras.new("Other"))
    other.location = (100.0, 0.0, 0.0)
    scene.collection.objects.link(other)
    for frame, camera in ((1, scene.camera), (11, other)):
        marker = scene.timeline_markers.new(camera.name, frame=frame)
        marker.camera = camera
    keyframe(scene.camera, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    open_shutter(scene, 4.0)
    scene.frame_set(10)
    np.testing.assert_allclose(export().camera.motion[:, 0, 3], [8.0, 10.0, 12.0], atol=1e-5)


@pytest.mark.parametrize("is_blurred", [True, False])
def test_a_zoom_is_seen_at_the_ends_of_the_shutter(scene: Any, is_blurred: bool) -> None:
    """As Cycles: also where the camera's own switch keeps it from moving, if other objects are looked at."""
    data, cube = scene.camera.data, add_cube()
    scene.camera.cycles.use_motion_blur = is_blurred
    scene.camera.cycles.motion_steps = cube.cycles.motion_steps = 2
    scene.camera.update_tag()
    keyframe(data, "lens", {9.5: 20.0, 10: 40.0, 10.25: 90.0, 10.5: 50.0})
    keyframe(data, "sensor_width", {0: 30.0, 20: 40.0})
    description = export()
    assert description.camera.motion is None and description.camera.lens == pytest.approx(40.0)
    np.testing.assert_allclose(description.camera.lens_motion, [(20.0, 34.75, 24.0), (50.0, 35.25, 24.0)], rtol=1e-6)
    assert description.notices == []


def test_cameras_that_do_not_zoom(scene: Any) -> None:
    """As Cycles: scales of orthographic views do not blur."""
    assert export().camera.lens_motion is None
    data = scene.camera.data
    data.type = "ORTHO"
    keyframe(data, "lens", {0: 20.0, 20: 60.0})
    assert export().camera.lens_motion is None and export().notices == []
    keyframe(data, "ortho_scale", {0: 5.0, 20: 25.0})
    scene.frame_set(10)
    description = export()
    assert description.camera.lens_motion is None and description.camera.ortho_scale == pytest.approx(15.0)
    assert [(notice.subject, "does not blur, as in Cycles" in notice.problem) for notice in description.notices] == [
        ("Camera", True)
    ]


@pytest.mark.parametrize(
    ("name", "value"), [("shift_x", 1.0), ("dof.focus_distance", 20.0), ("dof.aperture_fstop", 5.0)]
)
def test_what_does_not_blur_is_named(scene: Any, name: str, value: float) -> None:
    data = scene.camera.data
    data.dof.use_dof = True
    owner, _, path = name.rpartition(".")
    keyframe(data.dof if owner else data, path, {0: 0.0, 20: value})
    scene.frame_set(10)
    assert [notice.subject for notice in export().notices] == ["Camera"]
    data.dof.use_dof = False
    assert len(export().notices) == (path == "shift_x")


def test_most_of_the_camera_is_that_of_the_frame(scene: Any) -> None:
    """As Cycles: in the middle of the shutter it looks at place and field of view only."""
    camera, data = scene.camera, scene.camera.data
    keyframe(camera, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    for owner, path in ((data, "lens"), (data, "sensor_width"), (data, "clip_start"), (data, "shift_x"),
                        (data.dof, "focus_distance"), (data.dof, "aperture_fstop")):  # fmt: skip
        keyframe(owner, path, {0: 2.0, 20: 22.0})
    data.dof.use_dof = True
    open_shutter(scene, 4.0, "START")
    scene.frame_set(10)
    found = export().camera
    assert [found.lens, found.sensor_width, found.transform[0, 3]] == pytest.approx([14.0, 14.0, 12.0])
    assert [found.clip_start, found.shift_x, found.focus_distance] == pytest.approx([12.0] * 3)
    # The lens itself is as large as at the frame.
    assert found.lens / found.aperture_fstop == pytest.approx(1.0)
    np.testing.assert_allclose(found.lens_motion[:, :2], [(12.0, 12.0), (16.0, 16.0)])
    data.type = "ORTHO"
    keyframe(data, "ortho_scale", {0: 2.0, 20: 22.0})
    scene.frame_set(10)
    found = export().camera
    assert (found.ortho_scale, found.transform[0, 3]) == pytest.approx((12.0, 12.0))


def test_a_rolling_shutter(scene: Any) -> None:
    assert export().rolling_shutter_duration == 1.0
    scene.cycles.rolling_shutter_type, scene.cycles.rolling_shutter_duration = "TOP", 0.25
    scene.update_tag()
    description = export()
    assert description.rolling_shutter_duration == 0.25 and description.notices == []
    scene.render.use_motion_blur = False
    scene.update_tag()
    assert export().rolling_shutter_duration == 1.0


def test_a_moving_lamp_is_named(scene: Any) -> None:
    import bpy

    for name in ("Moving", "Still"):
        lamp = bpy.data.objects.new(name, bpy.data.lights.new(name, "POINT"))
        scene.collection.objects.link(lamp)
    keyframe(scene.objects["Moving"], "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    open_shutter(scene, 1.0, "START")
    scene.frame_set(10)
    description = export()
    assert [(notice.subject, "lamps are not blurred" in notice.problem) for notice in description.notices] == [
        ("Moving", True)
    ]
    # As in Cycles: where they are in the middle.
    assert [light.transform[0, 3] for light in description.lights] == [pytest.approx(10.5), 0.0]


def test_materials_are_those_of_the_frame(scene: Any) -> None:
    """As Cycles: it reads them before it goes to the middle of the shutter."""
    import bpy

    cube = add_cube()
    material = bpy.data.materials.new("Glow")
    cube.data.materials.append(material)
    shader = next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    keyframe(shader.inputs["Roughness"], "default_value", {0: 0.0, 20: 1.0})
    open_shutter(scene, 4.0, "END")
    scene.frame_set(10)
    graph = export().materials[0].graph
    assert graph is not None
    node = next(node for node in graph.nodes if node.kind == "ShaderNodeBsdfPrincipled")
    assert node.inputs["Roughness"] == pytest.approx(0.5)


# ---------------------------------------------------------------------------------------------------------------------
# Bad input, and Blender left as it was


def test_broken_transforms_keep_the_middle(scene: Any) -> None:
    cube = add_cube()
    keyframe(cube, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    keyframe(cube, "scale", {9: (1.0, 1.0, 1.0), 10.25: (1.0, 0.0, 1.0)}, "CONSTANT")
    scene.frame_set(10)
    description = export()
    np.testing.assert_allclose(description.instances.motion[0][:, 0, 3], [9.5, 10.0, 10.0], atol=1e-6)
    assert [notice.subject for notice in description.notices] == ["Cube"]
    for curve in curves_of(cube):
        if curve.data_path == "scale":
            curve.keyframe_points[-1].co[1] = math.nan
    description = export()
    np.testing.assert_allclose(description.instances.motion[0][:, 0, 3], [9.5, 10.0, 10.0], atol=1e-6)
    assert [notice.subject for notice in description.notices] == ["Cube"]


def test_broken_lenses_keep_the_middle(scene: Any) -> None:
    data = scene.camera.data
    keyframe(data, "lens", {9: 20.0, 10: 40.0, 10.25: 50.0}, "CONSTANT")
    curves_of(data)[0].keyframe_points[-1].co[1] = math.nan
    scene.frame_set(10)
    description = export()
    assert description.camera.lens == 40.0
    np.testing.assert_array_equal(description.camera.lens_motion[:, 0], [20.0, 40.0])
    assert [notice.subject for notice in description.notices] == ["Camera"]


@pytest.mark.parametrize("position", ["START", "CENTER", "END"])
def test_a_camera_that_cannot_be_is_named_and_leaves_the_frame(scene: Any, position: str) -> None:
    keyframe(scene.camera, "scale", {0: (1.0, 1.0, 1.0), 10: (1.0, 1.0, 1.0)}, "CONSTANT")
    for curve in curves_of(scene.camera):
        for point in curve.keyframe_points:
            point.co[1] = math.nan
    open_shutter(scene, 1.0, position)
    scene.frame_set(10, subframe=0.25)
    with pytest.raises(ValueError, match="scaled to zero or infinity"):
        export()
    assert (scene.frame_current, scene.frame_subframe) == (10, 0.25)


def test_a_driver_that_gives_nan(scene: Any) -> None:
    cube = add_cube()
    driver = cube.driver_add("location", 0).driver
    driver.expression = "float('nan') if frame > 10 else 1.0"
    scene.frame_set(10)
    description = export()
    motion = description.instances.motion.get(0)
    assert motion is None or np.isfinite(motion).all()
    assert np.isfinite(description.instances.transform).all()


@pytest.mark.parametrize("position", ["START", "CENTER"])
def test_cancelling_leaves_the_frame(scene: Any, position: str) -> None:
    from addon.export import ExportCancelled

    cube = add_cube()
    keyframe(cube, "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    open_shutter(scene, 1.0, position)
    scene.frame_set(10, subframe=0.25)
    asked: list[float] = []

    def note() -> bool:
        asked.append(scene.frame_current + scene.frame_subframe)
        return False

    export(should_cancel=note)
    assert len(set(asked)) == (4 if position == "START" else 3) - (position == "START")
    for limit in range(len(asked)):
        left = [limit]

        def stop(left: list[int] = left) -> bool:
            left[0] -= 1
            return left[0] < 0

        with pytest.raises(ExportCancelled):
            export(should_cancel=stop)
        assert (scene.frame_current, scene.frame_subframe) == (10, 0.25)


def test_errors_leave_the_frame(scene: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from addon.export import motion

    keyframe(add_cube(), "location", {0: (0.0, 0.0, 0.0), 20: (20.0, 0.0, 0.0)})
    scene.frame_set(10)

    def fail(*_args: Any) -> None:
        raise RuntimeError("broken")

    monkeypatch.setattr(motion, "find_again", fail)
    with pytest.raises(RuntimeError, match="broken"):
        export()
    assert (scene.frame_current, scene.frame_subframe) == (10, 0.0)


def test_shutter_curve(scene: Any) -> None:
    from addon.export.shutter import read_shutter_curve

    mapping = scene.render.motion_blur_shutter_curve
    points = mapping.curves[0].points
    for point in points:
        point.location[1] = 1.0
    mapping.update()
    assert read_shutter_curve(scene.render) is None and export().shutter_curve is None
    points[0].location, points[-1].location = (0.0, 0.0), (1.0, 1.0)
    while len(points) > 2:
        points.remove(points[1])
    for point in points:
        point.handle_type = "VECTOR"
    mapping.update()
    scene.update_tag()
    curve = export().shutter_curve
    assert curve is not None and curve.dtype == np.float32
    np.testing.assert_allclose(curve, np.linspace(0.0, 1.0, 256), atol=1e-3)
