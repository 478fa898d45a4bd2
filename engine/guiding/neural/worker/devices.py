# SPDX-License-Identifier: GPL-3.0-or-later
"""Where networks are trained: by the processor with the engine's kernels, or by a device on which torch does all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch

from engine.array_types import Float32Array, Int64Array
from engine.guiding.neural.worker.faults import DeviceError
from engine.guiding.neural.worker.reservoir import RowReservoir

#: A batch of rows: where training is by the processor, and where it is by a device.
Rows = Float32Array | torch.Tensor


class Device(NamedTuple):
    """Something to train on.

    Attributes
    ----------
    name : str
        For people, and for who asks for it.
    place : str
        Its name in torch.
    is_apart : bool
        Whether rows, tables and the optimiser's state lie there, and torch encodes features and steps tables too.
    """

    name: str
    place: str
    is_apart: bool


PROCESSOR = Device("cpu", "cpu", is_apart=False)
GPU = Device("cuda", "cuda", is_apart=True)


def candidates(wanted: str, *, is_deterministic: bool) -> tuple[Device, ...]:
    """What a network may be trained on here, the processor first where it may do so.

    Parameters
    ----------
    wanted : str
        As the setting `training_device` has it.
    is_deterministic : bool
        The same rows must give the same bits: sums on a device may be taken in any order.

    Raises
    ------
    DeviceError
        If a GPU is asked for and torch finds none.
    """
    if is_deterministic or wanted == "CPU":
        return (PROCESSOR,)
    has_gpu = torch.cuda.is_available()
    if wanted == "CUDA":
        if not has_gpu:
            raise DeviceError(
                "torch finds no CUDA device to train on: set Training Device to Automatic or Processor, or install a "
                "torch with CUDA and a driver for it"
            )
        return (GPU,)
    return (PROCESSOR, GPU) if has_gpu else (PROCESSOR,)


class Choice(NamedTuple):
    """A device, and in words why it was not another one; '': nothing failed."""

    device: Device
    why: str = ""

    @property
    def words(self) -> str:
        """What people are told."""
        return f"{self.device.name} ({self.why})" if self.why else self.device.name


def fastest(devices: Sequence[Device], seconds_of_steps: Callable[[Device], float]) -> Choice:
    """The device whose steps take least, as measured; a single one is taken as it is.

    Parameters
    ----------
    devices : sequence of Device
    seconds_of_steps : callable
        Raises RuntimeError, as torch does, where a device cannot do them. If none can the first one's is raised.
    """
    if len(devices) == 1:
        return Choice(devices[0])
    seconds: dict[Device, float] = {}
    errors: list[tuple[Device, RuntimeError]] = []
    for device in devices:
        try:
            seconds[device] = seconds_of_steps(device)
        except RuntimeError as error:
            errors.append((device, error))
    if not seconds:
        raise errors[0][1]
    why = "; ".join(f"{device.name} failed: {error}" for device, error in errors)
    return Choice(min(seconds, key=lambda device: seconds[device]), why)


class DeviceRows:
    """The rows of a reservoir where they are trained on; copied there when they have changed.

    Parameters
    ----------
    reservoir : RowReservoir
    place : str
    """

    def __init__(self, reservoir: RowReservoir, place: str) -> None:
        self._reservoir, self._place = reservoir, place
        self._version = -1
        self._rows = torch.empty(0)

    def take(self, picks: Int64Array) -> torch.Tensor:
        """Rows by number, in [0, count): a copy on the device."""
        reservoir = self._reservoir
        if self._version != reservoir.version:
            self._rows = torch.from_numpy(reservoir.rows[: reservoir.count]).to(self._place, copy=True)
            self._version = reservoir.version
        return self._rows.index_select(0, torch.from_numpy(picks).to(self._place))
