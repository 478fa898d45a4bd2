# SPDX-License-Identifier: GPL-3.0-or-later
"""One render by a cluster's workers: ranges are handed out, come back, and are handed out again where they do not."""

from __future__ import annotations

from collections import Counter, deque
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from engine.cluster.dispatcher import Dispatcher, Ticket
from engine.cluster.pool import ClusterError, Pool
from engine.cluster.ranges import RangeCutter, TaskRange, tiles_in_range
from engine.cluster.work import LOST, REFUSED, SUMS, Answer, Order, digest_of, pack, pack_guidance, unpack_traced
from engine.guiding.policy.guidance import Guidance
from engine.render.batch import Statistics
from engine.render.film import Film
from engine.render.loop_job import RenderLoopJob
from engine.render.render_loop import RenderLoop
from engine.render.report import Progress
from engine.render.traced import TracedTiles
from engine.scene.description import Notice
from engine.state.unit import BRIDGE, CURRENT

#: Least time that a range may take before others are asked for it as well [s].
PATIENCE = 20.0
#: A range of so many paths is not too small for what sending it costs.
MOST_PATHS = 1 << 22
#: A range that has failed so often, or taken so many workers with it, is not tried again.
_MOST_FAILURES = 3
#: Workers are counted so often [s].
_ROLL_CALL = 0.5
#: How long workers may wait for what is learned to be noticed [s].
_LEARNING_POLL = 0.01


