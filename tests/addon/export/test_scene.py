# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera, frame, lights, world, cancelling: the rest of the description."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from engine.scene.description import (
    VISIBLE_ALL,
    VISIBLE_CAMERA,
    VISIBLE_DIFFUSE,
    VISIBLE_SHADOW,
    Light,
)
from tests.helpers.blender_scenes import empty_scene, export


@pytest.fixture
def scene() -> Any:
    return empty_scene()


def add_light(kind: str, **properties: Any) -> Any:
    import bpy

    data = bpy.data.lights.new("Light", kind)
    for name, value in properties.items():
        setattr(data, name, value)
    item = bpy.data.objects.new("Light", data)
    bpy.context.scene.collection.objects.link(item)
    return item


def only_light() -> Light:
    lights = export().lights
    assert len(lights) == 1
    return lights[0]


# ---------------------------------------------------------------------------------------------------------------------
# Camera and frame


def test_no_camera_says_what_to_do(scene: Any) -> None:
    scene.camera = None
    with pytest.raises(ValueError, match=r"Scene 'Scene' has no camera: add one"):
        export()


@pytest.mark.parametrize("scale", [0.0, float("nan")])
def test_flattened_camera_is_named(scene: Any, scale: float) -> None:
    scene.camera.scale.x = scale
    with pytest.raises(ValueError, match="Camera 'Camera' is scaled to zero"):
        export()


def test_empty_scene(scene: Any) -> None:
    description = export()
    assert description.meshes == [] and description.lights == [] and description.world is None
    assert description.instances.transform.shape == (0, 4, 4) and description.instances.name == []
    assert description.notices == [] and description.working_space == "Rec.709" and description.to_xyz is None


def test_perspective_camera(scene: Any) -> None:
    camera = scene.camera
    camera.location, camera.rotation_euler, camera.scale = (1.0, 2.0, 3.0), (0.0, 0.0, math.pi / 2), (2.0, 3.0, 4.0)
    data = camera.data
    data.lens, data.sensor_width, data.sensor_height, data.sensor_fit = 35.0, 30.0, 20.0, "VERTICAL"
    data.shift_x, data.shift_y, data.clip_start, data.clip_end = 0.1, -0.2, 0.5, 50.0
    exported = export().camera
    assert exported.kind == "PERSP" and exported.sensor_fit == "VERTICAL"
    got = (exported.lens, exported.sensor_width, exported.sensor_height, exported.shift_x, exported.shift_y)
    assert got == pytest.approx((35.0, 30.0, 20.0, 0.1, -0.2))
    assert (exported.clip_start, exported.clip_end) == (0.5, 50.0) and not exported.use_dof
    expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(exported.transform, expected, atol=1e-6)


def test_orthographic_camera(scene: Any) -> None:
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 4.0
    exported = export().camera
    assert exported.kind == "ORTHO" and exported.ortho_scale == 4.0


def test_panorama(scene: Any) -> None:
    data = scene.camera.data
    data.type, data.panorama_type = "PANO", "EQUIRECTANGULAR"
    data.latitude_min, data.longitude_max = -0.5, 1.0
    description = export()
    assert description.camera.kind == "PANO" and description.notices == []
    panorama = description.camera.panorama
    assert (panorama.kind, panorama.latitude_min, panorama.longitude_max) == ("EQUIRECTANGULAR", -0.5, 1.0)


@pytest.mark.parametrize(("fit", "sensor"), [("AUTO", (36.0, 27.0)), ("HORIZONTAL", (36.0, 27.0)),
                                             ("VERTICAL", (40.0, 30.0))])  # fmt: skip
def test_panoramas_know_their_lens_and_film(scene: Any, fit: str, sensor: tuple[float, float]) -> None:
    data = scene.camera.data
    data.type, data.panorama_type = "PANO", "FISHEYE_LENS_POLYNOMIAL"
    data.sensor_fit, data.sensor_width, data.sensor_height = fit, 36.0, 30.0
    data.fisheye_polynomial_k3, data.shift_y = 0.25, 0.1
    data.central_cylindrical_radius, data.central_cylindrical_range_v_max = 2.0, 3.0
    scene.render.resolution_x, scene.render.resolution_y = 80, 60
    panorama = export().camera.panorama
    assert panorama.sensor == pytest.approx(sensor)
    assert panorama.polynomial[3] == 0.25 and panorama.cylinder[3] == 1.5
    assert panorama.window == pytest.approx((0.0, 1.0, 0.1, 1.1))


def test_depth_of_field(scene: Any) -> None:
    import bpy

    dof = scene.camera.data.dof
    dof.use_dof, dof.focus_distance, dof.aperture_fstop = True, 3.0, 1.4
    dof.aperture_blades, dof.aperture_rotation, dof.aperture_ratio = 5, 0.3, 2.0
    camera = export().camera
    assert camera.use_dof and camera.aperture_blades == 5
    got = (camera.focus_distance, camera.aperture_fstop, camera.aperture_rotation, camera.aperture_ratio)
    assert got == pytest.approx((3.0, 1.4, 0.3, 2.0))
    target = bpy.data.objects.new("Target", None)
    target.location = (4.0, 5.0, -7.0)
    scene.collection.objects.link(target)
    dof.focus_object = target
    # Along the axis, not the straight distance.
    assert export().camera.focus_distance == pytest.approx(7.0)


