# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures that many tests share. Blender is one global state: whoever wants it clean asks for `blender`."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator
from typing import Any, TypeVar

import pytest

from tests.helpers import enough_time, in_order
from tests.helpers.allowed_skips import is_allowed
from tests.helpers.late_workers import wait_for_a_core

# Kernels are those of the sources that are tested, compiled here: a library that lies in the checkout is left alone.
os.environ.setdefault("NEURALGUIDE_KERNEL_LIBRARIES", "")

_Report = TypeVar("_Report", pytest.TestReport, pytest.CollectReport)


def pytest_configure() -> None:
    """Compile as sessions do, in tests that have none."""
    from engine.render.garbage_collection import collect_nothing_while_compiling

    collect_nothing_while_compiling()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Cases of which there are many alike come last."""
    enough_time.put_last(items)


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """By `--dist loadscope` tests begin in their order."""
    return in_order.make_scheduler(config, log)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """In CI some of them are left out if it is late."""
    enough_time.skip_if_late(item)


def pytest_collection_finish() -> None:
    """Nothing is compiled for a list of tests: every worker makes the list, and all would compile at the same time."""
    from engine.runtime.kernel_cache import origins

    if origins:
        raise pytest.UsageError("a kernel was called while tests were collected: call it in a test, or in a fixture")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol() -> None:
    """In CI some workers wait until other tests leave them a core."""
    wait_for_a_core()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """In CI a test that is skipped, but for another Blender or Python, has failed."""
    return _judged((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """The same of files that are skipped as a whole."""
    return _judged((yield))


def _judged(report: _Report) -> _Report:
    if not os.environ.get("CI") or not report.skipped or hasattr(report, "wasxfail"):
        return report
    reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    if not is_allowed(reason):
        report.outcome = "failed"
        report.longrepr = f"{reason}\n\nIn CI nothing is skipped but for another Blender or Python."
    return report


@pytest.fixture(autouse=True)
def _no_index_outside() -> Iterator[None]:
    """Where kernels look at their indices, none of a test's is outside."""
    from engine.runtime import bounds

    before = len(bounds.found)
    yield
    assert bounds.found[before:] == []


@pytest.fixture
def blender() -> Iterator[Any]:
    """The module `bpy` with NeuralGuide registered and an empty file: no objects, no camera, one scene."""
    import bpy

    import addon

    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon.register()
    yield bpy
    addon.unregister()


@pytest.fixture
def cube_scene(blender: Any) -> Any:
    """A cube, a camera that sees it and a sun: the scene, 32 x 16 pixels, rendered by NeuralGuide to float EXR."""
    bpy = blender
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0.0, -6.0, 2.0)
    camera.rotation_euler = (1.25, 0.0, 0.0)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.rotation_euler = (0.6, 0.3, 0.0)
    sun.data.energy = 3.0
    for item in (camera, sun):
        scene.collection.objects.link(item)
    scene.camera = camera
    render = scene.render
    render.engine = "NEURALGUIDE"
    render.resolution_x, render.resolution_y, render.resolution_percentage = 32, 16, 100
    if hasattr(render.image_settings, "media_type"):
        render.image_settings.media_type = "IMAGE"
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    scene.neuralguide.samples = 4
    # Each pixel has all samples, and shows them.
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    return scene
