# SPDX-License-Identifier: GPL-3.0-or-later
"""What the passes of data read of a scene, and where they are on the film."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.runtime.bundle import Bundle

#: Columns of the sums that a pass of data takes. Of motion vectors the last one counts the samples that have one.
MIST_WIDTH = 1
UV_WIDTH = 3
VECTOR_WIDTH = 5
BACKWARD_MOTION_WIDTH = 3
SPECULAR_MOTION_WIDTH = 2
SPECULAR_ALBEDO_WIDTH = 3
ROUGHNESS_WIDTH = 1
SURFACE_ROUGHNESS_WIDTH = 1

# Columns of DataView.instance_ids
ID_OBJECT = 0
ID_ASSET = 1

# Rows of DataView.rasters, the first two of DataView.depths too
RASTER_NOW = 0
RASTER_BEFORE = 1
RASTER_AFTER = 2


class DataOptions(NamedTuple):
    """Which passes of data there are, and their settings.

    `mist`, `uv`, `vector`, `backward_motion`, `specular_motion`, `specular_albedo`, `roughness`, `surface_roughness`
    and `aov` are first columns of `FilmTile.data`, `object_mattes` and its kind first slots of `FilmTile.mattes`; -1:
    not asked for.
    """

    is_used: int = 0
    mist: int = -1
    uv: int = -1
    vector: int = -1
    backward_motion: int = -1
    specular_motion: int = -1
    specular_albedo: int = -1
    roughness: int = -1
    #: Of the first surface, not of what it mirrors.
    surface_roughness: int = -1
    #: Whether specular motion, specular albedo or roughness is asked for.
    asks_for_mirrors: int = 0
    aov: int = -1
    #: Columns of all AOVs.
    aov_width: int = 0
    object_mattes: int = -1
    material_mattes: int = -1
    asset_mattes: int = -1
    #: Slots of each kind of mattes, 0 = no mattes.
    matte_slots: int = 0
    mist_start: np.float32 = np.float32(0.0)  # [m]
    mist_inverse_depth: np.float32 = np.float32(0.0)  # [1 / m]
    mist_falloff: np.float32 = np.float32(1.0)  # exponent
    #: Surfaces of a smaller alpha leave passes of one surface to those behind.
    alpha_threshold: np.float32 = np.float32(0.5)
    #: Whether the background has motion vectors.
    background_moves: int = 0
    #: Whether the albedo of what rough glass lets through is looked up: `engine.kernels.bsdf.energy.albedo_blends`.
    looks_up_transmission: int = 0
    #: Whether specular albedo and roughness behind a surface count by what it mirrors, too.
    follows_mirrors: int = 1
    #: Whether lobes are specular by their roughness: `engine.kernels.bsdf.mirrors`.
    weighs_by_roughness: int = 1

    @property
    def knows_motion(self) -> bool:
        """Whether a pass asks how what is seen moves."""
        return max(self.vector, self.backward_motion, self.specular_motion) >= 0


@dataclass(frozen=True)
class DataLayout:
    """Passes of data of one film.

    Attributes
    ----------
    width : int
        Columns of `FilmTile.data`.
    matte_count : int
        Slots of `FilmTile.mattes`.
    aovs : tuple of (str, int, int)
        Name of the pass, first column and width, of each AOV.
    mattes : tuple of (str, int)
        Kind and first slot, of each kind of mattes.
    """

    options: DataOptions = field(default_factory=DataOptions)
    width: int = 0
    matte_count: int = 0
    aovs: tuple[tuple[str, int, int], ...] = ()
    mattes: tuple[tuple[str, int], ...] = ()


NO_DATA = DataLayout()


class DataView(Bundle):
    """What the passes of data read besides geometry and programs; without rows where a pass is not asked for.

    instance_ids : float32 (I, 2), of the Cryptomatte; program_ids : float32 (P,)
    motion_rows : int32 (I,), pair of rows of `motion_matrices`, -1 where an instance stands still
    motion_matrices : float32 (2 K, 12), before and after; from where an instance is now, in world space, or from object
        space where its shape changes
    shape_rows : int32 (M,), first row in `shape_vertices` of a mesh whose shape changes, else -1
    shape_vertices : float32 (V, 3), object space; of each mesh all vertices before, then all after
    rasters : float32 (3, 12), world to homogeneous pixels now, before and after; of panoramas world to camera
    depths : float32 (2, 4), world to distance along the camera's axis now and before [m]: direction, then its offset;
        of panoramas along its upward axis
    """

    options: DataOptions
    instance_ids: Float32Array
    program_ids: Float32Array
    motion_rows: Int32Array
    motion_matrices: Float32Array
    shape_rows: Int32Array
    shape_vertices: Float32Array
    rasters: Float32Array
    depths: Float32Array


def no_data(alpha_threshold: float = 0.5) -> DataView:
    """`DataView` without any pass of data."""
    return DataView(
        options=DataOptions(alpha_threshold=np.float32(alpha_threshold)),
        instance_ids=np.zeros((0, 2), np.float32),
        program_ids=np.zeros(0, np.float32),
        motion_rows=np.zeros(0, np.int32),
        motion_matrices=np.zeros((0, 12), np.float32),
        shape_rows=np.zeros(0, np.int32),
        shape_vertices=np.zeros((0, 3), np.float32),
        rasters=np.zeros((3, 12), np.float32),
        depths=np.zeros((2, 4), np.float32),
    )
