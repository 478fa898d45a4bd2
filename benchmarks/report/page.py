# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks report`: one page of charts, figures and pictures out of records."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from html import escape
from pathlib import Path

from benchmarks.profiling import read_bare_rates
from benchmarks.reference import NOTABLE_SHARE
from benchmarks.report import charts, html
from benchmarks.report.collect import SceneResults, collect
from benchmarks.report.figures import (
    BETTER_CYCLES,
    LEAST_SEEDS,
    MEASURES,
    RELMSE,
    RELMSE_TRIMMED,
    TIME_KINDS,
    Point,
    Ratios,
    denominator,
    efficiency_ratios,
    mean_time,
    measure_scene,
    pareto_front,
)
from benchmarks.report.pictures import file_name, write_pictures
from benchmarks.report.scaling_charts import scaling_section
from benchmarks.report.viewer import crops, viewer
from benchmarks.tables import format_figure

_HERE = Path(__file__).parent
PAGE = "index.html"


def reference_remarks(scene: SceneResults, points: Sequence[Point]) -> list[str]:
    """Whether the scene has a reference, and where that is too noisy for what is measured against it."""
    if scene.reference is None:
        return [
            f"There is no reference: errors are the variance over seeds, which sees no bias and needs {LEAST_SEEDS} of"
            " them; MAPE and FLIP need a reference."
        ]
    facts = scene.reference.facts
    if facts is None:
        return ["The reference does not say what it was made of, nor how large its own error is."]
    said = (
        f"Reference: mean of {len(facts.seeds)} seeds of {facts.samples} samples by {facts.rival}; its own error is"
        f" {format_figure(facts.error)}, trimmed {format_figure(facts.error_trimmed)}."
    )
    noisy = []
    for p in points:
        share = facts.error_trimmed / max(p.errors[RELMSE_TRIMMED].centre, 1e-30)
        if share > NOTABLE_SHARE:
            noisy.append(f"{p.rival} after {p.budget} ({share:.0%})")
    if noisy:
        return [
            said,
            f"Warning: the reference's own error is more than {NOTABLE_SHARE:.0%} of what is measured for"
            f" {', '.join(noisy)}. Those errors are too large, and gains over others too small.",
        ]
    return [said]


def _remark(text: str) -> str:
    kind = ' class="warning"' if text.startswith(("Warning", "reference refused")) else ' class="soft"'
    return f"<p{kind}>{escape(text)}</p>"


def _figures_table(scene: SceneResults, points: Sequence[Point], bare_rate: float) -> str:
    """All figures of a scene; `bare_rate`: rays a second of bare Embree by all threads, 0 where it is not known."""
    known = [name for name in MEASURES if any(name in p.errors for p in points)]
    front = pareto_front(points, RELMSE_TRIMMED)
    rows = []
    for p in points:
        row: list[html.Cell] = [p.rival, str(p.budget), p.seed_count, p.seconds, p.samples]
        for name in known:
            if name in p.errors:
                e = p.errors[name]
                row.append(f"{format_figure(e.centre)} ({format_figure(e.low)} to {format_figure(e.high)})")
            else:
                row.append(None)
        if bare_rate > 0.0:
            row.append(p.ray_count / bare_rate if p.ray_count > 0.0 else None)
        rows.append(
            [*row, p.seed_error, "yes" if any(p is one for one in front) else "", p.training_end, p.chosen or None]
        )
    header = [
        "rival", "budget", "seeds", "render s", "spp", *known, *(["rays alone [s]"] if bare_rate > 0.0 else []),
        "seed error, trimmed", "on the front",
        "learned until [spp]", "chose",
    ]  # fmt: skip
    return html.table(f"{scene.name}: medians over seeds, and the range of single seeds", header, rows, rival_column=0)


def _time_table(scene: SceneResults) -> str:
    times = [(batch.rival, mean_time(batch)) for batch in scene.final()]
    kinds = [kind for kind in TIME_KINDS if any(kind in one for _, one in times)]
    rows: list[list[html.Cell]] = [[rival, *(one.get(kind) for kind in kinds)] for rival, one in times]
    caption = f"{scene.name}, {scene.final_budget()}: seconds of all threads together, mean over seeds"
    return html.table(caption, ["rival", *kinds], rows, rival_column=0)


