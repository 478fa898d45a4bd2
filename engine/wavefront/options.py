# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings as stages read them: a tuple of scalars, limits already in the integrator's own counting."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from engine.scene.fast_gi import FastGi
from engine.settings import RenderSettings


class IntegratorOptions(NamedTuple):
    """Depth limits count scatterings: a path ends at the surface after the `max_*`-th."""

    max_depth: int
    max_diffuse_depth: int
    max_glossy_depth: int
    max_transmission_depth: int
    max_volume_depth: int
    max_transparent_depth: int
    min_depth: int
    min_transparent_depth: int
    use_nee: int
    use_roulette: int
    film_transparent: int
    clamp_direct: np.float32
    clamp_indirect: np.float32
    #: Light samples that would add less than 1 / this are played roulette with; 0 = off.
    inverse_light_threshold: np.float32
    filter_glossy: np.float32
    #: Whether that blurs delta lobes too; photons go over these as they are.
    blurs_delta: int
    #: How far the Ambient Occlusion pass and short rays look [m].
    occlusion_distance: np.float32
    #: As `engine.scene.fast_gi.FastGi` has them.
    short_bounces: int
    short_background: np.float32
    added_light: np.float32


def make_options(
    settings: RenderSettings, exposure: float, occlusion_distance: float, fast_gi: FastGi
) -> IntegratorOptions:
    """Options from a user's settings; a limit of N bounces is N + 1 scatterings, as in Cycles."""
    threshold = settings.light_sampling_threshold
    return IntegratorOptions(
        max_depth=settings.max_bounces + 1,
        max_diffuse_depth=settings.diffuse_bounces + 1,
        max_glossy_depth=settings.glossy_bounces + 1,
        max_transmission_depth=settings.transmission_bounces + 1,
        max_volume_depth=settings.volume_bounces + 1,
        max_transparent_depth=settings.transparent_max_bounces,
        min_depth=settings.min_light_bounces + 1,
        min_transparent_depth=settings.min_transparent_bounces + 1,
        use_nee=int(settings.use_nee),
        use_roulette=int(settings.use_russian_roulette),
        film_transparent=int(settings.film_transparent),
        clamp_direct=np.float32(settings.clamp_direct),
        clamp_indirect=np.float32(settings.clamp_indirect),
        inverse_light_threshold=np.float32(exposure / threshold if threshold > 0.0 else 0.0),
        filter_glossy=np.float32(settings.filter_glossy),
        blurs_delta=int(not settings.traces_photons),
        occlusion_distance=np.float32(occlusion_distance),
        short_bounces=fast_gi.bounces,
        short_background=np.float32(fast_gi.background),
        added_light=np.float32(fast_gi.added),
    )


class GuidingOptions(NamedTuple):
    """How guided lanes are sampled; fixed during an iteration.

    `candidate_count` 0 leaves it to the allocation. Lanes whose rough lobes are all narrower than `min_alpha` are not
    guided. With `blends_mixture`
    the mixture has a share in predictions of colour. With `probes_only` allocation is for some vertices of recorded
    paths, by which it can be judged; all others take one candidate.
    """

    defensive_alpha: np.float32
    candidate_count: int
    use_scalar_target: int
    min_alpha: np.float32
    blends_mixture: int
    probes_only: int


#: A roughness of 0.05, below which the BSDF is the better guess (Cycles' threshold).
_MIN_GUIDED_ALPHA = 0.05**2


def make_guiding_options(
    settings: RenderSettings, *, candidate_count: int, predicts_color: bool = False, probes_only: bool = False
) -> GuidingOptions:
    """Guiding options from a user's settings, the iteration's rule for the number of candidates, and whether something
    of colour predicts and allocation is only tried on recorded paths."""
    return GuidingOptions(
        defensive_alpha=np.float32(settings.defensive_alpha),
        candidate_count=candidate_count,
        use_scalar_target=int(settings.ris_target == "SCALAR"),
        min_alpha=np.float32(_MIN_GUIDED_ALPHA),
        blends_mixture=int(predicts_color),
        probes_only=int(probes_only),
    )
