# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m tools.nodes_page` writes docs/nodes.md: which shader nodes work, by the registry of the Blender that runs.

The engine is asked: each node is compiled with every output seen, every input linked, and every value of its menus. The
Blender of `BASE` writes the table of all nodes, newer ones what is another there.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).resolve().parents[1]
PAGE = _ROOT / "docs" / "nodes.md"

#: Version of Blender that the table of all nodes is of.
BASE = "5.0"

_HEAD = f"""\
# Shader nodes: what works, what does not

`python -m tools.nodes_page` writes this page: it asks Blender which nodes there are, and the engine what it says of
each output, linked input and value of a menu. A test fails where a Blender has what this page lacks.
[differences.md](differences.md) says where pictures differ although a node works.

- **yes**: all of it means what it means in Cycles.
- **partly**: a message names the part behind it, and says what is shown instead.
- **no**: a message names the node.
- **as in Cycles**: Cycles does not know the node either; a message names it, and the picture is the same.

*Beside Cycles* says where the node is compared: groups of scenes (`benchmarks/scenes`), single values (*values*) and
random trees (*fuzz*). Groups, reroutes, frames, muted nodes, Menu Switches, repeat zones, bundles, closures and outputs
are resolved when a scene is exported. So are switches, whole numbers, truth and strings, as mixes where they vary.

## Blender {BASE}
"""
_TABLE = "| Node | Works | Sockets, values of menus | Beside Cycles |\n| --- | --- | --- | --- |"
_NEWER = "\n## Blender {}: what is another\n"

#: Beside the point: what a node lacks in this question, not in the engine.
_LACKS = ("has no image", "has no table", "photometric data", "is a shader linked to a value")
_VALUES = ("tests/engine/shaders", "tests/engine/kernels")
_SHEET = "tests/addon/test_switches.py"


@dataclass(frozen=True)
class Row:
    """A node in the table.

    Attributes
    ----------
    inputs, outputs, values : int
        How many it has with any setting.
    problems : tuple of str
        Reported parts, and what is shown instead; () = all of it works.
    works : str
        'yes', 'partly', 'no' or 'as in Cycles'.
    """

    kind: str
    label: str
    inputs: int
    outputs: int
    values: int
    works: str
    problems: tuple[str, ...]

    def line(self, compared: str) -> str:
        """The row in Markdown."""
        parts = [f"{self.inputs} in", f"{self.outputs} out"] + ([f"{self.values} values"] if self.values else [])
        works = f"**{self.works}**" + (f": {'; '.join(self.problems)}" if self.problems else "")
        return f"| {self.label} (`{self.kind}`) | {works} | {', '.join(parts)} | {compared} |"


def rows() -> list[Row]:
    """All nodes of the Blender that runs."""
    import bpy

    from tools.node_registry import kinds

    material = bpy.data.materials.new("Nodes")
    if material.node_tree is None:
        material.use_nodes = True
    found = [_row(material.node_tree, kind) for kind in kinds(material.node_tree)]
    bpy.data.materials.remove(material)
    return found


