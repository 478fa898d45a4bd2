# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes of what is not as it should be, beside Cycles: UVs over each other, UVs by modifiers, tiles, images that are
too large, and bakes that are cancelled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from addon import engine
from benchmarks.images import read_exr
from engine.scene import limits
from tests.helpers.bake_scenes import SIZE, add_image, bake, baked_plane, pixels_of

bpy = pytest.importorskip("bpy")


@pytest.fixture
def plane(blender: Any) -> tuple[Any, Any, Any]:
    """Scene, plane and image of `baked_plane`."""
    scene = blender.context.scene
    return (scene, *baked_plane(scene))


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Notices that bakes show."""
    from addon import baking

    texts: list[str] = []

    def show(_engine: Any, notices: list[Any]) -> None:
        texts.extend(f"{one.subject}: {one.problem}" for one in notices)

    monkeypatch.setattr(baking, "show_notices", show)
    return texts


def two_faces(flat: Any) -> None:
    """Give the plane a second face beside it, of another height, with the UVs of the first."""
    mesh = flat.data
    corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (1, -1, 0.5), (3, -1, 0.5), (3, 1, 0.5), (1, 1, 0.5)]
    mesh.clear_geometry()
    mesh.from_pydata(corners, [], [(0, 1, 2, 3), (4, 5, 6, 7)])
    layer = mesh.uv_layers.new(name="UVMap")
    for corner, uv in zip(layer.data, [(0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (0.0, 0.5)] * 2, strict=True):
        corner.uv = uv
    mesh.update()


def are_alike(ours: np.ndarray, theirs: np.ndarray) -> bool:
    """Whether bakes of one sample are the same; as many texels have a face.

    From Blender 5.3 on texels whose centre lies beside their face look at a place by chance.
    """
    is_same = np.isclose(ours, theirs, rtol=1e-5, atol=1e-5).all(axis=-1)
    least = 1.0 if bpy.app.version < (5, 3, 0) else 0.6
    return bool(np.array_equal(ours[..., 3], theirs[..., 3]) and is_same.mean() >= least)


def beside_cycles(scene: Any, image: Any, kind: str = "POSITION") -> np.ndarray:
    """A bake of one sample a texel, which is that of Cycles."""
    ours, theirs = (bake(scene, image, by, kind, 1) for by in ("NEURALGUIDE", "CYCLES"))
    assert are_alike(ours, theirs)
    assert np.abs(ours[..., :3]).max() > 0.1
    return ours


def test_of_faces_over_each_other_the_last_is_baked_and_the_object_is_named(plane: Any, said: list[str]) -> None:
    scene, flat, image = plane
    two_faces(flat)
    found = beside_cycles(scene, image)
    # Inside, where both faces are whatever Blender counts as touched.
    inner = found[1 : SIZE // 2 - 1, 1 : SIZE // 2 - 1]
    assert inner[..., 0].min() > 1.0 and np.allclose(inner[..., 2], 0.5)
    share = "50%" if bpy.app.version < (5, 3, 0) else "%"
    assert len(said) == 1 and said[0].startswith("Object Plane: UVs of its faces overlap: ") and share in said[0]


@pytest.mark.parametrize("size", [SIZE, 64, 7])
def test_faces_beside_each_other_are_not_said_to_overlap(size: int, plane: Any, said: list[str]) -> None:
    """Triangles, quads and a sphere with poles, whose UVs have gaps and touch."""
    scene, flat, image = plane
    bake(scene, image, "NEURALGUIDE", "EMIT", 1)
    flat.select_set(False)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=24, ring_count=12)
    ball = bpy.context.object
    ball.data.materials.append(flat.active_material.copy())
    bake(scene, add_image(ball, "Ball", size), "NEURALGUIDE", "EMIT", 1)
    assert said == []


def test_faces_on_other_images_and_tiles_are_not_said_to_overlap(plane: Any, said: list[str]) -> None:
    """Each of two materials has its image; a face that reaches into the next tile has texels there."""
    scene, flat, _ = plane
    two_faces(flat)
    other = flat.active_material.copy()
    flat.data.materials.append(other)
    flat.data.polygons[1].material_index = 1
    flat.active_material_index = 1
    add_image(flat, "Other")
    flat.active_material_index = 0
    tiles = add_image(flat, "Tiles", tiles=2)
    for corner in list(flat.data.uv_layers[0].data)[:4]:
        corner.uv = (2.5 * corner.uv[0], corner.uv[1])
    bake(scene, tiles, "NEURALGUIDE", "EMIT", 1)
    assert said == []


def test_attributes_have_no_overlap(plane: Any, said: list[str]) -> None:
    scene, flat, image = plane
    two_faces(flat)
    flat.data.color_attributes.active_color = flat.data.color_attributes.new("Baked", "FLOAT_COLOR", "CORNER")
    bake(scene, image, "NEURALGUIDE", "EMIT", 1, target="VERTEX_COLORS")
    assert said == []


def mirror(flat: Any) -> None:
    """A copy on the other side, whose UVs lie beside those of the first."""
    for vertex in flat.data.vertices:
        vertex.co.x += 1.5
    modifier = flat.modifiers.new("Mirror", "MIRROR")
    modifier.offset_u = 0.5


def warp(flat: Any) -> None:
    modifier = flat.modifiers.new("Warp", "UV_WARP")
    modifier.uv_layer = flat.data.uv_layers[0].name
    modifier.offset, modifier.scale = (0.25, 0.125), (0.75, 1.5)


def project(flat: Any) -> None:
    projector = bpy.data.objects.new("Projector", None)
    projector.rotation_euler = (0.3, 0.2, 0.1)
    bpy.context.scene.collection.objects.link(projector)
    modifier = flat.modifiers.new("Project", "UV_PROJECT")
    modifier.uv_layer = flat.data.uv_layers[0].name
    modifier.projectors[0].object = projector


def repeat(flat: Any) -> None:
    modifier = flat.modifiers.new("Array", "ARRAY")
    modifier.count, modifier.offset_u, modifier.offset_v = 2, 0.5, 0.5


def divide(flat: Any) -> None:
    modifier = flat.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = modifier.render_levels = 2
    modifier.uv_smooth = "SMOOTH_ALL"


@pytest.mark.parametrize("change", [mirror, warp, project, repeat, divide])
def test_uvs_that_modifiers_make_count(change: Any, plane: Any, said: list[str]) -> None:
    scene, flat, image = plane
    plain = bake(scene, image, "NEURALGUIDE", "POSITION", 1)
    change(flat)
    found = beside_cycles(scene, image)
    assert not np.allclose(found, plain, atol=0.01), "the modifier changes something"
    assert said == []


@pytest.mark.parametrize("is_cleared", [True, False])
def test_tiles_of_several_sizes_and_rows_are_those_of_cycles(is_cleared: bool, plane: Any, tmp_path: Path) -> None:
    """Faces on tiles 1001, 1002 and 1011, none on 1012, which the image has, and one on 1003, which it lacks."""
    scene, flat, _ = plane
    image = add_image(flat, "Tiles", tiles=2)
    for number, size in ((1011, 32), (1012, 8)):
        image.tiles.active = image.tiles.new(number)
        with bpy.context.temp_override(edit_image=image):
            bpy.ops.image.tile_fill(width=size, height=2 * size, float=True, alpha=True)
    mesh = flat.data
    mesh.clear_geometry()
    corners, faces, uvs = [], [], []
    for index, (column, row) in enumerate(((0, 0), (1, 0), (0, 1), (2, 0))):
        square = [(0.1, 0.1), (0.9, 0.2), (0.8, 0.9), (0.2, 0.7)]
        faces.append(tuple(range(4 * index, 4 * index + 4)))
        corners += [(2.0 * index + x, y, 0.3 * index) for x, y in square]
        uvs += [(column + x, row + y) for x, y in square]
    mesh.from_pydata(corners, [], faces)
    layer = mesh.uv_layers.new(name="UVMap")
    for corner, uv in zip(layer.data, uvs, strict=True):
        corner.uv = uv
    found = {}
    for by in ("NEURALGUIDE", "CYCLES"):
        bake(scene, image, by, "POSITION", 1, use_clear=is_cleared)
        image.file_format, image.filepath_raw = "OPEN_EXR", str(tmp_path / f"{by}.<UDIM>.exr")
        image.save()
        found[by] = [read_exr(tmp_path / f"{by}.{tile.number}.exr")[0] for tile in image.tiles]
    is_covered = [bool(np.abs(pixels[..., :3]).max() > 0.1) for pixels in found["NEURALGUIDE"]]
    assert [tile.number for tile in image.tiles] == [1001, 1002, 1011, 1012]
    assert is_covered == [True, True, True, False]
    assert [pixels.shape[:2] for pixels in found["NEURALGUIDE"]] == [(16, 16), (16, 16), (64, 32), (16, 8)]
    for ours, theirs in zip(*found.values(), strict=True):
        assert are_alike(ours, theirs)


def test_an_image_that_memory_does_not_hold_is_refused(plane: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything is made for it: 16384 x 16384 texels on a machine of 48 GiB, 12 of them free. Half of that is
    enough for 8192 x 8192, since no more than a band of them has a film.
    """
    with monkeypatch.context() as patched:
        patched.setattr(limits, "usable_memory", lambda: 48 << 30)
        patched.setattr(limits, "swap_memory", lambda: 0)
        patched.setattr(limits, "resident_memory", lambda: 36 << 30)
        limits.check_baked_image(8192, 8192, "object 'Plane'")
        with pytest.raises(
            ValueError, match=r"object 'Plane': to bake an image of 16384 x 16384 pixels needs 52 GiB of memory"
        ):
            limits.check_baked_image(16384, 16384, "object 'Plane'")
    scene, _, image = plane
    monkeypatch.setattr(limits, "usable_memory", lambda: 1 << 20)
    with pytest.raises(RuntimeError, match="object 'Plane': to bake an image of 16 x 16 pixels needs"):
        bake(scene, image, "NEURALGUIDE", "EMIT", 1)


