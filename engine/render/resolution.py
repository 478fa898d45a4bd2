# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a render's settings counts in a scene, and what a user should know of the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from engine.accuracy import LEAST_CACHED_SAMPLES
from engine.builder.scene import Scene
from engine.denoise import library
from engine.guiding.policy.request import LearningRequest
from engine.guiding.sources.sequence import with_sequence_u
from engine.render.film import DENOISING_PASSES, Film, film_layout
from engine.render.light_passes import asks_for_groups
from engine.render.request import RenderRequest
from engine.render.scene_header import has_photons
from engine.render.strata import are_learned, strata_count
from engine.scene.description import Frame, Notice, SceneDescription
from engine.settings import RenderSettings
from engine.state.film import FilmLayout
from engine.state.lanes import RGB


@dataclass(frozen=True)
class Resolution:
    """What a render goes by.

    request : RenderRequest
    notices : tuple of Notice, what was asked for and is not done
    cache_left_out : str, why an automatic radiance cache is not tried, '' where it is or nobody asked
    """

    request: RenderRequest
    notices: tuple[Notice, ...] = ()
    cache_left_out: str = ""


def is_spectral(settings: RenderSettings, description: SceneDescription) -> bool:
    """Whether paths have wavelengths."""
    return settings.spectral == "ON" or (settings.spectral == "AUTO" and description.has_dispersion)


def resolve(
    settings: RenderSettings,
    scene: Scene,
    passes: frozenset[str],
    learning: LearningRequest,
    light_digest: Callable[[], str],
    first_samples: int | None = None,
    *,
    on_cluster: bool = False,
) -> Resolution:
    """Say what counts of what is asked for, and why the rest does not.

    Parameters
    ----------
    settings : RenderSettings
        As the user has them.
    scene : Scene
    passes : frozenset of str
        That the result is to have, and that it is denoised by.
    learning : LearningRequest
    light_digest : callable
        Gives the digest of all that light depends on in the scene, which takes a while.
    first_samples : int, optional
        Where to stop, before the number of the settings.
    on_cluster : bool
        Whether other machines trace.
    """
    notices: list[Notice] = []
    asked_strata = settings.strata
    if on_cluster:
        # Seconds of different machines do not compare: costs are counted in rays, and networks are trained between
        # iterations.
        settings = replace(settings, deterministic=True, network_backend="KERNEL")
    settings = replace(settings, spectral="ON" if is_spectral(settings, scene.description) else "OFF")
    settings = _with_u(settings, scene.description, learning)
    if scene.description.fast_gi.bounces > 0:
        settings = _with_short_rays(settings, notices)
    cache_left_out = _why_no_automatic_cache(settings, passes)
    if settings.radiance_cache != "OFF" and (notice := _cache_notice(settings, scene, passes)):
        if settings.radiance_cache == "AUTO":
            # Nobody has asked for it: the report says so, and no warning.
            cache_left_out = f"it {notice.problem}"
        else:
            notices.append(notice)
            settings = replace(settings, radiance_cache="OFF")
    if cache_left_out:
        settings = replace(settings, radiance_cache="OFF")
    if settings.traces_photons and (problem := _why_no_photons(settings, scene)):
        if len(scene.casters.area) and settings.caustics != "AUTO":
            notices.append(Notice("Caustics by photons", problem, "paths alone find them"))
        settings = replace(settings, caustics="PATHS")
    if scene.media.is_used:
        # What it would learn is of surfaces: collisions with media are none.
        if settings.roulette == "LEARNED":
            notices.append(Notice("Roulette", "knows no media", "it goes by the throughput"))
        settings = replace(settings, roulette="THROUGHPUT")
    if learning.start is not None:
        start = learning.start if settings.is_guided else None
        if start is not None and start.light_digest != light_digest():
            start = None
            problem = "lights, materials or geometry are not those that it was learned with"
            notices.append(Notice("Learned field", problem, "the render learns anew"))
        if start is not None:
            settings = replace(settings, seed=start.seed(settings.seed))
        learning = replace(learning, start=start)
    settings = _with_denoiser(settings, notices)
    layout = _layout(settings, scene, passes)
    settings = replace(settings, strata=strata_count(settings, _film_bytes(scene.description.frame, layout)))
    if 2 * settings.strata <= asked_strata:
        notices.append(_lack_of_strata(settings, is_trained=learning.source is not None))
    request = RenderRequest(scene.description.frame, settings, layout, learning, first_samples)
    return Resolution(request, tuple(notices), cache_left_out)


def _why_no_photons(settings: RenderSettings, scene: Scene) -> str:
    """Why photons find nothing in a scene, or are not at home in it; '' where they do."""
    if not has_photons(scene, settings):
        return "have nothing to go over, or no lamp to come from"
    if not (settings.use_caustics_reflective or settings.use_caustics_refractive):
        return "are not asked for: caustics are off"
    if settings.caustics == "AUTO" and settings.filter_glossy > 0.0 and not scene.description.asks_for_caustics:
        return "would be sharp, and Filter Glossy asks for blurred ones"
    if scene.media.varies:
        return "know no media that vary"
    if scene.description.fast_gi.bounces > 0:
        return "know no Fast Global Illumination"
    return ""


