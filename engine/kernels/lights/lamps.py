# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of lamps: what a newcomer extends, by a line here, a file of its own and a line of its conversion.

The file (`sun.py` is an example) has the kind's number, its columns of `LightArrays.lamps` (from LAMP_KIND_COLUMNS on)
and flags (from LAMP_FLAG_OF_KIND on), and the kernels of its `Lamp`. `engine/builder/lamps.py` has the other half: what
becomes rows of lamps in a description, and what the light tree knows of them.

Emissive triangles and the background are no lamps: each has arrays of its own, and a file here.
"""

import numpy as np

from engine.kernels.constants import FAR
from engine.kernels.lights import area, sphere, sun
from engine.kernels.lights.light import LightSample
from engine.kernels.lights.linking import has_blockers, lamp_emitter
from engine.kernels.lights.tree import emitter_pmf, selection_row
from engine.kernels.vector import add, scale
from engine.runtime.jit import by_number, kernel
from engine.scene.description import (
    VISIBLE_CAMERA,
    VISIBLE_DIFFUSE,
    VISIBLE_GLOSSY,
    VISIBLE_TRANSMISSION,
    VISIBLE_VOLUME,
)
from engine.state.lanes import RAY_CAMERA, RAY_DIFFUSE, RAY_GLOSSY, RAY_REFLECT, RAY_TRANSMIT, RAY_VOLUME
from engine.state.lights import (
    EMITTER_KIND,
    EMITTER_LAMP,
    EMITTER_PROGRAM,
    EMITTER_VISIBILITY,
    HEADER_HITTABLE,
    LAMP_FLAG_MIS,
    LAMP_FLAG_SHADOW,
    LAMP_FLAGS,
    LAMP_KIND,
    LAMP_MAX_BOUNCES,
    LAMP_RADIANCE,
)

#: Kinds of lamps; they are asked in this order.
LAMPS = (sun.LAMP, area.LAMP, sphere.POINT_LAMP, sphere.SPOT_LAMP)

_LOCAL = [lamp for lamp in LAMPS if not lamp.is_distant]
_DISTANT = [lamp for lamp in LAMPS if lamp.is_distant]

_sample = by_number({lamp.kind: lamp.sample for lamp in LAMPS}, "_sample", __name__)
_pdf = by_number({lamp.kind: lamp.pdf for lamp in _LOCAL}, "_pdf", __name__)
_hit = by_number({lamp.kind: lamp.hit for lamp in _LOCAL}, "_hit", __name__)
_leaving = by_number({lamp.kind: lamp.leaving for lamp in _LOCAL}, "_leaving", __name__)
_place = by_number({lamp.kind: lamp.place for lamp in LAMPS}, "_place", __name__)
_pdf_of_distant = by_number({lamp.kind: lamp.pdf for lamp in _DISTANT}, "_pdf_of_distant", __name__)
_hit_distant = by_number({lamp.kind: lamp.hit for lamp in _DISTANT}, "_hit_distant", __name__)
_leaving_distant = by_number({lamp.kind: lamp.leaving for lamp in _DISTANT}, "_leaving_distant", __name__)


_GLOSSY_REFLECTION = RAY_GLOSSY | RAY_REFLECT


@kernel
def is_seen_by(flags, visibility):
    """Whether a ray of this kind sees a lamp; glossy visibility is about reflections only."""
    if flags & RAY_CAMERA and not visibility & VISIBLE_CAMERA:
        return False
    if flags & RAY_DIFFUSE and not visibility & VISIBLE_DIFFUSE:
        return False
    if flags & _GLOSSY_REFLECTION == _GLOSSY_REFLECTION and not visibility & VISIBLE_GLOSSY:
        return False
    if flags & RAY_VOLUME and not visibility & VISIBLE_VOLUME:
        return False
    return not (flags & RAY_TRANSMIT and not visibility & VISIBLE_TRANSMISSION)


@kernel(forceinline=True)
def sample_lamp(lights, choice, receiver, u0, u1):
    """Draw a point of a lamp that has been chosen: LightSample."""
    emitter = choice.emitter
    kind, row = np.int64(lights.emitters[emitter, EMITTER_KIND]), np.int64(lights.emitters[emitter, EMITTER_LAMP])
    flags = lights.lamp_table[row, LAMP_FLAGS]
    found = _sample(kind, lights, row, receiver, u0, u1)
    factor = found.factor
    pdf = found.pdf if factor > 0.0 else 0.0 * u0
    point = found.wi if found.distance >= FAR else add(receiver.p, scale(found.wi, found.distance))
    program = np.int64(lights.emitters[emitter, EMITTER_PROGRAM])
    visibility = np.int64(lights.emitters[emitter, EMITTER_VISIBILITY])
    radiance = (
        factor * lights.lamps[row, LAMP_RADIANCE],
        factor * lights.lamps[row, LAMP_RADIANCE + 1],
        factor * lights.lamps[row, LAMP_RADIANCE + 2],
    )
    cast_shadow, shows_back = (flags & LAMP_FLAG_SHADOW) != 0, False
    # A hidden lamp that varies is found by light samples alone.
    use_mis = (flags & LAMP_FLAG_MIS) != 0 and not (program >= 0 and has_blockers(lights, emitter))
    max_bounces = np.int64(lights.lamp_table[row, LAMP_MAX_BOUNCES])
    return LightSample(
        pdf * choice.pmf, emitter, kind, found.wi, found.distance, point, found.ng, found.u, found.v, -1, -1, program,
        radiance, visibility, cast_shadow, max_bounces, use_mis, shows_back, choice.pmf,
    )  # fmt: skip


@kernel
def _choice_pmf(lights, row, receiver):
    """Probability with which a lamp is chosen for a receiver."""
    tree = receiver.tree
    return emitter_pmf(
        lights, selection_row(lights, tree, receiver.p), lamp_emitter(lights, tree, row), receiver.p, receiver.n,
        receiver.has_transmission,
    )


@kernel
def lamp_hit(lights, row, origin, direction, t_min, t_max):
    """Distance from `origin` at which a ray meets lamp `row`, one in the scene, -1 = not."""
    return _hit(lights.lamp_table[row, LAMP_KIND], lights, row, origin, direction, t_min, t_max)


@kernel
def lamp_leaving(lights, row, p, wi):
    """Share of the radiance of lamp `row`, one in the scene, that leaves along -wi towards p."""
    return _leaving(lights.lamp_table[row, LAMP_KIND], lights, row, p, wi)


@kernel
def lamp_place(lights, row, origin, direction, t):
    """Normal, and texture coordinates u and v, where a ray meets lamp `row`, of any kind."""
    return _place(lights.lamp_table[row, LAMP_KIND], lights, row, origin, direction, t)


@kernel
def lamp_pdf(lights, row, receiver, wi, distance):
    """Density [sr^-1] with which `sample_light` would have proposed a hit of lamp `row`, one in the scene."""
    pdf = _pdf(lights.lamp_table[row, LAMP_KIND], lights, row, receiver, wi, distance)
    return pdf * _choice_pmf(lights, row, receiver)


@kernel
def distant_lamp_is_hit(lights, row, origin, direction, t_min):
    """Whether a ray that leaves the scene meets lamp `row`, one that is infinitely far away."""
    return _hit_distant(lights.lamp_table[row, LAMP_KIND], lights, row, origin, direction, t_min, FAR) >= FAR


@kernel
def distant_lamp_leaving(lights, row, p, wi):
    """As `lamp_leaving`, of a lamp that is infinitely far away."""
    return _leaving_distant(lights.lamp_table[row, LAMP_KIND], lights, row, p, wi)


@kernel
def distant_lamp_pdf(lights, row, receiver, wi):
    """As `lamp_pdf`, of a lamp that is infinitely far away."""
    pdf = _pdf_of_distant(lights.lamp_table[row, LAMP_KIND], lights, row, receiver, wi, FAR)
    return pdf * _choice_pmf(lights, row, receiver)


@kernel
def any_lamp_pdf(lights, row, receiver, wi, distance):
    """As `lamp_pdf`, of any lamp; the distance of one that is infinitely far away does not count."""
    if row < lights.header[HEADER_HITTABLE]:
        return lamp_pdf(lights, row, receiver, wi, distance)
    return distant_lamp_pdf(lights, row, receiver, wi)
