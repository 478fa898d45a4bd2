# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiled shader programs as kernels read them, and the memory a thread runs them in.

A program is a run of instructions in `ShaderArrays.code`:

    code[pc] opcode | code[pc + 1] length in words | outputs ... | inputs ... | immediates ...

Outputs and inputs are indices into the thread's memory (`allocate_memory`): registers first, constants behind them, so
a kernel reads either the same way. Vectors and colours take three consecutive floats. Immediates are plain integers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from engine.array_types import Float32Array, Int32Array, Int64Array, Uint8Array
from engine.runtime.bundle import Bundle
from engine.runtime.stage_table import StageTable
from engine.state.camera import CAMERA_WIDTH

# ---------------------------------------------------------------------------------------------------------------------
# Evaluation modes (the `mode` argument of evaluate_shaders): one of the first four, plus any of the caustics bits.

#: Everything: lobes, emission, transparency.
MODE_CLOSURES = 0
#: Emission only (light samples, background).
MODE_EMISSION = 1
#: Weights of transparent and holdout closures only (shadow rays).
MODE_TRANSPARENCY = 2
#: What is inside, at a point in it: absorption [m^-1] as transparency, phase functions weighted by the scattering that
#: they have [m^-1], emission a metre.
MODE_MEDIUM = 3
MODE_MASK = 3
#: Glossy lobes vanish behind a diffuse bounce, as Cycles does with reflective caustics off.
MODE_NO_REFLECTIVE_CAUSTICS = 4
MODE_NO_REFRACTIVE_CAUSTICS = 8

# Columns of ShaderArrays.programs: a range of `code` per mode (those of surfaces are slices of the first), and facts.
PROGRAM_START = 0  # + 2 * (mode & MODE_MASK)
PROGRAM_END = 1
PROGRAM_FLAGS = 8
#: Row of `images`, plus 1, that a lookup by an unchanged UV map will read; 0 = not known. And the map's slot, or -1.
PROGRAM_AHEAD_IMAGE = 9
PROGRAM_AHEAD_SLOT = 10
#: For a world that is one image (`engine.shaders.program_analysis`): its row of `images` plus 1, else 0; where in
#: `tables` the matrix on directions is, or -1; and how the image is looked up.
PROGRAM_WORLD_IMAGE = 11
PROGRAM_WORLD_TABLE = 12
PROGRAM_WORLD_INTERPOLATION = 13
PROGRAM_WORLD_UNASSOCIATE = 14
PROGRAM_WIDTH = 16

#: May emit light.
PROGRAM_HAS_EMISSION = 1
#: Emission is program_values[row, 0:3] wherever and however it is seen.
PROGRAM_EMISSION_CONSTANT = 2
#: May let shadow rays through (transparent or holdout closures).
PROGRAM_MAY_BE_TRANSPARENT = 4
#: Its transparency is program_values[row, 4:7] everywhere: shadow rays need not run it.
PROGRAM_TRANSPARENCY_CONSTANT = 8
#: Every closure's inputs are constants.
PROGRAM_IS_CONSTANT = 16
#: Adds reflecting or refracting lobes (not only emission and transparency).
PROGRAM_HAS_LOBES = 32
#: The material turned "bump map correction" off.
PROGRAM_NO_BUMP_CORRECTION = 64
#: Nothing but one Lambertian lobe about the smooth normal, of weight program_values[row, 8:11].
PROGRAM_IS_LAMBERTIAN = 128
#: Gives values to AOVs.
PROGRAM_HAS_AOVS = 256
#: Its surface is nothing but the boundary of what is inside.
PROGRAM_IS_BOUNDARY = 512
#: Scatters light below its surface.
PROGRAM_HAS_SUBSURFACE = 1024
#: Has nodes that trace rays, and some whose rays meet the object alone.
PROGRAM_TRACES = 2048
PROGRAM_TRACES_LOCALLY = 4096
#: Has a Ray Portal BSDF.
PROGRAM_HAS_PORTAL = 8192

# Columns of ShaderArrays.program_values.
VALUE_EMISSION = 0  # radiance if constant, else an estimate of its mean
VALUE_TRANSPARENCY = 4
VALUE_LAMBERTIAN = 8
VALUE_WORLD = 12  # factor on the image of a world that is one
VALUE_WIDTH = 16

# Columns of ShaderArrays.images.
IMAGE_X = 0  # width [texels]
IMAGE_Y = 1  # height
IMAGE_OFFSET = 2  # first value in its pool
IMAGE_IS_FLOAT = 3
IMAGE_IS_SRGB = 4
IMAGE_IS_ASSOCIATED = 5
IMAGE_TILE_COUNT = 6  # 0 = no tiles
IMAGE_TILE_FIRST = 7  # first of the rows that list tiles
IMAGE_WIDTH = 8

