# SPDX-License-Identifier: GPL-3.0-or-later
"""What a new Blender changed: nodes with their sockets and settings, properties, values of menus, methods.

Each Blender's own interpreter lists what it has, and any interpreter compares two lists:

    old/bin/python -m tools.blender_changes list old.json
    new/bin/python -m tools.blender_changes list new.json
    new/bin/python -m tools.blender_changes compare old.json new.json
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

#: What has no part in a picture: classes of the user interface, and what tells its look.
_INTERFACE = (
    "AddonPreferences", "AssetShelf", "FileHandler", "Gizmo", "GizmoGroup", "Header", "KeyingSetInfo", "Macro", "Menu",
    "Operator", "OperatorProperties", "Panel", "Space", "Theme", "UILayout", "UIList", "WorkSpaceTool",
)  # fmt: skip

#: A list of Blender's: what there is, by its name, and its value in words. Names begin with what it is of.
Listing = dict[str, str]


def list_blender() -> Listing:
    """Everything that this interpreter's `bpy` has, with factory settings."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    found = {"Blender": bpy.app.version_string}
    classes = [getattr(bpy.types, name) for name in dir(bpy.types)]
    # Settings of Cycles: Blender does not list what Python has registered.
    classes += bpy.types.PropertyGroup.__subclasses__()
    for structure in (getattr(item, "bl_rna", None) for item in classes):
        if structure is not None and not _is_of_interface(structure):
            found.update(_properties(structure.identifier, structure))
    found.update(_nodes())
    return found


def _is_of_interface(structure: Any) -> bool:
    while structure is not None:
        if structure.identifier in _INTERFACE or structure.identifier.startswith("Theme"):
            return True
        structure = structure.base
    return False


def _properties(name: str, structure: Any) -> Iterator[tuple[str, str]]:
    """A structure's own properties and methods: those of its base are listed there."""
    inherited = set(structure.base.properties.keys()) if structure.base is not None else set()
    for item in structure.properties:
        if item.identifier not in inherited and item.identifier != "rna_type":
            yield from _property(f"{name}.{item.identifier}", item)
    inherited = set(structure.base.functions.keys()) if structure.base is not None else set()
    for function in structure.functions:
        if function.identifier not in inherited:
            yield f"{name}.{function.identifier}()", ", ".join(item.identifier for item in function.parameters)


def _property(name: str, item: Any) -> Iterator[tuple[str, str]]:
    yield name, item.type
    if item.type == "ENUM":
        # Lists of icons, which many classes have, would hide the rest.
        for value in item.enum_items_static if not name.endswith("icon") else ():
            yield f"{name} = {value.identifier}", value.name


def _nodes() -> Iterator[tuple[str, str]]:
    """The sockets of shader nodes, and the values of new ones."""
    import bpy

    tree = bpy.data.node_groups.new("Every node", "ShaderNodeTree")
    for kind in sorted(name for name in dir(bpy.types) if "Node" in name):
        try:
            node = tree.nodes.new(kind)
        except RuntimeError:  # It belongs to other trees.
            continue
        for sockets, what in ((node.inputs, "input"), (node.outputs, "output")):
            for socket in sockets:
                value = _plain(getattr(socket, "default_value", None)) if what == "input" else ""
                yield f"{kind} {what} {socket.identifier!r}", f"{socket.type} {value}".strip()
        tree.nodes.remove(node)
    bpy.data.node_groups.remove(tree)


def _plain(value: Any) -> str:
    """A value of a socket in words; reals as far as float32 holds them."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (str, bool, int)):
        return str(value)
    return "(" + ", ".join(_plain(part) for part in value) + ")" if hasattr(value, "__len__") else ""


def compare(old: Listing, new: Listing) -> list[str]:
    """What is new, gone or another in `new`, a line each, in the order of names."""
    lines = []
    for name in sorted(old.keys() | new.keys()):
        if name not in old:
            lines.append(f"+ {name}: {new[name]}")
        elif name not in new:
            lines.append(f"- {name}: {old[name]}")
        elif old[name] != new[name]:
            lines.append(f"~ {name}: {old[name]} -> {new[name]}")
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.blender_changes", description=(__doc__ or "").partition("\n")[0]
    )
    commands = parser.add_subparsers(dest="command", required=True)
    listing = commands.add_parser("list", help="write what this interpreter's bpy has")
    listing.add_argument("file", type=Path)
    comparing = commands.add_parser("compare", help="print what changed from one list to another")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    chosen = parser.parse_args(arguments)
    if chosen.command == "list":
        chosen.file.write_text(json.dumps(list_blender(), indent=0, sort_keys=True) + "\n", encoding="utf-8")
        return 0
    old, new = (json.loads(path.read_text(encoding="utf-8")) for path in (chosen.old, chosen.new))
    print(*compare(old, new), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
