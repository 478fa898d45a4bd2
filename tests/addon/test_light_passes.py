# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of light taken apart, by Blender's names and switches: their sum is the picture, and each is Cycles' own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import metrics
from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import SceneSource, open_scene
from benchmarks.scenes import SCENES
from tests.helpers.light_groups import grouped
from tests.helpers.light_sums import LOBES, lit_by, sum_of_passes
from tests.helpers.parity.scenes import LINKED_MEDIA
from tests.helpers.pass_files import NAMES, ask_for_passes, render_passes
from tests.helpers.pass_scenes import make_material, see_through
from tests.helpers.some_cases import some_of

PIXELS = 40 * 30
#: Standard errors, and difference of a cell, that count as found: as in test_parity, for 24 cells and 11 passes.
SIGMAS = 4.5
CELL_ALLOWANCE = 0.01
#: Always compared: hair whose colour is an estimate, and a portal in a wall, which is half transparent to passes.
ALWAYS = ["hair-principled", "hair-huang-round", "ray-portal-mixed"]
#: Where light is made to be found seldom, few samples say nothing; Cycles disperses nothing.
COMPARABLE = sorted(
    name
    for name, scene in SCENES.items()
    if scene.group not in ("failures", "spectral", "furnished", "caustics", "clamped", "matter_indoors", "matter_large")
    and name not in ("torus-in-glass", *LINKED_MEDIA, *ALWAYS)
)


#: For these Cycles takes twenty minutes.
TOO_LONG = {"fail-fog-nested"}
MANY = [name for name in some_of(COMPARABLE, 40) if name not in TOO_LONG]


def render_by(scene: Any, rival: str, samples: int, seed: int, path: Path, **settings: Any) -> dict[str, np.ndarray]:
    find_rival(rival, settings).configure(scene, Budget(samples), seed, 0)
    ask_for_passes(scene)
    return render_passes(scene, path, NAMES)


#: As in Cycles, light that the picture alone has; and linked lights in media, which take a minute to compile.
NOT_SUMMED = ("fast-gi-add", *LINKED_MEDIA)
#: Few scenes that touch much: all lobes, volumes, transparency, lamps that are seen, the world, emission, holes in the
#: picture.
FAST = [
    # Media have kernels of their own, which take a minute to compile.
    pytest.param("media-overlapping", marks=pytest.mark.estimator), "principled-everything", "visibility",
    "world-image-sun",
]


def check_sum(name: str, path: Path, rival: str = "OFF", samples: int = 8, **settings: Any) -> None:
    scene = open_scene(SceneSource(f"builtin:{name}"), pixels=PIXELS)
    images = render_by(scene, rival, samples, 0, path, **settings)
    if scene.render.film_transparent:
        # The picture leaves out the background that its pass has.
        images["Environment"][:] = 0.0
    combined = images["Combined"][..., :3]
    assert combined.max() > 0.0
    # Sums of some thousand float32 addends, and pixels that bright samples have come and gone in.
    assert np.allclose(sum_of_passes(images), combined, rtol=2e-4, atol=1e-5 * combined.mean()), name


@pytest.mark.parametrize("name", FAST)
def test_the_sum_of_passes_is_the_picture(name: str, tmp_path: Path, blender: Any) -> None:
    check_sum(name, tmp_path / "i.exr")


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize(
    "name",
    some_of(
        sorted(name for name, scene in SCENES.items() if scene.group != "matter_large" and name not in NOT_SUMMED), 4
    ),
)
def test_the_sum_of_passes_is_the_picture_in_many_scenes(name: str, tmp_path: Path, blender: Any) -> None:
    check_sum(name, tmp_path / "i.exr", samples=2)


