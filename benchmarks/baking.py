# SPDX-License-Identifier: GPL-3.0-or-later
"""How far is a room's lightmap off at equal time? `python -m benchmarks.baking`.

Walls, floor and ceiling of a room get a lightmap (`benchmarks.lightmaps`), to which rivals bake diffuse light, direct
and indirect, by Blender's operator. How many samples fill the seconds is found by two shorter bakes. Rivals take turns.
Two long bakes are the references: ours without guiding or cells, and Cycles' without guiding.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.environment import describe, thread_count
from benchmarks.images import Float32Array
from benchmarks.lightmaps import Lightmap, Spent, make_lightmap
from benchmarks.metrics import EPSILON, TRIMMED_FRACTION, compare_means, image_scale, seed_variance
from benchmarks.rivals import CYCLES_RIVALS, Budget, find_rival
from benchmarks.scene_files import SceneSource, expand, open_scene
from benchmarks.tables import geometric_mean, table

ROOMS = ("builtin:study", "builtin:evening-room", "builtin:room-sky")
RIVALS = (*CYCLES_RIVALS, "AUTO-AUTO")
REFERENCES = ("OFF", "cycles")
#: The first reference's seed; those of bakes that are measured begin at 1.
REFERENCE_SEED = 1001
#: The first bake that tells what samples take, and which part of the seconds the second is to take.
_FIRST_SAMPLES, _SECOND_SHARE = 16, 0.4


class Timing(NamedTuple):
    """How long a bake of so many samples took [s]."""

    samples: int
    seconds: float


def samples_for(seconds: float, short: Timing, long: Timing) -> int:
    """Samples of a bake that takes so long, by two shorter ones: what bakes take beside samples is always the same."""
    slope = (long.seconds - short.seconds) / max(long.samples - short.samples, 1)
    if slope <= 0.0:
        slope = long.seconds / long.samples
    beside = max(long.seconds - slope * long.samples, 0.0)
    return max(round((seconds - beside) / slope), 1)


@dataclass
class Bakes:
    """A rival's bakes of one room.

    samples : int, a texel
    spent : list of Spent, of each seed
    images : list of float32 (1, N, 3)
    said : list of str, what the log has of the last
    """

    samples: int
    spent: list[Spent] = field(default_factory=list)
    images: list[Float32Array] = field(default_factory=list)
    said: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Error:
    """Relative squared error without the worst texels, taken apart."""

    variance: float
    bias_squared: float

    @property
    def total(self) -> float:
        """Both; what is estimated of a bias may be below zero."""
        return self.variance + max(self.bias_squared, 0.0)


def error_of(
    images: Sequence[Float32Array], references: tuple[Float32Array, Float32Array], brightness: Float32Array
) -> Error:
    """Error of bakes of independent seeds.

    References may be noisier than what is measured. So the variance is taken from seeds alone, and the squared bias is
    a product of differences to two references, which only their product's own noise is in. Of that as many texels are
    left out below as above.

    Parameters
    ----------
    images, references : float (1, N, 3)
        Independent of each other.
    brightness : float (1, N, 3)
        What errors are relative to, less noisy than references.
    """
    first, second = (np.asarray(reference, np.float64) for reference in references)
    stack = np.stack([np.asarray(image, np.float64) for image in images])
    mean, noise = stack.mean(axis=0), stack.var(axis=0, ddof=1) / len(stack)
    scale = np.asarray(brightness, np.float64) ** 2 + EPSILON * image_scale(brightness) ** 2
    products = np.sort((((mean - first) * (mean - second) - noise) / scale).mean(axis=-1), axis=None)
    cut = int(np.ceil(products.size * TRIMMED_FRACTION))
    variance = seed_variance(images, brightness, least_seeds=2).trimmed
    return Error(variance, float(products[cut : products.size - cut].mean()))


@dataclass(frozen=True)
class Figures:
    """What a rival's bakes of one room came to.

    seconds, processor_seconds : float, means over seeds
    error, of_lit : Error, of all texels, and of those in which a reference has found light
    difference, standard_error : float
        Of the mean over texels and channels, to that of Cycles' reference; and of its noise, that of the reference
        included, by texels.
    """

    samples: int
    seconds: float
    processor_seconds: float
    error: Error
    of_lit: Error
    difference: float
    standard_error: float
    said: list[str]

    def times_better(self, other: Figures) -> float:
        """Error of another at equal time over ours. Seconds differ a little, and errors fall as 1 / seconds."""
        return other.error.total * other.seconds / (self.error.total * self.seconds)

    def times_better_where_lit(self, other: Figures) -> float:
        """The same of texels that light comes to. Others lie within walls, and nobody sees them."""
        return other.of_lit.total * other.seconds / (self.of_lit.total * self.seconds)

    def times_better_by_processor(self, other: Figures) -> float:
        """The same at equal seconds of all threads, whatever else the machine did."""
        return other.error.total * other.processor_seconds / (self.error.total * self.processor_seconds)


def mean_difference(images: Sequence[Float32Array], theirs: Sequence[Float32Array]) -> tuple[float, float]:
    """Relative difference of means over texels and channels, and its standard error."""
    grey = [[np.asarray(image, np.float64).mean(axis=-1, keepdims=True) for image in some] for some in (images, theirs)]
    difference, error = compare_means(*grey)
    return float(difference[0]), float(error[0])


def least_noisy(found: Mapping[str, Bakes], brightness: Float32Array) -> Float32Array:
    """Mean over seeds of the rival whose seeds differ least, relative to some brightness."""
    best = min(found.values(), key=lambda one: seed_variance(one.images, brightness, least_seeds=2).trimmed)
    return np.mean(np.stack(best.images), axis=0)


def figures(
    bakes: Bakes, references: Mapping[str, Sequence[Float32Array]], brightness: Float32Array
) -> Figures:
    """Figures of a rival's bakes.

    Parameters
    ----------
    references : {rival: two halves of its long bake}
    brightness : see `error_of`
    """
    first, second = (np.mean(np.stack(references[name]), axis=0) for name in REFERENCES)
    difference, error = mean_difference(bakes.images, references["cycles"])
    seconds, processor_seconds = np.mean(bakes.spent, axis=0)
    is_lit = (first + second).sum(axis=(0, 2)) > 0.0
    whole, lit = (
        error_of([image[:, some] for image in bakes.images], (first[:, some], second[:, some]), brightness[:, some])
        for some in (np.ones_like(is_lit), is_lit)
    )
    return Figures(
        bakes.samples, float(seconds), float(processor_seconds), whole, lit, difference, error, bakes.said
    )


class _Listener(logging.Handler):
    """Keeps what NEURALGUIDE says of a bake."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


