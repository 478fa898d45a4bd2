# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounds of media that vary in space, found by looking their programs up at many points of what they fill."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence

import numpy as np

from engine.array_types import Float32Array
from engine.builder.medium_lookup import Filled, MediumLookup, Ray, has_splines, rays_of
from engine.kernels.bsdf import BsdfTables
from engine.kernels.shader import ops_input
from engine.kernels.shader.opcodes import CLOSURE_FIRST
from engine.runtime.jit import kernel
from engine.scene.description import Mesh
from engine.scene.grids import TILE, Grid, unpack_values
from engine.shaders.compiled_program import CompiledProgram
from engine.state import geometry as geometry_layout
from engine.state.geometry import GeometryArrays
from engine.state.media import WORLD
from engine.state.shaders import ShaderArrays
from engine.state.tracking import (
    GRID_WIDTH,
    SPACE_WIDTH,
    WORLD_REACH,
    WORLD_SIZE,
    WORLD_UNIT,
    MajorantGrids,
    no_majorants,
)

#: Cells along the longest edge of what a medium fills.
_RESOLUTION = 32
#: And of the world's grid, whose cells grow with the distance.
_WORLD_RESOLUTION = 40
#: Points that are looked up in a cell, and how far beyond it they lie, in cells.
_POINTS = 8
_PADDING = 0.25
#: How much is added to the largest extinction that was found in a cell: this share of how much it varies there.
_SPREAD = 0.5
#: Where there are voxels, of which those of most and least have been looked up.
_SPREAD_OF_GRIDS = 0.1
#: A cell's bound is at least this share of those around it, so that what was overlooked is met sooner or later.
_OF_NEIGHBOURS = 0.02
#: Where there is emission a ray looks so often on its way through all that the medium fills, at the brightest place and
#: at any other.
_LOOKS_AT_EMISSION, _FEWEST_LOOKS = 16.0, 4.0
#: Voxels that are looked up, if there are no more than the first number. Of more, those of most and least in blocks: of
#: the first of these edges, in voxels, by which they are no more than the second number, else of the last.
_MOST_VOXELS, _MOST_EXTREMES = 1 << 17, 1 << 18
_BLOCKS = 2, 4
#: Where cells are no longer than this, in voxels, their corners and how these bend tell what is between them.
_SHORT_CELL = 0.5
#: How many voxels around it one matters to, by straight lines and by cubic splines.
_REACH, _SMOOTH_REACH = 1.0, 2.0

#: Instructions that give the same wherever the object stands, and for every ray.
_LOCAL = frozenset({
    ops_input.OP_GRID, ops_input.OP_GENERATED, ops_input.OP_OBJECT_COORDINATE, ops_input.OP_ATTRIBUTE,
    ops_input.OP_TRANSFORM_POINT, ops_input.OP_MAPPING, ops_input.OP_MULTIPLY, ops_input.OP_ADD,
    ops_input.OP_MIX_WEIGHTS, ops_input.OP_DOT, ops_input.OP_SATURATE, ops_input.OP_COLOR_TO_FLOAT,
    ops_input.OP_VECTOR_TO_FLOAT, ops_input.OP_FLOAT_TO_VECTOR,
})  # fmt: skip

class KeptBounds:
    """Bounds by cell, by what they were looked up of.

    state : hashable, what programs depend on besides themselves
    """

    def __init__(self) -> None:
        self.state: Hashable = None
        self.bounds: dict[Hashable, Float32Array] = {}


def _resolution(filled: Filled) -> np.ndarray:
    """Cells along x, y and z: about cubes in the world."""
    if filled.instance == WORLD:
        return np.full(3, _WORLD_RESOLUTION)
    edges = np.linalg.norm(filled.to_world[0, :, :3], axis=0) * (filled.upper - filled.lower)
    longest = edges.max()
    if not longest > 0.0:
        return np.ones(3, np.int64)
    return np.clip(np.ceil(_RESOLUTION * edges / longest), 1, _RESOLUTION).astype(np.int64)


def _points_of(filled: Filled, cells: np.ndarray, slab: int, random: np.random.Generator) -> np.ndarray:
    """Points in all cells of a layer along z, in the space of the object: float64 (Y, X, _POINTS, 3)."""
    corner = np.stack(np.meshgrid(np.arange(cells[1]), np.arange(cells[0]), indexing="ij"), axis=-1)
    corner = np.concatenate([corner[..., ::-1], np.full((*corner.shape[:2], 1), slab)], axis=-1)
    within = random.random((cells[1], cells[0], _POINTS, 3)) * (1.0 + 2.0 * _PADDING) - _PADDING
    return _in_object(filled, np.clip((corner[:, :, None] + within) / cells, 0.0, 1.0))


