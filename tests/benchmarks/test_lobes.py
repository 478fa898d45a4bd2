# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps of what was learned at a point: directions, truths, divergence, and that both show light where it is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import lobe_maps
from benchmarks.lobe_maps import (
    FLOOR,
    Comparison,
    cell_angles,
    cell_directions,
    compare,
    divergence,
    has_size,
    look,
    normalized,
    own_target,
    panorama,
    targets,
    trace_truth,
)
from benchmarks.lobes import main
from engine.render.session import Session
from engine.scene.description import VISIBLE_CAMERA, VISIBLE_DIFFUSE, Light, SceneDescription, World
from engine.settings import RenderSettings
from tests.helpers.small_scenes import floor_scene, material, sun
from tests.helpers.training import require_torch

ROWS = 32
SIZE = (32, 24)
CENTRE = (16, 12)
#: Where the lamp of `lamp_scene` is, seen from the middle of the floor.
LAMP = np.array((5.0, 2.0, 4.0))
STATISTICAL = ("VMM", "SDTREE", "SDTREE_VARIANCE")


def world(value: float = 1.0) -> World:
    return World("w", "World", None, (value, value, value))


def lamp_scene() -> SceneDescription:
    """A floor under a panel of two by two metres that glows, in a dim world."""
    panel = np.diag([0.02, 0.02, 1.0, 1.0])
    panel[:3, 3] = LAMP
    glow = material("Glow", (20.0, 20.0, 20.0), "ShaderNodeEmission")
    description = floor_scene(
        transforms=[np.eye(4), panel], materials=[material(), glow], world=world(0.05), size=SIZE
    )
    description.instances.material_offset = np.array([0, 1], np.int32)
    description.instances.materials = np.array([0, 1], np.int32)
    return description


def settings(**changes: object) -> RenderSettings:
    return RenderSettings(**({"samples": 31, "threads": 1, "use_nee": False, "max_bounces": 4} | changes))  # type: ignore[arg-type]


def surface_of(description: SceneDescription, pixel: tuple[int, int] = CENTRE) -> lobe_maps.Surface:
    session = Session(settings())
    session.load(description)
    assert session.scene is not None
    found, density = look(session.scene, settings(guiding_method="VMM"), None, pixel, ROWS)
    session.close()
    assert not density.any()
    return found


@pytest.fixture(scope="module")
def learned() -> Comparison:
    return compare(lamp_scene(), settings(), CENTRE, STATISTICAL, rows=ROWS, truth_samples=32)


def test_cells_cover_the_sphere_and_hold_their_directions() -> None:
    angles, directions = cell_angles(8), cell_directions(8)
    assert angles.sum() == pytest.approx(4.0 * np.pi)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, rtol=1e-6)
    grid = directions.reshape(8, 16, -1, 3)
    latitude = np.arcsin(grid[..., 2]) / np.pi + 0.5
    longitude = np.arctan2(grid[..., 0], grid[..., 1]) / (2.0 * np.pi) + 0.5
    assert (np.floor(latitude * 8) == np.arange(8)[:, None, None]).all()
    assert (np.floor(longitude * 16) == np.arange(16)[None, :, None]).all()
    # Equal weights give the integral: of z^2 over the sphere it is 4 pi / 3.
    assert ((grid[..., 2] ** 2).mean(axis=-1) * angles).sum() == pytest.approx(4.0 * np.pi / 3.0, rel=2e-3)


def test_divergence_is_zero_of_equals_and_known_of_a_hemisphere() -> None:
    rng = np.random.default_rng(3)
    truth = normalized(rng.random((16, 32)))
    assert divergence(truth, truth) == 0.0
    assert divergence(truth, normalized(rng.random((16, 32)))) > 0.01
    half, even = np.zeros((16, 32)), np.full((16, 32), 1.0 / (4.0 * np.pi))
    half[8:] = 1.0 / (2.0 * np.pi)
    expected = (1.0 - 0.5 * FLOOR) * np.log(2.0 - FLOOR) + 0.5 * FLOOR * np.log(FLOOR)
    assert divergence(half, even) == pytest.approx(expected)
    with pytest.raises(ValueError, match="no light"):
        normalized(np.zeros((16, 32)))


def test_the_truth_under_an_even_sky_is_even() -> None:
    description = floor_scene(world=world(0.7), size=SIZE)
    surface = surface_of(description)
    assert surface.is_diffuse
    np.testing.assert_allclose(surface.normal, (0.0, 0.0, 1.0), atol=1e-6)
    halves = trace_truth(description, surface, settings(), 4)
    above = np.arange(ROWS) >= ROWS // 2
    for radiance in halves:
        np.testing.assert_allclose(radiance[above], 0.7, rtol=1e-5)
    found = targets(halves[0], surface)
    np.testing.assert_allclose(normalized(found["RADIANCE"])[above], 1.0 / (2.0 * np.pi), rtol=1e-5)
    cosine = cell_directions(ROWS)[..., 2].mean(axis=-1).reshape(ROWS, 2 * ROWS)
    np.testing.assert_allclose(normalized(found["PRODUCT"])[above], cosine[above] / np.pi, rtol=2e-3)
    for density in found.values():
        assert not density[~above].any()


@pytest.mark.parametrize("pixel", [CENTRE, (3, 20)])
def test_truth_and_surface_are_where_the_pixel_is(pixel: tuple[int, int]) -> None:
    """The lamp's part of the sky against the solid angle of its cells, from wherever the pixel looks."""
    description = lamp_scene()
    surface = surface_of(description, pixel)
    radiance = sum(trace_truth(description, surface, settings(), 32))
    directions = cell_directions(ROWS, 1)[:, 0]
    meets = surface.position + directions * ((LAMP[2] - surface.position[2]) / np.maximum(directions[:, 2:], 1e-6))
    is_lamp = (np.abs(meets[:, :2] - LAMP[:2]) < 1.0).all(axis=1) & (directions[:, 2] > 0.0)
    bright = (radiance.mean(axis=-1) > 10.0).ravel()
    assert is_lamp.any() and (bright == is_lamp).mean() > 0.99
    assert (bright & is_lamp).sum() >= 0.6 * is_lamp.sum()