def test_a_light_as_camera(scene: Any) -> None:
    spot = add_light("SPOT", spot_size=math.radians(90.0))
    scene.camera = spot
    camera = export().camera
    assert camera.kind == "PERSP" and camera.lens == pytest.approx(16.0)


def test_frame_and_border(scene: Any) -> None:
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = 200, 101, 50
    render.pixel_aspect_y = 2.0
    scene.cycles.film_exposure = 1.5
    frame = export().frame
    assert (frame.width, frame.height, frame.region) == (100, 50, (0, 0, 100, 50))
    assert (frame.pixel_aspect_x, frame.pixel_aspect_y, frame.exposure) == (1.0, 2.0, 1.5)
    render.use_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.5, 0.1, 0.9
    for crop in (False, True):
        render.use_crop_to_border = crop
        frame = export().frame
        assert (frame.width, frame.height, frame.region) == (100, 50, (25, 5, 50, 45))
    render.border_max_x = 0.2501
    x0, _, x1, _ = export().frame.region
    assert x1 - x0 >= 1


def test_engine_is_asked_for_camera_and_shift(scene: Any) -> None:
    from mathutils import Matrix

    class Engine:
        camera_override = None

        def use_spherical_stereo(self, camera: Any) -> bool:
            return False

        def camera_model_matrix(self, camera: Any, use_spherical_stereo: bool) -> Any:
            return Matrix.Translation((9.0, 0.0, 0.0))

        def camera_shift_x(self, camera: Any, use_spherical_stereo: bool) -> float:
            return 0.75

    camera = export(engine=Engine()).camera
    assert camera.shift_x == 0.75 and camera.transform[0, 3] == 9.0


# ---------------------------------------------------------------------------------------------------------------------
# Lights


def test_point_light(scene: Any) -> None:
    item = add_light("POINT", energy=50.0, shadow_soft_size=0.2, color=(1.0, 0.5, 0.25), use_soft_falloff=False)
    item.location = (1.0, 2.0, 3.0)
    light = only_light()
    assert (light.kind, light.energy, light.is_normalized, light.use_soft_falloff) == ("POINT", 50.0, True, False)
    assert light.radius == pytest.approx(0.2) and light.color == pytest.approx((1.0, 0.5, 0.25))
    np.testing.assert_allclose(light.transform[:3, 3], (1.0, 2.0, 3.0))
    assert light.cast_shadow and light.use_mis and light.max_bounces == 1024
    # Blender hides new lights from the camera.
    assert light.visibility == VISIBLE_ALL & ~VISIBLE_CAMERA


def test_spot_and_sun(scene: Any) -> None:
    spot = add_light("SPOT", spot_size=1.2, spot_blend=0.4, normalize=False)
    light = only_light()
    assert (light.kind, light.is_normalized) == ("SPOT", False)
    assert (light.spot_angle, light.spot_blend) == pytest.approx((1.2, 0.4))
    import bpy

    bpy.data.objects.remove(spot)
    add_light("SUN", energy=3.0, angle=0.1)
    light = only_light()
    assert (light.kind, light.energy) == ("SUN", 3.0) and light.angle == pytest.approx(0.1)


@pytest.mark.parametrize("shape", ["SQUARE", "RECTANGLE", "DISK", "ELLIPSE"])
def test_area_light(scene: Any, shape: str) -> None:
    add_light("AREA", shape=shape, size=2.0, size_y=3.0, spread=1.0)
    light = only_light()
    expected_y = 3.0 if shape in ("RECTANGLE", "ELLIPSE") else 2.0
    assert (light.shape, light.size_x, light.size_y, light.spread) == (shape, 2.0, expected_y, 1.0)


def test_temperature_and_exposure_multiply_the_color(scene: Any) -> None:
    item = add_light("POINT", color=(1.0, 0.5, 1.0), exposure=2.0)
    assert only_light().color == pytest.approx((4.0, 2.0, 4.0))
    item.data.use_temperature, item.data.temperature = True, 3000.0
    warm = np.array(item.data.temperature_color)
    assert warm[0] > warm[1] > warm[2]
    assert only_light().color == pytest.approx(tuple(warm * (4.0, 2.0, 4.0)), rel=1e-5)


def test_lights_of_a_temperature_are_black_bodies(scene: Any) -> None:
    """But for tinted ones, and those that do not use it."""
    item = add_light("POINT", use_temperature=True, temperature=3000.0)
    assert only_light().temperature == 3000.0
    item.data.color = (1.0, 0.5, 1.0)
    assert only_light().temperature == 0.0
    item.data.color, item.data.use_temperature = (1.0, 1.0, 1.0), False
    assert only_light().temperature == 0.0


