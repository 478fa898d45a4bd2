# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages called through pointers: what a loop passes is what they take, and the loop in Python does the same."""

from __future__ import annotations

from types import FunctionType

import numba
import numpy as np
import pytest

from engine.jit import BoundKernel, in_python, kernel
from engine.precompile_worker import small_scene
from engine.session import Session
from engine.settings import GUIDING_METHODS, RenderSettings
from engine.stage_table import StageTable, StageType
from engine.wavefront import integrator
from engine.wavefront.trace_rounds import trace_rounds


@kernel
def _add(values, amount):
    for k in range(values.shape[0]):
        values[k] += amount


@kernel
def _ends(values):
    return int(values[0]), int(values[values.shape[0] - 1])


@kernel
def _count(values):
    return values.shape[0]


@kernel
def _first(values):
    return values[0]


@kernel
def _twice(stages, values):
    stages.add(values, np.float32(2.0))
    first, last = stages.ends(values)
    return first + 10 * last + 100 * stages.count(values)


@kernel
def _loop(stages, values, turns):
    total = 0
    for _ in range(turns):
        total += _twice(stages, values)
    return total


def _table(values: np.ndarray) -> StageTable:
    table = StageTable({"add": (_add, 0), "ends": (_ends, 2), "count": (_count, 1)})
    table.add(values, np.float32(0.0))
    table.ends(values)
    table.count(values)
    return table


def test_a_compiled_loop_calls_stages_as_python_does() -> None:
    values = np.arange(3, dtype=np.float32)
    table = _table(values)
    assert table.link()
    assert BoundKernel(_loop)(table, values, 2) == in_python(_loop)(table, np.arange(3, dtype=np.float32), 2)
    np.testing.assert_array_equal(values, [4.0, 5.0, 6.0])


def test_a_plain_function_cannot_be_linked() -> None:
    assert not StageTable({"add": (lambda values, amount: None, 0)}).link()


def test_a_stage_that_returns_something_else_is_an_error() -> None:
    values = np.ones(1, np.float32)
    for stage, count in ((_first, 1), (_ends, 1), (_count, 0)):
        table = StageTable({"stage": (stage, count)})
        table.stage(values)
        with pytest.raises(TypeError, match="stage stage returns"):
            table.link()


def test_python_sees_the_stages_and_no_others() -> None:
    table = _table(np.ones(1, np.float32))
    assert table.count(np.ones(4, np.float32)) == 4
    with pytest.raises(AttributeError):
        table.nothing  # noqa: B018


@pytest.mark.parametrize(("method", "spectral"), [("VMM_RIS", "OFF"), ("TABLE_RIS", "OFF"), ("TABLE_RIS", "ON")])
def test_the_main_loop_passes_what_its_stages_take(
    method: str, spectral: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing else would notice: calls through pointers are not checked."""
    kept: list[integrator.Integrator] = []
    arguments: list[tuple] = []
    original = integrator.Integrator._arguments

    def keep(self: integrator.Integrator, *rest: object) -> tuple:
        kept.append(self)
        arguments.append(original(self, *rest))  # type: ignore[arg-type]
        return arguments[-1]

    monkeypatch.setattr(integrator.Integrator, "_arguments", keep)
    session = Session(RenderSettings(samples=8, threads=1, guiding_method=method, spectral=spectral))
    session.load(small_scene())
    session.render(passes=("Combined", "Normal"))
    assert kept[-1]._compiled_loop is not None and isinstance(arguments[-1][0], StageTable)

    function = trace_rounds.py_func
    copy = FunctionType(function.__code__, function.__globals__, "not_in_the_cache")
    numba.njit(nogil=True, _nrt=False)(copy).compile(tuple(numba.typeof(argument) for argument in arguments[-1]))
    stages = kept[-1].stages.as_dict()
    bound = {name: stage for name, stage in stages.items() if stage.is_bound}  # type: ignore[attr-defined]
    assert set(StageType.called_with) >= set(stages)
    # The world is not constant in this scene, no lamp of it can be hit, and three stages are for wavelengths.
    assert len(bound) >= len(stages) - (2 if spectral == "ON" else 5)
    for name, stage in bound.items():
        assert StageType.called_with[name] == stage.signature.args, name  # type: ignore[attr-defined]


@pytest.mark.parametrize("method", ["OFF", "VMM_RIS"])
def test_the_loop_in_python_makes_the_same_image(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert method in GUIDING_METHODS

    def render() -> np.ndarray:
        session = Session(RenderSettings(samples=20, threads=1, guiding_method=method, seed=5))
        session.load(small_scene())
        return session.render().passes["Combined"]

    compiled = render()
    monkeypatch.setattr(StageTable, "link", lambda self: False)
    np.testing.assert_array_equal(render(), compiled)
