# SPDX-License-Identifier: GPL-3.0-or-later
"""Light mixes of saved files: an image of OpenEXR MultiLayer has factors of its own, and an image that shows its mix.

The factors are the image's and are saved in the .blend. They begin as those of the file's metadata, and get back there
by `save`. The file's pixels stay as they were rendered.
"""

from __future__ import annotations

import dataclasses
import zlib
from pathlib import Path
from typing import Any

import bpy

from . import light_mix, light_mix_images
from .app_handlers import add_handlers, remove_handlers
from .exr_layers import LayersError, read_layers
from .exr_metadata import set_text
from .light_mix_layers import check_mix, layer_passes, mix_in, rendered_groups
from .light_mix_passes import Mixer

_IMAGE_NAME = "Light Mix of {image}"
#: Of an image's name [bytes], before Blender 5.0.
_LONGEST_NAME = 63


@dataclasses.dataclass
class _Opened:
    """What was read of a file.

    mixers : dict of Mixer, by the name of the image that shows it: one for each view layer
    path : Path
    tried : the factors that its images were made by last, None while they were not
    problem : why its images do not show the factors as they are, '' where they do
    """

    mixers: dict[str, Mixer]
    path: Path
    tried: dict[str, light_mix.Factor] | None = None
    problem: str = ""


#: By the name of the image that shows the file.
_opened: dict[str, _Opened] = {}


def open_file(image: bpy.types.Image, threads: int) -> None:
    """Read what an image's mix is made of, give the image factors where it has none, and show the mix.

    Parameters
    ----------
    image : Image
        Of a file of layers.
    threads : int
        That may denoise; 0 = all.

    Raises
    ------
    LayersError
        If the file has no light groups, is mixed already, or cannot be read.
    """
    path = _path_of(image)
    layers = read_layers(path)
    mix = mix_in(layers) if layers.metadata(light_mix.FIELD) else {}
    groups = [group for layer in layers.layers() for group in rendered_groups(layers, layer)]
    check_mix(layers, {group: factor for group, factor in mix.items() if group in groups})
    _opened.pop(image.name, None)
    known = {*image.neuralguide.light_mix.keys()}
    light_mix.add_missing(image, groups)
    for entry in image.neuralguide.light_mix:
        if entry.name not in known and entry.name in mix:
            light_mix.set_factor(entry, mix[entry.name])
    names = [layer for layer in layers.layers() if rendered_groups(layers, layer)]
    _opened[image.name] = _Opened(
        {
            _image_name(image.name, "" if len(names) == 1 else layer): Mixer(layer_passes(layers, layer), threads)
            for layer in names
        },
        path,
    )
    show(image)


def _image_name(image: str, layer: str) -> str:
    """The name of the image of a mix, short enough for every Blender."""
    name = _IMAGE_NAME.format(image=image) + (f" {layer}" if layer else "")
    if len(name.encode()) <= _LONGEST_NAME:
        return name
    mark = f" {zlib.crc32(name.encode()):08x}"
    return name.encode()[: _LONGEST_NAME - len(mark)].decode(errors="ignore") + mark


def _path_of(image: bpy.types.Image) -> Path:
    if image.source == "SEQUENCE":
        raise LayersError(
            f"image {image.name} is a sequence of frames: choose Render > Mix Lights of a Sequence of Frames, or open "
            "a frame as a single image"
        )
    path = Path(bpy.path.abspath(image.filepath, library=image.library)).absolute()
    if not path.is_file():
        raise LayersError(f"there is no file {path}: if image {image.name} is packed into the .blend, unpack it")
    return path


def shown_file(image: bpy.types.Image | None) -> bpy.types.Image | None:
    """The image of a file of layers that an image is, or whose mix it shows; None where it is something else."""
    if image is None or image.type == "MULTILAYER":
        return image
    for name, opened in _opened.items():
        if image.name in opened.mixers:
            return bpy.data.images.get(name)
    return None


def opened_groups(image: bpy.types.Image) -> list[str]:
    """Light groups of an image's file; empty where it was not opened for a mix."""
    opened = _opened.get(image.name)
    mixers = [] if opened is None else opened.mixers.values()
    return list(dict.fromkeys(group for mixer in mixers for group in mixer.groups))


def problem(image: bpy.types.Image) -> str:
    """Why the mix of an image is not shown as its factors are, '' where it is."""
    opened = _opened.get(image.name)
    return "" if opened is None else opened.problem


def show(image: bpy.types.Image) -> None:
    """Mix an image's file by its factors as they are now, and have image editors that show the file show it; or the
    file again where the mix is switched off."""
    opened = _opened.get(image.name)
    if opened is None:
        return
    factors = light_mix.factors_of(image)
    if opened.tried != factors or not all(name in bpy.data.images for name in opened.mixers):
        opened.tried = factors
        opened.problem = light_mix_images.problem_of(lambda: _make_images(opened, factors))
    shown = [bpy.data.images[name] for name in opened.mixers if name in bpy.data.images]
    if not shown:
        return
    is_mixed = image.neuralguide.use_light_mix
    for _, area in light_mix_images.editors():
        if is_mixed and area.spaces.active.image == image:
            light_mix_images.turn(area, shown[0])
        elif not is_mixed and area.spaces.active.image in shown:
            light_mix_images.turn(area, image)


def _make_images(opened: _Opened, factors: dict[str, light_mix.Factor]) -> None:
    for name, mixer in opened.mixers.items():
        own = {group: factor for group, factor in factors.items() if group in mixer.groups}
        light_mix_images.put(name, mixer.picture(own))


def save(image: bpy.types.Image) -> Path:
    """Keep an image's factors in the metadata of its file, whose pixels stay as they are; returns its path.

    Raises
    ------
    LayersError
        If it cannot be written.
    """
    opened = _opened[image.name]
    factors = light_mix.factors_of(image)
    set_text(opened.path, light_mix.FIELD, light_mix.to_text({name: factors[name] for name in opened_groups(image)}))
    return opened.path


@bpy.app.handlers.persistent
def forget(*_args: Any) -> None:
    """Free what was read."""
    _opened.clear()


@bpy.app.handlers.persistent
def _go_along(*_args: Any) -> None:
    """Undoing brings other factors back."""
    for name in [*_opened]:
        image = bpy.data.images.get(name)
        if image is None:
            del _opened[name]
        else:
            show(image)


def _handlers() -> list[tuple[list[Any], Any]]:
    handlers = bpy.app.handlers
    return [(handlers.load_pre, forget), (handlers.undo_post, _go_along), (handlers.redo_post, _go_along)]


def register() -> None:
    """Free what was read when another file is opened, and follow undoing."""
    add_handlers(_handlers())


def unregister() -> None:
    """Stop that, and free what was read."""
    remove_handlers(_handlers())
    forget()
