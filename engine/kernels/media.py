# SPDX-License-Identifier: GPL-3.0-or-later
"""What a ray is in: entering and leaving media, sums of their coefficients, and what they let through.

Media that overlap add up. A row of `MediaLanes` lists those that a path, or a shadow ray, is in.
"""

import numpy as np

from engine.kernels.constants import FAR
from engine.kernels.exponential import decay
from engine.kernels.spectrum import upsample_light
from engine.runtime.jit import kernel
from engine.state.lanes import RGB
from engine.state.media import (
    CHANNEL_WEIGHT,
    EMISSION,
    EXTINCTION,
    MAX_MEDIA,
    MEDIUM_ABSORPTION,
    MEDIUM_EMISSION,
    MEDIUM_SCATTERING,
    SCATTERING,
    WORLD,
)


@kernel
def first_medium(lanes, row):
    """The instance of the medium that has been entered first of those around, -1: the world's, or none."""
    return np.int64(lanes.instance[row, 0]) if lanes.count[row] > 0 else np.int64(-1)


@kernel
def last_medium(lanes, row):
    """The instance of the medium that has been entered last of those around, -1: the world's, or none."""
    count = lanes.count[row]
    return np.int64(lanes.instance[row, count - 1]) if count > 0 else np.int64(-1)


@kernel
def enter_medium(lanes, row, instance, medium):
    """Add a medium to a row that does not have it; returns False if there is no room."""
    count = lanes.count[row]
    for k in range(count):
        if lanes.instance[row, k] == instance and lanes.medium[row, k] == medium:
            return True
    if count >= MAX_MEDIA:
        return False
    lanes.instance[row, count] = instance
    lanes.medium[row, count] = medium
    lanes.count[row] = count + 1
    return True


@kernel
def leave_medium(lanes, row, instance, medium):
    """Take a medium from a row, if it is there."""
    kept = 0
    for k in range(lanes.count[row]):
        if lanes.instance[row, k] == instance and lanes.medium[row, k] == medium:
            continue
        lanes.instance[row, kept] = lanes.instance[row, k]
        lanes.medium[row, kept] = lanes.medium[row, k]
        kept += 1
    lanes.count[row] = kept


@kernel
def cross_boundary(lanes, row, instance, medium, is_back):
    """Go through a surface: into the medium behind its front, or out of it. Returns False if there is no room."""
    if is_back:
        leave_medium(lanes, row, instance, medium)
        return True
    return enter_medium(lanes, row, instance, medium)


@kernel
def leave_objects(lanes, row):
    """Keep the world's medium only: nothing else reaches to infinity."""
    kept = 0
    for k in range(lanes.count[row]):
        if lanes.instance[row, k] == WORLD:
            lanes.instance[row, kept] = WORLD
            lanes.medium[row, kept] = lanes.medium[row, k]
            kept += 1
    lanes.count[row] = kept


@kernel
def copy_media(lanes, source, target):
    """Make row `target` what row `source` is."""
    for k in range(lanes.count[source]):
        lanes.instance[target, k] = lanes.instance[source, k]
        lanes.medium[target, k] = lanes.medium[source, k]
    lanes.count[target] = lanes.count[source]


@kernel
def any_varies(arrays, lanes, row):
    """Whether any of a row's media varies in space."""
    for entry in range(lanes.count[row]):
        if arrays.program[lanes.medium[row, entry]] >= 0:
            return True
    return False


