# SPDX-License-Identifier: GPL-3.0-or-later
"""Images in tiles (UDIM): each tile is an image, and one more tells where they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.scene.description import Image, SceneDescription
from tests.helpers.blender_scenes import empty_scene, export


@pytest.fixture
def node() -> Any:
    """An image texture on the only object."""
    import bpy

    empty_scene()
    bpy.ops.mesh.primitive_plane_add()
    material = bpy.data.materials.new("Material")
    bpy.context.object.data.materials.append(material)
    tree = material.node_tree
    texture, shader = tree.nodes.new("ShaderNodeTexImage"), tree.nodes["Principled BSDF"]
    tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    return texture


def shown(description: SceneDescription) -> Image:
    """What the texture node shows."""
    graph = description.materials[0].graph
    assert graph is not None
    texture = next(node for node in graph.nodes if node.kind == "ShaderNodeTexImage")
    return description.images[texture.properties["image"]]


def write(path: Path, red: int) -> None:
    """A file of one colour."""
    import bpy

    image = bpy.data.images.new("Written", 3, 2, alpha=True)
    image.pixels.foreach_set(np.tile(np.float32([red / 255.0, 0.0, 0.0, 1.0]), 6))
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)


@pytest.mark.parametrize("mark", ["<UDIM>", "<UVTILE>"])
@pytest.mark.parametrize("is_packed", [False, True])
def test_tiles_are_images(node: Any, tmp_path: Path, mark: str, is_packed: bool) -> None:
    import bpy

    from addon.export import ExportCache

    for number, place, red in ((1001, "u1_v1", 10), (1003, "u3_v1", 20), (1011, "u1_v2", 30)):
        name = str(number) if mark == "<UDIM>" else place
        write(tmp_path / f"tile.{name}.png", red)
    node.image = bpy.data.images.load(str(tmp_path / f"tile.{mark}.png"))
    node.image.source = "TILED"
    if is_packed:
        node.image.pack()
        for file in tmp_path.glob("tile*"):
            file.unlink()
    cache = ExportCache()
    for _ in range(2):
        description = export(cache=cache)
        assert description.notices == []
        found = {number: description.images[index] for number, index in shown(description).tiles}
        assert {number: int(tile.pixels[0, 0, 0]) for number, tile in found.items()} == {1001: 10, 1003: 20, 1011: 30}
        assert all(tile.encoding == shown(description).encoding == "SRGB" for tile in found.values())
    if not is_packed:
        (tmp_path / ("tile.1003.png" if mark == "<UDIM>" else "tile.u3_v1.png")).unlink()
        again = export(cache=cache)
        assert shown(again).key != shown(description).key
        assert ["tile 1003" in notice.problem for notice in again.notices] == [True]


@pytest.mark.parametrize("is_packed", [False, True])
def test_unsaved_paint_is_shown(node: Any, tmp_path: Path, is_packed: bool) -> None:
    import bpy

    from addon.export import ExportCache

    for number in (1001, 1002):
        write(tmp_path / f"tile.{number}.png", 10)
    image = node.image = bpy.data.images.load(str(tmp_path / "tile.<UDIM>.png"))
    image.source = "TILED"
    if is_packed:
        image.pack()
    cache = ExportCache()

    def reds() -> dict[int, int]:
        description = export(cache=cache)
        assert not description.notices
        return {number: int(description.images[i].pixels[0, 0, 0]) for number, i in shown(description).tiles}

    assert reds() == {1001: 10, 1002: 10}
    for red in (70, 80):
        image.pixels.foreach_set(np.tile(np.float32([red / 255.0, 0.0, 0.0, 1.0]), 6))
        assert reds() == {1001: red, 1002: 10}
    assert image.is_dirty and image.filepath_raw == str(tmp_path / "tile.<UDIM>.png")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["tile.1001.png", "tile.1002.png"]


@pytest.mark.parametrize("is_float", [False, True])
def test_tiles_that_were_never_saved_are_shown(node: Any, is_float: bool) -> None:
    import bpy

    image = node.image = bpy.data.images.new("Tiles", 2, 2, tiled=True, float_buffer=is_float)
    image.tiles.new(tile_number=1002)
    image.tiles.active_index = 1
    with bpy.context.temp_override(edit_image=image):
        bpy.ops.image.tile_fill(color=(1.0, 0.0, 0.0, 1.0), width=4, height=4, float=is_float)
    if is_float:
        image.pixels.foreach_set(np.tile(np.float32([2.5, 0.1, 0.0, 1.0]), 4))
    description = export()
    assert not description.notices
    first, second = (description.images[i].pixels for _, i in shown(description).tiles)
    assert first.shape[:2] == (2, 2) and second.shape[:2] == (4, 4)
    np.testing.assert_allclose(first[0, 0], (2.5, 0.1, 0.0, 1.0) if is_float else (0, 0, 0, 255), rtol=1e-6)
    assert second[0, 0].tolist() == ([1.0, 0.0, 0.0, 1.0] if is_float else [255, 0, 0, 255])
    assert image.file_format == "PNG"
