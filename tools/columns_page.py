# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m tools.columns_page` writes docs/columns.md from the declarations of the columns."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from engine.guiding.records.taught import TaughtRecords
from engine.guiding.records.vertices import VertexLog, VertexRecords
from engine.ris.candidates import Candidates
from engine.runtime.bundle import Bundle
from engine.state import lanes
from engine.state.columns import Column, columns_of, dtype_of
from engine.state.film import FilmTile
from engine.state.media import MediaLanes
from engine.state.tracking import TrackedLanes

PAGE = Path(__file__).resolve().parents[1] / "docs" / "columns.md"

_HEAD = """\
# Columns

What a render keeps by pixel, by record and by path is kept in tables. A column is declared once, where its class lists
it (`engine/state/columns.py`). `python -m tools.columns_page` writes this page from the declarations.

To add a column, add a line to its class, and write and read it. Nothing else knows which columns there are.

- The film: `FilmTile` in `engine/state/film.py`. The line says how the column is merged. A stage in
  `engine/wavefront/` writes it, and `engine/render/film.py` makes a pass of it.
- Records: `VertexRecords` in `engine/guiding/records/vertices.py`, where `collect_records` writes it. A model in
  `engine/guiding/` reads it.
- Lanes: a class in `engine/state/`. The line says in which cache line the column lies. Stages write and read it.

A size with a condition is 0 where that does not hold. `P` are pixels, `R` records, `L` lanes, `N` candidates and `C`
channels.
"""

_PARTS: dict[str, tuple[type[Bundle], ...]] = {
    "Film": (FilmTile,),
    "Records": (VertexRecords, TaughtRecords, VertexLog),
    "Lanes": (
        lanes.PathState, lanes.ShadePoints, lanes.Closures, lanes.LightSamples, lanes.ShadowRays, lanes.GuidedLanes,
        lanes.CachedLanes, lanes.LightPassLanes, lanes.FeatureLanes, lanes.CatcherLanes, MediaLanes, TrackedLanes,
        lanes.LightDraws, Candidates,
    ),
}  # fmt: skip


def _shape(declared: Column) -> str:
    rows, *inner = map(str, declared.shape)
    if declared.needs:
        rows = f"{rows} if `{declared.needs}`"
    return " × ".join([rows, *inner])


def _table(table: type[Bundle]) -> Iterator[str]:
    declared = columns_of(table)
    is_merged = any(of.merge for of in declared.values())
    module = table.__module__.replace(".", "/") + ".py"
    yield f"### {table.__name__}\n"
    yield f"`{module}`. {(table.__doc__ or '').partition(chr(10))[0]}\n"
    yield "| column | dtype | shape | holds |" + (" merged |" if is_merged else "")
    yield "|---|---|---|---|" + ("---|" if is_merged else "")
    for name, of in declared.items():
        cells = [f"`{name}`", str(dtype_of(table, name)), _shape(of), of.about]
        if of.merge:
            cells.append(str(of.merge.value) + (f", that of `{of.weight}`" if of.weight else ""))
        yield "| " + " | ".join(cells) + " |"
    yield ""


def page() -> str:
    """The whole page."""
    lines = [_HEAD]
    for part, tables in _PARTS.items():
        lines.append(f"## {part}\n")
        for table in tables:
            lines += _table(table)
    return "\n".join(lines).rstrip("\n") + "\n"


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")
    print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
