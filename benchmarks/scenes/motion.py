# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur: what turns, flies, grows, bends, glows, is instanced, or looks on while the shutter is open."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import bpy

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    add_object,
    box,
    camera,
    diffuse,
    emitter,
    light,
    lit_stage,
    material,
    mesh,
    quad,
    resolution,
    sphere,
    stage,
    world,
)

#: The frame rendered; keys lie one frame before and after it.
FRAME = 10


def _shutter(length: float = 1.0, position: str = "CENTER") -> None:
    """Motion blur over so many frames."""
    now = bpy.context.scene
    now.frame_set(FRAME)
    now.render.use_motion_blur = True
    now.render.motion_blur_shutter = length
    now.render.motion_blur_position = position
    # Open all the time; Blender's own curve opens and closes gently.
    curve = now.render.motion_blur_shutter_curve.curves[0]
    for point in curve.points:
        point.location.y = 1.0
    now.render.motion_blur_shutter_curve.update()


def _straighten(owner: Any) -> None:
    """Even speed between keys."""
    for layer in owner.id_data.animation_data.action.layers:
        for strip in layer.strips:
            for bag in strip.channelbags:
                for curve in bag.fcurves:
                    for point in curve.keyframe_points:
                        point.interpolation = "LINEAR"


def _animate(owner: Any, path: str, *values: Sequence[float] | float) -> None:
    """Keys of a property at the frames before, at and after the rendered one (three), or before and after it (two)."""
    frames = (FRAME - 1, FRAME + 1) if len(values) == 2 else (FRAME - 1, FRAME, FRAME + 1)
    for frame, value in zip(frames, values, strict=True):
        setattr(owner, path, value)
        owner.keyframe_insert(path, frame=frame)
    _straighten(owner)


def _checked(nodes: Nodes) -> Socket:
    """Checks in object space: they must turn with the object."""
    where = nodes("TexCoord", output="Object")
    colors = {"Color1": (0.8, 0.7, 0.1, 1.0), "Color2": (0.1, 0.2, 0.6, 1.0)}
    return nodes("BsdfDiffuse", Color=nodes("TexChecker", Vector=where, Scale=4.0, inputs=colors))


@scene("motion-propeller")
def propeller() -> None:
    """Blades that turn a hundred degrees while the shutter is open, checked in object space."""
    lit_stage()
    checked = material("checked", _checked)
    for index in range(3):
        blade = add_object("Blade", box("Blade", checked, (2.2, 0.28, 0.06)), (0.0, -0.4, 0.9), (70, 0, 60 * index))
        blade.rotation_mode = "XYZ"
        x, y, z = blade.rotation_euler
        _animate(blade, "rotation_euler", (x, y, z - math.radians(100)), (x, y, z + math.radians(100)))
        blade.cycles.motion_steps = 3
    _shutter()


@scene("motion-flight")
def flight() -> None:
    """A ball and a mirrored box, child of something turned, that fly by on bent ways, of different numbers of steps."""
    lit_stage()
    ball = add_object("Ball", sphere("Ball", diffuse((0.8, 0.3, 0.1), "ball"), 0.4))
    _animate(ball, "location", (-2.0, -0.5, 0.4), (0.0, -0.5, 1.8), (1.6, -0.8, 0.4))
    ball.cycles.motion_steps = 2
    holder = add_object("Holder", None, (0.6, 0.2, 0.6), (0, 0, 30))
    holder.scale = (1.2, 1.2, 1.2)
    glossy = material("glossy", lambda nodes: nodes("BsdfAnisotropic", Color=(0.8, 0.9, 0.8), Roughness=0.3))
    cube = add_object("Cube", box("Cube", glossy, (0.7, 0.7, 0.7)), (0.0, 0.0, 0.0), (25, 30, 0))
    cube.parent = holder
    cube.scale = (-1.0, 1.0, 1.0)
    _animate(cube, "location", (0.0, -0.6, 0.0), (0.3, 0.8, 0.3))
    _shutter()


