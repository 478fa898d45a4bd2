# SPDX-License-Identifier: GPL-3.0-or-later
"""What is too large for a machine says so before it starts, and names what is large."""

from __future__ import annotations

import numpy as np
import pytest

from engine.scene import limits
from engine.scene.description import Frame
from tests.helpers.small_scenes import floor_scene

GIB = 1 << 30


@pytest.fixture
def small_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine of 2 GiB, on which this process has one."""
    monkeypatch.setattr(limits, "physical_memory", lambda: 2 * GIB)
    monkeypatch.setattr(limits, "swap_memory", lambda: 0)
    monkeypatch.setattr(limits, "resident_memory", lambda: GIB)


@pytest.mark.usefixtures("small_machine")
def test_too_many_triangles_are_refused_by_their_number() -> None:
    description = floor_scene()
    limits.check_memory(description)
    description.meshes[0].triangles = np.broadcast_to(np.zeros(3, np.uint32), (50_000_000, 3))
    with pytest.raises(ValueError, match=r"the scene needs 8\.\d GiB .* this machine has 2\.0: it has 50,000,000 tri"):
        limits.check_memory(description)


@pytest.mark.usefixtures("small_machine")
def test_too_many_strands_are_refused_by_the_name_of_what_has_them() -> None:
    limits.check_memory_of_strands(90_000, 10_000, "Fur")
    with pytest.raises(ValueError, match=r"Fur has 10,000,000 strands of 90,000,000 keys, which need 17\.\d GiB"):
        limits.check_memory_of_strands(90_000_000, 10_000_000, "Fur")


@pytest.mark.usefixtures("small_machine")
def test_too_many_passes_are_refused() -> None:
    frame = Frame(7680, 4320, (0, 0, 7680, 4320))
    limits.check_film(Frame(1920, 1080, (0, 0, 1920, 1080)), 40, 20)
    with pytest.raises(ValueError, match=r"7680 x 4320 pixels with passes of 80 channels need .* leave passes out"):
        limits.check_film(frame, 40, 80)


def test_this_machine_knows_what_it_has() -> None:
    assert limits.usable_memory() > limits.resident_memory() >= 0


def test_textures_have_half_of_the_memory_unless_something_is_chosen() -> None:
    assert limits.texture_memory(0) == limits.usable_memory() // 2
    assert limits.texture_memory(3) == 3 << 20
