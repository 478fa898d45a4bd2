# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps in the plane of a surface, glass on a table, and scenes far from the origin, beside Cycles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Euler, Matrix, Vector  # noqa: E402

from tests.helpers.blender_scenes import empty_scene, export  # noqa: E402
from tests.helpers.pass_scenes import render_both  # noqa: E402

#: How far off a last bit is no matter any more, in the scenes below [m].
APART = 1e-3


def mesh(name: str, vertices: list[Any], faces: list[Any], material: Any = None) -> Any:
    made = bpy.data.meshes.new(name)
    made.from_pydata(vertices, [], faces)
    if material is not None:
        made.materials.append(material)
    placed = bpy.data.objects.new(name, made)
    bpy.context.scene.collection.objects.link(placed)
    return placed


def plane(name: str, size: float, location: Any, *, looks_down: bool = False, material: Any = None) -> Any:
    half = 0.5 * size
    corners = [(-half, -half, 0.0), (half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0)]
    placed = mesh(name, corners, [(3, 2, 1, 0) if looks_down else (0, 1, 2, 3)], material)
    placed.location = location
    return placed


def cube(name: str, size: float, location: Any) -> Any:
    half = 0.5 * size
    corners = [(x, y, z) for x in (-half, half) for y in (-half, half) for z in (-half, half)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    placed = mesh(name, corners, faces)
    placed.location = location
    return placed


def lamp(kind: str, energy: float, location: Any, rotation: Any = (0.0, 0.0, 0.0), **settings: float) -> Any:
    data = bpy.data.lights.new("Lamp", kind)
    data.energy = energy
    for name, value in settings.items():
        setattr(data, name, value)
    placed = bpy.data.objects.new("Lamp", data)
    placed.location, placed.rotation_euler = location, rotation
    bpy.context.scene.collection.objects.link(placed)
    return placed


def turn_all(rotation: Any) -> None:
    """Turn the whole scene about the origin."""
    turn = Euler(rotation).to_matrix().to_4x4()
    for placed in bpy.context.scene.objects:
        placed.matrix_world = turn @ Matrix.LocRotScale(placed.location, placed.rotation_euler, placed.scale)


def scene_of(width: int = 32, height: int = 24, world: float = 0.0) -> Any:
    scene = empty_scene()
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    scene.cycles.sample_clamp_indirect = 0.0
    scene.cycles.max_bounces = 4
    if world:
        scene.world = bpy.data.worlds.new("World")
        scene.world.color = (world, world, world)
        if scene.world.node_tree is not None:
            scene.world.node_tree.nodes["Background"].inputs[0].default_value = (world, world, world, 1.0)
    return scene


def means(scene: Any, folder: Path, samples: int, cells: tuple[int, int] = (1, 1)) -> tuple[np.ndarray, np.ndarray]:
    """Means of red by cells, ours and Cycles'."""
    found = []
    for image, _ in render_both(scene, folder, samples):
        red = image[next(channel for channel in image if channel.endswith("Combined.R"))]
        rows, columns = red.shape[0] // cells[0], red.shape[1] // cells[1]
        found.append(red.reshape(cells[0], rows, cells[1], columns).mean(axis=(1, 3)))
    return found[0], found[1]


def material_of(kind: str, **inputs: Any) -> Any:
    """A material of one node."""
    material = bpy.data.materials.new(kind)
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    node, output = tree.nodes.new(kind), tree.nodes.new("ShaderNodeOutputMaterial")
    for name, value in inputs.items():
        node.inputs[name].default_value = value
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    return material


def room_with_lamp(gap: float, *, is_instanced: bool = False, share: float = 0.0) -> Any:
    """A lamp so far below a ceiling that is an instance of the floor's mesh, or lets a share of the light through."""
    scene = scene_of()
    veil = material_of("ShaderNodeBsdfTransparent", Color=(share, share, share, 1.0)) if share else None
    floor = plane("Floor", 6.0, (0.0, 0.0, 0.0))
    ceiling = plane("Ceiling", 6.0, (0.0, 0.0, 2.4), looks_down=True, material=veil)
    if is_instanced:
        ceiling.data = floor.data
    lamp("AREA", 100.0, (0.3, 0.2, 2.4 - gap), size=0.5)
    scene.camera.location, scene.camera.rotation_euler = (0.0, -2.9, 1.2), (1.2, 0.0, 0.0)
    return scene


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), (0.3, 0.2, 0.1)], ids=["level", "tilted"])
def test_a_ceiling_hides_the_lamp_that_lies_in_it(blender: Any, tmp_path: Path, rotation: Any):
    """As in Cycles, up to what depends on the last bit of each ray: a few hundredths of the light come through."""
    scene = room_with_lamp(0.0)
    turn_all(rotation)
    ours, theirs = means(scene, tmp_path, 16)
    scene = room_with_lamp(APART)
    turn_all(rotation)
    free, _ = means(scene, tmp_path, 16)
    assert free > 0.5
    assert ours < 0.1 * free
    assert theirs < 0.1 * free


