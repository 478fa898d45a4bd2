# SPDX-License-Identifier: GPL-3.0-or-later
"""What every part of the export shares: notices, cancellation, and what is kept between frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import bpy

from engine.scene.description import Image, Material, Mesh, Notice
from engine.scene.dicing import Dicing

from .dicing_view import DicingView


class ExportCancelled(Exception):
    """Raised out of `export_scene` once `should_cancel()` is true."""


@dataclass
class CachedMesh:
    """The last content exported from one Blender datablock."""

    mesh: Mesh
    #: What the extraction depended on besides the datablock (names of attributes, tangents).
    request: Hashable
    #: Number of the last export that used it.
    last_used: int = 0


@dataclass
class CachedImage:
    """The last pixels read of an image, and the state of the datablock and file they were read from."""

    image: Image
    state: Hashable
    last_used: int = 0


@dataclass
class CachedMaterial:
    """The last content exported from a material, and all that it was read from."""

    material: Material
    #: Attributes of meshes that it asks for.
    request: Hashable
    #: Original datablocks that were read; None: more than datablocks, so that it must be read again.
    reads: frozenset[int] | None
    #: Images in the order they were met, by what identifies them, with their indices.
    images: tuple[tuple[Hashable, int], ...]
    #: What was noticed on the way.
    notices: tuple[Notice, ...]
    #: What it depended on besides.
    state: Hashable


#: Exports after which what was not used again is forgotten (view layers take turns).
_KEPT_EXPORTS = 8


@dataclass
class ExportCache:
    """Keeps what did not change between exports of one file, so that it is neither read nor rebuilt again.

    An object of the description is reused only if its content was found equal, or if Blender says (persistent data,
    same dependency graph) that its datablock was not touched.
    """

    meshes: dict[Hashable, CachedMesh] = field(default_factory=dict)
    materials: dict[Hashable, CachedMaterial] = field(default_factory=dict)
    images: dict[Hashable, CachedImage] = field(default_factory=dict)
    #: How meshes of windows are diced, and by what settings, by the address of the original object.
    dicings: dict[int, tuple[Hashable, Dicing]] = field(default_factory=dict)
    #: Address of the dependency graph of the last export, 0 = none.
    depsgraph: int = 0
    #: Number of the last mesh or image whose content was new.
    next_version: int = 0
    #: Number of exports begun.
    export_count: int = 0

    def begin(self) -> None:
        """Start an export: until `finish`, nothing Blender says about changes since the last one holds."""
        self.export_count += 1
        self.depsgraph = 0

    def finish(self, depsgraph: int) -> None:
        """End an export of the dependency graph at an address, and forget what has not been used for a while."""
        self.depsgraph = depsgraph
        oldest = self.export_count - _KEPT_EXPORTS
        self.meshes = {key: kept for key, kept in self.meshes.items() if kept.last_used > oldest}
        self.images = {key: kept for key, kept in self.images.items() if kept.last_used > oldest}

    def new_version(self) -> int:
        """A number no earlier object of this cache has."""
        self.next_version += 1
        return self.next_version


@dataclass(frozen=True)
class StudioLight:
    """What lights a window instead of the scene's world.

    path : str, of its image; '' = none
    rotation : float, about z [rad]
    strength : float
    opacity : float in [0, 1], how much of it the camera sees, over the world's plain colour
    """

    path: str
    rotation: float
    strength: float
    opacity: float


@dataclass(frozen=True)
class Window:
    """A window that the scene is exported for, instead of a render.

    is_shown : callable, whether the window shows an object
    use_lights : bool, whether it is lit by the scene's lamps
    studio : StudioLight or None, what it is lit by instead of the scene's world
    dicing_view : DicingView or None, by what it dices meshes, unless the scene has a camera for that
    culling_view : DicingView or None, by what it leaves out objects that are to be culled
    """

    is_shown: Callable[[bpy.types.Object], bool]
    use_lights: bool = True
    studio: StudioLight | None = None
    dicing_view: DicingView | None = None
    culling_view: DicingView | None = None


@dataclass
class ExportContext:
    """One export: where from, for whom, and what was found on the way."""

    depsgraph: bpy.types.Depsgraph
    scene: bpy.types.Scene
    view_layer: bpy.types.ViewLayer
    engine: bpy.types.RenderEngine | None
    cache: ExportCache
    should_cancel: Callable[[], bool] | None = None
    #: Memory for pixels of images, before they lie in files [bytes]; None = all.
    texture_memory: int | None = None
    #: Original datablocks changed since the last export of the same depsgraph; None = unknown, compare content.
    updated: frozenset[int] | None = None
    working_space: str = "Rec.709"
    #: Whether the shutter is open for a while.
    is_blurred: bool = False
    #: What passes ask for: motion vectors, names of assets, AOVs by name (whether they are colours).
    wants_vectors: bool = False
    wants_assets: bool = False
    aovs: dict[str, bool] = field(default_factory=dict)
    #: None for renders.
    window: Window | None = None
    #: Whether places on a mesh are looked at, not what the camera sees.
    bakes: bool = False
    #: How many meshes of one name an object has made so far (geometry nodes may make many).
    mesh_counts: dict[Hashable, int] = field(default_factory=dict)
    #: Levels that `subdivision` has found for meshes that Cycles would dice, by the address of the original object.
    subdivision_levels: dict[int, int] = field(default_factory=dict)
    #: How meshes are divided further for their displacement, by the same.
    diced: dict[int, Dicing] = field(default_factory=dict)
    #: What objects are to do with caustics, by the names of Cycles' switches (`caustics.py`).
    caustics_roles: set[str] = field(default_factory=set)
    _notices: dict[Notice, None] = field(default_factory=dict)

    def notice(self, subject: str, problem: str, fallback: str) -> None:
        """Record once that something is not exported as it is."""
        self._notices[Notice(subject, problem, fallback)] = None

    def finite(self, value: float, instead: float, subject: str, what: str) -> float:
        """`value`, or where it is NaN or infinite what stands in for it, and a notice."""
        if math.isfinite(value):
            return float(value)
        self.notice(subject, f"{what} is NaN or infinite: check its keyframes and drivers", f"{instead:g} is used")
        return instead

    def notice_again(self, notices: Iterable[Notice]) -> None:
        """Record what an earlier export has noticed of something that is as it was."""
        self._notices.update(dict.fromkeys(notices))

    @cached_property
    def light_groups(self) -> tuple[str, ...]:
        """Names of the view layer's light groups."""
        return tuple(group.name for group in getattr(self.view_layer, "lightgroups", ()))

    def light_group(self, owner: bpy.types.Object | bpy.types.World) -> int:
        """Which of them an object's or the world's light belongs to, -1 = none."""
        name = getattr(owner, "lightgroup", "")
        return self.light_groups.index(name) if name in self.light_groups else -1

    @property
    def needs_camera(self) -> bool:
        """Whether there must be a camera: windows have one of their own, and a bake may do without."""
        return self.window is None and not (self.bakes and self.scene.camera is None)

    @property
    def notices(self) -> list[Notice]:
        """What was recorded, in the order it was met."""
        return list(self._notices)

    def check_cancel(self) -> None:
        """Leave the export if the user asked to stop.

        Raises
        ------
        ExportCancelled
        """
        if self.should_cancel is not None and self.should_cancel():
            raise ExportCancelled

    def is_untouched(self, original: bpy.types.ID) -> bool:
        """True only where Blender vouches that `original` has not changed since the last export."""
        return self.are_untouched((original.as_pointer(),))

    def are_untouched(self, originals: Iterable[int]) -> bool:
        """The same of many, by their addresses."""
        return self.updated is not None and self.updated.isdisjoint(originals)


def cycles_property(owner: Any, name: str, default: Any, group: str = "cycles") -> Any:
    """A property of Cycles' own settings on a datablock, or `default` where its add-on is off or older."""
    return getattr(getattr(owner, group, None), name, default)
