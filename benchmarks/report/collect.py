# SPDX-License-Identifier: GPL-3.0-or-later
"""Finding records in a folder, and sorting them into scenes, rivals and budgets."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.images import read_exr
from benchmarks.reference import SEEDS, Reference, load_reference
from benchmarks.rendering import Render, RenderRecord
from benchmarks.report.look import LOOKS
from benchmarks.rivals import DENOISED, VARIANTS, Budget


@dataclass(eq=False)
class Batch:
    """Renders of one rival under one budget, one a seed."""

    rival: str
    budget: Budget
    renders: list[Render]

    @property
    def records(self) -> list[RenderRecord]:
        """What is known of each."""
        return [render.record for render in self.renders]


@dataclass
class SceneResults:
    """All that may be compared with each other: one scene in one version, size and number of threads.

    name : unique on the page
    """

    name: str
    scene: str
    scene_hash: str
    width: int
    height: int
    threads: int
    batches: list[Batch]
    reference: Reference | None = None
    remarks: list[str] = field(default_factory=list)

    @property
    def rivals(self) -> list[str]:
        """Names, each once, in the order of the batches."""
        return list(dict.fromkeys(batch.rival for batch in self.batches))

    def of_rival(self, rival: str) -> list[Batch]:
        """Batches of one rival, the smallest budget first."""
        return [batch for batch in self.batches if batch.rival == rival]

    def final_budget(self) -> Budget:
        """The largest budget of those that most rivals have been rendered with."""
        counts: dict[Budget, int] = {}
        for batch in self.batches:
            counts[batch.budget] = counts.get(batch.budget, 0) + 1
        return max(counts, key=lambda budget: (counts[budget], budget.seconds, budget.samples))

    def final(self) -> list[Batch]:
        """Batches of `final_budget`, in the order of `rivals`."""
        budget = self.final_budget()
        return [batch for rival in self.rivals for batch in self.of_rival(rival) if batch.budget == budget]


def rival_label(record: RenderRecord) -> str:
    """The rival's name, with the settings that are not what its name says."""
    usual = VARIANTS.get(record.rival.removesuffix(DENOISED), {})
    told = {name: value for name, value in record.settings.items() if name not in usual}
    return record.rival + "".join(f" {name}={value}" for name, value in sorted(told.items()))


def read_renders(folder: Path) -> tuple[list[Render], list[str]]:
    """All renders below a folder that have picture and record, and what is wrong with others.

    JSON files that are no records of renders are passed over, and so are the seeds of references.
    """
    renders, remarks = [], []
    for path in sorted(folder.rglob("*.json")):
        if SEEDS in path.relative_to(folder).parts[:-1] or not path.with_suffix(".exr").is_file():
            continue
        try:
            record = RenderRecord(**json.loads(path.read_text(encoding="utf-8")))
            renders.append(Render(read_exr(path.with_suffix(".exr"))[0], record))
        except TypeError:
            continue  # a reference, which has a JSON of its own kind
        except (OSError, ValueError, RuntimeError) as error:
            remarks.append(f"{path.relative_to(folder)} is left out: {error}")
    return renders, remarks


def collect(folder: Path, references: Path | None = None) -> tuple[list[SceneResults], list[str]]:
    """Scenes in the order of their names, and remarks that concern none of them.

    The newest of several renders of one rival, budget and seed counts.

    Raises
    ------
    ValueError
        If the folder holds no renders.
    """
    renders, remarks = read_renders(folder)
    if not renders:
        raise ValueError(f"no renders in {folder}: run `python -m benchmarks sweep` first, with the same --out")
    groups: dict[tuple[str, str, int, int, int], dict[tuple[str, Budget, int], Render]] = {}
    for render in sorted(renders, key=lambda r: r.record.date):
        r = render.record
        group = groups.setdefault((r.scene, r.scene_hash, r.width, r.height, r.threads), {})
        limit = (1, r.seconds_asked) if r.seconds_asked else (r.samples_asked, 0.0)
        budget = Budget(*limit, r.noise_threshold)
        group[rival_label(r), budget, r.seed] = render
    scenes = []
    for (scene, scene_hash, width, height, threads), found in sorted(groups.items()):
        same_name = [key for key in groups if key[0] == scene]
        name = scene if len(same_name) == 1 else f"{scene} ({width} x {height}, {threads} threads, {scene_hash[:6]})"
        batches: dict[tuple[str, Budget], Batch] = {}
        for (rival, budget, _), render in sorted(found.items(), key=_order):
            batches.setdefault((rival, budget), Batch(rival, budget, [])).renders.append(render)
        results = SceneResults(name, scene, scene_hash, width, height, threads, list(batches.values()))
        results.remarks += _version_remarks(results)
        _attach_reference(results, references)
        scenes.append(results)
    return scenes, remarks


def _order(item: tuple[tuple[str, Budget, int], Render]) -> tuple[int, str, float, int, int]:
    """Rivals in the order of their looks, Cycles' first, others by name; then budgets; then seeds."""
    (rival, budget, seed), _ = item
    known = list(LOOKS)
    rank = known.index(rival) if rival in known else len(known)
    return rank, rival, budget.seconds, budget.samples, seed


def _version_remarks(scene: SceneResults) -> list[str]:
    """Whether rivals of ours are of different versions of the engine."""
    versions = {
        record.environment.get("sources_hash", ""): record.environment.get("commit", "")
        for batch in scene.batches
        if not batch.rival.startswith("cycles")
        for record in batch.records
    }
    if len(versions) < 2:
        return []
    return [f"renders are of {len(versions)} versions of the engine: {', '.join(sorted(versions.values()))}"]


def _attach_reference(scene: SceneResults, folder: Path | None) -> None:
    """Take the reference that lies in `folder`, or say why not."""
    if folder is None:
        return
    try:
        found = load_reference(folder, scene.scene)
        if found is None:
            scene.remarks.append(f"there is no reference in {folder.name}")
            return
        for batch in scene.batches:
            for record in batch.records:
                found.require(record)
    except ValueError as error:
        scene.remarks.append(f"reference refused: {error}")
        return
    scene.reference = found
