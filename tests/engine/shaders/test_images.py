# SPDX-License-Identifier: GPL-3.0-or-later
"""Image textures: orientation, extension, interpolation, alpha, colour encoding, projections."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.scene.description import Image
from engine.shaders.image_pool import build_image_pool
from engine.state.lanes import POINT_NS, POINT_P
from engine.state.shaders import PROGRAM_AHEAD_IMAGE, PROGRAM_AHEAD_SLOT
from tests.helpers.shader_harness import Graph, compile_one, emitted, square_points


def gradient_image(**options: Any) -> Image:
    """Linear float image, 4 x 2 texels: red counts columns, green rows from the bottom, blue is 1."""
    pixels = np.ones((2, 4, 4), np.float32)
    pixels[..., 0] = np.arange(4)
    pixels[..., 1] = np.arange(2)[:, None]
    return Image("k", "gradient", pixels, **({"encoding": "LINEAR"} | options))


def lookup(
    image: Image, vectors: Any, kind: str = "ShaderNodeTexImage", output: str = "Color", **properties: Any
) -> np.ndarray:
    """The node's output with its Vector at world positions `vectors`."""
    graph = Graph()
    position = graph.link("ShaderNodeNewGeometry", "Position")
    texture = graph.link(kind, output, inputs={"Vector": position}, image=0, **properties)
    vectors = np.atleast_2d(np.asarray(vectors, np.float32))
    points = square_points(np.zeros((len(vectors), 2)))
    points.real[:, POINT_P : POINT_P + 3] = vectors
    return emitted(graph.emit(texture), points, [image])


def reference(pixels: np.ndarray, u: float, v: float, interpolation: str, extension: str) -> np.ndarray:
    """Cycles' filters written out: taps at texel centres, weights of the tent or the cubic B-spline."""
    height, width = pixels.shape[:2]

    def fetch(i: int, j: int) -> np.ndarray:
        if extension == "REPEAT":
            i, j = i % width, j % height
        elif extension == "EXTEND":
            i, j = min(max(i, 0), width - 1), min(max(j, 0), height - 1)
        elif extension == "MIRROR":
            i, j = i % (2 * width), j % (2 * height)
            i, j = min(i, 2 * width - 1 - i), min(j, 2 * height - 1 - j)
        elif not (0 <= i < width and 0 <= j < height):
            return np.zeros(4)
        return pixels[j, i].astype(np.float64)

    x, y = u * width, v * height
    if interpolation == "Closest":
        return fetch(int(np.floor(x)), int(np.floor(y)))
    x, y = x - 0.5, y - 0.5
    i, j = int(np.floor(x)), int(np.floor(y))

    def weights(t: float) -> dict[int, float]:
        if interpolation == "Linear":
            return {0: 1 - t, 1: t}
        cubes = (
            (1 - t) ** 3,
            3 * t**3 - 6 * t**2 + 4,
            -3 * t**3 + 3 * t**2 + 3 * t + 1,
            t**3,
        )
        return {k - 1: c / 6 for k, c in enumerate(cubes)}

    wx, wy = weights(x - i), weights(y - j)
    return sum(a * b * fetch(i + k, j + m) for k, a in wx.items() for m, b in wy.items())


@pytest.mark.parametrize("interpolation", ["Closest", "Linear", "Cubic"])
@pytest.mark.parametrize("extension", ["REPEAT", "EXTEND", "CLIP", "MIRROR"])
def test_filters_and_extensions(interpolation: str, extension: str) -> None:
    rng = np.random.default_rng(3)
    image = Image("k", "noise", rng.random((3, 5, 4), np.float32), encoding="LINEAR", alpha_mode="CHANNEL_PACKED")
    where = rng.uniform(-1.7, 2.7, (200, 3)).astype(np.float32)
    found = lookup(image, where, interpolation=interpolation, extension=extension)
    expected = [reference(image.pixels, float(p[0]), float(p[1]), interpolation, extension)[:3] for p in where]
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_row_zero_is_at_the_bottom() -> None:
    corners = lookup(gradient_image(), [(0.01, 0.01, 0), (0.99, 0.01, 0), (0.01, 0.99, 0)], interpolation="Closest")
    np.testing.assert_allclose(corners[:, :2], [(0, 0), (3, 0), (0, 1)])


