# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: passes that show what guiding did at the first surface. Runs only if such a pass was asked for."""

from engine.runtime.jit import kernel
from engine.state.film import FEATURE_CANDIDATES, FEATURE_GUIDING_BENEFIT


@kernel
def write_guiding(scene, unit, guidance, work, queue):
    """Add candidates and benefit of guided lanes that have not scattered yet to the film."""
    benefit, paths, guided, film = guidance.benefit, work.paths, work.guided, unit.film
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0 or paths.depth[lane] > 0 or not guided.rough_share[lane] > 0.0:
            continue
        pixel = paths.pixel[lane]
        film.features[pixel, FEATURE_CANDIDATES] += guided.candidate_count[lane]
        film.features[pixel, FEATURE_GUIDING_BENEFIT] += benefit[guided.leaf[lane]] - 1.0
