# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks papers`: methods of guiding by the protocols of the papers they come from."""

from __future__ import annotations

import importlib.metadata
import json
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import environment, metrics
from benchmarks.images import Float32Array
from benchmarks.rendering import Failure, Render, RenderRecord, image_stack, render_scene
from benchmarks.rivals import Budget, find_rival
from benchmarks.run import find_reference
from benchmarks.scene_files import SceneSource
from benchmarks.tables import format_figure, geometric_mean, table

#: What no paper's renderer has: Blender's ways of losing light for less noise, and what this engine decides by itself
#: about guiding. Networks are trained in step with the render, as the papers do between passes.
_PLAIN: dict[str, Any] = {
    "clamp_direct": 0.0,
    "clamp_indirect": 0.0,
    "filter_glossy": 0.0,
    "light_sampling_threshold": 0.0,
    "use_caustics_reflective": True,
    "use_caustics_refractive": True,
    "guiding_probability": 0.5,
    "learn_guiding_probability": False,
    "guiding_trial": False,
    "deterministic": True,
}
#: Beyond this share of pixels without light the variance over seeds is not the error.
_MOST_UNLIT = 0.01
#: The NPM authors' program scatters paths ten times, and so does a limit of nine bounces.
_NPM_BOUNCES = 9


@dataclass(frozen=True)
class Protocol:
    """How a paper compares methods.

    measure : str
        The paper's figure of error, by which methods are ranked: "relMSE" or "MAPE".
    settings : mapping
        Settings of all methods, by their names in `engine.settings.RenderSettings`; the rest is the scene's.
    paper_gains : mapping
        Error of OFF over a method's in the paper: geometric mean over the paper's scenes.
    source : str
        Where the paper says so.
    """

    name: str
    methods: tuple[str, ...]
    samples: int
    measure: str
    settings: Mapping[str, Any]
    paper_gains: Mapping[str, float]
    source: str


PROTOCOLS = {
    "npm": Protocol(
        "npm",
        ("OFF", "SDTREE", "SDTREE_VARIANCE", "VMM", "NPM", "NPM_PRODUCT"),
        750,
        "relMSE",
        _PLAIN
        | {"use_nee": False, "use_russian_roulette": False}
        | dict.fromkeys(("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces"), _NPM_BOUNCES),
        {"OFF": 1.0, "SDTREE": 2.19, "SDTREE_VARIANCE": 2.46, "NPM": 3.78, "NPM_PRODUCT": 4.62},
        "Dong et al. 2023, section 6 and Table 2 (10 scenes)",
    ),
    "nasg": Protocol(
        "nasg",
        ("OFF", "NASG-RADIANCE", "NASG-COSINE", "NASG", "NASG-SG", "NPM"),
        1024,
        "MAPE",
        _PLAIN | {"use_nee": True, "network_selection": True},
        {"OFF": 1.0, "NASG-RADIANCE": 1.75, "NASG-COSINE": 1.89, "NASG": 2.96, "NASG-SG": 2.51},
        "Huang et al. 2024, section 7.1 and Table 3 (8 scenes)",
    ),
    "4d": Protocol(
        "4d",
        ("OFF", "VMM", "NPM", "NPM-FREQUENCY", "NPM-PLANES", "NPM-HASH4D", "NPM-STRATA"),
        512,
        "relMSE",
        _PLAIN
        | {"use_nee": False, "use_russian_roulette": False}
        | dict.fromkeys(("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces"), _NPM_BOUNCES),
        {"OFF": 1.0, "NPM": 1.92, "NPM-PLANES": 2.14, "NPM-STRATA": 2.71},
        "Dong et al. 2024, section 6 and Table 1 (equal time, 5 scenes); Table 2 has the alternatives on one scene",
    ),
}


@dataclass
class MethodResult:
    """One method on one scene; nan where there is nothing to say.

    error, error_trimmed : relative squared error by the variance over seeds (no bias in it)
    mape, mape_trimmed : percentage error against the denominator of the scene, medians over seeds
    seed_error, seed_mape : trimmed, by seed: what each adds to `error`, and each one's `mape_trimmed`
    seed_seconds, samples : render seconds by seed; median samples per pixel
    brightness : mean of its pictures over that of all methods': far from 1, it has missed light or met a firefly
    unlit : share of the pixels in which some method found light and this one none, in no seed. The variance over seeds
        is 0 there, though the error is not
    remarks : what the engine noted about guiding, such as the loss of a training process
    """

    scene: str
    method: str
    samples: float
    seed_seconds: dict[int, float]
    error: float = math.nan
    error_trimmed: float = math.nan
    mape: float = math.nan
    mape_trimmed: float = math.nan
    seed_error: dict[int, float] = field(default_factory=dict)
    seed_mape: dict[int, float] = field(default_factory=dict)
    brightness: float = math.nan
    unlit: float = math.nan
    remarks: list[str] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Median render seconds, training waited for included."""
        return float(statistics.median(self.seed_seconds.values()))


@dataclass(frozen=True)
class Gain:
    """Error of one method over another's, above 1 where the other is better: median over seeds, and their range."""

    median: float = math.nan
    least: float = math.nan
    most: float = math.nan

    def __str__(self) -> str:
        text = format_figure(self.median)
        # Two seeds are both as far from their mean: no range.
        if math.isclose(self.least, self.most, rel_tol=1e-6) or math.isnan(self.least):
            return text
        return f"{text} ({format_figure(self.least)} to {format_figure(self.most)})"


