# SPDX-License-Identifier: GPL-3.0-or-later
"""What Particle Info nodes read: the particles that instances are of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array
from engine.scene.attribute_names import PARTICLE

from .context import ExportContext
from .hashes import hash_to_unit

#: Instances between two looks at whether the export is to stop.
_CANCEL_INTERVAL = 4096


def _random(index: int) -> float:
    return float(hash_to_unit(np.array([index]))[0])


#: By output, of a particle, its index and the frame.
_READ: dict[str, Callable[[Any, int, float], Any]] = {
    "Index": lambda particle, index, frame: index,
    "Random": lambda particle, index, frame: _random(index),
    "Age": lambda particle, index, frame: frame - particle.birth_time,
    "Lifetime": lambda particle, index, frame: particle.lifetime,
    "Location": lambda particle, index, frame: particle.location,
    "Size": lambda particle, index, frame: particle.size,
    "Velocity": lambda particle, index, frame: particle.velocity,
    "Angular Velocity": lambda particle, index, frame: particle.angular_velocity,
}


def read_particles(
    context: ExportContext, reads: npt.NDArray[np.bool_], names: Sequence[str]
) -> dict[str, Float32Array]:
    """Properties of instances, float32 (N, 4) each, in the order of the dependency graph.

    As in Cycles, what is no particle, and children of particles, are particle 0 of which nothing is known.

    Parameters
    ----------
    reads : bool (N,)
        Instances whose materials read them.
    names : sequence of str
        "particle:" and an output's name.
    """
    outputs = [name.removeprefix(PARTICLE) for name in names]
    values = {output: np.zeros((len(reads), 4), np.float32) for output in outputs}
    if "Random" in values:
        values["Random"][:] = _random(0)
    if reads.any():
        frame = context.scene.frame_current + context.scene.frame_subframe
        for number, item in enumerate(context.depsgraph.object_instances):
            if number % _CANCEL_INTERVAL == 0:
                context.check_cancel()
            if not reads[number]:
                continue
            particle, index = _particle_of(item)
            for output in outputs if particle is not None else ():
                values[output][number, :3] = _READ[output](particle, index, frame)
    return {f"{PARTICLE}{output}": value for output, value in values.items()}


def _particle_of(item: bpy.types.DepsgraphObjectInstance) -> tuple[bpy.types.Particle | None, int]:
    """The particle that an instance is of, and its index."""
    system = item.particle_system if item.is_instance else None
    index = item.persistent_id[0] if system is not None else 0
    if system is None or index >= len(system.particles):
        return None, index
    return system.particles[index], index
