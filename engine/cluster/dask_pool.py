# SPDX-License-Identifier: GPL-3.0-or-later
"""Workers behind a scheduler of Dask.

`engine.cluster.dispatcher` decides who does what: each task is for one worker. Dask carries orders, scenes and
sums, and knows who is there. Who may come in is the affair of `engine.cluster.encryption`.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import queue
import time
import uuid
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import dask
from distributed import Client, Future, LocalCluster, Security, Worker

from engine.cluster.encryption import (
    LOOPBACK,
    check_encryption,
    listening_host,
    shared_security,
    throwaway_certificate,
)
from engine.cluster.local import LocalWorkers
from engine.cluster.place import Place
from engine.cluster.pool import ClusterError
from engine.cluster.work import FAILED, LOST, REFUSED, Answer, keep, trace
from engine.runtime.source_version import source_version

#: Time for sums to come [s].
_TIMEOUT = 30.0
#: Time for a scheduler to answer whoever renders [s]; workers, which may be started before it, have Dask's time.
_ANSWER_TIMEOUT = 10.0
#: Sums come from the workers themselves, and by way of the scheduler only where these cannot be reached.
_CLIENT_OPTIONS: dict[str, Any] = {"set_as_default": False, "direct_to_workers": True}
#: How long to wait for the workers of this machine [s].
_START_TIMEOUT = 120.0
_POLL = 0.1
#: Whoever has not been heard of for so long hangs [s]. Workers say that they are there every half second, a thousand of
#: them every five.
_SILENCE = 15.0
#: They are found to hang after so many roll calls, none longer than this after the last [s]: a machine that has slept
#: hears of nobody at first.
_SILENT_ROLL_CALLS, _REGULAR = 4, 2.0
#: Answers that travel at a time: while some come, others are put on the film.
_FETCHES = 16


class DaskPool:
    """Workers behind a scheduler, as `engine.cluster.pool.Pool`; `open_pool` makes one.

    Whoever holds something that others fetch may hang meanwhile or go away, and they would wait for ever. So a worker
    that is not heard of counts as gone until it is. At each roll call the scheduler is asked where what is held is;
    where that is no good (`Place.is_safe`), it is held anew by those who are there, under another key, and orders that
    may wait for the old one are given out again.
    """

    def __init__(
        self, client: Client, local: LocalWorkers | None = None, cluster: LocalCluster | None = None,
        silence: float = _SILENCE,
    ) -> None:
        self._client = client
        self._local = local
        self._cluster = cluster
        self._run = uuid.uuid4().hex[:12]
        self._silence = silence
        #: What is held: digests and contents by name, and the newest futures of them.
        self._contents: dict[str, tuple[str, bytes]] = {}
        self._held: dict[str, Future] = {}
        #: Counts how often it had to be held anew.
        self._generation = 0
        #: Roll calls in which a worker was silent, those that hang, and when they were counted.
        self._silent_calls: Counter[str] = Counter()
        self._hanging: frozenset[str] = frozenset()
        self._counted = 0.0
        #: By ticket: what was submitted, and to whom.
        self._orders: dict[int, tuple[str, bytes]] = {}
        self._futures: dict[int, Future] = {}
        self._come: queue.SimpleQueue[tuple[int, Answer]] = queue.SimpleQueue()
        self._fetching = ThreadPoolExecutor(_FETCHES, thread_name_prefix="fetch")
        self._submitted = 0
        #: First key of each render of this pool: tickets of every render count from 0.
        self._keys: dict[int, int] = {}

    @property
    def now(self) -> float:
        """Time [s]."""
        return time.monotonic()

    @property
    def process_ids(self) -> dict[str, int]:
        """Process identifiers of the workers that were started here, by their address."""
        known: dict[str, int] = self._client.run(_process_id)
        return known

    def hold(self, scene: str, blob: bytes) -> None:
        """Have a scene at hand: one worker holds it, the others fetch it from those that have it by then.

        The scheduler keeps it as well, so that it is there again when its holder is lost.
        """
        self._hold("scene", scene, blob)

    def hold_learned(self, learned: str, blob: bytes) -> None:
        """As `hold`, for what orders go by; digest '': nothing."""
        if learned:
            self._hold("learned", learned, blob)
        else:
            self._contents.pop("learned", None)
            self._held.pop("learned", None)

    def _hold(self, name: str, digest: str, blob: bytes) -> None:
        key = f"{name}-{digest}-{self._run}-{self._generation}"
        held = self._held.get(name)
        if held is not None and held.key == key:
            return
        self._contents[name] = digest, blob
        whom: dict[str, Any] = {}
        present = self._connected() - self._hanging if self._hanging else frozenset()
        if present:
            whom = {"workers": sorted(present), "allow_other_workers": False}
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
            self._held[name] = self._ask(lambda: self._client.submit(keep, blob, key=key, **whom))

    def _connected(self) -> frozenset[str]:
        return frozenset(self._ask(self._client.nthreads))

    def workers(self) -> frozenset[str]:
        """Addresses of who is connected, and does not hang."""
        if self._local is not None:
            self._local.check()
        keys = {name: held.key for name, held in self._held.items()}
        ages, known = self._ask(lambda: self._client.run_on_scheduler(_roll_call(), keys=list(keys.values())))
        is_regular, self._counted = self.now - self._counted < _REGULAR, self.now
        for name, age in ages.items():
            is_silent = is_regular and age > self._silence
            self._silent_calls[name] = self._silent_calls[name] + 1 if is_silent else 0
        self._hanging = frozenset(name for name in ages if self._silent_calls[name] >= _SILENT_ROLL_CALLS)
        present = frozenset(ages) - self._hanging
        # What the scheduler does not know is still on its way there.
        places = [_place(*known[key]) if key in known else Place() for key in keys.values()]
        if present and not all(place.is_safe(present) for place in places):
            self._hold_anew(present, frozenset.intersection(*(place.holders for place in places)))
        return present

    @property
    def holders(self) -> frozenset[str]:
        """Addresses of who has all that is held."""
        found = self._ask(lambda: self._client.who_has(list(self._held.values())))
        return frozenset.intersection(*(frozenset(names) for names in found.values()))

    def _hold_anew(self, present: frozenset[str], have_all: frozenset[str]) -> None:
        """Have those who are there hold what is held, and give out again what may wait for it."""
        self._generation += 1
        for name, (digest, blob) in list(self._contents.items()):
            self._hold(name, digest, blob)
        for ticket, (worker, order) in list(self._orders.items()):
            if worker in present and worker not in have_all:
                self.cancel([ticket])
                self.submit(ticket, worker, order)

    def submit(self, ticket: int, worker: str, order: bytes) -> None:
        """Have a worker do an order."""
        self._submitted += 1
        scene, learned = self._held["scene"], self._held.get("learned")
        future = self._client.submit(
            trace, source_version(), order, scene, learned, key=f"range-{self._run}-{self._submitted}",
            workers=[worker], allow_other_workers=False, pure=False,
        )
        self._futures[ticket] = future
        self._orders[ticket] = worker, order
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
                    self._forget(ticket)
                    return ticket, answer
        except queue.Empty:
            return None

    def _forget(self, ticket: int) -> None:
        self._keys.pop(ticket, None)
        self._orders.pop(ticket, None)

    def cancel(self, tickets: list[int]) -> None:
        """Forget tickets."""
        futures = []
        for ticket in tickets:
            self._forget(ticket)
            futures.append(self._futures.pop(ticket, None))
        futures = [future for future in futures if future is not None]
        if futures:
            self._ask(lambda: self._client.cancel(futures, force=True))

    def close(self) -> None:
        """Leave the cluster, and end what was started here."""
        for known in (self._held, self._contents, self._orders, self._futures):
            known.clear()
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
    return os.getpid()


def _roll_call() -> Any:
    """What a scheduler is asked: how long ago each worker was heard of [s], and of those keys that it knows their
    state, who has each, who makes it, and who may. By value: it need not know this engine.
    """

    def call(dask_scheduler: Any, keys: list[str]) -> tuple[dict[str, float], dict[str, tuple[Any, ...]]]:
        import time

        now = time.time()
        ages = {name: now - worker.last_seen for name, worker in dask_scheduler.workers.items()}
        tasks = {key: dask_scheduler.tasks[key] for key in keys if key in dask_scheduler.tasks}
        known = {
            key: (
                task.state, [worker.address for worker in task.who_has or ()],
                task.processing_on.address if task.processing_on else "", list(task.worker_restrictions or ()),
            )
            for key, task in tasks.items()
        }
        return ages, known

    return call


def _place(state: str, holders: list[str], maker: str, allowed: list[str]) -> Place:
    return Place(frozenset(holders), maker, frozenset(allowed), state == "erred")


def open_pool(address: str, threads: int = 0, silence: float = _SILENCE) -> DaskPool:
    """Join a cluster, or make one.

    Parameters
    ----------
    address : str
        'local:N' for N workers on this machine; 'tcp://HOST:PORT' or 'tls://HOST:PORT' of a scheduler.
    threads : int
        Threads of each worker on this machine, 0: its share of the processors.
    silence : float
        Time [s] after which a worker hangs that is not heard of.

    Raises
    ------
    ClusterError
        If the scheduler cannot be reached, certificates are missing, or workers of this machine do not start.
    """
    logging.getLogger("distributed").setLevel(logging.ERROR)
    if address.startswith("local:"):
        return _open_local(int(address.removeprefix("local:")), threads, silence)
    check_encryption(address, "client")
    try:
        client = Client(address, timeout=_ANSWER_TIMEOUT, **_CLIENT_OPTIONS)
    except (OSError, TimeoutError, ValueError, TypeError) as error:
        raise ClusterError(f"Cluster: no scheduler answers at {address} ({error})") from None
    return DaskPool(client, silence=silence)


def _open_local(count: int, threads: int, silence: float) -> DaskPool:
    # Whoever else uses this machine reaches these ports too.
    certificate, key = throwaway_certificate()
    # Who is silent for long is not shut out by Dask: the pool sees to it, and he may come back.
    with dask.config.set({"distributed.scheduler.http.routes": [], "distributed.scheduler.worker-ttl": None}):
        cluster = LocalCluster(
            n_workers=0, processes=True, host=LOOPBACK, protocol="tls://", security=shared_security(certificate, key),
            dashboard_address=f"{LOOPBACK}:0", scheduler_kwargs={"dashboard": False}, silence_logs=logging.ERROR,
        )
    client = Client(cluster, **_CLIENT_OPTIONS)
    local = LocalWorkers(cluster.scheduler_address, count, threads, certificate, key)
    pool = DaskPool(client, local, cluster, silence)
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


def run_worker(
    address: str, host: str | None = None, name: str | None = None, *, trusts_network: bool = False,
    on_listening: Callable[[str], None] = lambda address: None,
) -> None:
    """Be a worker of the scheduler there, until that is gone.

    Parameters
    ----------
    address : str
        Address of the scheduler.
    host, trusts_network
        As `engine.cluster.encryption.listening_host` takes them.
    name : str, optional
        Under which the scheduler lists it.
    on_listening : callable(str)
        Told the address that the worker listens on.

    Raises
    ------
    ClusterError
        If there is no scheduler, certificates are missing, or others could come in without one.
    """
    check_encryption(address, "worker")
    try:
        chosen = listening_host(address, host, trusts_network=trusts_network)
        asyncio.run(_work(address, chosen, Security(), name, on_listening))
    except ClusterError:
        raise
    except (OSError, TimeoutError, ValueError, TypeError) as error:
        raise ClusterError(f"no scheduler answers at {address} ({error})") from None


def run_local_worker(address: str, certificate: str, key: str) -> None:
    """Be a worker of the scheduler of this machine that has this certificate, until that is gone."""
    asyncio.run(_work(address, LOOPBACK, shared_security(certificate, key)))


async def _work(
    address: str, host: str, security: Security, name: str | None = None,
    on_listening: Callable[[str], None] = lambda address: None,
) -> None:
    logging.getLogger("distributed").setLevel(logging.ERROR)
    # One range at a time, on all threads. What memory it takes is the engine's affair. Dask's pages about a worker have
    # no certificate: nobody is served any, and on this machine only.
    with dask.config.set({"distributed.worker.http.routes": []}):
        async with Worker(
            address, nthreads=1, name=name, memory_limit=0, dashboard=False, host=host, security=security,
            dashboard_address=f"{LOOPBACK}:0",
        ) as worker:
            on_listening(worker.listen_address)
            await worker.finished()