def test_a_bake_that_is_cancelled_before_its_first_sample_ends_at_once(
    plane: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What Blender writes then is its own: texels that no face has stay, and the next bake is whole."""
    scene, _, image = plane
    monkeypatch.setattr(engine, "cancel_hooks", [lambda: True])
    found = bake(scene, image, "NEURALGUIDE", "COMBINED", 1 << 20, use_clear=False)
    assert (found[SIZE // 2 :] == 0.25).all()
    assert not found[: SIZE // 2, : SIZE // 2].any()
    monkeypatch.setattr(engine, "cancel_hooks", [])
    assert (bake(scene, image, "NEURALGUIDE", "EMIT", 1)[: SIZE // 2, : SIZE // 2, :3] > 0.1).all()


def test_a_bake_that_is_cancelled_leaves_what_it_has(plane: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A million samples a texel, of which some are there: the picture is that of few samples."""
    from addon.progress import TerminalBar

    scene, _, image = plane
    whole = bake(scene, image, "NEURALGUIDE", "COMBINED", 64)[: SIZE // 2, : SIZE // 2]
    samples: list[int] = []
    monkeypatch.setattr(TerminalBar, "update", lambda _self, _title, _share, progress: samples.append(progress.sample))
    monkeypatch.setattr(engine, "cancel_hooks", [lambda: bool(samples) and samples[-1] > 8])
    found = bake(scene, image, "NEURALGUIDE", "COMBINED", 1 << 20)[: SIZE // 2, : SIZE // 2]
    assert found.mean() == pytest.approx(whole.mean(), rel=0.05)
    assert 8 < samples[-1] < 1 << 19


def test_the_second_of_two_objects_without_faces_is_named(plane: Any) -> None:
    scene, flat, image = plane
    other = flat.copy()
    other.name, other.data = "Empty", flat.data.copy()
    other.data.clear_geometry()
    scene.collection.objects.link(other)
    other.select_set(True)
    with pytest.raises(RuntimeError, match=r'No faces found in the object "Empty"'):
        bake(scene, image, "NEURALGUIDE", "EMIT", 1)
    assert (pixels_of(image) == 0.25).all()


def test_the_second_of_two_objects_without_uvs_is_named(plane: Any) -> None:
    scene, flat, image = plane
    other = flat.copy()
    other.name, other.data = "Bare", flat.data.copy()
    other.data.uv_layers.remove(other.data.uv_layers[0])
    scene.collection.objects.link(other)
    other.select_set(True)
    with pytest.raises(RuntimeError, match=r'No active UV layer found in the object "Bare"'):
        bake(scene, image, "NEURALGUIDE", "EMIT", 1)
    assert (pixels_of(image) == 0.25).all()


def test_an_object_whose_faces_a_modifier_takes_away_is_named(plane: Any) -> None:
    """Blender lets it through, and Cycles 5.0 ends Blender there."""
    scene, flat, image = plane
    modifier = flat.modifiers.new("Mask", "MASK")
    modifier.vertex_group = flat.vertex_groups.new(name="None").name
    with pytest.raises(RuntimeError, match=r"object 'Plane' is in no render.*: it may have no faces"):
        bake(scene, image, "NEURALGUIDE", "EMIT", 1)
