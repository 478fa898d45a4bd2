# SPDX-License-Identifier: GPL-3.0-or-later
"""Broken scenes through the whole of it, Blender to file: a picture or a sentence, never a traceback or a crash."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

Render = Callable[[], tuple[np.ndarray, str]]


@pytest.fixture
def render(cube_scene: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Render:
    """Render the frame: its pixels, row 0 at the top, and all that was said. Fails on NaN, failure or a traceback."""

    def run() -> tuple[np.ndarray, str]:
        import bpy

        from addon import engine

        engine.outcomes.clear()
        cube_scene.render.filepath = str(tmp_path / "image.exr")
        bpy.ops.render.render(write_still=True)
        said = "".join(capfd.readouterr())
        assert "Traceback" not in said
        assert [outcome.status for outcome in engine.outcomes] == ["FINISHED"], said
        with OpenEXR.File(str(tmp_path / "image.exr")) as file:
            pixels = np.array(file.channels()["RGBA"].pixels)
        assert np.isfinite(pixels).all()
        return pixels, said

    return run


def add_mesh(
    scene: Any, name: str, vertices: list[tuple[float, float, float]], faces: list[tuple[int, ...]], x: float = 0.0
) -> Any:
    import bpy

    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    thing = bpy.data.objects.new(name, mesh)
    thing.location.x = x
    scene.collection.objects.link(thing)
    return thing


def graph_of(scene: Any) -> Any:
    """The node tree of a new material on the cube, empty but for its output."""
    import bpy

    material = bpy.data.materials.new("Broken")
    material.use_nodes = True
    scene.objects["Cube"].data.materials.append(material)
    tree = material.node_tree
    tree.nodes.clear()
    tree.nodes.new("ShaderNodeOutputMaterial")
    return tree


def output_of(tree: Any) -> Any:
    return tree.nodes["Material Output"].inputs["Surface"]


SQUARE = [(-1.0, 0.0, -1.0), (1.0, 0.0, -1.0), (1.0, 0.0, 1.0), (-1.0, 0.0, 1.0)]


# Nothing to see


def test_no_lights_is_black(cube_scene: Any, render: Render) -> None:
    cube_scene.collection.objects.unlink(cube_scene.objects["Sun"])
    pixels, _ = render()
    assert (pixels[..., :3] == 0.0).all() and (pixels[..., 3] == 1.0).all()


def test_an_empty_scene_is_black(cube_scene: Any, render: Render) -> None:
    for name in ("Sun", "Cube"):
        cube_scene.collection.objects.unlink(cube_scene.objects[name])
    pixels, _ = render()
    assert (pixels[..., :3] == 0.0).all()


@pytest.mark.parametrize("how", ["objects", "layer collection", "rays"])
def test_everything_hidden_is_black(cube_scene: Any, render: Render, blender: Any, how: str) -> None:
    if how == "layer collection":
        collection = blender.data.collections.new("Hidden")
        cube_scene.collection.children.link(collection)
        for name in ("Sun", "Cube"):
            thing = cube_scene.objects[name]
            cube_scene.collection.objects.unlink(thing)
            collection.objects.link(thing)
        cube_scene.view_layers[0].layer_collection.children["Hidden"].exclude = True
    else:
        for name in ("Sun", "Cube"):
            thing = cube_scene.objects[name]
            if how == "objects":
                thing.hide_render = True
            else:
                for kind in ("camera", "diffuse", "glossy", "transmission", "shadow", "volume_scatter"):
                    setattr(thing, f"visible_{kind}", False)
    pixels, _ = render()
    assert (pixels[..., :3] == 0.0).all()


# Geometry


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e30])
def test_vertices_that_cannot_be_are_named_and_their_faces_left_out(
    cube_scene: Any, render: Render, bad: float
) -> None:
    before, _ = render()
    thing = add_mesh(cube_scene, "Torn", [*SQUARE, (bad, 0.0, 0.0), (0.0, bad, 0.0)], [(0, 1, 4), (4, 5, 2)])
    pixels, said = render()
    assert "mesh Torn: 2 faces have vertices that are NaN, infinite" in said
    np.testing.assert_array_equal(pixels, before)
    # Instanced, it is not flattened into the world: another path through the engine.
    twin = thing.copy()
    cube_scene.collection.objects.link(twin)
    pixels, said = render()
    assert "mesh Torn: 2 faces have vertices that are NaN, infinite" in said
    np.testing.assert_array_equal(pixels, before)


def test_faces_without_area_do_not_matter(cube_scene: Any, render: Render) -> None:
    before, _ = render()
    add_mesh(cube_scene, "Slivers", SQUARE, [(0, 0, 1), (2, 2, 2), (0, 1, 0, 1)])
    pixels, _ = render()
    np.testing.assert_allclose(pixels, before, rtol=1e-5, atol=1e-6)


def test_glowing_faces_without_area_do_not_matter(cube_scene: Any, render: Render, blender: Any) -> None:
    before, _ = render()
    thing = add_mesh(cube_scene, "Slivers", SQUARE, [(0, 0, 1), (2, 2, 2)], x=3.0)
    glow = blender.data.materials.new("Glow")
    glow.use_nodes = True
    glow.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 100.0
    thing.data.materials.append(glow)
    pixels, _ = render()
    np.testing.assert_allclose(pixels, before, rtol=1e-5, atol=1e-6)


def test_duplicate_faces_are_black_as_in_cycles(cube_scene: Any, render: Render) -> None:
    """Rays skip the face that they start on, and no other: its twin shadows it."""
    cube_scene.collection.objects.unlink(cube_scene.objects["Cube"])
    wall = add_mesh(cube_scene, "Wall", SQUARE, [(0, 1, 2, 3)])
    once, _ = render()
    cube_scene.collection.objects.unlink(wall)
    add_mesh(cube_scene, "Twice", SQUARE * 2, [(0, 1, 2, 3), (4, 5, 6, 7)])
    twice, _ = render()
    shown = np.abs(twice - once).max(axis=-1) > 1e-4
    assert once[..., :3].max() > 0.05 and shown.sum() > 100
    assert twice[shown][:, :3].max() < 1e-4
    np.testing.assert_array_equal(twice[..., 3], once[..., 3])


@pytest.mark.parametrize("scale", [(0.0, 0.0, 0.0), (1.0, 0.0, 1.0), (1e-30, 1.0, 1.0), (float("nan"), 1.0, 1.0)])
def test_objects_of_degenerate_scale_leave_the_others_alone(
    cube_scene: Any, render: Render, scale: tuple[float, float, float]
) -> None:
    """Far to the side, so that the cube looks as before whatever becomes of them."""
    before, _ = render()
    thing = add_mesh(cube_scene, "Flat", SQUARE, [(0, 1, 2, 3)], x=40.0)
    thing.scale = scale
    pixels, _ = render()
    np.testing.assert_allclose(pixels, before, rtol=1e-5, atol=1e-6)
    twin = thing.copy()
    cube_scene.collection.objects.link(twin)
    pixels, _ = render()
    np.testing.assert_allclose(pixels, before, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("scale", [0.0, float("nan"), 1e30])
@pytest.mark.parametrize("kind", ["POINT", "SPOT", "AREA", "SUN"])
def test_lamps_of_degenerate_scale_render(
    cube_scene: Any, render: Render, blender: Any, kind: str, scale: float
) -> None:
    lamp = blender.data.objects.new("Odd", blender.data.lights.new("Odd", kind))
    lamp.location = (0.0, -2.0, 6.0)
    lamp.scale = (scale, scale, scale)
    cube_scene.collection.objects.link(lamp)
    pixels, _ = render()
    assert pixels[..., :3].max() > 0.05


def test_a_mirrored_object_is_lit_from_outside(cube_scene: Any, render: Render) -> None:
    """A cube is its own mirror image: a negative scale changes rounding only."""
    before, _ = render()
    cube_scene.objects["Cube"].scale = (-1.0, 1.0, 1.0)
    pixels, _ = render()
    np.testing.assert_allclose(pixels[..., :3].mean(axis=(0, 1)), before[..., :3].mean(axis=(0, 1)), rtol=0.02)
    cube_scene.objects["Cube"].scale = (-1.0, -1.0, -1.0)
    pixels, _ = render()
    np.testing.assert_allclose(pixels[..., :3].mean(axis=(0, 1)), before[..., :3].mean(axis=(0, 1)), rtol=0.02)


# Materials and images


@pytest.mark.parametrize("kind", ["missing", "corrupt", "empty"])
@pytest.mark.parametrize("where", ["material", "world"])
def test_images_that_cannot_be_read_are_named(
    cube_scene: Any, render: Render, blender: Any, tmp_path: Path, kind: str, where: str
) -> None:
    path = tmp_path / f"{kind}.png"
    if kind != "missing":
        path.write_bytes(b"\x89PNG\r\n\x1a\nno picture" if kind == "corrupt" else b"")
    image = blender.data.images.new(kind, 4, 4)
    image.source = "FILE"
    image.filepath = str(path)
    if where == "material":
        tree = graph_of(cube_scene)
        texture, shader = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeBsdfDiffuse")
        tree.links.new(shader.outputs[0], output_of(tree))
    else:
        world = cube_scene.world = blender.data.worlds.new("World")
        world.use_nodes = True
        tree = world.node_tree
        texture, shader = tree.nodes.new("ShaderNodeTexEnvironment"), tree.nodes["Background"]
    texture.image = image
    tree.links.new(texture.outputs["Color"], shader.inputs["Color"])
    pixels, said = render()
    assert f" / {kind}: the file {path} is missing or cannot be read; " in said
    # Magenta: no green.
    middle = pixels[8, 16] if where == "material" else pixels[0, 0]
    assert middle[0] > 0.05 and middle[1] == 0.0


def test_links_in_a_circle_are_cut_and_named(cube_scene: Any, render: Render) -> None:
    tree = graph_of(cube_scene)
    first, second = tree.nodes.new("ShaderNodeMath"), tree.nodes.new("ShaderNodeMath")
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(first.outputs[0], second.inputs[0])
    tree.links.new(second.outputs[0], first.inputs[0])
    tree.links.new(second.outputs[0], shader.inputs["Color"])
    tree.links.new(shader.outputs[0], output_of(tree))
    _, said = render()
    assert "Broken / Math: has an invalid link into Value: part of a loop" in said


def test_a_group_without_a_tree_and_a_node_of_an_unknown_kind(cube_scene: Any, render: Render) -> None:
    tree = graph_of(cube_scene)
    group = tree.nodes.new("ShaderNodeGroup")
    assert group.node_tree is None
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(shader.outputs[0], output_of(tree))
    pixels, _ = render()
    assert pixels[8, 16, 0] > 0.01


def test_a_surface_fed_with_a_number_renders(cube_scene: Any, render: Render) -> None:
    """As in Cycles it glows."""
    tree = graph_of(cube_scene)
    value = tree.nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = 2.0
    tree.links.new(value.outputs[0], output_of(tree))
    pixels, _ = render()
    assert pixels[8, 16, 0] == pytest.approx(2.0, rel=1e-3)


def test_a_number_fed_with_a_surface_is_named(cube_scene: Any, render: Render) -> None:
    tree = graph_of(cube_scene)
    glow, shader = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(glow.outputs[0], shader.inputs["Roughness"], verify_limits=False)
    tree.links.new(shader.outputs[0], output_of(tree))
    pixels, said = render()
    assert "Broken / Diffuse BSDF: has an invalid link into Roughness" in said
    assert pixels[8, 16, 0] > 0.01


@pytest.mark.parametrize("operation", ["POWER", "EXPONENT"])
def test_light_that_is_no_number_is_left_out_counted_and_reported(
    cube_scene: Any, render: Render, operation: str
) -> None:
    tree = graph_of(cube_scene)
    math, shader = tree.nodes.new("ShaderNodeMath"), tree.nodes.new("ShaderNodeEmission")
    # Not foldable: the exponent hangs on the position.
    position = tree.nodes.new("ShaderNodeNewGeometry")
    math.operation = operation
    scale = tree.nodes.new("ShaderNodeVectorMath")
    scale.operation = "LENGTH"
    grow = tree.nodes.new("ShaderNodeMath")
    grow.operation = "MULTIPLY"
    grow.inputs[1].default_value = 1e6
    tree.links.new(position.outputs["Position"], scale.inputs[0])
    tree.links.new(scale.outputs["Value"], grow.inputs[0])
    tree.links.new(grow.outputs[0], math.inputs[0])
    math.inputs[1].default_value = 1000.0
    tree.links.new(math.outputs[0], shader.inputs["Strength"])
    tree.links.new(shader.outputs[0], output_of(tree))
    _, said = render()
    assert "samples were NaN or infinite and were left out" in said


# Sizes and numbers


def test_lamps_and_worlds_of_absurd_strength_render(cube_scene: Any, render: Render, blender: Any) -> None:
    cube_scene.objects["Sun"].data.energy = 3e38
    world = cube_scene.world = blender.data.worlds.new("World")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 3e38
    render()


def test_an_absurd_distance_renders(cube_scene: Any, render: Render) -> None:
    """Ten million kilometres away (at a thousand times that, Cycles shows nothing either)."""
    cube_scene.objects["Cube"].location = 1e10 * np.array([0.0, np.sin(1.25), -np.cos(1.25)])
    cube_scene.objects["Cube"].scale = (1e9, 1e9, 1e9)
    cube_scene.camera.data.clip_end = 1e17
    pixels, _ = render()
    assert pixels[8, 16, :3].max() > 0.05


def test_a_picture_that_memory_cannot_hold_is_refused(cube_scene: Any, blender: Any) -> None:
    """Blender's largest: 4 gigapixels."""
    cube_scene.render.resolution_x = cube_scene.render.resolution_y = 65536
    with pytest.raises(RuntimeError, match=r"65536 x 65536 pixels need .* GiB of memory .*lower the resolution"):
        blender.ops.render.render()


