# SPDX-License-Identifier: GPL-3.0-or-later
"""Sessions denoise the picture of a render that went to its end, and keep the one that was sampled."""

import numpy as np
import pytest

from engine.denoise import library
from engine.denoise.filter import denoise, denoise_all
from engine.denoise.fireflies import without_fireflies
from engine.denoise.mix import added_noise, mixed
from engine.render import denoising
from engine.render.session import Session
from engine.scene.description import World
from engine.settings import RenderSettings
from tests.helpers.small_scenes import corner_scene, floor_scene, material, sun

needs_library = pytest.mark.skipif(bool(library.problem()), reason="no Open Image Denoise here")

PASSES = ("Combined", "Noisy Image", "Denoising Albedo", "Denoising Normal", "Denoising Depth")


def render(description, passes=PASSES, should_cancel=None, **settings):
    session = Session(RenderSettings(**{"samples": 4, "threads": 1, "use_denoising": True, **settings}))
    session.load(description)
    result = session.render(passes=passes, should_cancel=should_cancel)
    session.close()
    return result


@needs_library
@pytest.mark.parametrize(
    ("inputs", "names"), [("RGB", ()), ("RGB_ALBEDO", PASSES[2:3]), ("RGB_ALBEDO_NORMAL", PASSES[2:4])]
)
def test_the_picture_is_denoised_by_the_passes_that_are_asked_for(inputs, names):
    result = render(corner_scene(), denoising_input_passes=inputs, denoising_quality="BALANCED")
    noisy, denoised = result.passes["Noisy Image"], result.passes["Combined"]
    expected = denoise(noisy, *(result.passes[name] for name in names), quality="BALANCED", threads=1)
    assert np.array_equal(denoised[..., :3], expected)
    assert np.array_equal(denoised[..., 3], noisy[..., 3])
    assert not np.array_equal(denoised[..., :3], noisy[..., :3])
    assert result.report.denoise_seconds > 0.0 and not result.report.notices
    plain = render(corner_scene(), passes=("Combined",), use_denoising=False)
    assert np.array_equal(plain.passes["Combined"], noisy)
    assert plain.report.denoise_seconds == 0.0


@needs_library
@pytest.mark.parametrize(("samples", "share"), [(7, 1.0), (8, 0.5)])
def test_from_eight_samples_on_fireflies_are_cut_before(samples, share, monkeypatch):
    half = np.float32(0.5)
    monkeypatch.setattr(denoising, "without_fireflies", lambda color, variance, albedo: half * color[..., :3])
    passes = render(corner_scene(), PASSES, samples=samples).passes
    albedo, normal = passes["Denoising Albedo"], passes["Denoising Normal"]
    expected = denoise(np.float32(share) * passes["Noisy Image"][..., :3], albedo, normal, threads=1)
    assert np.array_equal(passes["Combined"][..., :3], expected)


@needs_library
@pytest.mark.parametrize(("samples", "is_mixed"), [(127, False), (128, True)])
def test_from_128_samples_on_it_is_mixed_with_what_was_sampled(samples, is_mixed):
    passes = render(corner_scene(), (*PASSES, "Variance"), samples=samples).passes
    albedo, normal, variance = (passes[name] for name in ("Denoising Albedo", "Denoising Normal", "Variance"))
    noisy = passes["Noisy Image"]
    cut = without_fireflies(noisy, variance, albedo)
    added = added_noise(cut, variance)
    denoised, again = denoise_all((cut, cut + added), albedo, normal, threads=1)
    mix = mixed(denoised, noisy, variance, added, again)
    assert not np.array_equal(mix, denoised)
    assert np.array_equal(passes["Combined"][..., :3], mix if is_mixed else denoised)


@needs_library
def test_the_mix_does_not_depend_on_threads(monkeypatch):
    monkeypatch.setattr(denoising, "LEAST_MIXED", 8)
    first, second = (render(corner_scene(), samples=16, threads=threads).passes["Combined"] for threads in (1, 3))
    assert np.array_equal(first, second)


@needs_library
def test_shadows_that_are_caught_are_not_mixed_in(monkeypatch):
    """The variance knows nothing of their noise."""
    monkeypatch.setattr(denoising, "LEAST_MIXED", 8)
    asked = []
    monkeypatch.setattr(denoising, "mixed", lambda denoised, *_: asked.append(1) or denoised)
    description = floor_scene(lights=[sun()])
    render(description, samples=16)
    assert asked
    asked.clear()
    description.instances.is_shadow_catcher = np.array([True])
    render(description, samples=16)
    assert not asked


@needs_library
def test_only_what_was_asked_for_comes_back():
    assert set(render(corner_scene(), passes=("Combined", "Depth")).passes) == {"Combined", "Depth"}


