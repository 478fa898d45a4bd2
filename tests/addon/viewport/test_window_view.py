# SPDX-License-Identifier: GPL-3.0-or-later
"""What a window sends for what Blender says: real scenes and spaces, a process that notes what it gets."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from addon.engine import NeuralGuideRenderEngine  # noqa: E402
from addon.viewport import host as host_module  # noqa: E402
from addon.viewport import window_view  # noqa: E402
from engine.viewport.protocol import DEAD, DONE, Status  # noqa: E402
from engine.viewport.view import Update  # noqa: E402
from tests.helpers.blender_scenes import displacing_material  # noqa: E402
from tests.helpers.panel_layout import Layout  # noqa: E402


class FakeProcess:
    """Notes what it is told."""

    def __init__(self) -> None:
        self.updates: list[Update] = []
        self.status = Status(DONE)
        self.is_alive = self.has_image = self.is_waiting = False

    def start(self) -> None:
        self.is_alive = True

    def send(self, update: Update) -> None:
        self.updates.append(update)

    def poll(self) -> Status:
        return self.status

    def read_image(self) -> None:
        return None

    def close(self) -> None:
        self.is_alive = False


def touched(item: Any, flags: str = "") -> Any:
    """An update of a datablock."""
    return SimpleNamespace(
        id=item, is_updated_geometry="g" in flags, is_updated_transform="t" in flags, is_updated_shading="s" in flags
    )


class Window:
    """A window of 100 x 50 that looks down from 5 m."""

    def __init__(self) -> None:
        screen = bpy.data.screens["Layout"]
        space = next(area for area in screen.areas if area.type == "VIEW_3D").spaces.active
        matrix = np.zeros((4, 4), np.float32)
        matrix[0, 0], matrix[1, 1], matrix[2, 2], matrix[3, 2] = 1.0, 2.0, -1.0, -1.0
        view = np.eye(4, dtype=np.float32)
        view[2, 3] = -5.0
        self.region_3d = SimpleNamespace(
            window_matrix=matrix, view_matrix=view, view_perspective="PERSP", is_perspective=True, pause_render=False
        )
        self.context = SimpleNamespace(
            region=SimpleNamespace(width=100, height=50), space_data=space, region_data=self.region_3d
        )
        self.space = space
        self.view = window_view.WindowView()
        self.texts: list[str] = []
        self.engine = SimpleNamespace(update_stats=lambda _stats, text: self.texts.append(text))

    @property
    def updates(self) -> list[Update]:
        """What was sent since the last look."""
        process: Any = self.view.host.process
        sent, process.updates = process.updates, []
        return sent

    def draw(self, *updates: Any) -> list[Update]:
        """Have Blender say what it has touched, and draw; what was sent."""
        depsgraph = bpy.context.evaluated_depsgraph_get()
        if updates:
            # Blender shows its own to handlers only.
            told: Any = SimpleNamespace(updates=updates)
            self.view.update(told)
        self.view.draw(self.engine, self.context, depsgraph)
        return self.updates


@pytest.fixture
def window(monkeypatch: pytest.MonkeyPatch, blender: Any) -> Iterator[Window]:
    monkeypatch.setattr(host_module, "ViewProcess", FakeProcess)
    bpy.ops.wm.read_homefile(use_empty=False)
    bpy.context.scene.render.engine = "NEURALGUIDE"
    made = Window()
    (first,) = made.draw()
    assert first.view is not None and first.scene is not None and first.settings is not None
    yield made
    made.view.close()
    host_module.close_all()


def test_nothing_is_sent_twice(window: Window) -> None:
    assert window.draw() == []


def test_names_selections_and_colour_management_restart_nothing(window: Window) -> None:
    cube, scene = bpy.data.objects["Cube"], bpy.context.scene
    scene.view_settings.exposure = 2.0
    scene.frame_set(7)
    assert window.draw(touched(scene)) == []
    cube.name = "Box"
    assert window.draw(touched(cube)) == []


def test_a_view_that_turns_sends_a_camera(window: Window) -> None:
    window.region_3d.view_matrix = window.region_3d.view_matrix.copy()
    window.region_3d.view_matrix[0, 3] = 1.0
    (update,) = window.draw()
    assert update == Update(view=update.view)
    assert update.view.camera.transform[:3, 3].tolist() == [-1.0, 0.0, 5.0]


def test_culled_objects_go_and_come_with_the_next_change(window: Window) -> None:
    """As in Cycles: by what the window shows then, not while it turns."""
    scene, cube, light = bpy.context.scene, bpy.data.objects["Cube"], bpy.data.objects["Light"]
    scene.render.use_simplify = scene.cycles.use_camera_cull = cube.cycles.use_camera_cull = True
    scene.update_tag()
    cube.update_tag()
    assert window.draw(touched(scene), touched(cube, "t")) == []
    for aside, names in ((20.0, []), (0.0, ["Cube"])):
        window.region_3d.view_matrix = window.region_3d.view_matrix.copy()
        window.region_3d.view_matrix[0, 3] = aside
        (update,) = window.draw()
        assert update == Update(view=update.view)
        light.data.energy *= 2.0
        (update,) = window.draw(touched(light, "g"), touched(light.data, "gts"))
        assert list(update.scene.instances.name) == names


@pytest.mark.parametrize("edit", ["transform", "light", "material", "mesh", "hide"])
def test_an_edit_sends_a_scene_in_which_only_that_is_new(window: Window, edit: str) -> None:
    before = window.view.host.scene
    cube = bpy.data.objects["Cube"]
    if edit == "transform":
        cube.location.x += 1.0
        (update,) = window.draw(touched(cube, "t"))
        new = {"instances"}
    elif edit == "light":
        light = bpy.data.objects["Light"]
        light.data.energy *= 2.0
        (update,) = window.draw(touched(light, "g"), touched(light.data, "gts"))
        new = {"lights"}
    elif edit == "material":
        material = cube.data.materials[0]
        material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (1.0, 0.0, 0.0, 1.0)
        (update,) = window.draw(touched(material, "s"))
        new = {"materials"}
    elif edit == "mesh":
        cube.data.vertices[0].co.x += 0.5
        cube.data.update()
        (update,) = window.draw(touched(cube, "g"), touched(cube.data, "gts"))
        new = {"meshes"}
    else:
        cube.hide_viewport = True
        (update,) = window.draw(touched(bpy.context.scene))
        new = {"meshes", "instances", "materials"}
    assert update == Update(scene=update.scene)
    names = ("meshes", "instances", "materials", "images", "lights", "world")
    assert {name for name in names if getattr(update.scene, name) is not getattr(before, name)} == new


@pytest.mark.parametrize("kind", ["strands", "points", "hair"])
def test_edited_strands_and_points_are_sent_alone_and_those_before_are_forgotten(window: Window, kind: str) -> None:
    cube = bpy.data.objects["Cube"]
    if kind == "strands":
        data = bpy.data.hair_curves.new("Strands")
        data.add_curves([3, 2])
        owner = bpy.data.objects.new("Strands", data)
        bpy.context.scene.collection.objects.link(owner)
    elif kind == "points":
        bpy.ops.object.pointcloud_random_add()
        owner = bpy.context.object
        data = owner.data
    else:
        owner, data = cube, cube.data
        owner.modifiers.new("Fur", "PARTICLE_SYSTEM").particle_system.settings.type = "HAIR"
        bpy.context.view_layer.update()
    (update,) = window.draw(touched(bpy.context.scene), touched(owner, "g"), touched(data, "gts"))
    (before,) = (mesh for mesh in update.scene.meshes if mesh.rounds is not None)
    plain = [mesh for mesh in update.scene.meshes if mesh.rounds is None]
    for length in (1.5, 2.5):
        if kind == "hair":
            owner.particle_systems[0].settings.hair_length = length
        elif kind == "strands":
            flat = length * np.arange(3 * len(data.points), dtype=np.float32)
            data.position_data.foreach_set("vector", flat)
            data.update_tag()
        else:
            data.attributes["radius"].data.foreach_set("value", np.full(len(data.points), length, np.float32))
            data.update_tag()
        bpy.context.view_layer.update()
        (update,) = window.draw(touched(owner, "g"), touched(data, "gts"))
        (after,) = (mesh for mesh in update.scene.meshes if mesh.rounds is not None)
        assert after.key != before.key
        assert [id(mesh) for mesh in update.scene.meshes if mesh.rounds is None] == [id(mesh) for mesh in plain]
        before = after
    assert len(update.scene.meshes) == len(plain) + 1


def test_another_density_of_fog_is_sent(window: Window) -> None:
    material = bpy.data.objects["Cube"].data.materials[0]
    nodes, links = material.node_tree.nodes, material.node_tree.links
    output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
    fog = nodes.new("ShaderNodeVolumeScatter")
    links.remove(output.inputs["Surface"].links[0])
    links.new(fog.outputs[0], output.inputs["Volume"])
    (update,) = window.draw(touched(material, "s"))
    assert update.scene.materials[0].graph.volume is not None
    fog.inputs["Density"].default_value = 3.0
    (update,) = window.draw(touched(material, "s"))
    graph = update.scene.materials[0].graph
    assert graph.nodes[graph.volume.node].inputs["Density"] == 3.0


def test_settings_of_the_viewport_are_cycles(window: Window) -> None:
    scene = bpy.context.scene
    scene.cycles.preview_samples = 77
    scene.cycles.use_preview_denoising = True
    scene.cycles.preview_denoising_start_sample = 5
    (update,) = window.draw(touched(scene))
    assert update.scene is None
    assert update.settings.samples == 77 and update.settings.use_denoising and update.denoises_from == 5
    if bpy.app.version >= (5, 3):
        window.region_3d.pause_render = True
    else:
        scene.cycles.preview_pause = True
    assert window.draw(touched(scene)) == [Update(is_paused=True)]


@pytest.mark.skipif(bpy.app.version < (5, 3), reason="Blender 5.3 has a pause button in each window")
def test_each_window_has_its_pause_button(window: Window) -> None:
    # Cycles' setting of older Blenders may be left in a file, and does nothing.
    with pytest.warns(DeprecationWarning):
        bpy.context.scene.cycles.preview_pause = True
    assert window.draw(touched(bpy.context.scene)) == []
    redrawn: list[bool] = []
    engine = SimpleNamespace(tag_redraw=lambda: redrawn.append(True))
    for hook in (NeuralGuideRenderEngine.view_pause, NeuralGuideRenderEngine.view_resume):
        hook(engine, window.context)
    assert redrawn == [True, True]
    window.region_3d.pause_render = True
    assert window.draw() == [Update(is_paused=True)]
    window.region_3d.pause_render = False
    assert window.draw() == [Update(is_paused=False)]


def test_without_the_scenes_world_the_studio_light_shines(window: Window, blender: Any) -> None:
    shading = window.space.shading
    shading.type = "RENDERED"
    shading.use_scene_world_render = False
    shading.studiolight_intensity = 0.5
    (update,) = window.draw()
    world, (image,) = update.scene.world, update.scene.images
    assert world.key == ("studio", shading.selected_studio_light.path)
    assert image.pixels.dtype == np.float32 and image.encoding == "LINEAR" and image.pixels.shape[1] >= 256
    # Another angle is another world, by the same image; and no datablock is left of it.
    shading.studiolight_rotate_z = 1.0
    (update,) = window.draw()
    assert update.scene.world.graph != world.graph and update.scene.images[0] is image
    assert not any("studiolights" in item.filepath for item in bpy.data.images)
    shading.use_scene_world_render = True
    (update,) = window.draw()
    assert update.scene.world.name == bpy.context.scene.world.name and not update.scene.images


def test_a_material_that_blender_has_not_touched_is_not_read(
    window: Window, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not even where another one changes, or a lamp."""
    from addon.export import nodes

    cube = bpy.data.objects["Cube"]
    other = cube.copy()
    other.data = cube.data.copy()
    other.data.materials[0] = cube.data.materials[0].copy()
    bpy.context.scene.collection.objects.link(other)
    window.draw(touched(bpy.context.scene), touched(other, "gts"), touched(other.data.materials[0], "s"))
    read: list[str] = []
    export = nodes.GraphExporter.export

    def note(exporter: Any, tree: Any, subject: str) -> Any:
        read.append(subject.rpartition(" / ")[2])
        return export(exporter, tree, subject)

    monkeypatch.setattr(nodes.GraphExporter, "export", note)
    mine = other.data.materials[0]
    mine.node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.123
    (update,) = window.draw(touched(mine, "s"))
    assert [name for name in read if name.startswith("Material")] == [mine.name]
    assert len(update.scene.materials) == 2
    read.clear()
    light = bpy.data.objects["Light"]
    light.data.energy *= 2.0
    window.draw(touched(light, "g"), touched(light.data, "gts"))
    assert not [name for name in read if name.startswith("Material")]


