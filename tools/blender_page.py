# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m tools.blender_page` writes docs/blender.md: which of Cycles' settings work, by the panel they are in.

`tools.cycles_settings` says what each setting means here. Labels are those of the Blender that runs; a test sees that
no setting is missing there, and that what is said to work is read by the add-on.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tools.cycles_settings import PANELS, TEXTS, Row

PAGE = Path(__file__).resolve().parents[1] / "docs" / "blender.md"

_HEAD = """\
# Cycles' interface: what works, what does not

NeuralGuide shows Cycles' own panels and reads Cycles' own settings, so that a scene made for Cycles renders as it is.
This page says what each of these settings means here. `python -m tools.blender_page` writes it.
[differences.md](differences.md) says where pictures differ although a setting works.

- **works**: it means what it means in Cycles.
- **said**: it is not supported, and a message after the render says so where it would make a difference.
- **no need**: there is nothing here that it could change.
- **no**: it is not supported. It would not change the picture, or differences.md says what is shown instead.
"""


def owners() -> dict[str, Any]:
    """Types of Cycles' settings in the running Blender, by what has them."""
    import bpy

    scene = bpy.context.scene
    found = {
        "scene.cycles": scene.cycles, "scene.cycles_curves": scene.cycles_curves,
        "view_layer.cycles": scene.view_layers[0].cycles,
    }  # fmt: skip
    for owner, collection, arguments in (
        ("object", "objects", (None,)), ("light", "lights", ("POINT",)), ("material", "materials", ()),
        ("world", "worlds", ()),
    ):  # fmt: skip
        item = getattr(bpy.data, collection).new("Cycles' settings", *arguments)
        found[f"{owner}.cycles"] = item.cycles
    return {name: group.bl_rna.properties for name, group in found.items()}


def settings_of(properties: Any) -> list[str]:
    """Names of a group's settings."""
    return [item.identifier for item in properties if item.identifier not in ("rna_type", "name")]


def _label(row: Row, properties: Any) -> str:
    """The setting's name, and before it its label where that says something else."""
    label = properties[row.name].name if row.name in properties else ""
    if label.lower().replace(" ", "_") in ("", row.name, f"use_{row.name}", row.name.removeprefix("use_")):
        return f"`{row.name}`"
    return f"{label} (`{row.name}`)"


def _panels() -> Iterator[str]:
    """For each panel its settings, those together of which the same is said."""
    known = owners()
    for title, owner, rows in PANELS:
        shown = [row for row in rows if row.name in known[owner] or row.is_newer]
        yield f"\n## {title}\n"
        yield f"`{owner}`:\n"
        for verdict, note in dict.fromkeys((row.verdict, row.note) for row in shown):
            alike = [_label(row, known[owner]) for row in shown if (row.verdict, row.note) == (verdict, note)]
            yield f"- **{verdict}**: {', '.join(alike)}" + (f": {note}" if note else "") + "."
        if title in TEXTS:
            yield f"\n{TEXTS[title]}"


def page() -> str:
    """The whole page."""
    return "\n".join([_HEAD.rstrip("\n"), *_panels()]) + "\n"


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")
    print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
