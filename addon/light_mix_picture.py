# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture of a render's light mix: what the render has left for it so far, and the image that shows it.

Python cannot write into Blender's Render Result. So that stays as it was rendered, in files too, and an image of its
own, *Light Mix*, has the mix: it is made anew by numpy whenever a factor changes or more samples are there, and image
editors that show the Render Result show it instead.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
import numpy.typing as npt

from . import light_mix, light_mix_images
from .app_handlers import add_handlers, remove_handlers
from .light_mix_passes import Mixer, Noted, note
from .shared_settings import thread_count

if TYPE_CHECKING:
    from engine.scene.description import SceneDescription

Float32Array = npt.NDArray[np.float32]

IMAGE_NAME = "Light Mix"
_RENDER_RESULT = "Render Result"
#: How often it is looked whether there are more samples, and whether Blender has ended the job [s].
_PAUSE = 0.2


@dataclasses.dataclass
class _Kept:
    """What a render has left of a view layer.

    mixer : Mixer
    size : width and height of the whole image [pixels]
    corner : column and row of the region that was rendered, from the lower left
    is_new : whether the scene's factors do not know of this render yet
    tried : the factors that the image was made by last, None while it was not
    problem : why the image does not show the factors as they are, '' where it does
    """

    mixer: Mixer
    size: tuple[int, int]
    corner: tuple[int, int]
    is_new: bool = True
    tried: dict[str, light_mix.Factor] | None = None
    problem: str = ""

    def picture(self, factors: dict[str, light_mix.Factor]) -> Float32Array:
        """The whole image by these factors; what was not rendered is empty."""
        (width, height), (column, row) = self.size, self.corner
        picture = self.mixer.picture(factors)
        if picture.shape[:2] == (height, width):
            return picture
        whole = np.zeros((height, width, picture.shape[2]), np.float32)
        whole[row : row + picture.shape[0], column : column + picture.shape[1]] = picture
        return whole


#: By names of scene and view layer.
_kept: dict[tuple[str, str], _Kept] = {}


class RenderedMix:
    """What one render of a view layer leaves for a mix: of the samples so far, and then of all.

    In a stereo render the first view is kept.

    Parameters
    ----------
    engine : RenderEngine
    depsgraph : Depsgraph
    view : str
        Of a stereo render, else ''.
    description : SceneDescription
        What is rendered.
    """

    def __init__(
        self, engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, view: str,
        description: SceneDescription,
    ) -> None:
        self._engine, self._depsgraph, self._description = engine, depsgraph, description
        scene = depsgraph.scene
        self._is_shown = not view or view == next(one.name for one in scene.render.views if one.use)
        self._newest: _Kept | None = None

    def note(
        self, passes: Mapping[str, Float32Array], write: Callable[[Mapping[str, Float32Array]], None]
    ) -> Noted:
        """Have passes written, and note those that a mix is made of: each is made once."""
        return note(passes, self._depsgraph.view_layer_eval, write)

    def stream(
        self, passes: Mapping[str, Float32Array], write: Callable[[Mapping[str, Float32Array]], None]
    ) -> None:
        """Have passes of the samples so far written, and mix them."""
        noted = self.note(passes, write)
        with contextlib.suppress(MemoryError):
            self._keep(noted)
        _tell()

    def keep(self, passes: Noted) -> None:
        """Mix the finished picture, and note its mix in the metadata of files."""
        depsgraph = self._depsgraph
        names = light_mix.group_names(depsgraph.scene)
        # Those of the frame, where they are animated.
        factors = light_mix.factors_of(depsgraph.scene_eval)
        # Only the full result's fields reach the file, not those of the part being rendered.
        result = self._engine.get_result()
        if names:
            result.stamp_data_add_field(
                light_mix.FIELD, light_mix.to_text({name: factors.get(name, light_mix.NEUTRAL) for name in names})
            )
        behind = light_mix.background_group(depsgraph)
        if behind:
            result.stamp_data_add_field(
                light_mix.BACKGROUND_FIELD.format(layer=depsgraph.view_layer_eval.name), behind
            )
        self._keep(passes)

    def _keep(self, passes: Noted) -> None:
        depsgraph, frame = self._depsgraph, self._description.frame
        scene = depsgraph.scene
        if not self._is_shown:
            return
        owner = scene.name, depsgraph.view_layer_eval.name
        if passes.picture is None or not passes.groups:
            _kept.pop(owner, None)
            return
        behind = light_mix.background_group(depsgraph)
        if behind in passes.groups and passes.environment is not None:
            from engine.render.light_mix import without_background

            passes.groups[behind] = without_background(passes.groups[behind], passes.environment)
        x0, y0, x1, y1 = frame.region
        cropped = scene.render.use_crop_to_border
        size, corner = ((x1 - x0, y1 - y0), (0, 0)) if cropped else ((frame.width, frame.height), (x0, y0))
        # What was written back to lamps while it rendered is not in the picture, whose lamps were read before.
        is_new = self._newest is None or self._newest.is_new
        mixer = Mixer(passes, thread_count(depsgraph.scene_eval))
        _kept[owner] = self._newest = _Kept(mixer, size, corner, is_new)


