# SPDX-License-Identifier: GPL-3.0-or-later
"""Which vertices the guide is asked at, and how many directions are proposed there."""

import numpy as np

from engine.kernels.rng import hash_combine, unit_float
from engine.ris.orca import PROBED_SHARE, candidate_count
from engine.runtime.jit import kernel

#: Offset of the numbers for look-ups among a path's dimensions, far from those of its vertices.
_SET_LOOKUP = 1 << 17
#: Share (of 2^32) of recorded lanes for which the guide is asked, though not used, where its probability is 0.
TRIAL_BITS = np.uint32(1 << 28)
_PROBED_BITS = np.uint32(PROBED_SHARE * 2**32)


@kernel
def look_up_bits(paths, lane):
    """Random bits for the guide's look-up at the vertex that a lane stands at: uint32."""
    return hash_combine(
        hash_combine(paths.rng[lane], paths.sample[lane]), np.uint32(paths.dimension[lane] + _SET_LOOKUP)
    )


@kernel
def allot(guiding, allocation, region, paths, lane, pixel_weight, is_recorded, bits):
    """Candidates of the vertex that a lane stands at: int.

    Parameters
    ----------
    guiding : GuidingOptions
    region : int, row of `allocation`
    bits : uint32, random
    """
    count = guiding.candidate_count
    is_probe = is_recorded and hash_combine(bits, np.uint32(5)) < _PROBED_BITS
    if count == 0 and guiding.probes_only != 0 and not is_probe:
        count = 1
    if count == 0:
        squared = 0.0
        for c in range(len(paths.channels)):
            squared += paths.throughput[lane, c] * paths.throughput[lane, c]
        squared *= pixel_weight[paths.pixel[lane]] / len(paths.channels)
        u = unit_float(hash_combine(bits, np.uint32(2)))
        count = candidate_count(allocation, region, squared, is_recorded, u)
    return count