def mean_image(renders: Mapping[str, Sequence[Render]]) -> Float32Array:
    """Mean of all pictures, float32 (height, width, 4): what errors are relative to, the same for all methods."""
    return np.mean(np.stack([image for some in renders.values() for image in image_stack(some)]), axis=0)


def evaluate(scene: str, renders: Mapping[str, Sequence[Render]], reference: Float32Array | None) -> list[MethodResult]:
    """Errors of all methods on one scene.

    Variances over seeds need two of them. Percentage errors are taken against `reference`, or else against the mean of
    all renders, whose noise they hold: that brings methods nearer to each other than they are.
    """
    if not any(renders.values()):
        return []
    mean = mean_image(renders)
    truth = mean if reference is None else reference
    results = []
    for method, some in renders.items():
        if not some:
            continue
        records, images = [render.record for render in some], image_stack(some)
        seeds = [record.seed for record in records]
        result = MethodResult(
            scene,
            method,
            float(statistics.median(record.samples for record in records)),
            dict(zip(seeds, (record.render_seconds for record in records), strict=True)),
            brightness=float(np.mean(np.stack(images)[..., :3])) / metrics.image_scale(mean),
            unlit=_unlit_share(images, mean),
            remarks=list(dict.fromkeys(remark for record in records for remark in guiding_remarks(record))),
        )
        if len(images) >= 2:
            error = metrics.seed_variance(images, mean, least_seeds=2)
            result.error, result.error_trimmed = error.whole, error.trimmed
            deviations = metrics.seed_deviations(images, mean)
            result.seed_error = {seed: one.trimmed for seed, one in zip(seeds, deviations, strict=True)}
        shares = [metrics.percentage_error(image, truth) for image in images]
        result.mape = float(statistics.median(one.whole for one in shares))
        result.mape_trimmed = float(statistics.median(one.trimmed for one in shares))
        result.seed_mape = {seed: one.trimmed for seed, one in zip(seeds, shares, strict=True)}
        results.append(result)
    return results


def _unlit_share(images: Sequence[Float32Array], mean: Float32Array) -> float:
    """Share of the lit pixels of `mean` that are black in all of `images`."""
    is_lit = (mean[..., :3] > 0.0).any(axis=-1)
    is_own = np.stack([(image[..., :3] != 0.0).any(axis=-1) for image in images]).any(axis=0)
    return float((is_lit & ~is_own).sum() / max(int(is_lit.sum()), 1))


def guiding_remarks(record: RenderRecord) -> list[str]:
    """Notices about guiding: a network whose training died is no network."""
    return [str(notice) for notice in record.details.get("notices", []) if str(notice).startswith("Guiding")]


def used_measure(measure: str, results: Sequence[MethodResult]) -> str:
    """`measure`, or "MAPE" where a method has one seed only, whose variance is unknown."""
    return measure if all(len(result.seed_error) >= 2 for result in results) else "MAPE"


def gain(base: MethodResult | None, of: MethodResult, measure: str) -> Gain:
    """How much smaller the trimmed error of `of` is than that of `base`, over the seeds that both have."""
    if base is None:
        return Gain()
    pairs = [(r.seed_error if measure == "relMSE" else r.seed_mape) for r in (base, of)]
    ratios = [pairs[0][seed] / error for seed, error in pairs[1].items() if seed in pairs[0] and error > 0.0]
    if not ratios:
        return Gain()
    return Gain(float(statistics.median(ratios)), min(ratios), max(ratios))


def _find(results: Sequence[MethodResult], scene: str, method: str) -> MethodResult | None:
    return next((r for r in results if (r.scene, r.method) == (scene, method)), None)


def result_table(results: Sequence[MethodResult], measure: str) -> str:
    """Errors and seconds of every method, and the ratios of OFF's and SDTREE's error to its own."""
    rows = []
    for r in results:
        rows.append(
            [
                r.scene,
                r.method,
                r.samples,
                r.seconds,
                r.error,
                r.error_trimmed,
                r.mape,
                r.mape_trimmed,
                r.brightness,
                r.unlit,
                str(gain(_find(results, r.scene, "OFF"), r, measure)),
                str(gain(_find(results, r.scene, "SDTREE"), r, measure)),
            ]
        )
    header = [
        "scene", "method", "spp", "render s", "relMSE", "trimmed", "MAPE", "trimmed", "mean", "unlit",
        f"OFF / it, {measure}", f"SDTREE / it, {measure}",
    ]  # fmt: skip
    return table(header, rows)