@dataclass(frozen=True)
class Room:
    """A room that is open, with its lightmap."""

    name: str
    scene: Any
    lightmap: Lightmap
    threads: int

    def bake(self, rival: str, samples: int, seed: int) -> tuple[Float32Array, Spent, list[str]]:
        """A rival's bake, float32 (1, N, 3), what it took, and what the log has of it."""
        find_rival(rival).configure(self.scene, Budget(samples), seed, self.threads)
        listener, logger = _Listener(), logging.getLogger("neuralguide")
        logger.addHandler(listener)
        try:
            texels, spent = self.lightmap.bake(self.scene)
        finally:
            logger.removeHandler(listener)
        print(f"  {self.name} {rival} seed {seed}: {samples} samples in {spent.seconds:.2f} s", flush=True)
        return texels[None], spent, listener.lines

    def samples(self, rival: str, seconds: float) -> int:
        """How many samples a bake has that takes so long."""
        self.bake(rival, _FIRST_SAMPLES, 901)  # Kernels are loaded, and files read.
        short = Timing(_FIRST_SAMPLES, self.bake(rival, _FIRST_SAMPLES, 902)[1].seconds)
        samples = max(samples_for(_SECOND_SHARE * seconds, Timing(0, 0.0), short), 2 * _FIRST_SAMPLES)
        return samples_for(seconds, short, Timing(samples, self.bake(rival, samples, 903)[1].seconds))


def open_room(source: SceneSource, size: int, threads: int) -> Room:
    """Open a scene and give it a lightmap."""
    scene = open_scene(source)
    return Room(source.name, scene, make_lightmap(scene, size), threads)


