# SPDX-License-Identifier: GPL-3.0-or-later
"""What gathering at surfaces and within media has in common: which photons are a path's, and what a trial is told."""

import numpy as np

from engine.kernels.spectrum import to_rgb
from engine.runtime.jit import kernel
from engine.state.photons import BOUNCE_LIMIT, PHOTON_BOUNCES


@kernel
def is_of_path(options, paths, lane, photons, row):
    """Whether limits let a path go on over as many surfaces as a photon has come by."""
    bounces = np.int64(photons[row, PHOTON_BOUNCES])
    glossy, passed = bounces % BOUNCE_LIMIT, bounces // BOUNCE_LIMIT
    return (
        paths.depth[lane] + 1 + glossy + passed <= options.max_depth
        and paths.glossy_depth[lane] + glossy <= options.max_glossy_depth
        and paths.transmission_depth[lane] + passed <= options.max_transmission_depth
    )


@kernel
def note_found(scene, work, lane, over, expected):
    """Tell a trial of a photon whose light is in row `lane` of `work.f_cos`; all of it is `over` times that.

    Parameters
    ----------
    expected : float32, `expected_photons`
    """
    tried, pixel = work.photons.tried, work.paths.pixel[lane]
    r, g, b = to_rgb(scene.spectrum, work.paths, lane, work.f_cos, lane)
    whole = over * np.float32(1.0 / 3.0)
    tried[pixel, 0] += whole * (r + g + b)
    tried[pixel, 1] += np.float32(3.0) * whole * whole * expected * (r * r + g * g + b * b)
