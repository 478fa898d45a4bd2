# SPDX-License-Identifier: GPL-3.0-or-later
"""Hair, curves and point clouds in the description."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from engine.scene import limits
from engine.scene.rounds import RIBBONS, ROUND, ROUND_LINEAR, SPHERES
from tests.helpers.blender_scenes import empty_scene, export, render_and_export


@pytest.fixture
def scene(blender: Any) -> Any:
    return empty_scene()


def _info_material(kind: str = "ShaderNodeHairInfo", output: str = "Random") -> Any:
    import bpy

    material = bpy.data.materials.new("Info")
    material.use_nodes = True
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    tree.links.new(tree.nodes.new(kind).outputs[output], shader.inputs["Roughness"])
    return material


def _add_curves(scene: Any, sizes: list[int]) -> Any:
    import bpy

    data = bpy.data.hair_curves.new("Strands")
    data.add_curves(sizes)
    positions = np.zeros((sum(sizes), 3), np.float32)
    positions[:, 0] = np.arange(sum(sizes))
    data.position_data.foreach_set("vector", positions.ravel())
    data.materials.append(_info_material())
    scene.collection.objects.link(bpy.data.objects.new("Strands", data))
    return data


def _furry_square(**settings: Any) -> Any:
    import bpy

    bpy.ops.mesh.primitive_plane_add(size=2.0)
    square = bpy.context.object
    square.data.materials.append(_info_material())
    system = square.modifiers.new("Fur", "PARTICLE_SYSTEM").particle_system
    hair = system.settings
    hair.type, hair.count, hair.hair_length, hair.render_step = "HAIR", 7, 1.0, 2
    for key, value in settings.items():
        setattr(hair, key, value)
    return square


def test_curves_are_segments_between_their_keys(scene: Any) -> None:
    data = _add_curves(scene, [3, 1, 2])
    data.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", np.arange(6, dtype=np.float32))
    (mesh,) = export().meshes
    # One key makes no segment, as in Cycles.
    assert mesh.triangles.tolist() == [[0, 1, 0], [1, 2, 0], [4, 5, 4]]
    assert mesh.rounds.shape == RIBBONS and mesh.rounds.radii.tolist() == [0, 1, 2, 3, 4, 5]
    assert mesh.attributes["curve_intercept"].data.ravel().tolist() == [0.0, 0.5, 1.0, 0.0, 0.0, 1.0]
    assert mesh.attributes["curve_length"].data.ravel().tolist() == [2.0, 2.0, 1.0]
    random = mesh.attributes["curve_random"].data.ravel()
    assert random[0] == random[1] != random[2] and (0.0 <= random).all() and (random <= 1.0).all()


@pytest.mark.parametrize("model", ["CHIANG", "HUANG"])
def test_strands_have_normals_where_their_ellipses_need_them(scene: Any, model: str) -> None:
    data = _add_curves(scene, [3])
    tree = data.materials[0].node_tree
    hair = tree.nodes.new("ShaderNodeBsdfHairPrincipled")
    hair.model = model
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(hair.outputs[0], output.inputs["Surface"])
    (mesh,) = export().meshes
    assert ("curve_normal" in mesh.attributes) == (model == "HUANG")
    if model == "HUANG":
        normals = mesh.attributes["curve_normal"].data
        assert np.allclose(normals, [tuple(normal.vector) for normal in data.normals])
        assert np.allclose(np.linalg.norm(normals, axis=1), 1.0)
        assert np.allclose(normals[:, 0], 0.0)


@pytest.mark.parametrize(("setting", "shape"), [("THICK", ROUND), ("THICK_LINEAR", ROUND_LINEAR)])
def test_the_scene_says_the_shape(scene: Any, setting: str, shape: str) -> None:
    scene.cycles_curves.shape, scene.cycles_curves.subdivisions = setting, 3
    _add_curves(scene, [2])
    (mesh,) = export().meshes
    assert (mesh.rounds.shape, mesh.rounds.subdivisions) == (shape, 3)


def test_hair_grows_on_its_mesh_and_can_do_without_it(scene: Any) -> None:
    square = _furry_square(root_radius=1.0, tip_radius=0.0, radius_scale=0.5, use_close_tip=True)
    description = render_and_export(scene)
    plain, hair = description.meshes
    assert plain.rounds is None and description.instances.name == ["Plane", "Plane"]
    assert len(hair.triangles) == 7 * 4
    # By the length so far: Blender's keys are not quite evenly spaced.
    assert hair.rounds.radii.reshape(7, 5)[0].tolist() == pytest.approx([0.25, 0.1875, 0.125, 0.0625, 0.0], abs=0.005)
    roots = hair.vertices.reshape(7, 5, 3)[:, 0]
    assert np.abs(roots[:, 2]).max() < 1e-5 and np.abs(roots).max() <= 1.0 + 1e-5
    uv = hair.attributes[hair.default_uv]
    assert uv.domain == "FACE" and np.allclose(uv.data.reshape(7, 4, 2)[:, 0], 0.5 * (roots[:, :2] + 1.0), atol=1e-3)
    square.show_instancer_for_render = False
    (alone,) = render_and_export(scene).meshes
    assert alone.rounds is not None


def test_children_stand_for_their_parents(scene: Any) -> None:
    _furry_square(child_type="INTERPOLATED", rendered_child_count=4)
    hair = render_and_export(scene).meshes[1]
    assert len(hair.triangles) == 7 * 4 * 4


def test_short_strands_end_where_they_are(scene: Any) -> None:
    """Blender has fewer keys of strands that a random share of their length was taken from."""
    _furry_square(child_type="INTERPOLATED", rendered_child_count=4, length_random=0.6, render_step=4)
    keys = render_and_export(scene).meshes[1].vertices.reshape(7 * 4, 17, 3)
    lengths = np.linalg.norm(np.diff(keys, axis=1), axis=2).sum(axis=1)
    assert lengths.max() <= 1.05 and lengths.min() < 0.8 * lengths.max()
    assert (np.diff(keys[:, :, 2], axis=1) >= -1e-4).all(), "hair grows up from a square, and no strand turns back"


def test_a_view_layer_may_leave_hair_out(scene: Any) -> None:
    _furry_square()
    scene.view_layers[0].use_strand = False
    assert len(render_and_export(scene).meshes) == 1


def test_points_are_spheres(scene: Any) -> None:
    import bpy

    bpy.ops.object.pointcloud_random_add()
    bpy.context.object.data.materials.append(_info_material("ShaderNodePointInfo"))
    (mesh,) = export().meshes
    count = len(bpy.context.object.data.points)
    assert mesh.rounds.shape == SPHERES and len(mesh.rounds.radii) == count
    assert (mesh.triangles == np.arange(count)[:, None]).all()
    assert len(np.unique(mesh.attributes["point_random"].data)) > 0.9 * count


@pytest.mark.parametrize(("shape", "power"), [(-0.5, 0.5), (0.5, 2.0), (1.0, math.inf)])
def test_the_shape_bends_how_hair_gets_thinner(scene: Any, shape: float, power: float) -> None:
    _furry_square(root_radius=2.0, tip_radius=1.0, radius_scale=0.1, shape=shape, use_close_tip=False)
    hair = render_and_export(scene).meshes[1]
    keys = hair.vertices.reshape(7, 5, 3)
    along = np.concatenate([np.zeros((7, 1)), np.linalg.norm(np.diff(keys, axis=1), axis=2).cumsum(axis=1)], axis=1)
    rest = np.maximum(1.0 - along / along[:, -1:], 0.0)
    assert hair.rounds.radii.reshape(7, 5) == pytest.approx(0.05 * (1.0 + rest**power), abs=1e-5)


@pytest.mark.parametrize(
    ("settings", "keys"), [({"render_step": 4}, 17), ({"kink": "SPIRAL", "kink_extra_steps": 3}, 8)]
)
def test_steps_say_how_many_keys_hair_has(scene: Any, settings: dict[str, Any], keys: int) -> None:
    _furry_square(**settings)
    assert len(render_and_export(scene).meshes[1].vertices) == 7 * keys


def test_hair_has_the_material_that_its_particles_choose(scene: Any) -> None:
    square = _furry_square(material=2)
    square.data.materials.append(_info_material())
    assert set(render_and_export(scene).meshes[1].material_slots.tolist()) == {1}
    square.particle_systems[0].settings.material = 9
    assert set(render_and_export(scene).meshes[1].material_slots.tolist()) == {1}


def test_windows_have_their_own_steps_and_share_of_children(scene: Any) -> None:
    _furry_square(
        child_type="INTERPOLATED", child_percent=4, rendered_child_count=9, display_step=3, display_percentage=50
    )
    assert len(export().meshes[1].vertices) == 7 * 2 * 9


def test_two_systems_are_one_mesh(scene: Any) -> None:
    square = _furry_square()
    more = square.modifiers.new("More", "PARTICLE_SYSTEM").particle_system.settings
    more.type, more.count, more.render_step = "HAIR", 3, 1
    hair = render_and_export(scene).meshes[1]
    assert len(hair.triangles) == 7 * 4 + 3 * 2
    assert len(np.unique(hair.triangles[:, 2])) == 10


@pytest.mark.parametrize("of_hair", [True, False])
def test_strands_beyond_the_memory_are_refused_by_name(
    scene: Any, monkeypatch: pytest.MonkeyPatch, of_hair: bool
) -> None:
    monkeypatch.setattr(limits, "usable_memory", lambda: 1 << 20)
    monkeypatch.setattr(limits, "swap_memory", lambda: 0)
    if of_hair:
        _furry_square()
    else:
        _add_curves(scene, [3, 2])
    with pytest.raises(ValueError, match=r"(Plane has 7|Strands has 2) strands of"):
        export()
