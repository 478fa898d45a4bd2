# SPDX-License-Identifier: GPL-3.0-or-later
"""Workers behind a scheduler of Dask: the only module that imports `distributed`.

Who does what is decided by `engine.cluster.crew`: each task is for one worker. Dask carries orders, scenes and sums,
and knows who is there. TLS is its own affair too: its configuration says where certificates lie.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import queue
import time
import uuid
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import dask
from distributed import Client, Future, LocalCluster, Worker

from engine.cluster.local import LocalWorkers
from engine.cluster.pool import ClusterError
from engine.cluster.version import source_version
from engine.cluster.work import FAILED, LOST, REFUSED, Answer, keep, trace

#: Time for a scheduler to answer [s].
_TIMEOUT = 30.0
#: How long to wait for the workers of this machine [s].
_START_TIMEOUT = 120.0
_POLL = 0.1
#: Answers that travel at a time: while some come, others are put on the film.
_FETCHES = 16


class DaskPool:
    """Workers behind a scheduler, as `engine.cluster.pool.Pool`; `open_pool` makes one."""

    def __init__(self, client: Client, local: LocalWorkers | None = None, cluster: LocalCluster | None = None) -> None:
        self._client = client
        self._local = local
        self._cluster = cluster
        self._run = uuid.uuid4().hex[:12]
        self._scene: Future | None = None
        self._learned: Future | None = None
        self._futures: dict[int, Future] = {}
        self._come: queue.SimpleQueue[tuple[int, Answer]] = queue.SimpleQueue()
        self._fetching = ThreadPoolExecutor(_FETCHES, thread_name_prefix="fetch")
        self._submitted = 0
        #: Of the tickets of this pool's many renders, which all count from 0: first key.
        self._keys: dict[int, int] = {}

    @property
    def now(self) -> float:
        """Time [s]."""
        return time.monotonic()

    @property
    def process_ids(self) -> dict[str, int]:
        """Of the workers that were started here, by their address."""
        known: dict[str, int] = self._client.run(_process_id)
        return known

    def hold(self, scene: str, blob: bytes) -> None:
        """Have a scene at hand: one worker holds it, the others fetch it from those that have it by then.

        The scheduler keeps it as well, so that it is there again when its holder is lost.
        """
        self._scene = self._hold(self._scene, "scene", scene, blob)

    def hold_learned(self, learned: str, blob: bytes) -> None:
        """As `hold`, for what orders go by; digest '': nothing."""
        self._learned = self._hold(self._learned, "learned", learned, blob) if learned else None

    def _hold(self, held: Future | None, name: str, digest: str, blob: bytes) -> Future:
        key = f"{name}-{digest}-{self._run}"
        if held is not None and held.key == key:
            return held
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
            made: Future = self._ask(lambda: self._client.submit(keep, blob, key=key))
        return made

    def workers(self) -> frozenset[str]:
        """Addresses of who is connected."""
        if self._local is not None:
            self._local.check()
        return frozenset(self._ask(self._client.nthreads))

    def submit(self, ticket: int, worker: str, order: bytes) -> None:
        """Have a worker do an order."""
        self._submitted += 1
        future = self._client.submit(
            trace, source_version(), order, self._scene, self._learned, key=f"range-{self._run}-{self._submitted}",
            workers=[worker], allow_other_workers=False, pure=False,
        )
        self._futures[ticket] = future
        self._keys[ticket] = key = self._submitted
        future.add_done_callback(lambda done: self._note(ticket, key, done))

    def _note(self, ticket: int, key: int, future: Future) -> None:
        """In a thread of Dask's, which all tasks share: a task is over. A worker that hangs now must not hold it up."""
        if self._keys.get(ticket) == key and future.status != "cancelled":
            with contextlib.suppress(RuntimeError):  # closed meanwhile
                self._fetching.submit(lambda: self._come.put((ticket, _answer(future))))

    def take(self, seconds: float) -> tuple[int, Answer] | None:
        """The next answer."""
        try:
            while True:
                ticket, answer = self._come.get(timeout=max(seconds, 1e-3))
                if self._futures.pop(ticket, None) is not None:
                    self._keys.pop(ticket, None)
                    return ticket, answer
        except queue.Empty:
            return None

    def cancel(self, tickets: list[int]) -> None:
        """Forget tickets."""
        futures = []
        for ticket in tickets:
            self._keys.pop(ticket, None)
            futures.append(self._futures.pop(ticket, None))
        futures = [future for future in futures if future is not None]
        if futures:
            self._ask(lambda: self._client.cancel(futures, force=True))

    def close(self) -> None:
        """Leave the cluster, and end what was started here."""
        self._scene = self._learned = None
        self._futures.clear()
        if self._local is not None:
            self._local.close()
        self._fetching.shutdown(wait=False, cancel_futures=True)
        self._client.close(timeout=2)
        if self._cluster is not None:
            self._cluster.close(timeout=2)

    def _ask(self, question: Any) -> Any:
        try:
            return question()
        except (OSError, TimeoutError) as error:
            reason = error or "no connection"
            raise ClusterError(f"Cluster: the scheduler does not answer any more ({reason})") from None


