# SPDX-License-Identifier: GPL-3.0-or-later
"""What a worker has said, and how training stands by that."""

from __future__ import annotations

import dataclasses
import enum
import math
import threading
import time
from dataclasses import dataclass
from typing import Any

from engine.guiding.neural.trainer.channel import SLOT_COUNT


class TrainerState(enum.Enum):
    """What the worker is doing."""

    OFF = "not started"
    STARTING = "starting"
    WAITING = "waiting for light"
    TRAINING = "training"
    IDLE = "done with what there is"
    DEAD = "dead"


@dataclass(frozen=True)
class TrainerStatus:
    """How training stands.

    state, message : and why, if it is dead
    device : 'cpu' or 'cuda', and why it was not another; empty before it is known
    step, loss : of the network in training
    seconds : of processor time that the worker has used
    submitted_rows, rejected_rows : records that went to the worker, and those not fit to
    dropped_submissions : calls of `submit` that found the worker behind
    refused_snapshots : torn or not valid
    """

    state: TrainerState = TrainerState.OFF
    message: str = ""
    device: str = ""
    step: int = 0
    loss: float = math.nan
    seconds: float = 0.0
    submitted_rows: int = 0
    rejected_rows: int = 0
    dropped_submissions: int = 0
    refused_snapshots: int = 0

    @property
    def words(self) -> str:
        """What the worker is doing, on what and why, for reports."""
        place = f"on {self.device}" if self.device else ""
        return " ".join(word for word in (self.state.value, self.message, place) if word)


class WorkerNews:
    """What one worker has said, for any number of threads.

    Parameters
    ----------
    start_timeout, answer_timeout : float [s]
        Silence after which the worker counts as hung, while it starts and later.

    Attributes
    ----------
    changed : threading.Condition
        Guards the rest, and may be taken twice by a thread; it is notified at every message.
    status : TrainerStatus
    free_slots : set of int
        Of the channel, that records can be written to.
    announced : (int, int) or None
        Slot and version of the newest snapshot that was not read.
    trained_step : int
        That the worker was told to train to and has reached; -1: not yet.
    """

    def __init__(self, start_timeout: float, answer_timeout: float) -> None:
        self.changed = threading.Condition()
        self.status = TrainerStatus()
        self.free_slots = set(range(SLOT_COUNT))
        self.announced: tuple[int, int] | None = None
        self.trained_step = -1
        self._start_timeout, self._answer_timeout = start_timeout, answer_timeout
        self._last_message = 0.0

    @property
    def is_dead(self) -> bool:
        """Whether nothing more will come."""
        return self.status.state is TrainerState.DEAD

    def note(self, **fields: Any) -> None:
        """Change the status."""
        with self.changed:
            self.status = dataclasses.replace(self.status, **fields)
            self.changed.notify_all()

    def begin(self) -> bool:
        """The worker is started; False if it was before."""
        with self.changed:
            if self.status.state is not TrainerState.OFF:
                return False
            self._last_message = time.monotonic()
            self.note(state=TrainerState.STARTING)
        return True

    def take(self, message: dict[str, Any]) -> None:
        """Take a message.

        Raises
        ------
        KeyError, ValueError, TypeError
            If it is none.
        """
        with self.changed:
            self._last_message = time.monotonic()
            kind = message["kind"]
            if self.is_dead:
                return
            if kind == "ready":
                self.note(state=TrainerState.WAITING, device=message["device"])
            elif kind == "free":
                self.free_slots.add(int(message["slot"]))
            elif kind == "progress":
                self.note(
                    state=TrainerState[message["state"]],
                    step=int(message["step"]),
                    loss=float(message["loss"]),
                    seconds=float(message["seconds"]),
                )
            elif kind == "snapshot":
                self.announced = int(message["slot"]), int(message["version"])
            elif kind == "trained":
                self.trained_step = int(message["step"])
            elif kind == "failed":
                self.note(state=TrainerState.DEAD, message=f"the training worker gave up: {message['reason']}")
            self.changed.notify_all()

    def silence(self) -> float:
        """Seconds for which a worker that counts as hung has said nothing; 0: it is well, or there is none."""
        with self.changed:
            state = self.status.state
            if state in (TrainerState.OFF, TrainerState.DEAD):
                return 0.0
            limit = self._start_timeout if state is TrainerState.STARTING else self._answer_timeout
            silence = time.monotonic() - self._last_message
        return silence if silence > limit else 0.0