def test_light_switches(scene: Any) -> None:
    item = add_light("POINT", use_shadow=False)
    item.visible_camera, item.visible_diffuse = True, False
    item.data.cycles.use_multiple_importance_sampling = False
    item.data.cycles.max_bounces = 3
    light = only_light()
    assert not light.cast_shadow and not light.use_mis and light.max_bounces == 3
    assert light.visibility == VISIBLE_ALL & ~VISIBLE_DIFFUSE


def test_light_nodes(scene: Any) -> None:
    import bpy

    item = add_light("POINT")
    if bpy.app.version < (5, 2):  # From then on all lights have nodes.
        assert only_light().graph is None
    item.data.use_nodes = True
    tree = item.data.node_tree
    tree.nodes["Emission"].inputs["Strength"].default_value = 5.0
    graph = only_light().graph
    assert graph is not None and graph.surface is not None
    assert graph.nodes[graph.surface.node].inputs["Strength"] == 5.0


def test_a_portal_is_no_light_but_the_worlds(scene: Any) -> None:
    import bpy

    portal = add_light("AREA")
    portal.data.cycles.is_portal = True
    portal.data.shape, portal.data.size, portal.data.size_y = "ELLIPSE", 2.0, 3.0
    portal.location = (1.0, 2.0, 3.0)
    scene.world = bpy.data.worlds.new("World")
    description = export()
    assert description.lights == [] and description.notices == [] and description.world is not None
    (found,) = description.world.portals
    assert (found.shape, found.size_x, found.size_y) == ("ELLIPSE", 2.0, 3.0)
    assert found.transform[:3, 3].tolist() == [1.0, 2.0, 3.0]


def test_instanced_lights_have_keys_of_their_own(scene: Any) -> None:
    import bpy

    light = add_light("POINT")
    collection = bpy.data.collections.new("Lights")
    collection.objects.link(light)
    scene.collection.objects.unlink(light)
    for x in (1.0, 2.0):
        empty = bpy.data.objects.new("Empty", None)
        empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", collection, (x, 0.0, 0.0)
        scene.collection.objects.link(empty)
    lights = export().lights
    assert [light.transform[0, 3] for light in lights] == [1.0, 2.0]
    assert len({light.key for light in lights}) == 2 and len({light.random for light in lights}) == 2


# ---------------------------------------------------------------------------------------------------------------------
# World, layers, cancelling


def test_world(scene: Any) -> None:
    import bpy

    scene.world = bpy.data.worlds.new("World")
    background = scene.world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (0.1, 0.2, 0.3, 1.0)
    scene.world.cycles.sampling_method = "MANUAL"
    scene.world.cycles.sample_map_resolution = 512
    scene.world.cycles.max_bounces = 7
    scene.world.cycles_visibility.camera = False
    world = export().world
    assert world is not None and world.name == "World" and world.graph is not None and world.graph.surface is not None
    node = world.graph.nodes[world.graph.surface.node]
    assert node.kind == "ShaderNodeBackground" and node.inputs["Color"] == pytest.approx((0.1, 0.2, 0.3, 1.0))
    assert (world.sampling, world.map_resolution, world.max_bounces) == ("MANUAL", 512, 7)
    assert world.visibility == VISIBLE_ALL & ~VISIBLE_SHADOW & ~VISIBLE_CAMERA
    bpy.context.view_layer.use_sky = False
    assert export().world is None


def test_view_layers_show_their_own_collections(scene: Any) -> None:
    import bpy

    from addon.export import export_scene

    other = scene.view_layers.new("Other")
    bpy.ops.mesh.primitive_plane_add()
    collection = bpy.data.collections.new("Extra")
    scene.collection.children.link(collection)
    plane = bpy.context.object
    collection.objects.link(plane)
    scene.collection.objects.unlink(plane)
    other.layer_collection.children["Extra"].exclude = True
    depsgraphs = {}
    for layer in (scene.view_layers[0], other):
        layer.update()
        depsgraphs[layer.name] = layer.depsgraph
    counts = {name: len(export_scene(graph).instances.mesh) for name, graph in depsgraphs.items()}
    assert counts == {scene.view_layers[0].name: 1, "Other": 0}


def test_cancel(scene: Any) -> None:
    import bpy

    from addon.export import ExportCancelled

    bpy.ops.mesh.primitive_plane_add()
    asked: list[int] = []

    def should_cancel() -> bool:
        asked.append(1)
        return False

    export(should_cancel=should_cancel)
    assert len(asked) >= 5
    for limit in range(len(asked)):
        left = [limit]

        def stop(left: list[int] = left) -> bool:
            left[0] -= 1
            return left[0] < 0

        with pytest.raises(ExportCancelled):
            export(should_cancel=stop)


def test_time_of_the_frame(scene: Any) -> None:
    scene.frame_set(12, subframe=0.25)
    assert export().frame_current == pytest.approx(12.25)
