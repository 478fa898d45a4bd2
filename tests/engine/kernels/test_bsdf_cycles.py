# SPDX-License-Identifier: GPL-3.0-or-later
"""Every closure against Cycles: tilted planes in a white world and under suns, rendered through bpy."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.bsdf_harness import (
    ASHIKHMIN_SHIRLEY,
    BECKMANN,
    DIFFUSE,
    GGX,
    GLASS,
    GLOSSY,
    LINKED,
    MULTI_GGX,
    PRINCIPLED,
    REFRACTION,
    UP,
    Case,
    Lobes,
    at_cosine,
    vector,
)
from tests.helpers.kept_arrays import KeptArrays

COSINES = (1.0, 0.8, 0.5, 0.2)
ORANGE = (0.8, 0.4, 0.1)
#: Directions to suns, above and below the planes.
SUNS = ((0.3, 0.5, 0.9), (-0.5, -0.2, 0.9), (0.1, -0.2, -1.0))
#: Normal of bumped cases in the frame of their plane.
BUMP = np.array([0.6, 0.3, 0.75]) / np.linalg.norm([0.6, 0.3, 0.75])
FILM = {"film_thickness": 420.0, "film_ior": 1.33}
STRETCHED = {"anisotropic": 0.8, "rotation": 0.1}
COPPER = {"color": (0.27, 0.68, 1.32), "specular_tint": (3.61, 2.63, 2.29)}
PIXELS = 12
#: Of the Blender that renders, 5.x.
MINOR_VERSION = int(version("bpy").split(".")[1])
SAMPLES = 512

CASES = [
    Case(DIFFUSE, {"color": ORANGE, "roughness": 0.0}),
    Case(DIFFUSE, {"color": ORANGE, "roughness": 0.5}),
    Case(DIFFUSE, {"color": ORANGE, "roughness": 1.0}),
    Case(GLOSSY, {"color": ORANGE, "roughness": 0.0}),
    Case(GLOSSY, {"color": ORANGE, "roughness": 0.2}),
    Case(GLOSSY, {"color": ORANGE, "roughness": 0.6}),
    Case(GLOSSY, {"color": ORANGE, "roughness": 1.0}),
    Case(GLOSSY, {"color": ORANGE, "roughness": 0.6}, GGX),
    Case(GLOSSY, {"color": ORANGE, "roughness": 0.5, "anisotropic": 0.6, "rotation": 0.1}),
    Case(GLOSSY, {"color": ORANGE, "roughness": 0.5, "anisotropic": -0.6, "rotation": 0.3}),
    Case(REFRACTION, {"color": ORANGE, "roughness": 0.0, "ior": 1.45}, GGX),
    Case(REFRACTION, {"color": ORANGE, "roughness": 0.5, "ior": 1.45}, GGX),
    Case(REFRACTION, {"color": ORANGE, "roughness": 0.5, "ior": 1.45}, GGX, True),
    Case(GLASS, {"color": ORANGE, "roughness": 0.0, "ior": 1.5}),
    Case(GLASS, {"color": ORANGE, "roughness": 0.3, "ior": 1.5}),
    Case(GLASS, {"color": ORANGE, "roughness": 0.8, "ior": 1.5}),
    Case(GLASS, {"color": ORANGE, "roughness": 0.8, "ior": 1.5}, GGX),
    Case(GLASS, {"color": ORANGE, "roughness": 0.0, "ior": 1.5}, is_backfacing=True),
    Case(GLASS, {"color": ORANGE, "roughness": 0.3, "ior": 1.5}, is_backfacing=True),
    Case(GLASS, {"color": ORANGE, "roughness": 0.8, "ior": 2.0}, is_backfacing=True),
    Case(PRINCIPLED, {"color": ORANGE}),
    Case(PRINCIPLED, {"color": ORANGE, "roughness": 0.0}),
    Case(PRINCIPLED, {"color": ORANGE, "roughness": 0.2, "ior": 2.0}),
    Case(PRINCIPLED, {"color": ORANGE, "specular_level": 0.2, "roughness": 1.0}),
    Case(PRINCIPLED, {"color": ORANGE, "specular_level": 1.0, "specular_tint": (0.2, 0.5, 1.0)}),
    Case(PRINCIPLED, {"color": ORANGE, "diffuse_roughness": 0.7}),
    Case(PRINCIPLED, {"color": ORANGE, "metallic": 1.0, "roughness": 0.3}),
    Case(PRINCIPLED, {"color": ORANGE, "metallic": 1.0, "roughness": 0.9, "specular_tint": (0.2, 0.5, 1.0)}),
    Case(PRINCIPLED, {"color": ORANGE, "metallic": 0.5, "roughness": 0.6}, GGX),
    Case(PRINCIPLED, {"color": ORANGE, "metallic": 1.0, "roughness": 0.5, "anisotropic": 0.8, "rotation": 0.1}),
    Case(PRINCIPLED, {"color": ORANGE, "transmission": 1.0, "roughness": 0.0}),
    Case(PRINCIPLED, {"color": ORANGE, "transmission": 0.7, "roughness": 0.5}),
    Case(PRINCIPLED, {"color": ORANGE, "transmission": 1.0, "roughness": 0.5}, is_backfacing=True),
    Case(PRINCIPLED, {"color": ORANGE, "coat_weight": 1.0, "roughness": 0.6}),
    Case(PRINCIPLED, {"color": ORANGE, "coat_weight": 0.6, "coat_roughness": 0.4, "coat_tint": (0.9, 0.5, 0.3)}),
    Case(PRINCIPLED, {"color": ORANGE, "emission_strength": 0.3, "emission_color": (0.1, 0.5, 0.9)}),
    Case(PRINCIPLED, {"color": ORANGE, "alpha": 0.3}),
    Case(PRINCIPLED, {"color": ORANGE, "sheen_weight": 1.0, "sheen_tint": (0.9, 0.6, 0.3)}),
    Case(PRINCIPLED, {"color": ORANGE, "sheen_weight": 0.7, "sheen_roughness": 0.2}),
    Case(PRINCIPLED, {"color": ORANGE, "sheen_weight": 1.0, "sheen_roughness": 1.0}),
    Case(DIFFUSE, {"color": ORANGE, "roughness": 0.0}, is_bumped=True),
    Case(DIFFUSE, {"color": ORANGE, "roughness": 0.6}, is_bumped=True),
    Case(GLOSSY, {"color": ORANGE, "roughness": 0.5}, is_bumped=True),
    Case(GLOSSY, {"color": ORANGE, "roughness": 0.0}, is_bumped=True),
    Case(PRINCIPLED, {"color": ORANGE, "coat_weight": 0.7, "sheen_weight": 0.5, "metallic": 0.4}, is_bumped=True),
    *[Case(GLOSSY, {"color": ORANGE, "roughness": roughness}, BECKMANN) for roughness in (0.0, 0.2, 0.6, 1.0)],
    Case(GLOSSY, {"color": ORANGE, "roughness": 0.5, "anisotropic": 0.6, "rotation": 0.1}, BECKMANN),
    Case(GLOSSY, {"color": ORANGE, "roughness": 0.5}, BECKMANN, is_bumped=True),
    *[Case(GLOSSY, {"color": ORANGE, "roughness": roughness}, ASHIKHMIN_SHIRLEY) for roughness in (0.0, 0.2, 0.6, 1.0)],
    Case(GLOSSY, {"color": ORANGE, "roughness": 0.5, "anisotropic": -0.6, "rotation": 0.1}, ASHIKHMIN_SHIRLEY),
    Case(REFRACTION, {"color": ORANGE, "roughness": 0.5, "ior": 1.45}, BECKMANN),
    Case(REFRACTION, {"color": ORANGE, "roughness": 0.3, "ior": 1.45}, BECKMANN, True),
    Case(GLASS, {"color": ORANGE, "roughness": 0.5, "ior": 1.5}, BECKMANN),
    Case(GLASS, {"color": ORANGE, "roughness": 0.5, "ior": 1.5}, BECKMANN, True),
    Case(GLASS, {"color": ORANGE, "roughness": 0.0, "ior": 1.5, **FILM}),
    Case(GLASS, {"color": ORANGE, "roughness": 0.4, "ior": 1.5, **FILM}),
    Case(GLASS, {"color": ORANGE, "roughness": 0.4, "ior": 1.5, **FILM}, is_backfacing=True),
    Case(GLASS, {"color": ORANGE, "roughness": 0.4, "ior": 1.5, **FILM}, BECKMANN),
    Case(PRINCIPLED, {"color": ORANGE, **FILM}),
    Case(PRINCIPLED, {"color": ORANGE, "roughness": 0.2, "film_thickness": 0.5, "film_ior": 2.0}),
    Case(PRINCIPLED, {"color": ORANGE, "roughness": 0.2, "film_thickness": 1500.0, "film_ior": 1.4}),
    Case(PRINCIPLED, {"color": ORANGE, "specular_level": 0.2, "specular_tint": (0.2, 0.5, 1.0), **FILM}),
    Case(PRINCIPLED, {"color": ORANGE, "metallic": 1.0, "roughness": 0.3, **FILM}),
    Case(PRINCIPLED, {"color": ORANGE, "metallic": 0.6, "specular_tint": (0.2, 0.5, 1.0), "anisotropic": 0.7, **FILM}),
    Case(PRINCIPLED, {"color": ORANGE, "transmission": 0.7, "roughness": 0.3, **FILM}),
    Case(PRINCIPLED, {"color": ORANGE, "transmission": 1.0, "roughness": 0.3, **FILM}, is_backfacing=True),
    *[Case(LINKED, {"which": 9, "roughness": roughness, **COPPER}) for roughness in (0.0, 0.3, 0.9)],
    Case(LINKED, {"which": 9, "roughness": 0.5, "anisotropic": 0.8, "rotation": 0.1, **COPPER}, BECKMANN),
    Case(LINKED, {"which": 9, "roughness": 0.4, **COPPER, **FILM}),
    Case(LINKED, {"which": 8, "roughness": 0.5, "color": ORANGE, "specular_tint": (0.2, 0.5, 1.0)}, BECKMANN),
    Case(LINKED, {"which": 8, "roughness": 0.3, "color": ORANGE, "specular_tint": (0.2, 0.5, 1.0), **FILM}),
    *[Case(LINKED, {"which": which, "color": ORANGE, "first": 0.5, "second": 0.2}) for which in (0, 2)],
    *[Case(LINKED, {"which": which, "color": ORANGE, "first": 0.9, "second": 0.0}) for which in (0, 2)],
    *[Case(LINKED, {"which": 1, "color": ORANGE, "first": sigma}) for sigma in (0.0, 0.3, 1.0)],
    Case(LINKED, {"which": 1, "color": ORANGE, "first": 0.6}, is_bumped=True),
    Case(PRINCIPLED, {"color": ORANGE, "transmission": 1.0, "roughness": 0.5, **STRETCHED}),
    Case(PRINCIPLED, {"color": ORANGE, "transmission": 0.7, "roughness": 0.4, **STRETCHED, **FILM}, GGX),
    Case(PRINCIPLED, {"color": ORANGE, "transmission": 1.0, "roughness": 0.5, **STRETCHED}, GGX, is_backfacing=True),
]
if MINOR_VERSION >= 3:
    CASES += [
        *[
            Case(GLASS, {"color": ORANGE, "roughness": 0.5, "ior": 1.5, "anisotropic": by, "rotation": 0.1}, facets)
            for by in (0.6, -0.6)
            for facets in (MULTI_GGX, GGX, BECKMANN)
        ],
        Case(GLASS, {"color": ORANGE, "roughness": 0.5, "ior": 1.5, **STRETCHED}, GGX, is_backfacing=True),
        Case(GLASS, {"color": ORANGE, "roughness": 0.5, "ior": 1.5, **STRETCHED, **FILM}),
        *[
            Case(PRINCIPLED, {"color": ORANGE, "transmission": 0.8, "roughness": 0.5, "thin_wall": 1.0, **film})
            for film in ({}, FILM, {"film_thickness": 700.0, "film_ior": 1.8, "specular_tint": (0.2, 0.5, 1.0)})
        ],
    ]

NODES = {
    DIFFUSE: "ShaderNodeBsdfDiffuse",
    GLOSSY: "ShaderNodeBsdfAnisotropic",
    REFRACTION: "ShaderNodeBsdfRefraction",
    GLASS: "ShaderNodeBsdfGlass",
    PRINCIPLED: "ShaderNodeBsdfPrincipled",
}
DISTRIBUTIONS = ("GGX", "MULTI_GGX", "BECKMANN", "ASHIKHMIN_SHIRLEY")
LINKED_NODES = {
    0: "ShaderNodeBsdfToon",
    1: "ShaderNodeBsdfSheen",
    2: "ShaderNodeBsdfToon",
    8: "ShaderNodeBsdfMetallic",
    9: "ShaderNodeBsdfMetallic",
}
LINKED_SETTINGS = {
    0: ("component", "DIFFUSE"),
    1: ("distribution", "ASHIKHMIN"),
    2: ("component", "GLOSSY"),
    8: ("fresnel_type", "F82"),
    9: ("fresnel_type", "PHYSICAL_CONDUCTOR"),
}
#: Sockets of linked lobes, by what the others call them.
LINKED_SOCKETS: dict = {
    0: {"first": ("Size",), "second": ("Smooth",)},
    1: {"first": ("Roughness",)},
    2: {"first": ("Size",), "second": ("Smooth",)},
    8: {"specular_tint": ("Edge Tint",)},
    9: {"color": ("IOR",), "specular_tint": ("Extinction",)},
}
SOCKETS = {
    "color": ("Color", "Base Color"),
    "roughness": ("Roughness",),
    "ior": ("IOR",),
    "metallic": ("Metallic",),
    "diffuse_roughness": ("Diffuse Roughness",),
    "specular_level": ("Specular IOR Level",),
    "specular_tint": ("Specular Tint",),
    "anisotropic": ("Anisotropic", "Anisotropy"),
    "rotation": ("Anisotropic Rotation", "Rotation"),
    "film_thickness": ("Thin Film Thickness",),
    "film_ior": ("Thin Film IOR",),
    "transmission": ("Transmission Weight",),
    "thin_wall": ("Thin Wall",),
    "coat_weight": ("Coat Weight",),
    "coat_roughness": ("Coat Roughness",),
    "coat_tint": ("Coat Tint",),
    "sheen_weight": ("Sheen Weight",),
    "sheen_roughness": ("Sheen Roughness",),
    "sheen_tint": ("Sheen Tint",),
    "emission_color": ("Emission Color",),
    "emission_strength": ("Emission Strength",),
    "alpha": ("Alpha",),
}


def add_plane(bpy: Any, case: Case, column: int, row: int) -> None:
    """A plane tilted to COSINES[row], seen by the camera only, in its own block of the picture."""
    material = bpy.data.materials.new(str(case))
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    which = case.inputs.get("which")
    node = tree.nodes.new(NODES[case.node] if which is None else LINKED_NODES[which])
    if case.node == LINKED and which in LINKED_SETTINGS:
        setattr(node, *LINKED_SETTINGS[which])
    if hasattr(node, "distribution") and which != 1:
        is_plain = case.node == REFRACTION and case.distribution < BECKMANN
        node.distribution = "GGX" if is_plain else DISTRIBUTIONS[case.distribution]
    sockets = SOCKETS | LINKED_SOCKETS.get(which, {})
    for name, value in case.inputs.items():
        if name == "which" or (which == 1 and name == "second"):
            continue
        socket = next(node.inputs[key] for key in sockets[name] if key in node.inputs)
        is_color = isinstance(value, tuple) and len(socket.default_value) == 4
        value = bool(value) if name == "thin_wall" else value
        socket.default_value = (*value, 1.0) if is_color else value
    if "anisotropic" in case.inputs:
        tangent = tree.nodes.new("ShaderNodeTangent")
        tangent.direction_type = "UV_MAP"
        tree.links.new(tangent.outputs["Tangent"], node.inputs["Tangent"])
    if case.is_bumped:
        cosine, sine = COSINES[row], np.sqrt(1.0 - COSINES[row] ** 2)
        normal = tree.nodes.new("ShaderNodeCombineXYZ")
        world = (BUMP[0] * cosine + BUMP[2] * sine, BUMP[1], BUMP[2] * cosine - BUMP[0] * sine)
        for socket, value in zip(normal.inputs, world, strict=True):
            socket.default_value = value
        tree.links.new(normal.outputs["Vector"], node.inputs["Normal"])
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(node.outputs["BSDF"], output.inputs["Surface"])
    angle = np.arccos(COSINES[row]) + (np.pi if case.is_backfacing else 0.0)
    bpy.ops.mesh.primitive_plane_add(size=1.0, location=(column, row, 0.0), rotation=(0.0, angle, 0.0))
    plane = bpy.context.object
    plane.scale = (1.0 / COSINES[row], 1.0, 1.0)
    plane.data.materials.append(material)
    for kind in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
        setattr(plane, f"visible_{kind}", False)


def read_blocks(bpy: Any, path: Path) -> np.ndarray:
    """Render and return the mean of every plane's inner pixels, float32 (cases, cosines, 3)."""
    bpy.context.scene.render.filepath = str(path.with_suffix(".exr"))
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(bpy.context.scene.render.filepath)
    image.colorspace_settings.name = "Non-Color"
    pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    blocks = pixels.reshape(len(COSINES), PIXELS, len(CASES), PIXELS, 4)[:, 2:-2, :, 2:-2, :3]
    return blocks.mean((1, 3), dtype=np.float64).transpose(1, 0, 2).astype(np.float32)


