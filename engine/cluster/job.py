# SPDX-License-Identifier: GPL-3.0-or-later
"""One render by a cluster's workers: ranges are handed out, come back, and are handed out again where they do not."""

from __future__ import annotations

import threading
from collections import Counter, deque

from engine.cluster.collector import Collector
from engine.cluster.crew import Crew, Ticket
from engine.cluster.pool import ClusterError, Pool
from engine.cluster.ranges import SampleRange, plan_ranges
from engine.cluster.work import LOST, REFUSED, SUMS, Answer, Order, pack
from engine.guiding.policy.cache_learning import CacheLearner
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.learning import Learner
from engine.guiding.policy.unguided_learning import UnguidedLearner
from engine.render.batch import Statistics
from engine.render.film import Film
from engine.render.report import ENDINGS, Progress
from engine.scene.description import Frame, Notice
from engine.settings import RenderSettings
from engine.state.film import FilmTile

#: Least time that a range may take before others are asked for it as well [s].
PATIENCE = 20.0
#: Parts of the picture a worker, so that all have something to do at the end of a render too.
_PARTS_PER_WORKER = 2
#: A range of so many paths is not too small for what sending it costs.
_MOST_PATHS = 1 << 23
#: A range that has failed so often, or taken so many workers with it, is not tried again.
_MOST_FAILURES = 3
#: Workers are counted so often [s].
_ROLL_CALL = 0.5


