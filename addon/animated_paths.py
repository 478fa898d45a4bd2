# SPDX-License-Identifier: GPL-3.0-or-later
"""Which properties of a datablock are animated, by keyframes, drivers or strips."""

from __future__ import annotations

from collections.abc import Iterator

import bpy


def _curves(action: bpy.types.Action) -> Iterator[bpy.types.FCurve]:
    # From Blender 5 on curves are in layers alone.
    if hasattr(action, "fcurves"):
        yield from action.fcurves
        return
    for layer in action.layers:
        for strip in layer.strips:
            for bag in strip.channelbags:
                yield from bag.fcurves


def animated_paths(owner: bpy.types.ID) -> set[str]:
    """Paths of properties whose values keyframes, drivers or strips say; curves of other users of an action too."""
    data = owner.animation_data
    if data is None:
        return set()
    actions = [data.action, *(strip.action for track in data.nla_tracks for strip in track.strips)]
    paths = {curve.data_path for action in actions if action is not None for curve in _curves(action)}
    return paths | {driver.data_path for driver in data.drivers}
