# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking, beside Cycles in the same process: what it gives, what stays untouched, and what is refused in words."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from addon.bake_pictures import bake_picture
from tests.helpers.bake_scenes import SIZE, add_image, bake, baked_plane, pixels_of

#: Texels that the plane's UVs cover, and that no face is at.
COVERED = (slice(0, SIZE // 2), slice(0, SIZE // 2), slice(0, 3))
OUTSIDE = slice(SIZE // 2, SIZE)
#: Errors of the difference of two means that count as found.
SIGMAS = 4.0


@pytest.fixture
def plane(blender: Any) -> tuple[Any, Any, Any]:
    """Scene, plane and image of `baked_plane`."""
    scene = blender.context.scene
    return (scene, *baked_plane(scene))


@pytest.mark.parametrize(
    ("kind", "filters"),
    [
        ("COMBINED", None),
        ("COMBINED", {"DIFFUSE", "INDIRECT", "DIRECT", "EMIT"}),
        ("COMBINED", {"GLOSSY", "DIRECT", "EMIT"}),
        ("DIFFUSE", None),
        ("DIFFUSE", {"DIRECT"}),
        ("DIFFUSE", {"INDIRECT", "COLOR"}),
        ("GLOSSY", {"DIRECT", "INDIRECT", "COLOR"}),
        ("AO", None),
        ("SHADOW", None),
    ],
)
def test_means_are_those_of_cycles(plane: Any, kind: str, filters: set[str] | None) -> None:
    """Within noise, and half a percent: noise from texels beside each other, whose means differ little."""
    scene, _, image = plane
    options: dict[str, Any] = {} if filters is None else {"pass_filter": filters}
    # As docs/differences.md says, a bake of some lobes counts bounces as Cycles' renders do, not as its bakes.
    scene.cycles.diffuse_bounces = scene.cycles.glossy_bounces = 12
    samples = 256
    if filters is not None and "DIRECT" not in filters:
        # What glossy surfaces mirror of a sun onto others is noise that no short test gets through.
        scene.objects["Sun"].data.energy, samples = 0.0, 2048
    ours, theirs = (bake(scene, image, by, kind, samples, **options)[COVERED] for by in ("NEURALGUIDE", "CYCLES"))
    difference = ours.mean(axis=-1) - theirs.mean(axis=-1)
    error = difference.std() / np.sqrt(difference.size)
    assert theirs.mean() > 1e-3
    assert abs(difference.mean()) <= SIGMAS * error
    assert abs(difference.mean()) <= 0.005 * theirs.mean()
    # Nowhere another place: shadows and colours lie where Cycles has them.
    assert np.abs(difference).max() <= 0.1 * theirs.max()


@pytest.mark.parametrize(("method", "cache"), [("AUTO", "OFF"), ("OFF", "CONVERGING")])
def test_what_is_learned_changes_no_mean(plane: Any, method: str, cache: str) -> None:
    scene, _, image = plane
    theirs = bake(scene, image, "CYCLES", "COMBINED", 1024)[COVERED]
    scene.neuralguide.radiance_cache = cache
    ours = bake(scene, image, "NEURALGUIDE", "COMBINED", 512, guiding_method=method)[COVERED]
    difference = ours.mean(axis=-1) - theirs.mean(axis=-1)
    assert abs(difference.mean()) <= SIGMAS * difference.std() / np.sqrt(difference.size)
    assert abs(difference.mean()) <= 0.005 * theirs.mean()


@pytest.mark.parametrize("kind", ["NORMAL", "EMIT", "POSITION", "ENVIRONMENT"])
def test_what_needs_no_light_is_that_of_cycles(plane: Any, kind: str) -> None:
    """Of one sample, at the texel's centre."""
    scene, _, image = plane
    ours, theirs = (bake(scene, image, by, kind, 1) for by in ("NEURALGUIDE", "CYCLES"))
    assert np.allclose(ours, theirs, rtol=1e-6, atol=2e-7)
    assert ours[COVERED].max() > 0.1


def test_what_a_bake_came_to_is_logged(plane: Any, capsys: pytest.CaptureFixture[str]) -> None:
    scene, _, image = plane
    bake(scene, image, "NEURALGUIDE", "EMIT", 2)
    assert "NeuralGuide: Bake Plane, frame 1: finished in" in capsys.readouterr().err


def test_uvs_are_baked(plane: Any) -> None:
    """Cycles has none here: it asks for the map once the mesh has been made."""
    scene, _, image = plane
    found = bake(scene, image, "NEURALGUIDE", "UV", 1)[COVERED]
    centers = (np.arange(SIZE // 2) + 0.5) / SIZE
    # Blender takes places a little off the texel's centre.
    assert np.allclose(found[..., 0], centers[None, :], atol=1e-3)
    assert np.allclose(found[..., 1], centers[:, None], atol=1e-3)


@pytest.mark.parametrize(
    "inputs",
    [
        {"Roughness": 0.3},
        {"Roughness": 0.8, "Diffuse Roughness": 0.3},
        {"Roughness": 0.8, "Metallic": 0.5, "Diffuse Roughness": 0.3},
        {"Roughness": 0.2, "Specular IOR Level": 0.0},
        {"Roughness": 0.6, "Coat Weight": 1.0, "Sheen Weight": 1.0},
        {"Roughness": 0.4, "Transmission Weight": 0.5, "Subsurface Weight": 0.5, "Alpha": 0.75},
    ],
)
def test_roughness_is_that_of_cycles(plane: Any, inputs: dict[str, float]) -> None:
    scene, flat, image = plane
    for name, value in inputs.items():
        flat.active_material.node_tree.nodes["Principled BSDF"].inputs[name].default_value = value
    ours, theirs = (bake(scene, image, by, "ROUGHNESS", 1)[COVERED] for by in ("NEURALGUIDE", "CYCLES"))
    assert np.allclose(ours, theirs, atol=2e-3)


def test_nothing_is_seen_through_a_surface(plane: Any, blender: Any) -> None:
    """A plane that lets through half: what glows behind it counts neither for its colour nor for its alpha."""
    scene, flat, image = plane
    flat.active_material.node_tree.nodes["Principled BSDF"].inputs["Alpha"].default_value = 0.5
    behind = flat.copy()
    behind.data = flat.data.copy()
    behind.location = (0.0, 0.0, -1.0)
    behind.data.materials[0] = flat.active_material.copy()
    behind.data.materials[0].node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 20.0
    scene.collection.objects.link(behind)
    behind.select_set(False)
    texels = COVERED[:2]
    ours, theirs = (bake(scene, image, by, "COMBINED", 512)[texels] for by in ("NEURALGUIDE", "CYCLES"))
    assert np.allclose(ours[..., 3], 0.5, atol=0.1)
    assert np.isclose(ours[..., 3].mean(), theirs[..., 3].mean(), rtol=0.01)
    assert np.isclose(ours[..., :3].mean(), theirs[..., :3].mean(), rtol=0.02)


def test_texels_without_a_face_stay_untouched(plane: Any) -> None:
    scene, _, image = plane
    found = bake(scene, image, "NEURALGUIDE", "EMIT", 1, use_clear=False)
    assert (found[OUTSIDE] == 0.25).all()
    assert (found[COVERED] != 0.25).any(axis=-1).all()


def test_curved_and_moved_normals_are_those_of_cycles(plane: Any, blender: Any) -> None:
    """Of a smooth sphere that is turned, stretched and mirrored, one sample a texel."""
    scene, flat, _ = plane
    blender.ops.mesh.primitive_uv_sphere_add(segments=12, ring_count=8, location=(3.0, 1.0, 2.0))
    ball = blender.context.object
    blender.ops.object.shade_smooth()
    ball.rotation_euler, ball.scale = (0.5, 0.3, 1.0), (1.0, -2.0, 0.5)
    ball.data.materials.append(flat.active_material.copy())
    image = add_image(ball, "Ball")
    for space in ("OBJECT", "TANGENT"):
        ours, theirs = (bake(scene, image, by, "NORMAL", 1, normal_space=space) for by in ("NEURALGUIDE", "CYCLES"))
        off = np.abs(ours - theirs).max(axis=-1)
        # From Blender 5.3 on texels whose centre lies beside their face look at a place by chance.
        assert (off < 2e-5).mean() >= (1.0 if blender.app.version < (5, 3, 0) else 0.6), space
        assert off.max() < 0.1, space


def test_a_face_in_the_same_place_is_not_baked_instead(plane: Any, blender: Any) -> None:
    """Two planes in one place, of which the other is brighter."""
    scene, flat, image = plane
    other = flat.copy()
    other.data = flat.data.copy()
    bright = flat.active_material.copy()
    bright.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 7.0
    other.data.materials[0] = bright
    scene.collection.objects.link(other)
    other.select_set(False)
    found = bake(scene, image, "NEURALGUIDE", "EMIT", 4)[COVERED]
    assert np.allclose(found, (0.25, 0.125, 0.5), rtol=1e-5)


def test_several_objects_share_an_image(plane: Any, blender: Any) -> None:
    """Each fills its own texels, by its own material."""
    scene, flat, image = plane
    other = flat.copy()
    other.data = flat.data.copy()
    for corner in other.data.uv_layers[0].data:
        corner.uv = (corner.uv[0] + 0.5, corner.uv[1] + 0.5)
    other.location = (4.0, 0.0, 1.0)
    scene.collection.objects.link(other)
    bright = flat.active_material.copy()
    bright.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 4.0
    other.data.materials[0] = bright
    other.select_set(True)
    found = bake(scene, image, "NEURALGUIDE", "EMIT", 1)
    # From Blender 5.3 on faces have the texels too that they only touch.
    assert np.allclose(found[COVERED][:-1, :-1], (0.25, 0.125, 0.5), rtol=1e-5)
    assert np.allclose(found[OUTSIDE, OUTSIDE, :3], (2.0, 1.0, 4.0), rtol=1e-5)


def test_details_of_another_object_are_baked(plane: Any, blender: Any) -> None:
    """Selected to active: what Blender finds on the selected object, here its emission."""
    scene, flat, image = plane
    detail = flat.copy()
    detail.data = flat.data.copy()
    detail.location = (0.0, 0.0, 0.01)
    detail.data.materials[0] = flat.active_material.copy()
    detail.data.materials[0].node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 2.0
    scene.collection.objects.link(detail)
    detail.select_set(True)
    blender.context.view_layer.objects.active = flat
    options: dict[str, Any] = {"use_selected_to_active": True, "cage_extrusion": 0.1}
    found = bake(scene, image, "NEURALGUIDE", "EMIT", 1, **options)[COVERED]
    assert np.allclose(found, (1.0, 0.5, 2.0), rtol=1e-5)


@pytest.mark.parametrize("domain", ["CORNER", "POINT"])
def test_colour_attributes_are_those_of_cycles(plane: Any, domain: str) -> None:
    scene, flat, image = plane
    attribute = flat.data.color_attributes.new("Baked", "FLOAT_COLOR", domain)
    flat.data.color_attributes.active_color = attribute
    found = {}
    for by in ("NEURALGUIDE", "CYCLES"):
        bake(scene, image, by, "DIFFUSE", 1024, target="VERTEX_COLORS")
        values = np.empty(4 * len(attribute.data), np.float32)
        flat.data.color_attributes["Baked"].data.foreach_get("color", values)
        found[by] = values.reshape(-1, 4)[:, :3]
    assert found["CYCLES"].min() > 0.1
    assert np.allclose(found["NEURALGUIDE"], found["CYCLES"], rtol=0.05)


def test_tiles_are_baked_each(plane: Any) -> None:
    """Half of the plane's UVs lie on the second tile."""
    scene, flat, _ = plane
    image = add_image(flat, "Tiles", tiles=2)
    for corner in flat.data.uv_layers[0].data:
        corner.uv = (4.0 * corner.uv[0], 2.0 * corner.uv[1])
    bake(scene, image, "NEURALGUIDE", "EMIT", 1)
    for number in (1001, 1002):
        image.tiles.active = image.tiles.get(number)
    assert np.allclose(pixels_of(image)[..., :3], (0.25, 0.125, 0.5), rtol=1e-5)


def test_glossy_surfaces_are_seen_from_the_camera(plane: Any, blender: Any) -> None:
    """Where Blender is to look from the active camera, which sees the sun's glint, as in Cycles."""
    scene, flat, image = plane
    surface = flat.active_material.node_tree.nodes["Principled BSDF"]
    surface.inputs["Metallic"].default_value, surface.inputs["Roughness"].default_value = 1.0, 0.4
    camera = blender.data.objects.new("Camera", blender.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler = (0.5, -3.0, 2.0), (0.9, 0.0, 0.1)
    scene.collection.objects.link(camera)
    scene.camera = camera
    options: dict[str, Any] = {"pass_filter": {"DIRECT", "INDIRECT", "COLOR"}}
    above = bake(scene, image, "CYCLES", "GLOSSY", 64, **options)[COVERED]
    scene.render.bake.view_from = "ACTIVE_CAMERA"
    ours, theirs = (bake(scene, image, by, "GLOSSY", 256, **options)[COVERED] for by in ("NEURALGUIDE", "CYCLES"))
    assert abs(ours.mean() / theirs.mean() - 1.0) < 0.005
    assert abs(above.mean() / theirs.mean() - 1.0) > 0.05
    assert np.abs(ours - theirs).max() < 0.15 * theirs.max()


def test_a_bake_without_uvs_is_refused_by_blender(plane: Any, blender: Any) -> None:
    scene, flat, image = plane
    flat.data.uv_layers.remove(flat.data.uv_layers[0])
    with pytest.raises(RuntimeError, match="No active UV layer found"):
        bake(scene, image, "NEURALGUIDE", "EMIT", 1)


def test_a_bake_without_faces_is_refused_by_blender(plane: Any, blender: Any) -> None:
    scene, flat, image = plane
    flat.data.clear_geometry()
    with pytest.raises(RuntimeError, match="No faces found"):
        bake(scene, image, "NEURALGUIDE", "EMIT", 1)


def test_what_is_not_built_is_refused_in_words() -> None:
    with pytest.raises(ValueError, match="NeuralGuide cannot bake VECTOR: choose one of AO, COMBINED"):
        bake_picture("VECTOR", 0)


def test_a_camera_to_bake_from_has_to_be_there(plane: Any) -> None:
    scene, _, image = plane
    scene.render.bake.view_from = "ACTIVE_CAMERA"
    with pytest.raises(RuntimeError, match="has no camera to bake from"):
        bake(scene, image, "NEURALGUIDE", "COMBINED", 1)


def test_objects_that_no_ray_meets_are_refused_in_words(plane: Any) -> None:
    scene, flat, image = plane
    for name in ("camera", "diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
        setattr(flat, f"visible_{name}", False)
    if hasattr(flat, "visible_raycast"):
        flat.visible_raycast = False
    with pytest.raises(RuntimeError, match="'Plane' is in no render"):
        bake(scene, image, "NEURALGUIDE", "EMIT", 1)


def test_light_is_a_sum_of_passes_with_their_colour() -> None:
    """Twice the direct light and once the indirect one, of a colour of 0.5."""
    images = {
        f"Diffuse {name}": np.full((1, 1, 3), value, np.float32)
        for name, value in (("Direct", 2.0), ("Indirect", 1.0), ("Color", 0.5))
    }
    direct, indirect, color = 1 << 6, 1 << 7, 1 << 8
    for bits, value in ((direct, 2.0), (direct | indirect, 3.0), (direct | indirect | color, 1.5), (color, 0.5)):
        picture = bake_picture("DIFFUSE", bits)
        assert picture.compose({name: images[name] for name in picture.passes}).ravel().tolist() == [value] * 3 + [1.0]
