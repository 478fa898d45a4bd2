# SPDX-License-Identifier: GPL-3.0-or-later
"""One scene per way in which guiding is known to fail; `python -m benchmarks stability` renders them by every method.

What each is for is the first sentence of its docstring. All are small and, where the trouble allows it, half of their
light is easy to find: a bias of 2% of the image must be visible after some hundred thousand paths.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import bpy
import numpy as np

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    add_object,
    box,
    camera,
    diffuse,
    emitter,
    image,
    light,
    material,
    mesh,
    quad,
    resolution,
    sphere,
    world,
    world_nodes,
)
from benchmarks.scenes.walls import shell, wall_with_hole

WIDTH, HEIGHT = 48, 36
WHITE = (0.75, 0.75, 0.75)
#: Roughnesses of the sweep: the guide takes over somewhere in between (`prepare_guides`).
ROUGHNESSES = (0.0, 0.01, 0.03, 0.1, 0.3)
#: Sizes of the same scene [m a unit].
SCALES = {"1e-4": 1e-4, "1": 1.0, "1e6": 1e6}


def _begin(ambient: float = 0.0, width: int = WIDTH, height: int = HEIGHT) -> None:
    resolution(width, height)
    world((ambient, ambient, ambient))


@scene("fail-parallax")
def parallax() -> None:
    """Bright cards a hand above a wide floor: where the light comes from turns within every region that is learned."""
    _begin(0.12)
    add_object("Floor", quad("Floor", diffuse(WHITE, "floor"), 14.0, 14.0))
    for x, y in ((-1.3, 0.2), (1.2, 0.9), (0.2, -1.0)):
        add_object("Card", quad("Card", diffuse((0.9, 0.9, 0.9), "card"), 0.7, 0.7), (x, y, 0.22))
        light("SPOT", 4.0, (x, y, 0.02), (x, y, 1.0), shadow_soft_size=0.0, spot_size=math.radians(120))
    camera((0.0, -4.0, 3.0), (0.0, 0.0, 0.0), 40.0)


@scene("fail-thin")
def thin() -> None:
    """Slots between walls a thumb apart: regions so thin that positions hardly tell front from back."""
    _begin(0.15)
    add_object("Floor", quad("Floor", diffuse(WHITE, "floor"), 6.0, 6.0))
    wall = diffuse((0.8, 0.8, 0.8), "wall")
    for index in range(7):
        add_object("Wall", box("Wall", wall, (0.02, 2.4, 0.5)), (0.12 * index - 0.4, 0.0, 0.25))
    # From the far end, grazing: slots are lit by what the walls hand on.
    light("AREA", 60.0, (0.0, 3.0, 0.8), (0.0, 0.0, 0.1), size=0.6)
    camera((0.0, -2.2, 1.4), (0.0, 0.0, 0.2), 60.0)


@scene("fail-keyhole", samples=256)
def keyhole() -> None:
    """A room lit through a hole in its wall: a small part of all directions brings a large part of the light."""
    _begin()
    shell("Room", diffuse(WHITE, "room"), (-2, -2, 0), (2, 2, 3), "Y")
    shell("Next", diffuse((0.9, 0.85, 0.8), "next"), (-2, 2, 0), (2, 5, 3), "y")
    wall_with_hole("Door", diffuse((0.6, 0.6, 0.65), "door"), 2.0, (0.9, 1.3, 0.9, 1.3), 2.0, 3.0)
    light("POINT", 250.0, (-1.0, 3.5, 2.5), shadow_soft_size=0.1)
    light("AREA", 14.0, (0.0, 0.0, 2.9), (0.0, 0.0, 0.0), size=1.5)
    camera((-1.6, -1.8, 1.6), (0.5, 1.2, 1.0), 26.0)


@scene("fail-dark-bright", samples=256)
def dark_bright() -> None:
    """A dark room in front of one a thousand times as bright: what is learned belongs to the bright one."""
    _begin()
    shell("Dark", diffuse((0.5, 0.5, 0.55), "dark"), (-2, -3, 0), (2, 1, 3), "Y")
    shell("Bright", diffuse((0.85, 0.8, 0.7), "bright"), (-2, 1, 0), (2, 4, 3), "y")
    wall_with_hole("Wall", diffuse((0.6, 0.6, 0.6), "wall"), 1.0, (-0.5, 0.3, 0.001, 1.9), 2.0, 3.0)
    light("AREA", 600.0, (0.3, 2.8, 2.9), (0.3, 2.8, 0.0), size=0.8)
    light("AREA", 4.0, (0.0, -1.5, 2.9), (0.0, -1.5, 0.0), size=1.0)
    camera((-1.2, -2.8, 1.5), (0.2, 1.0, 1.0), 24.0)


def _metal(color: Sequence[float], roughness: float) -> object:
    """A metal's microfacets and nothing else."""
    ggx = {"distribution": "GGX"}
    return material("metal", lambda nodes: nodes("BsdfAnisotropic", ggx, Color=color, Roughness=roughness))


