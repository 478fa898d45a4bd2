# SPDX-License-Identifier: GPL-3.0-or-later
"""Who does what: workers, the tickets they have, and which of them are late.

A ticket is one order to one worker; a range may have several. Every worker has up to two tickets, so that the next is
there when it is done with one. A worker is late when its ticket takes much longer than such tickets take others; its
ranges are then given to others as well, and whoever is first counts.

References: Dean, Ghemawat 2004, "MapReduce: Simplified Data Processing on Large Clusters", section 3.6, Backup Tasks.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from statistics import median

from engine.cluster.ranges import TaskRange

#: Tickets that a worker has at a time.
TICKETS = 2
#: A ticket is late when it takes so many times what such tickets take.
LATE_FACTOR = 3.0
#: Whoever has nothing to do helps with a ticket that takes so many times what such tickets take.
_HELP_FACTOR = 1.5
#: Speeds of so many of the newest tickets count.
_REMEMBERED = 64


@dataclass
class Ticket:
    """One order to one worker; `began` is when it became the worker's first ticket, None before."""

    item: TaskRange
    worker: str
    began: float | None = None


@dataclass
class _Worker:
    tickets: list[int] = field(default_factory=list)
    has_answered: bool = False
    is_late: bool = False


class Dispatcher:
    """The workers of a render.

    Parameters
    ----------
    patience : float
        Time [s] that a ticket may take in any case.
    """

    def __init__(self, patience: float) -> None:
        self.tickets: dict[int, Ticket] = {}
        self._patience = patience
        self._workers: dict[str, _Worker] = {}
        self._next_ticket = 0
        #: Speeds of workers that had answered before [s per path]; the longest first answer, the scene built in it [s].
        self._speeds: list[float] = []
        self._longest_first = 0.0

    @property
    def names(self) -> frozenset[str]:
        """Those that are here."""
        return frozenset(self._workers)

    def meet(self, names: frozenset[str]) -> list[str]:
        """Take note of who is here; returns those that are gone, whose tickets `dismiss` gives back."""
        for name in sorted(names - self._workers.keys()):
            self._workers[name] = _Worker()
        return sorted(self._workers.keys() - names)

    def dismiss(self, name: str) -> list[int]:
        """Do without a worker; returns its tickets."""
        worker = self._workers.pop(name, None)
        return [] if worker is None else worker.tickets

    def idlest(self) -> str | None:
        """A worker with room for a ticket, one with nothing to do if there is one; late ones get none."""
        free = [
            (len(worker.tickets), name)
            for name, worker in self._workers.items()
            if len(worker.tickets) < TICKETS and not worker.is_late
        ]
        return min(free)[1] if free else None

    def idle(self) -> list[str]:
        """Workers with nothing to do."""
        return [name for name, worker in self._workers.items() if not worker.tickets and not worker.is_late]

    def assign(self, name: str, item: TaskRange, now: float) -> int:
        """Give a worker a range; returns the ticket's number."""
        number, self._next_ticket = self._next_ticket, self._next_ticket + 1
        worker = self._workers[name]
        self.tickets[number] = Ticket(item, name, now if not worker.tickets else None)
        worker.tickets.append(number)
        return number

    def take_back(self, number: int, now: float, *, is_done: bool) -> Ticket | None:
        """A ticket is over; None if it was over before. `is_done`: its worker has done it, and is there after all."""
        ticket = self.tickets.pop(number, None)
        if ticket is None:
            return None
        worker = self._workers.get(ticket.worker)
        if worker is None:
            return ticket
        worker.tickets.remove(number)
        worker.is_late = worker.is_late and not is_done
        if is_done and ticket.began is not None:
            seconds = now - ticket.began
            if worker.has_answered:
                self._speeds = [*self._speeds[1 - _REMEMBERED :], seconds / max(ticket.item.path_count, 1)]
            else:
                self._longest_first = max(self._longest_first, seconds)
            worker.has_answered = True
        if worker.tickets:
            following = self.tickets[worker.tickets[0]]
            following.began = now if following.began is None else following.began
        return ticket

    def find_late(self, now: float) -> list[str]:
        """Workers that have become late since this was last asked."""
        found = []
        for name, worker in self._workers.items():
            if worker.is_late or not worker.tickets:
                continue
            ticket = self.tickets[worker.tickets[0]]
            assert ticket.began is not None
            expected = self._expected(worker, ticket)
            if expected is not None and now - ticket.began > max(LATE_FACTOR * expected, self._patience):
                worker.is_late = True
                found.append(name)
        return found

    @property
    def path_seconds(self) -> float | None:
        """What a path takes a worker, with all its threads; None while nobody knows."""
        return median(self._speeds) if self._speeds else None

    def _expected(self, worker: _Worker, ticket: Ticket) -> float | None:
        """Time [s] that others need for such a ticket, None while nobody knows."""
        tracing = None if self.path_seconds is None else self.path_seconds * ticket.item.path_count
        if worker.has_answered:
            return tracing
        return self._longest_first + (tracing or 0.0) if self._longest_first else None

    def is_in_hand(self, item: TaskRange) -> bool:
        """Whether a worker that is not late has a ticket for this range."""
        return any(
            ticket.item.number == item.number
            and ticket.worker in self._workers
            and not self._workers[ticket.worker].is_late
            for ticket in self.tickets.values()
        )

    def takeable(self, now: float) -> TaskRange | None:
        """A range that only one worker has, and with which somebody idle may be sooner; None if there is none.

        Ranges that nobody has begun come first, then those that take longer than expected.
        """
        counts = Counter(ticket.item.number for ticket in self.tickets.values())
        single = [ticket for ticket in self.tickets.values() if counts[ticket.item.number] == 1]
        for ticket in single:
            if ticket.began is None:
                return ticket.item
        for ticket in single:
            expected = self._expected(self._workers[ticket.worker], ticket)
            if expected is not None and ticket.began is not None and now - ticket.began > _HELP_FACTOR * expected:
                return ticket.item
        return None

    def tickets_of(self, name: str) -> list[int]:
        """Tickets that a worker has."""
        return list(self._workers[name].tickets) if name in self._workers else []