def _answer(future: Future) -> Answer:
    """What a task that is over has brought."""
    try:
        return Answer(*future.result(timeout=_TIMEOUT))
    except (ImportError, AttributeError) as error:
        return Answer(REFUSED, f"it has no NeuralGuide, or an older one ({error})")
    except (OSError, TimeoutError, asyncio.CancelledError):
        return Answer(LOST, "its sums did not come")
    except Exception as error:
        # Such as that of Dask for sums that were lost with their worker.
        return Answer(FAILED, f"{type(error).__name__}: {error}")


def _process_id() -> int:
    import os

    return os.getpid()


def open_pool(address: str, threads: int = 0) -> DaskPool:
    """Join a cluster, or make one.

    Parameters
    ----------
    address : str
        'local:N' for N workers on this machine; 'tcp://HOST:PORT' or 'tls://HOST:PORT' of a scheduler.
    threads : int
        Of each worker on this machine, 0: its share of the processors.

    Raises
    ------
    ClusterError
        If the scheduler cannot be reached, or workers of this machine do not start.
    """
    logging.getLogger("distributed").setLevel(logging.ERROR)
    # Sums come from the workers themselves, and by way of the scheduler only where these cannot be reached.
    if address.startswith("local:"):
        return _open_local(int(address.removeprefix("local:")), threads)
    try:
        client = Client(address, timeout=_TIMEOUT, set_as_default=False, direct_to_workers=True)
    except (OSError, TimeoutError, ValueError, TypeError) as error:
        raise ClusterError(f"Cluster: no scheduler answers at {address} ({error})") from None
    return DaskPool(client)


def _open_local(count: int, threads: int) -> DaskPool:
    cluster = LocalCluster(
        n_workers=0, processes=True, host="127.0.0.1", protocol="tcp://", dashboard_address=None,
        silence_logs=logging.ERROR,
    )
    client = Client(cluster, set_as_default=False, direct_to_workers=True)
    local = LocalWorkers(cluster.scheduler_address, count, threads)
    pool = DaskPool(client, local, cluster)
    deadline = time.monotonic() + _START_TIMEOUT
    try:
        while len(pool.workers()) < count:
            if time.monotonic() > deadline:
                raise ClusterError(f"Cluster: {count} workers were started, {len(pool.workers())} answer")
            time.sleep(_POLL)
    except BaseException:
        pool.close()
        raise
    return pool


def run_worker(address: str, name: str | None = None) -> None:
    """Be a worker of the scheduler there, until that is gone.

    Raises
    ------
    ClusterError
        If there is no scheduler.
    """
    logging.getLogger("distributed").setLevel(logging.ERROR)
    try:
        asyncio.run(_work(address, name))
    except (OSError, TimeoutError, ValueError, TypeError) as error:
        raise ClusterError(f"no scheduler answers at {address} ({error})") from None


async def _work(address: str, name: str | None) -> None:
    # One range at a time, on all threads. What memory it takes is the engine's affair.
    async with Worker(address, nthreads=1, name=name, memory_limit=0, dashboard=False) as worker:
        await worker.finished()