@kernel
def sum_coefficients(scene, paths, lanes, lane, row, is_endless):
    """Write the sums of all media of a row, at the path's channels, into `lanes.coefficients`.

    Parameters
    ----------
    scene : SceneView; paths : PathState; lanes : MediaLanes
    lane, row : int
        Lane of the path, whose wavelengths count, and row of `lanes`.
    is_endless : bool
        Whether the ray leaves the scene, so that only the world's medium is on it.
    """
    media, sums = scene.media.media, lanes.coefficients
    for c in range(len(paths.channels)):
        sums[EXTINCTION, c] = 0.0
        sums[SCATTERING, c] = 0.0
        sums[EMISSION, c] = 0.0
    for k in range(lanes.count[row]):
        if is_endless and lanes.instance[row, k] != WORLD:
            continue
        medium = lanes.medium[row, k]
        for c in range(RGB):
            sums[EXTINCTION, c] += media[medium, MEDIUM_ABSORPTION + c]
            sums[SCATTERING, c] += media[medium, MEDIUM_SCATTERING + c]
            sums[EMISSION, c] += media[medium, MEDIUM_EMISSION + c]
    if len(paths.channels) > RGB:
        for kind in range(EMISSION + 1):
            upsample_light(
                scene.spectrum, paths, lane, sums[kind, 0], sums[kind, 1], sums[kind, 2], 0.0, sums, kind
            )
    for c in range(len(paths.channels)):
        sums[EXTINCTION, c] += sums[SCATTERING, c]


@kernel
def transmittance(extinction, distance):
    """Share of light that is left after a distance (Beer's law)."""
    if not extinction > 0.0:
        return np.float32(1.0)
    return decay(extinction * distance)


@kernel
def weigh_channels(paths, lanes, lane, distance):
    """How likely each channel draws where a path collides: by what it has to expect of scattering and of passing.

    Fills row CHANNEL_WEIGHT of `lanes.coefficients`.

    Returns
    -------
    total : float32, sum of the weights
    share : float32, probability that the path collides before `distance`
    """
    sums = lanes.coefficients
    total = 0.0
    colliding = 0.0
    for c in range(len(paths.channels)):
        passed = transmittance(sums[EXTINCTION, c], distance)
        albedo = sums[SCATTERING, c] / sums[EXTINCTION, c] if sums[EXTINCTION, c] > 0.0 else 0.0
        weight = abs(paths.throughput[lane, c]) * (albedo * (1.0 - passed) + passed)
        sums[CHANNEL_WEIGHT, c] = weight
        total += weight
        colliding += weight * (1.0 - passed)
    return total, colliding / total if total > 0.0 else 0.0


@kernel
def emitted_length(extinction, distance):
    """Integral of the transmittance over a distance: metres of emission that are seen."""
    depth = extinction * distance
    if depth < 1e-3:
        return distance * (1.0 - 0.5 * depth)
    return (1.0 - decay(depth)) / extinction


@kernel
def length_in_media(paths, lanes, lane):
    """How much of a path's ray may lie in media before what it meets, or without an end [m]; see `find_gaps`."""
    return max(paths.hit_distance[lane] - lanes.gap[lane], 0.0)


@kernel
def add_depth(scene, paths, lanes, lane, row, distance):
    """Add the optical depth of the media of a row over a distance to row CHANNEL_WEIGHT of `lanes.coefficients`."""
    if lanes.count[row] == 0:
        return
    sum_coefficients(scene, paths, lanes, lane, row, distance >= FAR)
    sums = lanes.coefficients
    for c in range(len(paths.channels)):
        if sums[EXTINCTION, c] > 0.0:
            sums[CHANNEL_WEIGHT, c] += sums[EXTINCTION, c] * distance


@kernel
def attenuate(scene, paths, lanes, lane, row, distance, values, value_row):
    """Multiply row `value_row` of `values` by what the media of a row let through over a distance.

    Returns
    -------
    bool
        Whether anything is left.
    """
    if lanes.count[row] == 0:
        return True
    is_endless = distance >= FAR
    sum_coefficients(scene, paths, lanes, lane, row, is_endless)
    largest = 0.0
    for c in range(len(paths.channels)):
        value = values[value_row, c] * transmittance(lanes.coefficients[EXTINCTION, c], distance)
        values[value_row, c] = value
        largest = max(largest, abs(value))
    return largest > 0.0
