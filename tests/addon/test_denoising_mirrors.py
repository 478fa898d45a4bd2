# SPDX-License-Identifier: GPL-3.0-or-later
"""Specular albedo and roughness for denoisers beside Cycles' own, which Blender has from 5.3 on.

Cycles makes them of all samples, and both renderers place theirs by chance: pixels at edges differ by that alone.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.pass_scenes import add_object, make_material, render_both, see_through

SAMPLES = 64
ROUGHNESS = "ViewLayer.Denoising Roughness.X"
SPECULAR_ALBEDO = [f"ViewLayer.Denoising Specular Albedo.{channel}" for channel in "RGB"]


def node(kind: str, properties: dict[str, Any] | None = None, **inputs: Any) -> Callable[[Any], Any]:
    """A surface of one shader node."""

    def surface(tree: Any) -> Any:
        shader = tree.nodes.new(f"ShaderNode{kind}")
        for name, value in (properties or {}).items():
            setattr(shader, name, value)
        for name, value in inputs.items():
            shader.inputs[name.replace("_", " ")].default_value = value
        return shader.outputs[0]

    return surface


def mixed(one: Callable[[Any], Any], other: Callable[[Any], Any], share: float) -> Callable[[Any], Any]:
    """A surface that is another by `share`."""

    def surface(tree: Any) -> Any:
        mix = tree.nodes.new("ShaderNodeMixShader")
        mix.inputs[0].default_value = share
        for index, part in enumerate((one, other)):
            tree.links.new(part(tree), mix.inputs[1 + index])
        return mix.outputs[0]

    return surface


COPPER, BLUE = (0.9, 0.5, 0.3, 1.0), (0.2, 0.4, 0.9, 1.0)
DIFFUSE = node("BsdfDiffuse", Color=BLUE)
TRANSPARENT = node("BsdfTransparent", Color=(0.9, 0.7, 0.5, 1.0))
SURFACES = {
    "mirror": node("BsdfAnisotropic", Color=COPPER, Roughness=0.0),
    "brushed": node("BsdfAnisotropic", Color=COPPER, Roughness=0.3, Anisotropy=0.6),
    "dull": node("BsdfAnisotropic", Color=COPPER, Roughness=0.6),
    "diffuse": DIFFUSE,
    "rough diffuse": node("BsdfDiffuse", Color=BLUE, Roughness=0.7),
    "glass": node("BsdfGlass", Color=COPPER, Roughness=0.0),
    "frosted": node("BsdfGlass", Color=COPPER, Roughness=0.25),
    "refraction": node("BsdfRefraction", Color=COPPER, Roughness=0.2),
    "varnish": mixed(node("BsdfAnisotropic", Roughness=0.1), DIFFUSE, 0.3),
    "half varnish": mixed(node("BsdfAnisotropic", Roughness=0.1), DIFFUSE, 0.8),
    "plastic": node("BsdfPrincipled", Base_Color=BLUE, Roughness=0.2),
    "metal": node("BsdfPrincipled", Base_Color=COPPER, Roughness=0.3, Metallic=1.0),
    "coated": node("BsdfPrincipled", Base_Color=BLUE, Roughness=0.6, Coat_Weight=0.8, Coat_Roughness=0.05),
    "window": node("BsdfPrincipled", Base_Color=BLUE, Roughness=0.15, Transmission_Weight=0.7),
    "thin window": node("BsdfPrincipled", Base_Color=COPPER, Roughness=0.2, Transmission_Weight=1.0, Thin_Wall=True),
    "skin": node("BsdfPrincipled", Base_Color=COPPER, Roughness=0.4, Subsurface_Weight=0.5),
    "velvet": node("BsdfPrincipled", Base_Color=BLUE, Roughness=0.5, Sheen_Weight=0.7),
    "film": node("BsdfPrincipled", Base_Color=BLUE, Roughness=0.1, Thin_Film_Thickness=400.0),
    "half there": node("BsdfPrincipled", Base_Color=BLUE, Roughness=0.2, Alpha=0.4),
    "translucent": node("BsdfTranslucent", Color=BLUE),
    "toon": node("BsdfToon", Color=BLUE),
    "shiny toon": node("BsdfToon", {"component": "GLOSSY"}, Color=BLUE),
    "conductor": node("BsdfMetallic", Roughness=0.2),
    "clear mirror": mixed(node("BsdfAnisotropic", Color=COPPER, Roughness=0.1), TRANSPARENT, 0.5),
    "hole": mixed(node("Holdout"), node("BsdfAnisotropic", Roughness=0.2), 0.5),
    "portal": mixed(node("BsdfRayPortal"), DIFFUSE, 0.4),
    "strands": node("BsdfHair", Color=COPPER),
    "seen through strands": node("BsdfHair", {"component": "Transmission"}, Color=COPPER),
    "hair": node("BsdfHairPrincipled"),
    "hair from afar": node("BsdfHairPrincipled", {"model": "HUANG"}),
}
#: Surfaces of which there are curves instead of a panel.
HAIR = list(SURFACES)[-4:]
COLUMNS, PIXELS = 6, 20


def add_panel(name: str, place: tuple[float, float]) -> None:
    """A panel at x and z that leans back; of hair its strands."""
    import bpy

    material = make_material(name, SURFACES[name])
    x, z = place
    if name not in HAIR:
        add_object(name, "plane", material, location=(x, 0.0, z), rotation=(1.3, 0.0, 0.2), size=0.92)
        return
    data = bpy.data.hair_curves.new(name)
    across = np.linspace(-0.45, 0.45, 16)
    data.add_curves([2] * len(across))
    ends = [(x + offset, 0.1 * side, z + 0.45 * side) for offset in across for side in (-1.0, 1.0)]
    data.attributes["position"].data.foreach_set("vector", np.float32(ends).reshape(-1))
    data.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", np.full(len(ends), 0.05, np.float32))
    data.materials.append(material)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, data))


def places() -> dict[str, tuple[float, float]]:
    """x and z of each panel's middle."""
    rows = len(SURFACES) // COLUMNS
    return {
        name: (index % COLUMNS - 0.5 * (COLUMNS - 1), index // COLUMNS - 0.5 * (rows - 1))
        for index, name in enumerate(SURFACES)
    }


@pytest.fixture
def scene(cube_scene: Any) -> Any:
    """A wall of panels before a shiny back, whose lower halves are behind panes."""
    import bpy

    layer = cube_scene.view_layers[0]
    if not hasattr(layer.cycles, "denoising_pass_follow_reflections"):
        pytest.skip("specular albedo and roughness for denoisers came with Blender 5.3")
    for item in list(cube_scene.objects):
        if item.type == "MESH":
            bpy.data.objects.remove(item)
    shiny = mixed(node("BsdfAnisotropic", Color=COPPER, Roughness=0.2), DIFFUSE, 0.4)
    leaning = {"location": (0.0, 1.5, 0.0), "rotation": (1.4, 0.0, 0.0), "size": 12}
    add_object("Back", "plane", make_material("Back", shiny), **leaning)
    glaze = mixed(see_through(0.4), node("BsdfAnisotropic", Color=BLUE, Roughness=0.1), 0.3)
    pane = make_material("Pane", glaze)
    for name, (x, z) in places().items():
        add_panel(name, (x, z))
        upright = {"location": (x, -1.0, z - 0.25), "rotation": (np.pi / 2.0, 0.0, 0.0), "size": 1}
        strip = add_object("Strip", "plane", pane, **upright)
        strip.scale = (1.0, 0.4, 1.0)
    camera = cube_scene.camera
    camera.data.type, camera.data.ortho_scale = "ORTHO", COLUMNS
    camera.location, camera.rotation_euler = (0.0, -8.0, 0.0), (np.pi / 2.0, 0.0, 0.0)
    render = cube_scene.render
    render.resolution_x, render.resolution_y = COLUMNS * PIXELS, len(SURFACES) // COLUMNS * PIXELS
    layer.cycles.denoising_store_passes = True
    return cube_scene


def halves(image: np.ndarray) -> dict[str, float]:
    """Means of each panel's middle, above and behind its pane, of an image of float64 (height, width), row 0 on top."""
    height, width = image.shape
    found = {}
    for name, (x, z) in places().items():
        column = round(width / 2 + x * PIXELS)
        for half, up in (("", 0.2), (", behind a pane", -0.25)):
            row = round(height / 2 - (z + up) * PIXELS)
            found[name + half] = float(image[row - 2 : row + 3, column - 4 : column + 5].mean())
    return found


@pytest.mark.parametrize(("follows", "weighs"), [(True, True), (True, False), (False, True)])
def test_specular_albedo_and_roughness_are_those_of_cycles(
    scene: Any, tmp_path: Path, follows: bool, weighs: bool
) -> None:
    layer = scene.view_layers[0].cycles
    layer.denoising_pass_follow_reflections, layer.denoising_pass_use_albedo_roughness_weighting = follows, weighs
    (ours, _), (theirs, _) = render_both(scene, tmp_path, SAMPLES)
    for name in (ROUGHNESS, *SPECULAR_ALBEDO):
        assert np.ptp(theirs[name]) > 0.5, name
        difference = ours[name] - theirs[name]
        assert np.sqrt((difference**2).mean()) < 0.01, name
        assert abs(difference.mean()) < 0.0005, name
        own, other = halves(ours[name]), halves(theirs[name])
        off = {place: (own[place], value) for place, value in other.items() if abs(own[place] - value) > 0.005}
        assert not off, name
