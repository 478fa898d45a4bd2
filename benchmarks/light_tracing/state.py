# SPDX-License-Identifier: GPL-3.0-or-later
"""What kernels of photons work on: the scene, a thread's memory, the film."""

from __future__ import annotations

import numpy as np

from engine.accel.scratch import RayScratch
from engine.builder.scene import Scene
from engine.kernels.bsdf.tables import BsdfTables
from engine.runtime.bundle import Bundle
from engine.scene.description import VISIBLE_ALL
from engine.state.geometry import GeometryArrays
from engine.state.lanes import Closures, ShadePoints, allocate_closures, allocate_points
from engine.state.shaders import ShaderArrays, ShaderMemory, allocate_memory

#: Cells of the filter's density.
_FILTER_CELLS = 512


class TracedScene(Bundle):
    """A scene for kernels of photons.

    handle : int64 (1,), Embree's scene
    camera, camera_motion, pixel_filter : as `engine.state.camera.CameraArrays`
    filter_density : float32 (F,), of an offset from the pixel's centre [1 / pixel], over evenly spaced cells
    filter_radius : float32 (1,), half of what these cells span [pixels]
    """

    handle: np.ndarray
    camera: np.ndarray
    camera_motion: np.ndarray
    pixel_filter: np.ndarray
    filter_density: np.ndarray
    filter_radius: np.ndarray
    geometry: GeometryArrays
    shaders: ShaderArrays
    tables: BsdfTables


class PhotonLanes(Bundle):
    """A thread's memory for one photon.

    ray, bits, address : `engine.accel.scratch.RayScratch`
    first : int32 (1,), the lane
    value : float32 (1, 3), of a BSDF
    random : uint64 (1,), state of the generator
    film : float64 (height, width, 3), row 0 at the bottom
    """

    ray: np.ndarray
    bits: np.ndarray
    address: np.ndarray
    first: np.ndarray
    value: np.ndarray
    random: np.ndarray
    film: np.ndarray
    points: ShadePoints
    closures: Closures
    registers: ShaderMemory


def filter_density(table: np.ndarray) -> tuple[np.ndarray, float]:
    """Density of a pixel filter whose inverse cumulative distribution is `table`; and the radius of its cells."""
    radius = float(np.abs(table).max())
    edges = np.linspace(-radius, radius, _FILTER_CELLS + 1)
    cumulative = np.interp(edges, table.astype(np.float64), np.linspace(0.0, 1.0, len(table)), left=0.0, right=1.0)
    return (np.diff(cumulative) * _FILTER_CELLS / (2.0 * radius)).astype(np.float32), radius


def traced_scene(scene: Scene) -> TracedScene:
    """A built scene for kernels of photons.

    Raises
    ------
    ValueError
        If the camera is no pinhole that stands still, or the scene has what photons are not traced through.
    """
    description = scene.description
    camera = description.camera
    is_hidden = (description.instances.visibility & VISIBLE_ALL) != VISIBLE_ALL
    reasons = {
        "an object is hidden from some rays": bool(is_hidden.any()),
        "the camera has no perspective": camera.kind != "PERSP",
        "the camera has depth of field": camera.use_dof,
        "something moves": description.is_moving or description.shutter is not None,
        "a border is set": description.frame.region != (0, 0, description.frame.width, description.frame.height),
        "a material scatters below the surface": scene.has_subsurface,
        "there is a ray portal": scene.has_portals,
        "a material traces rays": scene.traces,
        "something is a shadow catcher": scene.has_catchers,
        "there is a medium": scene.media.is_used,
    }
    for reason, holds in reasons.items():
        if holds:
            raise ValueError(f"{reason}: photons are not traced for that")
    density, radius = filter_density(scene.camera.filter)
    return TracedScene(
        np.array([scene.accelerator.handle], np.int64), scene.camera.real, scene.camera.motion, scene.camera.filter,
        density, np.array([radius], np.float32), scene.geometry, scene.shaders, scene.tables,
    )  # fmt: skip


class Memory:
    """A thread's memory, and what keeps it alive."""

    def __init__(self, scene: Scene, seed: int) -> None:
        frame = scene.description.frame
        self._scratch = RayScratch()
        state = np.random.SeedSequence(seed).generate_state(1, np.uint64)
        self.lanes = PhotonLanes(
            self._scratch.ray, self._scratch.bits, np.array([self._scratch.address], np.int64), np.zeros(1, np.int32),
            np.zeros((1, 3), np.float32), state, np.zeros((frame.height, frame.width, 3)), allocate_points(1),
            allocate_closures(1), allocate_memory(scene.shaders),
        )  # fmt: skip