def render(path: Path) -> None:
    """Render all cases with Cycles into `path` (.npy): float32 (1 + suns, cases, cosines, 3), the world first."""
    import bpy
    from mathutils import Vector

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = SAMPLES
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.sample_clamp_indirect = 0.0
    scene.cycles.blur_glossy = 0.0
    scene.cycles.light_sampling_threshold = 0.0
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.filter_width = 0.01
    world = bpy.data.worlds.new("white")
    scene.world = world
    world.use_nodes = True
    background = world.node_tree.nodes["Background"].inputs["Color"]
    background.default_value = (1.0, 1.0, 1.0, 1.0)
    world.cycles.sampling_method = "NONE"
    for column, case in enumerate(CASES):
        for row in range(len(COSINES)):
            add_plane(bpy, case, column, row)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.data.type = "ORTHO"
    camera.data.ortho_scale = len(CASES)
    camera.data.sensor_fit = "HORIZONTAL"
    camera.location = ((len(CASES) - 1) / 2, (len(COSINES) - 1) / 2, 10.0)
    scene.render.resolution_x = PIXELS * len(CASES)
    scene.render.resolution_y = PIXELS * len(COSINES)
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    pictures = [read_blocks(bpy, path)]
    background.default_value = (0.0, 0.0, 0.0, 1.0)
    # A sun without size is only found by light sampling, whose value has no noise.
    scene.cycles.samples = 4
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.angle = 0.0
    sun.data.energy = 1.0
    scene.collection.objects.link(sun)
    for direction in SUNS:
        sun.rotation_euler = Vector(direction).to_track_quat("Z", "Y").to_euler()
        pictures.append(read_blocks(bpy, path))
    np.save(path, np.array(pictures))


