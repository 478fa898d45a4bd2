# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of texture nodes: where they come from, how their values are stored, what happens if they are missing."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.scene.description import Image, SceneDescription
from engine.scene.image import is_multiplied
from engine.shaders.compiled_program import ProgramSource
from engine.shaders.compiler import compile_programs
from engine.shaders.image_pool import build_image_pool
from tests.helpers.blender_scenes import Altered, empty_scene, export, export_context


@pytest.fixture
def node() -> Any:
    """An image texture on the only object."""
    import bpy

    empty_scene()
    bpy.ops.mesh.primitive_plane_add()
    material = bpy.data.materials.new("Material")
    bpy.context.object.data.materials.append(material)
    tree = material.node_tree
    tree.nodes.clear()
    texture, emission = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(texture.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], output.inputs[0])
    return texture


def shown(description: SceneDescription | None = None) -> Image | None:
    """What the texture node shows."""
    description = description or export()
    graph = description.materials[0].graph
    assert graph is not None
    return description.images[index] if (index := graph.nodes[0].properties["image"]) >= 0 else None


def make_image(pixels: Any, name: str = "Image", *, is_float: bool = False, space: str | None = None) -> Any:
    """A generated image with `pixels` of shape (height, width, 4)."""
    import bpy

    pixels = np.asarray(pixels, np.float32)
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=is_float)
    if space is not None:
        image.colorspace_settings.name = space
    image.pixels.foreach_set(pixels.reshape(-1))
    image.update()
    return image


def gradient(width: int = 3, height: int = 2) -> np.ndarray:
    """Byte values that tell row, column and channel apart."""
    return np.arange(width * height * 4, dtype=np.uint8).reshape(height, width, 4) * 7 + 3


def write(path: Path, pixels: np.ndarray, file_format: str = "PNG", *, is_float: bool = False) -> None:
    import bpy

    image = make_image(pixels, "Written", is_float=is_float, space="Non-Color")
    image.filepath_raw, image.file_format = str(path), file_format
    image.save()
    bpy.data.images.remove(image)


def test_byte_image_keeps_its_bytes(node: Any) -> None:
    stored = gradient()
    node.image = make_image(stored / 255.0)
    image = shown()
    assert image is not None and image.name == "Image"
    assert image.pixels.dtype == np.uint8 and image.encoding == "SRGB" and not image.is_associated
    np.testing.assert_array_equal(image.pixels, stored)
    assert node.image.alpha_mode == image.alpha_mode == "STRAIGHT"


def test_every_byte_value_survives(node: Any) -> None:
    stored = np.arange(256, dtype=np.uint8).reshape(1, 64, 4)
    node.image = make_image(stored / 255.0)
    image = shown()
    assert image is not None
    np.testing.assert_array_equal(image.pixels, stored)


@pytest.mark.parametrize(
    ("space", "encoding"), [("Non-Color", "RAW"), ("Linear Rec.709", "LINEAR"), ("sRGB", "SRGB")]
)
def test_encodings_of_bytes(node: Any, space: str, encoding: str) -> None:
    node.image = make_image(gradient() / 255.0, space=space)
    image = shown()
    assert image is not None and image.encoding == encoding and image.pixels.dtype == np.uint8


def test_float_image_is_linear(node: Any) -> None:
    values = np.random.default_rng(1).random((2, 3, 4)).astype(np.float32) * 4.0
    node.image = make_image(values, is_float=True)
    image = shown()
    assert image is not None and image.pixels.dtype == np.float32 and image.is_associated
    assert image.encoding == "LINEAR"
    np.testing.assert_array_equal(image.pixels, values)


@pytest.mark.parametrize("space", ["Linear Rec.2020", "ACEScg", "Linear CIE-XYZ D65", "Linear DCI-P3 D65"])
def test_wide_spaces_agree_with_blenders_own_conversion(node: Any, tmp_path: Path, space: str) -> None:
    """Blender converts float files on loading; bytes of the same values must come out the same from us."""
    import bpy

    values = np.full((1, 2, 4), 1.0, np.float32)
    values[0, :, :3] = [(1.0, 0.2, 0.0), (0.0, 1.0, 0.6)]
    path = tmp_path / "wide.exr"
    write(path, values, "OPEN_EXR", is_float=True)
    reference = bpy.data.images.load(str(path))
    reference.colorspace_settings.name = space
    expected = np.empty(values.size, np.float32)
    reference.pixels.foreach_get(expected)
    node.image = make_image(values, space=space)
    image = shown()
    assert image is not None and image.encoding == "LINEAR" and image.pixels.dtype == np.float32
    np.testing.assert_allclose(image.pixels, expected.reshape(values.shape), atol=2e-3)