@pytest.mark.parametrize("size", [(1, 1), (1, 70), (300, 1)])
def test_pictures_a_pixel_wide_or_high(cube_scene: Any, render: Render, size: tuple[int, int]) -> None:
    """Below one pixel Blender itself refuses."""
    cube_scene.render.resolution_x, cube_scene.render.resolution_y = 100 * size[0], 100 * size[1]
    cube_scene.render.resolution_percentage = 1
    pixels, _ = render()
    assert pixels.shape[1::-1] == size


@pytest.mark.parametrize("name", ["lens", "ortho_scale", "clip_end", "shift_x"])
def test_cameras_of_absurd_numbers_render_or_are_named(cube_scene: Any, render: Render, name: str) -> None:
    camera = cube_scene.camera.data
    if name == "ortho_scale":
        camera.type = "ORTHO"
    setattr(camera, name, {"lens": 1e-3, "ortho_scale": 1e30, "clip_end": 1e-6, "shift_x": 1e20}[name])
    try:
        render()
    except RuntimeError as error:
        assert "camera" in str(error).lower() and "internal error" not in str(error)


# Settings that are no numbers

NAN = float("nan")


def float_settings() -> list[tuple[str, float]]:
    """All settings that are floats, and how they can be none."""
    from addon.declared_settings import SCENE_SETTINGS

    # Those of viewports are no settings of a final render.
    floats = [name for name, setting in SCENE_SETTINGS.items() if type(setting.default) is float]
    names = [name for name in floats if not name.startswith("preview_")]
    assert {"film_exposure", "time_limit", "clamp_direct", "defensive_alpha"} < set(names)
    return [(name, value) for name in names for value in (NAN, float("inf"), float("-inf"))]


