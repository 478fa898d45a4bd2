# SPDX-License-Identifier: GPL-3.0-or-later
"""Keys of hair out of Blender's memory are those of its Python, and where anything is odd nothing is read."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from addon.export.path_cache import LEAST_STRANDS, read_paths
from tests.helpers.blender_scenes import empty_scene

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere keys are read one by one")
KEYS = 3


@pytest.fixture
def fur(blender: Any) -> tuple[Any, Any]:
    """An evaluated ball that is not where it was made, and its hair, children of unequal length."""
    import bpy

    empty_scene()
    bpy.ops.mesh.primitive_uv_sphere_add(segments=8, ring_count=6, location=(1.0, 2.0, 3.0), scale=(1.0, 2.0, 1.0))
    ball = bpy.context.object
    settings = ball.modifiers.new("Fur", "PARTICLE_SYSTEM").particle_system.settings
    settings.type, settings.count, settings.hair_length, settings.display_step = "HAIR", 50, 0.5, 1
    settings.child_type, settings.child_percent, settings.length_random = "INTERPOLATED", LEAST_STRANDS // 50 + 1, 0.9
    evaluated = ball.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return evaluated, evaluated.particle_systems[0]


def _children(system: Any) -> range:
    return range(len(system.particles), len(system.particles) + len(system.child_particles))


def test_keys_are_those_of_blenders_python(fur: tuple[Any, Any]) -> None:
    owner, system = fur
    numbers = _children(system)
    keys = read_paths(owner, system, numbers, KEYS)
    assert keys is not None and keys.shape == (len(numbers), KEYS, 3)
    told = np.array([[system.co_hair(owner, particle_no=n, step=k)[:] for k in range(KEYS)] for n in numbers])
    has_key = (told != 0.0).any(axis=2)
    assert not has_key.all(), "no strand is short"
    assert np.allclose(keys[has_key], told[has_key], atol=1e-5)
    last = has_key.sum(axis=1) - 1
    assert np.allclose(keys[:, -1], told[np.arange(len(told)), last], atol=1e-5)
    part = read_paths(owner, system, numbers[1:], KEYS)
    assert part is not None and np.array_equal(part, keys[1:])


def test_what_is_not_there_is_not_read(fur: tuple[Any, Any]) -> None:
    owner, system = fur
    numbers = _children(system)
    assert read_paths(owner, system, numbers[: LEAST_STRANDS - 1], KEYS) is None
    assert read_paths(owner, system, range(numbers.start, numbers.stop + 1), KEYS) is None
    assert read_paths(owner, system, range(LEAST_STRANDS), KEYS) is None
    for key_count in (2, 4):
        assert read_paths(owner, system, numbers, key_count) is None


@pytest.mark.parametrize("address", [0, 1 << 40, 1 << 63])
def test_memory_that_is_none_harms_nobody(fur: tuple[Any, Any], address: int) -> None:
    owner, system = fur
    lost = _like(system, as_pointer=lambda: address)
    assert read_paths(owner, lost, _children(system), KEYS) is None


@pytest.mark.parametrize(
    "other", [{"seed": 5}, {"name": "Wool"}, {"settings": SimpleNamespace(as_pointer=lambda: 64)}],
    ids=["seed", "name", "settings"],
)
def test_systems_that_look_otherwise_are_left_alone(fur: tuple[Any, Any], other: dict[str, Any]) -> None:
    owner, system = fur
    assert read_paths(owner, _like(system), _children(system), KEYS) is not None
    assert read_paths(owner, _like(system, **other), _children(system), KEYS) is None


def test_keys_that_python_tells_otherwise_are_not_believed(fur: tuple[Any, Any]) -> None:
    owner, system = fur
    other = _like(system, co_hair=lambda object, particle_no, step: np.array((0.1, 0.2, 0.3)))
    assert read_paths(owner, other, _children(system), KEYS) is None


def _like(system: Any, **other: Any) -> Any:
    """What says of itself what the system does, but for some things."""
    names = ("as_pointer", "settings", "particles", "child_particles", "name", "seed", "co_hair")
    return SimpleNamespace(**{name: getattr(system, name) for name in names} | other)