def test_what_a_material_shows_of_an_object_is_read_again(window: Window) -> None:
    cube, empty = bpy.data.objects["Cube"], bpy.data.objects.new("Empty", None)
    bpy.context.scene.collection.objects.link(empty)
    tree = cube.data.materials[0].node_tree
    where = tree.nodes.new("ShaderNodeTexCoord")
    where.object = empty
    tree.links.new(where.outputs["Object"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    (before,) = window.draw(touched(bpy.context.scene), touched(cube.data.materials[0], "s"))
    empty.location.x = 3.0
    (after,) = window.draw(touched(empty, "t"))
    assert before.scene.materials[0].key != after.scene.materials[0].key


def displaced_plane() -> Any:
    """A plane with adaptive subdivision, beside the cube, that its material moves."""
    material = displacing_material()
    mesh = bpy.data.meshes.new("Plane")
    mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
    mesh.materials.append(material)
    plane = bpy.data.objects.new("Plane", mesh)
    bpy.context.scene.collection.objects.link(plane)
    modifier = plane.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels, modifier.subdivision_type, modifier.use_adaptive_subdivision = 1, "SIMPLE", True
    return plane


def dicing_in(update: Update) -> Any:
    """How the plane's mesh is diced."""
    assert update.scene is not None
    instances = update.scene.instances
    return update.scene.meshes[instances.mesh[instances.name.index("Plane")]].dicing


@pytest.mark.skipif(bpy.app.version < (5, 0), reason="Cycles had adaptive subdivision as an experiment")
def test_meshes_are_diced_by_the_windows_view_and_stay_so_until_they_are_touched(window: Window) -> None:
    plane, scene = displaced_plane(), bpy.context.scene
    (update,) = window.draw(touched(scene), touched(plane, "gts"))
    first = dicing_in(update)
    # 8 pixels of a window 100 wide, whose picture is 2 wide one length ahead; and 5 above the plane.
    assert first.growth == pytest.approx(8.0 * 2.0 / 100.0) and first.to_space[2, 3] == -5.0
    assert first.level == scene.cycles.max_subdivisions - 1
    assert first.outside == pytest.approx(3.0 * first.growth)
    window.region_3d.view_matrix = window.region_3d.view_matrix.copy()
    window.region_3d.view_matrix[2, 3] = -2.0
    (update,) = window.draw()
    assert update.scene is None
    light = bpy.data.objects["Light"]
    light.data.energy *= 2.0
    (update,) = window.draw(touched(light, "g"), touched(light.data, "gts"))
    assert dicing_in(update) is first
    plane.location.x = 1.0
    (update,) = window.draw(touched(plane, "t"))
    assert dicing_in(update).to_space[:, 3].tolist() == [1.0, 0.0, -2.0]


@pytest.mark.skipif(bpy.app.version < (5, 0), reason="Cycles had adaptive subdivision as an experiment")
def test_settings_of_dicing_dice_anew(window: Window) -> None:
    plane, scene = displaced_plane(), bpy.context.scene
    (update,) = window.draw(touched(scene), touched(plane, "gts"))
    first = dicing_in(update)
    scene.cycles.preview_dicing_rate = 4.0
    (update,) = window.draw(touched(scene))
    assert dicing_in(update).growth == pytest.approx(0.5 * first.growth)
    scene.cycles.offscreen_dicing_scale = 1.0
    (update,) = window.draw(touched(scene))
    assert dicing_in(update).outside == 0.0
    scene.cycles.max_subdivisions = 5
    (update,) = window.draw(touched(scene))
    assert dicing_in(update).level == 4
    # Rates of renders are none of a window's business.
    scene.cycles.dicing_rate = 0.5
    assert window.draw(touched(scene)) == []
    scene.cycles.dicing_camera = scene.camera
    (update,) = window.draw(touched(scene))
    wanted = np.array(scene.camera.matrix_world.inverted())[:3, 3]
    np.testing.assert_allclose(dicing_in(update).to_space[:, 3], wanted, atol=1e-5)
    plane.modifiers[0].show_viewport = False
    (update,) = window.draw(touched(plane, "g"))
    assert dicing_in(update) is None


def test_a_border_leaves_a_part_of_the_window(window: Window) -> None:
    space = window.space
    space.use_render_border = True
    space.render_border_min_x, space.render_border_max_x = 0.25, 0.5
    space.render_border_min_y, space.render_border_max_y = 0.0, 1.0
    (update,) = window.draw()
    assert update.view.region == (25, 0, 50, 50)
    space.use_render_border = False


def test_a_scene_without_a_camera_is_shown(window: Window) -> None:
    bpy.data.objects.remove(bpy.data.objects["Camera"])
    window.region_3d.view_perspective = "CAMERA"
    window.draw(touched(bpy.context.scene))
    assert "camera" not in window.texts[-1]
    assert window.view.host.process.is_alive


def test_a_camera_that_cannot_be_looked_through_is_named(window: Window) -> None:
    camera = bpy.context.scene.camera
    camera.scale = (0.0, 0.0, 0.0)
    window.region_3d.view_perspective = "CAMERA"
    assert window.draw(touched(camera, "t")) == []
    assert "Camera" in window.texts[-1] and "scale" in window.texts[-1]
    camera.scale = (1.0, 1.0, 1.0)
    assert len(window.draw(touched(camera, "t"))) == 1


def test_a_dead_process_is_said_and_the_next_change_starts_another(
    window: Window, monkeypatch: pytest.MonkeyPatch
) -> None:
    process: Any = window.view.host.process
    process.is_alive, process.status = False, Status(DEAD, "The viewport's process was ended by SIGKILL")
    assert window.draw() == []
    assert window.texts[-1] == "The viewport's process was ended by SIGKILL. Any change starts it again"
    now = host_module.time.monotonic
    monkeypatch.setattr(host_module.time, "monotonic", lambda: now() + 10.0)
    window.region_3d.is_perspective = False
    (update,) = window.draw()
    assert None not in (update.view, update.scene, update.settings)


def test_a_window_that_changes_its_size_is_left_alone_meanwhile(
    window: Window, monkeypatch: pytest.MonkeyPatch
) -> None:
    window.context.region.width = 120
    assert window.draw() == []
    assert window.view.tick() == (True, True)
    now = window_view.time.monotonic
    monkeypatch.setattr(window_view.time, "monotonic", lambda: now() + 1.0)
    (update,) = window.draw()
    assert update.view.width == 120


def test_factors_of_light_groups_are_sent_once_one_is_not_1(window: Window) -> None:
    """Alone: nothing else is sent with them, and nothing restarts."""
    from addon import light_mix

    scene, layer = bpy.context.scene, bpy.context.view_layer
    layer.lightgroups.add(name="Key")
    bpy.data.objects["Light"].lightgroup = "Key"
    scene.update_tag()
    window.draw(touched(scene), touched(bpy.data.objects["Light"], "g"))
    assert window.view.host.scene is not None and window.view.host.scene.light_groups == ("Key",)
    light_mix.add_missing(scene, ["Key"])
    assert window.draw(touched(scene)) == []
    entry = scene.neuralguide.light_mix["Key"]
    entry.strength = 2.0
    assert window.draw(touched(scene)) == [Update(mix={"Key": (2.0, 2.0, 2.0)})]
    entry.strength = 1.0
    assert window.draw() == [Update(mix={"Key": (1.0, 1.0, 1.0)})]
    entry.is_on = False
    assert window.draw() == [Update(mix={"Key": (0.0, 0.0, 0.0)})]
    scene.neuralguide.use_light_mix = False
    assert window.draw() == [Update(mix={"Key": (1.0, 1.0, 1.0)})]


def test_a_factor_that_makes_no_sense_is_said(window: Window) -> None:
    from addon import light_mix

    scene = bpy.context.scene
    bpy.context.view_layer.lightgroups.add(name="Key")
    light_mix.add_missing(scene, ["Key"])
    scene.neuralguide.light_mix["Key"].strength = 3e38
    scene.neuralguide.light_mix["Key"].color = (9.0, 1.0, 1.0)
    assert all(update.mix is None for update in window.draw())
    assert "light group Key: the factor 2.7e+39, 3e+38, 3e+38 is NaN or too large" in window.view.text


def test_the_panel_of_a_window_has_a_factor_for_each_group(window: Window) -> None:
    from addon.light_mix_panel import NEURALGUIDE_PT_view_light_mix as panel

    window.space.shading.type = "RENDERED"
    bpy.context.view_layer.lightgroups.add(name="Key")
    context = SimpleNamespace(
        engine="NEURALGUIDE", space_data=window.space, scene=bpy.context.scene, view_layer=bpy.context.view_layer
    )
    assert panel.poll(context)
    layout = Layout()
    panel.draw(SimpleNamespace(layout=layout), context)
    assert layout.operators == ["neuralguide.add_light_mix"]
    assert bpy.ops.neuralguide.add_light_mix() == {"FINISHED"}
    layout = Layout()
    panel.draw(SimpleNamespace(layout=layout), context)
    assert "Key" in layout.texts and layout.operators == ["neuralguide.reset_light_mix", "neuralguide.write_light_mix"]
    window.space.shading.type = "SOLID"
    assert not panel.poll(context)
