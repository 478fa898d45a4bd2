# SPDX-License-Identifier: GPL-3.0-or-later
"""Media: on meshes with and without a surface, on the world, nested, overlapping, around the camera, from textures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    add_object,
    box,
    camera,
    diffuse,
    light,
    lit_stage,
    material,
    resolution,
    sphere,
    stage,
    world,
    world_nodes,
)

Shader = Callable[[Nodes], Any]


def _scatter(density: float, color: tuple[float, float, float] = (0.9, 0.9, 0.9), anisotropy: float = 0.0) -> Shader:
    return lambda nodes: nodes("VolumeScatter", Color=color, Density=density, Anisotropy=anisotropy)


def _absorption(density: float, color: tuple[float, float, float]) -> Shader:
    return lambda nodes: nodes("VolumeAbsorption", Color=color, Density=density)


def _bounces(count: int = 4) -> None:
    import bpy

    bpy.context.scene.cycles.volume_bounces = count


@scene("media-absorbing-glass", samples=128)
def absorbing_glass() -> None:
    """A glass box and a glass ball that swallow light inside."""
    lit_stage()

    def glass(nodes: Nodes) -> Any:
        return nodes("BsdfGlass", Color=(1.0, 1.0, 1.0), Roughness=0.0, IOR=1.3)

    red = material("Red glass", glass, _absorption(2.0, (0.9, 0.2, 0.1)))
    green = material("Green glass", glass, _absorption(1.0, (0.2, 0.8, 0.3)))
    add_object("Sphere", sphere("Sphere", red, 0.8), (-0.9, 0.0, 0.8))
    add_object("Box", box("Box", green, (1.0, 1.0, 1.0)), (0.9, -0.2, 0.72), (20, 10, 35))


@scene("media-fog-spot", samples=128)
def fog_spot() -> None:
    """A cone of light in a room's fog, which scatters forwards."""
    stage()
    _bounces()
    fog = material("Fog", None, _scatter(0.15, anisotropy=0.5))
    add_object("Fog", box("Fog", fog, (8.0, 8.0, 5.0)), (0.0, 0.0, 2.4))
    light("SPOT", 800.0, (-2.0, -1.0, 4.0), (0.5, 0.0, 0.0), spot_size=0.8, spot_blend=0.3, shadow_soft_size=0.2)


@scene("media-world-fog", samples=128)
def world_fog() -> None:
    """A lamp in fog without an end, which reddens what is far."""
    stage()
    _bounces()
    world_nodes(None, _scatter(0.08, (0.9, 0.7, 0.5)))
    light("POINT", 400.0, (-1.0, -1.0, 2.5), shadow_soft_size=0.3)


@scene("media-camera-inside", samples=128)
def camera_inside() -> None:
    """A camera in a ball of coloured fog, under a sky."""
    lit_stage()
    _bounces()
    cool = material("Cool fog", None, _scatter(0.12, (0.3, 0.5, 0.9), -0.3))
    add_object("Fog", sphere("Fog", cool, 4.0), (0.0, -6.0, 2.6))


@scene("media-nested", samples=128)
def nested() -> None:
    """Balls of media within each other, the innermost with a surface of its own."""
    lit_stage()
    _bounces()

    def clear(nodes: Nodes) -> Any:
        return nodes("BsdfRefraction", Color=(1.0, 1.0, 1.0), Roughness=0.0, IOR=1.2)

    for radius, made in (
        (1.1, material("Haze", None, _scatter(0.5))),
        (0.7, material("Blue haze", None, _scatter(2.0, (0.3, 0.4, 0.9)))),
        (0.35, material("Ink", clear, _absorption(8.0, (0.9, 0.5, 0.2)))),
    ):
        add_object(made.name, sphere(made.name, made, radius), (0.0, 0.0, 1.15))


