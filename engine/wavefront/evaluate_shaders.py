# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: run shader programs at points, the same kernel for surfaces, light samples, background and shadow hits.

It lives with the other kernels because the shader compiler folds constants with it; `memory` is a thread's
`allocate_memory(shaders)`.
"""

from engine.kernels.shader.interpreter import evaluate_shaders
from engine.state.shaders import (
    MODE_CLOSURES,
    MODE_EMISSION,
    MODE_MEDIUM,
    MODE_NO_REFLECTIVE_CAUSTICS,
    MODE_NO_REFRACTIVE_CAUSTICS,
    MODE_TRANSPARENCY,
    allocate_memory,
)

__all__ = [
    "MODE_CLOSURES",
    "MODE_EMISSION",
    "MODE_MEDIUM",
    "MODE_NO_REFLECTIVE_CAUSTICS",
    "MODE_NO_REFRACTIVE_CAUSTICS",
    "MODE_TRANSPARENCY",
    "allocate_memory",
    "evaluate_shaders",
]
