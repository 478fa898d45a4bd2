# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays of built scenes by name, and which of two scenes' are not the same."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.builder.scene import Scene


def scene_arrays(scene: Scene) -> dict[str, np.ndarray]:
    """All arrays of a scene by name, and its other facts as arrays."""
    found: dict[str, np.ndarray] = {
        "world_program": np.array(scene.world_program),
        "has_transparent_shadows": np.array(scene.has_transparent_shadows),
        **{f"camera.{name}": array for name, array in scene.camera._asdict().items()},
    }
    for name in ("geometry", "shaders", "lights", "bake"):
        found |= _parts(name, getattr(scene, name))
    return found | _parts("media", scene.media.arrays)


def _parts(name: str, value: Any) -> dict[str, np.ndarray]:
    """The arrays of a bundle and of the bundles in it, by name."""
    if not hasattr(value, "_asdict"):
        return {name: np.asarray(value)}
    found: dict[str, np.ndarray] = {}
    for part, inner in value._asdict().items():
        found |= _parts(f"{name}.{part}", inner)
    return found


def different_arrays(a: Scene, b: Scene) -> list[str]:
    """Names of arrays that are not equal to the bit."""
    first, second = scene_arrays(a), scene_arrays(b)
    assert first.keys() == second.keys()
    return [
        name for name in first
        if first[name].shape != second[name].shape or first[name].tobytes() != second[name].tobytes()
    ]