def _roughness(roughness: float) -> Callable[[], None]:
    def build() -> None:
        _begin(0.1)
        surface = _metal((0.9, 0.85, 0.8), roughness)
        add_object("Floor", quad("Floor", surface, 8.0, 8.0))
        add_object("Ball", sphere("Ball", surface, 0.6), (-0.8, 0.2, 0.6))
        add_object("Wall", box("Wall", diffuse((0.8, 0.5, 0.3), "wall"), (5.0, 0.1, 2.4)), (0.0, 1.6, 1.2))
        add_object("Block", box("Block", diffuse((0.4, 0.6, 0.8), "block"), (0.7, 0.7, 0.9)), (0.9, 0.1, 0.45))
        # Wide, so that the light it sends by way of the metal can be found at all.
        light("SPOT", 250.0, (1.5, -1.5, 3.0), (0.3, 1.6, 1.4), shadow_soft_size=0.4, spot_size=math.radians(40))
        camera((0.0, -4.5, 1.8), (0.0, 0.4, 0.7), 42.0)

    where = "where only the BSDF can sample" if roughness == 0.0 else "near where the BSDF is too narrow to guide"
    build.__doc__ = f"""Metal of roughness {roughness:g} before lit walls: {where}."""
    return build


for _value in ROUGHNESSES:
    scene(f"fail-roughness-{_value:g}", module=__name__)(_roughness(_value))


@scene("fail-late-caustic", samples=256)
def late_caustic() -> None:
    """Light through glass that few paths ever find: it is met first when much has been learned already."""
    _begin(0.25)
    add_object("Floor", quad("Floor", diffuse((0.7, 0.7, 0.7), "floor"), 10.0, 10.0))
    glass = material("glass", lambda nodes: nodes("BsdfGlass", Color=(1, 1, 1), Roughness=0.0, IOR=1.5))
    add_object("Ball", sphere("Ball", glass, 0.5, 64, 32), (0.0, 0.3, 0.55))
    add_object("Lamp", quad("Lamp", emitter((1.0, 0.8, 0.5), 35.0), 0.25, 0.25), (-1.6, 1.2, 2.2), (0, -35, 0))
    camera((0.4, -4.0, 2.4), (0.2, 0.0, 0.2), 46.0)


@scene("fail-fireflies", samples=256)
def fireflies() -> None:
    """A small lamp inside a glass bulb: no light sample reaches it, and the paths that do are rare and very bright."""
    _begin(0.3)
    add_object("Floor", quad("Floor", diffuse((0.7, 0.7, 0.7), "floor"), 8.0, 8.0))
    add_object("Wall", box("Wall", diffuse((0.7, 0.4, 0.3), "wall"), (4.0, 0.1, 2.0)), (0.0, 1.3, 1.0))
    glass = material("glass", lambda nodes: nodes("BsdfGlass", Color=(1, 1, 1), Roughness=0.0, IOR=1.3))
    add_object("Bulb", sphere("Bulb", glass, 0.22, 48, 24), (0.3, 0.2, 1.0))
    add_object("Filament", sphere("Filament", emitter((1.0, 0.9, 0.7), 12.0), 0.11, 16, 8), (0.3, 0.2, 1.0))
    camera((0.0, -4.2, 1.6), (0.0, 0.4, 0.7), 42.0)


