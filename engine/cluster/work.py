# SPDX-License-Identifier: GPL-3.0-or-later
"""What a worker does: it builds a scene once, and renders ranges of its samples.

What goes over the network is plain: numbers, texts, arrays, and bytes that only an engine of the same version unpacks.
"""

from __future__ import annotations

import os
import pickle
import time
import traceback
from dataclasses import dataclass, replace
from typing import Any

from engine.cluster.ranges import SampleRange
from engine.cluster.version import source_version
from engine.render.batch import Statistics
from engine.render.session import Session
from engine.settings import RenderSettings
from engine.state.film import FilmLayout

#: Threads that a worker traces with, 0: as the settings say.
THREADS_VARIABLE = "NEURALGUIDE_WORKER_THREADS"

# What an answer is.
SUMS, REFUSED, FAILED, LOST = "SUMS", "REFUSED", "FAILED", "LOST"


@dataclass(frozen=True)
class Order:
    """A range, and by which settings; `scene` is the digest of the description that is rendered."""

    scene: str
    settings: RenderSettings
    layout: FilmLayout
    range: SampleRange


@dataclass(frozen=True)
class Answer:
    """What has become of an order.

    kind : SUMS, REFUSED (by a worker of another version), FAILED or LOST (with its worker)
    sentence : str, why, where there are no sums
    sums : list of arrays, those of a `FilmTile`
    seconds : float, what rendering took, without building the scene
    """

    kind: str
    sentence: str = ""
    sums: tuple[Any, ...] = ()
    statistics: Statistics | None = None
    seconds: float = 0.0


#: The scene that this process holds: its digest, and the session that has built it.
_held: tuple[str, Session] | None = None


def pack(order: Order) -> bytes:
    """An order as it is sent."""
    return pickle.dumps(order, protocol=5)


def keep(scene: bytes) -> bytes:
    """Hold a packed description for other workers to fetch."""
    return scene


def trace(version: str, order: bytes, scene: bytes) -> tuple[Any, ...]:
    """Do what an order asks for; the fields of an `Answer`.

    Parameters
    ----------
    version : str
        `source_version` of whoever asks.
    order : bytes
        A packed `Order`.
    scene : bytes
        The pickled `SceneDescription` that it is about.
    """
    if version != source_version():
        return REFUSED, f"it has version {source_version()} of the engine, and {version} is needed"
    try:
        wanted: Order = pickle.loads(order)
        session = _session(wanted, scene)
        start = time.perf_counter()
        item = wanted.range
        sums, statistics = session.render_range(session.settings, wanted.layout, item.region, item.first, item.count)
        return SUMS, "", tuple(sums), statistics, time.perf_counter() - start
    except MemoryError:
        return FAILED, "it has not enough memory for the scene"
    except Exception as error:
        traceback.print_exc()
        return FAILED, f"{type(error).__name__}: {error}"


def _session(order: Order, scene: bytes) -> Session:
    """A session that has built the scene, and has the order's settings."""
    global _held
    threads = int(os.environ.get(THREADS_VARIABLE, "0")) or order.settings.threads
    settings = replace(order.settings, threads=threads)
    if _held is None or _held[0] != order.scene:
        session = Session(settings) if _held is None else _held[1]
        # Nothing is held while it is built: if that fails, the next order begins anew.
        _held = None
        session.settings = settings
        session.load(pickle.loads(scene))
        _held = order.scene, session
    _held[1].settings = settings
    return _held[1]
