# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes of strings and menus in materials (Blender 5.3), see `inlined_nodes`. Strings are constants.

What they make of a number that varies is nothing, as in Cycles.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import bpy

from engine.scene.description import Link

from .node_trees import Tree
from .string_formats import Item, by_base, format_string, read_by_base, trimmed

_NUMBER = re.compile(r"-?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_MATCHES: dict[str, Callable[[str, str], bool]] = {
    "Starts With": str.startswith,
    "Ends With": str.endswith,
    "Contains": str.__contains__,
}


def menu(access: Any, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """Menu: the name of an item."""
    return node.value


def text(access: Any, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """String."""
    return node.string


def special_characters(access: Any, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """Special Characters."""
    return "\n" if socket.identifier == "Line Break" else "\t"


def _length(given: dict[str, Any], node: bpy.types.Node, output: str) -> Any:
    return len(given["String"])


def _to_value(given: dict[str, Any], node: bpy.types.Node, output: str) -> Any:
    """A number that a string begins with, and of how many characters it is."""
    if node.data_type == "INT":
        value, length = read_by_base(given["String"], int(given.get("Base", 10)))
        return length if output == "Length" else value
    found = _NUMBER.match(given["String"])
    if found is None:
        return 0
    return len(found[0]) if output == "Length" else float(found[0])


def _to_string(given: dict[str, Any], node: bpy.types.Node, output: str) -> Any:
    if node.data_type == "FLOAT":
        return f"{given['Value']:.{max(int(given['Decimals']), 0)}f}"
    return by_base(int(given["Value"]), int(given.get("Base", 10)), int(given.get("Padding", 0)))


def _format(given: dict[str, Any], node: bpy.types.Node, output: str) -> Any:
    sockets = [socket for socket in node.inputs if socket.identifier in given and socket.identifier != "Format"]
    return format_string(given["Format"], [Item(one.name, one.type, given[one.identifier]) for one in sockets])


def _trim(given: dict[str, Any], node: bpy.types.Node, output: str) -> Any:
    characters = given["Characters"] + (" \t\n\r" if given["Whitespace"] else "")
    return trimmed(given["String"], characters, at_start=bool(given["Start"]), at_end=bool(given["End"]))


def _find(given: dict[str, Any], node: bpy.types.Node, output: str) -> Any:
    if given.get("Mode", "From Start") != "From Start" or not given["Search"]:
        return None
    if output == "Count":
        return given["String"].count(given["Search"])
    return max(given["String"].find(given["Search"]), 0)


def _match(given: dict[str, Any], node: bpy.types.Node, output: str) -> Any:
    function = _MATCHES.get(given["Operation"])
    return None if function is None else function(given["String"], given["Key"])


def _slice(given: dict[str, Any], node: bpy.types.Node, output: str) -> Any:
    """Part of a string; what lies before its beginning counts."""
    begin = int(given["Position"])
    return given["String"][max(begin, 0) : max(begin + max(int(given["Length"]), 0), 0)]


def _replace(given: dict[str, Any], node: bpy.types.Node, output: str) -> Any:
    return given["String"].replace(given["Find"], given["Replace"]) if given["Find"] else given["String"]


def _reverse(given: dict[str, Any], node: bpy.types.Node, output: str) -> Any:
    return given["String"][::-1]


def _case(given: dict[str, Any], node: bpy.types.Node, output: str) -> Any:
    cases = {"Uppercase": str.upper, "Lowercase": str.lower}
    return cases[given["Case"]](given["String"]) if given["Case"] in cases else None


def _function(
    compute: Callable[[dict[str, Any], bpy.types.Node, str], Any],
) -> Callable[[Any, Tree, bpy.types.Node, bpy.types.NodeSocket], Any]:
    """What an output carries, of constants."""

    def carried(access: Any, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
        sockets = [item for item in node.inputs if not item.is_unavailable and item.type != "CUSTOM"]
        given = {item.identifier: access.input(tree, item) for item in sockets}
        if any(isinstance(value, Link) or value is None for value in given.values()):
            return "" if socket.type == "STRING" else 0
        result = compute(given, node, socket.identifier)
        if result is None:
            access.notice(node, "has a setting of strings that is not supported", "as if it were not linked")
        return result

    return carried


STRINGS = {
    "FunctionNodeInputMenu": menu,
    "FunctionNodeInputString": text,
    "FunctionNodeInputSpecialCharacters": special_characters,
    "FunctionNodeStringLength": _function(_length),
    "FunctionNodeStringToValue": _function(_to_value),
    "FunctionNodeValueToString": _function(_to_string),
    "FunctionNodeFormatString": _function(_format),
    "FunctionNodeTrimString": _function(_trim),
    "FunctionNodeFindInString": _function(_find),
    "FunctionNodeMatchString": _function(_match),
    "FunctionNodeSliceString": _function(_slice),
    "FunctionNodeReplaceString": _function(_replace),
    "FunctionNodeReverseString": _function(_reverse),
    "FunctionNodeSetStringCase": _function(_case),
}
