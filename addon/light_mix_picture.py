# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture of a light mix: what the last render has left for it, and the image that shows it.

Python cannot write into Blender's Render Result. So that stays as it was rendered, in files too, and an image of its
own, *Light Mix*, has the mix: it is made anew by numpy whenever a factor changes, and image editors that show the
Render Result show it instead.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
import numpy.typing as npt

from . import light_mix

if TYPE_CHECKING:
    from engine.scene.description import SceneDescription

IMAGE_NAME = "Light Mix"
_RENDER_RESULT = "Render Result"
#: How often it is looked whether Blender has ended a job [s].
_PAUSE = 0.2

#: Whether renders leave their groups for a mix: where somebody looks.
keeps_passes = not bpy.app.background


class NotedPasses(Mapping[str, npt.NDArray[np.float32]]):
    """Passes of a render, of which the picture and light groups are kept once they are looked up.

    Parameters
    ----------
    passes : mapping of float32 (height, width, channels)
    groups : iterable of str
        Names of light groups.

    Attributes
    ----------
    picture : float32 (height, width, 4) or None
    groups : dict of float32 (height, width, 3)
        By name of the group.
    environment : float32 (height, width, 3) or None
    """

    def __init__(self, passes: Mapping[str, npt.NDArray[np.float32]], layer: bpy.types.ViewLayer) -> None:
        self._passes = passes
        names = [group.name for group in getattr(layer, "lightgroups", ())]
        self._groups = {light_mix.PASS_PREFIX + name: name for name in names}
        self.picture: npt.NDArray[np.float32] | None = None
        self.groups: dict[str, npt.NDArray[np.float32]] = {}
        self.environment: npt.NDArray[np.float32] | None = None

    def __getitem__(self, name: str) -> npt.NDArray[np.float32]:
        image = self._passes[name]
        if not keeps_passes:
            return image
        if name == "Combined":
            self.picture = image
        elif name == "Environment":
            self.environment = image
        elif name in self._groups:
            self.groups[self._groups[name]] = image
        return image

    def __contains__(self, name: object) -> bool:
        return name in self._passes

    def __iter__(self) -> Iterator[str]:
        return iter(self._passes)

    def __len__(self) -> int:
        return len(self._passes)


@dataclasses.dataclass
class _Kept:
    """What a render has left of a view layer.

    picture, groups : as in `NotedPasses`
    size : width and height of the whole image [pixels]
    corner : column and row of the region that was rendered, from the lower left
    is_new : whether the layer's factors do not know of this render yet
    shown : the factors that the image has been made by, None while it has not
    """

    picture: npt.NDArray[np.float32]
    groups: dict[str, npt.NDArray[np.float32]]
    size: tuple[int, int]
    corner: tuple[int, int] = (0, 0)
    is_new: bool = True
    shown: dict[str, light_mix.Factor] | None = None


#: By names of scene and view layer.
_kept: dict[tuple[str, str], _Kept] = {}


def keep(
    engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, view: str, description: SceneDescription,
    passes: NotedPasses,
) -> None:
    """Keep what a render has left of a view layer, and note its mix in the metadata of files. In a stereo render the
    first view is kept.
    """
    scene, layer = depsgraph.scene, depsgraph.view_layer_eval
    names = light_mix.group_names(scene)
    # Those of the frame, where they are animated.
    factors = light_mix.factors_of(depsgraph.scene_eval)
    if names:
        # Only the full result's fields reach the file, not those of the part being rendered.
        engine.get_result().stamp_data_add_field(
            light_mix.FIELD, light_mix.to_text({name: factors.get(name, light_mix.NEUTRAL) for name in names})
        )
    behind = light_mix.background_group(depsgraph)
    if behind:
        engine.get_result().stamp_data_add_field(light_mix.BACKGROUND_FIELD.format(layer=layer.name), behind)
    if view and view != next(one.name for one in scene.render.views if one.use):
        return
    _kept.pop((scene.name, layer.name), None)
    if passes.picture is None or not passes.groups:
        return
    if behind in passes.groups and passes.environment is not None:
        from engine.render.light_mix import without_background

        passes.groups[behind] = without_background(passes.groups[behind], passes.environment)
    frame = description.frame
    x0, y0, x1, y1 = frame.region
    cropped = scene.render.use_crop_to_border
    size, corner = ((x1 - x0, y1 - y0), (0, 0)) if cropped else ((frame.width, frame.height), (x0, y0))
    _kept[scene.name, layer.name] = _Kept(passes.picture, passes.groups, size, corner)