@scene("media-overlapping", samples=128)
def overlapping() -> None:
    """Two boxes of media that share a part of space: there their coefficients add up."""
    lit_stage()
    _bounces()
    warm = material("Warm", None, _scatter(1.2, (0.9, 0.5, 0.2)))
    cold = material("Cold", None, _absorption(1.5, (0.2, 0.5, 0.9)))
    add_object("Warm", box("Warm", warm, (1.4, 1.0, 1.0)), (-0.4, 0.0, 0.8), (10, 0, 20))
    add_object("Cold", box("Cold", cold, (1.4, 1.2, 1.2)), (0.45, 0.1, 0.9), (0, 15, -10))


@scene("media-colored-shadow", samples=128)
def colored_shadow() -> None:
    """Coefficients that differ by channel, and the coloured shadow that they cast."""
    stage()
    world((0.1, 0.1, 0.1))
    _bounces()
    light("SUN", 4.0, (2.0, -2.0, 4.0), angle=0.02)

    def coefficients(nodes: Nodes) -> Any:
        return nodes(
            "VolumeCoefficients", Absorption_Coefficients=(0.2, 1.5, 3.0), Scatter_Coefficients=(0.9, 0.5, 0.1),
            Emission_Coefficients=(0.0, 0.02, 0.1),
        )

    jelly = material("Jelly", None, coefficients)
    add_object("Jelly", box("Jelly", jelly, (1.2, 1.2, 1.2)), (0.0, 0.0, 0.9), (15, 10, 30))


@scene("media-principled-fire", samples=128)
def principled_fire() -> None:
    """A Principled Volume that glows by itself, and one that glows as a black body."""
    stage()
    world((0.15, 0.15, 0.2))
    _bounces()

    def glow(nodes: Nodes) -> Any:
        return nodes(
            "VolumePrincipled", Color=(0.7, 0.6, 0.5), Density=1.0, Absorption_Color=(0.1, 0.0, 0.3),
            Emission_Strength=0.4, Emission_Color=(0.3, 0.6, 1.0), Anisotropy=0.2,
        )

    def fire(nodes: Nodes) -> Any:
        return nodes("VolumePrincipled", Color=(0.2, 0.2, 0.2), Density=2.0, Blackbody_Intensity=1.0, Temperature=900.0)

    add_object("Glow", sphere("Glow", material("Glow", None, glow), 0.7), (-0.8, 0.0, 0.8))
    add_object("Fire", box("Fire", material("Fire", None, fire), (0.9, 0.9, 0.9)), (0.9, 0.0, 0.7), (0, 20, 30))


@scene("media-phases", samples=128)
def phases() -> None:
    """Phase functions side by side: Rayleigh's, Draine's, that of droplets, and a mixture of two.

    The two are of one colour: of several Cycles takes the mean, and NeuralGuide each channel's own mixture.
    """
    stage()
    world((0.05, 0.05, 0.05))
    _bounces()
    light("AREA", 300.0, (0.0, 3.0, 3.0), size=1.0)

    def scatter(phase: str, **inputs: Any) -> Shader:
        return lambda nodes: nodes(
            "VolumeScatter", {"phase": phase}, Color=(0.9, 0.9, 0.9), Density=1.5, **inputs
        )

    def mixed(nodes: Nodes) -> Any:
        ahead = nodes("VolumeScatter", Color=(0.9, 0.9, 0.9), Density=2.0, Anisotropy=0.8)
        back = nodes("VolumeScatter", Color=(0.9, 0.9, 0.9), Density=1.0, Anisotropy=-0.6)
        return nodes("MixShader", Fac=0.4, inputs={1: ahead, 2: back})

    kinds: list[tuple[str, Shader]] = [
        ("Rayleigh", scatter("RAYLEIGH")), ("Draine", scatter("DRAINE", Anisotropy=0.6, Alpha=0.9)),
        ("Mie", scatter("MIE", Diameter=8.0)), ("Mixed", mixed),
    ]  # fmt: skip
    for index, (name, shader) in enumerate(kinds):
        add_object(name, sphere(name, material(name, None, shader), 0.45), (-1.5 + index, 0.0, 0.6))