def test_a_ceiling_that_is_an_instance_hides_the_lamp_too(blender: Any, tmp_path: Path):
    """Up to the last bit of each ray: in Cycles a tenth of the light passes, here less."""
    ours, theirs = means(room_with_lamp(0.0, is_instanced=True), tmp_path, 16)
    free, _ = means(room_with_lamp(APART, is_instanced=True), tmp_path, 16)
    assert free > 0.5
    assert ours < 0.1 * free
    assert theirs < 0.2 * free


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_a_transparent_ceiling_dims_the_lamp_that_lies_in_it(blender: Any, tmp_path: Path, share: float):
    """As in Cycles. The notice says that it shadows the lamp unless it is transparent."""
    ours, theirs = means(room_with_lamp(0.0, share=share), tmp_path, 64)
    free, _ = means(room_with_lamp(APART, share=share), tmp_path, 64)
    assert ours / free == pytest.approx(share, abs=0.05)
    assert ours == pytest.approx(theirs, rel=0.03)


def unmoved_copies(rotation: Any, kind: str, has_own_meshes: bool = False, **inputs: Any) -> Any:
    """Two planes in one place, seen from above below a white sky."""
    scene = scene_of(16, 12, world=1.0)
    first = plane("First", 2.0, (0.0, 0.0, 0.0), material=material_of(kind, **inputs))
    second = first.copy()
    scene.collection.objects.link(second)
    if has_own_meshes:
        second.data = first.data.copy()
    turn_all(rotation)
    scene.camera.matrix_world = Matrix.Translation((0.0, 0.0, 3.0))
    scene.camera.data.lens = 100.0
    return scene


TILT = (0.3, 0.2, 0.1)


@pytest.mark.parametrize("has_own_meshes", [False, True])
@pytest.mark.parametrize(("rotation", "share"), [((0.0, 0.0, 0.0), 0.0), (TILT, 0.7)], ids=["level", "tilted"])
def test_unmoved_copies_shadow_each_other(
    blender: Any, tmp_path: Path, rotation: Any, share: float, has_own_meshes: bool
):
    """As in Cycles: all of the sky where they are level, elsewhere by the last bit of each ray."""
    scene = unmoved_copies(rotation, "ShaderNodeBsdfDiffuse", has_own_meshes, Color=(0.8, 0.8, 0.8, 1.0))
    ours, theirs = means(scene, tmp_path, 32)
    assert ours == pytest.approx(share, abs=0.08)
    assert theirs == pytest.approx(share, abs=0.08)


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), TILT], ids=["level", "tilted"])
def test_rays_go_straight_through_unmoved_copies_once(blender: Any, tmp_path: Path, rotation: Any):
    scene = unmoved_copies(rotation, "ShaderNodeBsdfTransparent", Color=(0.5, 0.5, 0.5, 1.0))
    ours, theirs = means(scene, tmp_path, 4)
    assert ours == pytest.approx(0.5, abs=0.01)
    assert theirs == pytest.approx(0.5, abs=0.01)


def table_with_glass(gap: float, roughness: float) -> Any:
    """A box of glass that stands on a floor, or so far above it, under a white world."""
    scene = scene_of(world=1.0)
    for name in ("max_bounces", "transmission_bounces", "glossy_bounces"):
        setattr(scene.cycles, name, 12)
    scene.cycles.blur_glossy = 0.0
    plane("Floor", 8.0, (0.0, 0.0, 0.0))
    material = material_of("ShaderNodeBsdfGlass", Roughness=roughness, IOR=1.5)
    cube("Box", 2.0, (0.0, 0.0, 1.0 + gap)).data.materials.append(material)
    scene.camera.location, scene.camera.rotation_euler = (0.0, -5.0, 4.0), (1.03, 0.0, 0.0)
    return scene