def summary_table(results: Sequence[MethodResult], measure: str, paper_gains: Mapping[str, float]) -> str:
    """Geometric means over scenes of the ratios, beside the paper's."""
    rows: list[list[float | int | str | None]] = []
    for method in dict.fromkeys(r.method for r in results):
        own = [r for r in results if r.method == method]
        row: list[float | int | str | None] = [method, len(own)]
        for base in ("OFF", "SDTREE"):
            gains = [gain(_find(results, r.scene, base), r, measure).median for r in own]
            row += [geometric_mean(gains), paper_gains.get(method, math.nan) / paper_gains.get(base, math.nan)]
        off_seconds = [
            r.seconds / max(off.seconds, 1e-6) for r in own if (off := _find(results, r.scene, "OFF")) is not None
        ]
        rows.append([*row, geometric_mean(off_seconds)])
    header = ["method", "scenes", "OFF / it", "paper", "SDTREE / it", "paper", "seconds, OFF = 1"]
    return table(header, rows)


def _versions() -> dict[str, str]:
    """Versions that a method's result depends on: the harness's, and what trains the networks."""
    versions = dict(environment.describe()["versions"])
    try:
        versions["torch"] = importlib.metadata.version("torch")
    except importlib.metadata.PackageNotFoundError:
        versions["torch"] = ""
    return versions


def compare_methods(
    protocol: Protocol,
    sources: Sequence[SceneSource],
    *,
    seed_count: int,
    out: Path,
    methods: Sequence[str] | None = None,
    samples: int = 0,
    pixels: int = 0,
    threads: int = 0,
    sample_weighting: str = "ITERATION",
    references: Path | None = None,
) -> int:
    """Render, evaluate, print, write `out/summary.json`. What `out` holds is kept, but for renders with remarks.

    Parameters
    ----------
    methods : sequence of str, optional
        Names of rivals of ours (`find_rival`) instead of the protocol's.
    samples : int
        Per pixel; 0 = the protocol's.
    references : path, optional
        Folder of NAME.exr, for percentage errors; they set the size too.

    Returns
    -------
    int
        Number of failures, renders with remarks included.

    Raises
    ------
    ValueError
        For a method there is not.
    """
    settings = {**protocol.settings, "sample_weighting": sample_weighting}
    rivals = [find_rival(method, settings) for method in methods or protocol.methods]
    budget = Budget(samples or protocol.samples)
    results: list[MethodResult] = []
    failures: list[tuple[str, Failure]] = []
    compared_with = {}
    for source in sources:
        reference = find_reference(references, source)
        size = (reference.shape[1], reference.shape[0]) if reference is not None else None
        renders, failed = render_scene(
            source, rivals, budget, seed_count, out=out, pixels=pixels, size=size, threads=threads, resume=True,
            is_usable=lambda record: not guiding_remarks(record),
        )  # fmt: skip
        failures += [(source.name, failure) for failure in failed]
        results += evaluate(source.name, renders, reference)
        compared_with[source.name] = "the mean of all renders" if reference is None else "a reference"

    measure = used_measure(protocol.measure, results)
    facts = {**environment.describe(), "versions": _versions()}
    used_threads = threads or facts["cores"]
    print(f"\n{protocol.source}: {budget}, {seed_count} seeds, {used_threads} threads, commit {facts['commit']}")
    print(", ".join(f"{name} {value}" for name, value in settings.items()))
    print(f"MAPE against {' or '.join(sorted(set(compared_with.values())))}; medians over seeds (and their range)")
    if measure != protocol.measure:
        print(f"{protocol.measure} needs 2 seeds of every method: ratios are of {measure}")
    print(f"\n{result_table(results, measure)}\n\n{summary_table(results, measure, protocol.paper_gains)}")
    for r in results:
        for remark in r.remarks:
            print(f"{r.scene}, {r.method}: {remark} (the same command renders it again)")
        if r.unlit > _MOST_UNLIT:
            print(f"{r.scene}, {r.method}: no light in {r.unlit:.1%} of the lit pixels, whose error relMSE misses")
    for name, failure in failures:
        print(f"failed: {name}, {failure.rival}: {failure.message}")

    out.mkdir(parents=True, exist_ok=True)
    summary = {
        "protocol": protocol.name,
        "source": protocol.source,
        "environment": facts,
        "budget": asdict(budget),
        "threads": used_threads,
        "settings": settings,
        "methods": {rival.name: rival.settings for rival in rivals},
        "measure": measure,
        "mape_against": compared_with,
        "results": [
            asdict(r)
            | {
                f"{base.lower()}_over_it": asdict(gain(_find(results, r.scene, base), r, measure))
                for base in ("OFF", "SDTREE")
            }
            for r in results
        ],
        "failures": [{"scene": name, **asdict(failure)} for name, failure in failures],
    }
    (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    return len(failures) + sum(bool(r.remarks) for r in results)
