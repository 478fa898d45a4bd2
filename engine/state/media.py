# SPDX-License-Identifier: GPL-3.0-or-later
"""Media that paths are in: their coefficients, and by lane which of them."""

from __future__ import annotations

from engine.array_types import Float32Array, Int32Array, Uint8Array
from engine.runtime.bundle import Bundle
from engine.state.columns import allocate, column
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
    """Media that each path is in: a row a lane and one for the ray in work; one row in scenes without any.

    Where media vary as many rows as lanes lie between the two, for shadow rays.
    """

    instance: Int32Array = column("the first `count` are in use; the world's has instance WORLD", "L", MAX_MEDIA)
    medium: Int32Array = column("row of MediaArrays.media, likewise", "L", MAX_MEDIA)
    count: Int32Array = column("media that the path is in", "L")
    depth: Int32Array = column("scatterings by media", "L")
    crossings: Int32Array = column("surfaces without a shader that the path has crossed", "L")
    gap: Float32Array = column(
        "before what the ray meets, in which there are no media; 0 but in scenes of dense ones [m]", "L"
    )
    is_lit: Uint8Array = column(
        "whether lights have been sampled for all of the segment, so that a collision samples none", "L"
    )
    collision_share: Float32Array = column(
        "probability with which the path collides on the segment, for MIS weights", "L", fill=1.0
    )
    next_instance: Int32Array = column(
        "what the ray meets behind the segment, while the lane stands within it", "L"
    )
    kept_throughput: Float32Array = column("likewise", "L", "C")
    kept_unguided: Float32Array = column("likewise", "L")
    coefficients: Float32Array = column(
        "scratch: sums over what a path is in, at its channels", COEFFICIENT_ROWS, "C"
    )


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
    return allocate(MediaLanes, {"L": rows, "C": channel_count})
