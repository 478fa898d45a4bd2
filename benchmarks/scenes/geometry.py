# SPDX-License-Identifier: GPL-3.0-or-later
"""Instances, attributes, transforms, visibility, curves and the furnace."""

from __future__ import annotations

import bpy
import numpy as np

from benchmarks.scenes.closures import ROUGH_REFRACTION, glass_rough
from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    Surface,
    add_object,
    box,
    camera,
    diffuse,
    lit_stage,
    material,
    quad,
    resolution,
    show,
    sphere,
    world,
)


def _furnace(surface: Surface) -> None:
    """A sphere in a white world: an energy-conserving white material vanishes."""
    resolution()
    camera((0, -4, 0), (0, 0, 0))
    world((1, 1, 1))
    add_object("Sphere", sphere("Sphere", material("white", surface), 1.0))


@scene("furnace-diffuse")
def furnace_diffuse() -> None:
    """A white Lambertian sphere in a white world."""
    _furnace(lambda nodes: nodes("BsdfDiffuse", Color=(1, 1, 1)))


@scene("furnace-glossy")
def furnace_glossy() -> None:
    """A white sphere of rough, energy-compensated GGX in a white world."""
    _furnace(lambda nodes: nodes("BsdfAnisotropic", {"distribution": "MULTI_GGX"}, Color=(1, 1, 1), Roughness=0.7))


@scene("furnace-glass")
def furnace_glass() -> None:
    """A sphere of smooth glass in a white world, deep enough to be transparent."""
    _furnace(lambda nodes: nodes("BsdfGlass", {"distribution": "GGX"}, Color=(1, 1, 1), Roughness=0.0))
    bpy.context.scene.cycles.max_bounces = bpy.context.scene.cycles.transmission_bounces = 64
    bpy.context.scene.cycles.glossy_bounces = 64


@scene("furnace-principled")
def furnace_principled() -> None:
    """A white Principled sphere with coat and sheen in a white world."""
    _furnace(
        lambda nodes: nodes("BsdfPrincipled", Base_Color=(1, 1, 1), Roughness=0.5, Coat_Weight=0.5, Sheen_Weight=0.3)
    )


@scene("instanced")
def instanced() -> None:
    """Collection instances, an object instanced on faces, and geometry-node instances with random per object."""
    lit_stage()

    def by_random(nodes: Nodes) -> Socket:
        info = nodes("ObjectInfo", output="Random")
        return nodes("BsdfDiffuse", Color=nodes("HueSaturation", Hue=info, Color=(0.8, 0.2, 0.2)))

    random_colour = material("random", by_random)
    hidden = bpy.data.collections.new("Library")
    for name, data, location in (
        ("Ball", sphere("Ball", random_colour, 0.18, 16, 8), (0.0, 0.0, 0.18)),
        ("Cap", box("Cap", diffuse((0.9, 0.8, 0.2)), (0.3, 0.3, 0.06)), (0.0, 0.0, 0.39)),
    ):
        created = bpy.data.objects.new(name, data)
        created.location = location
        hidden.objects.link(created)
    for index in range(6):
        empty = add_object(f"Instance {index}", None, (-1.5 + 0.6 * index, -1.0 + 0.2 * index, 0.0), (0, 0, 15 * index))
        empty.instance_type, empty.instance_collection = "COLLECTION", hidden
        empty.scale = (1.0, 1.0, 0.6 + 0.2 * index)

    tree = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    leave = tree.nodes.new("NodeGroupOutput")
    grid = tree.nodes.new("GeometryNodeMeshGrid")
    cube = tree.nodes.new("GeometryNodeMeshCube")
    paint = tree.nodes.new("GeometryNodeSetMaterial")
    scatter = tree.nodes.new("GeometryNodeInstanceOnPoints")
    cube.inputs["Size"].default_value = (0.12, 0.12, 0.3)
    paint.inputs["Material"].default_value = random_colour
    for name, value in (("Size X", 3.0), ("Size Y", 1.5), ("Vertices X", 9), ("Vertices Y", 5)):
        grid.inputs[name].default_value = value
    tree.links.new(cube.outputs["Mesh"], paint.inputs["Geometry"])
    tree.links.new(grid.outputs["Mesh"], scatter.inputs["Points"])
    tree.links.new(paint.outputs["Geometry"], scatter.inputs["Instance"])
    tree.links.new(scatter.outputs["Instances"], leave.inputs[0])

    holder = add_object("Scatter", box("Scatter", random_colour), (0.0, 1.2, 0.15))
    holder.modifiers.new("Scatter", "NODES").node_group = tree


@scene("attributes")
def attributes() -> None:
    """Colour attributes on points and corners, a generic attribute on faces, two UV maps."""
    lit_stage()

    def surface(nodes: Nodes) -> Socket:
        colour = nodes("VertexColor", {"layer_name": "Paint"})
        value = nodes("Attribute", {"attribute_name": "warmth"}, output="Fac")
        second = nodes("UVMap", {"uv_map": "Second"})
        checker = nodes("TexChecker", Vector=second, Scale=4.0)

        node = nodes.node("Mix", {"data_type": "RGBA"}, {"Factor_Float": value, "A_Color": colour, "B_Color": checker})
        return nodes("BsdfDiffuse", Color=next(s for s in node.outputs if s.identifier == "Result_Color"))

    painted = material("painted", surface)
    show(painted)
    for name, domain in (("Sphere", "POINT"), ("Box", "CORNER")):
        data = bpy.data.objects[name].data
        layer = data.color_attributes.new("Paint", "FLOAT_COLOR", domain)
        generator = np.random.default_rng(3)
        layer.data.foreach_set("color", generator.uniform(0.0, 1.0, 4 * len(layer.data)).astype(np.float32))
        warmth = data.attributes.new("warmth", "FLOAT", "FACE")
        warmth.data.foreach_set("value", generator.uniform(0.0, 1.0, len(warmth.data)).astype(np.float32))
        second = data.uv_layers.new(name="Second")
        uv = np.zeros(2 * len(second.data), np.float32)
        data.uv_layers[0].data.foreach_get("uv", uv)
        second.data.foreach_set("uv", 1.7 * uv)


