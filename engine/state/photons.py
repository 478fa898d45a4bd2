# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons: light that has gone from a lamp over sharp surfaces to one that gathers it, and where it can begin."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, FloatArray, Int32Array, Int64Array, Uint8Array
from engine.runtime.bundle import Bundle
from engine.state.columns import RowLayout, allocate, column
from engine.state.lights import LightArrays

_photon = RowLayout()
PHOTON_P = _photon.take(3)  # where it has arrived, world [m]
PHOTON_WI = _photon.take(3)  # unit, towards where it has come from
PHOTON_NG = _photon.take(3)  # geometric normal there, on that side
PHOTON_POWER = _photon.take(3)  # [W], RGB
#: Density with which photons begin as this one did: of places on casters times directions of light samples, over the
#: cosine at the caster [m^-2 sr^-1].
PHOTON_DENSITY = _photon.take()
PHOTON_GROUP = _photon.take()  # light group, -1 = none
#: Scatterings on its way that reflected it, and those that let it through BOUNCE_LIMIT times: both are whole numbers
#: below that.
PHOTON_BOUNCES = _photon.take()
PHOTON_START = _photon.take()  # where it began, a row of PhotonMap.place_density
#: A cache line of float32.
PHOTON_WIDTH = _photon.width(16)
# Where something moves, or paths have wavelengths, rows are longer (`photon_width`).
PHOTON_TIME = _photon.take()  # in [0, 1], of the shutter
PHOTON_MOVES = _photon.take()  # instance on which it has arrived, if that moves, else -1
PHOTON_HERO = _photon.take()  # as `PathState.hero`
_photon.take()
PHOTON_POWERS = _photon.take(4)  # [W], at its wavelengths; PHOTON_POWER is their mean then
PHOTON_WIDTH_MORE = _photon.width(16)

# Marks of photons within media have no normal: in its place,
PHOTON_MEDIUM = PHOTON_NG  # what tells their medium from others
PHOTON_SCATTERING = PHOTON_NG + 1  # of the medium there, mean over channels [m^-1]
PHOTON_IS_WITHIN = PHOTON_NG + 2  # IS_WITHIN, which no unit normal has; their PHOTON_POWER is in W m
IS_WITHIN = np.float32(2.0)

#: See PHOTON_BOUNCES. Blender's limits are 1024.
BOUNCE_LIMIT = 2048

# PhotonMap.header
MAP_BUCKETS = 0  # a power of two
MAP_IS_TRIED = 1  # `PhotonLanes.tried` is asked for
#: Of the photons within radii of a pixel (MAP_PIXELS) a path gathers one in so many; 0: as many of them as of a map's
#: disc.
MAP_ONE_IN = 2
MAP_TUBE_BUCKETS = 3  # of the marks within media
MAP_MARKS = 4  # that a photon draws on each of its segments within media
#: Of the photons in a map's disc each path gathers one in so many, by chance: neighbouring pixels, and samples of a
#: pixel, go by others, so that noise has no blotches. In smaller discs it gathers a larger part.
MAP_GATHERED_ONE_IN = 5
MAP_HEADER_WIDTH = 6

# PhotonMap.numbers
MAP_RADIUS = 0  # within which photons are gathered [m]; 0: there is no map
MAP_INVERSE_CELL = 1  # of the grid [m^-1]
#: 1 / (photons that have begun, of which a path gathers, x area of the disc) [m^-2]
MAP_SCALE = 2
#: Such photons times the area of a disc [m^2]: makes of a density how many photons arrive in a disc.
MAP_EXPECTED = 3
#: Half of the windows in which photons are gathered: of the shutter, and of [0, 1), by which wavelengths are drawn; 0:
#: whenever they have arrived, and with three channels. MAP_SCALE and MAP_EXPECTED count the photons of the windows.
MAP_HALF_TIME = 4
MAP_HALF_WAVES = 5
#: Paths that have met nothing diffuse gather within so many radii of their pixel, at most.
MAP_PIXELS = 6
# The same of marks within media, which are gathered within a cylinder about a path's segment, TUBE_LENGTH radii long.
MAP_TUBE_RADIUS = 7  # [m]
MAP_TUBE_INVERSE_CELL = 8  # [m^-1]
MAP_TUBE_SCALE = 9  # [m^-3]
MAP_TUBE_EXPECTED = 10  # [m^3]
MAP_NUMBERS = 11

TUBE_LENGTH = 4
#: Of the marks in a cylinder a path gathers one in so many.
TUBE_ONE_IN = 4

#: Cells of a block of a grid, whose buckets are in a row.
BLOCK_CELLS = 64
_WORD_BITS = 32

#: MAP_MARKS while nothing tells how many pay.
MARKS_AT_FIRST = 4

# Bits of CasterArrays.instances
MAY_CAST = 1
MAY_GATHER = 2
MOVES = 4
#: Photons go through a caster's surfaces.
REFRACTS = 8

#: When casters have the areas by which photons begin, and surfaces are where photons are gathered on them: the middle
#: of the shutter.
RESTING = np.float32(0.5)


