# SPDX-License-Identifier: GPL-3.0-or-later
"""Hair of particle systems, key by key as Blender draws it."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.scene.limits import check_memory_of_strands

from .colorspaces import from_srgb
from .context import ExportContext
from .materials import AttributeRequest
from .path_cache import read_paths

#: Strands between two questions whether to stop.
_CANCEL_INTERVAL = 1 << 13


@dataclass(frozen=True)
class ParticleHair:
    """The hair of an evaluated object that has some."""

    owner: bpy.types.Object

    @property
    def name(self) -> str:
        """The object's."""
        return self.owner.name


@dataclass
class HairKeys:
    """Strands of all systems; see `rounds.Strands`. `texture_space` is that of the mesh they grow on."""

    positions: Float32Array
    radii: Float32Array
    offsets: npt.NDArray[np.int64]
    material: Int32Array
    texture_space: Float32Array
    of_curves: dict[str, Float32Array] = field(default_factory=dict)
    default_uv: str = ""


@dataclass(frozen=True)
class _Drawn:
    """Strands of one system that are drawn: their numbers, and how many keys each has."""

    modifier: Any
    system: Any
    numbers: range
    key_count: int


def hair_systems(owner: bpy.types.Object, *, is_final: bool) -> list[tuple[Any, Any]]:
    """Modifiers and systems of an object whose particles are drawn as hair."""
    found = []
    for modifier in owner.modifiers:
        if modifier.type != "PARTICLE_SYSTEM" or not (modifier.show_render if is_final else modifier.show_viewport):
            continue
        settings = modifier.particle_system.settings
        if settings.type == "HAIR" and settings.render_type == "PATH":
            found.append((modifier, modifier.particle_system))
    return found


def read_hair(context: ExportContext, hair: ParticleHair, request: AttributeRequest) -> HairKeys | None:
    """Strands of an object's hair, in its own space; None where it has none."""
    owner = hair.owner
    drawn = _drawn_systems(context, owner)
    if not drawn:
        return None
    keys = sum(len(one.numbers) * one.key_count for one in drawn)
    check_memory_of_strands(keys, sum(len(one.numbers) for one in drawn), owner.name)
    shapes = _read_shape(context, drawn, owner)
    counts = np.concatenate([np.full(len(one.numbers), one.key_count, np.int64) for one in drawn])
    last_slot = max(len(owner.material_slots) - 1, 0)
    slots = [min(max(one.system.settings.material - 1, 0), last_slot) for one in drawn]
    mesh = owner.data
    found = HairKeys(
        *shapes,
        offsets=np.concatenate([[0], np.cumsum(counts)]),
        material=np.repeat(np.array(slots, np.int32), [len(one.numbers) for one in drawn]),
        texture_space=np.array([mesh.texspace_location, mesh.texspace_size], np.float32),
    )
    _add_uv_maps(context, mesh, drawn, found)
    _add_colors(context, mesh, drawn, request, found)
    return found


def read_hair_shape(context: ExportContext, owner: bpy.types.Object) -> tuple[Float32Array, Float32Array]:
    """Places, float32 (K, 3), and radii, float32 (K,), of all keys of an evaluated object's hair."""
    return _read_shape(context, _drawn_systems(context, owner), owner)


def _drawn_systems(context: ExportContext, owner: bpy.types.Object) -> list[_Drawn]:
    is_final = context.depsgraph.mode == "RENDER"
    drawn = []
    for modifier, system in hair_systems(owner, is_final=is_final):
        first, end = _strand_range(system, is_final=is_final)
        if end > first:
            drawn.append(_Drawn(modifier, system, range(first, end), _key_count(system.settings, is_final=is_final)))
    return drawn


def _read_shape(
    context: ExportContext, drawn: list[_Drawn], owner: bpy.types.Object
) -> tuple[Float32Array, Float32Array]:
    """As `read_hair_shape`, of these systems."""
    total = sum(len(one.numbers) * one.key_count for one in drawn)
    positions, radii = np.empty((total, 3), np.float32), np.empty(total, np.float32)
    inverse = np.array(owner.matrix_world.inverted_safe(), np.float64)
    begin = 0
    for one in drawn:
        # A few at a time: that Blender's keys are in the world, and lengths are summed, takes memory.
        for row in range(0, len(one.numbers), _CANCEL_INTERVAL):
            context.check_cancel()
            keys = _read_keys(owner, one, one.numbers[row : row + _CANCEL_INTERVAL])
            local = keys @ inverse[:3, :3].T + inverse[:3, 3]
            end = begin + local.shape[0] * local.shape[1]
            positions[begin:end] = local.reshape(-1, 3)
            radii[begin:end] = _radii(one.system.settings, local).reshape(-1)
            begin = end
    return positions, radii


