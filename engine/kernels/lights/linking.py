# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lights reach a receiver: its light tree, and what of a scene's emitters is in that.

Where a scene links no lights, all this is constants: `LightLinks.receivers` then has no columns, which is part of its
type.
"""

import numpy as np

from engine.kernels.media import first_medium, last_medium
from engine.runtime.jit import kernel
from engine.state.lanes import RAY_CAMERA, RAY_TREE_MASK, RAY_TREE_SHIFT
from engine.state.lights import (
    HEADER_BACKGROUND_EMITTER,
    HEADER_FIRST_PATCH,
    HEADER_UNLINKED,
    LAMP_EMITTER,
    TREE_BACKGROUND,
    TREE_FIRST_DISTANT,
    TREE_FIRST_PATCH,
    TREE_LAST_DISTANT,
    TREE_ROOT,
)

_FIRST = np.int64(0)
_NONE = np.int64(-1)
_ONE = np.int64(1)


@kernel(forceinline=True)
def is_linked(lights):
    """Whether a scene links lights: known when a kernel is compiled."""
    return lights.links.receivers.shape[1] != 0


@kernel(forceinline=True)
def tree_of_receiver(lights, instance):
    """The light tree by which an instance receives light; of none (-1) the first one."""
    if not is_linked(lights) or instance < 0:
        return _FIRST
    return np.int64(lights.links.receivers[instance, 0])


@kernel(forceinline=True)
def tree_within(lights, media, row):
    """The light tree of a point within the media of a row of `MediaLanes`.

    As in Cycles, which asks the medium entered first when it chooses a light, and that entered last when it samples it:
    where media overlap, what lights both counts.
    """
    if not is_linked(lights):
        return _FIRST
    first = tree_of_receiver(lights, first_medium(media, row))
    last = tree_of_receiver(lights, last_medium(media, row))
    return first if first == last else np.int64(lights.links.joined[first, last])


@kernel(forceinline=True)
def tree_of_emitter(lights, emitter):
    """The light tree that a row of `LightArrays.emitters` is in."""
    if not is_linked(lights):
        return _FIRST
    return np.int64(lights.links.tree[emitter])


@kernel(forceinline=True)
def tree_of_ray(lights, flags):
    """The light tree of what a ray was scattered by; flags RAY_*."""
    if not is_linked(lights):
        return _FIRST
    return np.int64((flags & RAY_TREE_MASK) >> RAY_TREE_SHIFT)


@kernel(forceinline=True)
def tree_flags(lights, tree):
    """RAY_* bits of a ray that is scattered where light comes by a tree, which `tree_of_ray` reads."""
    if not is_linked(lights):
        return _FIRST
    return tree << RAY_TREE_SHIFT


@kernel(forceinline=True)
def tree_range(lights, tree):
    """Group of a light tree's root (-1: no local emitters), and where its rows of `distant` begin and end."""
    if not is_linked(lights):
        return _FIRST if lights.nodes.shape[0] > 0 else _NONE, _FIRST, np.int64(lights.distant.shape[0])
    trees = lights.links.trees
    return (
        np.int64(trees[tree, TREE_ROOT]), np.int64(trees[tree, TREE_FIRST_DISTANT]),
        np.int64(trees[tree, TREE_LAST_DISTANT]),
    )  # fmt: skip


@kernel(forceinline=True)
def emitter_in_tree(lights, tree, emitter):
    """Row of `LightArrays.emitters` that stands in a tree for an emitter of the scene; -1: it is not in it."""
    if not is_linked(lights) or emitter < 0:
        return np.int64(emitter)
    return np.int64(lights.links.rows[tree * lights.header[HEADER_UNLINKED] + emitter])


@kernel(forceinline=True)
def lamp_emitter(lights, tree, row):
    """Row of `LightArrays.emitters` of a lamp in a tree; -1: it is not in it."""
    return emitter_in_tree(lights, tree, lights.lamp_table[row, LAMP_EMITTER])


@kernel(forceinline=True)
def background_emitter(lights, tree):
    """Row of `LightArrays.emitters` of the background in a tree; -1: it is not sampled."""
    if not is_linked(lights):
        return np.int64(lights.header[HEADER_BACKGROUND_EMITTER])
    return np.int64(lights.links.trees[tree, TREE_BACKGROUND])


@kernel(forceinline=True)
def first_patch(lights, tree):
    """The first cluster of a tree that is a patch of the background."""
    if not is_linked(lights):
        return np.int64(lights.header[HEADER_FIRST_PATCH])
    return np.int64(lights.links.trees[tree, TREE_FIRST_PATCH])


@kernel(forceinline=True)
def surface_shines(lights, flags, instance):
    """Whether what an instance emits counts for a ray that has met it; flags RAY_*. Cameras see everything."""
    if not is_linked(lights) or flags & RAY_CAMERA:
        return True
    return (lights.links.surfaces[instance] >> tree_of_ray(lights, flags)) & _ONE != 0


@kernel(forceinline=True)
def medium_shines(lights, flags, instance):
    """As `surface_shines`, of a medium (-1: the world's): cameras see of it what lights objects in no collection."""
    if not is_linked(lights) or instance < 0:
        return True
    return (lights.links.surfaces[instance] >> tree_of_ray(lights, flags)) & _ONE != 0


@kernel(forceinline=True)
def lamp_shines(lights, flags, row):
    """As `surface_shines`, of a lamp."""
    if not is_linked(lights) or flags & RAY_CAMERA:
        return True
    return (lights.links.lamps[row] >> tree_of_ray(lights, flags)) & _ONE != 0


@kernel(forceinline=True)
def links_shadows(lights):
    """Whether a scene links shadows: known when a kernel is compiled."""
    return lights.links.blockers.shape[1] != 0


@kernel(forceinline=True)
def has_blockers(lights, emitter):
    """Whether only some objects cast shadows in an emitter's light."""
    return links_shadows(lights) and lights.links.blockers[emitter, 0] != 0


@kernel(forceinline=True)
def casts_shadow(lights, emitter, instance):
    """Whether an instance dims an emitter's light (-1: none's)."""
    if not links_shadows(lights) or emitter < 0:
        return True
    blockers = lights.links.blockers[emitter, 0]
    return blockers == 0 or lights.links.casters[instance] & blockers != 0


@kernel(forceinline=True)
def lamp_is_hidden(lights, row):
    """Whether only some objects cast shadows in a lamp's light: scattered rays find it by stages of their own."""
    return links_shadows(lights) and lights.links.hides[row] != 0


@kernel(forceinline=True)
def shadow_mask(lights, emitter, mask, shift):
    """Mask of shadow rays towards an emitter (-1: none), which is `mask` if everything casts shadows in its light.

    Parameters
    ----------
    shift : int
        By how many bits masks are higher of rays that see some objects only.
    """
    if links_shadows(lights) and emitter >= 0:
        blockers = np.int64(lights.links.blockers[emitter, 0])
        if blockers != 0:
            return blockers << shift
    return np.int64(mask)
