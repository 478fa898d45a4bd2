# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders with wavelengths: greys are exact, colours stay, and dispersion is what many renders in grey say it is.

What is unbiased is compared with a mean over seeds by its standard error: at most 4.5 of them, which a normal
distribution exceeds once in 147,000, in any of at most 100 numbers. Seeds are fixed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.kernels.shader.color_math import blackbody, luminance
from engine.render.session import Session
from engine.scene.description import (
    Light,
    Link,
    Material,
    Node,
    NodeGraph,
    SceneDescription,
    World,
)
from engine.settings import RenderSettings
from engine.spectral.observer import GRID, XYZ_TO_REC709, spectrum_to_rec709
from tests.helpers.some_cases import every
from tests.helpers.spectral_harness import blackbodies, iors, spectra, wavelengths_and_weights
from tests.helpers.spectral_scenes import DISPERSION, IOR, diffuse, glass, material, scene, square, wedge
from tests.helpers.untrained_networks import guess

#: Kernels of wavelengths are kernels of their own, which take half a minute to compile.
pytestmark = pytest.mark.slow

LIMIT = 4.5


def prism(ior: float, roughness: float, dispersion: float, kind: str = "Glass") -> SceneDescription:
    """A bright square seen through a wedge: where its edges are depends on the refractive index."""
    lamp = material("Emission", Color=(1.0, 1.0, 1.0, 1.0), Strength=1.0)
    return scene([(wedge(), glass(ior, roughness, dispersion, kind)), (square(1.0, 0.5), lamp)])


def render(description: SceneDescription, **settings: Any) -> np.ndarray:
    """Combined, float64 (pixels, 3)."""
    session = Session(RenderSettings(**{"samples": 16, "threads": 1, "pixel_filter": "BOX", **settings}))
    session.load(description)
    result = session.render()
    session.close()
    assert result.report.reject_count == 0
    return result.passes["Combined"][..., :3].reshape(-1, 3).astype(np.float64)


def mean_and_error(description: SceneDescription, seeds: range, **settings: Any) -> tuple[np.ndarray, np.ndarray]:
    images = np.stack([render(description, seed=seed, **settings) for seed in seeds])
    return images.mean(axis=0), images.std(axis=0, ddof=1) / np.sqrt(len(seeds))


def grey_renders(roughness: float, kind: str, count: int, **settings: Any) -> tuple[np.ndarray, np.ndarray]:
    """What wavelengths should give: renders without, each with the refractive index of one, as the film weighs it."""
    total = np.zeros((12, 3))
    squares = np.zeros((12, 3))
    wavelengths, *weights = wavelengths_and_weights((np.arange(count) + 0.5) / count).T
    for k, ior in enumerate(iors(IOR, DISPERSION, wavelengths)):
        seeds = range(100 + 4 * k, 104 + 4 * k)
        value, error = mean_and_error(prism(float(ior), roughness, 0.0, kind), seeds, **settings)
        weight = np.stack(weights)[:, k]
        total += value * weight / count
        squares += (error * weight / count) ** 2
    return total, np.sqrt(squares)


@pytest.mark.parametrize("method", ["OFF", "VMM"])
def test_grey_light_on_grey_things_is_grey(method: str) -> None:
    lamp = material("Emission", Color=(1.0, 1.0, 1.0, 1.0), Strength=3.0)
    parts = [(square(1.0, 4.0, 3.0), lamp), (square(50.0, 0.0), diffuse((0.5, 0.5, 0.5)))]
    description = scene(parts, world=World("w", "World", None, (0.2, 0.2, 0.2)))
    plain, plain_error = mean_and_error(description, range(8), samples=256, guiding_method=method, spectral="OFF")
    image, error = mean_and_error(description, range(8), samples=256, guiding_method=method, spectral="ON")
    assert np.abs(image - plain).max() > 0.0, "there are wavelengths"
    assert (np.abs(image - plain) < LIMIT * np.hypot(error, plain_error) + 1e-6).all()
    assert (error / image).max() < 0.02


def test_light_straight_from_a_lamp_is_what_it_was() -> None:
    """Nothing but the wavelengths is random here, and stratified samples settle them quickly."""
    for color in ((1.0, 1.0, 1.0), (0.2, 0.5, 0.8), (3.0, 2.0, 0.5)):
        lamp = material("Emission", Color=(*color, 1.0), Strength=2.0)
        image = render(scene([(square(50.0, 0.0), lamp)], size=(4, 1)), samples=4096, spectral="ON")
        np.testing.assert_allclose(image, np.broadcast_to(2.0 * np.array(color), image.shape), rtol=5e-3, atol=5e-3)


SURFACE, FILTER, LIGHT = (0.3, 0.6, 0.4), (0.9, 0.6, 0.4), (1.0, 0.6, 0.3)


def spectrum(color: tuple[float, float, float]) -> np.ndarray:
    return spectra([color], GRID)[0].astype(np.float64)