@scene("motion-camera")
def camera_moves() -> None:
    """A camera that turns and goes sideways, with a shallow focus."""
    lit_stage()
    add_object("Sphere", sphere("Sphere", material("checked", _checked), 0.8), (-0.75, 0.0, 0.8))
    view = bpy.context.scene.camera
    view.data.dof.use_dof, view.data.dof.focus_distance, view.data.dof.aperture_fstop = True, 6.0, 0.8
    x, y, z = view.rotation_euler
    _animate(view, "location", (-0.5, -6.0, 2.6), (0.6, -5.6, 2.9))
    _animate(view, "rotation_euler", (x, y - 0.05, z), (x - 0.05, y + 0.05, z + 0.12))
    _shutter()


@scene("motion-zoom")
def zoom() -> None:
    """Blur that begins at the frame by a lens that zooms in; shift and focus change too, which does not blur."""
    lit_stage()
    add_object("Sphere", sphere("Sphere", material("checked", _checked), 0.8), (-0.75, 0.0, 0.8))
    add_object("Box", box("Box", diffuse((0.2, 0.5, 0.7), "box")), (1.1, 0.6, 0.5), (0, 0, 30))
    lens = bpy.context.scene.camera.data
    lens.dof.use_dof, lens.dof.aperture_fstop = True, 1.2
    _animate(lens, "lens", 20.0, 32.0, 70.0)
    _animate(lens, "shift_x", -0.1, 0.06, 0.3)
    _animate(lens.dof, "focus_distance", 3.0, 6.0, 12.0)
    _shutter(0.8, "START")


@scene("motion-rolling")
def rolling() -> None:
    """Blades that turn and a camera that pans, seen row by row from the top, each for a quarter of the time."""
    lit_stage()
    checked = material("checked", _checked)
    for index in range(3):
        blade = add_object("Blade", box("Blade", checked, (2.2, 0.28, 0.06)), (0.0, -0.4, 0.9), (70, 0, 60 * index))
        x, y, z = blade.rotation_euler
        _animate(blade, "rotation_euler", (x, y, z - math.radians(60)), (x, y, z + math.radians(60)))
        blade.cycles.motion_steps = 3
    view = bpy.context.scene.camera
    x, y, z = view.rotation_euler
    _animate(view, "rotation_euler", (x, y, z - 0.12), (x, y, z + 0.12))
    now = bpy.context.scene
    now.cycles.rolling_shutter_type, now.cycles.rolling_shutter_duration = "TOP", 0.25
    _shutter()


@scene("motion-deform")
def deform() -> None:
    """A smooth ball that is pressed flat and back by shape keys, and a ribbon that a modifier bends."""
    lit_stage()
    glossy = material("glossy", lambda nodes: nodes("BsdfAnisotropic", Color=(0.8, 0.8, 0.9), Roughness=0.35))
    ball = add_object("Ball", sphere("Ball", glossy, 0.8), (-0.8, -0.2, 0.8))
    ball.shape_key_add(name="Basis")
    flat = ball.shape_key_add(name="Flat")
    for point in flat.data:
        point.co.z = 0.35 * point.co.z - 0.5
        point.co.x *= 1.2
    _animate(flat, "value", 0.0, 1.0, 0.2)
    ball.cycles.motion_steps = 2
    green = diffuse((0.2, 0.6, 0.3), "ribbon")
    ribbon = add_object("Ribbon", quad("Ribbon", green, 0.5, 1.4), (0.9, -0.3, 0.9), (90, 0, 0))
    ribbon.modifiers.new("Subdivide", "SUBSURF").subdivision_type = "SIMPLE"
    ribbon.modifiers[0].render_levels = ribbon.modifiers[0].levels = 4
    bend = ribbon.modifiers.new("Bend", "SIMPLE_DEFORM")
    bend.deform_method, bend.deform_axis = "BEND", "Z"
    for frame, angle in ((FRAME - 1, -1.5), (FRAME + 1, 1.5)):
        bend.angle = angle
        ribbon.keyframe_insert('modifiers["Bend"].angle', frame=frame)
    _straighten(ribbon)
    _shutter()