@scene("fail-colors", samples=128)
def colors() -> None:
    """Surfaces that reflect one colour each, under light of single colours: most of what is bright is of no use."""
    _begin(0.03)
    for x, color in ((-1.0, (0.9, 0.0, 0.0)), (0.0, (0.0, 0.9, 0.0)), (1.0, (0.0, 0.0, 0.9))):
        add_object("Floor", quad("Floor", diffuse(color, "stripe"), 1.0, 4.0), (x, 0.0, 0.0))
    white = diffuse((0.8, 0.8, 0.8), "white")
    for x, color, energy in ((-1.9, (0.0, 1.0, 0.0), 400.0), (1.9, (1.0, 0.0, 0.0), 60.0)):
        add_object("Wall", box("Wall", white, (0.1, 4.0, 2.2)), (x, 0.0, 1.1))
        light("SPOT", energy, (-0.5 * x, -1.0, 2.5), (x, 0.6, 1.3), color=color, shadow_soft_size=0.02,
              spot_size=math.radians(40), spot_blend=0.3)  # fmt: skip
    add_object("Back", box("Back", white, (4.0, 0.1, 2.2)), (0.0, 2.0, 1.1))
    light("SPOT", 120.0, (0.0, -0.5, 2.5), (0.0, 2.0, 1.4), color=(0.0, 0.0, 1.0), shadow_soft_size=0.02,
          spot_size=math.radians(40))  # fmt: skip
    camera((0.0, -4.6, 2.6), (0.0, 0.0, 0.5), 44.0)


@scene("fail-many-lights", samples=128)
def lights() -> None:
    """Three thousand tiny lamps: no direction stands out, and regions of any size see many of them."""
    _begin()
    add_object("Floor", quad("Floor", diffuse((0.6, 0.6, 0.6), "floor"), 10.0, 10.0))
    add_object("Block", box("Block", diffuse((0.5, 0.5, 0.7), "block"), (1.0, 1.0, 1.0)), (-0.4, 0.3, 0.5), (0, 0, 30))
    generator = np.random.default_rng(11)
    count, half = 3000, 0.02
    centres = generator.uniform((-4, -2, 0.3), (4, 4, 3.0), (count, 3))
    offsets = half * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    corners = (centres[:, None] + offsets).reshape(-1, 3)
    lamps = mesh("Lamps", corners.tolist(), np.arange(4 * count).reshape(-1, 4).tolist())
    for color, strength in (((1.0, 0.6, 0.3), 20.0), ((0.4, 0.6, 1.0), 8.0), ((0.7, 1.0, 0.5), 2.0)):
        lamps.materials.append(emitter(color, strength))
    lamps.polygons.foreach_set("material_index", generator.integers(0, 3, count).astype(np.int32))
    # Lamps seen are single bright pixels: noise that says nothing about light.
    add_object("Lamps", lamps).visible_camera = False
    camera((0.0, -4.4, 3.6), (0.0, 0.2, 0.2), 42.0)


def _lamps(name: str, centres: np.ndarray, normals: Sequence[float], half: float, surfaces: Sequence[object]) -> None:
    """Small emissive squares, hidden from the camera: seen, they are bright pixels that say nothing about light.

    Parameters
    ----------
    centres : (N, 3)
    normals : axis that they all face, a unit vector along x, y or z
    half : half of their side
    surfaces : materials, taken in turns
    """
    normal = np.asarray(normals, float)
    u = np.roll(np.abs(normal), 1)
    v = np.cross(normal, u)
    offsets = half * np.array([-u - v, u - v, u + v, v - u])
    corners = (centres[:, None] + offsets).reshape(-1, 3)
    lamps = mesh(name, corners.tolist(), np.arange(4 * len(centres)).reshape(-1, 4).tolist())
    for surface in surfaces:
        lamps.materials.append(surface)
    lamps.polygons.foreach_set("material_index", (np.arange(len(centres)) % len(surfaces)).astype(np.int32))
    add_object(name, lamps).visible_camera = False