def check_against_cycles(name: str, tmp_path: Path, samples: int, seed_count: int) -> None:
    """As in test_parity, for each pass of colour, for light with its colour, and for what the camera sees itself.

    Relative to a pass's own cells, or to a twentieth of its mean where they are darker. Passes that bring less than a
    thousandth of the picture's light are left out: there are few samples in them.
    """
    scene = open_scene(SceneSource(f"builtin:{name}"), pixels=PIXELS)
    renders = {
        rival: [
            render_by(scene, rival, samples, seed, tmp_path / "i.exr") for seed in range(seed_count)
        ]
        for rival in ("OFF", "cycles")
    }
    compared = {
        **{f"{lobes} Color": lambda images, key=f"{lobes} Color": images[key][..., :3] for lobes in LOBES},
        **{
            f"{lobes} {light}": lambda images, lobes=lobes, light=light: lit_by(images, lobes, light)
            for lobes in LOBES
            for light in ("Direct", "Indirect")
        },
        **{key: lambda images, key=key: images[key][..., :3] for key in NAMES[1:4]},
    }
    least = 1e-3 * np.mean([images["Combined"][..., :3] for images in renders["cycles"]])
    count = 0
    for key, of in compared.items():
        ours, theirs = ([of(images) for images in renders[rival]] for rival in ("OFF", "cycles"))
        if max(np.mean(ours), np.mean(theirs)) <= least:
            continue
        count += 1
        cells = metrics.compare_cells(ours, theirs, rows=4, columns=6)
        allowance = max(CELL_ALLOWANCE, SCENES[name].allowance)
        beyond = np.abs(cells.difference) > allowance + SIGMAS * cells.standard_error
        assert not beyond.any(), (
            f"{name}, {key}: cells (row, column) {np.argwhere(beyond).tolist()} differ by "
            f"{100 * cells.difference[beyond]} % +- {100 * cells.standard_error[beyond]} %"
        )
    assert count >= 1


@pytest.mark.parametrize("name", ["glass-rough", "light-visibility", "principled-everything"])
def test_passes_are_those_of_cycles(name: str, tmp_path: Path, blender: Any) -> None:
    check_against_cycles(name, tmp_path, samples=24, seed_count=4)


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize("name", [*MANY, *ALWAYS])
def test_passes_are_those_of_cycles_in_many_scenes(name: str, tmp_path: Path, blender: Any) -> None:
    check_against_cycles(name, tmp_path, samples=max(SCENES[name].samples, 32), seed_count=4)


def test_light_groups_are_passes_and_their_sum_is_the_picture(cube_scene: Any, tmp_path: Path) -> None:
    grouped(cube_scene)
    ask_for_passes(cube_scene)
    names = ["Combined_Key", "Combined_Glow", "Combined_Sky"]
    images = render_passes(cube_scene, tmp_path / "i.exr", ["Combined", *names])
    assert all(images[name].mean() > 1e-4 for name in names)
    total = sum(images[name][..., :3] for name in names)
    assert np.allclose(total, images["Combined"][..., :3], rtol=1e-4, atol=1e-6)


def check_passes_against_cycles(
    scene: Any, names: list[str], tmp_path: Path, *, asks_all: bool = True
) -> dict[str, np.ndarray]:
    """Means over cells as in test_parity: 24 cells a pass, normal noise, 4 seeds each; returns Cycles' last passes."""
    renders: dict[str, list[dict[str, np.ndarray]]] = {"OFF": [], "cycles": []}
    for rival, found in renders.items():
        for seed in range(4):
            find_rival(rival).configure(scene, Budget(64), seed, 0)
            if asks_all:
                ask_for_passes(scene)
            found.append(render_passes(scene, tmp_path / "i.exr", names))
    for name in names:
        ours, theirs = ([images[name] for images in renders[rival]] for rival in ("OFF", "cycles"))
        cells = metrics.compare_cells(ours, theirs, rows=4, columns=6)
        assert (np.abs(cells.difference) <= CELL_ALLOWANCE + SIGMAS * cells.standard_error).all(), name
    return renders["cycles"][-1]


def test_light_groups_are_those_of_cycles(cube_scene: Any, tmp_path: Path) -> None:
    grouped(cube_scene)
    check_passes_against_cycles(cube_scene, ["Combined_Key", "Combined_Glow", "Combined_Sky"], tmp_path)


