# SPDX-License-Identifier: GPL-3.0-or-later
"""Textured and procedural scenes: boards facing the camera, so that orientation and colour show."""

from __future__ import annotations

import os
import tempfile
from typing import Any

import bpy
import numpy as np

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    Surface,
    add_object,
    box,
    image,
    light,
    lit_stage,
    material,
    quad,
    show,
    sphere,
    stage,
    world,
)


def asymmetric_pixels(height: int = 6, width: int = 8) -> np.ndarray:
    """RGBA no flip, turn or transposition leaves as it is: red grows to the right, green upwards, one blue corner."""
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., 0] = np.linspace(0.1, 0.9, width)[None, :]
    pixels[..., 1] = np.linspace(0.1, 0.9, height)[:, None]
    pixels[..., 2] = 0.1
    pixels[: height // 3, : width // 4, 2] = 1.0
    return pixels


def boards(surfaces: list[Surface]) -> None:
    """Up to eight boards in two rows in front of the camera, lit by the world and a lamp behind the camera."""
    stage()
    world((0.8, 0.8, 0.8))
    light("AREA", 100.0, (0.0, -4.0, 4.0), size=2.0)
    columns = (len(surfaces) + 1) // 2
    for index, surface in enumerate(surfaces):
        column, row = index % columns, index // columns
        board = quad(f"Board {index}", material(f"board {index}", surface), 0.95, 0.95)
        add_object(f"Board {index}", board, ((column - (columns - 1) / 2) * 1.05, -0.5, 1.65 - 1.1 * row), (75, 0, 0))


def _image_board(properties: dict[str, Any], scale: tuple[float, float, float] = (1, 1, 1), **settings: Any) -> Surface:
    def surface(nodes: Nodes) -> Socket:
        picture = bpy.data.images.get("Asymmetric") or image("Asymmetric", asymmetric_pixels())
        vector = nodes("Mapping", Vector=nodes("TexCoord", output="UV"), Location=(-0.3, -0.2, 0.0), Scale=scale)
        if scale == (1, 1, 1):
            vector = nodes("TexCoord", output="UV")
        texture = nodes.node("TexImage", {"image": picture, **properties}, Vector=vector)
        for key, value in settings.items():
            setattr(texture, key, value)
        return nodes("BsdfDiffuse", Color=texture.outputs["Color"])

    return surface


@scene("textured")
def textured() -> None:
    """Image textures: orientation, interpolation and extension."""
    scale = (2.0, 1.6, 1.0)
    boards(
        [
            _image_board({"interpolation": "Closest"}),
            _image_board({"interpolation": "Linear"}),
            _image_board({"interpolation": "Cubic"}),
            _image_board({"interpolation": "Smart"}),
            _image_board({"interpolation": "Linear", "extension": "REPEAT"}, scale),
            _image_board({"interpolation": "Linear", "extension": "EXTEND"}, scale),
            _image_board({"interpolation": "Linear", "extension": "CLIP"}, scale),
            _image_board({"interpolation": "Closest", "extension": "MIRROR"}, scale),
        ]
    )


@scene("textured-projections")
def textured_projections() -> None:
    """Image textures projected from generated and object coordinates: flat, box, sphere and tube."""
    lit_stage()
    picture = image("Asymmetric", asymmetric_pixels())

    def surface(projection: str, coordinates: str) -> Surface:
        def build(nodes: Nodes) -> Socket:
            properties = {"image": picture, "projection": projection, "projection_blend": 0.2}
            vector = nodes("TexCoord", output=coordinates)
            return nodes("BsdfDiffuse", Color=nodes("TexImage", properties, Vector=vector))

        return build

    add_object("A", sphere("A", material("a", surface("SPHERE", "Generated")), 0.6), (-1.2, 0.3, 0.6))
    add_object("B", box("B", material("b", surface("BOX", "Object")), (0.9, 0.9, 0.9)), (0.0, 0.6, 0.5), (0, 0, 30))
    add_object("C", sphere("C", material("c", surface("TUBE", "Generated")), 0.6), (1.2, 0.3, 0.6))
    block = box("D", material("d", surface("FLAT", "Generated")), (0.7, 0.7, 0.7))
    add_object("D", block, (0.2, -1.2, 0.35), (0, 0, 20))


@scene("textured-tiles")
def textured_tiles() -> None:
    """An image in tiles: two columns and two rows, one of which is missing, and what lies beside them."""
    with tempfile.TemporaryDirectory() as folder:
        for number, factor in ((1001, 1.0), (1002, 0.6), (1011, 0.3)):
            tile = image(f"Tile {number}", factor * asymmetric_pixels())
            tile.filepath_raw, tile.file_format = os.path.join(folder, f"tile.{number}.png"), "PNG"
            tile.save()
        tiles = bpy.data.images.load(os.path.join(folder, "tile.<UDIM>.png"))
        tiles.source = "TILED"
        tiles.pack()

    def surface(extension: str, interpolation: str) -> Surface:
        def build(nodes: Nodes) -> Socket:
            uv = nodes("TexCoord", output="UV")
            vector = nodes("Mapping", Vector=uv, Location=(-0.2, -0.2, 0), Scale=(2.4, 2.4, 1))
            properties = {"image": tiles, "extension": extension, "interpolation": interpolation}
            return nodes("BsdfDiffuse", Color=nodes("TexImage", properties, Vector=vector))

        return build

    ways = (("REPEAT", "Linear"), ("EXTEND", "Linear"), ("CLIP", "Cubic"), ("REPEAT", "Closest"))
    boards([surface(*way) for way in ways])


@scene("textured-color-spaces")
def textured_color_spaces() -> None:
    """The same bytes as sRGB colour, as non-colour data, as float; and alpha in each of its modes."""
    pixels = asymmetric_pixels()
    pixels[2:4, 3:6, 3] = 0.3

    def board(name: str, colorspace: str | None, is_float: bool, alpha_mode: str) -> Surface:
        def surface(nodes: Nodes) -> Socket:
            picture = image(name, pixels, is_float, colorspace)
            picture.alpha_mode = alpha_mode
            texture = nodes.node("TexImage", {"image": picture})
            return nodes(
                "MixShader",
                inputs={
                    0: texture.outputs["Alpha"],
                    1: nodes("BsdfTransparent"),
                    2: nodes("BsdfDiffuse", Color=texture.outputs["Color"]),
                },
            )

        return surface

    boards(
        [
            board("srgb", "sRGB", False, "STRAIGHT"),
            board("data", "Non-Color", False, "STRAIGHT"),
            board("float", "Linear Rec.709", True, "PREMUL"),
            board("packed", "sRGB", False, "CHANNEL_PACKED"),
            board("opaque", "sRGB", False, "NONE"),
            board("premultiplied", "sRGB", False, "PREMUL"),
        ]
    )


def _texture_board(
    kind: str, output: str = "Color", properties: dict[str, Any] | None = None, **inputs: Any
) -> Surface:
    def surface(nodes: Nodes) -> Socket:
        vector = nodes("TexCoord", output="Generated")
        return nodes("BsdfDiffuse", Color=nodes(kind, properties, output=output, Vector=vector, **inputs))

    return surface


@scene("procedural")
def procedural() -> None:
    """Checker, noise, gradient, Voronoi, wave, brick and their colours."""
    boards(
        [
            _texture_board("TexChecker", Scale=5.0, Color1=(0.9, 0.2, 0.1), Color2=(0.1, 0.2, 0.8)),
            _texture_board("TexNoise", Scale=4.0, Detail=3.0, Roughness=0.6, Distortion=0.4),
            _texture_board("TexGradient", properties={"gradient_type": "RADIAL"}),
            _texture_board("TexVoronoi", Scale=5.0),
            _texture_board("TexVoronoi", "Distance", {"feature": "DISTANCE_TO_EDGE"}, Scale=5.0),
            _texture_board("TexWave", properties={"wave_type": "RINGS"}, Scale=3.0, Distortion=2.0, Detail=2.0),
            _texture_board("TexBrick", Scale=3.0, Color1=(0.8, 0.3, 0.2), Color2=(0.5, 0.2, 0.1)),
            _texture_board("TexWave", properties={"wave_profile": "SAW", "bands_direction": "DIAGONAL"}, Scale=2.0),
        ]
    )


@scene("procedural-noise")
def procedural_noise() -> None:
    """Noise textures of every type and of 1 to 4 dimensions."""
    kinds = ["FBM", "MULTIFRACTAL", "HYBRID_MULTIFRACTAL", "RIDGED_MULTIFRACTAL", "HETERO_TERRAIN"]
    surfaces = [
        _texture_board("TexNoise", "Fac", {"noise_type": kind, "normalize": kind == "FBM"}, Scale=4.0, Detail=2.5)
        for kind in kinds
    ]

    def dimension(count: str) -> Surface:
        def surface(nodes: Nodes) -> Socket:
            generated = nodes("TexCoord", output="Generated")
            inputs: dict[int | str, Any] = {"Scale": 4.0}
            if count != "1D":
                inputs["Vector"] = generated
            if count in ("1D", "4D"):
                inputs["W"] = nodes("SeparateXYZ", Vector=generated)
            texture = nodes.node("TexNoise", {"noise_dimensions": count}, inputs)
            return nodes("BsdfDiffuse", Color=texture.outputs["Color"])

        return surface

    boards([*surfaces, dimension("1D"), dimension("2D"), dimension("4D")])


@scene("procedural-voronoi")
def procedural_voronoi() -> None:
    """Voronoi's features and metrics."""
    kind = "TexVoronoi"
    boards(
        [
            _texture_board(kind, "Color", {"distance": "MANHATTAN"}, Scale=5.0),
            _texture_board(kind, "Color", {"distance": "CHEBYCHEV"}, Scale=5.0),
            _texture_board(kind, "Distance", {"distance": "MINKOWSKI"}, Scale=5.0, Exponent=0.7),
            _texture_board(kind, "Distance", {"feature": "F2"}, Scale=5.0),
            _texture_board(kind, "Color", {"feature": "SMOOTH_F1"}, Scale=5.0, Smoothness=0.5),
            _texture_board(kind, "Radius", {"feature": "N_SPHERE_RADIUS"}, Scale=5.0),
            _texture_board(kind, "Color", {"voronoi_dimensions": "2D"}, Scale=5.0, Randomness=0.5),
            _texture_board(kind, "Position", Scale=5.0, Detail=2.0),
        ]
    )


@scene("color-nodes")
def color_nodes() -> None:
    """Ramp, curves, mix, invert, hue, gamma, contrast and blackbody over a gradient."""

    def board(build: Any) -> Surface:
        def surface(nodes: Nodes) -> Socket:
            uv = nodes("SeparateXYZ", output="X", Vector=nodes("TexCoord", output="UV"))
            colour = nodes("CombineColor", Red=uv, Green=0.4, Blue=0.7)
            return nodes("BsdfDiffuse", Color=build(nodes, uv, colour))

        return surface

    def ramp(nodes: Nodes, factor: Socket, _: Socket) -> Socket:
        node = nodes.node("ValToRGB", inputs={0: factor})
        node.color_ramp.interpolation = "EASE"
        node.color_ramp.elements[0].color, node.color_ramp.elements[1].color = (0.8, 0.1, 0, 1), (0, 0.2, 0.9, 1)
        node.color_ramp.elements.new(0.4).color = (0.1, 0.9, 0.1, 1)
        return node.outputs["Color"]

    def curves(nodes: Nodes, _: Socket, colour: Socket) -> Socket:
        node = nodes.node("RGBCurve", Color=colour)
        node.mapping.curves[0].points.new(0.3, 0.8)
        node.mapping.curves[3].points.new(0.6, 0.3)
        node.mapping.update()
        return node.outputs[0]

    def mix(nodes: Nodes, factor: Socket, colour: Socket) -> Socket:
        properties = {"data_type": "RGBA", "blend_type": "OVERLAY", "clamp_result": True}
        node = nodes.node("Mix", properties, {"Factor_Float": factor, "A_Color": colour, "B_Color": (0.9, 0.4, 0.1)})
        return next(socket for socket in node.outputs if socket.identifier == "Result_Color")

    def hue(nodes: Nodes, factor: Socket, colour: Socket) -> Socket:
        return nodes("HueSaturation", Hue=factor, Saturation=1.4, Value=0.9, Color=colour)

    boards(
        [
            board(ramp),
            board(curves),
            board(mix),
            board(lambda nodes, factor, colour: nodes("Invert", Fac=factor, Color=colour)),
            board(hue),
            board(lambda nodes, factor, colour: nodes("Gamma", Color=colour, Gamma=2.2)),
            board(lambda nodes, factor, colour: nodes("BrightContrast", Color=colour, Bright=0.1, Contrast=0.4)),
            board(
                lambda nodes, factor, colour: nodes(
                    "Blackbody",
                    Temperature=nodes("MapRange", Value=factor, inputs={"To Min": 1500.0, "To Max": 12000.0}),
                )
            ),
        ]
    )


@scene("math-nodes")
def math_nodes() -> None:
    """Math and vector math operations over texture coordinates."""

    def board(operation: str, second: float, vector_operation: str) -> Surface:
        def surface(nodes: Nodes) -> Socket:
            uv = nodes.node("SeparateXYZ", Vector=nodes("TexCoord", output="UV"))
            scalar = nodes("Math", {"operation": operation}, {0: uv.outputs["X"], 1: second})
            turned = nodes(
                "VectorMath", {"operation": vector_operation}, {0: nodes("TexCoord", output="UV"), 1: (0.3, 0.6, 0.2)}
            )
            parts = nodes.node("SeparateXYZ", Vector=turned)
            return nodes("BsdfDiffuse", Color=nodes("CombineXYZ", X=scalar, Y=parts.outputs["Y"], Z=uv.outputs["Y"]))

        return surface

    boards(
        [
            board("POWER", 2.5, "MULTIPLY"),
            board("SINE", 0.0, "CROSS_PRODUCT"),
            board("PINGPONG", 0.3, "FRACTION"),
            board("SNAP", 0.25, "REFLECT"),
            board("SMOOTH_MIN", 0.5, "MODULO"),
            board("GREATER_THAN", 0.4, "NORMALIZE"),
        ]
    )


@scene("bump")
def bump() -> None:
    """Bump from noise on diffuse and glossy surfaces."""
    lit_stage()

    def surface(nodes: Nodes) -> Socket:
        height = nodes("TexNoise", output="Fac", Scale=3.0, Detail=1.0, Vector=nodes("TexCoord", output="Object"))
        normal = nodes("Bump", Strength=0.7, Distance=0.3, Height=height)
        return nodes("BsdfPrincipled", Base_Color=(0.6, 0.5, 0.3), Roughness=0.4, Normal=normal)

    show(material("bump", surface))


@scene("normal-map")
def normal_map() -> None:
    """A tangent-space normal map of a few large bumps, on a box and a sphere."""
    lit_stage()
    v, u = np.mgrid[0:32, 0:32] / 32.0
    x, y = 0.5 * np.sin(2 * np.pi * 2 * u), 0.3 * np.cos(2 * np.pi * 3 * v)
    pixels = np.ones((32, 32, 4), np.float32)
    pixels[..., 0], pixels[..., 1] = 0.5 + 0.5 * x, 0.5 + 0.5 * y
    pixels[..., 2] = 0.5 + 0.5 * np.sqrt(1.0 - x**2 - y**2)
    normals = image("Normals", pixels, colorspace="Non-Color")

    def surface(nodes: Nodes) -> Socket:
        normal = nodes("NormalMap", Strength=0.8, Color=nodes("TexImage", {"image": normals}))
        return nodes("BsdfPrincipled", Base_Color=(0.6, 0.5, 0.5), Roughness=0.3, Normal=normal)

    show(material("normal map", surface))


@scene("textured-limit")
def textured_limit() -> None:
    """Simplify's limit of 128 texels a side: images are as coarse as Cycles makes them, with alpha and without."""
    scene = bpy.context.scene
    y, x = np.mgrid[0:300, 0:400]
    checks = np.ones((300, 400, 4), np.float32)
    checks[..., 0] = (x // 9 + y // 7) % 2
    checks[..., 1] = x / 400
    checks[..., 3] = 0.3 + 0.7 * ((x // 31 + y // 23) % 2)

    def board(name: str, is_float: bool, alpha_mode: str) -> Surface:
        def surface(nodes: Nodes) -> Socket:
            picture = image(name, checks, is_float, "Linear Rec.709" if is_float else "sRGB")
            picture.alpha_mode = alpha_mode
            return nodes("BsdfDiffuse", Color=nodes("TexImage", {"image": picture, "interpolation": "Closest"}))

        return surface

    boards([board("bytes", False, "STRAIGHT"), board("packed", False, "CHANNEL_PACKED"),
            board("floats", True, "STRAIGHT"), board("opaque", False, "NONE")])  # fmt: skip
    scene.render.use_simplify, scene.cycles.texture_limit_render = True, "128"