def rendered(folder: Path) -> np.ndarray:
    """Albedos from Cycles, in a process of its own (Blender's settings are global)."""
    path = folder / "cycles.npy"
    root = Path(__file__).resolve().parents[3]
    command = [sys.executable, "-m", "tests.engine.kernels.test_bsdf_cycles", str(path)]
    subprocess.run(command, check=True, cwd=root, timeout=600)
    return np.load(path)


@pytest.fixture(scope="module")
def cycles(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> np.ndarray:
    """Albedos from Cycles, rendered by whichever worker of this run needs them first: they take a minute."""
    folder = tmp_path_factory.getbasetemp()
    kept = KeptArrays(folder if worker_id == "master" else folder.parent)
    return kept.get("bsdf-cycles", lambda: rendered(tmp_path_factory.mktemp("furnace")))


def lobes_of(case: Case, cosine: float) -> Lobes:
    """Our closures of a case, in the frame of its plane."""
    of_version = float(MINOR_VERSION >= 3)
    case = replace(case, inputs={**case.inputs, "tints_by_bounce": of_version, "stretches_glass": of_version})
    return Lobes(case, wo=at_cosine(cosine, np.pi), n=vector(*BUMP) if case.is_bumped else UP)


def ours(case: Case) -> np.ndarray:
    """Our albedos, emission included, float64 (cosines, 3)."""
    rows = []
    for cosine in COSINES:
        lobes = lobes_of(case, cosine)
        rows.append(lobes.albedo(16) + lobes.closures.emission[0, :3])
    return np.array(rows)


def directions(cosine: float, sun: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Directions to the camera and to a sun in the frame of a plane turned about y."""
    sine = np.sqrt(1.0 - cosine**2)
    x, y, z = np.array(sun) / np.linalg.norm(sun)
    return np.array([-sine, 0.0, cosine]), np.array([x * cosine - z * sine, y, x * sine + z * cosine])


def is_impossible_refraction(case: Case, wo: np.ndarray, wi: np.ndarray) -> bool:
    """Whether no facet can refract `wi` towards `wo`: it would have to look down, or lie between the two."""
    if case.node not in (REFRACTION, GLASS) and "transmission" not in case.inputs or wi[2] >= 0.0:
        return False
    ior = case.inputs.get("ior", 1.5)
    facet = (1.0 / ior if case.is_backfacing else ior) * wi + wo
    facet *= np.sign(facet[2])
    return bool(facet @ wo <= 0.0 or facet @ wi >= 0.0)


def tolerance(case: Case) -> float:
    """Relative; glass from within has a finer table of its energy in Cycles 5.3 (docs/differences.md)."""
    return 0.02 if MINOR_VERSION > 0 and case.is_backfacing and "film_thickness" in case.inputs else 5e-3


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize("case", CASES, ids=str)
def test_albedo_agrees_with_cycles(case: Case, cycles: np.ndarray) -> None:
    # Cycles' own noise is below 0.1% (64 pixels of 512 samples, weights close to 1), ours is smaller.
    # At grazing angles its rays that meet Ashikhmin and Shirley's facets from behind go where its light samples have
    # no such light.
    rows = slice(0, 3 if case.distribution == ASHIKHMIN_SHIRLEY and case.inputs["roughness"] > 0.2 else None)
    np.testing.assert_allclose(ours(case)[rows], cycles[0, CASES.index(case), rows], rtol=tolerance(case), atol=5e-4)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=str)
@pytest.mark.parametrize("sun", range(len(SUNS)))
def test_value_agrees_with_cycles(case: Case, sun: int, cycles: np.ndarray) -> None:
    for row, cosine in enumerate(COSINES):
        wo, wi = directions(cosine, SUNS[sun])
        lobes = lobes_of(case, cosine)
        value = lobes.evaluate(wi[None])[1][0] + lobes.closures.emission[0, :3]
        if is_impossible_refraction(case, wo, wi):
            # Cycles lights these by light sampling only, against its own sampling of the lobe: we do not.
            assert not value.any()
        else:
            expected = cycles[1 + sun, CASES.index(case), row]
            np.testing.assert_allclose(value, expected, rtol=tolerance(case), atol=2e-5, err_msg=f"cosine {cosine}")


if __name__ == "__main__":
    render(Path(sys.argv[1]))
