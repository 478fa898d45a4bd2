# SPDX-License-Identifier: GPL-3.0-or-later
"""No garbage is collected while kernels compile, and it is again afterwards."""

from __future__ import annotations

import gc
from typing import Any

import numba
import pytest
from numba.core import event

from engine.render.garbage_collection import collect_nothing_while_compiling


class _Watch(event.Listener):
    def __init__(self) -> None:
        self.was_on: list[bool] = []

    def on_start(self, event: Any) -> None:
        self.was_on.append(gc.isenabled())

    def on_end(self, event: Any) -> None:
        pass


def compiles(body: Any) -> list[bool]:
    """Whether collection was on while numba compiled a function, and one that it calls."""
    collect_nothing_while_compiling()
    watch = _Watch()
    inner = numba.njit(body)

    def outer(x: int) -> Any:
        return inner(x)

    with event.install_listener("numba:compile", watch):
        numba.njit(outer)(1)
    return watch.was_on


def test_nothing_is_collected_while_kernels_compile() -> None:
    assert gc.isenabled()
    assert compiles(lambda x: x + 1) == [False, False]
    assert gc.isenabled()


def test_collection_goes_on_after_a_kernel_that_does_not_compile() -> None:
    with pytest.raises(numba.core.errors.TypingError):
        compiles(lambda x: x + "")
    assert gc.isenabled()


def test_who_had_it_off_has_it_off_afterwards() -> None:
    gc.disable()
    try:
        compiles(lambda x: x + 2)
        assert not gc.isenabled()
    finally:
        gc.enable()