@scene("motion-grow")
def grow() -> None:
    """A box that grows unevenly, and one that keeps still by its own switch though it is animated."""
    lit_stage()
    grows = add_object("Grows", box("Grows", diffuse((0.7, 0.5, 0.2), "grows")), (-0.7, 0.0, 0.7), (15, 25, 10))
    _animate(grows, "scale", (0.4, 1.0, 1.0), (1.4, 0.5, 1.5))
    still = add_object("Still", box("Still", diffuse((0.2, 0.5, 0.7), "still")), (0.9, 0.0, 0.5))
    _animate(still, "location", (0.0, 0.0, 0.5), (1.8, 0.0, 0.5))
    still.cycles.use_motion_blur = False
    _shutter()


@scene("motion-emitter", samples=128, note="Cycles' shutter ends 0.6% early", allowance=0.035)
def glowing() -> None:
    """A glowing card that turns over as it flies, and a small ball that glows where it is squeezed: all the light."""
    stage()
    world((0.02, 0.02, 0.02))
    card = add_object("Card", quad("Card", emitter((1.0, 0.8, 0.5), 12.0), 1.2, 0.8), (0.0, -0.5, 2.2))
    _animate(card, "location", (-1.6, -0.5, 2.0), (1.4, -0.8, 2.4))
    _animate(card, "rotation_euler", (2.0, 0.3, 0.0), (4.2, -0.3, 0.5))
    card.cycles.motion_steps = 3
    ball = add_object("Ball", sphere("Ball", emitter((0.3, 0.5, 1.0), 20.0), 0.25, 24, 12), (0.9, -0.9, 0.4))
    ball.shape_key_add(name="Basis")
    flat = ball.shape_key_add(name="Flat")
    for point in flat.data:
        point.co.z *= 0.2
    _animate(flat, "value", 0.0, 1.0)
    _shutter()