def test_uv_map_is_the_default_vector() -> None:
    graph = Graph()
    graph_color = graph.link("ShaderNodeTexImage", "Color", image=0, interpolation="Closest")
    found = emitted(graph.emit(graph_color), square_points([(0.9, 0.1), (0.1, 0.9)]), [gradient_image()])
    np.testing.assert_allclose(found[:, :2], [(3, 0), (0, 1)])


def test_texels_are_foreseen_where_a_uv_map_is_used_as_it_is() -> None:
    def columns(vector: object) -> list[int]:
        graph = Graph()
        inputs = {} if vector is None else {"Vector": vector(graph)}  # type: ignore[operator]
        color = graph.link("ShaderNodeTexImage", "Color", image=0, inputs=inputs)
        shaders, _names, _notices = compile_one(graph.emit(color), [gradient_image()])
        return shaders.programs[0, [PROGRAM_AHEAD_IMAGE, PROGRAM_AHEAD_SLOT]].tolist()

    assert columns(None) == [1, -1]
    assert columns(lambda graph: graph.link("ShaderNodeUVMap", "UV", uv_map="Other")) == [1, 0]
    assert columns(lambda graph: graph.link("ShaderNodeNewGeometry", "Position")) == [0, 0]


def test_srgb_bytes_are_decoded_after_filtering() -> None:
    pixels = np.full((1, 2, 4), 255, np.uint8)
    pixels[0, 0, :3] = 0
    image = Image("k", "step", pixels, encoding="SRGB")
    found = lookup(image, [(0.5, 0.5, 0), (0.75, 0.5, 0)])
    np.testing.assert_allclose(found[:, 0], (((0.5 + 0.055) / 1.055) ** 2.4, 1.0), rtol=1e-5)
    levels = np.zeros((1, 256, 4), np.uint8)
    levels[..., :3] = np.arange(256)[None, :, None]
    levels[..., 3] = 255
    where = np.stack([(np.arange(256) + 0.5) / 256, np.full(256, 0.5), np.zeros(256)], axis=1)
    found = lookup(Image("k", "ramp", levels, encoding="SRGB"), where, interpolation="Closest")
    c = np.arange(256) / 255.0
    np.testing.assert_allclose(found[:, 0], np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4), atol=2e-6)


@pytest.mark.parametrize(
    ("alpha_mode", "read_alpha", "color"),
    [("STRAIGHT", False, 0.4), ("STRAIGHT", True, 0.8), ("CHANNEL_PACKED", True, 0.8), ("NONE", True, 0.8)],
)
def test_alpha_modes(alpha_mode: str, read_alpha: bool, color: float) -> None:
    pixels = np.array([[[0.8, 0.8, 0.8, 0.5]]], np.float32)
    image = Image("k", "film", pixels, encoding="LINEAR", alpha_mode=alpha_mode)
    graph = Graph()
    texture = graph.add("ShaderNodeTexImage", image=0)
    from engine.scene.description import Link

    strength = Link(texture, "Alpha") if read_alpha else 1.0
    found = emitted(graph.emit(Link(texture, "Color"), strength), None, [image])
    alpha = 1.0 if alpha_mode == "NONE" or not read_alpha else 0.5
    np.testing.assert_allclose(found[0], color * alpha, rtol=1e-6)


def test_missing_image_is_magenta_and_reported() -> None:
    from tests.helpers.shader_harness import compile_one, run

    graph = Graph()
    texture = graph.link("ShaderNodeTexImage", "Color", image=-1, name="Lost")
    shaders, _names, notices = compile_one(graph.emit(texture))
    np.testing.assert_allclose(run(shaders).emission[0, :3], (1.0, 0.0, 1.0))
    assert [n.subject for n in notices] == ["M / Lost"]


def test_equirectangular_directions() -> None:
    """-y is the middle of the image, +z its top; longitude decreases with u from +x ... as Cycles' formula."""
    pixels = np.ones((64, 128, 4), np.float32)
    pixels[..., 0] = (np.arange(128) + 0.5) / 128
    pixels[..., 1] = ((np.arange(64) + 0.5) / 64)[:, None]
    image = Image("k", "map", pixels, encoding="LINEAR")
    directions = np.array([(1, 0, 0), (0, 1, 0), (0, -1, 0), (1, 0, 1), (0.3, -0.5, -0.8)], np.float64)
    found = lookup(image, directions, kind="ShaderNodeTexEnvironment")
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    u = 0.5 - np.arctan2(unit[:, 1], unit[:, 0]) / (2 * np.pi)
    v = 1.0 - np.arccos(unit[:, 2]) / np.pi
    np.testing.assert_allclose(found[:, :2], np.stack([u, v], axis=1), atol=1e-4)