@pytest.mark.parametrize("roughness", [0.0, 0.3], ids=["smooth", "rough"])
@pytest.mark.parametrize(
    "rotation, most", [((0.0, 0.0, 0.0), 0.8), ((0.3, 0.2, 0.1), 0.99)], ids=["level", "tilted"]
)
def test_glass_on_a_table_is_as_dark_as_in_cycles(
    blender: Any, tmp_path: Path, rotation: Any, most: float, roughness: float
):
    """Cycles' rays skip only the very triangle that they start on. So the faces shadow each other."""
    found = []
    for gap in (0.0, APART):
        scene = table_with_glass(gap, roughness)
        turn_all(rotation)
        ours, theirs = means(scene, tmp_path, 64)
        assert ours == pytest.approx(theirs, rel=0.01)
        found.append(ours)
    assert found[0] < most * found[1]


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), TILT], ids=["level", "tilted"])
def test_a_transparent_label_in_glass_dims_once(blender: Any, tmp_path: Path, rotation: Any):
    """A ray that has passed the label does not meet it again from the glass that lies in its place: it was black."""
    found = []
    for gap in (0.0, APART):
        scene = scene_of(24, 18, world=1.0)
        cube("Box", 2.0, (0.0, 0.0, 1.0)).data.materials.append(material_of("ShaderNodeBsdfGlass", Roughness=0.0))
        label = material_of("ShaderNodeBsdfTransparent", Color=(0.5, 0.5, 0.5, 1.0))
        plane("Label", 1.8, (0.0, 0.0, 2.0 + gap), material=label)
        turn_all(rotation)
        scene.camera.matrix_world = Matrix.Translation((0.0, 0.0, 9.0))
        scene.camera.data.lens = 200.0
        ours, theirs = means(scene, tmp_path, 32)
        found.append(ours)
    assert found[0] == pytest.approx(found[1], rel=0.2)


def survey(distance: float, size: float = 60.0) -> Any:
    """A cube that floats above a floor of some size, in the sun, so far from the origin."""
    place = Vector((distance, 0.3 * distance, 0.0))
    scene = scene_of(48, 36, world=0.2)
    plane("Floor", size, place)
    cube("Cube", 4.0, place + Vector((0.0, 0.0, 4.0)))
    lamp("SUN", 3.0, place, (0.6, 0.3, 0.0))
    scene.camera.location = place + Vector((0.0, -30.0, 12.0))
    scene.camera.rotation_euler = (np.radians(72.0), 0.0, 0.0)
    return scene


@pytest.mark.parametrize("distance, size", [(1e5, 60.0), (5e5, 60.0), (5e5, 5e3), (5e6, 60.0)])
def test_far_from_the_origin_shadows_are_where_they_are_for_cycles(
    blender: Any, tmp_path: Path, distance: float, size: float
):
    """5000 km is what northings of UTM are. A ground is large where what stands on it is small."""
    ours, theirs = means(survey(distance, size), tmp_path, 64, (9, 12))
    assert theirs.max() > 2.0 * theirs.min()
    np.testing.assert_allclose(ours, theirs, atol=0.05 * theirs.mean())
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.005)


@pytest.mark.parametrize(
    "build, told",
    [
        (lambda: room_with_lamp(0.0), ["light Lamp: it lies in Ceiling"]),
        (lambda: room_with_lamp(APART), []),
    ],
    ids=["lamp", "lamp before the ceiling"],
)
def test_what_lies_in_something_else_is_named(blender: Any, build: Callable[[], Any], told: list[str]):
    from engine.builder.scene import SceneCache, build_scene
    from engine.settings import RenderSettings

    build()
    bpy.context.view_layer.update()
    scene = build_scene(export(), RenderSettings(), SceneCache())
    said = [f"{notice.subject}: {notice.problem}" for notice in scene.notices]
    assert [sentence for sentence in said if "lie" in sentence] == told
