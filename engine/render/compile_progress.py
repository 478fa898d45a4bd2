# SPDX-License-Identifier: GPL-3.0-or-later
"""How far the compiling of kernels is: while helper processes do it ahead, and where a first call does it."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from engine.runtime.kernel_cache import origins

#: How much the expected speed counts beside the measured one, as if so much had been seen of it [s].
_EXPECTATION = 15.0
#: A part that takes longer than expected is taken to need so much of its time so far on top.
_OVERTIME = 0.1


@dataclass(frozen=True)
class Work:
    """What is to compile: how many kernels, and how long that takes where it was measured [s of one thread]."""

    kernels: int
    seconds: float


@dataclass(frozen=True)
class CompileProgress:
    """How many of the kernels are compiled, and how long the others will take [s]."""

    done: int
    total: int
    remaining: float

    @property
    def fraction(self) -> float:
        """Share of the kernels that are compiled."""
        return self.done / max(self.total, 1)

    @property
    def sentence(self) -> str:
        """As users read it."""
        step = 10 if self.remaining > 30.0 else 5
        left = math.ceil(self.remaining / step) * step  # an estimate, not a clock
        return f"Compiling kernels (once): {self.done} of {self.total} kernels, {left or step} s left"


class CompileClock:
    """Tells how far several steps are, of parts that are compiled side by side.

    Parameters
    ----------
    steps : sequence of dict
        Parts by name and their work, a step after the other; without those that are compiled already.
    processors : int
        More parts than that at a time take as much longer.
    """

    def __init__(self, steps: Sequence[dict[str, Work]], processors: int) -> None:
        self._steps = steps
        self._processors = max(processors, 1)
        self._total = sum(work.kernels for step in steps for work in step.values())

    def progress(self, step: int, done: dict[str, int], seconds: float) -> CompileProgress:
        """Where it stands.

        Parameters
        ----------
        step : int
            Which is being done; those before it are.
        done : dict
            Kernels of its parts that are compiled; of a part that is finished, all of them.
        seconds : float
            Since the step began.
        """
        before = sum(work.kernels for earlier in self._steps[:step] for work in earlier.values())
        counts = {name: min(done.get(name, 0), work.kernels) for name, work in self._steps[step].items()}
        expected = self._expected(step)
        # The machine's slowness, by the part of which most is known.
        known = max(counts[name] / work.kernels * expected[name] for name, work in self._steps[step].items())
        slowness = (seconds + _EXPECTATION) / (known + _EXPECTATION) if known else 1.0
        remaining = 0.0
        for name, work in self._steps[step].items():
            if counts[name] < work.kernels:
                # What takes longer than expected is not over for that.
                remaining = max(remaining, expected[name] * slowness - seconds, _OVERTIME * seconds)
        for later in range(step + 1, len(self._steps)):
            remaining += slowness * max(self._expected(later).values())
        return CompileProgress(before + sum(counts.values()), self._total, remaining)

    def _expected(self, step: int) -> dict[str, float]:
        """Seconds that the parts of a step take side by side."""
        crowd = max(len(self._steps[step]) / self._processors, 1.0)
        return {name: work.seconds * crowd for name, work in self._steps[step].items()}


class FirstCalls:
    """Notices kernels that this process compiles itself, since nobody has before: those of what is new in a scene."""

    def __init__(self) -> None:
        self._before = origins["compiled"]

    def message(self, otherwise: str) -> str:
        """What is being done: compiling, where anything was or is compiled since this object was made."""
        count = origins["compiled"] - self._before
        if not count:
            return otherwise
        return f"Compiling kernels (once) for what is new in this scene: {count} so far"


def report_to(file: Path) -> None:
    """Note in a file that another kernel was compiled."""
    with file.open("ab") as stream:
        stream.write(b".")


def reported(file: Path) -> int:
    """How many were noted."""
    try:
        return os.stat(file).st_size
    except OSError:
        return 0