def _row(tree: Any, kind: str) -> Row:
    from addon.export.inlined_nodes import INLINED
    from engine.scene.description import Link
    from engine.shaders import media
    from tools.node_registry import (
        AS_IN_CYCLES,
        PARTLY_RESOLVED,
        notices,
        properties_of,
        settings_of,
        variants,
    )

    inputs: set[str] = set()
    outputs: set[str] = set()
    whole: dict[str, bool] = {}
    problems: dict[str, None] = {}
    for node in variants(tree, kind):
        label = node.bl_label
        values = sum(len(prop.enum_items_static) for prop in settings_of(node).values() if prop.type == "ENUM")
        sockets = [socket for socket in node.inputs if socket.enabled and not socket.is_unavailable]
        inputs.update(socket.identifier for socket in sockets if socket.type != "CUSTOM")
        linked = {socket.identifier: Link(0, "Value") for socket in sockets if socket.type not in ("SHADER", "CUSTOM")}
        for socket in node.outputs:
            if not socket.enabled or socket.is_unavailable or socket.type == "CUSTOM":
                continue
            outputs.add(socket.identifier)
            for given in ({}, linked):
                said = notices(
                    kind, socket.identifier, socket.type == "SHADER", given, properties_of(node),
                    is_volume=kind in media.NODES,
                )  # fmt: skip
                told = [notice for notice in said if not any(lack in notice.problem for lack in _LACKS)]
                whole[socket.identifier] = whole.get(socket.identifier, True) and bool(told)
                problems.update({f"{notice.problem} → {notice.fallback}": None for notice in told})
    if not outputs and not _is_known(kind):
        whole[""], problems["what is linked to it is reported"] = True, None
    works = "yes" if not problems else "no" if whole and all(whole.values()) else "partly"
    if kind in INLINED:
        problems = {PARTLY_RESOLVED[kind]: None} if kind in PARTLY_RESOLVED else {}
        works = "partly" if problems else "yes"
    elif kind in AS_IN_CYCLES:
        works = "as in Cycles"
    return Row(kind, label, len(inputs), len(outputs), values, works, tuple(problems))


def _compared() -> dict[str, str]:
    """Where nodes are named in scenes and tests beside Cycles, by kind."""
    found: dict[str, dict[str, None]] = {}
    for path in sorted((_ROOT / "benchmarks" / "scenes").glob("*.py")):
        for name in re.findall(r'nodes(?:\.node)?\(\s*"(\w+)"', path.read_text("utf-8")):
            found.setdefault(f"ShaderNode{name}", {})[path.stem.replace("_", " ")] = None
    for folder in _VALUES:
        paths = sorted((_ROOT / folder).glob("*_cycles.py")) + sorted((_ROOT / folder).glob("test_cycles.py"))
        for path in [*paths, _ROOT / _SHEET]:
            for name in re.findall(r'"((?:Shader|Function|Geometry|)Node\w+)"', path.read_text("utf-8")):
                found.setdefault(name, {})["values"] = None
    return {kind: ", ".join(places) for kind, places in found.items()}


def _is_known(kind: str) -> bool:
    from engine.shaders import nodes_closure
    from engine.shaders.node_values import gives_values

    return gives_values(kind) or kind in nodes_closure.CLOSURES


def _in_random_trees(kind: str) -> bool:
    left_out = (_ROOT / "tests" / "helpers" / "fuzz" / "graphs.py").read_text("utf-8").partition("_SURFACES")[0]
    return _is_known(kind) and f'"{kind}"' not in left_out


def lines() -> list[str]:
    """The table's rows for the Blender that runs."""
    compared = _compared()
    result = []
    for row in rows():
        places = [compared[row.kind]] if row.kind in compared else []
        if row.works != "no" and _in_random_trees(row.kind):
            places.append("fuzz")
        result.append(row.line(", ".join(places)))
    return result


def page(version: str, known: str) -> str:
    """The whole page.

    Parameters
    ----------
    version : str
        That of the Blender that runs, as "5.0".
    known : str
        The page so far, for what other Blenders have written of it.
    """
    own = lines()
    parts = re.split(r"\n## Blender (\S+): what is another\n", known)
    newer = dict(zip(parts[1::2], parts[2::2], strict=True))
    if version == BASE:
        base = "\n".join([_TABLE, *own]) + "\n"
    else:
        base = parts[0].partition(f"## Blender {BASE}\n\n")[2]
        others = [line for line in own if line not in base.splitlines()]
        newer[version] = "\n" + "\n".join([_TABLE, *others]) + "\n"
    added = "".join(_NEWER.format(name) + text for name, text in sorted(newer.items()))
    return f"{_HEAD}\n{base}{added}"


def main() -> None:
    """Write the page."""
    import bpy

    version = f"{bpy.app.version[0]}.{bpy.app.version[1]}"
    known = PAGE.read_text("utf-8") if PAGE.exists() else ""
    PAGE.write_text(page(version, known), encoding="utf-8")
    print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
