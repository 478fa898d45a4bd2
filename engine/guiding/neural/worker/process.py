# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker: a process that serves one training after the other.

It may be started before there is anything to train (`stands_by`), and it stays for the next render when one is over.
Messages in, beside those of a training (`worker/service.py`): `job` (config: the next training's), `stay` (the
renderer counts on this process for longer). Messages out: `left` (a training is over), `failed` (reason). When the
input ends, the process does, and when nobody has trained for `idle_seconds` of the configuration.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import queue
import sys
import threading
from collections.abc import Iterator
from typing import Any, BinaryIO, TextIO

from engine.guiding.neural.worker.faults import DeviceError
from engine.guiding.neural.worker.kinds import warm_up
from engine.guiding.neural.worker.service import Service
from engine.processes.parent import leave_with_parent

_Jobs = queue.SimpleQueue[Service | None]


@contextlib.contextmanager
def _saying_why(answers: TextIO) -> Iterator[None]:
    """Whatever is raised is the end of the process, after it has said so."""
    try:
        yield
        return
    except ModuleNotFoundError as error:
        reason = f"the package {error.name} is not installed for {sys.executable}"
    except DeviceError as error:
        reason = str(error)
    except MemoryError:
        reason = "out of memory"
    except Exception as error:
        # torch reports a failed allocation as a RuntimeError.
        reason = "out of memory" if "alloc" in str(error).lower() else f"{type(error).__name__}: {error}"
    with contextlib.suppress(OSError):
        answers.write(json.dumps({"kind": "failed", "reason": reason}) + "\n")
        answers.flush()
    os._exit(1)


def _listen(stream: BinaryIO, answers: TextIO, jobs: _Jobs, service: Service | None) -> None:
    """Read messages until there are no more (thread); `service` is the training that there is already."""
    with _saying_why(answers):
        for line in stream:
            message = json.loads(line)
            if message["kind"] == "job":
                service = Service(message["config"], answers)
                jobs.put(service)
            elif message["kind"] == "stay":
                jobs.put(None)
            elif service is not None:
                service.hear(message)
    os._exit(0)


def serve(config: dict[str, Any], stream: BinaryIO, answers: TextIO) -> None:
    """Run the worker in this process, and end the process when it has been idle for long."""
    leave_with_parent(config)
    jobs: _Jobs = queue.SimpleQueue()
    with _saying_why(answers):
        first = None if config.get("stands_by") else Service(config, answers)
        jobs.put(first)
        threading.Thread(target=_listen, args=(stream, answers, jobs, first), daemon=True).start()
        if first is None:
            warm_up(config["device"])
        with contextlib.suppress(queue.Empty):
            while True:
                service = jobs.get(timeout=config["idle_seconds"])
                if service is None:
                    continue
                service.run()
                service.close()
                service.answer("left")
                # A training is a quarter of a gigabyte, and in circles.
                first = service = None
                gc.collect()
    # The thread that reads must not be caught by the interpreter's own end.
    os._exit(0)
