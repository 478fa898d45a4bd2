# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a render's settings counts in a scene, and what a user should know of the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from engine.builder.scene import Scene
from engine.guiding.policy.request import LearningRequest
from engine.guiding.sources.sequence import with_sequence_u
from engine.render.light_passes import group_pass
from engine.scene.description import Notice, SceneDescription
from engine.settings import RenderSettings
from engine.state.lanes import RGB


@dataclass(frozen=True)
class Resolution:
    """What a render goes by.

    settings : RenderSettings, with an answer wherever they leave one open, and without what the scene cannot have
    request : LearningRequest, without a learned field that does not fit
    notices : tuple of Notice, what was asked for and is not done
    """

    settings: RenderSettings
    request: LearningRequest
    notices: tuple[Notice, ...] = ()


def is_spectral(settings: RenderSettings, description: SceneDescription) -> bool:
    """Whether paths have wavelengths."""
    return settings.spectral == "ON" or (settings.spectral == "AUTO" and description.has_dispersion)


def resolve(
    settings: RenderSettings,
    scene: Scene,
    passes: frozenset[str],
    request: LearningRequest,
    light_digest: Callable[[], str],
) -> Resolution:
    """Say what counts of what is asked for, and why the rest does not.

    Parameters
    ----------
    settings : RenderSettings
        As the user has them.
    scene : Scene
    passes : frozenset of str
        That the result is to have.
    request : LearningRequest
    light_digest : callable
        Gives the digest of all that light depends on in the scene, which takes a while.
    """
    notices: list[Notice] = []
    settings = replace(settings, spectral="ON" if is_spectral(settings, scene.description) else "OFF")
    settings = _with_u(settings, scene.description, request)
    if settings.radiance_cache != "OFF" and (notice := _cache_notice(settings, scene, passes)):
        notices.append(notice)
        settings = replace(settings, radiance_cache="OFF")
    if scene.media.is_used:
        # What it would learn is of surfaces: collisions with media are none.
        if settings.roulette == "LEARNED":
            notices.append(Notice("Roulette", "knows no media", "it goes by the throughput"))
        settings = replace(settings, roulette="THROUGHPUT")
    if request.start is not None:
        start = request.start if settings.is_guided else None
        if start is not None and start.light_digest != light_digest():
            start = None
            problem = "lights, materials or geometry are not those that it was learned with"
            notices.append(Notice("Learned field", problem, "the render learns anew"))
        if start is not None:
            settings = replace(settings, seed=start.seed(settings.seed))
        request = replace(request, start=start)
    return Resolution(settings, request, tuple(notices))


def _with_u(settings: RenderSettings, description: SceneDescription, request: LearningRequest) -> RenderSettings:
    """Settings in which `u_dimension` is what the scene has of it: without it the rest is learned sooner."""
    if request.source is not None:
        return with_sequence_u(settings, request.source.u_dimension)
    has_time = description.is_moving and settings.u_dimension in ("AUTO", "TIME")
    has_wavelength = (
        settings.spectral == "ON" and description.has_dispersion and settings.u_dimension in ("AUTO", "WAVELENGTH")
    )
    return settings.with_u("TIME" if has_time else "WAVELENGTH" if has_wavelength else "NONE")


def _cache_notice(settings: RenderSettings, scene: Scene, passes: frozenset[str]) -> Notice | None:
    """Why the radiance cache cannot be used, None where it can."""
    problem = "knows no light groups, shadow catchers or media"
    groups = map(group_pass, scene.description.light_groups)
    if settings.channel_count > RGB:
        problem = "knows no wavelengths"
    # Nor what shadow catchers would have alone, nor what is within media.
    elif not (passes.intersection(groups) or scene.has_catchers or scene.media.is_used):
        return None
    return Notice("Radiance cache", problem, "paths find all light themselves")
