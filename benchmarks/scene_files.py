# SPDX-License-Identifier: GPL-3.0-or-later
"""Opening what the command line calls a scene: a .blend file or `builtin:NAME`, at the size asked for."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

BUILTIN = "builtin:"


@dataclass(frozen=True)
class SceneSource:
    """A scene by what was typed. `name` is unique and fit for a file name."""

    text: str

    @property
    def is_builtin(self) -> bool:
        """Whether the project builds it itself."""
        return self.text.startswith(BUILTIN)

    @property
    def name(self) -> str:
        """Short name: the file's stem, or the built-in scene's name."""
        return self.text.removeprefix(BUILTIN) if self.is_builtin else Path(self.text).stem

    def content_hash(self) -> str:
        """Identity of the content: the file's hash, or that of the builders' sources."""
        if self.is_builtin:
            from benchmarks.scenes.registry import source_hash

            return source_hash()[:16]
        return hashlib.sha256(Path(self.text).read_bytes()).hexdigest()[:16]

    def note(self) -> str:
        """A documented difference from Cycles; '' if none."""
        if self.is_builtin:
            from benchmarks.scenes import SCENES

            return SCENES[self.name].note
        return ""

    def allowance(self) -> float:
        """How large the documented difference may be in a cell, relative."""
        if self.is_builtin:
            from benchmarks.scenes import SCENES

            return SCENES[self.name].allowance
        return 0.0


def expand(texts: list[str]) -> list[SceneSource]:
    """Scenes of command-line arguments; `builtin:*` and other patterns name several, a folder all its .blend files.

    Raises
    ------
    ValueError
        Naming what does not exist.
    """
    found: list[SceneSource] = []
    for text in texts:
        if text.startswith(BUILTIN):
            from benchmarks.scenes import SCENES

            names = [name for name in SCENES if fnmatchcase(name, text.removeprefix(BUILTIN))]
            if not names:
                raise ValueError(f"no scene {text}; there are: {', '.join(sorted(SCENES))}")
            found.extend(SceneSource(BUILTIN + name) for name in names)
        elif Path(text).is_dir():
            found.extend(SceneSource(str(path)) for path in sorted(Path(text).glob("*.blend")))
        elif Path(text).is_file():
            found.append(SceneSource(text))
        else:
            raise ValueError(f"no file {text}: give a .blend file, a folder of them, or {BUILTIN}NAME")
    return list(dict.fromkeys(found))


def scaled_size(width: int, height: int, pixel_count: int) -> tuple[int, int]:
    """Size of about `pixel_count` pixels at the aspect of width x height."""
    factor = math.sqrt(pixel_count / (width * height))
    return max(round(width * factor), 1), max(round(height * factor), 1)


def open_scene(source: SceneSource, pixels: int = 0, size: tuple[int, int] | None = None) -> Any:
    """Open a scene in this process and set its size.

    Parameters
    ----------
    pixels : int
        Scale to about so many pixels; 0 leaves the scene's own resolution.
    size : (width, height), optional
        Exactly this size, whatever `pixels` says.

    Returns
    -------
    bpy.types.Scene
    """
    import bpy

    if source.is_builtin:
        from benchmarks.scenes import build

        build(source.name)
    else:
        bpy.ops.wm.open_mainfile(filepath=str(Path(source.text).resolve()), load_ui=False)
    scene = bpy.context.scene
    render = scene.render
    width = max(round(render.resolution_x * render.resolution_percentage / 100), 1)
    height = max(round(render.resolution_y * render.resolution_percentage / 100), 1)
    if size is None:
        size = scaled_size(width, height, pixels) if pixels else (width, height)
    render.resolution_x, render.resolution_y = size
    render.resolution_percentage = 100
    return scene


def hide_lamps(scene: Any) -> None:
    """Hide lights and emitting meshes of the open scene from the camera, and from it alone.

    The edges of small bright lamps carry most of the noise of an image's mean, and say nothing about the transport.
    """
    for item in scene.objects:
        if item.type == "LIGHT" or any(emits(slot.material) for slot in item.material_slots):
            item.visible_camera = False


#: What Blender's defaults make of Cycles' settings that scenes for measuring switch off. Noise threshold and denoising
#: are the budget's and the rival's.
BLENDER_DEFAULTS = ("sample_clamp_direct", "sample_clamp_indirect", "blur_glossy", "light_sampling_threshold")


def restore_defaults(scene: Any) -> None:
    """Give the open scene Blender's default clamps, Filter Glossy and Light Threshold."""
    for name in BLENDER_DEFAULTS:
        scene.cycles.property_unset(name)


def emits(material: Any) -> bool:
    """Whether a material's tree has an Emission node, or a Principled BSDF whose emission is linked or not black."""
    if material is None or material.node_tree is None:
        return False
    for node in material.node_tree.nodes:
        if node.type == "EMISSION":
            return True
        if node.type == "BSDF_PRINCIPLED":
            strength, colour = node.inputs["Emission Strength"], node.inputs["Emission Color"]
            if strength.is_linked or (strength.default_value > 0.0 and max(colour.default_value[:3]) > 0.0):
                return True
    return False