@scene("media-particles", samples=128)
def particles() -> None:
    """Particles in water, which scatter by Fournier and Forand's function: few back, or many, and some that vary.

    The last is dust of which Draine's function makes much of what is scattered straight on or back.
    """
    stage()
    world((0.05, 0.05, 0.05))
    _bounces()
    light("AREA", 60.0, (0.0, 3.0, 3.0), size=1.0)
    light("AREA", 200.0, (-2.0, -3.0, 3.0), size=1.0)

    def water(ior: float, backscatter: float) -> Shader:
        return lambda nodes: nodes(
            "VolumeScatter", {"phase": "FOURNIER_FORAND"}, Color=(0.9, 0.9, 0.9), Density=1.5, IOR=ior,
            Backscatter=backscatter,
        )

    def varying(nodes: Nodes) -> Any:
        density = _above(nodes, _noise(nodes, 3.0), 0.4, 20.0)
        return nodes(
            "VolumeCoefficients", {"phase": "FOURNIER_FORAND"}, {"Scatter Coefficients": density}, Backscatter=0.2,
            Absorption_Coefficients=(0.0, 0.0, 0.0),
        )

    def dust(nodes: Nodes) -> Any:
        return nodes(
            "VolumeScatter", {"phase": "DRAINE"}, Color=(0.9, 0.9, 0.9), Density=1.5, Anisotropy=0.2, Alpha=20.0
        )

    kinds: list[tuple[str, Shader]] = [
        ("Water", water(1.33, 0.1)), ("Turbid", water(1.1, 0.4)), ("Varying", varying), ("Dust", dust),
    ]
    for index, (name, shader) in enumerate(kinds):
        add_object(name, sphere(name, material(name, None, shader), 0.45), (-1.5 + index, 0.0, 0.6))


@scene("media-open-room", samples=128)
def open_room() -> None:
    """Fog around the camera and the scene at once, with a lamp inside: `media-camera-inside` without a sky."""
    stage(with_camera=False)
    _bounces(2)
    camera((0.0, -5.0, 2.2))
    fog = material("Fog", None, _scatter(0.1, (0.8, 0.8, 0.9)))
    add_object("Fog", box("Fog", fog, (16.0, 16.0, 8.0)), (0.0, 0.0, 3.5))
    light("AREA", 150.0, (1.0, -0.5, 3.0), size=1.0)


@scene("media-door", samples=256)
def door() -> None:
    """Fog in a room that gets its light through a door, from a lamp in the next room that shines away from it."""
    resolution()
    _bounces()
    world((0.0, 0.0, 0.0))
    paint = diffuse((0.75, 0.75, 0.72), "paint")
    for name, size, place in (
        ("Floor", (4.4, 7.4, 0.2), (0.0, 1.5, -0.1)), ("Ceiling", (4.4, 7.4, 0.2), (0.0, 1.5, 2.6)),
        ("Left", (0.2, 7.0, 2.5), (-2.1, 1.5, 1.25)), ("Right", (0.2, 7.0, 2.5), (2.1, 1.5, 1.25)),
        ("Front", (4.4, 0.2, 2.5), (0.0, -2.1, 1.25)), ("Back", (4.4, 0.2, 2.5), (0.0, 5.1, 1.25)),
        ("Left of door", (1.5, 0.2, 2.5), (-1.25, 2.1, 1.25)), ("Right of door", (1.5, 0.2, 2.5), (1.25, 2.1, 1.25)),
        ("Above door", (1.0, 0.2, 0.5), (0.0, 2.1, 2.25)),
    ):  # fmt: skip
        add_object(name, box(name, paint, size), place)
    fog = material("Fog", None, _scatter(0.15, anisotropy=0.3))
    add_object("Fog", box("Fog", fog, (6.0, 9.0, 5.0)), (0.0, 1.5, 1.2))
    light("AREA", 200.0, (1.4, 3.4, 1.6), (1.6, 5.0, 1.4), size=0.4)
    camera((-0.6, -1.8, 1.4), (0.2, 2.0, 1.1), lens=28.0)


