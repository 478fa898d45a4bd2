# SPDX-License-Identifier: GPL-3.0-or-later
"""A stage has one record: the loop calls those that are listed, and their time goes to the clocks that are named."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator

import pytest

from engine.wavefront import trace_photons as photon_loop
from engine.wavefront import trace_rounds as loop
from engine.wavefront.columns import CLOCK
from engine.wavefront.stages import CLOCKS, STAGES

_TREES = [ast.parse(inspect.getsource(module)) for module in (loop, photon_loop)]
_FUNCTIONS = {node.name: node for tree in _TREES for node in tree.body if isinstance(node, ast.FunctionDef)}


def calls_in(node: ast.AST) -> Iterator[ast.Call]:
    """Calls in the order in which the source has them."""
    for child in ast.iter_child_nodes(node):
        yield from calls_in(child)
    if isinstance(node, ast.Call):
        yield node


def events_of(name: str) -> Iterator[tuple[str, str]]:
    """What a function of the loop does: ('stage', name) and ('mark', clock), its helpers' calls in their places."""
    for call in calls_in(_FUNCTIONS[name]):
        called = call.func
        if isinstance(called, ast.Attribute) and isinstance(called.value, ast.Name) and called.value.id == "stages":
            yield "stage", called.attr
        elif isinstance(called, ast.Name) and called.id == "mark":
            clock = call.args[1]
            assert isinstance(clock, ast.Attribute)
            yield "mark", clock.attr
        elif isinstance(called, ast.Name) and called.id in _FUNCTIONS:
            yield from events_of(called.id)


@pytest.fixture(scope="module")
def clocks() -> dict[str, set[str]]:
    """Clocks by stage: what is marked next after each of its calls."""
    found: dict[str, set[str]] = {}
    waiting: list[str] = []
    for kind, name in events_of("trace_rounds"):
        if kind == "stage":
            waiting.append(name)
            continue
        for stage in waiting:
            found.setdefault(stage, set()).add(name)
        waiting.clear()
    assert not waiting
    for kind, name in events_of("trace_photons"):
        if kind == "stage":
            # The time that a map takes is no unit's: its own stages have no clock.
            found.setdefault(name, set())
    return found


def test_the_loop_calls_all_stages_and_no_others(clocks: dict[str, set[str]]) -> None:
    assert set(clocks) == set(STAGES) and len(STAGES) > 50


@pytest.mark.parametrize("name", STAGES)
def test_the_time_of_a_stage_goes_to_its_clocks(name: str, clocks: dict[str, set[str]]) -> None:
    assert clocks[name] == CLOCKS[name]


def test_every_clock_is_some_stage_s() -> None:
    assert set().union(*CLOCKS.values()) == set(CLOCK._fields)
