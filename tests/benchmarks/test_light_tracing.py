# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons: closed forms, the engine's own paths where these find the light, and what is refused or not known."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import metrics
from benchmarks.light_tracing.__main__ import main, make_reference
from benchmarks.light_tracing.picture import LightTracer
from benchmarks.light_tracing.state import filter_density
from benchmarks.reference import load_reference
from benchmarks.rendering import image_stack, render_scene
from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import SceneSource
from benchmarks.scenes import studio
from benchmarks.scenes.registry import SCENES, BuiltinScene
from engine.builder.camera import filter_table
from tests.helpers.grey_floor import open_grey_floor

#: Kernels of photons take a minute to compile.
compiled = pytest.mark.slow


def _bounces(scene: Any, count: int) -> None:
    for kind in ("max", "diffuse", "glossy", "transmission"):
        setattr(scene.cycles, f"{kind}_bounces", count)


@pytest.fixture
def floor(blender: Any) -> Any:
    """The open scene: a grey floor that fills the picture, seen from 2 m above; no light."""
    scene = open_grey_floor(blender, 16, 12)
    _bounces(scene, 1)
    return scene


def _mean(scene: Any, photons: int = 400_000) -> np.ndarray:
    tracer = LightTracer(scene, 1)
    assert tracer.known.all()
    return tracer.picture(photons, 1)[..., :3].mean(axis=(0, 1))


@compiled
def test_a_floor_in_the_sun(floor: Any) -> None:
    studio.light("SUN", 3.0, (1.0, 0.0, 1.0), (0.0, 0.0, 0.0), color=(1.0, 0.5, 0.25))
    expected = np.array((0.5, 0.4, 0.3)) * (3.0, 1.5, 0.75) * math.cos(math.radians(45.0)) / math.pi
    np.testing.assert_allclose(_mean(floor), expected, rtol=0.02)


@compiled
def test_a_floor_under_a_uniform_sky(floor: Any) -> None:
    studio.world((0.2, 0.3, 0.6), 2.0)
    np.testing.assert_allclose(_mean(floor), np.array((0.5, 0.4, 0.3)) * (0.4, 0.6, 1.2), rtol=0.03)


@compiled
def test_a_floor_below_a_ceiling_that_glows(floor: Any) -> None:
    """The form factor of a point below a square's middle: Howell 2010, "A Catalog of Radiation Heat Transfer
    Configuration Factors", B-3.
    """
    half, height = 4.0, 2.5
    lamp = studio.quad("Lamp", studio.emitter((1.0, 0.5, 0.25), 2.0), 2.0 * half, 2.0 * half)
    studio.add_object("Lamp", lamp, (0.0, 0.0, height))
    side = half / math.hypot(half, height)
    seen = 4.0 / math.pi * side * math.atan(side)
    expected = np.array((0.5, 0.4, 0.3)) * (2.0, 1.0, 0.5) * seen
    np.testing.assert_allclose(_mean(floor, 1_500_000), expected, rtol=0.03)


