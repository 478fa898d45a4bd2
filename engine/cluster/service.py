# SPDX-License-Identifier: GPL-3.0-or-later
"""A worker on the coordinator's machine, as `engine.processes` starts it."""

from __future__ import annotations

import os
import sys
import threading
import traceback
from typing import Any, BinaryIO, TextIO

from engine.processes.parent import leave_with_parent


def serve(config: dict[str, Any], stream: BinaryIO, _answers: TextIO) -> None:
    """Work until the coordinator closes the stream, or ends."""
    leave_with_parent(config)
    threading.Thread(target=_leave_with, args=(stream,), name="messages", daemon=True).start()
    try:
        from engine.cluster.dask_pool import run_local_worker

        run_local_worker(config["address"], config["certificate"], config["key"])
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    # A range may be in work.
    os._exit(1)


def _leave_with(stream: BinaryIO) -> None:
    stream.read()
    os._exit(0)