def _strand_range(system: Any, *, is_final: bool) -> tuple[int, int]:
    """Numbers of the strands that are drawn: parents, or where there are any their children."""
    parents, children = len(system.particles), len(system.child_particles)
    if not is_final:
        children = int(children * system.settings.display_percentage / 100.0)
    has_children = system.settings.child_type != "NONE" and children > 0
    return (parents if has_children else 0), parents + children


def _key_count(settings: Any, *, is_final: bool) -> int:
    count = (1 << (settings.render_step if is_final else settings.display_step)) + 1
    return int(count + settings.kink_extra_steps) if settings.kink == "SPIRAL" else count


def _read_keys(owner: bpy.types.Object, drawn: _Drawn, numbers: range) -> Float32Array:
    """Keys of strands in the world, float32 (S, K, 3)."""
    together = read_paths(owner, drawn.system, numbers, drawn.key_count)
    if together is not None:
        return together
    read = drawn.system.co_hair
    keys = (read(object=owner, particle_no=number, step=step) for number in numbers for step in range(drawn.key_count))
    shape = (len(numbers), drawn.key_count, 3)
    return _end_short_strands(_joined(keys, shape[0] * shape[1], 3).reshape(shape))


def _end_short_strands(keys: Float32Array) -> Float32Array:
    """Keys that a strand shorter than others does not have, of which Blender says zeros, are where it ends."""
    steps = np.arange(keys.shape[1])
    last = np.max(np.where((keys != 0.0).any(axis=2), steps, 0), axis=1)
    ended: Float32Array = np.take_along_axis(keys, np.minimum(steps, last[:, None])[:, :, None], axis=1)
    return ended


def _joined(vectors: Iterable[Iterable[float]], count: int, width: int) -> Float32Array:
    """Vectors as float32 (N, width): number by number, as numpy takes long to find out that a vector is one."""
    return np.fromiter(itertools.chain.from_iterable(vectors), np.float32, count * width).reshape(count, width)


def _radii(settings: Any, keys: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Radii of keys, float64 (S, K), by how far along their strand they are."""
    steps = np.linalg.norm(np.diff(keys, axis=1), axis=2)
    along = np.concatenate([np.zeros((len(keys), 1)), np.cumsum(steps, axis=1)], axis=1)
    length = along[:, -1:]
    rest = 1.0 - np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
    shape = settings.shape
    if shape < 0.0:
        rest = np.maximum(rest, 0.0) ** (1.0 + shape)
    elif shape > 0.0:
        with np.errstate(divide="ignore"):
            rest = np.maximum(rest, 0.0) ** (1.0 / np.float64(1.0 - shape))
    scale = 0.5 * settings.radius_scale
    radii = scale * (rest * (settings.root_radius - settings.tip_radius) + settings.tip_radius)
    if settings.use_close_tip:
        radii[:, -1] = 0.0
    return radii


def _particles(drawn: _Drawn) -> Iterator[Any]:
    """Which particle Blender is told for each strand: its own, or the first for children."""
    particles = drawn.system.particles
    if drawn.numbers.start:
        return itertools.repeat(particles[0], len(drawn.numbers))
    last = len(particles) - 1
    return (particles[min(number, last)] for number in drawn.numbers)


def _add_uv_maps(context: ExportContext, mesh: bpy.types.Mesh, drawn: list[_Drawn], found: HairKeys) -> None:
    for number, layer in enumerate(mesh.uv_layers):
        parts = []
        for one in drawn:
            context.check_cancel()
            read, modifier = one.system.uv_on_emitter, one.modifier
            maps = (
                read(modifier, particle=particle, particle_no=strand, uv_no=number)
                for particle, strand in zip(_particles(one), one.numbers, strict=True)
            )
            parts.append(_joined(maps, len(one.numbers), 2))
        found.of_curves[layer.name] = np.concatenate(parts)
        if layer.active_render:
            found.default_uv = layer.name


def _add_colors(
    context: ExportContext, mesh: bpy.types.Mesh, drawn: list[_Drawn], request: AttributeRequest, found: HairKeys
) -> None:
    """Colours of roots: of corners, in bytes, as Cycles reads no others."""
    names = [item.name for item in mesh.color_attributes if (item.domain, item.data_type) == ("CORNER", "BYTE_COLOR")]
    for number, name in enumerate(names):
        if name not in request.names:
            continue
        parts = []
        for one in drawn:
            context.check_cancel()
            read, modifier = one.system.mcol_on_emitter, one.modifier
            stored = (
                read(modifier, particle=particle, particle_no=strand, vcol_no=number)
                for particle, strand in zip(_particles(one), one.numbers, strict=True)
            )
            parts.append(_joined(stored, len(one.numbers), 3))
        colors = np.ones((sum(len(part) for part in parts), 4), np.float32)
        colors[:, :3] = from_srgb(np.concatenate(parts))
        found.of_curves[name] = colors
