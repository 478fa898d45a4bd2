# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture of a light mix: what the last render has left for it, and the image that shows it.

Python cannot write into Blender's Render Result. So that stays as it was rendered, in files too, and an image of its
own, *Light Mix*, has the mix: it is made anew by numpy whenever a factor changes, and image editors that show the
Render Result show it instead.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
import numpy.typing as npt

from . import light_mix
from .app_handlers import add_handlers, remove_handlers
from .shared_settings import thread_count

if TYPE_CHECKING:
    from engine.scene.description import SceneDescription

Float32Array = npt.NDArray[np.float32]

IMAGE_NAME = "Light Mix"
_RENDER_RESULT = "Render Result"
_FEATURES = ("Denoising Albedo", "Denoising Normal")
#: How often it is looked whether Blender has ended a job [s].
_PAUSE = 0.2

#: Whether renders leave their groups for a mix: where somebody looks.
keeps_passes = not bpy.app.background


@dataclasses.dataclass
class Noted:
    """Passes of a view layer that a mix is made of, row 0 at the bottom.

    picture : float32 (height, width, 4)
    groups : dict of float32 (height, width, 3), by name of the group
    environment : the pass, None where it was not rendered
    sampled : the picture before it was denoised, None where it was not
    albedo, normal : what helps to denoise the groups
    """

    picture: Float32Array | None = None
    groups: dict[str, Float32Array] = dataclasses.field(default_factory=dict)
    environment: Float32Array | None = None
    sampled: Float32Array | None = None
    albedo: Float32Array | None = None
    normal: Float32Array | None = None


class _NotingPasses(Mapping[str, Float32Array]):
    """Passes of a render, which are made when they are looked up: what is, is kept."""

    def __init__(self, passes: Mapping[str, Float32Array], names: Iterable[str]) -> None:
        self._passes, self._names = passes, {*names}
        self.noted: dict[str, Float32Array] = {}

    def __getitem__(self, name: str) -> Float32Array:
        image = self._passes[name]
        if name in self._names:
            self.noted[name] = image
        return image

    def __contains__(self, name: object) -> bool:
        return name in self._passes

    def __iter__(self) -> Iterator[str]:
        return iter(self._passes)

    def __len__(self) -> int:
        return len(self._passes)


def note(
    passes: Mapping[str, Float32Array], layer: bpy.types.ViewLayer, write: Callable[[Mapping[str, Float32Array]], None]
) -> Noted:
    """Have a render's passes written, and note those that a mix is made of: each is made once.

    Parameters
    ----------
    passes : mapping of float32 (height, width, channels)
    layer : ViewLayer
        What they are of.
    write : callable
        Looks passes up.
    """
    groups = {light_mix.PASS_PREFIX + group.name: group.name for group in getattr(layer, "lightgroups", ())}
    if not keeps_passes or not groups:
        write(passes)
        return Noted()
    noting = _NotingPasses(passes, ("Combined", "Noisy Image", "Environment", *_FEATURES, *groups))
    write(noting)
    noted = noting.noted
    sampled = noted.get("Noisy Image")
    if sampled is not None and np.array_equal(sampled, noted["Combined"], equal_nan=True):
        sampled = None
    if sampled is not None:
        # The denoiser has used them, whether the layer asks for them or not.
        with contextlib.suppress(KeyError, MemoryError):
            for name in _FEATURES:
                noting[name]
    return Noted(
        noted.get("Combined"), {group: noted[name] for name, group in groups.items() if name in noted},
        noted.get("Environment"), sampled, *map(noted.get, _FEATURES),
    )  # fmt: skip