def test_box_projection_takes_the_facing_side() -> None:
    image = gradient_image()
    graph = Graph()
    position = graph.link("ShaderNodeNewGeometry", "Position")
    texture = graph.link(
        "ShaderNodeTexImage", "Color", inputs={"Vector": position}, image=0, projection="BOX", interpolation="Closest"
    )
    points = square_points(np.zeros((4, 2)))
    points.real[:, POINT_P : POINT_P + 3] = (0.1, 0.4, 0.9)
    normals = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, 0, 1)], np.float32)
    points.real[:, POINT_NS : POINT_NS + 3] = normals
    found = emitted(graph.emit(texture), points, [image])
    # Image coordinates (y, z), (1 - y, z), (1 - x, z), (1 - y, x) on a 4 x 2 grid.
    np.testing.assert_allclose(found[:, :2], [(1, 1), (2, 1), (3, 1), (2, 0)])


def test_images_are_in_memory_once_unless_they_have_to_change() -> None:
    plain, straight, broken = (gradient_image() for _ in range(3))
    straight.pixels[0, 0, 3] = 0.5
    straight.alpha_mode = "STRAIGHT"
    broken.pixels[1, 1] = np.nan
    wrong_shape = Image("w", "wrong", np.zeros((2, 2, 3), np.uint8))
    originals = [image.pixels for image in (straight, broken, wrong_shape)]
    expected = plain.pixels.copy()
    for _ in range(2):  # the second time from the first pool
        pool = build_image_pool([plain, straight, broken, wrong_shape])
        assert np.shares_memory(plain.pixels, pool.pixels_float)
        assert not np.shares_memory(plain.pixels, pool.pixels_byte)
        np.testing.assert_array_equal(plain.pixels, expected)
        assert len(pool.notices) == 1
    for image, original in zip((straight, broken, wrong_shape), originals, strict=True):
        assert image.pixels is original


def test_tiles_lie_side_by_side_and_magenta_beside_them() -> None:
    tiles = [
        Image(k, f"tile {k}", np.full((2, 2, 4), k + 1.0, np.float32), "LINEAR", is_associated=True) for k in range(3)
    ]
    images = [Image("i", "tiles", np.zeros((1, 1, 4), np.uint8), tiles=((1001, 1), (1003, 2), (1012, 3))), *tiles]
    graph = Graph()
    position = graph.link("ShaderNodeNewGeometry", "Position")
    texture = graph.link("ShaderNodeTexImage", "Color", inputs={"Vector": position}, image=0)
    magenta = (1.0, 0.0, 1.0)
    places = {
        (0.2, 0.9): 1.0, (2.5, 0.1): 2.0, (1.99, 1.0): 3.0, (1.5, 0.5): magenta, (-0.1, 0.5): 1.0,
        (2.5, -0.9): 2.0, (0.5, -1.1): magenta, (-1.1, 0.5): magenta, (10.5, 0.5): magenta,
        (12.5, 0.5): magenta, (np.nan, 0.5): magenta, (0.5, 1e9): magenta,
    }  # fmt: skip
    points = square_points(np.zeros((len(places), 2)))
    points.real[:, POINT_P : POINT_P + 3] = [(u, v, 0.0) for u, v in places]
    found = emitted(graph.emit(texture), points, images)
    np.testing.assert_allclose(found, [np.broadcast_to(value, 3) for value in places.values()])


def test_a_filter_ends_at_its_tile() -> None:
    pixels = np.zeros((1, 2, 4), np.float32)
    pixels[0, 1] = 1.0
    tiles = [Image("a", "a", pixels, "LINEAR"), Image("b", "b", np.full((1, 2, 4), 9.0, np.float32), "LINEAR")]
    images = [Image("i", "tiles", np.zeros((1, 1, 4), np.uint8), tiles=((1001, 1), (1002, 2))), *tiles]
    graph = Graph()
    position = graph.link("ShaderNodeNewGeometry", "Position")
    texture = graph.link("ShaderNodeTexImage", "Color", inputs={"Vector": position}, image=0, extension="REPEAT")
    points = square_points(np.zeros((1, 2)))
    points.real[:, POINT_P : POINT_P + 3] = (0.9999, 0.5, 0.0)
    # As in Cycles, a tile is repeated at its own edge.
    np.testing.assert_allclose(emitted(graph.emit(texture), points, images)[0], 0.5, atol=1e-3)
