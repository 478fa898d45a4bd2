# SPDX-License-Identifier: GPL-3.0-or-later
"""Which training a kind of network has, and how it gets ready."""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.neural.networks.flow.shape import FlowSettings, FlowShape
from engine.guiding.neural.networks.mixture.shape import NPM, MixtureSettings, MixtureShape
from engine.guiding.neural.networks.radiance import COMPACT_SHAPE, NetworkShape, TrainingSettings
from engine.guiding.neural.worker.faults import DeviceError
from engine.guiding.records.training_rows import ROW_WIDTH

if TYPE_CHECKING:
    from engine.guiding.neural.worker.devices import Choice, Device
    from engine.guiding.neural.worker.training import Training

#: Shape and settings by the shape's kind.
KINDS: dict[str, tuple[type, type]] = {
    NetworkShape.kind: (NetworkShape, TrainingSettings),
    MixtureShape.kind: (MixtureShape, MixtureSettings),
    FlowShape.kind: (FlowShape, FlowSettings),
}

#: What workers that stand by rehearse; other shapes are trained by the same kernels.
_USUAL_SHAPES = (COMPACT_SHAPE, NPM)
#: Shapes that this process has rehearsed, each with a device, and the devices that it has chosen.
rehearsed_shapes: set[tuple[Any, Device]] = set()
chosen_devices: dict[tuple[Any, ...], Choice] = {}


#: Times that steps are timed, and how many each time.
_TIMES, _TIMED_STEPS = 2, 4


def make_training(
    shape: Any, settings: Any, seed: int, bounds: Float32Array | None, thread_count: int, device: Device
) -> Training:
    """The training of a shape's kind. Imports torch, which takes seconds."""
    if isinstance(shape, MixtureShape):
        from engine.guiding.neural.worker.mixture_training import MixtureTraining

        return MixtureTraining(shape, settings, seed, bounds, thread_count, device)
    if isinstance(shape, FlowShape):
        from engine.guiding.neural.worker.flow_training import FlowTraining

        return FlowTraining(shape, settings, seed, bounds, thread_count, device)
    from engine.guiding.neural.worker.radiance_training import RadianceTraining

    return RadianceTraining(shape, settings, seed, bounds, thread_count, device)


def choose_device(shape: Any, settings: Any, thread_count: int, *, is_deterministic: bool = False) -> Choice:
    """What a network is trained on, as its settings ask for; where these leave it open, what takes less for its steps,
    as measured once by this process.

    Raises
    ------
    DeviceError
        If it is not there.
    """
    from engine.guiding.neural.worker.devices import candidates, fastest

    devices = candidates(settings.device, is_deterministic=is_deterministic)
    case = shape, settings.batch_size, devices
    if case not in chosen_devices:

        def seconds_of_steps(device: Device) -> float:
            return _seconds_of_steps(_rehearsal(shape, settings, thread_count, device))

        chosen_devices[case] = fastest(devices, seconds_of_steps)
    return chosen_devices[case]


def rehearse(shape: Any, settings: Any, thread_count: int, device: Device) -> None:
    """Have a training that is not used for anything else load (or compile) all its kernels; once for each shape."""
    if (shape, device) not in rehearsed_shapes:
        _rehearsal(shape, settings, thread_count, device)


def _rehearsal(shape: Any, settings: Any, thread_count: int, device: Device) -> Training:
    """A training that has called all that trainings call."""
    training = make_training(shape, settings, 0, None, thread_count, device)
    row_width = shape.row_width
    rows = np.random.default_rng(0).uniform(0.1, 1.0, (256, row_width)).astype(np.float32)
    for first in range(3, 12 if row_width == ROW_WIDTH else 6, 3):
        rows[:, first : first + 3] /= np.linalg.norm(rows[:, first : first + 3], axis=1, keepdims=True)
    training.add(rows)
    training.step()
    training.improvement()
    training.snapshot()
    rehearsed_shapes.add((shape, device))
    return training


def _seconds_of_steps(training: Training) -> float:
    """What some steps take, once everything is loaded [s]."""
    least = math.inf
    for _ in range(_TIMES):
        began = time.perf_counter()
        for _ in range(_TIMED_STEPS):
            training.step()
        # A device is through with its steps when the parameters are here.
        training.snapshot()
        least = min(least, time.perf_counter() - began)
    return least


def warm_up(wanted: str) -> None:
    """Import torch, and load the kernels of the usual trainings by training a little: all of it takes seconds.

    Parameters
    ----------
    wanted : str
        Device, as `TrainingSettings` has it.
    """
    # What is missing matters to whoever trains, who will hear of it.
    with contextlib.suppress(ImportError, DeviceError):
        for shape in _USUAL_SHAPES:
            settings = replace(shape.training_settings, device=wanted)
            rehearse(shape, settings, 1, choose_device(shape, settings, 1).device)
