# SPDX-License-Identifier: GPL-3.0-or-later
"""Lightmaps at equal time: what is baked, and what is made of seconds and errors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from benchmarks.baking import (
    Bakes,
    Error,
    Figures,
    Timing,
    better_cycles,
    error_of,
    error_table,
    figures,
    least_noisy,
    mean_difference,
    samples_for,
)
from benchmarks.lightmaps import Spent, make_lightmap


@pytest.mark.parametrize(("beside", "each"), [(1.5, 0.04), (0.0, 0.2)])
def test_samples_fill_the_seconds_beside_what_bakes_take_anyway(beside: float, each: float) -> None:
    short, long = (Timing(samples, beside + each * samples) for samples in (16, 100))
    assert beside + each * samples_for(20.0, short, long) == pytest.approx(20.0, abs=each)


def test_a_bake_that_seems_to_get_faster_counts_as_a_whole() -> None:
    assert samples_for(20.0, Timing(16, 9.0), Timing(100, 8.0)) == 250


def _bakes(level: float, deviation: float, seconds: float, seed: int) -> Bakes:
    rng = np.random.default_rng(seed)
    images = [
        (level + deviation * rng.standard_normal((1, 60000, 3))).astype(np.float32) for _ in range(3)
    ]
    return Bakes(64, [Spent(seconds, 1.5 * seconds)] * 3, images)


def test_errors_and_seconds_make_times_better() -> None:
    """A fourth of the deviation in twice the time: eight times better."""
    references = {name: _bakes(1.0, 0.01, 1.0, seed).images[:2] for name, seed in (("OFF", 1), ("cycles", 2))}
    bakes = {"cycles": _bakes(1.0, 0.4, 10.0, 3), "AUTO": _bakes(1.003, 0.1, 20.0, 4)}
    brightness = least_noisy(bakes, references["OFF"][0])
    assert (brightness == np.mean(bakes["AUTO"].images, axis=0)).all()
    theirs, ours = (figures(bakes[name], references, np.ones_like(brightness)) for name in bakes)
    assert ours.times_better(theirs) == pytest.approx(8.0, rel=0.03)
    assert ours.times_better_where_lit(theirs) == pytest.approx(ours.times_better(theirs))
    assert ours.times_better_by_processor(theirs) == pytest.approx(ours.times_better(theirs))
    assert ours.difference == pytest.approx(0.003, abs=4.0 * ours.standard_error)
    error = math.hypot(0.1 / 3.0, 0.01 / math.sqrt(6.0)) / math.sqrt(60000)
    assert ours.standard_error == pytest.approx(error, rel=0.1)


def test_texels_that_no_light_comes_to_count_apart() -> None:
    """Of four texels one is black, and only there a bias: all light where there should be none."""
    black = np.array([0.0, 1.0, 1.0, 1.0])[None, :, None] * np.ones((1, 4, 3), np.float32)
    found = np.tile(black + np.array([0.3, 0.0, 0.0, 0.0])[None, :, None], (1, 500, 1))
    black = np.tile(black, (1, 500, 1))
    one = figures(Bakes(1, [Spent(1.0, 1.0)] * 2, [found, found]), dict.fromkeys(("OFF", "cycles"), [black] * 2), black)
    assert one.error.bias_squared > 0.1 and one.of_lit.bias_squared == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("bias", "deviation", "of_references"), [(0.1, 0.05, 0.01), (0.05, 0.03, 0.2), (0.0, 0.1, 0.2)]
)
def test_noise_of_references_is_in_no_error(bias: float, deviation: float, of_references: float) -> None:
    first, second = (_bakes(1.0, of_references, 1.0, seed).images[0] for seed in (5, 6))
    found = error_of(_bakes(1.0 + bias, deviation, 1.0, 7).images, (first, second), np.ones_like(first))
    assert found.variance == pytest.approx(deviation**2 / 1.01, rel=0.05)
    assert found.bias_squared == pytest.approx(bias**2 / 1.01, abs=6e-4)
    assert found.total == pytest.approx(found.variance + max(found.bias_squared, 0.0))


def test_means_are_of_texels_and_channels() -> None:
    images = [np.full((1, 4, 3), value, np.float32) for value in (1.0, 1.2)]
    difference, _ = mean_difference(images, [np.ones((1, 4, 3), np.float32)] * 2)
    assert difference == pytest.approx(0.1)


def _figures(total: float, seconds: float) -> Figures:
    return Figures(64, seconds, 2.0 * seconds, Error(total, 0.0), Error(total, 0.0), 0.0, 0.0, [])


def test_the_better_cycles_counts() -> None:
    rooms = {
        "first": {"cycles": _figures(0.4, 20.0), "cycles-guided": _figures(0.3, 22.0), "AUTO": _figures(0.1, 20.0)},
        "second": {"cycles": _figures(0.3, 20.0), "cycles-guided": _figures(0.3, 22.0), "AUTO": _figures(0.025, 20.0)},
    }
    better = better_cycles(rooms["first"])
    assert better is not None and better.seconds == 22.0
    last = [line.split("|")[-4].strip() for line in error_table(rooms).splitlines()[2:]]
    assert last == ["-", "-", "3.3", "-", "-", "12", f"{math.sqrt(3.3 * 12.0):.3g}"]


def test_what_looks_at_the_camera_is_baked(blender: Any) -> None:
    """Of a floor, a wall and a small box the first two, and of these the faces that are seen: by Cycles."""
    scene = blender.context.scene
    material = blender.data.materials.new("Wall")
    if material.node_tree is None:
        material.use_nodes = True
    for name, place, size in (
        ("Floor", (0.0, 0.0, -0.1), (4.0, 4.0, 0.2)), ("Wall", (0.0, 2.1, 1.0), (4.0, 0.2, 2.0)),
        ("Box", (0.0, 1.0, 0.1), (0.2, 0.2, 0.2)),
    ):  # fmt: skip
        blender.ops.mesh.primitive_cube_add(size=1.0, location=place)
        item = blender.context.object
        item.name, item.scale = name, size
        item.data.materials.append(material)
    sun = blender.data.objects.new("Sun", blender.data.lights.new("Sun", "SUN"))
    camera = blender.data.objects.new("Camera", blender.data.cameras.new("Camera"))
    camera.location, sun.rotation_euler = (0.0, -1.0, 1.0), (0.7, 0.0, 0.0)
    for one in (camera, sun):
        scene.collection.objects.link(one)
    scene.camera = camera
    blender.context.view_layer.update()
    lightmap = make_lightmap(scene, 64)
    assert {item.name for item in scene.objects if item.type == "MESH"} == {"Floor", "Box"}
    assert lightmap.item.name == "Floor"
    scene.render.engine, scene.cycles.samples = "CYCLES", 4
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    texels, spent = lightmap.bake(scene)
    assert spent.seconds > 0.0 and spent.processor_seconds > 0.0
    assert 64 * 64 / 5 < len(texels) < 64 * 64
    # Nothing of what is seen turns away from the sun.
    assert np.median(texels) > 0.1 and (texels > 0.0).mean() > 0.9
