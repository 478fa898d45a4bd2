# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: what media leave of light samples. Runs only in scenes that have media.

It goes along the shadow rays from boundary to boundary, whatever stands between; surfaces in their way come after.
"""

from engine.accel import MASK_MEDIUM, read_hit, trace_closest
from engine.kernels.constants import DISTANT, FAR
from engine.kernels.media import attenuate, copy_media, cross_boundary
from engine.kernels.path import real_3
from engine.kernels.surface import offset_origin, program_of, surface_point
from engine.kernels.vector import dot, load
from engine.runtime.jit import kernel
from engine.scene.description import VISIBLE_SHADOW
from engine.state.geometry import INSTANCE_VISIBILITY
from engine.state.lanes import (
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_NG,
    POINT_PROGRAM,
    RAY_CATCHER_HIT,
)
from engine.wavefront.columns import (
    MEDIA_DROPPED,
    SCENE_HANDLE,
    SCENE_HAS_BOUNDARIES,
    SHADOW_ROWS,
    TRANSPARENT_SHADOW_RAYS,
    UNIT_FOLLOWS,
)

#: Boundaries that a shadow ray may cross: one that has more is caught between two.
_MOST_CROSSINGS = 1024


@kernel
def _leave_point(scene, work, lane, row, direction):
    """Make row `row` what the shadow ray of a lane starts in."""
    points, media = work.points, work.media
    copy_media(media, lane, row)
    program = points.integer[lane, POINT_PROGRAM]
    if program < 0 or dot(direction, real_3(points, lane, POINT_NG)) >= 0.0:
        return
    medium = scene.media.of_program[program]
    is_back = points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING != 0
    if medium >= 0 and not cross_boundary(media, row, points.integer[lane, POINT_INSTANCE], medium, is_back):
        work.counts[MEDIA_DROPPED] += 1


@kernel
def attenuate_shadows(scene, unit, work, queue):
    """Multiply the light of all shadow rays by the transmittance on their way.

    Lights without shadows are not dimmed, as in Cycles.

    Parameters
    ----------
    queue : LaneQueue
        Not looked at: rows of `work.shadows` are in use.
    """
    geometry, of_program, paths, shadows = scene.geometry, scene.media.of_program, work.paths, work.shadows
    media, radiance = work.media, work.shadows.radiance
    has_boundaries, follows = scene.header[SCENE_HAS_BOUNDARIES] != 0, unit.header[UNIT_FOLLOWS] != 0
    own = media.count.shape[0] - 1
    for row in range(work.counts[SHADOW_ROWS]):
        lane = shadows.lane[row]
        rest = shadows.distance[row]
        if not rest > 0.0 or (follows and paths.flags[lane] & RAY_CATCHER_HIT):
            continue
        origin, direction, time = load(shadows.origin, row), load(shadows.direction, row), paths.time[lane]
        _leave_point(scene, work, lane, own, direction)
        if not has_boundaries:
            attenuate(scene, paths, media, lane, own, rest, radiance, row)
            continue
        for _ in range(_MOST_CROSSINGS):
            work.counts[TRANSPARENT_SHADOW_RAYS] += 1
            hit = trace_closest(
                scene.header[SCENE_HANDLE], work.ray, work.ray_bits, work.ray_address[0], origin, direction, 0.0, rest,
                time, MASK_MEDIUM,
            )
            if not hit:
                attenuate(scene, paths, media, lane, own, rest, radiance, row)
                break
            instance, triangle, distance, u, v = read_hit(work.ray, work.ray_bits, geometry)
            if not attenuate(scene, paths, media, lane, own, distance, radiance, row):
                break
            p, ng, _ns, error = surface_point(geometry, instance, triangle, u, v, time)
            origin = offset_origin(p, ng, direction, error)
            rest = rest - distance if rest < FAR else DISTANT
            medium = of_program[program_of(geometry, instance, triangle)]
            if medium < 0 or not geometry.instance_table[instance, INSTANCE_VISIBILITY] & VISIBLE_SHADOW:
                continue
            is_back = dot(ng, direction) > 0.0
            if not cross_boundary(media, own, instance, medium, is_back):
                work.counts[MEDIA_DROPPED] += 1
