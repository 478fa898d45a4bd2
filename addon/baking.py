# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking: Blender gives a place on a mesh for each pixel of an image, and gets what is seen there.

The panels are Cycles' own (`addon.ui`), and so is the type that is baked, `bake_type` of Cycles' settings.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
import numpy.typing as npt

from .bake_overlaps import BakedUvs
from .bake_pictures import BakePicture, bake_picture
from .bake_places import BakePlaces
from .figures import log_figures
from .passes import write_pass
from .progress import TerminalBar
from .properties import render_settings
from .shown_notices import show_notices

if TYPE_CHECKING:
    from engine.render.report import RenderResult
    from engine.scene.bake import Bake
    from engine.scene.description import Notice, SceneDescription
    from engine.settings import RenderSettings

#: Rows on either side of a band that are rendered for the denoiser alone: it blends what lies so far away.
_DENOISER_REACH = 32
#: Of a band where no time is left [s]: each texel gets a sample.
_LEAST_LIMIT = 1e-3


class BakeHook:
    """What the render engine does for a bake.

    Blender makes an engine of its own for each object, calls `update`, then `bake` for each image or tile of it.
    """

    #: Whether Blender has asked for passes, as before every render and before no bake.
    _has_passes: Any = False
    _bake: Any = None  # ObjectBake of the object whose images are baked

    # Of the render engine.
    _guard: Callable[..., None]
    _should_cancel: Callable[[], bool]
    is_preview: bool

    @property
    def _is_bake(self) -> bool:
        """Whether this engine was made for a bake."""
        return not self._has_passes and not self.is_preview

    def bake(
        self, depsgraph: bpy.types.Depsgraph, baked: bpy.types.Object, pass_type: str, pass_filter: int, width: int,
        height: int,
    ) -> None:
        """Bake one image of an object, or one tile of it."""

        def work(graph: bpy.types.Depsgraph) -> None:
            if self._bake is None:
                self._bake = ObjectBake(self, graph, baked, bake_picture(pass_type, pass_filter), self._should_cancel)
            self._bake.bake_image(width, height)

        self._guard(depsgraph, "baking", work)


