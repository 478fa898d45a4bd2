# SPDX-License-Identifier: GPL-3.0-or-later
"""Media that paths are in: their coefficients, and by lane which of them."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array, Uint8Array
from engine.runtime.bundle import Bundle
from engine.state.tracking import MajorantGrids

# Columns of MediaArrays.media.
MEDIUM_ABSORPTION = 0  # RGB [m^-1]
MEDIUM_SCATTERING = 3  # of all lobes [m^-1]
MEDIUM_EMISSION = 6  # radiance a metre
MEDIUM_MAJORANT = 9  # largest channel of the extinction [m^-1]
MEDIUM_WIDTH = 10

# Columns of MediaArrays.lobes.
LOBE_SCATTERING = 0  # RGB [m^-1]
LOBE_G = 3
LOBE_ALPHA = 4
LOBE_DELTA = 5
LOBE_WIDTH = 6

# Rows of MediaLanes.coefficients.
EXTINCTION = 0
SCATTERING = 1
EMISSION = 2
CHANNEL_WEIGHT = 3
#: Weight in the density that proposes distances (`engine.kernels.distances`), and the integral of the transmittance.
PROPOSAL_WEIGHT = 4
SEEN_LENGTH = 5
COEFFICIENT_ROWS = 6

#: Media that a path can be in at once, Cycles' limit; further ones are as if they were not there, and counted.
MAX_MEDIA = 32
#: Boundaries that a ray may cross, Cycles' limit: one that has more is caught between two.
MOST_CROSSINGS = 1024
#: Instance of the world's medium.
WORLD = -1


class MediaArrays(Bundle):
    """All media of a scene.

    media : float32 (M, MEDIUM_WIDTH), 0 of media that vary
    program : int32 (M,), that says what a medium is at a point, -1: it is the same everywhere
    lobes : float32 (K, LOBE_WIDTH), those of a medium one after the other
    first_lobe : int32 (M + 1,)
    of_program : int32 (P,), medium inside of what has this program, -1 = none
    world : int32 (1,), the world's medium, -1 = none
    majorants : bounds of media that vary
    """

    media: Float32Array
    program: Int32Array
    lobes: Float32Array
    first_lobe: Int32Array
    of_program: Int32Array
    world: Int32Array
    majorants: MajorantGrids


class MediaLanes(Bundle):
    """Media that each path is in, L lanes and a row for the ray in work; one row in scenes without any.

    Where media vary L more lie between the two, for shadow rays.

    instance, medium : int32 (L + 1, MAX_MEDIA), the first `count` are in use; the world's has instance WORLD
    count : int32 (L + 1,)
    depth : int32 (L + 1,), scatterings by media
    crossings : int32 (L + 1,), surfaces without a shader that the path has crossed
    gap : float32 (L + 1,) [m], before what the ray meets, in which there are no media; 0 but in scenes of dense ones
    is_lit : uint8 (L + 1,), whether lights have been sampled for all of the segment, so that a collision samples none
    collision_share : float32 (L + 1,), probability with which the path collides on the segment, for MIS weights
    next_instance : int32 (L + 1,), what the ray meets behind the segment, while the lane stands within it
    kept_throughput : float32 (L + 1, channels), likewise; kept_unguided : float32 (L + 1,), likewise
    coefficients : float32 (COEFFICIENT_ROWS, channels), scratch: sums over what a path is in, at its channels
    """

    instance: Int32Array
    medium: Int32Array
    count: Int32Array
    depth: Int32Array
    crossings: Int32Array
    gap: Float32Array
    is_lit: Uint8Array
    collision_share: Float32Array
    next_instance: Int32Array
    kept_throughput: Float32Array
    kept_unguided: Float32Array
    coefficients: Float32Array


def allocate_media_lanes(lane_count: int, channel_count: int, *, has_shadows: bool = False) -> MediaLanes:
    """`MediaLanes` of paths that are in no medium.

    Parameters
    ----------
    lane_count : int
        0 for scenes without media.
    has_shadows : bool
        Whether shadow rays have rows of their own.
    """
    rows = lane_count * (2 if has_shadows else 1) + 1
    return MediaLanes(
        instance=np.zeros((rows, MAX_MEDIA), np.int32),
        medium=np.zeros((rows, MAX_MEDIA), np.int32),
        count=np.zeros(rows, np.int32),
        depth=np.zeros(rows, np.int32),
        crossings=np.zeros(rows, np.int32),
        gap=np.zeros(rows, np.float32),
        is_lit=np.zeros(rows, np.uint8),
        collision_share=np.ones(rows, np.float32),
        next_instance=np.zeros(rows, np.int32),
        kept_throughput=np.zeros((rows, channel_count), np.float32),
        kept_unguided=np.zeros(rows, np.float32),
        coefficients=np.zeros((COEFFICIENT_ROWS, channel_count), np.float32),
    )
