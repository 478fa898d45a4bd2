# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes that only say what is linked to what: menus, switches, repeat zones, bundles, closures.

Blender resolves them before Cycles sees a tree, and so does the export: a repeat zone becomes as many copies of its
nodes as it has iterations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import bpy

from engine.scene.description import Link

from . import switches
from .node_trees import Tree, open_turn
from .strings import STRINGS

#: Iterations of a repeat zone beyond these are left out, and named.
MOST_ITERATIONS = 1024


class Access(NamedTuple):
    """What these nodes need of the export.

    input : what an input socket carries in a tree
    convert : a value as a socket of another type has it
    notice : says what is wrong with a node, and what is shown
    output : what an output socket of a node carries in a tree
    add : a new node of a kind: its output, inputs and properties
    constant : the value of a link to a node that is a constant, else None
    """

    input: Callable[[Tree, bpy.types.NodeSocket], Any]
    convert: Callable[[Any, str, str], Any]
    notice: Callable[[bpy.types.Node, str, str], None]
    output: Callable[[Tree, bpy.types.Node, bpy.types.NodeSocket], Any]
    add: Callable[[str, str, dict[str, Any], dict[str, Any]], Link]
    constant: Callable[[Any], Any]


@dataclass(frozen=True, eq=False)
class _Bundle:
    """What a Combine Bundle node puts together."""

    tree: Tree
    node: bpy.types.Node


@dataclass(frozen=True, eq=False)
class _Joined:
    """Bundles one after the other: of several items of a name, the last counts."""

    parts: tuple[_Bundle | _Joined, ...]


@dataclass(frozen=True, eq=False)
class _Closure:
    """What a closure zone ends with."""

    tree: Tree
    node: bpy.types.Node


def _converted(access: Access, tree: Tree, inner: bpy.types.NodeSocket, outer: bpy.types.NodeSocket) -> Any:
    return access.convert(access.input(tree, inner), inner.type, outer.type)


def _named(sockets: Any, name: str) -> bpy.types.NodeSocket | None:
    return next((socket for socket in sockets if socket.name == name and socket.type != "CUSTOM"), None)


def _begin_of(tree: Tree, end: bpy.types.Node) -> bpy.types.Node | None:
    """The node that a zone begins with which ends with `end`."""
    return next((node for node in tree.tree.nodes if getattr(node, "paired_output", None) == end), None)


def _menu_switch(access: Access, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """What the input carries that a menu has chosen, or whether it is the one of `socket`."""
    chosen = access.input(tree, node.inputs[0])
    names = [item.name for item in node.enum_items]
    if chosen not in names:
        access.notice(node, "has a menu that is not constant", "as if it were not linked")
        return None
    row = 1 + names.index(chosen)
    if socket.identifier != "Output":
        return node.outputs[row].identifier == socket.identifier
    return _converted(access, tree, node.inputs[row], socket)


def _repeat(access: Access, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """What an item is after all iterations."""
    begin = _begin_of(tree, node)
    count = None if begin is None else access.input(tree, begin.inputs[0])
    if begin is None or isinstance(count, bool) or not isinstance(count, (int, float)):
        access.notice(node, "has a number of iterations that is not constant", "as if it were not linked")
        return None
    if count > MOST_ITERATIONS:
        access.notice(node, f"has {int(count)} iterations", f"the first {MOST_ITERATIONS}")
    turns = tree.turns.setdefault(node.as_pointer(), [])

    def after(iterations: int, outer: bpy.types.NodeSocket) -> Any:
        if iterations == 0:
            first = next(item for item in begin.inputs if item.identifier == outer.identifier)
            return _converted(access, tree, first, outer)
        last = next(item for item in node.inputs if item.identifier == outer.identifier)
        return _converted(access, turns[iterations - 1], last, outer)

    for number in range(len(turns), max(min(int(count), MOST_ITERATIONS), 0)):

        def value(outer: bpy.types.NodeSocket, number: int = number) -> Any:
            return number if outer.identifier == "Iteration" else after(number, outer)

        turns.append(open_turn(tree, begin, value))
    return after(len(turns), socket)


def _bundle(access: Access, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    return _Bundle(tree, node)


def _join(access: Access, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    links = [link for link in tree.tree.links if link.to_socket == node.inputs[0] and not link.is_muted]
    given = [access.output(tree, link.from_node, link.from_socket) for link in links]
    return _Joined(tuple(bundle for bundle in given if isinstance(bundle, (_Bundle, _Joined))))


def _bundles(bundle: _Bundle | _Joined) -> list[_Bundle]:
    """All that were joined, the one that counts first."""
    if isinstance(bundle, _Bundle):
        return [bundle]
    return [inner for part in reversed(bundle.parts) for inner in _bundles(part)]


def _separate(access: Access, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """The item of a bundle that has the socket's name."""
    given = access.input(tree, node.inputs[0])
    if not isinstance(given, (_Bundle, _Joined)):
        return None
    for bundle in _bundles(given):
        item = _named(bundle.node.inputs, socket.name)
        if item is not None:
            return _converted(access, bundle.tree, item, socket)
    access.notice(node, f"separates {socket.name!r}, which is not there", "as if it were not linked")
    return None


def _closure(access: Access, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    return _Closure(tree, node)


def _evaluate(access: Access, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """What comes out of a closure for the inputs of this node; those that it lacks are as if nothing were linked."""
    closure = access.input(tree, node.inputs[0])
    if not isinstance(closure, _Closure):
        return None
    item = _named(closure.node.inputs, socket.name)
    if item is None:
        access.notice(node, f"evaluates {socket.name!r}, which is not there", "as if it were not linked")
        return None
    turns = tree.turns.setdefault(node.as_pointer(), [])
    if not turns:

        def value(inner: bpy.types.NodeSocket) -> Any:
            given = _named(node.inputs, inner.name)
            return None if given is None else _converted(access, tree, given, inner)

        begin = _begin_of(closure.tree, closure.node)
        turns.append(closure.tree if begin is None else open_turn(closure.tree, begin, value))
    return _converted(access, turns[0], item, socket)


#: By the type of a node: what one of its outputs carries.
INLINED: dict[str, Callable[[Access, Tree, bpy.types.Node, bpy.types.NodeSocket], Any]] = {
    "GeometryNodeMenuSwitch": _menu_switch,
    "GeometryNodeRepeatOutput": _repeat,
    "GeometryNodeSwitch": switches.switch,
    "GeometryNodeIndexSwitch": switches.index_switch,
    "GeometryNodeWarning": switches.warning,
    "FunctionNodeBooleanMath": switches.boolean_math,
    "FunctionNodeIntegerMath": switches.integer_math,
    "FunctionNodeGetVectorComponent": switches.vector_component,
    "NodeEnableOutput": switches.enable_output,
    "NodeImplicitConversion": switches.implicit_conversion,
    "NodeJoinBundle": _join,
    "NodeCombineBundle": _bundle,
    "NodeSeparateBundle": _separate,
    "NodeClosureOutput": _closure,
    "NodeEvaluateClosure": _evaluate,
} | STRINGS