class ClusterJob:
    """One render, as `engine.render.job.AnyJob`; all happens in the thread that calls `wait`.

    Parameters
    ----------
    pool : Pool
        That holds the scene.
    scene : str
        Digest of the description.
    settings : RenderSettings
        By which nothing is learned.
    film : Film
    frame : Frame
    samples : int
    patience : float
        Least time [s] that a range may take before others are asked for it as well.
    """

    learner: Learner | CacheLearner | UnguidedLearner | None = None
    prepare_seconds = 0.0
    guidance: Guidance | None = None
    is_preparing = False

    def __init__(
        self, pool: Pool, scene: str, settings: RenderSettings, film: Film, frame: Frame, samples: int,
        patience: float = PATIENCE,
    ) -> None:
        self.film, self.film_lock = film, threading.Lock()
        self.ended_by = ""
        self.render_seconds = 0.0
        self.notices: list[Notice] = []
        self._pool, self._scene, self._settings, self._samples = pool, scene, settings, samples
        self._frame = frame
        self._crew = Crew(patience)
        self._statistics = Statistics()
        self._failures: Counter[int] = Counter()
        self._left_out: set[str] = set()
        self._is_stopped = False
        self._created = self._started = pool.now
        self._counted = float("-inf")
        self._ranges: list[SampleRange] = []
        self._waiting: deque[SampleRange] = deque()
        self._collector = Collector(film, frame.region, [])

    # -- as a session sees it -----------------------------------------------------------------------------------------

    def start(self) -> None:
        """Divide the frame."""
        x0, y0, x1, y1 = self._frame.region
        paths = (x1 - x0) * (y1 - y0) * min(self._samples, 64)
        workers = len(self._pool.workers())
        count = max(_PARTS_PER_WORKER * workers if workers > 1 else 1, -(-paths // _MOST_PATHS))
        self._ranges = plan_ranges(self._frame, self._samples, count)
        self._waiting = deque(self._ranges)
        self._collector = Collector(self.film, self._frame.region, self._ranges)
        self._started = self._pool.now

    def stop(self) -> None:
        """End with what is there."""
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
            if self._is_stopped or self._collector.is_complete or self._time_is_up():
                return True
            self._call_roll()
            self._hand_out()
            left = deadline - self._pool.now
            if left <= 0.0:
                return False
            come = self._pool.take(min(left, _ROLL_CALL))
            if come is not None:
                self._receive(*come)

    def join(self) -> None:
        """Leave what is still out; put on the film what has come."""
        self._pool.cancel(list(self._crew.tickets))
        with self.film_lock:
            self._collector.flush()
        self.ended_by = self.ended_by or "SAMPLES"
        self.render_seconds = self._pool.now - self._started

    @property
    def has_paths(self) -> bool:
        """Whether there is anything to show; it may be a part of the image."""
        return self._collector.has_paths

    def statistics(self) -> Statistics:
        """Sum over all ranges on the film."""
        return self._statistics

    def progress(self) -> Progress:
        """Where it stands now."""
        elapsed = self._pool.now - self._started
        total = sum(item.path_count for item in self._ranges)
        fraction = self._collector.path_count / total if total else 0.0
        remaining = elapsed * (1.0 - fraction) / fraction if fraction else None
        limit = self._settings.time_limit
        if limit:
            fraction = max(fraction, min(elapsed / limit, 1.0))
            remaining = max(limit - elapsed, 0.0) if remaining is None else min(remaining, max(limit - elapsed, 0.0))
        rays = sum(self._statistics.rays.values()) / max(elapsed, 1e-6)
        count = len(self._crew.names)
        message = f"{count} workers" if count != 1 else "1 worker"
        if not count:
            message = "Waiting for workers"
        if self.ended_by:
            message = ENDINGS[self.ended_by]
        return Progress(fraction, int(fraction * self._samples), self._samples, elapsed, remaining, rays, message)

    # -- the work -----------------------------------------------------------------------------------------------------

    def _time_is_up(self) -> bool:
        limit = self._settings.time_limit
        # As on one machine there is a whole picture first: every part has its first range.
        has_image = self._collector.has_paths and all(
            self._collector.has(item.number) for item in self._ranges if item.step == 0
        )
        if limit and has_image and self._pool.now - self._started >= limit:
            self.ended_by = "TIME_LIMIT"
            return True
        return False

    def _call_roll(self) -> None:
        """See who is here, and who is late."""
        now = self._pool.now
        if now - self._counted < _ROLL_CALL:
            return
        self._counted = now
        for name in self._crew.meet(self._pool.workers() - self._left_out):
            self._notice(f"worker {name}", "is gone", "others render what it had")
            tickets = self._crew.dismiss(name)
            self._give_up(tickets, is_failure=True)
        for name in self._crew.find_late(now):
            self._notice(f"worker {name}", "is far slower than the others, or hangs", "others render what it has too")
            for number in self._crew.tickets_of(name):
                self._again(self._crew.tickets[number].item)

    def _hand_out(self) -> None:
        """Give work to all who have room for it."""
        while self._waiting:
            if self._collector.has(self._waiting[0].number):
                self._waiting.popleft()
                continue
            name = self._crew.idlest()
            if name is None:
                return
            self._submit(name, self._waiting.popleft())
        # Nothing is left but what is out: whoever has nothing to do helps with that.
        for name in self._crew.idle():
            item = self._crew.takeable(self._pool.now)
            if item is None:
                return
            self._submit(name, item)

    def _submit(self, name: str, item: SampleRange) -> None:
        number = self._crew.assign(name, item, self._pool.now)
        self._pool.submit(number, name, pack(Order(self._scene, self._settings, self.film.layout, item)))

    def _receive(self, number: int, answer: Answer) -> None:
        """A ticket has come back."""
        ticket = self._crew.take_back(number, self._pool.now, is_done=answer.kind == SUMS)
        if ticket is None:
            return
        if answer.kind == SUMS:
            self._put_on_film(ticket.item, answer)
        elif answer.kind == LOST:
            # Whether the worker is still there will be seen.
            self._give_up(self._crew.dismiss(ticket.worker), is_failure=False)
            self._fail(ticket.item, answer.sentence)
        else:
            self._do_without(ticket, answer)

    def _put_on_film(self, item: SampleRange, answer: Answer) -> None:
        with self.film_lock:
            is_new = self._collector.take(item.number, FilmTile(*answer.sums))
        if is_new and answer.statistics is not None:
            self._statistics.add(answer.statistics)
        # What others have not begun of the same range would come for nothing.
        spare = [
            number
            for number, ticket in self._crew.tickets.items()
            if ticket.item.number == item.number and ticket.began is None
        ]
        self._give_up(spare, is_failure=False)

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
        self._give_up(self._crew.dismiss(name), is_failure=False)

    def _give_up(self, tickets: list[int], *, is_failure: bool) -> None:
        """Expect these tickets no more; their ranges are handed out again, if nobody else has them."""
        tickets = list(tickets)
        if tickets:
            self._pool.cancel(tickets)
        for number in tickets:
            ticket = self._crew.take_back(number, self._pool.now, is_done=False)
            if ticket is None:
                continue
            if is_failure and ticket.began is not None:
                self._fail(ticket.item, "its workers went away while they rendered it")
            else:
                self._again(ticket.item)

    def _fail(self, item: SampleRange, reason: str) -> None:
        self._failures[item.number] += 1
        if self._failures[item.number] >= _MOST_FAILURES and not self._collector.has(item.number):
            raise ClusterError(
                f"Cluster: samples {item.first} to {item.first + item.count - 1} of a part of the picture have failed "
                f"{_MOST_FAILURES} times; the last time: {reason}"
            )
        self._again(item)

    def _again(self, item: SampleRange) -> None:
        """Have a range done by somebody, before all others, if it has not come and nobody is at it."""
        if not (self._collector.has(item.number) or item in self._waiting or self._crew.is_in_hand(item)):
            self._waiting.appendleft(item)

    def _notice(self, subject: str, problem: str, fallback: str) -> None:
        notice = Notice(f"Cluster, {subject}", problem, fallback)
        if notice not in self.notices:
            self.notices.append(notice)
