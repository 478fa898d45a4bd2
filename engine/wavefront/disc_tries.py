# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of a disc, within which photons are gathered, is surface: next to an edge or a wall only a part.

What photons say of light is their power over the area in which they lie. Who divides by the whole disc there finds too
little. How often a place must be drawn until one lies on the surface is one over the surface's share, on average.
"""

import math

import numpy as np

from engine.accel.rays import read_hit, trace_closest
from engine.kernels.rng import hash_combine, unit_float
from engine.kernels.surface import surface_point
from engine.kernels.vector import add, dot, orthonormal_basis, scale, subtract
from engine.runtime.jit import kernel
from engine.state.lanes import RAY_DIFFUSE
from engine.state.photons import REFRACTS
from engine.wavefront.columns import SCENE_HANDLE

#: Photons have arrived at the same surface up to this far off its plane, over the radius, and by this cosine between
#: normals.
FLATNESS = np.float32(0.3)
SAME_SURFACE = np.float32(0.5)
#: Places that are drawn at most: surfaces much narrower than the disc keep a part of its darkness.
_MOST_TRIES = 8
#: Casters that a ray to a place passes, as photons do.
_MOST_CASTERS = 4
_TWO_PI = np.float32(2.0 * math.pi)


@kernel
def _is_surface(scene, work, lane, p, ng, radius, place):
    """Whether a ray from above the disc's middle meets the same surface next where it goes to a place of the disc."""
    ray, bits, address = work.ray, work.ray_bits, work.ray_address[0]
    handle, geometry, time = scene.header[SCENE_HANDLE], scene.geometry, work.paths.time[lane]
    above = FLATNESS * radius
    origin = add(p, scale(ng, above))
    direction = subtract(place, origin)
    near = np.float32(0.0)
    for _ in range(_MOST_CASTERS):
        # To as far below the disc as it has begun above.
        if not trace_closest(handle, ray, bits, address, origin, direction, near, np.float32(2.0), time, RAY_DIFFUSE):
            return False
        instance, triangle, distance, u, v = read_hit(ray, bits, geometry)
        if scene.casters.instances[instance] & REFRACTS:
            near = distance * np.float32(1.0001) + np.float32(1e-6)
            continue
        met, normal, _ns, _error = surface_point(geometry, instance, triangle, u, v, time)
        off = subtract(met, p)
        return bool(
            dot(off, off) <= radius * radius and abs(dot(off, ng)) <= above and abs(dot(normal, ng)) > SAME_SURFACE
        )
    return False


@kernel
def tries_in_disc(scene, work, lane, p, ng, radius, seed):
    """How many places of a disc are drawn until one lies on the surface about its middle: 1 / share, on average.

    Parameters
    ----------
    p, ng : tuple of 3 float32, world: the middle [m], and the unit geometric normal towards the viewer
    radius : float32 [m]
    seed : uint32, of the random numbers
    """
    tangent, bitangent = orthonormal_basis(ng)
    for tried in range(1, _MOST_TRIES):
        seed = hash_combine(seed, np.uint32(tried))
        away = radius * math.sqrt(unit_float(seed))
        seed = hash_combine(seed, np.uint32(tried))
        angle = _TWO_PI * unit_float(seed)
        place = add(p, add(scale(tangent, away * math.cos(angle)), scale(bitangent, away * math.sin(angle))))
        if _is_surface(scene, work, lane, p, ng, radius, place):
            return np.float32(tried)
    return np.float32(_MOST_TRIES)
