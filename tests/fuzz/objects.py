# SPDX-License-Identifier: GPL-3.0-or-later
"""Random meshes, lamps and cameras, and how they stand in a scene."""

from __future__ import annotations

import math
from random import Random
from typing import Any

from tests.fuzz.node_trees import LIGHT, TreeMaker, node_tree
from tests.fuzz.numbers import angles, chance, color, number

#: Rays that an object may be hidden from.
VISIBILITIES = (
    "visible_camera", "visible_diffuse", "visible_glossy", "visible_transmission", "visible_volume_scatter",
    "visible_shadow",
)  # fmt: skip
_SHAPES = (
    ("cube", {"size": 1.6}), ("plane", {"size": 3.0}), ("uv_sphere", {"segments": 12, "ring_count": 6}),
    ("ico_sphere", {"subdivisions": 2}), ("cone", {"vertices": 7}), ("torus", {"major_segments": 12, "minor_segments": 6}),
    ("monkey", {}), ("grid", {"x_subdivisions": 3, "y_subdivisions": 3}),
)  # fmt: skip


def add_material(random: Random, maker: TreeMaker) -> Any:
    """A material of random nodes."""
    import bpy

    material = bpy.data.materials.new("Material")
    if chance(random, 0.03):
        material.diffuse_color = color(random)
        if hasattr(material, "use_nodes"):
            return material
    tree = node_tree(material)
    maker.fill(tree, "ShaderNodeOutputMaterial")
    if chance(random, 0.1):
        maker.add_volume(tree, alone=chance(random, 0.5))
    material.pass_index = random.randrange(5)
    material.use_transparent_shadow = not chance(random, 0.15)
    material.cycles.emission_sampling = random.choice(("AUTO", "NONE", "FRONT", "BACK", "FRONT_BACK"))
    material.cycles.use_bump_map_correction = chance(random, 0.8)
    return material


def add_floor(random: Random, material: Any) -> Any:
    """Something large, so that there is something to see."""
    import bpy

    bpy.ops.mesh.primitive_plane_add(size=random.choice((8.0, 30.0)), location=(0.0, 0.0, -1.5))
    bpy.context.object.data.materials.append(material)
    return bpy.context.object


def add_mesh(random: Random, materials: list[Any]) -> Any:
    """A primitive somewhere before the camera, at times smooth, mirrored, flat, hidden from some rays or a holdout."""
    import bpy

    shape, arguments = random.choice(_SHAPES)
    place = tuple(random.uniform(-2.0, 2.0) for _ in range(3))
    getattr(bpy.ops.mesh, f"primitive_{shape}_add")(location=place, rotation=angles(random), **arguments)
    added = bpy.context.object
    for _ in range(random.choice((0, 1, 1, 1, 2))):
        added.data.materials.append(random.choice(materials))
    for polygon in added.data.polygons:
        polygon.material_index = random.randrange(max(len(added.data.materials), 1))
        polygon.use_smooth = chance(random, 0.5)
    _add_attributes(random, added.data)
    added.scale = tuple(random.uniform(0.5, 1.5) * random.choice((1, 1, 1, -1)) for _ in range(3))
    if chance(random, 0.08):
        added.scale[random.randrange(3)] = random.choice((0.0, 1e-4, 1e-2, 20.0))
    added.color, added.pass_index = color(random), random.randrange(5)
    _choose_visibility(random, added)
    added.is_holdout = chance(random, 0.04)
    added.is_shadow_catcher = chance(random, 0.04)
    if chance(random, 0.06):
        added.modifiers.new("Subdivision", "SUBSURF").render_levels = random.randrange(3)
    return added


def _add_attributes(random: Random, mesh: Any) -> None:
    if chance(random, 0.5):
        attribute = mesh.color_attributes.new("Tint", random.choice(("FLOAT_COLOR", "BYTE_COLOR")), "CORNER")
        attribute.data.foreach_set("color", [x for _ in attribute.data for x in color(random)])
    if chance(random, 0.3):
        attribute = mesh.attributes.new("Mask", "FLOAT", random.choice(("POINT", "FACE")))
        attribute.data.foreach_set("value", [random.random() for _ in attribute.data])
    if chance(random, 0.1) and mesh.uv_layers:
        mesh.uv_layers.remove(mesh.uv_layers[0])


def _choose_visibility(random: Random, item: Any) -> None:
    for name in VISIBILITIES:
        if chance(random, 0.04):
            setattr(item, name, False)


def add_copies(random: Random, items: list[Any]) -> None:
    """Instances of meshes, and children."""
    import bpy

    for item in list(items):
        if chance(random, 0.15):
            copy = item.copy()
            copy.location = tuple(random.uniform(-2.0, 2.0) for _ in range(3))
            bpy.context.collection.objects.link(copy)
            if chance(random, 0.5):
                copy.parent = random.choice(items)
    if chance(random, 0.1):
        empty = bpy.data.objects.new("Instancer", None)
        group = bpy.data.collections.new("Group")
        group.objects.link(random.choice(items))
        empty.instance_type, empty.instance_collection = "COLLECTION", group
        empty.location, empty.rotation_euler = (random.uniform(-2.0, 2.0), 1.0, 0.5), angles(random)
        bpy.context.collection.objects.link(empty)


