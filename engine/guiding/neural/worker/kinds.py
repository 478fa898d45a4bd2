# SPDX-License-Identifier: GPL-3.0-or-later
"""Which training a kind of network has, and how it gets ready."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.neural.networks.flow.shape import FlowSettings, FlowShape
from engine.guiding.neural.networks.mixture.shape import NPM, MixtureSettings, MixtureShape
from engine.guiding.neural.networks.radiance import COMPACT_SHAPE, NetworkShape, TrainingSettings
from engine.guiding.records.training_rows import ROW_WIDTH

#: Shape and settings by the shape's kind.
KINDS: dict[str, tuple[type, type]] = {
    NetworkShape.kind: (NetworkShape, TrainingSettings),
    MixtureShape.kind: (MixtureShape, MixtureSettings),
    FlowShape.kind: (FlowShape, FlowSettings),
}

#: What workers that stand by rehearse; other shapes are trained by the same kernels.
_USUAL_SHAPES = (COMPACT_SHAPE, NPM)
#: Shapes that this process has rehearsed.
_rehearsed: set[Any] = set()


def make_training(
    shape: Any, settings: Any, seed: int, bounds: Float32Array | None, thread_count: int, is_deterministic: bool
) -> tuple[Any, str]:
    """The training of a shape's kind, and the device it runs on. Imports torch, which takes seconds."""
    if isinstance(shape, MixtureShape):
        from engine.guiding.neural.worker.mixture_training import MixtureTraining

        # Lobes and grids are small work for many kernels: a GPU would mostly wait.
        return MixtureTraining(shape, settings, seed, bounds, thread_count), "cpu"
    if isinstance(shape, FlowShape):
        from engine.guiding.neural.worker.flow_training import FlowTraining

        return FlowTraining(shape, settings, seed, bounds, thread_count), "cpu"
    import torch

    from engine.guiding.neural.worker.radiance_training import RadianceTraining

    device = "cuda" if not is_deterministic and torch.cuda.is_available() else "cpu"
    return RadianceTraining(shape, settings, seed, bounds, thread_count, device), device


def rehearse(
    shape: Any, settings: Any, seed: int, bounds: Float32Array | None, thread_count: int, is_deterministic: bool
) -> None:
    """Have a training that is not used for anything else load (or compile) all its kernels; once for each shape."""
    if shape in _rehearsed:
        return
    training, _ = make_training(shape, settings, seed, bounds, thread_count, is_deterministic)
    row_width = shape.row_width
    rows = np.random.default_rng(0).uniform(0.1, 1.0, (256, row_width)).astype(np.float32)
    for first in range(3, 12 if row_width == ROW_WIDTH else 6, 3):
        rows[:, first : first + 3] /= np.linalg.norm(rows[:, first : first + 3], axis=1, keepdims=True)
    training.add(rows)
    training.step()
    training.improvement()
    training.snapshot()
    _rehearsed.add(shape)


def warm_up() -> None:
    """Import torch, and load the kernels of the usual trainings by training a little: all of it takes seconds."""
    # What is missing matters to whoever trains, who will hear of it.
    with contextlib.suppress(ImportError):
        for shape in _USUAL_SHAPES:
            rehearse(shape, shape.training_settings, 0, None, 1, True)