def test_instances_without_a_group_are_in_that_of_their_instancer(cube_scene: Any, tmp_path: Path) -> None:
    """A collection of a lamp and a cube that glows, each in a group of its own or in none, instanced by an empty."""
    import bpy

    grouped(cube_scene)
    collection = bpy.data.collections.new("Lamps")
    for item in [*cube_scene.objects]:
        if item.name == "Sun" or item.lightgroup == "Glow":
            cube_scene.collection.objects.unlink(item)
            collection.objects.link(item)
            item.lightgroup = "" if item.lightgroup == "Glow" else item.lightgroup
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.data.energy, lamp.data.shadow_soft_size, lamp.location = 300.0, 0.3, (-2.0, -2.0, 2.0)
    collection.objects.link(lamp)
    empty = bpy.data.objects.new("Instancer", None)
    empty.instance_type, empty.instance_collection, empty.lightgroup = "COLLECTION", collection, "Glow"
    cube_scene.collection.objects.link(empty)
    passes = check_passes_against_cycles(cube_scene, ["Combined_Key", "Combined_Glow", "Combined_Sky"], tmp_path)
    assert all(image.mean() > 1e-4 for image in passes.values())


@pytest.mark.parametrize("has_environment", [True, False])
def test_a_transparent_film_leaves_the_environment_to_its_pass(
    cube_scene: Any, tmp_path: Path, has_environment: bool
) -> None:
    """And, only with that pass, to the world's light group, as in Cycles; a pane covers half of the picture."""
    import bpy

    grouped(cube_scene)
    cube_scene.render.film_transparent = True
    bpy.ops.mesh.primitive_plane_add(size=2.0, location=(-1.0, -3.0, 1.0), rotation=(1.57, 0.0, 0.0))
    bpy.context.object.data.materials.append(make_material("Thin", see_through(0.3)))
    names = ["Combined", "Combined_Sky"]
    ask_for_passes(cube_scene)
    cube_scene.view_layers[0].use_pass_environment = has_environment
    passes = check_passes_against_cycles(
        cube_scene, [*names, "Environment"] if has_environment else names, tmp_path, asks_all=has_environment
    )
    assert passes["Combined"][..., 3].min() < 0.01
    assert (passes["Combined_Sky"].min() > 0.01) == has_environment


@pytest.mark.parametrize("distance", [None, 1.0, 30.0])
def test_ambient_occlusion_looks_as_far_as_in_cycles(cube_scene: Any, tmp_path: Path, distance: float | None) -> None:
    """As far as the world says, or 10 m without one, and whatever the view layer's switch and the object say.

    A cube on a floor before a wall at 12 m.
    """
    import bpy

    scene = cube_scene
    bpy.ops.mesh.primitive_plane_add(size=60.0, location=(0.0, 0.0, -1.0))
    bpy.context.object.cycles.ao_distance = 3.0
    bpy.ops.mesh.primitive_cube_add(size=20.0, location=(0.0, 15.0, 0.0))
    scene.world = None
    if distance is not None:
        scene.world = bpy.data.worlds.new("World")
        scene.world.light_settings.distance = distance
        scene.view_layers[0].use_sky = False
    passes = check_passes_against_cycles(scene, ["Ambient Occlusion"], tmp_path)
    assert 0.2 < passes["Ambient Occlusion"].mean() < 0.99


def test_an_object_of_a_group_that_the_layer_has_not_is_of_none(cube_scene: Any) -> None:
    from tests.helpers.blender_scenes import export

    grouped(cube_scene)
    cube_scene.objects["Sun"].lightgroup = "Nowhere"
    cube_scene.objects["Sun"].update_tag()
    description = export()
    assert description.light_groups == ("Key", "Glow", "Sky")
    assert description.lights[0].light_group == -1
    assert sorted(description.instances.light_group.tolist()) == [-1, 1]
    assert description.world.light_group == 2


def test_volume_passes_are_black(cube_scene: Any, tmp_path: Path) -> None:
    layer = cube_scene.view_layers[0]
    layer.cycles.use_pass_volume_direct = layer.cycles.use_pass_volume_indirect = True
    ask_for_passes(cube_scene)
    images = render_passes(cube_scene, tmp_path / "i.exr", ["Volume Direct", "Volume Indirect"])
    assert not any(image.any() for image in images.values())
