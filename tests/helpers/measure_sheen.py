# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure the sheen lobe that Cycles renders and store its fit: `python -m tests.helpers.measure_sheen`.

Cycles' Sheen BSDF is a linearly transformed cosine (Zeltner et al. 2022): with the local direction (x, y, z) of the
light, f cos = R z / pi (a / g)^2, g = a^2 (x^2 + y^2) + 2 a b x z + (b^2 + 1) z^2. So the root of R z / (pi f cos) is
linear in (a, b, (b^2 + 1) / a), and a few suns and one white world give a, b and the albedo R of every angle and
roughness, without noise. Planes tilted against an orthographic camera show all of them in one picture.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from engine.kernels.bsdf.tables import TABLES_FILE

SIZE = 32
PIXELS = 3
SUNS = [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (-0.6, 0.0, 0.8), (0.0, 0.7, 0.7), (0.95, 0.0, 0.3), (0.8, 0.5, 0.1)]
#: Cosine and roughness that stand in for the tables' first samples, as fractions of their spacing.
FIRST_COSINE = 0.3
FIRST_ROUGHNESS = 1e-3 * (SIZE - 1)


def axis(first: float) -> np.ndarray:
    """Coordinates of the tables' samples, the first moved inwards by `first` spacings."""
    return np.concatenate([[first], np.arange(1, SIZE)]) / (SIZE - 1)


def build_scene(bpy: Any) -> None:
    """Planes: cosine along x, roughness along y."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 1
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.light_sampling_threshold = 0.0
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.filter_width = 0.01
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.data.type = "ORTHO"
    camera.data.ortho_scale = SIZE
    camera.data.clip_end = 1000.0
    camera.location = ((SIZE - 1) / 2, (SIZE - 1) / 2, 400.0)
    scene.render.resolution_x = scene.render.resolution_y = PIXELS * SIZE
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    corner = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    for row, roughness in enumerate(axis(FIRST_ROUGHNESS)):
        material = bpy.data.materials.new("sheen")
        material.use_nodes = True
        tree = material.node_tree
        tree.nodes.clear()
        sheen = tree.nodes.new("ShaderNodeBsdfSheen")
        sheen.distribution = "MICROFIBER"
        sheen.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
        sheen.inputs["Roughness"].default_value = roughness
        output = tree.nodes.new("ShaderNodeOutputMaterial")
        tree.links.new(sheen.outputs["BSDF"], output.inputs["Surface"])
        for column, cosine in enumerate(axis(FIRST_COSINE)):
            slope = np.sqrt(1.0 - cosine**2) / cosine
            mesh = bpy.data.meshes.new("plane")
            mesh.from_pydata([(x, y, -slope * x) for x, y in corner], [], [(0, 1, 2, 3)])
            mesh.materials.append(material)
            plane = bpy.data.objects.new("plane", mesh)
            plane.location = (column, row, 0.0)
            scene.collection.objects.link(plane)
            for kind in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
                setattr(plane, f"visible_{kind}", False)


def render(bpy: Any, folder: str) -> np.ndarray:
    """Radiance of every plane, float64 (roughness, cosine)."""
    scene = bpy.context.scene
    scene.render.filepath = str(Path(folder) / "sheen.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    image.colorspace_settings.name = "Non-Color"
    pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(SIZE, PIXELS, SIZE, PIXELS, 4)[:, PIXELS // 2, :, PIXELS // 2, 0].astype(np.float64)


def measure() -> np.ndarray:
    """a, b and albedo, float64 (3, roughness, cosine), at the coordinates of `axis`."""
    import bpy
    from mathutils import Vector

    build_scene(bpy)
    scene = bpy.context.scene
    world = bpy.data.worlds.new("world")
    scene.world = world
    world.use_nodes = True
    background = world.node_tree.nodes["Background"].inputs["Color"]
    cosines = axis(FIRST_COSINE)
    sines = np.sqrt(1.0 - cosines**2)
    with tempfile.TemporaryDirectory() as folder:
        background.default_value = (1.0, 1.0, 1.0, 1.0)
        scene.cycles.samples = 16
        albedo = render(bpy, folder)
        scene.cycles.samples = 1
        background.default_value = (0.0, 0.0, 0.0, 1.0)
        sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
        sun.data.angle = 0.0
        sun.data.energy = 1.0
        scene.collection.objects.link(sun)
        rows, sides, valid = [], [], []
        for direction in SUNS:
            unit = np.array(direction) / np.linalg.norm(direction)
            sun.rotation_euler = Vector(unit).to_track_quat("Z", "Y").to_euler()
            f_cos = render(bpy, folder)
            # Frame of a plane: normal (sine, 0, cosine); the tangent is the camera's direction, laid into the plane.
            z = sines * unit[0] + cosines * unit[2]
            x = -cosines * unit[0] + sines * unit[2]
            with np.errstate(divide="ignore", invalid="ignore"):
                sides.append(np.sqrt(albedo * z / (np.pi * f_cos)))
            rows.append(np.stack([x**2 + unit[1] ** 2, 2.0 * x * z, z**2], -1))
            valid.append((f_cos > 1e-9) & (z > 0.02))
    fit = np.zeros((3, SIZE, SIZE))
    for row in range(SIZE):
        for column in range(SIZE):
            used = [k for k in range(len(SUNS)) if valid[k][row, column]]
            if len(used) < 3:
                continue
            # Relative errors count: the transformed cosine spans orders of magnitude.
            matrix = np.array([rows[k][column] / sides[k][row, column] for k in used])
            solution = np.linalg.lstsq(matrix, np.ones(len(used)), rcond=None)[0]
            residual = np.abs(matrix @ solution - 1.0).max()
            assert residual < 5e-3, (row, column, residual)
            fit[:, row, column] = solution[0], solution[1], albedo[row, column]
    return fit


def at_table_samples(fit: np.ndarray) -> np.ndarray:
    """Extrapolate the first row and column from where they were measured to 0."""
    fit = fit.copy()
    fit[:, 0, :] = (fit[:, 0, :] - FIRST_ROUGHNESS * fit[:, 1, :]) / (1.0 - FIRST_ROUGHNESS)
    fit[:, :, 0] = (fit[:, :, 0] - FIRST_COSINE * fit[:, :, 1]) / (1.0 - FIRST_COSINE)
    return fit


def main() -> None:
    """Replace the sheen fit in the package's tables."""
    with np.load(TABLES_FILE) as stored:
        tables = dict(stored)
    tables["sheen"] = at_table_samples(measure()).astype(np.float32)
    np.savez_compressed(TABLES_FILE, **tables)


if __name__ == "__main__":
    main()