def lit_by(kind: str) -> SceneDescription:
    """A coloured floor under a filter that hides part of one coloured source of light."""
    above = np.eye(4, dtype=np.float32)
    above[:3, 3] = 5.0, 0.0, 7.0
    lights: tuple[Light, ...] = ()
    parts = [(square(50.0, 3.0), material("Transparent", Color=(*FILTER, 1.0))), (square(50.0, 0.0), diffuse(SURFACE))]
    world = None
    if kind == "point":
        lights = (Light("point", "Point", "POINT", above, LIGHT, 300.0, radius=1.5),)
    elif kind == "sun":
        lights = (Light("sun", "Sun", "SUN", np.eye(4, dtype=np.float32), LIGHT, 1.0, angle=0.2),)
    elif kind == "world":
        world = World("w", "World", None, LIGHT)
    else:
        parts.append((square(4.0, 7.0, 7.0), material("Emission", Color=(*LIGHT, 1.0), Strength=9.0)))
    return scene(parts, lights=lights, world=world)


# A sun is too small to be found by chance.
@pytest.mark.parametrize(
    ("kind", "use_nee"),
    [("sun", True), *((kind, use_nee) for kind in ("point", "world", "mesh") for use_nee in (True, False))],
)
def test_colours_multiply_by_wavelength(kind: str, use_nee: bool) -> None:
    """Source, filter (twice: the camera is above it) and surface, however the source is found, as integrated here."""
    settings: dict[str, Any] = {"samples": 1024 if use_nee else 4096, "max_bounces": 0, "use_nee": use_nee}
    plain, plain_error = mean_and_error(lit_by(kind), range(8), spectral="OFF", **settings)
    image, error = mean_and_error(lit_by(kind), range(8), spectral="ON", **settings)
    by_channel = np.array(LIGHT) * np.array(SURFACE) * np.array(FILTER) ** 2
    # What emits has the spectrum of a colour half as bright, whatever its brightness.
    light = 2.0 * spectrum(tuple(0.5 * np.array(LIGHT)))
    ratio = spectrum_to_rec709(light * spectrum(SURFACE) * spectrum(FILTER) ** 2) / by_channel
    assert np.abs(ratio - 1.0).max() > 0.05, "wavelengths make a difference"
    allowed = LIMIT * np.hypot(error, ratio * plain_error) + 0.003 * plain
    assert (np.abs(image - ratio * plain) < allowed).all(), (image / plain, ratio)
    assert np.median(allowed / plain) < 0.1, "too noisy to tell"


@pytest.mark.parametrize(
    ("roughness", "kind", "method"),
    every(
        [
            (0.4, "Glass", "VMM_RIS"),
            (0.4, "Glass", "OFF"),
            (0.0, "Refraction", "OFF"),
            (0.4, "Glass", "VMM"),
            (0.0, "Glass", "OFF"),
            (0.4, "Refraction", "OFF"),
        ],
        2,
    ),
)
def test_dispersion_is_a_refractive_index_for_every_wavelength(roughness: float, kind: str, method: str) -> None:
    """By hero wavelengths in one render, and by many renders of one refractive index each."""
    expected, expected_error = grey_renders(roughness, kind, 64, samples=1024)
    guiding: dict[str, Any] = {"guiding_method": method, "guiding_trial": False, "learn_guiding_probability": False}
    if method == "VMM_RIS":
        guiding |= {"candidate_allocation": "FIXED", "candidate_count": 3}
    image, error = mean_and_error(
        prism(IOR, roughness, DISPERSION, kind), range(12), samples=4096, spectral="AUTO", **guiding
    )
    difference = np.abs(image - expected)
    allowed = LIMIT * np.hypot(error, expected_error) + 0.004
    assert (difference < allowed).all(), (difference / allowed).max(axis=1)
    # It can be seen at all: the colours of an edge are apart by far more than what is allowed.
    spread = expected.max(axis=1) - expected.min(axis=1)
    assert (spread / allowed.max(axis=1)).max() > 3.0