@scene("transforms")
def transforms() -> None:
    """Negative and non-uniform scales on smooth and flat meshes, parent and child."""
    lit_stage()
    show(material("glossy", lambda nodes: nodes("BsdfAnisotropic", {"distribution": "GGX"}, Roughness=0.25)))
    ball, block = bpy.data.objects["Sphere"], bpy.data.objects["Box"]
    ball.scale, block.scale = (-1.0, 0.6, 1.2), (0.7, -0.5, 1.3)
    block.parent = ball
    block.location = (-1.6, -0.6, -0.2)


@scene("low-poly")
def low_poly() -> None:
    """Smooth normals on coarse meshes, diffuse and glossy: the shadow terminator and bent reflections."""
    lit_stage()
    add_object("A", sphere("A", diffuse((0.7, 0.6, 0.5)), 0.8, 10, 6), (-0.9, 0, 0.8))
    shiny = material("shiny", lambda nodes: nodes("BsdfAnisotropic", {"distribution": "GGX"}, Roughness=0.1))
    add_object("B", sphere("B", shiny, 0.8, 10, 6), (0.9, 0, 0.8))


@scene("low-poly-glass", samples=128, note=ROUGH_REFRACTION)
def low_poly_glass() -> None:
    """Smooth normals on coarse rough glass."""
    lit_stage()
    add_object("A", sphere("A", material("glass", glass_rough), 0.8, 10, 6), (0, 0, 0.8))


@scene("visibility")
def visibility() -> None:
    """Objects hidden from one kind of ray each, a holdout, and a hidden one."""
    lit_stage()
    for index, name in enumerate(("camera", "diffuse", "glossy", "transmission", "shadow")):
        block = box(name, diffuse((0.2 + 0.15 * index, 0.5, 0.3)), (0.5, 0.5, 0.8))
        created = add_object(name, block, (-1.4 + 0.7 * index, -0.3, 0.4))
        setattr(created, f"visible_{name}", False)
    mirror = material("mirror", lambda nodes: nodes("BsdfAnisotropic", {"distribution": "GGX"}, Roughness=0.0))
    add_object("Mirror", quad("Mirror", mirror, 3.0, 1.2), (0.0, 1.4, 1.2), (100, 0, 0))
    add_object("Hidden", box("Hidden", diffuse((1, 0, 0))), (0, -2, 0.5)).hide_render = True
    holdout = add_object("Holdout", box("Holdout", diffuse((0, 1, 0)), (0.4, 0.4, 0.4)), (1.2, -1.5, 0.2))
    holdout.is_holdout = True


@scene("curves")
def curves() -> None:
    """A bevelled curve, text and a metaball: everything that becomes a mesh on evaluation."""
    lit_stage()
    path = bpy.data.curves.new("Path", "CURVE")
    path.dimensions, path.bevel_depth, path.resolution_u = "3D", 0.1, 6
    spline = path.splines.new("BEZIER")
    spline.bezier_points.add(2)
    for point, position in zip(spline.bezier_points, ((-1.5, 0, 0.3), (-0.5, 0.5, 1.2), (0.4, 0, 0.3)), strict=True):
        point.co = position
        point.handle_left_type = point.handle_right_type = "AUTO"
    path.materials.append(diffuse((0.8, 0.3, 0.2)))
    add_object("Path", path)
    text = bpy.data.curves.new("Text", "FONT")
    text.body, text.size, text.extrude = "Ng", 0.9, 0.05
    text.materials.append(diffuse((0.2, 0.5, 0.8)))
    add_object("Text", text, (0.5, -0.6, 0.1), (80, 0, 0))
    ball = bpy.data.metaballs.new("Ball")
    ball.resolution = ball.render_resolution = 0.15
    for x in (0.0, 0.5):
        element = ball.elements.new()
        element.co, element.radius = (x, 0, 0), 0.6
    ball.materials.append(diffuse((0.3, 0.7, 0.3)))
    add_object("Ball", ball, (-0.3, -1.2, 0.4))


@scene("modifiers")
def modifiers() -> None:
    """Subdivision, mirror and solidify, with several materials on one mesh."""
    lit_stage()
    show(diffuse((0.7, 0.3, 0.3)))
    block = bpy.data.objects["Box"]
    block.data.materials.append(diffuse((0.2, 0.3, 0.8)))
    block.data.polygons.foreach_set("material_index", [0, 1, 0, 1, 0, 1])
    subdivide = block.modifiers.new("Subdivide", "SUBSURF")
    subdivide.levels = subdivide.render_levels = 2
    bpy.data.objects["Sphere"].modifiers.new("Wireframe", "WIREFRAME").thickness = 0.08
