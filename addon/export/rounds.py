# SPDX-License-Identifier: GPL-3.0-or-later
"""Hair, curves and point clouds: strands of keys with radii, and spheres."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.scene.attribute_names import UNDEFORMED
from engine.scene.description import Attribute, Mesh
from engine.scene.limits import check_memory_of_strands
from engine.scene.rounds import RIBBONS, ROUND, ROUND_LINEAR, SPHERES, Rounds

from .attributes import read_values
from .context import ExportContext
from .geometry import export_kept
from .hashes import hash_to_unit
from .materials import AttributeRequest
from .particle_hair import ParticleHair, read_hair

#: Cycles' shapes of curves.
_SHAPES = {"RIBBONS": RIBBONS, "THICK": ROUND, "THICK_LINEAR": ROUND_LINEAR}
#: What Cycles takes where there are no radii [m].
_CURVE_RADIUS, _POINT_RADIUS = 0.005, 0.01
_POLY = 1
#: A texture space in which Generated coordinates are those of the object.
_OBJECT_SPACE = np.full((2, 3), 0.5, np.float32)


@dataclass
class Strands:
    """Curves as they were read: keys in a row, and where each curve begins.

    Attributes
    ----------
    positions : float32 (K, 3), radii : float32 (K,)
    offsets : int64 (C + 1,)
    material : int32 (C,), slots
    of_keys, of_curves : dict of float32 (K | C, width), by the attributes' names
    """

    positions: Float32Array
    radii: Float32Array
    offsets: npt.NDArray[np.int64]
    material: Int32Array
    of_keys: dict[str, Float32Array] = field(default_factory=dict)
    of_curves: dict[str, Float32Array] = field(default_factory=dict)
    default_uv: str = ""


def export_rounds(
    context: ExportContext, source: Any, owner: bpy.types.Object, request: AttributeRequest
) -> Mesh | None:
    """Curves, points or the hair of an object; None where there are none.

    Parameters
    ----------
    source : Curves, PointCloud or ParticleHair
        Evaluated.
    owner : Object
        Whose evaluation made it.
    """
    if isinstance(source, ParticleHair):
        read_it = partial(_read_hair, context, source, request)
        return export_kept(context, owner, f"{source.name} (hair)", request, read_it)
    read = _read_points if isinstance(source, bpy.types.PointCloud) else _read_curves
    return export_kept(context, owner, source.name_full, request, partial(read, context, source, request))


def read_shape(source: Any) -> tuple[Float32Array, Float32Array]:
    """Places, float32 (K, 3), and radii, float32 (K,), of an evaluated Curves or PointCloud as it is now."""
    count = len(source.points)
    if isinstance(source, bpy.types.PointCloud):
        return _read_vectors(source.attributes["position"].data, count), _read_radii(source, count, _POINT_RADIUS)
    return _read_vectors(source.position_data, count), _read_radii(source, count, _CURVE_RADIUS)


def read_offsets(curves: Any) -> npt.NDArray[np.int64]:
    """Where the keys of each curve of an evaluated Curves begin, and where the last one's end, int64 (C + 1,)."""
    offsets = np.empty(len(curves.curves) + 1, np.int32)
    curves.curve_offset_data.foreach_get("value", offsets)
    return offsets.astype(np.int64)


def as_many_keys(
    values: Float32Array, offsets: npt.NDArray[np.int64], wanted: npt.NDArray[np.int64]
) -> Float32Array:
    """What keys of curves have, float32 (K, ...), at as many keys as other curves have, evenly spread, as Cycles does.

    Parameters
    ----------
    offsets, wanted : int64 (C + 1,)
        Of the curves, and of others that are as many.
    """
    counts, wanted_counts = np.diff(offsets), np.diff(wanted)
    curve = np.repeat(np.arange(len(counts)), wanted_counts)
    number = np.arange(wanted[-1]) - wanted[curve]
    at = number / np.maximum(wanted_counts[curve] - 1, 1) * np.maximum(counts[curve] - 1, 0)
    before = at.astype(np.int64)
    behind = np.minimum(before + 1, np.maximum(counts[curve] - 1, 0))
    share = (at - before).reshape(-1, *[1] * (values.ndim - 1))
    first = offsets[curve]
    mixed = (1.0 - share) * values[first + before] + share * values[first + behind]
    result: Float32Array = mixed.astype(np.float32)
    return result


def _read_curves(context: ExportContext, curves: Any, request: AttributeRequest) -> Mesh | None:
    curve_count = len(curves.curves)
    if not curve_count:
        return None
    check_memory_of_strands(len(curves.points), curve_count, curves.name)
    strands = Strands(
        *read_shape(curves),
        read_offsets(curves),
        np.zeros(curve_count, np.int32),
    )
    for attribute in curves.attributes:
        is_uv = attribute.data_type == "FLOAT2" and attribute.domain == "CURVE"
        if attribute.name not in request.names and not is_uv:
            continue
        values = read_values(attribute)
        if values is None:
            continue
        if is_uv and not strands.default_uv:
            strands.default_uv = attribute.name
        (strands.of_curves if attribute.domain == "CURVE" else strands.of_keys)[attribute.name] = values
    if "curve_normal" in request.names:
        # In the object's space, which Cycles takes for the world's.
        # One by one: `foreach_get` reads them after Blender has freed them.
        strands.of_keys["curve_normal"] = np.array([normal.vector[:] for normal in curves.normals], np.float32)
    types = curves.attributes.get("curve_type")
    is_poly = types is not None and len(types.data) > 0 and types.data[0].value == _POLY
    mesh = _mesh_of(context, curves.name, strands, request, ROUND_LINEAR if is_poly else None)
    if mesh is not None:
        mesh.texture_space = _OBJECT_SPACE
    return mesh


