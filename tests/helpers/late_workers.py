# SPDX-License-Identifier: GPL-3.0-or-later
"""Workers that leave their cores to other tests at first.

.ci/run begins the slow tests when the first of the two Pythons is done, on its half of the cores. The other half of the
workers runs nothing until the other Python is done too; until then the first half steals what is theirs.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

#: Names the file whose coming says that all cores are free.
VARIABLE = "NEURALGUIDE_LATE_WORKERS"


def wait_for_a_core() -> None:
    """Return when this worker may run tests: at once, if it is of the first half, or nobody has to wait."""
    free = os.environ.get(VARIABLE)
    if not free or not _is_late():
        return
    # For as long as the other tests take, which have limits of their own.
    while not Path(free).exists():
        time.sleep(0.5)


def _is_late() -> bool:
    """Whether this is a worker of the second half, which is the smaller one."""
    worker, count = os.environ.get("PYTEST_XDIST_WORKER", ""), os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")
    return worker.startswith("gw") and int(worker[2:]) >= (int(count) + 1) // 2