@scene("fail-ten-rooms", samples=128)
def ten_rooms() -> None:
    """A thousand lamps in ten closed rooms: nine tenths of them light nothing that is seen, and are the brighter."""
    _begin()
    wall = diffuse((0.7, 0.68, 0.65), "wall")
    generator = np.random.default_rng(12)
    dim = [emitter(color, 12.0) for color in ((1.0, 0.8, 0.6), (0.7, 0.8, 1.0))]
    bright = [emitter(color, 48.0) for color in ((1.0, 0.8, 0.6), (0.7, 0.8, 1.0))]
    for room in range(10):
        x, y = 3.2 * (room % 5 - 2), 3.2 * (room // 5)
        shell(f"Room {room}", wall, (x - 1.5, y - 1.5, 0.0), (x + 1.5, y + 1.5, 2.5))
        block = diffuse((0.5, 0.55, 0.7), "block")
        add_object(f"Block {room}", box("Block", block, (0.7, 0.7, 0.9)), (x + 0.4, y + 0.3, 0.45), (0, 0, 25))
        centres = generator.uniform((x - 1.4, y - 1.4, 2.3), (x + 1.4, y + 1.4, 2.45), (100, 3))
        _lamps(f"Lamps {room}", centres, (0, 0, -1), 0.02, dim if room == 2 else bright)
    camera((-1.2, -1.3, 1.7), (0.4, 0.5, 0.7), 22.0)


@scene("fail-street", samples=128)
def street() -> None:
    """A street of lit windows at night, among others: most windows are behind houses."""
    _begin()
    add_object("Ground", quad("Ground", diffuse((0.4, 0.4, 0.42), "ground"), 60.0, 60.0))
    house = diffuse((0.55, 0.5, 0.45), "house")
    generator = np.random.default_rng(13)
    glow = [emitter(color, strength) for color, strength in (((1.0, 0.75, 0.45), 30.0), ((0.8, 0.85, 1.0), 10.0))]
    ys = np.arange(-18.0, 18.1, 1.5)
    zs = np.array([1.2, 2.8, 4.4])
    for row in range(5):
        # Streets four metres wide between rows of houses six metres deep.
        x = 10.0 * (row - 2) - 5.0
        add_object(f"Houses {row}", box("Houses", house, (6.0, 40.0, 6.0)), (x, 0.0, 3.0))
        for side in (-1.0, 1.0):
            grid = np.stack(np.meshgrid([x + side * 3.02], ys, zs, indexing="ij"), -1).reshape(-1, 3)
            lit = grid[generator.random(len(grid)) < 0.6]
            _lamps(f"Windows {row} {side:g}", lit, (side, 0, 0), 0.3, glow)
    camera((0.9, -15.0, 1.7), (-0.3, 0.0, 1.6), 24.0)


@scene("fail-texel", samples=128)
def texel() -> None:
    """A sky black but for one texel and a faint glow: infinitely far, and narrower than any cell of directions."""
    _begin()
    pixels = np.full((256, 512, 4), 0.2, np.float32)
    pixels[190, 330, :3] = (700.0, 600.0, 450.0)
    sky = image("Sky", pixels, is_float=True, colorspace="Linear Rec.709")

    def surface(nodes: Nodes) -> Socket:
        return nodes("Background", Color=nodes("TexEnvironment", {"image": sky}, Vector=nodes("TexCoord")))

    sky_world = world_nodes(surface)
    # The map that it is sampled by is coarser than the texel, so that sampling the sky alone does not find it well.
    sky_world.cycles.sampling_method, sky_world.cycles.sample_map_resolution = "MANUAL", 128
    _corner_objects(1.0, (0.0, 0.0, 0.0))
    camera((0.0, -4.5, 2.2), (0.0, 0.3, 0.6), 42.0)


def _corner_objects(scale: float, offset: Sequence[float]) -> None:
    """A floor, a wall, a block and a glossy ball, all sizes times `scale`, moved by `offset`."""

    def put(name: str, data: object, location: Sequence[float], turn: float = 0.0) -> None:
        created = add_object(name, data, [scale * x + o for x, o in zip(location, offset)], (0, 0, turn))
        created.scale = (scale, scale, scale)

    put("Floor", quad("Floor", diffuse(WHITE, "floor"), 7.0, 7.0), (0, 0, 0))
    put("Wall", box("Wall", diffuse((0.7, 0.5, 0.4), "wall"), (4.0, 0.2, 2.2)), (0, 1.6, 1.1))
    put("Block", box("Block", diffuse((0.4, 0.5, 0.7), "block"), (0.8, 0.8, 1.0)), (0.9, 0.2, 0.5), 25.0)
    put("Ball", sphere("Ball", _metal(WHITE, 0.25), 0.5), (-0.8, 0.1, 0.5))


def _corner(scale: float, offset: Sequence[float], doc: str) -> Callable[[], None]:
    def build() -> None:
        _begin(0.1)

        def at(x: float, y: float, z: float) -> list[float]:
            return [scale * value + o for value, o in zip((x, y, z), offset)]

        _corner_objects(scale, offset)
        power = scale * scale
        light("SPOT", 250.0 * power, at(1.6, -1.2, 2.6), at(-0.3, 1.5, 1.4), shadow_soft_size=0.05 * scale,
              spot_size=math.radians(40))  # fmt: skip
        created = camera(at(0.0, -4.5, 2.0), at(0.0, 0.4, 0.7), 42.0)
        created.data.clip_start, created.data.clip_end = 0.05 * scale, 100.0 * scale

    build.__doc__ = doc
    return build


for _name, _scale in SCALES.items():
    scene(f"fail-scale-{_name}", module=__name__)(
        _corner(_scale, (0, 0, 0), f"A corner of {_name} m a unit, lit by way of its wall: figures of any magnitude.")
    )
scene("fail-offset-1e4", module=__name__)(
    _corner(1.0, (1e4, -1e4, 1e4), "The same corner 17 km from the origin: positions have a millimetre's precision.")
)


@scene("fail-plane", samples=128)
def plane() -> None:
    """Everything in one plane: positions have no extent along an axis. No faces overlap, which would be black."""
    _begin()
    for index, y in enumerate((-3.0, 3.25)):
        edge = 6.0 + 0.5 * index
        add_object(f"Floor {index}", quad("Floor", diffuse((0.7, 0.6, 0.5), "floor"), edge, edge), (0.0, y, 0.0))
    rows, columns = np.mgrid[0:32, 0:64]
    pixels = np.full((32, 64, 4), 0.2, np.float32)
    pixels[(rows > 18) & (rows < 26) & (columns > 38) & (columns < 46), :3] = (5.0, 4.0, 3.0)
    sky = image("Sky", pixels, is_float=True, colorspace="Linear Rec.709")
    sky_world = world_nodes(
        lambda nodes: nodes("Background", Color=nodes("TexEnvironment", {"image": sky}, Vector=nodes("TexCoord")))
    )
    # No light samples: there is nothing else to learn on a plane.
    sky_world.cycles.sampling_method = "NONE"
    camera((0.0, -3.0, 2.4), (0.0, 0.0, 0.0), 50.0)


@scene("fail-alpha-fog", samples=128)
def alpha_fog() -> None:
    """Twenty nearly transparent cards one behind the other: paths of many surfaces that hardly bend."""
    _begin(0.2)
    cycles = bpy.context.scene.cycles
    cycles.transparent_max_bounces, cycles.max_bounces = 64, 8

    def surface(nodes: Nodes) -> Socket:
        body = nodes("BsdfDiffuse", Color=(0.8, 0.8, 0.85))
        return nodes("MixShader", inputs={0: 0.15, 1: nodes("BsdfTransparent"), 2: body})

    fog = material("fog", surface)
    add_object("Floor", quad("Floor", diffuse((0.5, 0.5, 0.5), "floor"), 8.0, 8.0))
    for index in range(20):
        add_object("Card", quad("Card", fog, 4.0, 2.4), (0.0, 0.15 * index - 1.2, 1.2), (90, 0, 3 * (index % 5)))
    light("AREA", 150.0, (-2.5, 0.3, 2.0), (0.0, 0.3, 0.8), size=0.6)
    camera((0.6, -4.2, 1.7), (0.0, 0.2, 0.9), 42.0)


@scene("fail-albedo")
def albedo() -> None:
    """Walls that reflect 99.9% of the light, for a hundred bounces: what was learned enters every factor of a path."""
    _begin(0.2)
    cycles = bpy.context.scene.cycles
    cycles.max_bounces = cycles.diffuse_bounces = 100
    snow = diffuse((0.999, 0.999, 0.999), "snow")
    shell("Pit", snow, (-1.5, -1.5, 0), (1.5, 1.5, 2.0), "Z")
    add_object("Lid", quad("Lid", snow, 3.0, 2.0), (0.0, 0.5, 2.0))
    light("SPOT", 40.0, (0.0, -1.0, 3.5), (0.0, -0.9, 0.0), shadow_soft_size=0.1, spot_size=math.radians(20))
    camera((-1.2, -1.35, 1.5), (0.4, 0.8, 0.6), 24.0)