def rendered_groups(scene: bpy.types.Scene) -> list[str]:
    """Light groups that the last render of a scene has left for a mix; empty where it has left none."""
    names = [name for (owner, _), kept in _kept.items() if owner == scene.name for name in kept.groups]
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
    """Make the images of a scene's mixes anew where their factors are others by now; whether there was such a one."""
    from engine.render.light_mix import changes

    has_changed = False
    layers = {layer: kept for layer in scene.view_layers if (kept := _kept.get((scene.name, layer.name))) is not None}
    if any(kept.is_new for kept in layers.values()):
        for entry in scene.neuralguide.light_mix:
            entry.property_unset("written")
    for kept in layers.values():
        kept.is_new = False
        light_mix.add_missing(scene, kept.groups)
    shown = light_mix.shown_factors(scene)
    for layer, kept in layers.items():
        factors = {group: factor for group, factor in shown.items() if group in kept.groups}
        image = image_of(scene, layer)
        if (changes(factors) if image is None else kept.shown != factors):
            _make_image(scene, layer, kept, factors)
            has_changed = True
    return has_changed


def _make_image(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, kept: _Kept, factors: dict[str, light_mix.Factor]
) -> None:
    from engine.render.light_mix import mixed

    width, height = kept.size
    picture = mixed(kept.picture, kept.groups, factors)
    if picture.shape[:2] != (height, width):
        whole = np.zeros((height, width, picture.shape[2]), np.float32)
        column, row = kept.corner
        whole[row : row + picture.shape[0], column : column + picture.shape[1]] = picture
        picture = whole
    name = _image_name(scene, layer.name)
    image = bpy.data.images.get(name)
    if image is not None and (image.source != "GENERATED" or not image.is_float or tuple(image.size) != kept.size):
        bpy.data.images.remove(image)
        image = None
    if image is None:
        image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=True)
        image.alpha_mode = "PREMUL"
        # The view transform, exposure and look of the Render Result.
        image.use_view_as_render = True
    image.pixels.foreach_set(np.ascontiguousarray(picture).reshape(-1))
    image.update()
    kept.shown = factors


def _turn_editors() -> None:
    """Image editors that show the Render Result show the mix, or the other way where the mix is switched off."""
    result = bpy.data.images.get(_RENDER_RESULT)
    for window in getattr(bpy.context.window_manager, "windows", ()):
        scene, layer = window.scene, window.view_layer
        image = image_of(scene, layer)
        if image is None or (scene.name, layer.name) not in _kept:
            continue
        old, new = (result, image) if scene.neuralguide.use_light_mix else (image, result)
        for area in window.screen.areas:
            space = area.spaces.active
            if area.type == "IMAGE_EDITOR" and space.image == old and new is not None:
                space.image = new
                area.tag_redraw()


def _mix_all() -> None:
    """Whoever has an editor show something else keeps that until a mix changes."""
    scenes = [scene for scene in bpy.data.scenes if any(name == scene.name for name, _ in _kept)]
    if any([_mix(scene) for scene in scenes]):
        _turn_editors()


@bpy.app.handlers.persistent
def _begin(scene: bpy.types.Scene, *_args: Any) -> None:
    """The Render Result is another from now on."""
    for owner in [owner for owner in _kept if owner[0] == scene.name]:
        del _kept[owner]


@bpy.app.handlers.persistent
def _end(*_args: Any) -> None:
    if not _kept:
        return
    if bpy.app.background:
        _mix_all()
    else:
        # Handlers run in the thread of the job.
        bpy.app.timers.register(_show_after_job, first_interval=_PAUSE)


def _show_after_job() -> float | None:
    if bpy.app.is_job_running("RENDER"):
        return _PAUSE
    _mix_all()
    return None


@bpy.app.handlers.persistent
def _go_along(*_args: Any) -> None:
    """Another frame has other factors where they are animated, and undoing brings others back."""
    if _kept and not bpy.app.is_job_running("RENDER"):
        _mix_all()


@bpy.app.handlers.persistent
def forget(*_args: Any) -> None:
    """Free what is kept."""
    _kept.clear()


def _handlers() -> list[tuple[list[Any], Any]]:
    handlers = bpy.app.handlers
    return [
        (handlers.render_init, _begin), (handlers.render_complete, _end), (handlers.render_cancel, _end),
        (handlers.load_pre, forget),
        (handlers.frame_change_post, _go_along), (handlers.undo_post, _go_along), (handlers.redo_post, _go_along),
    ]  # fmt: skip


def register() -> None:
    """Show mixes once renders have ended, and free them when another file is opened."""
    for handlers, handler in _handlers():
        handlers.append(handler)


def unregister() -> None:
    """Stop that, and free what is kept."""
    for handlers, handler in _handlers():
        if handler in handlers:
            handlers.remove(handler)
    forget()
