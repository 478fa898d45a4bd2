# SPDX-License-Identifier: GPL-3.0-or-later
"""Iterations, and the bridges between them (`engine.render.bridge`), as one schedule.

A bridge is handed out behind the iteration that is learned from, so that no thread waits for that one's last tasks, and
ahead of the iteration that follows. A tile of this one begins when its own bridge is traced: pixels get their samples
in the same order, whatever ends first.
"""

from __future__ import annotations

from collections.abc import Sequence

from engine.guiding.policy.trial import ArmSamples
from engine.render.bridge import Bridge
from engine.render.schedule import Iterations, Task
from engine.state.unit import BRIDGE


class BridgedIterations:
    """A schedule of both.

    Parameters
    ----------
    iterations : Iterations
    bridge : Bridge
    """

    def __init__(self, iterations: Iterations, bridge: Bridge) -> None:
        self._iterations, self._bridge = iterations, bridge
        #: Whether the bridge leads to the iteration that is handed out, and does not come behind it.
        self._leads = False
        #: Samples a pixel of the bridge to the iteration that is planned; None: nobody has thought of it yet.
        self.bridged: int | None = None
        self.plan = iterations.plan

    @property
    def is_whole(self) -> bool:
        """Whether samples of the iteration that is planned lie in all of u."""
        return self._iterations.is_whole

    @property
    def next_sample(self) -> int:
        """Samples a pixel by the end of the iteration."""
        return self._iterations.next_sample

    @property
    def in_hand(self) -> tuple[int, int]:
        """As of `Iterations`."""
        return self._iterations.in_hand

    @property
    def lacks_bridge(self) -> bool:
        """Whether only the iteration's last tasks are out, and nobody has thought of the bridge yet."""
        return self.bridged is None and not (self._iterations.has_task or self._iterations.is_over)

    def begin_bridge(self, first: int, tile_count: int, weight: float) -> None:
        """Hand out `bridged` samples of each tile from sample `first` on, behind what is left of the iteration."""
        assert self.bridged
        self._leads = False
        self._bridge.begin(first, self.bridged, tile_count, weight)

    def begin(
        self, arms: Sequence[ArmSamples], tile_count: int, other_arms: Sequence[ArmSamples] = (), first_other: int = 0
    ) -> None:
        """Hand out the iteration that is planned (`Iterations.begin`), behind what is left of its bridge."""
        self._leads, self.bridged = True, None
        self._iterations.begin(arms, tile_count, other_arms, first_other)

    @property
    def has_task(self) -> bool:
        return self._bridge.has_task or self._can_go_on

    @property
    def _can_go_on(self) -> bool:
        iterations = self._iterations
        return iterations.has_task and not (self._leads and not self._bridge.has_traced(iterations.next_tile))

    @property
    def lacks_first_tasks(self) -> bool:
        return self._iterations.lacks_first_tasks

    def take(self) -> Task:
        if self._bridge.has_task and (self._leads or not self._can_go_on):
            return self._bridge.take()
        return self._iterations.take()

    def clear(self) -> None:
        self._bridge.clear()
        self._iterations.clear()

    def finish(self, task: Task) -> bool:
        return (self._bridge if task.arm_samples.arm == BRIDGE else self._iterations).finish(task)
