# SPDX-License-Identifier: GPL-3.0-or-later
"""Light groups of a view: the passes that a mix of them takes, and pictures with the mix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from engine.array_types import Float32Array
from engine.render.light_mix import changes, mixed
from engine.render.light_passes import group_pass
from engine.viewport.view import Factor


def group_passes(groups: Sequence[str], mix: Mapping[str, Factor] | None) -> frozenset[str]:
    """Passes of all light groups of a scene; none where there is no mix."""
    return frozenset(map(group_pass, groups)) if mix else frozenset()


def mixed_picture(
    images: Mapping[str, Float32Array], groups: Sequence[str], mix: Mapping[str, Factor] | None
) -> Float32Array:
    """Combined of some passes with the light of each group times its factor; itself where that changes nothing.

    Parameters
    ----------
    images : mapping of float32 (H, W, channels)
        Of a render of `group_passes`; factors of groups that it has not are left out.
    groups : sequence of str
        The scene's.
    mix : mapping of three floats

    Raises
    ------
    ValueError
        As `engine.render.light_mix.mixed`.
    """
    lights = {group: images[group_pass(group)] for group in groups if group_pass(group) in images}
    factors = {group: factor for group, factor in (mix or {}).items() if group in lights}
    return mixed(images["Combined"], lights, factors) if changes(factors) else images["Combined"]