class ObjectBake:
    """One object's bake of one type, to one image or several.

    Parameters
    ----------
    engine : RenderEngine
    depsgraph : Depsgraph
    baked : Object
        Evaluated.
    picture : BakePicture
        What is baked.
    should_cancel : callable

    Raises
    ------
    ValueError
        If the object is not there to be baked, or the scene cannot be exported.
    """

    def __init__(
        self, engine: Any, depsgraph: bpy.types.Depsgraph, baked: bpy.types.Object, picture: BakePicture,
        should_cancel: Callable[[], bool],
    ) -> None:
        from engine.render.session import Session

        self._engine, self._picture, self._should_cancel = engine, picture, should_cancel
        scene = depsgraph.scene_eval
        self._settings = bake_settings(render_settings(scene), picture)
        self._view = _view_of(scene, picture)
        self._name, self._frame = baked.name, scene.frame_current
        self._uvs = BakedUvs(baked)
        self._description: SceneDescription | None = self._export(depsgraph)
        self._instance = -1
        if self._description is not None:
            self._instance = _find_instance(self._description, baked)
            if picture.catches_shadows:
                catchers = np.zeros(len(self._description.instances.mesh), np.bool_)
                catchers[self._instance] = True
                self._description.instances.is_shadow_catcher = catchers
        self._session = Session(self._settings)
        self._image_count = 0

    def _export(self, depsgraph: bpy.types.Depsgraph) -> SceneDescription | None:
        """The scene; None if the user has gone on meanwhile."""
        from engine.scene.limits import texture_memory

        from .export import ExportCancelled, export_scene

        try:
            return export_scene(
                depsgraph, engine=self._engine, view_layer=depsgraph.view_layer_eval,
                should_cancel=self._should_cancel, texture_memory=texture_memory(self._settings.texture_memory),
                bakes=True,
            )  # fmt: skip
        except ExportCancelled:
            return None

    def bake_image(self, width: int, height: int) -> None:
        """Bake the next image: what Blender calls a render's result has its places, and gets its pixels.

        Raises
        ------
        ValueError
            If this machine cannot hold it, or places are not on the object's mesh.
        """
        from engine.scene.limits import check_baked_image

        if self._description is None:
            return
        check_baked_image(width, height, f"object {self._name!r}")
        # Blender tells images apart by the layer's name.
        target = self._engine.begin_result(0, 0, width, height, layer=f"bake_{self._image_count}")
        self._image_count += 1
        is_whole = False
        try:
            places = BakePlaces(target.layers[0], (height, width), self._instance, self._view)
            triangles, weights = places.on_triangles()
            overlap = self._uvs.overlap_notice(triangles, weights)
            self._show([] if overlap is None else [overlap])
            counts = np.count_nonzero(triangles >= 0, axis=1)
            # They are of the whole image, and a band's are read again.
            del triangles, weights
            pixels = self._bake_bands(self._description, places, counts, width)
            if pixels is not None:
                write_pass(target.layers[0].passes.find_by_name("Combined", ""), pixels)
                is_whole = True
        finally:
            self._engine.end_result(target, cancel=not is_whole, do_merge_results=is_whole)

    def _bake_bands(
        self, description: SceneDescription, places: BakePlaces, counts: npt.NDArray[np.int64], width: int
    ) -> npt.NDArray[np.float32] | None:
        """Pixels, float32 (H, W, 4), as far as the user has not cancelled; None of none.

        As in Cycles, what no face has is opaque or clear by the type that is baked.

        Parameters
        ----------
        counts : int (H,)
            Places in each row of the image.
        """
        from engine.scene.bake import bands_of

        height, total = len(counts), int(counts.sum())
        pixels: npt.NDArray[np.float32] | None = None
        bands, limit = bands_of(width, height), self._settings.time_limit
        is_denoised = self._settings.use_denoising and "Combined" in self._picture.passes
        beside = _DENOISER_REACH if len(bands) > 1 and is_denoised else 0
        ends_at = time.monotonic() + limit
        for first, end in bands:
            count, left = int(counts[first:end].sum()), int(counts[first:].sum())
            if not count:
                continue
            bake = places.band(max(first - beside, 0), min(end + beside, height))
            if limit:
                # 0 would be no limit.
                share = max((ends_at - time.monotonic()) * count / left, _LEAST_LIMIT)
                self._session.settings = dataclasses.replace(self._settings, time_limit=share)
            shares = 1.0 - left / total, 1.0 - (left - count) / total
            result = self._render(description, bake, height, shares)
            if result is None:
                return pixels
            if pixels is None:
                pixels = self._picture.background(height, width)
            x0, y0, x1, y1 = bake.region
            low, high = max(y0, first), min(y1, end)
            if low < high:
                pixels[low:high, x0:x1] = self._picture.compose(result.passes)[low - y0 : high - y0]
            if result.report.cancelled:
                break
            # Before room is made for the next.
            del bake, result
        return self._picture.background(height, width) if pixels is None else pixels

    def _render(
        self, description: SceneDescription, bake: Bake, height: int, shares: tuple[float, float]
    ) -> RenderResult | None:
        """Samples of some of the image's rows, as many as there are if the user has cancelled; None of none.

        Parameters
        ----------
        height : int
            Of the whole image.
        shares : (float, float)
            Of the whole work, before and after these rows.
        """
        from engine.render.session import LoadCancelled

        start = time.monotonic()
        frame = dataclasses.replace(
            description.frame, width=bake.triangles.shape[1], height=height, region=bake.region, pixel_aspect_x=1.0,
            pixel_aspect_y=1.0,
        )  # fmt: skip
        description = dataclasses.replace(description, frame=frame, bake=bake)
        try:
            with self._progress(*shares) as on_progress:
                notices = self._session.load(
                    description, on_progress=on_progress, should_cancel=self._should_cancel
                )
                self._show(notices)
                result = self._session.render(
                    on_progress=on_progress, should_cancel=self._should_cancel, passes=self._picture.passes
                )
        except LoadCancelled:
            return None
        if result.report.cancelled and not result.report.sample_count:
            return None
        self._show(result.report.notices)
        log_figures(f"Bake {self._name}", self._frame, time.monotonic() - start, result.report)
        return result

    def _show(self, notices: list[Notice]) -> None:
        show_notices(self._engine, notices)

    @contextmanager
    def _progress(self, before: float, after: float) -> Iterator[Callable[[Any], None]]:
        bar = TerminalBar() if bpy.app.background else None

        def on_progress(progress: Any) -> None:
            fraction = before + (after - before) * progress.fraction
            if after < 1.0:
                # What it is of these rows says nothing of all.
                progress = dataclasses.replace(progress, remaining=None)
            self._engine.update_progress(fraction)
            if bar is not None:
                bar.update(f"Bake {self._name}", fraction, progress)

        try:
            yield on_progress
        finally:
            if bar is not None:
                bar.close()


def bake_settings(settings: RenderSettings, picture: BakePicture) -> RenderSettings:
    """What a bake is rendered by, of what renders of the scene are.

    The film is transparent, as Cycles has it, since behind a hole in a surface there is no picture's background. What
    is known without following light needs no guiding.
    """
    settings = dataclasses.replace(settings, film_transparent=True)
    if picture.is_lit:
        return settings
    return dataclasses.replace(
        settings, guiding_method="OFF", radiance_cache="OFF", spectral="OFF", caustics="PATHS", use_denoising=False,
        strata=0,
    )


def _view_of(scene: bpy.types.Scene, picture: BakePicture) -> str:
    """From where places are looked at.

    Raises
    ------
    ValueError
        If it is from the camera, and there is none.
    """
    from engine.scene.bake import BACKGROUND, FROM_ABOVE, FROM_CAMERA

    if picture.is_of_background:
        return BACKGROUND
    if getattr(scene.render.bake, "view_from", "ABOVE_SURFACE") != "ACTIVE_CAMERA":
        return FROM_ABOVE
    if scene.camera is None:
        raise ValueError(
            f"Scene {scene.name!r} has no camera to bake from: add one, or set View From to Above Surface in Render "
            f"properties > Bake"
        )
    return FROM_CAMERA


def _find_instance(description: SceneDescription, baked: bpy.types.Object) -> int:
    """The row of an object itself, not of its copies by instancing.

    Raises
    ------
    ValueError
        If renders do not show it.
    """
    instances = description.instances
    place = np.array(baked.matrix_world, np.float32)
    named = [row for row, name in enumerate(instances.name) if name == baked.name]
    rows = [row for row in named if np.allclose(instances.transform[row], place, rtol=1e-5, atol=1e-6)]
    if not rows:
        raise ValueError(
            f"object {baked.name!r} is in no render, so it cannot be baked: it may have no faces, be scaled to zero, "
            f"or be hidden from all rays (Object properties > Visibility)"
        )
    return rows[0]