def _scene_section(
    scene: SceneResults, points: list[Point], folder: Path, identifier: str, bare_rate: float
) -> str:
    """Charts, figures and pictures of one scene; writes their files. `bare_rate` as in `charts.draw_errors`."""
    prefix = identifier
    budget = str(scene.final_budget())
    parts = [
        f'<section aria-labelledby="{identifier}"><h2 id="{identifier}">{escape(scene.name)}</h2>',
        f'<p class="soft">{scene.width} x {scene.height} pixels, {scene.threads} threads, version'
        f" {escape(scene.scene_hash)}</p>",
        *(_remark(text) for text in [*reference_remarks(scene, points), *scene.remarks]),
    ]
    has_errors = any(p.errors for p in points)
    if not has_errors:
        parts.append(_remark(f"Warning: without a reference and with less than {LEAST_SEEDS} seeds no error is known."))
    else:
        own = {}
        if scene.reference is not None and scene.reference.facts is not None:
            own = {RELMSE: scene.reference.facts.error, RELMSE_TRIMMED: scene.reference.facts.error_trimmed}
        for over, name in (("seconds", "time"), ("samples", "samples")):
            charts.error_chart(folder / f"{prefix}_error_{name}.png", points, scene.rivals, over, own, bare_rate)
        charts.front_chart(folder / f"{prefix}_front.png", points, scene.rivals)
        names = ", ".join(scene.rivals)
        band = "Lines: medians over seeds (variance over all, without a reference); bands: the range of single seeds."
        if bare_rate > 0.0:
            band += " Dotted: the time that the same rays would take by bare Embree, the limit of a faster tracer."
        front = ", ".join(f"{p.rival} at {format_figure(p.seconds)} s" for p in pareto_front(points, RELMSE_TRIMMED))
        parts += [
            "<h3>Error over time and over samples</h3>",
            html.chart(
                f"{prefix}_error_time.png", f"Error of {names} over render time, logarithmic; figures below", band
            ),
            html.chart(
                f"{prefix}_error_samples.png",
                f"Error of {names} over samples per pixel, logarithmic; figures below",
                "A star and a dotted line: nothing was learned from there on. Without one, learning went on to the"
                " end.",
            ),
            html.details("Figures of these charts", _figures_table(scene, points, bare_rate)),
            "<h3>Speed against accuracy</h3>",
            html.chart(
                f"{prefix}_front.png",
                f"Trimmed error against render time. On the front: {front}",
                f"Nearer to the lower left is better. On the front, where nothing is both quicker and better: {front}.",
            ),
        ]
    truth = denominator(scene)
    pictures = write_pictures(scene, truth, folder, prefix)
    final = scene.final()
    charts.time_chart(folder / f"{prefix}_time.png", final)
    memory = {batch.rival: max(r.peak_memory_mib for r in batch.records) for batch in final}
    charts.bar_chart(folder / f"{prefix}_memory.png", memory, "peak memory of the process [MiB]")
    shares = ", ".join(f"{rival} {format_figure(value)} MiB" for rival, value in memory.items())
    parts += [
        "<h3>Side by side</h3>",
        viewer(scene, pictures, identifier),
        "<h3>Where rivals differ most</h3>",
        crops(scene, pictures),
        "<h3>Time and memory</h3>",
        '<div class="charts">',
        html.chart(
            f"{prefix}_time.png",
            f"Thread seconds by kind of work after {budget}; figures below",
            f"After {budget}. Inference: asking what was learned; waiting: between stages, and for learning. Cycles"
            " tells its time as a whole. Training beside the render makes bars longer than threads times seconds.",
        ),
        html.chart(
            f"{prefix}_memory.png",
            f"Peak memory after {budget}: {shares}",
            f"After {budget}, largest of all seeds. Rivals share a process unless the sweep was made with --isolate.",
        ),
        "</div>",
        html.details("Figures of the time chart", _time_table(scene)),
        "</section>",
    ]
    return "".join(parts)


def _ratio_rows(ratios: Ratios) -> list[tuple[str, list[float]]]:
    return [
        (rival, [ratios.mean(rival), *(ratios.values[rival].get(scene, math.nan) for scene in ratios.scenes)])
        for rival in ratios.values
    ]


def _efficiency_section(
    scenes: Sequence[SceneResults], points: dict[str, list[Point]], folder: Path
) -> tuple[str, dict[str, dict[str, dict[str, float]]]]:
    """Efficiency relative to Cycles, as tables with bars and a chart; and the figures for `report.json`."""
    finals = {
        scene.name: [p for p in points[scene.name] if p.budget == scene.final_budget()] for scene in scenes
    }
    budgets = ", ".join(f"{scene.name} {scene.final_budget()}" for scene in scenes)
    parts = [
        '<section aria-labelledby="efficiency"><h2 id="efficiency">Efficiency relative to Cycles</h2>',
        f'<p class="soft">1 / (trimmed relMSE x render seconds); above 1 is better. After {escape(budgets)}.</p>',
        '<div class="charts">',
    ]
    figures: dict[str, dict[str, dict[str, float]]] = {}
    has_reference = any(scene.reference is not None for scene in scenes)
    kinds = [(False, "")]
    if has_reference:
        kinds = [(False, ", against references where there are some"), (True, ", by the variance over seeds alone")]
    for by_seeds, how in kinds:
        for base in (None, BETTER_CYCLES):
            ratios = efficiency_ratios(finals, base, by_seeds)
            if ratios is None:
                continue
            caption = f"Efficiency, {ratios.base} = 1{how}"
            parts.append(html.bar_table(caption, ["rival", "geometric mean", *ratios.scenes], _ratio_rows(ratios)))
            figures[caption] = ratios.values
            if not by_seeds and base is None:
                means = {rival: ratios.mean(rival) for rival in ratios.values}
                unit = f"efficiency, {ratios.base} = 1, geometric mean"
                charts.bar_chart(folder / "efficiency.png", means, unit, 1.0)
                said = ", ".join(f"{rival} {format_figure(value)}" for rival, value in means.items())
                parts.append(
                    html.chart(
                        "efficiency.png", f"Geometric means: {said}",
                        "Geometric mean over scenes, of rivals that have a figure in all of them.",
                    )
                )  # fmt: skip
    parts.append("</div>")
    if not figures:
        parts.append('<p class="soft">No rival of Cycles, or too few seeds, among the records.</p>')
    parts.append("</section>")
    return "".join(parts), figures


