# SPDX-License-Identifier: GPL-3.0-or-later
"""A meadow and a forest: instances by the thousand, leaves that let light through, cards cut out by their alpha."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    add_object,
    camera,
    diffuse,
    image,
    light,
    material,
    mesh,
    quad,
    resolution,
    world,
)


def leaf(nodes: Nodes, color: tuple[float, float, float] = (0.12, 0.35, 0.06)) -> Socket:
    """What reflects some of the light and lets as much through."""
    through = nodes("BsdfTranslucent", Color=(1.3 * color[0], color[1], 0.5 * color[2]))
    return nodes("MixShader", inputs={0: 0.5, 1: nodes("BsdfDiffuse", Color=color), 2: through})


def card(name: str, color: tuple[float, float, float]) -> Any:
    """A material of leaves that an image cuts out."""
    y, x = np.mgrid[-1:1:32j, -1:1:32j]
    pixels = np.ones((32, 32, 4), np.float32)
    # Five petals with soft edges.
    pixels[..., 3] = np.clip(8.0 * (0.45 + 0.4 * np.cos(5.0 * np.arctan2(y, x)) - np.hypot(x, y)), 0.0, 1.0)
    cut = image(name, pixels)

    def surface(nodes: Nodes) -> Socket:
        alpha = nodes("TexImage", {"image": cut, "extension": "CLIP"}, output="Alpha")
        return nodes("MixShader", None, {0: alpha, 1: nodes("BsdfTransparent"), 2: leaf(nodes, color)})

    return material(name, surface)


def scatter(data: Any, places: np.ndarray, sizes: np.ndarray, seed: int, lean: float = 0.0) -> None:
    """An instance of a mesh on each place, turned at random about z, and leaning by so much of its height.

    Parameters
    ----------
    places : (N, 3)
    sizes : (N,)
        Factors of the mesh's size.
    """
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0.0, 2.0 * np.pi, len(places))
    across = np.stack([np.cos(turn), np.sin(turn), lean * rng.normal(size=len(turn))], axis=1)
    along = np.stack([-np.sin(turn), np.cos(turn), lean * rng.normal(size=len(turn))], axis=1)
    # A face's instance is as large as the square root of its area.
    half = 0.5 * sizes[:, None]
    corners = [places + half * (i * across + j * along) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    vertices = np.stack(corners, axis=1).reshape(-1, 3)
    holder = add_object(f"{data.name} places", mesh(
        f"{data.name} places", vertices.tolist(), np.arange(len(vertices)).reshape(-1, 4).tolist()
    ))  # fmt: skip
    holder.instance_type, holder.use_instance_faces_scale = "FACES", True
    holder.show_instancer_for_render = False
    add_object(data.name, data).parent = holder


def _blade(name: str, surface: Any, bend: float) -> Any:
    """A blade of grass, a metre high, that narrows and bends."""
    heights = np.array([0.0, 0.4, 0.75, 1.0])
    vertices = [(side * 0.035 * (1.0 - 0.8 * z), bend * z * z, z) for z in heights for side in (-1.0, 1.0)]
    faces = [(2 * k, 2 * k + 1, 2 * k + 3, 2 * k + 2) for k in range(3)]
    created = mesh(name, vertices, faces, surface)
    created.polygons.foreach_set("use_smooth", [True] * 3)
    return created


def _flower(name: str, surface: Any) -> Any:
    """Three cards that cross each other, a metre high."""
    vertices: list[tuple[float, float, float]] = []
    for angle in np.radians([0.0, 60.0, 120.0]):
        x, y = 0.5 * np.cos(angle), 0.5 * np.sin(angle)
        vertices += [(-x, -y, 0.0), (x, y, 0.0), (x, y, 1.0), (-x, -y, 1.0)]
    faces = [tuple(range(4 * k, 4 * k + 4)) for k in range(3)]
    return mesh(name, vertices, faces, surface, [(0, 0), (1, 0), (1, 1), (0, 1)] * 3)


def grass(blades: int, flowers: int, half: tuple[float, float], height: float = 0.5) -> None:
    """Blades in three shapes, and flowers, on the ground from -half to half [m]."""
    rng = np.random.default_rng(21)

    def places(count: int) -> np.ndarray:
        return rng.uniform((-half[0], -half[1], 0.0), (half[0], half[1], 1e-3), (count, 3))

    surface = material("Grass", leaf)
    for kind, bend in enumerate((0.15, 0.35, 0.6)):
        count = blades // 3
        scatter(_blade(f"Blade {kind}", surface, bend), places(count), height * rng.uniform(0.5, 1.0, count), kind, 0.2)
    pink = card("Petals", (0.7, 0.25, 0.4))
    scatter(_flower("Flower", pink), places(flowers), 0.8 * height * rng.uniform(0.5, 1.0, flowers), 5, 0.1)


def _sunlit(look_from: tuple[float, float, float], look_at: tuple[float, float, float]) -> None:
    resolution()
    camera(look_from, look_at)
    world((0.35, 0.45, 0.65))
    # Low and from behind, so that leaves glow.
    light("SUN", 4.0, (2.0, 4.0, 3.0), (0.0, 0.0, 0.0), angle=0.02)
    bpy.context.scene.cycles.transparent_max_bounces = 32


def meadow(blades: int, flowers: int) -> None:
    """A meadow that is twelve metres deep, seen against the sun."""
    _sunlit((0.0, -6.0, 1.4), (0.0, 0.0, 0.3))
    add_object("Ground", quad("Ground", diffuse((0.12, 0.08, 0.04), "earth"), 40.0, 40.0))
    grass(blades, flowers, (4.5, 6.0))


def _tree(kind: int, leaves: int, bark: Any, foliage: Any) -> Any:
    """A trunk with cards of leaves in a ball around its top, four metres high."""
    rng = np.random.default_rng(40 + kind)
    turn = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    rings = [(0.14, 0.0), (0.1, 1.2), (0.03, 3.2)]
    trunk = [(radius * np.cos(a), radius * np.sin(a), z) for radius, z in rings for a in turn]
    faces = [
        (8 * ring + k, 8 * ring + (k + 1) % 8, 8 * ring + 8 + (k + 1) % 8, 8 * ring + 8 + k)
        for ring in range(2) for k in range(8)
    ]  # fmt: skip
    outward = rng.normal(size=(leaves, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    centres = outward * rng.uniform(0.3, 1.0, (leaves, 1)) ** (1 / 3) * (0.9, 0.9, 1.2) + (0.0, 0.0, 2.8)
    side = np.cross(outward, rng.normal(size=(leaves, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(outward, side)
    half = 0.5 * 3.0 / np.sqrt(leaves)
    cards = np.stack([centres + half * (i * side + j * up) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))], axis=1)
    vertices = [*trunk, *cards.reshape(-1, 3).tolist()]
    first = len(trunk)
    all_faces = [*faces, *(tuple(range(first + 4 * k, first + 4 * k + 4)) for k in range(leaves))]
    data = mesh(f"Tree {kind}", vertices, all_faces, bark, [(0, 0), (1, 0), (1, 1), (0, 1)] * len(all_faces))
    data.materials.append(foliage)
    data.polygons.foreach_set("material_index", np.array([0] * len(faces) + [1] * leaves, np.int32))
    return data


def forest(trees: int, leaves: int) -> None:
    """Trees of three kinds on a hillside, each with so many cards of leaves."""
    _sunlit((0.0, -9.0, 3.2), (0.0, 0.0, 1.7))
    add_object("Ground", quad("Ground", diffuse((0.15, 0.12, 0.06), "moss"), 120.0, 120.0))
    bark = diffuse((0.2, 0.13, 0.08), "bark")
    rng = np.random.default_rng(22)
    for kind, color in enumerate(((0.1, 0.3, 0.05), (0.25, 0.35, 0.06), (0.4, 0.25, 0.05))):
        count = trees // 3
        places = rng.uniform((-8.0, -4.0, 0.0), (8.0, 26.0, 1e-3), (count, 3))
        tree = _tree(kind, leaves, bark, card(f"Leaves {kind}", color))
        scatter(tree, places, rng.uniform(0.7, 1.1, count), 30 + kind, 0.05)


@scene("plants-meadow")
def small_meadow() -> None:
    """A meadow of instanced blades that let light through, with flowers on cards."""
    meadow(6000, 60)


@scene("plants-forest")
def small_forest() -> None:
    """A wood of instanced trees, whose leaves an image cuts out of cards."""
    forest(60, 120)