def _layout(settings: RenderSettings, scene: Scene, passes: frozenset[str]) -> FilmLayout:
    return film_layout(
        passes, settings, scene.description.light_groups, scene.description.passes, has_catchers=scene.has_catchers,
        has_media=scene.media.is_used, has_varying_media=scene.media.varies,
    )


def _film_bytes(frame: Frame, layout: FilmLayout) -> int:
    """Memory of a film without strata."""
    x0, y0, x1, y1 = frame.region
    return Film(1, 1, layout).nbytes * (x1 - x0) * (y1 - y0)


def _with_u(settings: RenderSettings, description: SceneDescription, learning: LearningRequest) -> RenderSettings:
    """Settings in which `u_dimension` is what the scene has of it: without it the rest is learned sooner."""
    if learning.source is not None:
        return with_sequence_u(settings, learning.source.u_dimension)
    has_time = description.is_moving and settings.u_dimension in ("AUTO", "TIME")
    has_wavelength = (
        settings.spectral == "ON" and description.has_dispersion and settings.u_dimension in ("AUTO", "WAVELENGTH")
    )
    return settings.with_u("TIME" if has_time else "WAVELENGTH" if has_wavelength else "NONE")


def _lack_of_strata(settings: RenderSettings, *, is_trained: bool) -> Notice:
    """Why there are fewer strata than were asked for.

    Parameters
    ----------
    settings : RenderSettings
        With as many as there are.
    is_trained : bool
        Whether directions are drawn by what was learned before the frame.
    """
    problem = "there are too few samples for more, or their film would be too large"
    if is_trained:
        problem = "nothing is learned within a frame"
    elif not are_learned(settings):
        problem = "no neural mixture guides the render: choose one of NPM, NPM_PRODUCT, NASG"
    elif settings.u_dimension == "NONE":
        problem = "neither time nor wavelengths are there to divide"
    return Notice("Strata", problem, f"there are {settings.strata}" if settings.strata > 1 else "they are not used")


def _with_denoiser(settings: RenderSettings, notices: list[Notice]) -> RenderSettings:
    """Settings without a threshold on the denoised picture where there will be none."""
    if settings.denoised_threshold == 0.0 or _is_denoised(settings):
        return settings
    problem = "there is no denoiser" if settings.use_denoising else "nothing is denoised: Denoise is off"
    notices.append(Notice("Denoised Noise", problem, "it ends no render"))
    return replace(settings, denoised_threshold=0.0)


def _with_short_rays(settings: RenderSettings, notices: list[Notice]) -> RenderSettings:
    """Settings for scenes in which later rays are short (`engine.wavefront.short_rays`); what is not done is noted.

    As in Cycles light that lies beyond is lost by the share that scattering was to find of it. The picture depends on
    the densities of directions and light samples therefore, so nothing that is learned may change them.
    """
    problem = "knows no short rays (Fast GI Approximation)"
    if settings.guiding_method not in ("OFF", "AUTO"):
        notices.append(Notice("Guiding", problem, "paths follow what surfaces scatter"))
    if settings.light_selection == "LEARNED":
        notices.append(Notice("Learned visibility of lights", problem, "the light tree chooses"))
    return replace(settings, guiding_method="OFF", light_selection="TREE")


def _is_denoised(settings: RenderSettings) -> bool:
    """Whether the picture is to be denoised, and can be."""
    return settings.use_denoising and not library.problem()


def _why_no_automatic_cache(settings: RenderSettings, passes: frozenset[str]) -> str:
    """Why an automatic radiance cache would not pay, whatever the scene; '' where it may, or nobody asked.

    A denoiser leaves a fifth to a fortieth of the noise, but all of what cells get wrong in the large
    (docs/decisions/radiance-cache.md, "As a default"). Who asks for a denoiser's passes denoises elsewhere.
    """
    if settings.radiance_cache != "AUTO":
        return ""
    if settings.samples < LEAST_CACHED_SAMPLES:
        return "so few samples are over before it could pay"
    is_denoised = _is_denoised(settings) or passes & DENOISING_PASSES
    return "a denoiser takes noise away, but not what cells get wrong" if is_denoised else ""


def _cache_notice(settings: RenderSettings, scene: Scene, passes: frozenset[str]) -> Notice | None:
    """Why the radiance cache cannot be used, None where it can."""
    problem = "knows no light groups"
    if settings.channel_count > RGB:
        problem = "knows no wavelengths"
    elif scene.description.fast_gi.is_used:
        problem = "knows no Fast GI Approximation"
    # Paths that measure what the cache lacks know groups.
    elif settings.measures_cache or not asks_for_groups(passes, scene.description.light_groups):
        return None
    return Notice("Radiance cache", problem, "paths find all light themselves")