class CasterArrays(Bundle):
    """Sharp surfaces in pieces, from which photons begin: T triangles, each divided into 4 ** level pieces, P in all.

    first_row : int32 (I,), row of the first triangle of an instance's mesh, -1: it casts nothing
    instance, triangle : int32 (T,), rows of `GeometryArrays.instance_table` and `.triangles`
    first_piece : int32 (T,), -1: the triangle is no caster
    level : int32 (T,)
    row : int32 (P,), the pieces' triangles; group : int32 (P,), those that lie together have the same number
    area : float32 (P,), of the pieces in the world, in the middle of the shutter [m^2]
    instances : uint8 (I,), MAY_* and MOVES
    motion : float32 (1,), how far things go while the shutter is open, at most, about [m]
    lights : LightArrays, by the tree alone: nothing learned
    """

    first_row: Int32Array
    instance: Int32Array
    triangle: Int32Array
    first_piece: Int32Array
    level: Int32Array
    row: Int32Array
    group: Int32Array
    area: Float32Array
    instances: Uint8Array
    motion: Float32Array
    lights: LightArrays


class PhotonMap(Bundle):
    """Photons sorted by the cells of a hashed grid, P of them in H buckets; and M marks within media, in K buckets.

    header : int64 (MAP_HEADER_WIDTH,); numbers : float32 (MAP_NUMBERS,)
    cumulative : float64 (S,), of the probabilities with which photons begin at the casters' pieces, the last is 1.
        Pieces have two rows each, their sides: that of the geometric normal, then the other.
    place_density : float32 (S,), with which they begin at a place of a piece, on that side [m^-2]
    starts : int32 (H + 1,), first photon of each bucket
    places : float32 (P, 3), where they have arrived, which is asked for most
    photons : float32 (P, `photon_width`)
    starts_within : int32 (K + 1 + K / 32,), behind the first mark of each bucket a bit for each that holds any
        (`engine.kernels.hash_grid.note_occupied`)
    within : float32 (M, as `photons`)
    """

    _dynamic = frozenset({"photons", "within"})

    header: Int64Array
    numbers: Float32Array
    cumulative: FloatArray
    place_density: Float32Array
    starts: Int32Array
    places: Float32Array
    photons: Float32Array
    starts_within: Int32Array
    within: Float32Array


class PhotonLanes(Bundle):
    """What lanes know of photons, L of them; F photons that have been found; M pixels of a trial; S as in PhotonMap."""

    ratio: Float32Array = column(
        "where the path gathered photons last: cosine to its geometric normal over the density of its BSDF [sr]", "L"
    )
    disc: Float32Array = column("photons expected where it gathered last, over those of the map's disc", "L")
    density: Float32Array = column("of the lane's photon, PHOTON_DENSITY", "L")
    place_density: Float32Array = column(
        "`PhotonMap.place_density` where the photon began, or at the last caster that the path has met [m^-2]", "L"
    )
    start: Int32Array = column("where the lane's photon began, PHOTON_START", "L")
    seen: Float32Array = column("how often a trial's paths have left each side of the casters' pieces", "S")
    group: Int32Array = column("of its light", "L")
    visibility: Int32Array = column("RAY_* bits of rays that see its light", "L")
    tried: Float32Array = column(
        "of a trial's pixels, by row of the film: what was gathered, the second moment of what paths alone would have "
        "found of it, mean over channels, and the pixel's radius where it gathers first [m]", "M", 3,
    )
    found: Float32Array = column("photons that have arrived, `photon_width` numbers each", "F", "W", is_dynamic=True)


def photon_width(*, moves: bool, is_spectral: bool) -> int:
    """Numbers of a photon: a cache line, or two where something moves or paths have wavelengths."""
    return PHOTON_WIDTH_MORE if moves or is_spectral else PHOTON_WIDTH


def allocate_photon_lanes(
    lane_count: int, photon_count: int, pixel_count: int, piece_count: int, width: int = PHOTON_WIDTH
) -> PhotonLanes:
    """Zeroed `PhotonLanes`, photons of so many numbers."""
    sizes = {"L": lane_count, "F": photon_count, "M": pixel_count, "S": 2 * piece_count, "W": width}
    return allocate(PhotonLanes, sizes)


def bucket_starts(bucket_count: int) -> Int32Array:
    """Zeros for the first mark of each bucket, of a multiple of BLOCK_CELLS, and bits of which hold any."""
    return np.zeros(bucket_count + 1 + bucket_count // _WORD_BITS, np.int32)


def no_casters(lights: LightArrays) -> CasterArrays:
    """`CasterArrays` of scenes without photons."""
    return CasterArrays(
        **{name: np.zeros(0, np.int32) for name in CasterArrays._fields[:7]},
        area=np.zeros(0, np.float32), instances=np.zeros(0, np.uint8), motion=np.zeros(1, np.float32), lights=lights,
    )  # fmt: skip


def no_photons(place_density: Float32Array | None = None, cumulative: FloatArray | None = None) -> PhotonMap:
    """A map without photons, which are to begin with these densities."""
    header = np.zeros(MAP_HEADER_WIDTH, np.int64)
    header[MAP_BUCKETS], header[MAP_TUBE_BUCKETS] = 1, BLOCK_CELLS
    header[MAP_MARKS] = MARKS_AT_FIRST
    return PhotonMap(
        header=header, numbers=np.zeros(MAP_NUMBERS, np.float32),
        cumulative=np.zeros(0, np.float64) if cumulative is None else cumulative,
        place_density=np.zeros(0, np.float32) if place_density is None else place_density, starts=np.zeros(2, np.int32),
        places=np.zeros((0, 3), np.float32), photons=np.zeros((0, PHOTON_WIDTH), np.float32),
        starts_within=bucket_starts(BLOCK_CELLS), within=np.zeros((0, PHOTON_WIDTH), np.float32),
    )  # fmt: skip