def take_references(room: Room, samples: int, size: int, folder: Path) -> dict[str, list[Float32Array]]:
    """Two halves of each reference, of so many samples together; those that lie in the folder are read."""
    found: dict[str, list[Float32Array]] = {}
    folder.mkdir(parents=True, exist_ok=True)
    for rival in REFERENCES:
        for seed in (REFERENCE_SEED, REFERENCE_SEED + 1):
            file = folder / f"{room.name}_{rival}_{size}px_{samples // 2}spp_seed{seed}.npy"
            if not file.exists():
                np.save(file, room.bake(rival, samples // 2, seed)[0])
            found.setdefault(rival, []).append(np.load(file))
    return found


def measure(room: Room, rivals: Sequence[str], seconds: float, seeds: int) -> dict[str, Bakes]:
    """Bakes of all rivals, which take turns."""
    found = {rival: Bakes(room.samples(rival, seconds)) for rival in rivals}
    for seed in range(1, seeds + 1):
        for rival, bakes in found.items():
            image, spent, bakes.said = room.bake(rival, bakes.samples, seed)
            bakes.images.append(image)
            bakes.spent.append(spent)
    return found


def better_cycles(of_room: Mapping[str, Figures]) -> Figures | None:
    """Cycles with or without path guiding, whichever errs less in equal time; None where neither was measured."""
    cycles = [of_room[name] for name in CYCLES_RIVALS if name in of_room]
    return min(cycles, key=lambda one: one.error.total * one.seconds, default=None)


def error_table(found: Mapping[str, Mapping[str, Figures]]) -> str:
    """A line for each room and rival, and geometric means over rooms of what is over the better Cycles."""
    rows: list[list[float | int | str | None]] = []
    ratios: dict[str, list[list[float]]] = {}
    for room, of_room in found.items():
        better = better_cycles(of_room)
        for rival, one in of_room.items():
            times: list[Any] = [None] * 3
            if better is not None and rival not in CYCLES_RIVALS:
                times = [
                    one.times_better(better), one.times_better_where_lit(better), one.times_better_by_processor(better)
                ]
                ratios.setdefault(rival, []).append(times)
            rows.append([
                room, rival, one.samples, one.seconds, one.error.total, one.error.variance, one.error.bias_squared,
                f"{one.difference:+.2%} ± {one.standard_error:.2%}", *times,
            ])  # fmt: skip
    rows += [
        ["geometric mean", rival, None, None, None, None, None, "", *map(geometric_mean, zip(*of_rival, strict=True))]
        for rival, of_rival in ratios.items()
    ]
    header = (
        "room", "rival", "samples", "seconds", "total", "variance", "bias^2", "mean", "times better", "where lit",
        "by processor",
    )  # fmt: skip
    return table(header, rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Bake and print a table; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.baking", description=__doc__)
    parser.add_argument("scenes", nargs="*", default=ROOMS, help=f".blend files or builtin:NAME ({' '.join(ROOMS)})")
    parser.add_argument("--rivals", nargs="+", default=RIVALS, help=f"(default: {' '.join(RIVALS)})")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each bake (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=3, help="bakes of each, 2 or more (default: %(default)s)")
    parser.add_argument("--size", type=int, default=256, help="side of the image (default: %(default)s)")
    parser.add_argument("--samples", type=int, default=1024, help="of each reference (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=thread_count(), help="(default: %(default)s)")
    parser.add_argument("--only-references", action="store_true", help="make these, and end")
    parser.add_argument("--out", type=Path, default=Path("out/baking"), help="references, figures (%(default)s)")
    chosen = parser.parse_args(arguments)
    found: dict[str, dict[str, Figures]] = {}
    try:
        for source in expand(list(chosen.scenes)):
            room = open_room(source, chosen.size, chosen.threads)
            references = take_references(room, chosen.samples, chosen.size, chosen.out)
            difference, error = mean_difference(*(references[name] for name in REFERENCES))
            print(
                f"{room.name}: {references['OFF'][0].shape[1]} texels; references' means differ by {difference:+.3%} "
                f"± {error:.3%}"
            )
            if chosen.only_references:
                continue
            bakes = measure(room, chosen.rivals, chosen.seconds, chosen.seeds)
            for rival, some in bakes.items():
                np.save(chosen.out / f"{room.name}_{rival}.npy", np.stack(some.images))
            halves = [half for pair in references.values() for half in pair]
            brightness = least_noisy(bakes, np.mean(np.stack(halves), axis=0))
            found[room.name] = {rival: figures(some, references, brightness) for rival, some in bakes.items()}
            record = {"environment": describe(), "rooms": {
                name: {rival: asdict(one) for rival, one in of_room.items()} for name, of_room in found.items()
            }}  # fmt: skip
            (chosen.out / "figures.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    except (ValueError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if found:
        print(error_table(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
