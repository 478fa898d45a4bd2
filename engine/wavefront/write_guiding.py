# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: passes that show what guiding did at the first surface. Runs only if such a pass was asked for."""

from engine.film import FEATURE_CANDIDATES, FEATURE_GUIDING_BENEFIT
from engine.jit import kernel


@kernel
def write_guiding(benefit, paths, guided, lanes, lane_count, film):
    """Add candidates and benefit of guided lanes that have not scattered yet to the film.

    Parameters
    ----------
    benefit : float32 (R,)
        See `engine.guiding.selection.SelectionModel`.
    """
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0 or paths.depth[lane] > 0 or not guided.rough_share[lane] > 0.0:
            continue
        pixel = paths.pixel[lane]
        film.features[pixel, FEATURE_CANDIDATES] += guided.candidate_count[lane]
        film.features[pixel, FEATURE_GUIDING_BENEFIT] += benefit[guided.leaf[lane]] - 1.0
