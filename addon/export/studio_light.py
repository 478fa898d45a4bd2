# SPDX-License-Identifier: GPL-3.0-or-later
"""The studio light of a window that shows no scene world, as the world that Cycles makes of it.

Camera rays see it over the world's plain colour, as opaque as the window says; all other rays see it alone. Cycles does
not blur it.
"""

from __future__ import annotations

from engine.scene.description import Link, Node, NodeGraph, World

from .context import ExportContext, StudioLight
from .images import ImageExporter
from .world import world_of, world_visibility


def export_studio_light(context: ExportContext, images: ImageExporter, studio: StudioLight) -> World:
    """The world that a studio light is."""
    world = world_of(context)
    color = (0.0, 0.0, 0.0) if world is None else tuple(world.color)
    made = World(
        key=("studio", studio.path), name="Studio light", graph=_graph(images.export_file(studio.path), studio, color)
    )
    if world is not None:
        made.visibility = world_visibility(world)
    return made


def _graph(image: int, studio: StudioLight, color: tuple[float, ...]) -> NodeGraph:
    """Nodes as Cycles connects them.

    Parameters
    ----------
    image : int
        Index of the studio light's image, -1 if it cannot be read.
    color : (red, green, blue)
        Colour of the world without nodes.
    """
    plain = (*color, 1.0)
    strength = (studio.strength,) * 3 + (1.0,)
    nodes = [
        Node("ShaderNodeTexCoord", "Direction"),
        Node(
            "ShaderNodeMapping", "Rotation",
            {"Vector": Link(0, "Generated"), "Rotation": (0.0, 0.0, studio.rotation), "Scale": (1.0, 1.0, 1.0)},
            {"vector_type": "VECTOR"},
        ),
        Node(
            "ShaderNodeTexEnvironment", "Image", {"Vector": Link(1, "Vector")},
            {"image": image, "projection": "EQUIRECTANGULAR", "interpolation": "Linear"},
        ),
        Node(
            "ShaderNodeMixRGB", "Strength", {"Fac": 1.0, "Color1": Link(2, "Color"), "Color2": strength},
            {"blend_type": "MULTIPLY", "use_clamp": False},
        ),
        Node(
            "ShaderNodeMixRGB", "Opacity", {"Fac": studio.opacity, "Color1": plain, "Color2": Link(3, "Color")},
            {"blend_type": "MIX", "use_clamp": False},
        ),
        Node("ShaderNodeLightPath", "Ray"),
        Node(
            "ShaderNodeMixRGB", "Camera",
            {"Fac": Link(5, "Is Camera Ray"), "Color1": Link(3, "Color"), "Color2": Link(4, "Color")},
            {"blend_type": "MIX", "use_clamp": False},
        ),
        Node("ShaderNodeBackground", "Background", {"Color": Link(6, "Color"), "Strength": 1.0}),
    ]  # fmt: skip
    return NodeGraph(nodes, surface=Link(7, "Background"))