@pytest.mark.parametrize(("name", "value"), float_settings())
def test_a_setting_that_is_no_number_is_refused_by_name(cube_scene: Any, name: str, value: float) -> None:
    """Blender makes infinity the property's limit, or the largest number where that has none."""
    import bpy

    from addon import engine
    from addon.declared_settings import setting_owner
    from addon.shared_settings import SHARED_SETTINGS

    owners = [(setting_owner(cube_scene, name), name)]
    if name in SHARED_SETTINGS:
        owner, their_name = SHARED_SETTINGS[name]
        owners.append((getattr(cube_scene, owner), their_name))
    for owner, own_name in owners:
        cube_scene.neuralguide.property_unset("guiding_method")
        setattr(owner, own_name, value)
        if np.isfinite(getattr(owner, own_name)) and abs(getattr(owner, own_name)) < 1e38:
            continue
        with pytest.raises(RuntimeError, match=f"{name} is .*: choose"):
            bpy.ops.render.render()
        assert engine.outcomes[-1].status == "FAILED"
        owner.property_unset(own_name)


@pytest.mark.parametrize("switch", ["motion_blur_shutter", "rolling_shutter_duration"])
def test_a_shutter_that_is_no_number_is_refused(cube_scene: Any, switch: str) -> None:
    import bpy

    cube_scene.render.use_motion_blur = True
    cube_scene.cycles.rolling_shutter_type = "TOP"
    setattr(cube_scene.render if switch.startswith("motion") else cube_scene.cycles, switch, NAN)
    with pytest.raises(RuntimeError, match=r"shutter.* nan"):
        bpy.ops.render.render()