def add_lamp(random: Random, maker: TreeMaker) -> Any:
    """A lamp of any kind."""
    import bpy

    kind = random.choice(("POINT", "SUN", "SPOT", "AREA"))
    lamp = bpy.data.lights.new("Lamp", kind)
    item = bpy.data.objects.new("Lamp", lamp)
    item.location = tuple(random.uniform(-4.0, 4.0) for _ in range(2)) + (random.uniform(0.0, 4.0),)
    item.rotation_euler = (random.uniform(-1.2, 1.2), random.uniform(-1.2, 1.2), random.uniform(-3.0, 3.0))
    lamp.color = color(random)[:3]
    lamp.energy = random.choice((0.0, 1.0, 4.0, -1.0)) if kind == "SUN" else random.choice((0.0, 50.0, 300.0, 300.0, -50.0))
    if kind == "SUN":
        lamp.angle = random.choice((0.0, 0.01, 0.5, math.pi))
    elif kind == "AREA":
        lamp.shape = random.choice(("SQUARE", "RECTANGLE", "DISK", "ELLIPSE"))
        lamp.size, lamp.size_y = random.choice((0.0, 0.1, 1.0, 4.0)), random.choice((0.0, 0.5, 2.0))
        lamp.spread = random.choice((math.pi, math.pi, 1.0, 0.02))
    else:
        lamp.shadow_soft_size = random.choice((0.0, 0.05, 0.5, 2.0))
        if hasattr(lamp, "use_soft_falloff"):
            lamp.use_soft_falloff = chance(random, 0.5)
    if kind == "SPOT":
        lamp.spot_size, lamp.spot_blend = random.choice((0.02, 0.8, 2.0, math.pi)), random.choice((0.0, 0.15, 1.0))
    if hasattr(lamp, "exposure") and chance(random, 0.2):
        lamp.exposure = random.uniform(-2.0, 2.0)
    if hasattr(lamp, "normalize"):
        lamp.normalize = chance(random, 0.85)
    if hasattr(lamp, "use_temperature"):
        lamp.use_temperature, lamp.temperature = chance(random, 0.15), random.uniform(800.0, 20000.0)
    lamp.use_shadow = chance(random, 0.85)
    lamp.cycles.use_multiple_importance_sampling = chance(random, 0.8)
    lamp.cycles.max_bounces = random.choice((1024, 1024, 0, 1, 2))
    _choose_visibility(random, item)
    if chance(random, 0.15):
        maker.fill(node_tree(lamp), "ShaderNodeOutputLight", LIGHT[:1] + LIGHT[2:])
    bpy.context.collection.objects.link(item)
    return item


def add_camera(random: Random) -> None:
    """A camera that looks at the middle."""
    import bpy
    from mathutils import Vector

    camera = bpy.data.cameras.new("Camera")
    item = bpy.data.objects.new("Camera", camera)
    item.location = Vector((random.uniform(-3.0, 3.0), -7.0, random.uniform(0.0, 4.0)))
    item.rotation_mode = "QUATERNION"
    item.rotation_quaternion = (-item.location).to_track_quat("-Z", "Y")
    camera.type = random.choice(("PERSP", "PERSP", "PERSP", "ORTHO", "PANO"))
    camera.lens = random.choice((15.0, 35.0, 50.0))
    camera.ortho_scale = random.choice((2.0, 6.0, 12.0))
    camera.sensor_fit = random.choice(("AUTO", "HORIZONTAL", "VERTICAL"))
    if camera.type == "PANO":
        (camera if hasattr(camera, "panorama_type") else camera.cycles).panorama_type = "EQUIRECTANGULAR"
    camera.shift_x, camera.shift_y = (random.uniform(-0.3, 0.3) if chance(random, 0.2) else 0.0 for _ in range(2))
    if chance(random, 0.1):
        camera.clip_start, camera.clip_end = random.choice((1e-3, 0.1, 5.0)), random.choice((8.0, 100.0))
    if chance(random, 0.25):
        camera.dof.use_dof, camera.dof.focus_distance = True, number(random, 2.0, 9.0)
        camera.dof.aperture_fstop = random.choice((0.05, 0.5, 2.8))
        camera.dof.aperture_blades = random.choice((0, 3, 6))
        camera.dof.aperture_ratio = random.choice((1.0, 1.0, 2.0))
        camera.dof.aperture_rotation = random.choice((0.0, 0.7))
    bpy.context.collection.objects.link(item)
    bpy.context.scene.camera = item
