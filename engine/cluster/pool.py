# SPDX-License-Identifier: GPL-3.0-or-later
"""What the coordinator asks of whatever reaches the workers."""

from __future__ import annotations

from typing import Protocol

from engine.cluster.work import Answer


class ClusterError(ValueError):
    """The cluster cannot render; the message says why, for users."""


class Pool(Protocol):
    """Workers that do orders. Its methods are called by one thread."""

    @property
    def now(self) -> float:
        """Time [s] since whenever."""

    def hold(self, scene: str, blob: bytes) -> None:
        """Have a scene, a pickled description with this digest, at hand for the orders that come, instead of the last.

        Raises
        ------
        ClusterError
            If there is no cluster any more.
        """

    def hold_learned(self, learned: str, blob: bytes) -> None:
        """As `hold`, for what orders go by; digest '': nothing."""

    def workers(self) -> frozenset[str]:
        """Who is connected now.

        Raises
        ------
        ClusterError
            If there is no cluster any more.
        """

    def submit(self, ticket: int, worker: str, order: bytes) -> None:
        """Have this worker, and no other, do an order about what is held now."""

    def take(self, seconds: float) -> tuple[int, Answer] | None:
        """The next ticket that has come back, with its answer; None after so many seconds."""

    def cancel(self, tickets: list[int]) -> None:
        """Have nothing more to do with these tickets; what is in work may go on to its end."""

    def close(self) -> None:
        """Leave the cluster."""
