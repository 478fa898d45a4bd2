# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks reference`: pictures to compare with, made once, with their own error.

A reference is the mean of independent seeds. It lies as `NAME.exr` beside `NAME.json`, which says of what and how it
was made; the seeds stay under `seeds/`, so that more can be added. It is refused where the scene or its light paths are
not those it was made of.
"""

from __future__ import annotations

import datetime
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import environment, metrics
from benchmarks.images import Float32Array, read_exr, write_exr
from benchmarks.light_paths import differences
from benchmarks.rendering import Failure, RenderRecord, image_stack, render_scene
from benchmarks.rivals import Budget, Rival
from benchmarks.scene_files import SceneSource
from benchmarks.tables import table

#: Folder of the single seeds, beside the references.
SEEDS = "seeds"
#: Own error of a reference over a measured one from which on it is worth a word.
NOTABLE_SHARE = 0.1


@dataclass(frozen=True)
class ReferenceFacts:
    """What a reference was made of.

    samples : per pixel of each seed
    seeds : those in the mean
    error, error_trimmed : expected relative squared error of the mean, from the variance between seeds; nan of one seed
    render_seconds : of all seeds
    known : share of the pixels in which it says something; the others are NaN
    """

    scene: str
    scene_hash: str
    light_paths: dict[str, Any]
    width: int
    height: int
    rival: str
    samples: int
    seeds: list[int]
    error: float = math.nan
    error_trimmed: float = math.nan
    render_seconds: float = 0.0
    environment: dict[str, Any] = field(default_factory=dict)
    date: str = ""
    known: float = 1.0


@dataclass(frozen=True)
class Reference:
    """A picture, float32 (height, width, channels), and what is known of it: nothing, if no JSON lies beside it."""

    image: Float32Array
    facts: ReferenceFacts | None = None

    def problem(self, scene_hash: str, light_paths: Mapping[str, Any], size: tuple[int, int] | None = None) -> str:
        """Why it must not be compared with a render of such a scene; '' if it may.

        Parameters
        ----------
        size : (width, height), optional
            Size of the render; None where it will follow the reference.
        """
        own_size = (self.image.shape[1], self.image.shape[0])
        if size is not None and size != own_size:
            return f"it has {own_size[0]} x {own_size[1]} pixels instead of {size[0]} x {size[1]}"
        if self.facts is None:
            return ""
        if self.facts.scene_hash != scene_hash:
            return f"it was made of another version of the scene ({self.facts.scene_hash}, this one is {scene_hash})"
        different = differences(self.facts.light_paths, light_paths)
        return "its light paths are others: " + ", ".join(different) if different else ""

    def require(self, record: RenderRecord) -> None:
        """Refuse to be compared with a render of something else.

        Raises
        ------
        ValueError
            Saying what differs.
        """
        problem = self.problem(record.scene_hash, record.light_paths, (record.width, record.height))
        if problem:
            raise ValueError(f"the reference of {record.scene} does not fit {record.rival}: {problem}")


def load_reference(folder: Path | None, scene: str) -> Reference | None:
    """The reference `folder/NAME.exr`, if there is one.

    Raises
    ------
    ValueError
        If the JSON beside it cannot be read, or does not say that the picture is not known in some pixels.
    """
    if folder is None or not (folder / f"{scene}.exr").is_file():
        return None
    image = read_exr(folder / f"{scene}.exr")[0]
    try:
        facts = ReferenceFacts(**json.loads((folder / f"{scene}.json").read_text(encoding="utf-8")))
    except FileNotFoundError:
        facts = None
    except (OSError, ValueError, TypeError) as error:
        raise ValueError(f"{folder / scene}.json does not describe a reference: {error}") from error
    if not metrics.known_pixels(image).all() and (facts is None or facts.known >= 1.0):
        raise ValueError(f"{folder / scene}.exr has pixels that are no number: make the reference anew")
    return Reference(image, facts)


def own_error(images: Sequence[Float32Array]) -> metrics.Error:
    """Expected relative squared error of the mean of independent seeds; nan of one."""
    if len(images) < 2:
        return metrics.Error(math.nan, math.nan)
    mean = np.mean(np.stack(images), axis=0)
    return metrics.reduce_error(metrics.seed_variance_map(images, mean, least_seeds=2) / len(images))


def _require_continuation(found: Reference | None, record: RenderRecord, samples: int, folder: Path) -> None:
    """Refuse to add seeds to a reference of something else."""
    if found is None:
        return
    hint = f"; choose another folder than {folder}, or remove it"
    if found.facts is None:
        raise ValueError(f"nothing can be added to the reference of {record.scene}: it does not say what it is{hint}")
    facts = found.facts
    problem = found.problem(record.scene_hash, record.light_paths, (record.width, record.height))
    if not problem and (facts.rival, facts.samples) != (record.rival, samples):
        problem = f"it was made by {facts.rival} with {facts.samples} samples"
    if problem:
        raise ValueError(f"no seeds can be added to the reference of {record.scene}: {problem}{hint}")


def make_references(
    sources: Sequence[SceneSource],
    rival: Rival,
    samples: int,
    seed_count: int,
    *,
    out: Path,
    pixels: int = 0,
    threads: int = 0,
) -> int:
    """Render what is missing of `seed_count` seeds, store means and errors, print; returns the number of failures.

    Seeds that an earlier call left are kept, also where there are more of them.

    Raises
    ------
    ValueError
        If `out` holds a reference of another scene, size, rival, number of samples or light paths.
    """
    rows: list[list[float | int | str | None]] = []
    failures: list[tuple[str, Failure]] = []
    for source in sources:
        found = load_reference(out, source.name)
        stored = len(found.facts.seeds) if found is not None and found.facts is not None else 0

        def check(record: RenderRecord, found: Reference | None = found) -> None:
            _require_continuation(found, record, samples, out)

        renders, failed = render_scene(
            source, [rival], Budget(samples), max(seed_count, stored), out=out / SEEDS, pixels=pixels, threads=threads,
            resume=True, check=check,
        )  # fmt: skip
        failures += [(source.name, failure) for failure in failed]
        done = renders[rival.name]
        if not done:
            continue
        images, records = image_stack(done), [render.record for render in done]
        error = own_error(images)
        facts = ReferenceFacts(
            source.name,
            records[0].scene_hash,
            records[0].light_paths,
            records[0].width,
            records[0].height,
            rival.name,
            samples,
            [record.seed for record in records],
            error.whole,
            error.trimmed,
            sum(record.render_seconds for record in records),
            environment.describe(),
            datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        )
        write_exr(out / f"{source.name}.exr", np.mean(np.stack(images), axis=0, dtype=np.float64).astype(np.float32))
        (out / f"{source.name}.json").write_text(json.dumps(asdict(facts), indent=1) + "\n", encoding="utf-8")
        size = f"{facts.width}x{facts.height}"
        rows.append(
            [source.name, rival.name, size, samples, len(images), error.whole, error.trimmed, facts.render_seconds]
        )
    print(f"\nReferences in {out}; errors are of the mean, from the variance between seeds\n")
    print(table(["scene", "rival", "size", "spp", "seeds", "own error", "trimmed", "render s"], rows))
    for name, failure in failures:
        print(f"failed: {name}, {failure.rival}: {failure.message}")
    return len(failures)