@pytest.mark.parametrize(("kind", "name"), [
    ("SUN", "angle"), ("POINT", "shadow_soft_size"), ("SPOT", "shadow_soft_size"), ("SPOT", "spot_blend"),
    ("SPOT", "spot_size"), ("AREA", "size"), ("AREA", "size_y"), ("AREA", "spread"),
])  # fmt: skip
def test_a_lamp_whose_size_is_no_number_is_named_and_left_out(
    cube_scene: Any, render: Render, kind: str, name: str
) -> None:
    import bpy

    before, _ = render()
    lamp = bpy.data.objects.new("Odd", bpy.data.lights.new("Odd", kind))
    lamp.location.z = 3.0
    if kind == "AREA":
        lamp.data.shape = "RECTANGLE"
    setattr(lamp.data, name, NAN)
    cube_scene.collection.objects.link(lamp)
    pixels, said = render()
    assert "light Odd: its size, angle or spread is NaN or infinite" in said
    np.testing.assert_array_equal(pixels, before)


@pytest.mark.parametrize(("owner", "name", "said_of_it"), [
    ("mist", "start", "World Sky: Start of the mist"), ("mist", "depth", "World Sky: Depth of the mist"),
    ("layer", "pass_alpha_threshold", "View layer ViewLayer: Alpha Threshold"),
    ("cube", "shadow_terminator_geometry_offset", "Cube: Geometry Offset"),
    ("cube", "shadow_terminator_shading_offset", "Cube: Shading Offset"),
])  # fmt: skip
def test_what_few_pictures_depend_on_is_named_and_replaced(
    cube_scene: Any, render: Render, owner: str, name: str, said_of_it: str
) -> None:
    import bpy

    cube_scene.world = bpy.data.worlds.new("Sky")
    cube_scene.view_layers[0].use_pass_mist = True
    owners = {
        "mist": cube_scene.world.mist_settings, "layer": cube_scene.view_layers[0], "cube": cube_scene.objects["Cube"],
    }
    before, _ = render()
    setattr(owners[owner], name, NAN)
    pixels, said = render()
    assert f"{said_of_it} is NaN or infinite" in said
    np.testing.assert_array_equal(pixels, before)