def _noise(nodes: Nodes, scale: float, detail: float = 2.0) -> Any:
    """Noise in the object's own space, with the most of it near the middle of [0, 1]."""
    place = nodes("TexCoord", output="Object")
    return nodes("TexNoise", Vector=place, Scale=scale, Detail=detail, Roughness=0.5)


def _above(nodes: Nodes, value: Any, limit: float, factor: float) -> Any:
    """How far a value is above a limit, times a factor; 0 below it."""
    return nodes("Math", {"operation": "MULTIPLY", "use_clamp": False}, {
        0: nodes("Math", {"operation": "MAXIMUM"}, {0: nodes("Math", {"operation": "SUBTRACT"}, {0: value, 1: limit}),
                                                     1: 0.0}),
        1: factor,
    })  # fmt: skip


@scene("media-noise-fog", samples=128)
def noise_fog() -> None:
    """Shreds of fog in a box, by a noise texture, under a lamp."""
    lit_stage()
    _bounces()

    def shreds(nodes: Nodes) -> Any:
        density = _above(nodes, _noise(nodes, 2.5), 0.5, 30.0)
        return nodes("VolumeScatter", Color=(0.9, 0.9, 0.9), Density=density, Anisotropy=0.3)

    fog = material("Shreds", None, shreds)
    add_object("Fog", box("Fog", fog, (2.4, 2.4, 1.4)), (0.0, 0.0, 0.8), (0, 0, 25))


@scene("media-colored-smoke", samples=128)
def colored_smoke() -> None:
    """A ball of smoke whose colour and density vary, beside a uniform one that it overlaps, with a lamp in sight."""
    lit_stage()
    _bounces()
    light("POINT", 60.0, (-0.2, 1.3, 1.6), shadow_soft_size=0.25)

    def smoke(nodes: Nodes) -> Any:
        place = nodes("TexCoord", output="Generated")
        density = _above(nodes, nodes("TexGradient", {"gradient_type": "SPHERICAL"}, Vector=nodes(
            "Mapping", Vector=place, Location=(-1.0, -1.0, -1.0), Scale=(2.0, 2.0, 2.0),
        ), output="Fac"), 0.0, 6.0)  # fmt: skip
        return nodes("VolumePrincipled", Color=place, Density=density, Anisotropy=-0.2)

    grey = material("Grey", None, _scatter(0.8, (0.5, 0.5, 0.5)))
    add_object("Smoke", sphere("Smoke", material("Smoke", None, smoke), 0.9), (-0.4, 0.0, 1.0))
    add_object("Grey", box("Grey", grey, (1.0, 1.0, 1.0)), (0.7, 0.0, 0.7), (0, 15, 20))


@scene("media-noise-fire", samples=128)
def noise_fire() -> None:
    """Flames by textures: a Principled Volume whose black body is hot inside, over smoke that swallows light."""
    stage()
    world((0.1, 0.1, 0.15))
    _bounces()

    def fire(nodes: Nodes) -> Any:
        core = _above(nodes, _noise(nodes, 3.0, 1.0), 0.45, 5.0)
        hot = nodes("Math", {"operation": "MULTIPLY"}, {0: core, 1: 1400.0})
        density = nodes("Math", {"operation": "MULTIPLY"}, {0: core, 1: 3.0})
        return nodes(
            "VolumePrincipled", Color=(0.2, 0.2, 0.2), Density=density, Blackbody_Intensity=1.0, Temperature=hot,
        )

    add_object("Fire", box("Fire", material("Fire", None, fire), (1.4, 1.4, 1.8)), (0.0, 0.0, 1.0), (0, 0, 30))