# Columns of the rows that list tiles, behind all images.
TILE_NUMBER = 0
TILE_IMAGE = 1  # row of the tile

#: Registers 0..3 swallow outputs nobody reads.
SINK = 0
FIRST_REGISTER = 4

#: ShaderArrays.tables begins with this many samples of the sRGB decoding curve on [0, 1].
SRGB_TABLE_SIZE = 2049

# Rows of ShaderArrays.camera: 3x4 matrices in their first 12 columns, and the camera itself
CAMERA_WORLD_TO_CAMERA = 0
CAMERA_TO_WORLD = 1
CAMERA_WORLD_TO_NDC = 2  # three homogeneous rows: x, y, weight
CAMERA_LENS = 3  # columns as `CameraArrays.real`
CAMERA_ROWS = 4


class ShaderArrays(Bundle):
    """All programs of a scene.

    code : int32 (K,)
    constants : float32 (C,), copied behind the registers of each thread's memory
    programs : int32 (P, PROGRAM_WIDTH)
    program_values : float32 (P, VALUE_WIDTH)
    program_pass_index : float32 (P,), material index pass
    program_dispersion : float32 (P,)  [um^2], of all refracting lobes (`engine.spectral.dispersion.ior_at`)
    program_temperature : float32 (P,)  [K], of programs that emit as a black body (`engine.shaders.blackbody`), else 0
    images : int64 (I, IMAGE_WIDTH)
    pixels_byte, pixels_float : uint8 and float32 pools, RGBA, row 0 at the bottom
    tables : float32 pool of ramps and curves
    camera : float32 (CAMERA_ROWS, CAMERA_WIDTH), camera space looks along +z as in Cycles
    register_count : int64 (1,)
    """

    code: Int32Array
    constants: Float32Array
    programs: Int32Array
    program_values: Float32Array
    program_pass_index: Float32Array
    program_dispersion: Float32Array
    program_temperature: Float32Array
    images: Int64Array
    pixels_byte: Uint8Array
    pixels_float: Float32Array
    tables: Float32Array
    camera: Float32Array
    register_count: Int64Array


class ShaderMemory(Bundle):
    """A thread's memory for `evaluate_shaders`.

    floats : float32 (R + C,), registers, then a copy of the constants
    traces : int64 (1,), whether instructions that trace rays do
    ray_ops : what runs them, as `trace_op`: the interpreter calls it through a pointer, since it must not know Embree
    rays : what that takes, of any class
    """

    _rows = True
    _opaque = frozenset({"rays"})

    floats: Float32Array
    traces: Int64Array
    ray_ops: StageTable
    rays: Bundle


class NoRays(Bundle):
    """In the place of what rays need where nothing traces any; nobody reads it.

    nothing : uint8 (1,)
    """

    nothing: Uint8Array


class RayOps(NamedTuple):
    """What instructions that trace rays are run by (`ShaderMemory`)."""

    ray_ops: StageTable
    rays: Bundle


def no_ray_ops() -> RayOps:
    """Nothing that traces: such instructions give what they do where there are no rays."""
    return RayOps(StageTable({"trace_op": _untraced}), NoRays(np.zeros(1, np.uint8)))


def _untraced(*_arguments: object) -> None:
    raise AssertionError("nothing traces here")


def allocate_memory(shaders: ShaderArrays, ray_ops: RayOps | None = None) -> ShaderMemory:
    """A thread's memory for `evaluate_shaders`, with the constants of these programs.

    It belongs to these programs: allocate anew whenever `shaders` changes.

    Parameters
    ----------
    ray_ops : RayOps, optional
        What traces the rays of nodes; None: nothing does.
    """
    register_count = int(shaders.register_count[0])
    memory = np.zeros(register_count + len(shaders.constants), np.float32)
    memory[register_count:] = shaders.constants
    table, rays = ray_ops or no_ray_ops()
    return ShaderMemory(memory, np.array([ray_ops is not None], np.int64), table, rays)


def identity_camera() -> Float32Array:
    """`ShaderArrays.camera` where there is none: all spaces are the world.

    Returns
    -------
    float32 (CAMERA_ROWS, CAMERA_WIDTH)
    """
    rows = np.zeros((CAMERA_ROWS, CAMERA_WIDTH), np.float32)
    rows[:CAMERA_LENS, :12] = np.eye(4, dtype=np.float32)[:3].ravel()
    rows[CAMERA_WORLD_TO_NDC, 8:12] = (0.0, 0.0, 0.0, 1.0)
    return rows