def _read_hair(context: ExportContext, hair: ParticleHair, request: AttributeRequest) -> Mesh | None:
    found = read_hair(context, hair, request)
    if found is None:
        return None
    strands = Strands(
        found.positions, found.radii, found.offsets, found.material, {}, found.of_curves, found.default_uv
    )
    mesh = _mesh_of(context, hair.name, strands, request, None)
    if mesh is not None:
        mesh.texture_space = found.texture_space
        if request.generated:
            roots = strands.positions[strands.offsets[:-1]]
            mesh.attributes[UNDEFORMED] = Attribute("FACE", roots[_curve_of_rows(strands)])
    return mesh


def _curve_of_rows(strands: Strands) -> Int32Array:
    """The curve that each segment belongs to."""
    counts = np.maximum(np.diff(strands.offsets) - 1, 0)
    return np.repeat(np.arange(len(counts), dtype=np.int32), counts)


def _rows_of(strands: Strands, curve_of_rows: Int32Array) -> npt.NDArray[np.uint32]:
    """Segments as rows of `Mesh.triangles`."""
    roots = strands.offsets[:-1]
    before = np.cumsum(np.maximum(np.diff(strands.offsets) - 1, 0))
    # Keys of the curves before outnumber their segments.
    ahead = roots - np.concatenate([[0], before[:-1]])
    rows = np.empty((len(curve_of_rows), 3), np.uint32)
    rows[:, 0] = np.arange(len(rows), dtype=np.uint32)
    rows[:, 0] += ahead.astype(np.uint32)[curve_of_rows]
    rows[:, 1] = rows[:, 0]
    rows[:, 1] += np.uint32(1)
    rows[:, 2] = roots.astype(np.uint32)[curve_of_rows]
    return rows


def _mesh_of(
    context: ExportContext, name: str, strands: Strands, request: AttributeRequest, shape: str | None
) -> Mesh | None:
    """Curves of one key are none, as in Cycles."""
    of_rows = _curve_of_rows(strands)
    if not len(of_rows):
        return None
    rows = _rows_of(strands, of_rows)
    settings = getattr(context.scene, "cycles_curves", None)
    if shape is None:
        shape = _SHAPES[getattr(settings, "shape", "RIBBONS")]
    mesh = Mesh(
        key=None,
        name=name,
        vertices=strands.positions,
        triangles=rows,
        corner_normals=None,
        material_slots=strands.material[of_rows],
        default_uv=strands.default_uv,
        rounds=Rounds(shape, strands.radii, int(getattr(settings, "subdivisions", 2))),
    )
    _add_standard(strands, request)
    for attribute, values in strands.of_keys.items():
        mesh.attributes[attribute] = Attribute("POINT", values)
    for attribute, values in strands.of_curves.items():
        mesh.attributes[attribute] = Attribute("FACE", np.ascontiguousarray(values[of_rows]))
    return mesh


def _add_standard(strands: Strands, request: AttributeRequest) -> None:
    """What Cycles makes itself: how far along its curve a key is, the curves' lengths, and random numbers."""
    count = len(strands.offsets) - 1
    if "curve_random" in request.names:
        strands.of_curves["curve_random"] = hash_to_unit(np.arange(count))[:, None]
    if not request.names & {"curve_intercept", "curve_length"}:
        return
    steps = np.zeros(len(strands.positions))
    steps[1:] = np.linalg.norm(np.diff(strands.positions.astype(np.float64), axis=0), axis=1)
    counts = np.diff(strands.offsets)
    begins = strands.offsets[:-1][counts > 0]
    steps[begins] = 0.0
    so_far = np.cumsum(np.nan_to_num(steps, posinf=0.0))
    along = so_far - np.repeat(so_far[begins], counts[counts > 0])
    lengths = np.zeros(count)
    lengths[counts > 0] = along[strands.offsets[1:][counts > 0] - 1]
    of_keys = np.repeat(lengths, counts)
    intercept = np.divide(along, of_keys, out=np.zeros_like(along), where=of_keys > 0.0)
    strands.of_keys["curve_intercept"] = intercept.astype(np.float32)[:, None]
    strands.of_curves["curve_length"] = lengths.astype(np.float32)[:, None]


def _read_points(context: ExportContext, cloud: Any, request: AttributeRequest) -> Mesh | None:
    count = len(cloud.points)
    if not count:
        return None
    numbers = np.arange(count, dtype=np.uint32)
    places, radii = read_shape(cloud)
    mesh = Mesh(
        key=None,
        name=cloud.name,
        vertices=places,
        triangles=np.repeat(numbers[:, None], 3, axis=1),
        corner_normals=None,
        material_slots=np.zeros(count, np.int32),
        texture_space=_OBJECT_SPACE,
        rounds=Rounds(SPHERES, radii),
    )
    for attribute in cloud.attributes:
        values = read_values(attribute) if attribute.name in request.names else None
        if values is not None:
            mesh.attributes[attribute.name] = Attribute("POINT", values)
    if "point_random" in request.names:
        mesh.attributes["point_random"] = Attribute("POINT", hash_to_unit(np.arange(count))[:, None])
    return mesh


def _read_vectors(data: Any, count: int) -> Float32Array:
    flat = np.empty(count * 3, np.float32)
    data.foreach_get("vector", flat)
    return flat.reshape(-1, 3)


def _read_radii(source: Any, count: int, otherwise: float) -> Float32Array:
    stored = source.attributes.get("radius")
    if stored is None or (stored.domain, stored.data_type) != ("POINT", "FLOAT"):
        return np.full(count, otherwise, np.float32)
    radii = np.empty(count, np.float32)
    stored.data.foreach_get("value", radii)
    return radii