# Strands and points


@pytest.mark.parametrize("shape", ["RIBBONS", "THICK", "THICK_LINEAR"])
def test_strands_that_are_broken_leave_the_others(cube_scene: Any, render: Render, shape: str) -> None:
    """One key, no length, no radius, NaN, hardly a radius, within the cube; the last is wide and seen."""
    import bpy

    cube_scene.cycles_curves.shape = shape
    data = bpy.data.hair_curves.new("Strands")
    data.add_curves([1, 3, 3, 3, 3, 3, 2])
    places = np.zeros((18, 3), np.float32)
    places[:, 2] = np.arange(18) % 3 + 1.0
    places[1:4] = 1.0
    places[8:10] = np.nan
    places[13:16] = (0.0, 0.0, 0.1)
    places[16:] = [(-50.0, 0.0, 3.0), (50.0, 0.0, 3.0)]
    radii = np.full(18, 0.1, np.float32)
    radii[4:7], radii[7], radii[10:13], radii[16:] = 0.0, -1.0, 1e-6, 0.8
    data.position_data.foreach_set("vector", places.ravel())
    data.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", radii)
    strands = bpy.data.objects.new("Strands", data)
    cube_scene.collection.objects.link(strands)
    pixels, said = render()
    assert "NaN" in said and "radii are negative" in said
    strands.hide_render = True
    without, _ = render()
    assert not np.allclose(pixels, without, atol=0.01)


def test_points_that_are_broken_leave_the_others(cube_scene: Any, render: Render) -> None:
    import bpy

    bpy.ops.object.pointcloud_random_add()
    data = bpy.context.object.data
    count = len(data.points)
    places, radii = np.full((count, 3), np.nan, np.float32), np.full(count, 1e9, np.float32)
    places[0], radii[0] = (0.0, 0.0, 2.0), 0.8
    places[1:4], radii[1:4] = 0.0, (0.0, np.nan, -1.0)
    data.attributes["position"].data.foreach_set("vector", places.ravel())
    data.attributes["radius"].data.foreach_set("value", radii)
    pixels, said = render()
    assert "NaN" in said and "3 radii are negative" not in said and "2 radii are negative" in said
    bpy.context.object.hide_render = True
    without, _ = render()
    assert not np.allclose(pixels, without, atol=0.01)