def _in_object(filled: Filled, place: np.ndarray) -> np.ndarray:
    """Places from 0 to 1 along each edge of the grid, (..., 3), in the space of the object."""
    if filled.instance == WORLD:
        return WORLD_UNIT * np.sinh((2.0 * place - 1.0) * WORLD_REACH)
    return filled.lower + place * (filled.upper - filled.lower)


def _largest_around(values: np.ndarray) -> np.ndarray:
    """The largest of each cell of a grid and those that touch it."""
    for axis in range(values.ndim):
        ahead, behind = np.roll(values, 1, axis), np.roll(values, -1, axis)
        edge = [slice(None)] * values.ndim
        edge[axis] = slice(0, 1)
        ahead[tuple(edge)] = values[tuple(edge)]
        edge[axis] = slice(-1, None)
        behind[tuple(edge)] = values[tuple(edge)]
        values = np.maximum(np.maximum(ahead, behind), values)
    return values


def _extremes(grid: Grid, block: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the corners of all blocks, twice, and of their voxels of most and of least, both int64 (N, 3)."""
    places = np.argwhere(grid.tiles >= 0)
    values = unpack_values(grid).sum(axis=2)[grid.tiles[tuple(places.T)]]
    parts = TILE // block
    blocks = values.reshape(-1, parts, block, parts, block, parts, block).transpose(0, 1, 3, 5, 2, 4, 6)
    blocks = blocks.reshape(len(places), parts**3, block**3)
    corners = _within_tiles(grid.first + places * TILE, block)
    chosen = np.concatenate([blocks.argmax(axis=2).ravel(), blocks.argmin(axis=2).ravel()])
    corners = np.concatenate([corners, corners])
    return corners, corners + np.stack(np.unravel_index(chosen, (block,) * 3), axis=-1)


def _within_tiles(tiles: np.ndarray, block: int) -> np.ndarray:
    """Corners of all blocks of tiles that begin at `tiles`, (N, 3)."""
    parts = TILE // block
    of_part = np.stack(np.unravel_index(np.arange(parts**3), (parts,) * 3), axis=1) * block
    return (tiles[:, None] + of_part).reshape(-1, 3)


def _voxels_to_meet(grids: Sequence[Grid]) -> Iterator[tuple[np.ndarray, int, np.ndarray, np.ndarray]]:
    """Voxels to look up: where a grid has them (`Grid.to_index`), edge and corners of the blocks that they stand for,
    and their indices, both int64 (N, 3).
    """
    tiles: dict[bytes, list[np.ndarray]] = {}
    for grid in grids:
        tiles.setdefault(grid.to_index.tobytes(), []).append(grid.first + np.argwhere(grid.tiles >= 0) * TILE)
    # All voxels of grids that have them in the same places are looked up at once.
    together = {place: np.unique(np.concatenate(found), axis=0) for place, found in tiles.items()}
    if sum(map(len, together.values())) * TILE**3 <= _MOST_VOXELS:
        for place, found in together.items():
            corners = _within_tiles(found, 1)
            yield np.frombuffer(place, np.float32).reshape(4, 4), 1, corners, corners
        return
    tile_count = sum(len(one) for found in tiles.values() for one in found)
    block = next((one for one in _BLOCKS if 2 * tile_count * (TILE // one) ** 3 <= _MOST_EXTREMES), _BLOCKS[-1])
    for grid in grids:
        yield grid.to_index, block, *_extremes(grid, block)


@kernel(float64_literals=True)
def _raise_cells(low, high, values, cells):
    """Raise the cells (Z, Y, X) from `low` to `high`, x, y and z of each row, both included, to what was found."""
    for row in range(low.shape[0]):
        for z in range(low[row, 2], high[row, 2] + 1):
            for y in range(low[row, 1], high[row, 1] + 1):
                for x in range(low[row, 0], high[row, 0] + 1):
                    cells[z, y, x] = max(cells[z, y, x], np.float64(values[row]))


def _meet_voxels(
    filled: Filled, lookup: MediumLookup, rays: Sequence[Ray], cells: np.ndarray, largest: np.ndarray,
    bright: np.ndarray, reach: float,
) -> None:
    """Raise what was found by cell to what is at voxels: between them there is nothing larger.

    Points at random find the rest for programs that read several grids, or want the values in between.
    """
    for to_index, block, corners, voxels in _voxels_to_meet(filled.grids):
        to_object = np.linalg.inv(to_index.astype(np.float64))
        local = voxels @ to_object[:3, :3].T + to_object[:3, 3]
        world = local @ filled.to_world[0, :, :3].T + filled.to_world[0, :, 3]
        half = 0.5 * (block - 1) + reach
        middle = (corners + 0.5 * (block - 1)) @ to_object[:3, :3].T + to_object[:3, 3]
        extent = np.abs(to_object[:3, :3]) @ np.full(3, half)
        scale = cells / np.maximum(filled.upper - filled.lower, 1e-30)
        low, high = (
            np.clip(np.floor((middle + sign * extent - filled.lower) * scale), 0, cells - 1).astype(np.int64)
            for sign in (-1.0, 1.0)
        )
        for ray in rays:
            extinction, emission = lookup(
                filled, world.astype(np.float32), np.zeros(len(world), np.float32), ray, by_lines=reach > _REACH
            )
            _raise_cells(low, high, extinction, largest)
            _raise_cells(low, high, emission, bright)


def _at_times(
    filled: Filled, lookup: MediumLookup, local: np.ndarray, ray: Ray, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Extinction and emission at points in the space of the object, (..., 3), each at some time of the shutter."""
    step = random.integers(len(filled.to_world), size=local.shape[:-1])
    matrix = filled.to_world[step]
    world = np.einsum("...ij,...j->...i", matrix[..., :3], local) + matrix[..., 3]
    times = step.ravel() / max(len(filled.to_world) - 1, 1)
    extinction, emission = lookup(
        filled, world.reshape(-1, 3).astype(np.float32), times.astype(np.float32), ray
    )
    return extinction.reshape(local.shape[:-1]), emission.reshape(local.shape[:-1])


def _moved(filled: Filled, bound: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Bounds by cell of all that may have moved there, of bounds where the grids have it."""
    # What is at a point has come from there less its displacement.
    size = cells / np.maximum(filled.upper - filled.lower, 1e-30)
    first = np.clip(np.floor(-filled.displacement[1] * size), -cells, cells).astype(np.int64)
    last = np.clip(np.ceil(-filled.displacement[0] * size), -cells, cells).astype(np.int64)
    for axis in range(3):
        count, found = int(cells[axis]), bound
        along = 2 - axis
        for step in range(int(first[axis]), int(last[axis]) + 1):
            source = np.clip(np.arange(count) + step, 0, count - 1)
            found = np.maximum(found, np.take(bound, source, axis=along))
        bound = found
    return bound


def _has_short_cells(filled: Filled, cells: np.ndarray) -> bool:
    """Whether every grid's voxels are much larger than the cells of bounds."""
    size = (filled.upper - filled.lower) / cells
    return all(
        np.linalg.norm(grid.to_index[:3, :3].astype(np.float64) * size, axis=0).max() <= _SHORT_CELL
        for grid in filled.grids
    )


def _largest_of_corners(values: np.ndarray) -> np.ndarray:
    """The largest of the values at each cell's corners."""
    for axis in range(values.ndim):
        count = values.shape[axis] - 1
        values = np.maximum(values.take(range(count), axis), values.take(range(1, count + 1), axis))
    return values


def _bulge(corners: np.ndarray) -> np.ndarray:
    """How much more may be within a cell than at its corners, by how what is there bends along each axis.

    A line that bends down once between two corners leaves second differences at both, of d and e, and rises above what
    is straight between them by no more than d e / (d + e). A cubic spline rises by no more than (d + e) / 16.
    """
    total = np.zeros(np.array(corners.shape) - 1)
    for axis, count in enumerate(total.shape):
        if count < 2:
            continue
        bend = np.zeros(corners.shape)
        inner = [slice(None)] * 3
        inner[axis] = slice(1, -1)
        bend[tuple(inner)] = np.maximum(-np.diff(corners.astype(np.float64), n=2, axis=axis), 0.0)
        first, second = bend.take(range(count), axis), bend.take(range(1, count + 1), axis)
        both = first + second
        along = np.maximum(first * second / np.maximum(both, 1e-30), both / 16.0)
        for other in {0, 1, 2} - {axis}:
            size = along.shape[other] - 1
            along = np.maximum(along.take(range(size), other), along.take(range(1, size + 1), other))
        total += along
    return total


def _bound(filled: Filled, lookup: MediumLookup, rays: Sequence[Ray], *, has_splines: bool) -> Float32Array:
    """Bounds by cell, float32 (Z, Y, X)."""
    cells = _resolution(filled)
    random = np.random.default_rng(filled.instance + 2)
    shape = tuple(cells[::-1])
    largest, smallest, bright = np.zeros(shape), np.full(shape, np.inf), np.zeros(shape)
    has_short_cells = bool(filled.grids) and _has_short_cells(filled, cells)
    for ray in rays:
        for slab in range(cells[2]):
            extinction, emission = _at_times(filled, lookup, _points_of(filled, cells, slab, random), ray, random)
            largest[slab] = np.maximum(largest[slab], extinction.max(axis=-1))
            smallest[slab] = np.minimum(smallest[slab], extinction.min(axis=-1))
            bright[slab] = np.maximum(bright[slab], emission.max(axis=-1))
        # What grows steadily is largest at a corner, which cells share.
        ticks = [np.arange(count + 1) / count for count in cells]
        corners = np.stack(np.meshgrid(*ticks[::-1], indexing="ij"), axis=-1)[..., ::-1]
        extinction, emission = _at_times(filled, lookup, _in_object(filled, corners), ray, random)
        for corner in np.ndindex(2, 2, 2):
            part = tuple(slice(at, at + count) for at, count in zip(corner, shape, strict=True))
            np.maximum(largest, extinction[part], out=largest)
            np.minimum(smallest, extinction[part], out=smallest)
            np.maximum(bright, emission[part], out=bright)
        if has_short_cells:
            np.maximum(largest, _largest_of_corners(extinction) + _bulge(extinction), out=largest)
    if filled.grids and not has_short_cells:
        reach = _SMOOTH_REACH if has_splines else _REACH
        _meet_voxels(filled, lookup, rays, cells, largest, bright, reach)
    bound = largest + (_SPREAD_OF_GRIDS if filled.grids else _SPREAD) * (largest - smallest)
    # Rounding makes constants differ a little from place to place.
    bound = np.maximum(bound * (1.0 + 1e-4), _OF_NEIGHBOURS * _largest_around(bound))
    bright = _largest_around(bright)
    if bright.any():
        way = np.linalg.norm(filled.to_world[0, :, :3] @ (filled.upper - filled.lower))
        looks = np.maximum(_LOOKS_AT_EMISSION * bright / bright.max(), _FEWEST_LOOKS) / max(way, 1e-30)
        bound = np.where(bright > 0.0, np.maximum(bound, looks), bound)
    if filled.displacement.any():
        bound = _moved(filled, bound, cells)
    return bound.astype(np.float32)


def _is_local(program: CompiledProgram) -> bool:
    """Whether a medium is the same in the object's space whatever instance it is of, and for every ray."""
    return all(
        instruction.opcode in _LOCAL or instruction.opcode >= CLOSURE_FIRST
        for instruction in program.medium_instructions
    )


def _looked_up(filled: Filled, program: CompiledProgram, geometry: GeometryArrays) -> tuple[Hashable, ...]:
    """What a bound depends on besides the program: of a medium that knows no place, no more than scale and shape."""
    shape: tuple[Hashable, ...] = (
        filled.lower.tobytes(), filled.upper.tobytes(), tuple(grid.key for grid in filled.grids),
        filled.displacement.tobytes(),
    )  # fmt: skip
    if filled.instance == WORLD:
        return shape
    values = geometry.instance_values[filled.instance]
    mesh = int(geometry.instance_table[filled.instance, geometry_layout.INSTANCE_MESH])
    shape = (*shape, geometry.texture_space[mesh].tobytes(), *_whole_values(geometry, mesh, filled.instance))
    if _is_local(program):
        # How often emission is looked for goes by the size in the world.
        lengths = np.linalg.norm(filled.to_world[0, :, :3], axis=0)
        return (*shape, float(values[geometry_layout.VALUE_DENSITY]), lengths.round(6).tobytes())
    return (*shape, filled.instance, values.tobytes(), filled.to_world.tobytes())


def _whole_values(geometry: GeometryArrays, mesh: int, instance: int) -> list[bytes]:
    """Attributes that an instance has one value of; a point inside of it sees no others but voxels."""
    count = int(geometry.attribute_count[0])
    rows = geometry.attribute_table[mesh * count : (mesh + 1) * count]
    widths = rows[:, geometry_layout.ATTRIBUTE_COMPONENTS]
    starts = rows[:, geometry_layout.ATTRIBUTE_OFFSET] + instance * widths
    ends = starts + widths
    is_whole = rows[:, geometry_layout.ATTRIBUTE_DOMAIN] == geometry_layout.DOMAIN_INSTANCE
    return [
        geometry.attribute_data[start:end].tobytes() if whole else b""
        for start, end, whole in zip(starts, ends, is_whole, strict=True)
    ]


def filled_by_media(
    of_program: np.ndarray, varies: np.ndarray, world_program: int, geometry: GeometryArrays, meshes: Sequence[Mesh],
    slot_counts: np.ndarray,
) -> Iterator[Filled]:
    """Everything that media which vary fill, the world first, then by instance.

    Parameters
    ----------
    of_program : int32 (P,)
        Medium inside of what has this program, -1 = none.
    varies : bool (M,)
        By medium.
    """
    if world_program >= 0 and of_program[world_program] >= 0 and varies[of_program[world_program]]:
        size = np.full(3, WORLD_SIZE)
        yield Filled(WORLD, int(of_program[world_program]), world_program, -size, size, np.eye(4)[None, :3])
    table = geometry.instance_table
    bounds: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for instance in range(len(table)):
        mesh = int(table[instance, geometry_layout.INSTANCE_MESH])
        start = int(table[instance, geometry_layout.INSTANCE_MATERIAL_OFFSET])
        programs = np.unique(geometry.instance_materials[start : start + slot_counts[mesh]])
        programs = [int(p) for p in programs if of_program[p] >= 0 and varies[of_program[p]]]
        if not programs:
            continue
        if mesh not in bounds:
            shapes = [meshes[mesh].vertices]
            moving = meshes[mesh].motion_vertices
            if moving is not None:
                shapes.append(moving.reshape(-1, 3))
            vertices = np.concatenate(shapes).astype(np.float64)
            bounds[mesh] = vertices.min(axis=0), vertices.max(axis=0)
        first, count = table[instance, [geometry_layout.INSTANCE_FIRST_KEY, geometry_layout.INSTANCE_KEY_COUNT]]
        matrices = geometry.motion_transforms[first : first + count] if count else geometry.transforms[instance]
        to_world = np.asarray(matrices, np.float64).reshape(-1, 3, 4)
        for program in programs:
            grids = tuple(meshes[mesh].grids.values())
            motion = meshes[mesh].volume_motion
            displacement = np.zeros((2, 3)) if motion is None else np.stack(motion.displacement())
            yield Filled(instance, int(of_program[program]), program, *bounds[mesh], to_world, grids, displacement)


def build_majorants(
    everything: Sequence[Filled], compiled: Sequence[CompiledProgram], geometry: GeometryArrays, shaders: ShaderArrays,
    tables: BsdfTables, kept: KeptBounds,
) -> MajorantGrids:
    """Bounds of all that media which vary fill.

    Parameters
    ----------
    everything : sequence of Filled
        As `filled_by_media` gives it.
    kept : KeptBounds
        Updated: what is as it was is not looked up again.
    """
    instance_count = len(geometry.instance_table)
    if not everything:
        kept.bounds.clear()
        return no_majorants(instance_count)
    lookup = MediumLookup(shaders, geometry, tables)
    known: dict[Hashable, tuple[int, np.ndarray]] = {}
    bounds: dict[Hashable, Float32Array] = {}
    values: list[Float32Array] = []
    rows, offsets, spaces, size = [], [], [], 0
    counts = np.zeros(instance_count + 2, np.int64)
    for filled in everything:
        program = compiled[filled.program]
        key = (program, kept.state, *_looked_up(filled, program, geometry))
        if key not in known:
            bound = kept.bounds.get(key)
            if bound is None:
                bound = _bound(filled, lookup, rays_of(program), has_splines=has_splines(program))
            bounds[key] = bound
            known[key] = size, np.array(bound.shape[::-1])
            values.append(bound.ravel())
            size += bound.size
        offset, cells = known[key]
        extent = np.maximum(filled.upper - filled.lower, 1e-30)
        rows.append((filled.medium, *cells))
        offsets.append(offset)
        spaces.append((*filled.lower, *(cells / extent)))
        counts[filled.instance + 2] += 1
    kept.bounds = bounds
    first = np.cumsum(counts)
    return MajorantGrids(
        first=first.astype(np.int32),
        table=np.array(rows, np.int32).reshape(-1, GRID_WIDTH),
        offset=np.array(offsets, np.int64),
        space=np.array(spaces, np.float32).reshape(-1, SPACE_WIDTH),
        values=np.ascontiguousarray(np.concatenate(values)),
    )
