# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of nodes as numbers for kernels: whatever is not known is reported, and the default used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from engine.scene.description import Node


def choice(
    node: Node, builder: Any, name: str, choices: Sequence[str] | Mapping[str, int], default: str
) -> int:
    """What kernels call the value of an enum.

    Parameters
    ----------
    choices : sequence of str, or mapping
        Known values: a value's number is its place, or what it maps to.
    """
    value = node.properties.get(name, default)
    if value not in choices:
        builder.notice(f"{name} {value!r} is not supported", f"{default!r} is used")
        value = default
    return choices[value] if isinstance(choices, Mapping) else choices.index(value)


def is_choice(node: Node, builder: Any, name: str, value: str, other: str, default: str) -> bool:
    """Whether an enum of two known values has the one and not the other."""
    return choice(node, builder, name, (other, value), default) == 1


def flag(node: Node, name: str, default: bool) -> int:
    """A switch, as 0 or 1."""
    return int(bool(node.properties.get(name, default)))