@compiled
def test_a_floor_under_water_without_the_compression_of_radiance(floor: Any) -> None:
    """As in Cycles a floor that is seen from within the water gets 1 / n^2 of the light that comes through."""
    ior, angle = 1.333, math.radians(45.0)
    water = studio.material("water", lambda nodes: nodes("BsdfGlass", Color=(1.0, 1.0, 1.0), Roughness=0.0, IOR=ior))
    studio.add_object("Water", studio.quad("Water", water, 8.0, 8.0), (0.0, 0.0, 2.5))
    studio.light("SUN", 3.0, (1.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    inside = math.asin(math.sin(angle) / ior)
    across = ((math.cos(angle) - ior * math.cos(inside)) / (math.cos(angle) + ior * math.cos(inside))) ** 2
    along = ((math.cos(inside) - ior * math.cos(angle)) / (math.cos(inside) + ior * math.cos(angle))) ** 2
    passed = 1.0 - 0.5 * (across + along)
    expected = np.array((0.5, 0.4, 0.3)) * 3.0 * math.cos(angle) * passed / ior**2 / math.pi
    np.testing.assert_allclose(_mean(floor), expected, rtol=0.02)


def _glass_and_gloss() -> None:
    """Glass, rough glass and rough metal on a glossy floor under lamps large enough for paths to find them."""
    import bpy

    studio.resolution(48, 36)
    _bounces(bpy.context.scene, 6)
    plain = studio.material("plain", lambda nodes: nodes("BsdfPrincipled", Base_Color=(0.6, 0.5, 0.4)))
    clear = studio.material("clear", lambda nodes: nodes("BsdfGlass", Color=(0.9, 1.0, 0.9), Roughness=0.0, IOR=1.5))
    rough = studio.material(
        "rough",
        lambda nodes: nodes("BsdfPrincipled", {"distribution": "GGX"}, Transmission_Weight=1.0, Roughness=0.3, IOR=1.5),
    )
    metal = studio.material(
        "metal", lambda nodes: nodes("BsdfPrincipled", Base_Color=(0.9, 0.6, 0.3), Metallic=1.0, Roughness=0.2)
    )
    studio.add_object("Floor", studio.quad("Floor", plain, 6.0, 6.0))
    for item, x in ((clear, -1.1), (rough, 0.0), (metal, 1.1)):
        studio.add_object("Ball", studio.sphere("Ball", item, 0.45, 96, 48), (x, 0.5, 0.46))
    studio.light("AREA", 60.0, (-1.0, 1.8, 2.2), (0.0, 0.0, 0.0), shape="RECTANGLE", size=1.2, size_y=0.8)
    studio.light("POINT", 60.0, (1.5, 1.0, 2.0), shadow_soft_size=0.5)
    # It glows on both sides.
    glow = studio.quad("Glow", studio.emitter((1.0, 0.6, 0.3), 3.0), 1.0, 0.6)
    studio.add_object("Glow", glow, (0.3, -1.6, 1.0), (70.0, 20.0, 0.0))
    studio.world((0.5, 0.7, 1.0), 0.1)
    studio.camera((0.0, -3.4, 2.6), (0.0, -0.1, 0.0), 38.0)


@compiled
@pytest.mark.estimator
def test_photons_show_what_paths_show(blender: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SCENES, "test-photons", BuiltinScene("test-photons", _glass_and_gloss))
    source = SceneSource("builtin:test-photons")
    renders, failures = render_scene(source, [find_rival("OFF")], Budget(256), 4, out=tmp_path, say=lambda _: None)
    assert not failures
    # It is the open scene still.
    tracer = LightTracer(blender.context.scene, 2)
    assert 0.4 < tracer.known.mean() < 0.95
    photons = [tracer.picture(1_000_000, seed) for seed in range(1, 5)]
    known = tracer.known[..., None]
    ours = [np.where(known, image[..., :3], 0.0) for image in photons]
    paths = [np.where(known, image[..., :3], 0.0) for image in image_stack(renders["OFF"])]
    difference, error = metrics.compare_means(ours, paths)
    assert (error < 0.004).all()
    assert (np.abs(difference) < 0.003 + 4.0 * error).all(), (difference, error)
    cells = metrics.compare_cells(ours, paths, 6, 6)
    assert not cells.exceeds(0.01, 4.5).any(), cells.difference


@compiled
def test_a_reference_is_known_where_no_glass_is_seen(blender: Any, tmp_path: Path) -> None:
    source = SceneSource("builtin:caustic-ball-matte")
    facts = make_reference(source, 20_000, 2, out=tmp_path, pixels=300, threads=1)
    reference = load_reference(tmp_path, source.name)
    assert reference is not None and reference.facts == facts
    known = metrics.known_pixels(reference.image)
    assert 0.5 < facts.known < 0.95 and known.mean() == pytest.approx(facts.known)
    # The ball is above the middle, the table all around.
    height, width = known.shape
    assert not known[round(0.32 * height), round(0.41 * width)] and known[0].all() and known[-1].all()
    assert 0.0 < facts.error < 1.0 and facts.samples == round(20_000 / known.size)
    assert not reference.problem(source.content_hash(), facts.light_paths)
    # What is not known counts in no figure.
    image = np.where(known[..., None], reference.image, 7.0)
    assert metrics.relative_squared_error(image, reference.image).whole == 0.0
    assert metrics.flip(image, reference.image) == pytest.approx(0.0, abs=1e-6)


def _varying_glow() -> None:
    glow = studio.material("glow", lambda nodes: nodes("Emission", Color=nodes("TexChecker")))
    studio.add_object("Glow", studio.quad("Glow", glow), (0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda: studio.light("SPOT", 10.0, (0, 0, 2)), "the lamp 'Spot' is a spot"),
        (lambda: setattr(studio.light("POINT", 10.0, (0, 0, 2)), "visible_glossy", False), "is hidden from some rays"),
        (lambda: None, "nothing emits light: add a lamp"),
        (_varying_glow, "a mesh's emission varies"),
    ],
)
def test_what_photons_are_not_traced_for_is_named(floor: Any, change: Any, message: str) -> None:
    change()
    with pytest.raises(ValueError, match=message):
        LightTracer(floor, 1)


def test_settings_that_change_what_paths_converge_to_are_refused(floor: Any) -> None:
    studio.light("POINT", 10.0, (0.0, 0.0, 2.0))
    floor.cycles.sample_clamp_indirect = 10.0
    with pytest.raises(ValueError, match="clamps to 0"):
        LightTracer(floor, 1)
    floor.cycles.sample_clamp_indirect, floor.cycles.caustics_refractive = 0.0, False
    with pytest.raises(ValueError, match="caustics on"):
        LightTracer(floor, 1)
    floor.cycles.caustics_refractive, floor.camera.data.type = True, "ORTHO"
    with pytest.raises(ValueError, match="no perspective"):
        LightTracer(floor, 1)


@pytest.mark.parametrize("name", ["BOX", "GAUSSIAN", "BLACKMAN_HARRIS"])
def test_the_filter_s_density_is_that_of_its_samples(name: str) -> None:
    table = filter_table(name, 1.5)
    density, radius = filter_density(table)
    step = 2.0 * radius / len(density)
    assert density.sum() * step == pytest.approx(1.0, abs=1e-3)
    offsets = -radius + (np.arange(len(density)) + 0.5) * step
    samples = np.interp((np.arange(4096) + 0.5) / 4096, np.linspace(0.0, 1.0, len(table)), table)
    assert (density * offsets**2).sum() * step == pytest.approx(float((samples**2).mean()), rel=0.01)


def test_a_scene_that_is_not_there_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["builtin:nowhere"]) == 2
    assert "no scene builtin:nowhere" in capsys.readouterr().err