@dataclasses.dataclass
class _Kept:
    """What a render has left of a view layer.

    passes : Noted
    size : width and height of the whole image [pixels]
    corner : column and row of the region that was rendered, from the lower left
    threads : that may denoise
    is_new : whether the scene's factors do not know of this render yet
    shown : the factors that the image has been made by, None while it has not
    parts : of a denoised picture, as `engine.render.light_mix.denoised_parts` makes them, once there was a mix
    problem : why the image does not show the factors as they are, '' where it does
    """

    passes: Noted
    size: tuple[int, int]
    corner: tuple[int, int]
    threads: int
    is_new: bool = True
    shown: dict[str, light_mix.Factor] | None = None
    parts: tuple[Float32Array, dict[str, Float32Array]] | None = None
    problem: str = ""

    def mixed(self, factors: dict[str, light_mix.Factor]) -> Float32Array:
        """The picture by these factors."""
        from engine.render.light_mix import changes, denoised_parts, mixed, mixed_denoised

        passes = self.passes
        assert passes.picture is not None
        if passes.sampled is None or not changes(factors):
            return mixed(passes.picture, passes.groups, factors)
        if self.parts is None:
            self.parts = denoised_parts(
                passes.sampled, passes.groups, passes.albedo, passes.normal, threads=self.threads
            )
        return mixed_denoised(passes.picture, *self.parts, factors)


#: Editors that were given another image; undoing changes no windows.
_turned: set[int] = set()
#: By names of scene and view layer.
_kept: dict[tuple[str, str], _Kept] = {}


def keep(
    engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, view: str, description: SceneDescription,
    passes: Noted,
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
    _kept[scene.name, layer.name] = _Kept(passes, size, corner, thread_count(depsgraph.scene_eval))


def rendered_groups(scene: bpy.types.Scene) -> list[str]:
    """Light groups that the last render of a scene has left for a mix; empty where it has left none."""
    names = [name for (owner, _), kept in _kept.items() if owner == scene.name for name in kept.passes.groups]
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
        light_mix.add_missing(scene, kept.passes.groups)
    shown = light_mix.shown_factors(scene)
    for layer, kept in layers.items():
        factors = {group: factor for group, factor in shown.items() if group in kept.passes.groups}
        image = image_of(scene, layer)
        if changes(factors) if image is None else kept.shown != factors:
            kept.problem = _try_image(scene, layer, kept, factors)
            has_changed = True
    return has_changed


def _try_image(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, kept: _Kept, factors: dict[str, light_mix.Factor]
) -> str:
    """Make an image; returns why that did not work. Blender would put it where nobody looks."""
    try:
        _make_image(scene, layer, kept, factors)
    except MemoryError:
        return "out of memory: render smaller, or with fewer light groups"
    except (ValueError, RuntimeError) as error:  # a factor that is no number; the denoiser
        return str(error)
    return ""


def problem(scene: bpy.types.Scene) -> str:
    """Why a mix of a scene is not shown as its factors are, '' where it is."""
    problems = [kept.problem for (owner, _), kept in _kept.items() if owner == scene.name]
    return next(filter(None, problems), "")


def _make_image(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, kept: _Kept, factors: dict[str, light_mix.Factor]
) -> None:
    width, height = kept.size
    picture = kept.mixed(factors)
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
    for window, area in _editors():
        image = image_of(window.scene, window.view_layer)
        old, new = (result, image) if window.scene.neuralguide.use_light_mix else (image, result)
        if image is not None and new is not None and area.spaces.active.image == old:
            _turn(area, new)


def _turn_back() -> None:
    """Editors that showed a mix which undoing has taken away show the Render Result."""
    result = bpy.data.images.get(_RENDER_RESULT)
    for _, area in _editors():
        if result is not None and area.as_pointer() in _turned and area.spaces.active.image is None:
            _turn(area, result)


def _editors() -> Iterator[tuple[bpy.types.Window, bpy.types.Area]]:
    """Image editors of windows whose scene and view layer have a picture to mix."""
    for window in getattr(bpy.context.window_manager, "windows", ()):
        if (window.scene.name, window.view_layer.name) in _kept:
            for area in window.screen.areas:
                if area.type == "IMAGE_EDITOR":
                    yield window, area


def _turn(area: bpy.types.Area, image: bpy.types.Image) -> None:
    area.spaces.active.image = image
    area.tag_redraw()
    _turned.add(area.as_pointer())


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
        _turn_back()


@bpy.app.handlers.persistent
def forget(*_args: Any) -> None:
    """Free what is kept."""
    _kept.clear()
    _turned.clear()


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