class ClusterJob(RenderLoopJob):
    """One render, as `engine.render.job.AnyJob`; all but learning happens in the thread that calls `wait`.

    Between iterations it learns here, from what all workers have recorded, in the order of the tiles. What is learned
    has a digest; orders name it, and workers fetch what they do not have.

    Parameters
    ----------
    pool : Pool
        That holds the scene.
    scene : str
        Digest of the description.
    loop : RenderLoop
        Which tells `follow` what tasks go by.
    patience : float
        Least time [s] that a range may take before others are asked for it as well.
    """

    prepare_seconds = 0.0
    is_preparing = False

    def __init__(self, pool: Pool, scene: str, loop: RenderLoop, patience: float = PATIENCE) -> None:
        self.film: Film = loop.film
        self.render_seconds = 0.0
        self._notices: list[Notice] = []
        self._pool, self._scene, self._loop = pool, scene, loop
        self._dispatcher = Dispatcher(patience)
        self._cutter = RangeCutter(loop)
        #: Of bridges, and of all else.
        self._statistics = {is_bridge: Statistics() for is_bridge in (False, True)}
        self._failures: Counter[int] = Counter()
        self._left_out: set[str] = set()
        self._is_stopped = False
        self._counted = float("-inf")
        #: Ranges that have not come, by number; and those of them that are to be handed out again.
        self._open: dict[int, TaskRange] = {}
        self._waiting: deque[TaskRange] = deque()
        #: Learns while the thread that calls `wait` goes on asking who is there.
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="learn")
        self._learning: Future[None] | None = None
        #: What tasks go by, packed, and weights of pixels: those of the arm BRIDGE, and all others.
        self._learned = {is_bridge: ("", b"") for is_bridge in (False, True)}
        self._weights: dict[bool, np.ndarray | None] = {False: None, True: None}

    # -- as a session sees it -----------------------------------------------------------------------------------------

    @property
    def notices(self) -> list[Notice]:
        """What users should know of how it went."""
        return [*self._notices, *super().notices]

    def follow(self, guidance: Guidance, arm: int) -> None:
        """Take what tasks go by from now on: those of the arm BRIDGE, or all others."""
        if arm == BRIDGE:
            # Workers have it: it is what they went by, and what is not asked for they do not record.
            self._learned[True] = self._learned[False]
        else:
            blob = pack_guidance(guidance)
            self._learned[False] = digest_of(blob), blob
        self._weights[arm == BRIDGE] = guidance.newest_pixel_weight

    def start(self) -> None:
        """Begin; kernels of learning are loaded while workers trace the first samples."""
        loop = self._loop
        if loop.learner is not None:
            self._executor.submit(loop.learner.rehearse)
        loop.ready()
        loop.begin()

    def stop(self) -> None:
        """End with what is there."""
        self._loop.looks.stop()
        self._is_stopped = True

    def wait(self, seconds: float) -> bool:
        """Hand out, and put on the film what comes in so many seconds; True once all is there.

        Raises
        ------
        ClusterError
            If it cannot go on.
        """
        deadline = self._pool.now + seconds
        while True:
            if self._learning is not None and self._learning.done():
                self._learning.result()
                self._learning = None
            is_learning = self._learning is not None
            if self._is_stopped or not (self._open or is_learning or self._cutter.has_task):
                return True
            self._call_roll()
            with self._loop.changed:
                # The thread that learns begins what is traced meanwhile.
                self._hand_out()
            left = deadline - self._pool.now
            if left <= 0.0:
                return False
            come = self._pool.take(min(left, _LEARNING_POLL if is_learning else _ROLL_CALL))
            if come is not None:
                self._receive(*come)

    def join(self) -> None:
        """Leave what is still out."""
        self._pool.cancel(list(self._dispatcher.tickets))
        self._executor.shutdown(wait=True)
        self.render_seconds = self._loop.end()

    def statistics(self) -> Statistics:
        """Sum over all ranges on the film."""
        total = Statistics()
        for counted in self._statistics.values():
            total.add(counted)
        return total

    def progress(self) -> Progress:
        """Where it stands now."""
        count = len(self._dispatcher.names)
        message = f"{count} workers" if count != 1 else "1 worker"
        if not count:
            message = "Waiting for workers"
        elif self._learning is not None:
            message += ", learning"
        return self._loop.progress(sum(self.statistics().rays.values()), message)

    # -- the work -----------------------------------------------------------------------------------------------------

    def _call_roll(self) -> None:
        """See who is here, and who is late."""
        now = self._pool.now
        if now - self._counted < _ROLL_CALL:
            return
        self._counted = now
        for name in self._dispatcher.meet(self._pool.workers() - self._left_out):
            self._notice(f"worker {name}", "is gone", "others render what it had")
            tickets = self._dispatcher.dismiss(name)
            self._give_up(tickets, is_failure=True)
        for name in self._dispatcher.find_late(now):
            self._notice(f"worker {name}", "is far slower than the others, or hangs", "others render what it has too")
            for number in self._dispatcher.tickets_of(name):
                self._again(self._dispatcher.tickets[number].item)

    def _hand_out(self) -> None:
        """Give work to all who have room for it."""
        while self._waiting or self._cutter.has_task:
            if self._waiting and self._waiting[0].number not in self._open:
                self._waiting.popleft()
                continue
            name = self._dispatcher.idlest()
            if name is None:
                return
            self._submit(name, self._waiting.popleft() if self._waiting else self._cut())
        # Nothing is left but what is out: whoever has nothing to do helps with that.
        for name in self._dispatcher.idle():
            item = self._dispatcher.takeable(self._pool.now)
            if item is None:
                return
            self._submit(name, item)

    def _cut(self) -> TaskRange:
        """A range of tasks that nobody had before."""
        tiles, dispatcher = self._loop.tiles, self._dispatcher
        seconds = None
        if dispatcher.path_seconds is not None:
            task = self._cutter.next_task
            seconds = dispatcher.path_seconds * len(tiles) * len(tiles[task.tile][0]) * task.arm_samples.sample_count
        item = self._cutter.cut(tiles_in_range(len(tiles), len(dispatcher.names), seconds), MOST_PATHS)
        self._open[item.number] = item
        return item

    def _submit(self, name: str, item: TaskRange) -> None:
        number = self._dispatcher.assign(name, item, self._pool.now)
        self._pool.hold_learned(*self._learned[item.is_bridge])
        self._pool.submit(number, name, pack(self._order(item)))

    def _order(self, item: TaskRange) -> Order:
        loop, task = self._loop, item.tasks[0]
        indices = tuple(task.tile for task in item.tasks)
        tiles = [loop.tiles[index] for index in indices]
        arm_samples = loop.arm_samples(task)
        is_bridge = item.is_bridge
        weights = self._weights[is_bridge]
        if weights is not None:
            weights = weights[np.concatenate([film_index for _, film_index in tiles])]
        is_whole = loop.has_all_pixels
        return Order(
            self._scene, self._learned[is_bridge][0], loop.settings, loop.film.layout, indices if is_whole else (),
            None if is_whole else [pixels for pixels, _ in tiles],
            # What comes with the order is all that the worker goes by.
            arm_samples._replace(arm=CURRENT) if is_bridge else arm_samples, task.stratum, weights,
            loop.records(arm_samples.arm),
        )

    def _receive(self, number: int, answer: Answer) -> None:
        """A ticket has come back."""
        ticket = self._dispatcher.take_back(number, self._pool.now, is_done=answer.kind == SUMS)
        if ticket is None:
            return
        if answer.kind == SUMS:
            self._keep(ticket.item, answer)
        elif answer.kind == LOST:
            # Whether the worker is still there will be seen.
            self._give_up(self._dispatcher.dismiss(ticket.worker), is_failure=False)
            self._fail(ticket.item, answer.sentence)
        else:
            self._do_without(ticket, answer)

    def _keep(self, item: TaskRange, answer: Answer) -> None:
        """Put a range on the film, once."""
        loop = self._loop
        if self._open.pop(item.number, None) is None:
            return
        if answer.statistics is not None:
            self._statistics[item.is_bridge].add(answer.statistics)
        is_waiting = self._put_on_film(item, unpack_traced(answer.traced, loop.film.layout))
        # What others have not begun of the same range would come for nothing.
        spare = [
            number
            for number, ticket in self._dispatcher.tickets.items()
            if ticket.item.number == item.number and ticket.began is None
        ]
        self._give_up(spare, is_failure=False)
        if is_waiting:
            counted = Statistics()
            counted.add(self._statistics[False])
            self._learning = self._executor.submit(loop.begin_next, counted)

    def _put_on_film(self, item: TaskRange, traced: TracedTiles) -> bool:
        """Put tasks on the film; True if the loop waits for what follows."""
        loop = self._loop
        units = [loop.unit(task) for task in item.tasks]
        with loop.film_lock:
            loop.keep_alike(item.tasks, units, traced.sums, traced.costs, traced.records)
        is_waiting = False
        with loop.changed:
            for task in item.tasks:
                is_waiting |= loop.finish(task)
        return is_waiting

    def _do_without(self, ticket: Ticket, answer: Answer) -> None:
        """Ask no more of a worker that is of another version, or has failed."""
        name, sentence = ticket.worker, answer.sentence
        self._left_out.add(name)
        problem = f"is refused: {sentence}" if answer.kind == REFUSED else f"has failed: {sentence}"
        self._notice(f"worker {name}", problem, "others render what it had")
        if not self._pool.workers() - self._left_out:
            raise ClusterError(f"Cluster: no worker is left. Worker {name} {problem}")
        if answer.kind == REFUSED:
            self._again(ticket.item)
        else:
            self._fail(ticket.item, sentence)
        self._give_up(self._dispatcher.dismiss(name), is_failure=False)

    def _give_up(self, tickets: list[int], *, is_failure: bool) -> None:
        """Expect these tickets no more; their ranges are handed out again, if nobody else has them."""
        tickets = list(tickets)
        if tickets:
            self._pool.cancel(tickets)
        for number in tickets:
            ticket = self._dispatcher.take_back(number, self._pool.now, is_done=False)
            if ticket is None:
                continue
            if is_failure and ticket.began is not None:
                self._fail(ticket.item, "its workers went away while they rendered it")
            else:
                self._again(ticket.item)

    def _fail(self, item: TaskRange, reason: str) -> None:
        self._failures[item.number] += 1
        if self._failures[item.number] >= _MOST_FAILURES and item.number in self._open:
            raise ClusterError(f"Cluster: {item} have failed {_MOST_FAILURES} times; the last time: {reason}")
        self._again(item)

    def _again(self, item: TaskRange) -> None:
        """Have a range done by somebody, before all others, if it has not come and nobody is at it."""
        is_needed = item.number in self._open and item not in self._waiting
        if is_needed and not self._dispatcher.is_in_hand(item):
            self._waiting.appendleft(item)

    def _notice(self, subject: str, problem: str, fallback: str) -> None:
        notice = Notice(f"Cluster, {subject}", problem, fallback)
        if notice not in self._notices:
            self._notices.append(notice)
