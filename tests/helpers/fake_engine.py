# SPDX-License-Identifier: GPL-3.0-or-later
"""A session and an exporter that return known pixels at once: what the add-on's hooks do is seen exactly."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from engine.scene.description import Frame


class ExportCancelled(Exception):
    """As addon.export's."""


class LoadCancelled(Exception):
    """As engine.render.session's."""


class FakeEngine:
    """Installs itself in place of `engine.render.session` and `addon.export`; tests set its attributes."""

    def __init__(self, monkeypatch: Any) -> None:
        self.notices: list[Any] = []
        self.reject_count = 0
        self.export_error: Exception | None = None
        self.render_error: Exception | None = None
        self.during_render: Callable[[FakeEngine], None] = lambda _fake: None
        self.before: dict[str, Callable[[], None]] = {}
        self.sessions: list[FakeSession] = []
        self.caches: list[Any] = []
        self.asked_passes: list[set[str]] = []
        self.learned: Any = None
        #: In place of the pixels of `FakeSession`, by pass.
        self.pictures: dict[str, Any] = {}
        self.kernels = "kernels: none"
        self.started_from: list[Any] = []
        self.exported: list[tuple[str, int]] = []
        session = ModuleType("engine.render.session")
        session.Session = self._session  # type: ignore[attr-defined]
        session.LoadCancelled = LoadCancelled  # type: ignore[attr-defined]
        export = ModuleType("addon.export")
        export.ExportCache = SimpleNamespace  # type: ignore[attr-defined]
        export.ExportCancelled = ExportCancelled  # type: ignore[attr-defined]
        export.export_scene = self._export  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "engine.render.session", session)
        monkeypatch.setitem(sys.modules, "addon.export", export)

    def interrupt_at(self, where: str, interrupt: Callable[[], None]) -> None:
        """Have `interrupt` called when a scene is exported ('export') or loaded ('load')."""
        self.before[where] = interrupt

    def _session(self, settings: Any) -> FakeSession:
        self.sessions.append(FakeSession(self, settings))
        return self.sessions[-1]

    def _export(
        self, depsgraph: Any, *, engine: Any, view_layer: Any, cache: Any, should_cancel: Any, texture_memory: Any
    ) -> Any:
        self.before.get("export", lambda: None)()
        if self.export_error is not None:
            raise self.export_error
        if should_cancel():
            raise ExportCancelled
        self.caches.append(cache)
        self.exported.append((view_layer.name, depsgraph.scene.frame_current))
        render = depsgraph.scene.render
        width = render.resolution_x * render.resolution_percentage // 100
        height = render.resolution_y * render.resolution_percentage // 100
        region = (0, 0, width, height)
        if render.use_border:
            region = (
                int(render.border_min_x * width),
                int(render.border_min_y * height),
                int(render.border_max_x * width),
                int(render.border_max_y * height),
            )
        # What the Cryptomatte passes are told of is nothing.
        return SimpleNamespace(
            frame=Frame(width=width, height=height, region=region), instances=SimpleNamespace(name=(), asset=()),
            materials=(), meshes=(),
        )


class FakeSession:
    """Pixels are functions of where they are in the full image: red grows with x, green with y from the bottom."""

    def __init__(self, fake: FakeEngine, settings: Any) -> None:
        self.fake = fake
        self.settings = settings
        self.region = (0, 0, 0, 0)
        self.light_digest = "light"
        self.checkpointing: Any = None

    def load(self, description: Any, *, on_progress: Any, should_cancel: Any, keeps_meshes: bool) -> list[Any]:
        self.fake.before.get("load", lambda: None)()
        if should_cancel():
            raise LoadCancelled
        self.region = description.frame.region
        return self.fake.notices

    def images(self, passes: set[str]) -> dict[str, Any]:
        x0, y0, x1, y1 = self.region
        y, x = np.mgrid[y0:y1, x0:x1].astype(np.float32)
        images = {"Combined": np.stack([x, y, np.full_like(x, self.settings.samples), np.ones_like(x)], axis=-1)}
        for index, name in enumerate(sorted(passes - {"Combined"})):
            images[name] = np.stack([x + 1000 * index] * 4, axis=-1)
        return images | {name: image[y0:y1, x0:x1] for name, image in self.fake.pictures.items() if name in images}

    def render(
        self, *, on_progress: Any, on_image: Any, should_cancel: Any, passes: set[str], source: Any, start: Any,
        keep: bool, one_by_one: bool,
    ) -> Any:
        assert one_by_one, "Blender copies passes: all of them need not lie ready"
        self.fake.started_from.append(start)
        self.fake.asked_passes.append(passes)
        self.should_cancel = should_cancel
        progress = SimpleNamespace(
            fraction=0.5, sample=2, samples=4, elapsed=1.0, remaining=75.0, rays_per_second=1.25e6, message="Rendering",
            noisy_share=None,
        )
        on_progress(progress)
        on_image(self.images(passes))
        self.fake.during_render(self.fake)
        if self.fake.render_error is not None:
            raise self.fake.render_error
        report = SimpleNamespace(
            build_seconds=0.1,
            compile_seconds=0.0,
            kernels=self.fake.kernels,
            prepare_seconds=0.1,
            render_seconds=1.0,
            denoise_seconds=0.5,
            rays={"camera": 600, "shadow": 400},
            sample_count=self.settings.samples,
            denoised_sentence="",
            guiding=SimpleNamespace(lines=[]),
            reject_count=self.fake.reject_count,
            record_reject_count=0,
            record_drop_count=0,
            peak_memory=2**20,
            cancelled=(cancelled := should_cancel()),
            ended_by="CANCEL" if cancelled else "SAMPLES",
            notices=self.fake.notices,
        )
        learned = self.fake.learned if keep else None
        return SimpleNamespace(passes=self.images(passes), report=report, learned=learned)
