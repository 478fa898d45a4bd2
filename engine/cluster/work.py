# SPDX-License-Identifier: GPL-3.0-or-later
"""What a worker does: it builds a scene once, and traces ranges of its samples by what the coordinator has learned.

What goes over the network is plain: numbers, texts, arrays, and bytes that only an engine of the same version unpacks.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.trial import ArmSamples
from engine.guiding.records.cache_records import CacheRecords, join_cache_records
from engine.guiding.records.unit_records import UnitRecords
from engine.guiding.records.vertices import VertexRecords, join_records
from engine.render.batch import Statistics
from engine.render.session import Session
from engine.render.tiles import FrameTiles
from engine.render.traced import Pixels, TracedTiles, split_records
from engine.runtime.source_version import source_version
from engine.settings import RenderSettings
from engine.state.film import FilmLayout, allocate_tile
from engine.state.lanes import RGB
from engine.state.unit import UnitCosts

#: Threads that a worker traces with, 0: as the settings say.
THREADS_VARIABLE = "NEURALGUIDE_WORKER_THREADS"

# What an answer is.
SUMS, REFUSED, FAILED, LOST = "SUMS", "REFUSED", "FAILED", "LOST"


@dataclass(frozen=True)
class Order:
    """A range, and by what to trace it.

    scene, learned : str, digests of the description and of the guidance (`pack_guidance`); '': nothing is learned
    tiles : tuple of int, of the whole frame; () with `pixels`
    pixels : list of int32 (P, 2), of tiles that a noise threshold has made; None with `tiles`
    weights : float32 (P,), of the tiles' pixels one after the other (`Guidance.pixel_weight`)
    records : bool, whether what paths record is wanted
    """

    scene: str
    learned: str
    settings: RenderSettings
    layout: FilmLayout
    tiles: tuple[int, ...]
    pixels: list[Pixels] | None
    arm_samples: ArmSamples
    stratum: int
    weights: np.ndarray | None
    records: bool


@dataclass(frozen=True)
class Answer:
    """What has become of an order.

    kind : SUMS, REFUSED (by a worker of another version), FAILED or LOST (with its worker)
    sentence : str, why, where there are no sums
    traced : tuple, `TracedTiles` as `pack_traced` packs it
    seconds : float, what rendering took, without building the scene
    """

    kind: str
    sentence: str = ""
    traced: tuple[Any, ...] = ()
    statistics: Statistics | None = None
    seconds: float = 0.0


#: The scene that this process holds: its digest, and the session that has built it.
_held: tuple[str, Session] | None = None
#: What it traces by: its digest, and the guidance.
_learned: tuple[str, Guidance | None] = "", None


def digest_of(blob: bytes) -> str:
    """Digest of what is held for workers: 32 hexadecimal digits."""
    return hashlib.blake2b(blob, digest_size=16).hexdigest()


def pack(order: Order) -> bytes:
    """An order as it is sent."""
    return pickle.dumps(order, protocol=5)


def pack_guidance(guidance: Guidance) -> bytes:
    """What an iteration goes by, for all workers: without the pixels' weights, of which each order has its own."""
    return pickle.dumps(guidance.with_pixel_weight(None), protocol=5)


def pack_traced(traced: TracedTiles) -> tuple[Any, ...]:
    """Plain arrays; of sums that are all zero, as those of parts that nothing asks for, only how many there are."""
    sums = tuple(column if column.any() else None for column in traced.sums)
    costs = np.array([(c.seconds, c.ray_count, c.guided_vertices, c.resampled_candidates) for c in traced.costs])
    if traced.records is None:
        return len(traced.sums.count), sums, costs, None, None, None
    counts = np.array([(len(unit.vertices.pdf), len(unit.cache_records.side)) for unit in traced.records])
    vertices, _ = join_records([unit.vertices for unit in traced.records])
    cache = join_cache_records([unit.cache_records for unit in traced.records])
    return len(traced.sums.count), sums, costs, counts, tuple(vertices), tuple(cache)


def unpack_traced(packed: tuple[Any, ...], layout: FilmLayout) -> TracedTiles:
    """The opposite of `pack_traced`."""
    row_count, columns, costs, counts, vertices, cache = packed
    zeros = allocate_tile(row_count, RGB, layout)
    sums = type(zeros)(*(zero if one is None else one for zero, one in zip(zeros, columns, strict=True)))
    units = [UnitCosts(float(row[0]), *(int(count) for count in row[1:])) for row in costs]
    if counts is None:
        return TracedTiles(sums, units, None)
    together = UnitRecords(VertexRecords(*vertices), CacheRecords(*cache))
    return TracedTiles(sums, units, list(split_records(together, counts.tolist())))


def keep(blob: bytes) -> bytes:
    """Hold a packed description or guidance for other workers to fetch."""
    return blob


def trace(version: str, order: bytes, scene: bytes, learned: bytes | None = None) -> tuple[Any, ...]:
    """Do what an order asks for; the fields of an `Answer`.

    Parameters
    ----------
    version : str
        `source_version` of whoever asks.
    order : bytes
        A packed `Order`.
    scene : bytes
        The pickled `SceneDescription` that it is about.
    learned : bytes, optional
        The guidance that it goes by (`pack_guidance`).
    """
    if version != source_version():
        return REFUSED, f"it has version {source_version()} of the engine, and {version} is needed"
    try:
        wanted: Order = pickle.loads(order)
        session = _session(wanted, scene)
        start = time.perf_counter()
        assert session.scene is not None
        guidance = _guidance(wanted, learned)
        if guidance is not None and not wanted.records:
            guidance = guidance.without_records()
        tiles: Sequence[Pixels]
        if wanted.pixels is None:
            whole = FrameTiles(session.scene.description.frame)
            tiles = [whole[tile][0] for tile in wanted.tiles]
        else:
            tiles = wanted.pixels
        traced, statistics = session.trace_tiles(
            session.settings, wanted.layout, tiles, wanted.arm_samples, wanted.stratum, guidance, records=wanted.records
        )
        return SUMS, "", pack_traced(traced), statistics, time.perf_counter() - start
    except MemoryError:
        return FAILED, "it has not enough memory for the scene"
    except Exception as error:
        traceback.print_exc()
        return FAILED, f"{type(error).__name__}: {error}"


def _guidance(order: Order, learned: bytes | None) -> Guidance | None:
    """What the order goes by, with its pixels' weights.

    Raises
    ------
    ValueError
        If what has come is not what the order is about.
    """
    global _learned
    if not order.learned:
        return None
    if _learned[0] != order.learned:
        if learned is None or digest_of(learned) != order.learned:
            raise ValueError("what was learned has another digest than the order")
        _learned = order.learned, pickle.loads(learned)
    assert _learned[1] is not None
    return _learned[1].with_pixel_weight(order.weights)


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