def rendered_groups(scene: bpy.types.Scene) -> list[str]:
    """Light groups that the last render of a scene has left for a mix; empty where it has left none."""
    names = [name for (owner, _), kept in [*_kept.items()] if owner == scene.name for name in kept.mixer.groups]
    return list(dict.fromkeys(names))


def image_of(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bpy.types.Image | None:
    """The image that shows the mix of a view layer, None while there is none."""
    return bpy.data.images.get(_image_name(scene, layer.name))


def _image_name(scene: bpy.types.Scene, layer: str) -> str:
    return IMAGE_NAME if len(scene.view_layers) == 1 else f"{IMAGE_NAME} {layer}"


def show(scene: bpy.types.Scene) -> None:
    """Mix what is kept of a scene by its factors as they are now, and have image editors show it."""
    _mix(scene)
    _turn_editors()


def _mix(scene: bpy.types.Scene) -> bool:
    """Make the images of a scene's mixes anew where their factors or pictures are others by now; whether there was
    such a one."""
    from engine.render.light_mix import changes

    has_changed = False
    layers = {layer: kept for layer in scene.view_layers if (kept := _kept.get((scene.name, layer.name))) is not None}
    if any(kept.is_new for kept in layers.values()):
        for entry in scene.neuralguide.light_mix:
            entry.property_unset("written")
    for kept in layers.values():
        kept.is_new = False
        light_mix.add_missing(scene, kept.mixer.groups)
    shown = light_mix.shown_factors(scene)
    for layer, kept in layers.items():
        factors = {group: factor for group, factor in shown.items() if group in kept.mixer.groups}
        has_image = image_of(scene, layer) is not None
        is_due = kept.tried != factors or not (has_image or kept.problem)
        if is_due and (has_image or changes(factors)):
            kept.tried = factors
            name = _image_name(scene, layer.name)
            kept.problem = light_mix_images.problem_of(
                lambda: light_mix_images.put(name, kept.picture(factors))  # noqa: B023 (called at once)
            )
            has_changed = True
    return has_changed


def problem(scene: bpy.types.Scene) -> str:
    """Why a mix of a scene is not shown as its factors are, '' where it is."""
    problems = [kept.problem for (owner, _), kept in [*_kept.items()] if owner == scene.name]
    return next(filter(None, problems), "")


def _turn_editors() -> None:
    """Image editors that show the Render Result show the mix, or the other way where the mix is switched off."""
    result = bpy.data.images.get(_RENDER_RESULT)
    for window, area in _editors():
        image = image_of(window.scene, window.view_layer)
        old, new = (result, image) if window.scene.neuralguide.use_light_mix else (image, result)
        if image is not None and new is not None and area.spaces.active.image == old:
            light_mix_images.turn(area, new)


def _turn_back() -> None:
    """Editors that showed a mix which undoing has taken away show the Render Result."""
    result = bpy.data.images.get(_RENDER_RESULT)
    for _, area in _editors():
        if result is not None:
            light_mix_images.turn_back(area, result)


def _editors() -> Iterator[tuple[bpy.types.Window, bpy.types.Area]]:
    """Image editors of windows whose scene and view layer have a picture to mix."""
    for window, area in light_mix_images.editors():
        if (window.scene.name, window.view_layer.name) in _kept:
            yield window, area


def _mix_all() -> None:
    """Whoever has an editor show something else keeps that until a mix changes."""
    scenes = [scene for scene in bpy.data.scenes if any(name == scene.name for name, _ in [*_kept])]
    if any([_mix(scene) for scene in scenes]):
        _turn_editors()


@bpy.app.handlers.persistent
def _begin(scene: bpy.types.Scene, *_args: Any) -> None:
    """The Render Result is another from now on."""
    for owner in [owner for owner in _kept if owner[0] == scene.name]:
        del _kept[owner]


@bpy.app.handlers.persistent
def _end(*_args: Any) -> None:
    if _kept:
        _tell()


def _tell() -> None:
    """There is something new to be mixed: by the main thread, which makes images."""
    if bpy.app.background:
        _mix_all()
    elif not bpy.app.timers.is_registered(_follow_job):
        # Renders run, and handlers too, in the thread of the job.
        bpy.app.timers.register(_follow_job, first_interval=_PAUSE)


def _follow_job() -> float | None:
    is_running = bpy.app.is_job_running("RENDER")
    _mix_all()
    return _PAUSE if is_running else None


@bpy.app.handlers.persistent
def _go_along(*_args: Any) -> None:
    """Another frame has other factors where they are animated, and undoing brings others back."""
    if _kept and not bpy.app.is_job_running("RENDER"):
        _mix_all()
        _turn_back()


@bpy.app.handlers.persistent
def forget(*_args: Any) -> None:
    """Free what is kept."""
    _kept.clear()
    light_mix_images.forget()


def _handlers() -> list[tuple[list[Any], Any]]:
    handlers = bpy.app.handlers
    return [
        (handlers.render_init, _begin), (handlers.render_complete, _end), (handlers.render_cancel, _end),
        (handlers.load_pre, forget),
        (handlers.frame_change_post, _go_along), (handlers.undo_post, _go_along), (handlers.redo_post, _go_along),
    ]  # fmt: skip


def register() -> None:
    """Show mixes once renders have ended, and free them when another file is opened."""
    add_handlers(_handlers())


def unregister() -> None:
    """Stop that, and free what is kept."""
    remove_handlers(_handlers())
    forget()
