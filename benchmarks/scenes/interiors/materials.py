# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of rooms, procedural throughout."""

from __future__ import annotations

from typing import Any

import bpy

Color = tuple[float, float, float]


class _Graph:
    """A material's nodes, with a shorter way to add and link them."""

    def __init__(self, name: str) -> None:
        self.material = bpy.data.materials.new(name)
        self.material.use_nodes = True
        self.tree = self.material.node_tree
        self.shader = next(node for node in self.tree.nodes if node.type == "BSDF_PRINCIPLED")

    def add(self, kind: str, inputs: dict[Any, Any] | None = None, **properties: Any) -> Any:
        """Add a node; an input, by name or number, may be a value or the output socket of another node."""
        node = self.tree.nodes.new(kind)
        for name, value in properties.items():
            setattr(node, name, value)
        self.connect(node, inputs or {})
        return node

    def connect(self, node: Any, inputs: dict[Any, Any]) -> None:
        """Set or link inputs of a node."""
        for name, value in inputs.items():
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, node.inputs[name])
            else:
                node.inputs[name].default_value = value

    def set(self, **inputs: Any) -> None:
        """Set or link inputs of the Principled BSDF; underscores stand for spaces."""
        self.connect(self.shader, {name.replace("_", " "): value for name, value in inputs.items()})

    def math(self, operation: str, first: Any, second: Any) -> Any:
        """A sum, difference or product of values or sockets."""
        node = self.add("ShaderNodeMath", {0: first, 1: second}, operation=operation)
        return node.outputs["Value"]

    def ramp(self, factor: Any, stops: list[tuple[float, Color]]) -> Any:
        """A colour ramp."""
        node = self.add("ShaderNodeValToRGB", {"Fac": factor})
        elements = node.color_ramp.elements
        while len(elements) < len(stops):
            elements.new(0.5)
        for element, (position, color) in zip(elements, stops, strict=True):
            element.position, element.color = position, (*color, 1.0)
        return node.outputs["Color"]


def plaster(name: str, color: Color) -> bpy.types.Material:
    """Painted plaster: matt, a little uneven."""
    graph = _Graph(name)
    place = graph.add("ShaderNodeTexCoord").outputs["Object"]
    noise = graph.add("ShaderNodeTexNoise", {"Vector": place, "Scale": 9.0, "Detail": 6.0})
    bump = graph.add("ShaderNodeBump", {"Height": noise.outputs["Fac"], "Strength": 0.25, "Distance": 0.02})
    darker = tuple(0.82 * value for value in color)
    shade = graph.ramp(noise.outputs["Fac"], [(0.35, darker), (0.65, color)])  # type: ignore[arg-type]
    graph.set(Base_Color=shade, Roughness=0.9, Normal=bump.outputs["Normal"])
    return graph.material


def marble_tiles() -> bpy.types.Material:
    """Polished tiles in two marbles, with matt joints."""
    graph = _Graph("Floor tiles")
    place = graph.add("ShaderNodeTexCoord").outputs["Object"]
    noise = graph.add("ShaderNodeTexNoise", {"Vector": place, "Scale": 1.7, "Detail": 8.0, "Distortion": 1.6})
    light = graph.ramp(noise.outputs["Fac"], [(0.38, (0.10, 0.085, 0.07)), (0.46, (0.52, 0.47, 0.40))])
    dark = graph.ramp(noise.outputs["Fac"], [(0.40, (0.012, 0.02, 0.018)), (0.62, (0.035, 0.06, 0.05))])
    checker = graph.add("ShaderNodeTexChecker", {"Vector": place, "Color1": light, "Color2": dark, "Scale": 2.0})
    rough = graph.add("ShaderNodeMapRange", {"Value": noise.outputs["Fac"], "To Min": 0.06, "To Max": 0.22})
    graph.set(Base_Color=checker.outputs["Color"], Roughness=rough.outputs["Result"])
    return graph.material


def wood(name: str, dark: Color, light: Color) -> bpy.types.Material:
    """Varnished wood, grain along the object's x axis."""
    graph = _Graph(name)
    place = graph.add("ShaderNodeTexCoord").outputs["Object"]
    scaled = graph.add("ShaderNodeMapping", {"Vector": place, "Scale": (0.7, 7.0, 7.0)}).outputs["Vector"]
    noise = graph.add("ShaderNodeTexNoise", {"Vector": scaled, "Scale": 2.2, "Detail": 8.0, "Distortion": 0.6})
    color = graph.ramp(noise.outputs["Fac"], [(0.36, dark), (0.64, light)])
    bump = graph.add("ShaderNodeBump", {"Height": noise.outputs["Fac"], "Strength": 0.08, "Distance": 0.01})
    graph.set(Base_Color=color, Roughness=0.38, Normal=bump.outputs["Normal"], Coat_Weight=0.35, Coat_Roughness=0.12)
    return graph.material


def metal(name: str, color: Color, roughness: float) -> bpy.types.Material:
    """Bare metal."""
    graph = _Graph(name)
    graph.set(Base_Color=(*color, 1.0), Metallic=1.0, Roughness=roughness)
    return graph.material


def glass(name: str, color: Color, roughness: float = 0.0) -> bpy.types.Material:
    """Clear or frosted glass."""
    graph = _Graph(name)
    graph.set(Base_Color=(*color, 1.0), Transmission_Weight=1.0, Roughness=roughness, IOR=1.5)
    return graph.material


