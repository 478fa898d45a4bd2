# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m tools.columns_page` writes docs/columns.md from the declarations of the columns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from engine.guiding.records.cache_records import CacheRecords
from engine.guiding.records.vertices import VertexLog, VertexRecords
from engine.ris.candidates import Candidates
from engine.runtime.bundle import Bundle
from engine.state import lanes
from engine.state.columns import Column, columns_of, dtype_of
from engine.state.film import FilmTile, Merge
from engine.state.media import MediaLanes
from engine.state.passed_hits import PassedHits
from engine.state.tracking import TrackedLanes
from engine.state.walks import WalkLanes

PAGE = Path(__file__).resolve().parents[1] / "docs" / "columns.md"

_HEAD = """\
# Columns

What a render keeps by pixel, by record and by path is kept in tables. A column is declared once, where its class lists
it (`engine/state/columns.py`). `python -m tools.columns_page` writes this page from the declarations.

To add a column, add a line to its class, and write and read it. Nothing else knows which columns there are.

- The film: `FilmTile`. Its line says how it is merged. A stage writes it; `engine/render/film.py` makes a pass of it.
- Records: `VertexRecords`. `collect_records` beside it writes it, and a model in `engine/guiding/` reads it.
- Lanes: a class in `engine/state/`. Its line says in which cache line it lies. Stages write and read it.

A column is float32, one number a row, and in the film added with the samples' weight, where its line says nothing else.
One with a condition is empty where that does not hold. `P` are pixels, `R` records, `L` lanes, `N` candidates and `C`
channels.
"""

_PARTS: dict[str, tuple[type[Bundle], ...]] = {
    "Film": (FilmTile,),
    "Records": (VertexRecords, CacheRecords, VertexLog),
    "Lanes": (
        lanes.PathState, lanes.ShadePoints, lanes.Closures, lanes.LightSamples, lanes.ShadowRays, PassedHits,
        lanes.GuidedLanes, lanes.CachedLanes, lanes.LightPassLanes, lanes.FeatureLanes, lanes.CatcherLanes, MediaLanes,
        TrackedLanes, WalkLanes, lanes.LightDraws, Candidates,
    ),
}  # fmt: skip


def _kind(dtype: str, declared: Column, rows: int | str) -> str:
    """Element type, shape and condition, where they are not the usual ones."""
    first, *inner = declared.shape
    shape = "×".join(str(size) for size in ([first] if first != rows else []) + inner)
    kinds = [dtype] if dtype != "float32" else []
    kinds += [f"×{shape}" if first == rows else shape] if shape else []
    kinds += [f"if `{declared.needs}`"] if declared.needs else []
    return f" ({', '.join(kinds)})" if kinds else ""


def _merged(declared: Column) -> str:
    """How a film's column is merged, where it is not added by the usual weights."""
    if declared.merge is None or (declared.merge is Merge.SUM and not declared.weight):
        return ""
    return f"; {declared.merge.value}" + (f", that of `{declared.weight}`" if declared.weight else "")


def _table(table: type[Bundle]) -> Iterator[str]:
    declared = columns_of(table)
    (rows, _count), *_rest = Counter(column.shape[0] for column in declared.values()).most_common()
    module = table.__module__.replace(".", "/") + ".py"
    yield f"### {table.__name__}\n"
    yield f"`{module}`. {(table.__doc__ or '').partition(chr(10))[0]}\n"
    for name, column in declared.items():
        kind = _kind(str(dtype_of(table, name)), column, rows)
        yield f"- `{name}`{kind}: {column.about}{_merged(column)}"
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
