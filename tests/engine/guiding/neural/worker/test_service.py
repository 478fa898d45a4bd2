# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker's loop with a stand-in for training: when it trains and when it rests."""

from __future__ import annotations

import math
import threading

import pytest

from engine.guiding.neural.networks.radiance import TrainingSettings
from engine.guiding.neural.worker.patience import Patience
from engine.guiding.neural.worker.service import Service

#: Steps between two submissions of rows, no multiple of those between two checks.
ROWS_EVERY = 100


class Rested(Exception):
    """The loop waits for messages."""


class StubTraining:
    """Always has rows enough; gains `gain` from one check to the next."""

    can_train = True
    loss = 0.0
    looks_worth = math.inf

    def __init__(self, gain):
        self.gain = gain
        self.step_count = 0
        self.has_reference = False

    def step(self):
        self.step_count += 1
        if self.step_count >= 5000:
            raise TimeoutError

    def improvement(self):
        had, self.has_reference = self.has_reference, True
        return self.gain if had else math.inf


class StubService(Service):
    """Rows come every `ROWS_EVERY` steps; nobody listens."""

    def __init__(self, gain):
        self.training = StubTraining(gain)
        self.settings = TrainingSettings()
        self.submission_count = 0
        self.is_over = threading.Event()

    def take_pending(self):
        if self.training.step_count < self.submission_count * ROWS_EVERY:
            return False
        self.submission_count += 1
        self.training.has_reference = False
        return True

    def publish(self):
        pass

    def report(self, state):
        pass

    def wait(self, seconds):
        raise Rested


@pytest.mark.parametrize("gain, is_to_rest", [(0.0, True), (0.1, False)])
def test_training_that_gains_nothing_rests_though_rows_come(gain, is_to_rest):
    service = StubService(gain)
    with pytest.raises(Rested if is_to_rest else TimeoutError):
        service.train_freely(1.0)
    assert not is_to_rest or service.training.step_count < 1000


def test_rows_wake_training_for_one_check():
    patience = Patience()
    for _ in range(3):
        assert not patience.is_resting
        patience.check(0.0)
    assert patience.is_resting
    patience.wake()
    patience.check(math.inf)
    assert not patience.is_resting
    patience.check(0.0)
    assert patience.is_resting
    patience.wake()
    patience.check(0.1)
    patience.wake()
    for _ in range(2):
        patience.check(0.0)
    assert not patience.is_resting
    patience.check(-math.inf)
    assert patience.is_resting
