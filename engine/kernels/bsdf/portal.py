# SPDX-License-Identifier: GPL-3.0-or-later
"""The lobe of the Ray Portal BSDF: light that goes on from another place, as the same ray. As in Cycles.

To most stages it is what a subsurface lobe is: it has no value in any direction, is sampled only, and goes on
elsewhere. `engine.wavefront.enter_portals` says where. The rows of `Closures.param` hold another method than those of
light that scatters below the surface.
"""

from engine.kernels.bsdf.closures import append_closure
from engine.kernels.bsdf.kinds import SUBSURFACE
from engine.kernels.bsdf.subsurface import (
    RANDOM_WALK_SKIN,
    SUBSURFACE_ALBEDO,
    SUBSURFACE_IS_BUMPED,
    SUBSURFACE_METHOD,
    SUBSURFACE_RADIUS,
)
from engine.kernels.vector import dot, normalize, scale
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_WEIGHT

#: The value of SUBSURFACE_METHOD.
RAY_PORTAL = RANDOM_WALK_SKIN + 1

# Columns of Closures.param, apart from those that become colours by wavelength.
PORTAL_POSITION = SUBSURFACE_METHOD + 1
PORTAL_DIRECTION = SUBSURFACE_IS_BUMPED + 1


@kernel
def add_portal(closures, lane, view, weight, place):
    """Append the lobe of a Ray Portal BSDF.

    Parameters
    ----------
    view : tuple
        Direction to the viewer, geometric and smooth normal.
    weight : tuple of 3 float32
        Its colour included.
    place : tuple
        Where the ray goes on, world [m], and its direction, world, of any length; zero: the ray's own.
    """
    wo, _ng, ns = view
    position, direction = place
    i = append_closure(closures, lane, SUBSURFACE, weight, ns)
    if i < 0:
        return
    length_squared = dot(direction, direction)
    direction = normalize(direction) if length_squared > 0.0 else scale(wo, -1.0)
    param = closures.param
    param[lane, i, SUBSURFACE_METHOD] = RAY_PORTAL
    param[lane, i, SUBSURFACE_IS_BUMPED] = 0.0
    for c in range(4):
        param[lane, i, SUBSURFACE_ALBEDO + c] = 0.0
        param[lane, i, SUBSURFACE_RADIUS + c] = 0.0
    for c in range(3):
        param[lane, i, PORTAL_POSITION + c] = position[c]
        param[lane, i, PORTAL_DIRECTION + c] = direction[c]


@kernel
def is_portal(closures, lane, i):
    """Whether a lane's lobe `i` is that of a Ray Portal BSDF."""
    return closures.kind[lane, i] == SUBSURFACE and closures.param[lane, i, SUBSURFACE_METHOD] == RAY_PORTAL


@kernel
def passed_share(closures, lane, channel):
    """How much light in an RGB channel goes on beyond a surface as the same ray: float32 in [0, 1].

    By what is transparent and by portals: alpha in data passes and Ambient Occlusion is the rest, as in Cycles. Shadows
    do not go through portals.
    """
    passed = closures.transparency[lane, channel]
    for i in range(closures.count[lane]):
        if is_portal(closures, lane, i):
            passed += closures.param[lane, i, CLOSURE_WEIGHT + channel]
    return min(max(passed, 0.0), 1.0)