@scene("motion-instances")
def instances() -> None:
    """A collection shown by empties that circle, each with something in it that turns by itself."""
    lit_stage()
    hidden = bpy.data.collections.new("Library")
    spinner = bpy.data.objects.new("Spinner", box("Spinner", material("checked", _checked), (0.6, 0.12, 0.12)))
    spinner.location = (0.0, 0.0, 0.3)
    hidden.objects.link(spinner)
    _animate(spinner, "rotation_euler", (0.0, 0.0, -1.2), (0.0, 0.0, 1.2))
    post = bpy.data.objects.new("Post", box("Post", diffuse((0.4, 0.3, 0.3), "post"), (0.1, 0.1, 0.3)))
    post.location = (0.0, 0.0, 0.15)
    hidden.objects.link(post)
    for index in range(7):
        angle = 2.0 * math.pi * index / 7
        empty = add_object(f"Instance {index}", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", hidden
        _animate(
            empty, "location",
            *((1.5 * math.cos(a), 1.1 * math.sin(a) - 0.3, 0.1 * index) for a in (angle - 0.25, angle + 0.25)),
        )  # fmt: skip
    _shutter()


@scene("motion-start-curve")
def start_curve() -> None:
    """Blur that begins at the frame, through a shutter that opens at once and closes slowly; a lamp moves as well."""
    lit_stage()
    ball = add_object("Ball", sphere("Ball", diffuse((0.8, 0.2, 0.2), "ball"), 0.5), (0.0, -0.4, 0.5))
    _animate(ball, "location", (-1.6, -0.4, 0.5), (1.6, -0.4, 0.5))
    lamp = light("SPOT", 300.0, (0.0, -3.0, 4.0), shadow_soft_size=0.1, spot_size=0.5)
    _animate(lamp, "location", (-1.0, -3.0, 4.0), (1.0, -3.0, 4.0))
    _shutter(0.8, "START")
    curve = bpy.context.scene.render.motion_blur_shutter_curve
    points = sorted(curve.curves[0].points, key=lambda point: point.location.x)
    for index, point in enumerate(points):
        point.location.y = 1.0 - index / (len(points) - 1)
        point.handle_type = "VECTOR"
    curve.update()


@scene("motion-glass", samples=128)
def glass() -> None:
    """A glass ball and a mirror that fly, seen in each other and behind a still pane."""
    resolution()
    world((0.3, 0.35, 0.4))
    light("AREA", 200.0, (2.0, -2.0, 4.0), size=3.0)
    add_object("Floor", quad("Floor", diffuse((0.6, 0.6, 0.6), "floor"), 12.0, 12.0))
    clear = material("clear", lambda nodes: nodes("BsdfGlass", {"distribution": "GGX"}, Roughness=0.0, IOR=1.4))
    mirror = material("mirror", lambda nodes: nodes("BsdfAnisotropic", Color=(0.9, 0.9, 0.9), Roughness=0.0))
    ball = add_object("Ball", sphere("Ball", clear, 0.6), (0.0, -0.6, 0.7))
    _animate(ball, "location", (-0.9, -0.6, 0.7), (0.5, -0.9, 0.9))
    flat = add_object("Mirror", quad("Mirror", mirror, 2.0, 1.4), (0.8, 0.9, 0.8), (80, 0, -20))
    _animate(flat, "location", (0.5, 0.9, 0.7), (1.1, 0.6, 1.0))
    add_object("Box", box("Box", material("checked", _checked), (0.6, 0.6, 0.6)), (-0.9, 0.4, 0.3), (0, 0, 30))
    camera((0.0, -5.0, 2.0), (0.0, 0.0, 0.6))
    _shutter()


def _room(name: str, surface: Any, half: float, height: float) -> None:
    """Floor, ceiling and walls but the one towards -y."""
    x, z = half, height
    corners = [(i, j, k) for i in (-x, x) for j in (-x, x) for k in (0.0, z)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    add_object(name, mesh(name, corners, faces, surface))


@scene("blur-tower", samples=128)
def tower() -> None:
    """A glowing body flies behind a tower of cubes that fall: what lights a place depends on when it is looked at."""
    resolution()
    world((0.0, 0.0, 0.0))
    _room("Room", diffuse((0.7, 0.7, 0.7), "room"), 2.5, 3.0)
    body = add_object("Body", sphere("Body", emitter((1.0, 0.8, 0.6), 60.0), 0.16, 24, 12))
    _animate(body, "location", (-1.9, 1.2, 0.5), (1.9, 0.9, 1.4))
    for row in range(4):
        for column in range(4):
            color = (0.3 + 0.15 * row, 0.45, 0.75 - 0.15 * column)
            cube = add_object("Cube", box("Cube", diffuse(color, "cube"), (0.42, 0.42, 0.42)))
            x, z = -0.8 + 0.5 * column, 0.22 + 0.46 * row
            away = 0.25 * row
            _animate(cube, "location", (x, 0.2, z), (x + away, 0.2 - away, max(z - 0.5 * away, 0.22)))
            _animate(cube, "rotation_euler", (0.0, 0.0, 0.0), (0.6 * away, 0.9 * away, 0.4 * column * away))
    camera((0.0, -5.2, 1.6), (0.0, 0.0, 1.1), 40.0)
    _shutter()


@scene("blur-lamp", samples=128)
def lamp_room() -> None:
    """A furnished room lit by what two shaded lamps throw at its ceiling; one of them is carried along a wall."""
    resolution()
    world((0.0, 0.0, 0.0))
    _room("Room", diffuse((0.7, 0.68, 0.62), "room"), 2.5, 2.6)
    shade = diffuse((0.6, 0.55, 0.5), "shade")
    sides = 16
    ring = [(math.cos(2 * math.pi * i / sides), math.sin(2 * math.pi * i / sides)) for i in range(sides)]
    corners = [(r * x, r * y, z) for r, z in ((0.12, -0.25), (0.2, 0.25)) for x, y in ring]
    faces: list[tuple[int, ...]] = [
        (i, (i + 1) % sides, sides + (i + 1) % sides, sides + i) for i in range(sides)
    ]
    faces.append(tuple(range(sides)))
    for name, power, places in (
        ("Carried", 120.0, ((-1.9, 1.3, 1.3), (1.7, 1.7, 1.6))), ("Standing", 40.0, ((2.0, -0.6, 1.1),)),
    ):
        holder = add_object(name, mesh(f"{name} Shade", corners, faces, shade), places[0])
        bulb = add_object(f"{name} Bulb", sphere(f"{name} Bulb", emitter((1.0, 0.8, 0.55), power), 0.06, 16, 8))
        bulb.parent = holder
        if len(places) > 1:
            _animate(holder, "location", *places)
    table, glossy = diffuse((0.45, 0.3, 0.2), "table"), material(
        "vase", lambda nodes: nodes("BsdfAnisotropic", Color=(0.5, 0.6, 0.7), Roughness=0.25)
    )
    add_object("Table", box("Table", table, (1.6, 0.8, 0.06)), (-0.2, 0.2, 0.7))
    for x, y in ((-0.9, -0.1), (0.5, -0.1), (-0.9, 0.5), (0.5, 0.5)):
        add_object("Leg", box("Leg", table, (0.06, 0.06, 0.68)), (x, y, 0.34))
    add_object("Vase", sphere("Vase", glossy, 0.22), (-0.5, 0.2, 0.95))
    add_object("Box", box("Box", diffuse((0.25, 0.4, 0.3), "box"), (0.3, 0.3, 0.4)), (0.25, 0.15, 0.93), (0, 0, 25))
    add_object("Shelf", box("Shelf", table, (0.5, 1.6, 1.2)), (-2.2, 0.4, 0.6))
    camera((0.3, -5.0, 1.7), (-0.1, 0.2, 1.15), 42.0)
    _shutter()


@scene("blur-turning-room", samples=128)
def turning_room() -> None:
    """A lamp hidden in a drum with slits that turns: beams sweep over the room."""
    resolution()
    world((0.0, 0.0, 0.0))
    _room("Room", diffuse((0.75, 0.72, 0.7), "room"), 2.5, 3.0)
    add_object("Lamp", sphere("Lamp", emitter((1.0, 0.9, 0.7), 150.0), 0.08, 24, 12), (0.0, 0.4, 1.0))
    metal = diffuse((0.5, 0.5, 0.55), "drum")
    sides, open_sides = 24, (0, 1, 8, 9, 16)
    ring = [(0.45 * math.cos(2 * math.pi * i / sides), 0.45 * math.sin(2 * math.pi * i / sides)) for i in range(sides)]
    corners = [(x, y, z) for z in (-0.5, 0.5) for x, y in ring]
    faces: list[tuple[int, ...]] = [
        (i, (i + 1) % sides, sides + (i + 1) % sides, sides + i) for i in range(sides) if i not in open_sides
    ]
    faces += [tuple(range(sides)), tuple(range(sides, 2 * sides))]
    drum = add_object("Drum", mesh("Drum", corners, faces, metal), (0.0, 0.4, 1.0))
    _animate(drum, "rotation_euler", (0.0, 0.0, -1.0), (0.0, 0.0, 1.0))
    drum.cycles.motion_steps = 3
    camera((0.0, -5.2, 1.8), (0.0, 0.0, 1.2), 40.0)
    _shutter()