@needs_library
@pytest.mark.parametrize("settings", [
    {"radiance_cache": "CONVERGING", "samples": 16}, {"guiding_method": "VMM", "samples": 16},
    pytest.param({"spectral": "ON"}, marks=pytest.mark.slow),  # compiles stages for wavelengths
])  # fmt: skip
def test_every_kind_of_render_can_be_denoised(settings):
    result = render(corner_scene(), **settings)
    noisy, denoised = (result.passes[name][..., :3] for name in ("Noisy Image", "Combined"))
    assert np.isfinite(denoised).all()
    assert denoised.mean() == pytest.approx(noisy.mean(), rel=0.1)
    assert not np.array_equal(noisy, denoised)


def test_a_render_that_was_cancelled_is_as_it_was_sampled():
    result = render(corner_scene(), should_cancel=lambda: True, samples=1 << 20)
    assert result.report.cancelled and result.report.denoise_seconds == 0.0
    assert np.array_equal(result.passes["Combined"], result.passes["Noisy Image"])


@needs_library
def test_a_cancel_while_denoising_ends_it():
    """The render of one sample is over before anybody looks; from then on all ask to stop."""
    session = Session(RenderSettings(samples=1, threads=1, use_denoising=True))
    session.load(floor_scene(lights=[sun()], size=(900, 600)))
    messages = []
    result = session.render(
        passes=("Combined", "Noisy Image"), on_progress=lambda progress: messages.append(progress.message),
        should_cancel=lambda: "Denoising" in messages,
    )
    session.close()
    assert "Denoising" in messages and result.report.cancelled
    assert np.array_equal(result.passes["Combined"], result.passes["Noisy Image"])


def test_without_the_library_a_notice_says_so(monkeypatch):
    monkeypatch.setattr(library, "problem", lambda: "Open Image Denoise was not found")
    result = render(corner_scene())
    (notice,) = result.report.notices
    assert notice.problem == "Open Image Denoise was not found" and "as it was sampled" in notice.fallback
    assert np.array_equal(result.passes["Combined"], result.passes["Noisy Image"])


def test_a_floor_shows_its_albedo_its_normal_and_how_far_it_is():
    """Ten metres below a camera that looks down: along its axis, against it; rays begin 0.1 m before the camera."""
    passes = render(floor_scene(lights=[sun()]), use_denoising=False, samples=1).passes
    assert np.allclose(passes["Denoising Albedo"], 0.5, atol=1e-6)
    assert np.allclose(passes["Denoising Normal"], (0.0, 0.0, -1.0), atol=1e-6)
    depth = passes["Denoising Depth"][..., 0]
    assert depth.min() == pytest.approx(9.9, abs=0.01) and depth.max() < 13.0


def test_the_background_counts_as_albedo_and_has_no_normal():
    """The floor is out of sight, the world is seen."""
    away = np.eye(4, dtype=np.float32)
    away[2, 3] = 100.0
    world = World("world", "World", None, color=(0.25, 0.5, 2.0))
    passes = render(floor_scene(transforms=[away], world=world), use_denoising=False, samples=1).passes
    assert np.allclose(passes["Denoising Albedo"], (0.25, 0.5, 2.0), rtol=1e-5)
    assert not passes["Denoising Normal"].any() and not passes["Denoising Depth"].any()


@pytest.mark.parametrize(("roughness", "is_passed_on"), [(0.0, True), (0.2, True), (0.35, False)])
def test_mirrors_show_what_is_seen_in_them(roughness, is_passed_on):
    """A tinted mirror below a white ceiling: alpha 0.04 is specular, alpha 0.12 is not, where 0.075 is the limit."""
    ceiling = np.diag([1.0, -1.0, -1.0, 1.0]).astype(np.float32)
    ceiling[2, 3] = 20.0
    mirror = material("Mirror", (0.5, 0.25, 0.125), "ShaderNodeBsdfGlossy")
    mirror.graph.nodes[0].inputs["Roughness"] = roughness
    white = material("White", (0.8, 0.8, 0.8))
    description = floor_scene(lights=[sun()], transforms=[np.eye(4), ceiling], materials=[mirror, white])
    description.instances.material_offset = np.array([0, 1], np.int32)
    description.instances.materials = np.array([0, 1], np.int32)
    passes = render(description, use_denoising=False, samples=16).passes
    tint = np.array([0.5, 0.25, 0.125])
    normal = passes["Denoising Normal"].mean((0, 1))
    if is_passed_on:
        assert np.allclose(passes["Denoising Albedo"].mean((0, 1)), 0.8 * tint, rtol=0.03)
        assert normal == pytest.approx((0.0, 0.0, 1.0), abs=0.02)
        assert passes["Denoising Depth"].mean() > 10.0 + 0.3 * 20.0 * tint.mean()
    else:
        assert np.allclose(passes["Denoising Albedo"].mean((0, 1)), tint, rtol=0.03)
        assert normal == pytest.approx((0.0, 0.0, -1.0), abs=0.02)