def _volume_object(name: str, grids: dict[str, np.ndarray], voxel: float, made: Any, location: Any) -> Any:
    """A volume object from a file of these grids, float32 (X, Y, Z) or (X, Y, Z, 3), around the object's origin."""
    import tempfile

    import bpy

    from addon.export.openvdb_module import find_openvdb

    openvdb = find_openvdb()
    if openvdb is None:
        raise ValueError(f"scene {name}: this Blender has no module that writes OpenVDB files")
    written = []
    for grid_name, values in grids.items():
        grid = openvdb.Vec3SGrid() if values.ndim == 4 else openvdb.FloatGrid()
        corner = tuple(-(size // 2) for size in values.shape[:3])
        grid.copyFromArray(np.ascontiguousarray(values, np.float32), ijk=corner)
        grid.transform = openvdb.createLinearTransform(voxelSize=voxel)
        grid.name = grid_name
        written.append(grid)
    path = f"{tempfile.mkdtemp(prefix='volume-')}/{name}.vdb"
    openvdb.write(path, grids=written)
    volume = bpy.data.volumes.new(name)
    volume.filepath = path
    volume.materials.append(made)
    return add_object(name, volume, location)


def _ball(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the middle of a cube, 1 at its faces, and smooth waves around 0, both float32 (N, N, N)."""
    axis = np.linspace(-1.0, 1.0, size, dtype=np.float32)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    random = np.random.default_rng(5)
    waves = np.zeros_like(x)
    for frequency in (2.0, 3.5, 6.0, 11.0):
        direction = random.normal(size=(4, 3)) * frequency
        phase = random.random(4) * 2.0 * np.pi
        for d, p in zip(direction, phase, strict=True):
            waves += np.sin(d[0] * x + d[1] * y + d[2] * z + p) / frequency
    return np.sqrt(x * x + y * y + z * z), waves.astype(np.float32)


@scene("media-vdb-cloud", samples=128)
def vdb_cloud() -> None:
    """A cloud from an OpenVDB file, turned and stretched, and an instance of it."""
    import bpy

    lit_stage()
    _bounces(6)
    distance, waves = _ball(64)
    density = np.clip((0.75 - distance + 0.35 * waves) * 6.0, 0.0, 1.0)
    cloud = material("Cloud", None, lambda nodes: nodes(
        "VolumePrincipled", Color=(0.95, 0.95, 0.95), Density=10.0, Anisotropy=0.4,
    ))  # fmt: skip
    made = _volume_object("Cloud", {"density": density}, 2.0 / 64, cloud, (-0.5, 0.0, 1.1))
    made.rotation_euler, made.scale = (0.3, 0.2, 0.6), (1.2, 0.9, 0.8)
    other = bpy.data.objects.new("Small cloud", made.data)
    other.location, other.scale = (1.3, -0.4, 0.6), (0.5, 0.5, 0.5)
    bpy.context.scene.collection.objects.link(other)


@scene("media-vdb-fire", samples=128)
def vdb_fire() -> None:
    """Smoke with fire: density, colour and temperature from a file, and flames by a Volume Info node."""
    stage()
    world((0.1, 0.1, 0.12))
    _bounces()
    distance, waves = _ball(48)
    smoke = np.clip(0.9 - distance + 0.4 * waves, 0.0, 1.0)
    flame = np.clip(0.6 - 1.4 * distance + 0.5 * waves, 0.0, 1.0)
    color = np.stack([smoke, 0.6 * smoke + 0.2, 0.4 + 0.0 * smoke], axis=-1) * (smoke > 0.0)[..., None]

    def fire(nodes: Nodes) -> Any:
        burning = nodes("VolumeInfo", output="Flame")
        smoke = nodes(
            "VolumePrincipled", Color=(0.6, 0.6, 0.6), Density=4.0, Blackbody_Intensity=1.0, Temperature=1900.0,
            inputs={"Color Attribute": "color"},
        )
        strength = nodes("Math", {"operation": "MULTIPLY"}, {0: burning, 1: 4.0})
        glow = nodes("Emission", Color=(0.2, 0.4, 1.0), Strength=strength)
        return nodes("AddShader", inputs={0: smoke, 1: glow})

    grids = {"density": smoke, "flame": flame, "temperature": np.sqrt(flame), "color": color}
    made = _volume_object("Fire", grids, 2.0 / 48, material("Fire", None, fire), (0.0, 0.0, 1.0))
    made.scale = (0.9, 0.9, 1.1)


@scene("media-moving-smoke", samples=64)
def moving_smoke() -> None:
    """A ring of smoke that turns fast while the shutter is open, and a puff that is carried off as it is blown away.

    Nothing moves further than a few voxels: to Cycles there is nothing to collide with beyond where the smoke stands.
    """
    import bpy

    lit_stage()
    _bounces()
    render = bpy.context.scene.render
    render.use_motion_blur, render.motion_blur_shutter = True, 0.5
    axis = np.linspace(-1.0, 1.0, 48, dtype=np.float32)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    _distance, waves = _ball(48)
    around = np.arctan2(y, x)
    ring = np.clip(1.0 - 14.0 * ((np.hypot(x, y) - 0.65) ** 2 + z * z), 0.0, 1.0) * (np.cos(3.0 * around) > 0.2)
    turning = 12.0 * np.stack([-y, x, 0.3 * x], axis=-1)
    smoke = material("Smoke", None, lambda nodes: nodes(
        "VolumePrincipled", Color=(0.8, 0.8, 0.9), Density=12.0, Anisotropy=0.2,
    ))  # fmt: skip
    made = _volume_object("Ring", {"density": ring, "velocity": turning}, 2.0 / 48, smoke, (-0.6, 0.0, 1.1))
    made.data.velocity_unit = "SECOND"
    made.rotation_euler, made.scale = (0.9, 0.2, 0.0), (1.1, 1.1, 0.8)
    puff = np.clip(1.5 - 2.2 * np.sqrt(x * x + y * y + z * z) + 0.3 * waves, 0.0, 1.0)
    blown = {f"velocity_{name}": np.full_like(x, speed) for name, speed in zip("xyz", (0.12, 0.0, 0.08), strict=True)}
    made = _volume_object("Puff", {"density": puff, **blown}, 1.0 / 48, smoke, (1.1, -0.3, 0.8))
    for frame, place in ((0, 0.9), (2, 1.3)):
        made.location.z = place
        made.keyframe_insert("location", frame=frame)


@scene("media-smooth-voxels", samples=64)
def smooth_voxels() -> None:
    """A cloud of few voxels: by straight lines between them, by cubic splines, and by splines as something that glows.

    What glows is no black body: Cycles takes the fourth power of the temperature of voxels picked at random.
    """
    lit_stage()
    _bounces()
    distance, waves = _ball(8)
    density = np.clip((0.8 - distance + 0.6 * waves) * 3.0, 0.0, 1.0)

    def cloud(nodes: Nodes) -> Any:
        return nodes("VolumePrincipled", Color=(0.9, 0.9, 0.9), Density=8.0, Anisotropy=0.3)

    def glow(nodes: Nodes) -> Any:
        strength = nodes("VolumeInfo", output="Density")
        smoke = nodes("VolumePrincipled", Color=(0.3, 0.2, 0.1), Density=4.0)
        return nodes("AddShader", inputs={0: smoke, 1: nodes("Emission", Color=(0.9, 0.3, 0.1), Strength=strength)})

    lines, splines = material("Lines", None, cloud), material("Splines", None, cloud)
    glowing = material("Glow", None, glow)
    splines.cycles.volume_interpolation = glowing.cycles.volume_interpolation = "CUBIC"
    for place, made in zip((-1.3, 0.0, 1.3), (lines, splines, glowing), strict=True):
        _volume_object(made.name, {"density": density}, 1.3 / 8, made, (place, 0.0, 0.8))
