# SPDX-License-Identifier: GPL-3.0-or-later
"""Hair of particle systems, key by key as Blender draws it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array

from .colorspaces import from_srgb
from .context import ExportContext
from .materials import AttributeRequest

#: Strands between two questions whether to stop.
_CANCEL_INTERVAL = 1024


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
    is_final = context.depsgraph.mode == "RENDER"
    inverse = np.array(owner.matrix_world.inverted_safe(), np.float64)
    positions, radii, counts, slots, ranges = [], [], [], [], []
    for modifier, system in hair_systems(owner, is_final=is_final):
        settings = system.settings
        first, end = _strand_range(system, is_final=is_final)
        if end <= first:
            continue
        keys = _read_keys(context, owner, system, first, end, _key_count(settings, is_final=is_final))
        local = keys @ inverse[:3, :3].T + inverse[:3, 3]
        positions.append(local.reshape(-1, 3).astype(np.float32))
        radii.append(_radii(settings, local).reshape(-1).astype(np.float32))
        counts.append(np.full(end - first, keys.shape[1], np.int64))
        slots.append(np.full(end - first, max(settings.material - 1, 0), np.int32))
        ranges.append((modifier, system, first, end))
    if not positions:
        return None
    mesh = owner.data
    last_slot = max(len(owner.material_slots) - 1, 0)
    found = HairKeys(
        positions=np.concatenate(positions),
        radii=np.concatenate(radii),
        offsets=np.concatenate([[0], np.cumsum(np.concatenate(counts))]),
        material=np.minimum(np.concatenate(slots), last_slot),
        texture_space=np.array([mesh.texspace_location, mesh.texspace_size], np.float32),
    )
    _add_uv_maps(context, mesh, ranges, found)
    _add_colors(context, mesh, ranges, request, found)
    return found


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


def _read_keys(
    context: ExportContext, owner: bpy.types.Object, system: Any, first: int, end: int, key_count: int
) -> npt.NDArray[np.float64]:
    """Keys of strands in the world, float64 (S, K, 3)."""
    keys = np.empty((end - first, key_count, 3), np.float32)
    read = system.co_hair
    for row, number in enumerate(range(first, end)):
        if row % _CANCEL_INTERVAL == 0:
            context.check_cancel()
        keys[row] = [read(object=owner, particle_no=number, step=step) for step in range(key_count)]
    return _end_short_strands(keys).astype(np.float64)


def _end_short_strands(keys: Float32Array) -> Float32Array:
    """Keys that a strand shorter than others does not have, of which Blender says zeros, are where it ends."""
    steps = np.arange(keys.shape[1])
    last = np.max(np.where((keys != 0.0).any(axis=2), steps, 0), axis=1)
    ended: Float32Array = np.take_along_axis(keys, np.minimum(steps, last[:, None])[:, :, None], axis=1)
    return ended


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


def _particles(system: Any, first: int, end: int) -> list[Any]:
    """Which particle Blender is told for each strand: its own, or the first for children."""
    particles = system.particles
    return [particles[min(number, len(particles) - 1) if first == 0 else 0] for number in range(first, end)]


def _add_uv_maps(context: ExportContext, mesh: bpy.types.Mesh, ranges: list[Any], found: HairKeys) -> None:
    for number, layer in enumerate(mesh.uv_layers):
        parts = []
        for modifier, system, first, end in ranges:
            context.check_cancel()
            read, particles = system.uv_on_emitter, _particles(system, first, end)
            parts += [
                read(modifier, particle=particle, particle_no=strand, uv_no=number)[:]
                for particle, strand in zip(particles, range(first, end), strict=True)
            ]
        found.of_curves[layer.name] = np.array(parts, np.float32).reshape(-1, 2)
        if layer.active_render:
            found.default_uv = layer.name


def _add_colors(
    context: ExportContext, mesh: bpy.types.Mesh, ranges: list[Any], request: AttributeRequest, found: HairKeys
) -> None:
    """Colours of roots: of corners, in bytes, as Cycles reads no others."""
    names = [item.name for item in mesh.color_attributes if (item.domain, item.data_type) == ("CORNER", "BYTE_COLOR")]
    for number, name in enumerate(names):
        if name not in request.names:
            continue
        parts = []
        for modifier, system, first, end in ranges:
            context.check_cancel()
            read, particles = system.mcol_on_emitter, _particles(system, first, end)
            parts += [
                read(modifier, particle=particle, particle_no=strand, vcol_no=number)[:]
                for particle, strand in zip(particles, range(first, end), strict=True)
            ]
        colors = np.ones((len(parts), 4), np.float32)
        colors[:, :3] = from_srgb(np.array(parts, np.float32).reshape(-1, 3))
        found.of_curves[name] = colors
