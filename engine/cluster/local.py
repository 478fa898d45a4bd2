# SPDX-License-Identifier: GPL-3.0-or-later
"""Workers on this machine, each a process that ends with this one."""

from __future__ import annotations

import os

from engine.cluster.pool import ClusterError
from engine.cluster.work import THREADS_VARIABLE
from engine.processes.child import Child
from engine.processes.interpreter import find_interpreter

_SERVICE = "cluster.service"


class LocalWorkers:
    """So many workers of a scheduler.

    Parameters
    ----------
    address : str
        Address of the scheduler.
    count : int
    threads : int
        Threads of each, 0: its share of the processors.
    certificate, key : str
        By which the scheduler and workers know each other. They go through a pipe: others see a process's arguments.

    Raises
    ------
    ClusterError
        If they cannot be started.
    """

    def __init__(self, address: str, count: int, threads: int, certificate: str, key: str) -> None:
        interpreter = find_interpreter()
        if interpreter is None:
            raise ClusterError("Cluster: there is no Python to start workers with")
        threads = threads or max((os.cpu_count() or 1) // count, 1)
        config = {"address": address, "certificate": certificate, "key": key}
        self._children: list[Child] = []
        try:
            for _ in range(count):
                # Its own path comes first, as on other machines: on that of a process that has loaded Blender another
                # folder is called bpy, and Embree would be another one, which rounds differently.
                child = Child(
                    interpreter, _SERVICE, config, environment={THREADS_VARIABLE: str(threads)}, has_answers=False,
                )
                self._children.append(child)
        except OSError as error:
            self.close()
            raise ClusterError(f"Cluster: a worker could not be started: {error.strerror or error}") from None

    def check(self) -> None:
        """See whether any is alive.

        Raises
        ------
        ClusterError
            If none is, with the reason why the last one ended.
        """
        codes = [child.process.poll() for child in self._children]
        if all(code is not None for code in codes):
            reason = self._children[-1].reason(codes[-1] or 0)
            raise ClusterError(f"Cluster: all workers of this machine have ended; the last one {reason}")

    def close(self) -> None:
        """End them."""
        for child in self._children:
            child.close(is_patient=False)
            child.release()
        self._children = []