def _hardware(scenes: Sequence[SceneResults]) -> str:
    """Machines, versions and commits of all records."""
    records = [record for scene in scenes for batch in scene.batches for record in batch.records]

    def said(values: set[str]) -> str:
        return escape("; ".join(sorted(value for value in values if value)) or "unknown")

    environments = [record.environment for record in records]
    versions = {
        ", ".join(f"{name} {version}" for name, version in e.get("versions", {}).items() if version)
        for e in environments
    }
    dates = sorted(record.date for record in records if record.date)
    rows = [
        ("Processor", said({f"{e.get('cpu', '')}, {e.get('cores', '?')} cores" for e in environments if e})),
        ("Threads", said({str(record.threads) for record in records})),
        ("Versions", said(versions)),
        ("Commit (ours)", said({str(e.get("commit", "")) for e in environments})),
        ("Rendered", said({f"{dates[0]} to {dates[-1]}"} if dates else set())),
    ]
    body = "".join(f'<tr><th scope="row">{name}</th><td>{text}</td></tr>' for name, text in rows)
    return (
        '<section aria-labelledby="machine"><h2 id="machine">Machine and versions</h2>'
        f'<table class="plain">{body}</table></section>'
    )


def write_report(folder: Path, to: Path, references: Path | None = None) -> Path:
    """Write the page and its pictures; returns the page's path.

    Parameters
    ----------
    folder : of records, as `sweep` or `run` left them
    to : folder for the page; what it holds of an earlier one is overwritten
    references : folder that `make_references` wrote, optional

    Raises
    ------
    ValueError
        If there are no renders.
    """
    scenes, remarks = collect(folder, references)
    to.mkdir(parents=True, exist_ok=True)
    points = {scene.name: measure_scene(scene) for scene in scenes}
    efficiency, ratios = _efficiency_section(scenes, points, to)
    scaling = scaling_section(folder, to)
    identifiers = {scene.name: f"scene-{number}-{file_name(scene.scene)}" for number, scene in enumerate(scenes, 1)}
    bare_rates = read_bare_rates(folder)
    sections = [
        _scene_section(
            scene, points[scene.name], to, identifiers[scene.name], bare_rates.get(scene.scene, 0.0) * scene.threads
        )
        for scene in scenes
    ]
    links = [("efficiency", "Efficiency"), *((identifiers[scene.name], scene.name) for scene in scenes)]
    links += [("scaling", "Scaling")] if scaling else []
    links.append(("machine", "Machine"))
    navigation = "".join(f'<li><a href="#{target}">{escape(name)}</a></li>' for target, name in links)
    style, script = ((_HERE / name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    page = (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>Speed against accuracy</title><style>{style}</style></head><body>'
        "<header><h1>Speed against accuracy</h1></header>"
        f'<nav aria-label="Contents"><ul>{navigation}</ul></nav><main>'
        + "".join(_remark(f"Warning: {text}") for text in remarks)
        + efficiency
        + "".join(sections)
        + scaling
        + _hardware(scenes)
        + f"</main><script>{script}</script></body></html>\n"
    )
    (to / PAGE).write_text(page, encoding="utf-8")
    _write_figures(to / "report.json", points, ratios)
    return to / PAGE


def _write_figures(
    path: Path, points: dict[str, list[Point]], ratios: dict[str, dict[str, dict[str, float]]]
) -> None:
    """The page's figures for programs."""
    listed = {
        scene: [
            {
                "rival": p.rival, "budget": str(p.budget), "seeds": p.seed_count, "seconds": p.seconds,
                "samples": p.samples, "memory_mib": p.memory_mib, "seed_error_trimmed": p.seed_error,
                "training_end": p.training_end, "chosen": p.chosen,
                "errors": {name: [e.low, e.centre, e.high] for name, e in p.errors.items()},
            }
            for p in some
        ]
        for scene, some in points.items()
    }  # fmt: skip
    path.write_text(json.dumps({"scenes": listed, "efficiency": ratios}, indent=1) + "\n", encoding="utf-8")