def test_a_network_that_weighs_by_the_wavelength_is_unbiased(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever it says of each wavelength: its parameters are drawn at random."""
    description = prism(IOR, 0.4, DISPERSION)
    expected, expected_error = mean_and_error(description, range(8), samples=2048)
    seen = guess(monkeypatch)
    image, error = mean_and_error(
        description, range(20, 28), samples=2047, guiding_method="NEURAL_RIS", network_u="PLANES", guiding_trial=False,
        candidate_allocation="FIXED", candidate_count=3,
    )
    assert (np.abs(image - expected) < LIMIT * np.hypot(error, expected_error) + 0.004).all()
    assert [(settings.network_u, settings.u_dimension) for settings in seen] == [("PLANES", "WAVELENGTH")] * 8
    # The test can see a bias of a few per cent.
    bright = expected.mean(axis=1) > 0.3
    assert np.median((LIMIT * np.hypot(error, expected_error) + 0.004)[bright] / expected[bright]) < 0.1


@pytest.mark.parametrize(
    "color", [(0.5, 0.45, 0.4), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.02, 1.0), (0.0, 1e6, 0.0)]
)
def test_other_working_spaces_keep_their_colours(color: tuple[float, float, float]) -> None:
    """A lamp's colour in Rec.2020: what comes out is what went in, where it is not more saturated than Rec.709.

    Then it is the colour whose channels in Rec.709 are not below 0 (docs/differences.md), as near as smooth spectra
    come to the very edge of Rec.709: within 1.5% of its brightest channel.
    """
    to_xyz = np.array([(0.636958, 0.144617, 0.168881), (0.2627, 0.677998, 0.059302), (0.0, 0.028073, 1.060985)])
    to_rec709 = XYZ_TO_REC709 @ to_xyz
    expected = np.linalg.inv(to_rec709) @ np.maximum(to_rec709 @ np.array(color), 0.0)
    assert np.allclose(expected, color, rtol=1e-3) == (color[0] == 0.5)
    description = scene([(square(50.0, 0.0), material("Emission", Color=(*color, 1.0), Strength=1.0))], size=(4, 1))
    description.to_xyz = to_xyz.astype(np.float32)
    image = render(description, samples=4096, spectral="ON") / max(color)
    allowed = 0.0 if color[0] == 0.5 else 0.015
    np.testing.assert_allclose(image, np.broadcast_to(expected / max(color), image.shape), rtol=5e-3, atol=allowed)


@pytest.mark.parametrize("source", ["mesh", "mesh by nodes", "world", "seen", "lamp", "lamp by nodes", "sun"])
def test_black_bodies_are_plancks(source: str) -> None:
    """A warm light on a bluish floor, which has other colours by Planck's law than by a smooth spectrum."""
    temperature, surface = 1800.0, (0.3, 0.4, 0.9)
    nodes = [
        Node("ShaderNodeBlackbody", "Blackbody", {"Temperature": temperature}),
        Node("ShaderNodeEmission", "Emission", {"Color": Link(0, "Color"), "Strength": 4.0}),
    ]
    if source == "mesh by nodes":
        # What is seen from the floor: the strength is not a constant.
        nodes.append(Node("ShaderNodeLightPath", "Light Path"))
        nodes.append(
            Node("ShaderNodeMath", "Math", {"Value": Link(2, "Is Camera Ray"), "Value_001": 4.0}, {"operation": "ADD"})
        )
        nodes[1].inputs["Strength"] = Link(3, "Value")
    glow = NodeGraph(nodes, Link(1, "Emission"))
    world = None
    parts = [(square(50.0, 0.0), diffuse(surface))]
    if source == "seen":
        parts, surface = [(square(50.0, 0.0), Material("Glow", "Glow", glow))], (1.0, 1.0, 1.0)
    elif source == "world":
        nodes[1].kind, glow.surface = "ShaderNodeBackground", Link(1, "Background")
        world = World("w", "World", glow)
    lights: tuple[Light, ...] = ()
    beside = np.eye(4, dtype=np.float32)
    beside[:3, 3] = (6.0, 0.0, 6.0)
    color = blackbody(np.float32(temperature))
    if source == "lamp by nodes":
        lights = (Light("l", "Lamp", "POINT", beside, (1.0, 1.0, 1.0), 500.0, radius=1.0, graph=glow),)
    elif source == "lamp":
        lights = (Light("l", "Lamp", "POINT", beside, color, 500.0, radius=1.0, temperature=temperature),)
    elif source == "sun":
        lights = (Light("l", "Sun", "SUN", np.eye(4, dtype=np.float32), color, 2.0, temperature=temperature),)
    elif source.startswith("mesh"):
        parts.append((square(4.0, 7.0, 7.0), Material("Glow", "Glow", glow)))
    description = scene(parts, world=world, lights=lights, size=(6, 1))
    settings: dict[str, Any] = {"samples": 2048, "max_bounces": 0}
    plain, plain_error = mean_and_error(description, range(8), spectral="OFF", **settings)
    image, error = mean_and_error(description, range(8), spectral="ON", **settings)
    planck = blackbodies([temperature], GRID)[0]
    # By how much light there is, which green tells.
    light = plain[:, 1:2] / (color[1] * surface[1]) * luminance(color)
    expected = light * spectrum_to_rec709(planck * spectrum(surface))
    noise = np.abs(expected) * plain_error[:, 1:2] / plain[:, 1:2]
    allowed = LIMIT * np.hypot(error, noise) + 0.004 * np.abs(expected).max()
    assert (np.abs(image - expected) < allowed).all(), (image, expected)
    smooth = light * spectrum_to_rec709(2.0 * spectrum(tuple(0.5 * np.array(color))) * spectrum(surface))
    assert (np.abs(smooth - expected) > 1.5 * allowed).any(), "that is another colour"


def test_light_that_is_no_number_is_counted() -> None:
    """As without wavelengths: no colour is made up for it."""
    lamp = material("Emission", Color=(1.0, 1.0, 1.0, 1.0), Strength=float("nan"))
    parts = [(square(50.0, 0.0), lamp)]
    counts = {}
    for spectral in ("OFF", "ON"):
        session = Session(RenderSettings(samples=4, threads=1, spectral=spectral))
        session.load(scene(parts))
        result = session.render()
        session.close()
        counts[spectral] = result.report.reject_count
        assert np.isfinite(result.passes["Combined"]).all()
    assert counts["ON"] == counts["OFF"]