def glaze() -> bpy.types.Material:
    """Glazed ceramic with a crackle of Voronoi cells."""
    graph = _Graph("Glaze")
    place = graph.add("ShaderNodeTexCoord").outputs["Object"]
    cells = graph.add("ShaderNodeTexVoronoi", {"Vector": place, "Scale": 7.0}, feature="DISTANCE_TO_EDGE")
    color = graph.ramp(cells.outputs["Distance"], [(0.0, (0.006, 0.02, 0.06)), (0.08, (0.02, 0.16, 0.24))])
    graph.set(Base_Color=color, Roughness=0.5, Coat_Weight=1.0, Coat_Roughness=0.03)
    return graph.material


def cloth_covers() -> bpy.types.Material:
    """Book covers: a colour for every object, from its random number."""
    graph = _Graph("Book covers")
    number = graph.add("ShaderNodeObjectInfo").outputs["Random"]
    stops = [
        (0.0, (0.35, 0.05, 0.03)),
        (0.25, (0.42, 0.22, 0.06)),
        (0.5, (0.03, 0.13, 0.10)),
        (0.75, (0.03, 0.06, 0.18)),
        (1.0, (0.50, 0.42, 0.30)),
    ]
    graph.set(Base_Color=graph.ramp(number, stops), Roughness=0.7, Sheen_Weight=0.3)
    return graph.material


def lamp(name: str, temperature: float, strength: float) -> bpy.types.Material:
    """A glowing surface."""
    graph = _Graph(name)
    color = graph.add("ShaderNodeBlackbody", {"Temperature": temperature}).outputs["Color"]
    graph.set(Base_Color=(0.0, 0.0, 0.0, 1.0), Emission_Color=color, Emission_Strength=strength)
    return graph.material


def planks() -> bpy.types.Material:
    """A floor of oiled oak planks along the object's y axis, each of a shade of its own."""
    graph = _Graph("Oak planks")
    place = graph.add("ShaderNodeTexCoord").outputs["Object"]
    turned = graph.add("ShaderNodeMapping", {"Vector": place, "Rotation": (0.0, 0.0, 1.5708)}).outputs["Vector"]
    plank = graph.add(
        "ShaderNodeTexBrick",
        {
            "Vector": turned, "Color1": (0.0, 0.0, 0.0, 1.0), "Color2": (1.0, 1.0, 1.0, 1.0),
            "Mortar": (0.0, 0.0, 0.0, 1.0), "Scale": 1.0, "Mortar Size": 0.003, "Brick Width": 1.6, "Row Height": 0.16,
        },
        offset=0.37,
    )  # fmt: skip
    stretched = graph.add("ShaderNodeMapping", {"Vector": turned, "Scale": (0.9, 9.0, 9.0)}).outputs["Vector"]
    grain = graph.add("ShaderNodeTexNoise", {"Vector": stretched, "Scale": 2.4, "Detail": 7.0, "Distortion": 0.5})
    shade = graph.math("MULTIPLY", plank.outputs["Color"], 0.35)
    is_wood = graph.math("SUBTRACT", 1.0, plank.outputs["Fac"])
    value = graph.math("MULTIPLY", graph.math("ADD", grain.outputs["Fac"], shade), is_wood)
    stops = [
        (0.0, (0.05, 0.025, 0.012)), (0.35, (0.20, 0.10, 0.045)), (0.65, (0.36, 0.20, 0.095)),
        (0.95, (0.50, 0.31, 0.16)),
    ]  # fmt: skip
    graph.set(Base_Color=graph.ramp(value, stops), Roughness=0.32)
    return graph.material


def cloth(name: str, color: Color) -> bpy.types.Material:
    """Cloth with a soft nap."""
    graph = _Graph(name)
    graph.set(Base_Color=(*color, 1.0), Roughness=0.95, Sheen_Weight=0.4)
    return graph.material


def paint(name: str, color: Color, roughness: float = 0.4) -> bpy.types.Material:
    """Enamel or porcelain: one colour under a soft shine."""
    graph = _Graph(name)
    graph.set(Base_Color=(*color, 1.0), Roughness=roughness)
    return graph.material


def canvas() -> bpy.types.Material:
    """A painting: bands of a hilly evening, from a noise that is cut by height."""
    graph = _Graph("Canvas")
    place = graph.add("ShaderNodeTexCoord").outputs["Generated"]
    axes = graph.add("ShaderNodeSeparateXYZ", {"Vector": place})
    stretched = graph.add("ShaderNodeMapping", {"Vector": place, "Scale": (2.6, 1.0, 0.9)}).outputs["Vector"]
    hills = graph.add("ShaderNodeTexNoise", {"Vector": stretched, "Scale": 1.5, "Detail": 3.0})
    height = graph.math("ADD", axes.outputs["Z"], graph.math("MULTIPLY", hills.outputs["Fac"], 0.55))
    bands = [
        (0.00, (0.015, 0.045, 0.06)), (0.42, (0.03, 0.10, 0.12)), (0.56, (0.10, 0.23, 0.22)),
        (0.70, (0.42, 0.40, 0.24)), (0.80, (0.80, 0.42, 0.14)), (0.95, (0.85, 0.62, 0.36)), (1.0, (0.52, 0.62, 0.66)),
    ]  # fmt: skip
    graph.set(Base_Color=graph.ramp(height, bands), Roughness=0.6)
    graph.shader.id_data.nodes["Color Ramp"].color_ramp.interpolation = "CONSTANT"
    return graph.material