def test_what_was_learned_is_a_density_and_points_to_the_lamp(learned: Comparison) -> None:
    towards = cell_directions(ROWS, 1)[:, 0].reshape(ROWS, 2 * ROWS, 3) @ (LAMP / np.linalg.norm(LAMP))
    near = (towards > np.cos(np.radians(25.0))) * cell_angles(ROWS)
    share = (learned.truths["PRODUCT"] * near).sum()
    assert share > 0.5
    assert [found.method for found in learned.methods] == list(STATISTICAL)
    for found in learned.methods:
        assert found.integral == pytest.approx(1.0, abs=0.01)
        assert (found.density >= 0.0).all() and np.isfinite(found.density).all()
        # A cell of a tree holds much of the floor, from where the lamp is in other directions.
        assert (found.density * near).sum() > 5.0 * near.sum() / (4.0 * np.pi)
        # Better than the uniform density, and than its own mirror image.
        own = learned.truths[found.target]
        assert 0.0 <= found.divergence[found.target] < divergence(own, np.full_like(own, 0.25 / np.pi))
        assert found.divergence[found.target] < divergence(own, found.density[:, ::-1])
    assert max(learned.noise.values()) < 0.1


def test_methods_say_what_they_aim_at(learned: Comparison) -> None:
    surface = learned.surface
    expected = {
        "VMM": "PRODUCT", "SDTREE": "RADIANCE", "SDTREE_VARIANCE": "PRODUCT", "NPM": "RADIANCE",
        "NPM_PRODUCT": "PRODUCT", "NASG": "PRODUCT", "FLOW": "PRODUCT",
    }  # fmt: skip
    assert {name: own_target(settings(guiding_method=name), surface) for name in expected} == expected
    assert own_target(settings(guiding_method="NASG", mixture_target="RADIANCE"), surface) == "RADIANCE"


def test_pixels_without_a_guided_surface_are_refused() -> None:
    def look_at(description: SceneDescription, pixel: tuple[int, int]) -> None:
        surface_of(description, pixel)

    with pytest.raises(ValueError, match="32 x 24"):
        look_at(floor_scene(size=SIZE), (32, 0))
    with pytest.raises(ValueError, match="no surface"):
        look_at(floor_scene(transforms=[np.diag([1e-3, 1e-3, 1.0, 1.0])], size=SIZE), (0, 0))
    mirror = material("Mirror", (0.9, 0.9, 0.9), "ShaderNodeBsdfGlossy")
    with pytest.raises(ValueError, match="single directions"):
        look_at(floor_scene(materials=[mirror], size=SIZE), CENTRE)


def test_scattered_rays_see_what_the_camera_does_not() -> None:
    description = floor_scene(world=world(), lights=[sun()], size=SIZE)
    surface = surface_of(description)
    description.instances.visibility[:] = VISIBLE_DIFFUSE
    assert description.world is not None
    description.world.visibility = VISIBLE_CAMERA
    seen = panorama(description, surface, ROWS)
    assert seen.world is not None
    assert seen.instances.visibility[0] & VISIBLE_CAMERA and not seen.world.visibility & VISIBLE_CAMERA
    assert seen.lights[0].visibility == description.lights[0].visibility


def test_lights_without_size_are_named() -> None:
    point = Light("p", "Spark", "POINT", np.eye(4, dtype=np.float32), (1.0, 1.0, 1.0), 1.0)
    assert not has_size(point) and not has_size(sun())
    description = floor_scene(world=world(), lights=[sun()], size=SIZE)
    few = {"rows": 8, "truth_samples": 2}
    assert any("Sun" in notice for notice in compare(description, settings(), CENTRE, [], **few).notices)  # type: ignore[arg-type]
    assert not compare(description, settings(use_nee=True), CENTRE, [], **few).notices  # type: ignore[arg-type]


def test_the_command_writes_a_picture_and_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "maps" / "lobes.png"
    arguments = ["builtin:diffuse", "--size", "16", "12", "--samples", "7", "--rows", "16", "--truth-samples", "4"]
    arguments += ["--threads", "1", "--methods", "VMM", "SDTREE", "--output", str(picture)]
    assert main([*arguments, "--pixel", "8", "9"]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    record = json.loads(picture.with_suffix(".json").read_text(encoding="utf-8"))
    assert (record["width"], record["height"], record["pixel"]) == (16, 12, [8, 9])
    assert set(record["methods"]) == {"VMM", "SDTREE"}
    assert all(np.isfinite(found["divergence"]["PRODUCT"]) for found in record["methods"].values())
    assert "aims at" in capsys.readouterr().out
    assert main([*arguments, "--pixel", "99", "9"]) == 2
    assert "16 x 12" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("method", ["NPM", "NASG", "FLOW"])
def test_networks_point_to_the_lamp(method: str) -> None:
    require_torch()
    chosen = settings(deterministic=True, training_steps=32)
    found = compare(lamp_scene(), chosen, CENTRE, [method], rows=ROWS, truth_samples=8)
    network = found.methods[0]
    assert "snapshots" in network.status
    assert network.integral == pytest.approx(1.0, abs=0.02)
    own = found.truths[network.target]
    assert network.divergence[network.target] < divergence(own, np.full_like(own, 0.25 / np.pi))
