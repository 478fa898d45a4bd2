# SPDX-License-Identifier: GPL-3.0-or-later
"""Appearances of node trees: each group and each turn of a zone is one more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import bpy


@dataclass
class Tree:
    """One appearance of a node tree: the outermost one, a group inside `parent`, or a turn of a zone."""

    tree: bpy.types.NodeTree
    parent: Tree | None
    #: The group node in `parent` this tree stands for.
    group: bpy.types.Node | None
    #: Link into each input socket, by the socket's address.
    links: dict[int, bpy.types.NodeLink] = field(default_factory=dict)
    #: Input sockets with a link that Blender shows in red and nobody follows: it closes a loop, or the types differ.
    broken: set[int] = field(default_factory=set)
    #: Trees of group nodes, and finished nodes, by the node's address.
    groups: dict[int, Tree] = field(default_factory=dict)
    finished: dict[int, int] = field(default_factory=dict)
    unfinished: set[int] = field(default_factory=set)
    #: What outputs carry of nodes that are resolved, by the socket's address.
    carried: dict[int, Any] = field(default_factory=dict)
    #: What this is one turn of, None: of no zone.
    turn: Turn | None = None
    #: Turns of zones, by the address of the node that asks for them.
    turns: dict[int, list[Tree]] = field(default_factory=dict)


@dataclass
class Turn:
    """One turn of a zone: other values come out of the node that it begins with, and so out of all behind that.

    Attributes
    ----------
    outer : Tree
        Where the zone is.
    members : set of int
        Addresses of nodes that depend on where the zone begins. Others are those of `outer`.
    begin : int
        Address of the node that the zone begins with.
    value : callable
        What a socket of that node carries.
    """

    outer: Tree
    members: set[int]
    begin: int
    value: Callable[[bpy.types.NodeSocket], Any]


def open_tree(tree: bpy.types.NodeTree, parent: Tree | None, group: bpy.types.Node | None) -> Tree:
    """An appearance of a tree, with its links looked up."""
    opened = Tree(tree, parent, group)
    for link in tree.links:
        if link.is_muted or link.from_socket is None or link.to_socket is None or link.from_socket.is_unavailable:
            continue
        if link.is_valid:
            opened.links[link.to_socket.as_pointer()] = link
        else:
            opened.broken.add(link.to_socket.as_pointer())
    return opened


def open_turn(outer: Tree, begin: bpy.types.Node, value: Callable[[bpy.types.NodeSocket], Any]) -> Tree:
    """One turn of the zone of `outer` that begins with a node."""
    turn = Turn(outer, _behind(outer, begin), begin.as_pointer(), value)
    return Tree(outer.tree, outer.parent, outer.group, outer.links, outer.broken, turn=turn)


def _behind(tree: Tree, begin: bpy.types.Node) -> set[int]:
    """Addresses of a node and of all that depend on it."""
    following: dict[int, list[bpy.types.Node]] = {}
    for link in tree.links.values():
        following.setdefault(link.from_node.as_pointer(), []).append(link.to_node)
    found, waiting = {begin.as_pointer()}, [begin]
    while waiting:
        for node in following.get(waiting.pop().as_pointer(), ()):
            if node.as_pointer() not in found:
                found.add(node.as_pointer())
                waiting.append(node)
    return found
