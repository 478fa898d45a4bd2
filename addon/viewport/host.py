# SPDX-License-Identifier: GPL-3.0-or-later
"""What outlives a window's engine: the process, and what it knows of the scene. Holds no bpy.

Blender makes an engine whenever a window changes to rendered shading and frees it when the window changes back. One
host is kept for the next one, for a while: that window then need not wait for a process to start, and sends only what
has changed.
"""

from __future__ import annotations

import time
from dataclasses import fields, replace
from typing import Any

from engine.render.light_mix import changes
from engine.scene.content import same_content
from engine.scene.description import Instances, SceneDescription
from engine.settings import RenderSettings
from engine.viewport.handle import ViewProcess
from engine.viewport.view import Factor, Update, View

#: How long a process without a window is kept [s].
SPARE_SECONDS = 300.0
#: Time between two starts of a process by one window [s]: one that ends again and again must not keep Blender busy.
_RESTART_SECONDS = 2.0

_hosts: list[Host] = []
_spare: list[tuple[Host, float]] = []


class Host:
    """A process, and what has been sent to it.

    Attributes
    ----------
    process : ViewProcess
    cache : ExportCache, of the export
    scene : SceneDescription or None, newest that was exported
    """

    def __init__(self, cache: Any) -> None:
        self.process = ViewProcess()
        self.cache = cache
        self.scene: SceneDescription | None = None
        self._sent = Update()
        self._started = -1e9
        self._mixes = False

    def _start(self) -> bool:
        """Start a process, which knows nothing of what the last one knew; False where one has just been tried."""
        now = time.monotonic()
        if now - self._started < _RESTART_SECONDS:
            return False
        self._started = now
        self._sent = Update()
        self.process.start()
        return self.process.is_alive

    def take(self, scene: SceneDescription) -> bool:
        """Keep a new description, with the old one's parts wherever they say the same; whether any does not."""
        settled, is_changed = settle(self.scene, scene)
        self.scene = settled
        return is_changed

    def show(
        self, view: View, settings: RenderSettings, *, denoises_from: int = 1, is_paused: bool,
        mix: dict[str, Factor] | None = None,
    ) -> bool:
        """Send what differs from what the process has; whether anything does.

        Factors of light groups, `mix`, are sent once one of them is not 1, and from then on: keeping groups takes time.
        Where a process has ended by itself another one is started with the next change, and not before: users are to
        read why, and what ended it may do so again.
        """
        if self.scene is None:
            return False
        self._mixes = self._mixes or bool(changes(mix or {}))
        wanted = Update(view, self.scene, settings, denoises_from, is_paused, mix if self._mixes else None)
        update = _difference(self._sent, wanted)
        if not self.process.is_alive:
            if update.is_empty or not self._start():
                return False
            update = wanted
        if update.is_empty:
            return False
        self._sent = wanted
        self.process.send(update)
        return True

    def rest(self) -> None:
        """Stop rendering, and keep what is known."""
        if self._sent.scene is not None:
            self._sent = replace(self._sent, is_paused=True)
            self.process.send(Update(is_paused=True))


def _difference(sent: Update, wanted: Update) -> Update:
    """What the process lacks."""
    return Update(
        view=wanted.view if wanted.view is not None and wanted.view.differs(sent.view) else None,
        scene=wanted.scene if wanted.scene is not sent.scene else None,
        settings=wanted.settings if wanted.settings != sent.settings else None,
        denoises_from=wanted.denoises_from if wanted.denoises_from != sent.denoises_from else None,
        is_paused=wanted.is_paused if wanted.is_paused != sent.is_paused else None,
        mix=wanted.mix if wanted.mix != sent.mix else None,
    )


def settle(old: SceneDescription | None, new: SceneDescription) -> tuple[SceneDescription, bool]:
    """The new description with the old one's objects where they are alike, and whether something is not.

    Arrays that stay the same objects are neither sent nor compared again.
    """
    if old is None:
        return new, True
    kept: dict[str, Any] = {}
    for item in fields(SceneDescription):
        before, now = getattr(old, item.name), getattr(new, item.name)
        if same_content(before, now):
            kept[item.name] = before
    if len(kept) == len(fields(SceneDescription)):
        return old, False
    if "instances" not in kept:
        before, now = old.instances, new.instances
        alike = {item.name: getattr(before, item.name) for item in fields(Instances)
                 if same_content(getattr(before, item.name), getattr(now, item.name))}  # fmt: skip
        kept["instances"] = replace(now, **alike)
    return replace(new, **kept), True


def acquire(make_cache: Any) -> Host:
    """A host for a window: the spare one, or a new one."""
    host = _spare.pop()[0] if _spare else Host(make_cache())
    _hosts.append(host)
    return host


def release(host: Host) -> None:
    """Take a host back; it is kept if it is the only spare one and its process is well."""
    if host in _hosts:
        _hosts.remove(host)
        if _spare or not host.process.is_alive:
            host.process.close()
        else:
            host.rest()
            _spare.append((host, time.monotonic()))


def drop_spare(*, whatever: bool = False) -> bool:
    """End a spare process that has waited long, or `whatever`; whether one is left."""
    for host, since in list(_spare):
        if whatever or not host.process.is_alive or time.monotonic() - since > SPARE_SECONDS:
            _spare.remove((host, since))
            host.process.close()
        else:
            host.process.poll()
    return bool(_spare)


def close_all() -> None:
    """End all processes: another file comes, the add-on or Blender goes."""
    drop_spare(whatever=True)
    while _hosts:
        _hosts.pop().process.close()