#: Of curves, of curves and a matrix, of tables; those of cameras are new in Blender 5.2.
CONVERTED = [
    "Filmic sRGB", "ACEScct", "AgX Base sRGB", "S-Log3 S-Gamut3.Cine", "V-Log V-Gamut", "Linear ARRI Wide Gamut 4",
    "Gamma 2.2 Encoded AdobeRGB",
]  # fmt: skip


@pytest.mark.parametrize("space", CONVERTED)
def test_blender_converts_spaces_that_have_no_formula_here(node: Any, tmp_path: Path, space: str) -> None:
    """As it converts the same numbers from a file of floats."""
    import bpy

    if space not in bpy.types.ColorManagedInputColorspaceSettings.bl_rna.properties["name"].enum_items:
        pytest.skip(f"this Blender does not have {space}")
    stored = gradient()
    values = (stored / 255.0).astype(np.float32)
    opaque = values.copy()
    opaque[..., 3] = 1.0
    write(tmp_path / "same.exr", opaque, "OPEN_EXR", is_float=True)
    reference = bpy.data.images.load(str(tmp_path / "same.exr"))
    reference.colorspace_settings.name = space
    expected = np.empty(values.size, np.float32)
    reference.pixels.foreach_get(expected)
    count = len(bpy.data.images)
    node.image = make_image(values, space=space)
    description = export()
    image = shown(description)
    assert image is not None and image.encoding == "LINEAR" and image.pixels.dtype == np.float32
    np.testing.assert_allclose(image.pixels[..., :3], expected.reshape(values.shape)[..., :3], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(image.pixels[..., 3], values[..., 3], atol=1e-6)
    assert description.notices == [] and len(bpy.data.images) == count + 1


def test_unknown_space_is_reported() -> None:
    """One of another configuration of colours than Blender's own."""
    from addon.export.images import ImageExporter

    empty_scene()
    stored = make_image(gradient() / 255.0)
    settings = Altered(stored.colorspace_settings, name="Studio Log")
    context = export_context()
    exporter = ImageExporter(context)
    assert exporter.export(Altered(stored, colorspace_settings=settings), None, "Plane / Material / Texture") == 0
    image = exporter.images[0]
    assert image.encoding == "SRGB"
    np.testing.assert_array_equal(image.pixels, gradient())
    assert len(context.notices) == 1 and "Studio Log" in context.notices[0].problem


def test_external_packed_and_relative_files(node: Any, tmp_path: Path) -> None:
    import bpy

    stored = gradient()
    write(tmp_path / "texture.png", stored / 255.0)
    node.image = bpy.data.images.load(str(tmp_path / "texture.png"))
    image = shown()
    assert image is not None
    np.testing.assert_array_equal(image.pixels, stored)
    node.image.pack()
    (tmp_path / "texture.png").unlink()
    image = shown()
    assert image is not None
    np.testing.assert_array_equal(image.pixels, stored)


def test_blender_keeps_pixels_it_had_not_up_to_a_number_of_bytes(
    node: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import bpy

    from addon.export import images

    write(tmp_path / "first.png", gradient() / 255.0)
    write(tmp_path / "second.png", gradient() / 255.0)
    first, second = (bpy.data.images.load(str(tmp_path / f"{name}.png")) for name in ("first", "second"))
    monkeypatch.setattr(images, "MOST_LEFT", gradient().nbytes)
    exporter = images.ImageExporter(export_context())
    exporter.export(first, None, "Material")
    exporter.export(second, None, "Material")
    assert first.has_data and not second.has_data


def test_of_many_pixels_blender_keeps_only_those_it_had(
    node: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import bpy

    from addon.export import images

    monkeypatch.setattr(images, "MOST_LEFT", 0)
    stored = gradient()
    write(tmp_path / "texture.png", stored / 255.0)
    node.image = bpy.data.images.load(str(tmp_path / "texture.png"))
    assert not node.image.has_data
    shown()
    assert not node.image.has_data, "a second copy of every texture for the whole of the render"
    assert node.image.pixels[0] == pytest.approx(stored[0, 0, 0] / 255.0), "read again when asked for"
    shown()
    assert node.image.has_data, "somebody looks at it"


def test_byte_images_lie_as_in_the_pool_which_is_no_copy(node: Any) -> None:
    from addon.export.images import ImageExporter
    from engine.shaders.image_pool import build_image_pool

    rng = np.random.default_rng(1)
    stored = [rng.integers(0, 256, (height, 5, 4), np.uint8) for height in (3, 40_000, 7)]
    for pixels in stored:
        pixels[..., 3] = 255
    exporter = ImageExporter(export_context())
    for pixels in stored:
        exporter.export(make_image(pixels / 255.0), None, "Material")
    exporter.close()
    pool = build_image_pool(exporter.images)
    for image, pixels in zip(exporter.images, stored, strict=True):
        np.testing.assert_array_equal(image.pixels, pixels)
        assert np.shares_memory(image.pixels, pool.pixels_byte)
    np.testing.assert_array_equal(pool.pixels_byte, np.concatenate([pixels.ravel() for pixels in stored]))
    assert pool.pixels_byte.base is not None, "the memory that they were read into"


def test_a_pool_changes_no_pixels_that_it_was_not_made_for(node: Any) -> None:
    from addon.export.images import ImageExporter
    from engine.shaders.image_pool import build_image_pool

    opaque, clear = np.full((2, 3, 4), 255, np.uint8), np.full((2, 3, 4), 100, np.uint8)
    exporter = ImageExporter(export_context())
    for pixels in (opaque, clear):
        exporter.export(make_image(pixels / 255.0), None, "Material")
    exporter.close()
    pool = build_image_pool(exporter.images)
    np.testing.assert_array_equal(exporter.images[1].pixels, clear)
    assert pool.pixels_byte[opaque.size :].reshape(-1, 4)[0].tolist() == [39, 39, 39, 100]


def test_images_without_room_side_by_side_have_memory_of_their_own(node: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from addon.export import image_memory
    from addon.export.images import ImageExporter

    stored = [gradient(), gradient(8, 4), gradient(2, 2)]
    monkeypatch.setattr(image_memory, "SIZE", 4 * stored[1].size + 8)
    exporter = ImageExporter(export_context())
    for pixels in stored:
        exporter.export(make_image(pixels / 255.0), None, "Material")
    exporter.close()
    for image, pixels in zip(exporter.images, stored, strict=True):
        np.testing.assert_array_equal(image.pixels, pixels)
    assert not any(np.shares_memory(stored[0], image.pixels) for image in exporter.images)


def test_half_and_grey_files_have_four_channels(node: Any, tmp_path: Path) -> None:
    import bpy

    path = tmp_path / "grey.png"
    image = make_image(np.full((2, 2, 4), 0.5), "Grey", space="Non-Color")
    settings = bpy.context.scene.render.image_settings
    settings.file_format, settings.color_mode = "PNG", "BW"
    bpy.context.scene.view_settings.view_transform = "Raw"
    image.save_render(str(path))
    node.image = bpy.data.images.load(str(path))
    node.image.colorspace_settings.name = "Non-Color"
    exported = shown()
    assert exported is not None and exported.pixels.shape == (2, 2, 4)
    assert (exported.pixels[..., 3] == 255).all() and np.ptp(exported.pixels[..., :3]) == 0


def save_half_transparent(path: Path, file_format: str, depth: str) -> None:
    """A file of one colour, linear (0.246, 0.912, 0.7) by alpha 0.5, stored as sRGB unless the format is linear."""
    import bpy

    settings = bpy.context.scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = file_format, "RGBA", depth
    bpy.context.scene.view_settings.view_transform = "Standard"
    image = make_image(np.full((2, 2, 4), (0.123, 0.456, 0.35, 0.5)), "Source", is_float=True)
    image.save_render(str(path), scene=bpy.context.scene)
    bpy.data.images.remove(image)


#: As the files of `save_half_transparent` store their colours, and these times alpha.
STORED = np.array([0.5333, 0.9608, 0.8549])
MULTIPLIED = 0.5 * STORED


def as_pooled(image: Image | None) -> np.ndarray:
    """The first texel as kernels filter it."""
    assert image is not None
    pool = build_image_pool([image])
    if image.pixels.dtype == np.uint8:
        return pool.pixels_byte[:3] / 255.0
    return pool.pixels_float[:3]


def is_by_setting() -> bool:
    """Whether Cycles goes by the image's setting, not by what the file says of itself."""
    import bpy

    return bpy.app.version >= (5, 2)


@pytest.mark.parametrize(("file_format", "depth"), [("PNG", "8"), ("PNG", "16"), ("TIFF", "8"), ("TARGA", "8")])
@pytest.mark.parametrize("mode", ["STRAIGHT", "PREMUL", "CHANNEL_PACKED", "NONE"])
def test_alpha_of_straight_files(node: Any, tmp_path: Path, file_format: str, depth: str, mode: str) -> None:
    import bpy

    path = tmp_path / "half"
    save_half_transparent(path, file_format, depth)
    node.image = bpy.data.images.load(str(path))
    node.image.alpha_mode = mode
    exported = shown()
    assert exported is not None and exported.encoding == "SRGB" and exported.alpha_mode == mode
    leaves_colors = mode in ("CHANNEL_PACKED", "NONE") or mode == "PREMUL" and is_by_setting()
    np.testing.assert_allclose(as_pooled(exported), STORED if leaves_colors else MULTIPLIED, atol=0.006)
    assert is_multiplied(exported) == (mode in ("STRAIGHT", "PREMUL"))
    node.image.colorspace_settings.name = "Non-Color"
    np.testing.assert_allclose(as_pooled(shown()), STORED, atol=0.006)


@pytest.mark.parametrize("mode", ["STRAIGHT", "PREMUL"])
def test_alpha_of_multiplied_files(node: Any, tmp_path: Path, mode: str) -> None:
    import bpy

    node.image = None
    for name, file_format, depth, stored in (
        ("half.tif", "TIFF", "16", MULTIPLIED),
        ("half.exr", "OPEN_EXR", "32", (0.123, 0.456, 0.35)),
    ):
        path = tmp_path / name
        save_half_transparent(path, file_format, depth)
        node.image = bpy.data.images.load(str(path))
        node.image.alpha_mode = mode
        factor = 0.5 if mode == "STRAIGHT" and is_by_setting() else 1.0
        np.testing.assert_allclose(as_pooled(shown()), factor * np.array(stored), atol=2e-3)


def test_packed_files_are_blenders_own(node: Any, tmp_path: Path) -> None:
    import bpy

    path = tmp_path / "half.png"
    save_half_transparent(path, "PNG", "16")
    node.image = bpy.data.images.load(str(path))
    node.image.pack()
    exported = shown()
    assert exported is not None and exported.encoding == "LINEAR" and exported.is_associated
    np.testing.assert_allclose(as_pooled(exported), (0.123, 0.456, 0.35), atol=2e-3)


@pytest.mark.parametrize("kind", ["missing", "corrupt", "none"])
def test_missing_and_corrupt_files(node: Any, tmp_path: Path, kind: str) -> None:
    import bpy

    node.extension = "CLIP"
    if kind != "none":
        path = tmp_path / "texture.png"
        write(path, gradient() / 255.0)
        node.image = bpy.data.images.load(str(path))
        path.unlink()
        if kind == "corrupt":
            path.write_bytes(b"no image at all")
        node.image.reload()
    description = export()
    if kind == "none":
        # What is not there at all the engine reports.
        assert shown(description) is None and description.images == [] and description.notices == []
    else:
        image = shown(description)
        # A texel like any: where textures are clipped, so is it, until Blender 5.2.
        assert image is not None and image.encoding == "LINEAR"
        nodes = description.materials[0].graph.nodes  # type: ignore[union-attr]
        assert nodes[0].properties["extension"] == ("REPEAT" if bpy.app.version >= (5, 2) else "CLIP")
        np.testing.assert_array_equal(image.pixels, [[(255, 0, 255, 255)]])
        assert [notice.subject for notice in description.notices] == [
            "Plane / Material / Image Texture / texture.png"
        ]


def test_a_missing_image_is_reported_once(node: Any, tmp_path: Path) -> None:
    """By the export, with its path; the engine finds the texel that stands for it."""
    import bpy

    path = tmp_path / "texture.png"
    write(path, gradient() / 255.0)
    for texture in (node, node.id_data.nodes.new("ShaderNodeTexImage")):
        texture.image = bpy.data.images.load(str(path), check_existing=False)
    tree = node.id_data
    mix = tree.nodes.new("ShaderNodeMixRGB")
    tree.links.new(node.outputs[0], mix.inputs[1])
    tree.links.new(texture.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], next(item for item in tree.nodes if item.type == "EMISSION").inputs["Color"])
    path.unlink()
    for image in bpy.data.images:
        image.reload()
    description = export()
    assert len(description.images) == 1 and len(description.notices) == 2
    _shaders, _names, notices = compile_programs(
        [ProgramSource("Plane / Material", description.materials[0].graph)], description.images
    )
    assert notices == []


def test_image_shared_by_nodes_is_exported_once(node: Any) -> None:
    tree = node.id_data
    other = tree.nodes.new("ShaderNodeTexImage")
    mix = tree.nodes.new("ShaderNodeMixRGB")
    node.image = other.image = make_image(gradient() / 255.0)
    emission = next(item for item in tree.nodes if item.bl_idname == "ShaderNodeEmission")
    tree.links.new(node.outputs[0], mix.inputs[1])
    tree.links.new(other.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], emission.inputs["Color"])
    description = export()
    assert len(description.images) == 1


def test_sequences_follow_the_frame(node: Any, tmp_path: Path) -> None:
    import bpy

    for frame in range(1, 4):
        write(tmp_path / f"s_{frame:03d}.png", np.full((1, 1, 4), frame * 10 / 255.0))
    image = bpy.data.images.load(str(tmp_path / "s_001.png"))
    image.source = "SEQUENCE"
    image.colorspace_settings.name = "Non-Color"
    node.image = image
    user = node.image_user
    user.frame_duration, user.frame_start, user.use_auto_refresh = 3, 5, True

    def value(frame: int) -> int:
        bpy.context.scene.frame_set(frame)
        exported = shown()
        assert exported is not None
        return int(exported.pixels[0, 0, 0])

    assert [value(frame) for frame in (5, 6, 7, 9)] == [10, 20, 30, 30]
    user.use_cyclic = True
    assert [value(frame) for frame in (8, 9)] == [10, 20]
    user.use_cyclic, user.frame_offset, user.use_auto_refresh = False, 1, False  # That is for windows.
    assert [value(frame) for frame in (5, 6)] == [20, 30]
    assert value(7) == 255 and export().notices  # pink: there is no such file
    assert len(bpy.data.images) == 1


def test_sequences_in_a_final_render(node: Any, tmp_path: Path) -> None:
    """Reading a frame of a sequence makes and removes a datablock, in the middle of Blender's render."""
    import bpy

    from addon.export import export_scene

    for frame in (1, 2):
        write(tmp_path / f"s_{frame:03d}.png", np.full((1, 1, 4), frame * 10 / 255.0))
    node.image = bpy.data.images.load(str(tmp_path / "s_001.png"))
    node.image.source = "SEQUENCE"
    node.image_user.frame_duration, node.image_user.use_auto_refresh = 2, True
    results: list[Any] = []

    class Engine(bpy.types.RenderEngine):
        bl_idname = "EXPORT_IMAGE_TEST"
        bl_label = "Export image test"

        def update(self, data: Any, depsgraph: Any) -> None:
            description = export_scene(depsgraph, engine=self)
            results.append((int(shown(description).pixels[0, 0, 0]), len(description.instances.mesh)))

        def render(self, depsgraph: Any) -> None:
            pass

    bpy.utils.register_class(Engine)
    scene = bpy.context.scene
    try:
        scene.render.engine = "EXPORT_IMAGE_TEST"
        scene.render.resolution_x = scene.render.resolution_y = 4
        scene.render.use_persistent_data = True
        scene.render.filepath = str(tmp_path / "out_")
        scene.frame_start, scene.frame_end = 1, 2
        bpy.ops.render.render(animation=True)
    finally:
        scene.render.engine = "BLENDER_WORKBENCH"
        bpy.utils.unregister_class(Engine)
    assert results == [(10, 1), (20, 1)]


def test_unchanged_images_are_the_same_object(node: Any, tmp_path: Path) -> None:
    import bpy

    from addon.export import ExportCache

    write(tmp_path / "texture.png", gradient() / 255.0)
    node.image = bpy.data.images.load(str(tmp_path / "texture.png"))
    cache = ExportCache()
    first, second = shown(export(cache=cache)), shown(export(cache=cache))
    assert first is second
    node.image.alpha_mode = "CHANNEL_PACKED"
    third = shown(export(cache=cache))
    assert third is not None and first is not None and third.key != first.key


def test_painting_is_noticed(node: Any) -> None:
    from addon.export import ExportCache

    node.image = make_image(gradient() / 255.0)
    cache = ExportCache()
    first = shown(export(cache=cache))
    assert shown(export(cache=cache)) is first
    node.image.pixels.foreach_set(np.full(24, 1.0, np.float32))
    second = shown(export(cache=cache))
    assert first is not None and second is not None
    assert second.key != first.key and (second.pixels == 255).all()


def test_working_space_of_the_file(node: Any) -> None:
    import bpy

    from addon.export.colorspaces import working_space

    name, matrix = working_space("Linear Rec.2020")
    assert name == "Rec.2020" and matrix is not None
    # ITU-R BT.2020: luminance, and the white point of D65.
    np.testing.assert_allclose(matrix[1], (0.2627, 0.6780, 0.0593), atol=1e-4)
    np.testing.assert_allclose(matrix.sum(axis=1), (0.9505, 1.0, 1.0891), atol=1e-3)
    assert working_space("Something else") is None
    if not hasattr(bpy.data, "colorspace"):
        pytest.skip("Blender before 5.0 has no working space")
    # Blender refuses to change it once an image was edited.
    bpy.ops.wm.set_working_color_space(working_space="Linear Rec.2020", convert_colors=False)
    node.image = make_image([[(1.0, 0.0, 0.0, 1.0)]])
    description = export()
    image = shown(description)
    bpy.data.images.remove(node.image)
    bpy.ops.wm.set_working_color_space(working_space="Linear Rec.709", convert_colors=False)
    assert bpy.data.colorspace.working_space == "Linear Rec.709"
    assert description.working_space == "Rec.2020" and description.to_xyz is not None
    assert image is not None and image.encoding == "LINEAR"
    # Red of Rec.709 in Rec.2020 (ITU-R BT.2087, Table 3).
    np.testing.assert_allclose(image.pixels[0, 0, :3], (0.6274, 0.0691, 0.0164), atol=1e-4)


def save_file(folder: Path, name: str, size: int = 64) -> Path:
    """A PNG file of so many pixels in each direction."""
    import bpy

    made = make_image(np.full((size, size, 4), 0.5), name)
    made.filepath_raw, made.file_format = str(folder / f"{name}.png"), "PNG"
    made.save()
    bpy.data.images.remove(made)
    return folder / f"{name}.png"


def use_files(node: Any, paths: list[Path]) -> None:
    """Have a texture node of the material of `node` for each file."""
    import bpy

    for path in paths:
        texture = node.id_data.nodes.new("ShaderNodeTexImage")
        texture.image = bpy.data.images.load(str(path))
        mix = node.id_data.nodes.new("ShaderNodeMixRGB")
        emission = node.id_data.nodes["Emission"]
        links = node.id_data.links
        links.new(emission.inputs["Color"].links[0].from_socket, mix.inputs[1])
        links.new(texture.outputs["Color"], mix.inputs[2])
        links.new(mix.outputs[0], emission.inputs["Color"])


def test_textures_beyond_their_memory_lie_in_a_file(node: Any, tmp_path: Path) -> None:
    size = 64 * 64 * 4
    node.image = make_image(gradient() / 255.0)
    use_files(node, [save_file(tmp_path, name) for name in "abc"])
    plain, limited = export(), export(texture_memory=2 * size)
    assert [bool(image.folder) for image in plain.images] == [False] * 4
    assert sum(image.pixels.nbytes for image in limited.images if not image.folder) <= 2 * size
    assert sum(bool(image.folder) for image in limited.images) == 2
    for kept, in_file in zip(plain.images, limited.images, strict=True):
        np.testing.assert_array_equal(kept.pixels, in_file.pixels)
    (notice,) = [notice for notice in limited.notices if notice.subject == "Textures"]
    assert "they lie in a temporary file in" in notice.fallback


def test_textures_without_room_are_refused_before_they_are_read(
    node: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk has room for the one that is to be put there first, and not for those that follow."""
    use_files(node, [save_file(tmp_path, name) for name in "abcd"])
    size = 64 * 64 * 4
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _folder: usage._replace(free=3 * size))
    with pytest.raises(ValueError, match=r"has no room for .* use smaller images, free disk space"):
        export(texture_memory=size)


def test_image_files_say_how_large_they_are(tmp_path: Path) -> None:
    from addon.export.image_headers import texel_bytes

    assert texel_bytes(str(save_file(tmp_path, "a", 48))) == 48 * 48 * 4
    assert texel_bytes(str(tmp_path / "missing.png")) == 0
