# SPDX-License-Identifier: GPL-3.0-or-later
"""All shader programs of a description: materials, the default material, the world, lights with nodes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.builder.camera_spaces import camera_matrices
from engine.builder.emission import SAMPLING_AUTO, SAMPLING_MODES, ProgramInfo
from engine.builder.point_batches import PointBatches
from engine.builder.sky_suns import find_sky_suns
from engine.kernels.bsdf import BsdfTables
from engine.scene.description import Link, Material, Node, NodeGraph, Notice, SceneDescription
from engine.shaders.aov_columns import aov_columns
from engine.shaders.compiled_program import AovColumns, ProgramSource
from engine.shaders.compiler import compile_programs
from engine.shaders.lamp_facts import facts_of
from engine.shaders.program_cache import ProgramCache
from engine.state.geometry import GeometryArrays
from engine.state.lanes import (
    LANE_COUNT,
    POINT_INSTANCE,
    POINT_LIGHT,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_PROGRAM,
    POINT_RAY_FLAGS,
    POINT_RAY_LENGTH,
    POINT_TRIANGLE,
    POINT_WO,
    RAY_EMISSION,
)
from engine.state.shaders import (
    MODE_EMISSION,
    PROGRAM_EMISSION_CONSTANT,
    PROGRAM_FLAGS,
    PROGRAM_HAS_EMISSION,
    VALUE_EMISSION,
    ShaderArrays,
)

#: Width of the map a procedural world is sampled by, and the largest that an image gets.
_DEFAULT_MAP_WIDTH = 1024
_LARGEST_MAP_WIDTH = 4096
#: Of a world of one colour, which is sampled through light portals alone.
_UNIFORM_MAP_WIDTH = 8


@dataclass
class Programs:
    """Compiled programs and which is whose: material i is program i."""

    arrays: ShaderArrays
    attribute_names: list[str]
    notices: list[Notice]
    default_program: int
    world_program: int
    light_programs: Int32Array
    #: Of each material, -1 = none: what it moves vertices by.
    displacement_programs: Int32Array
    description: SceneDescription

    def program_info(self) -> ProgramInfo:
        """What light sampling wants to know."""
        flags = self.arrays.programs[:, PROGRAM_FLAGS]
        sampling = np.full(len(flags), SAMPLING_AUTO, np.int32)
        for index, material in enumerate(self.description.materials):
            sampling[index] = SAMPLING_MODES[material.emission_sampling]
        return ProgramInfo(
            has_emission=(flags & PROGRAM_HAS_EMISSION) != 0,
            emission_is_constant=(flags & PROGRAM_EMISSION_CONSTANT) != 0,
            emission_estimate=self.arrays.program_values[:, VALUE_EMISSION : VALUE_EMISSION + 3],
            temperature=self.arrays.program_temperature,
            sampling_mode=sampling,
            light_program=self.light_programs,
            world_program=self.world_program,
        )

    @property
    def background_width(self) -> int:
        """Columns of the grid by which the world is sampled as a light, 0 = none: it is left to scattered rays."""
        world = self.description.world
        if world is None or world.sampling == "NONE":
            return 0
        flags = self.arrays.programs[self.world_program, PROGRAM_FLAGS]
        if not flags & PROGRAM_HAS_EMISSION:
            return 0
        if flags & PROGRAM_EMISSION_CONSTANT:
            # Where it comes in is known all the same.
            return _UNIFORM_MAP_WIDTH if world.portals else 0
        width = world.map_resolution if world.sampling == "MANUAL" else self._map_width()
        return int(np.clip(width, 4, _LARGEST_MAP_WIDTH))

    def background_grid(
        self, width: int, geometry: GeometryArrays, tables: BsdfTables, threads: int = 1
    ) -> Float32Array:
        """The world's radiance by direction, float32 (width / 2, width, 3), computed by so many threads.

        Rows go from z = -1 to 1, columns along longitude as Blender's environment textures.
        """
        height = max(width // 2, 2)
        z_angle = np.pi * ((np.arange(height) + 0.5) / height - 0.5)
        longitude = np.pi * (1.0 - 2.0 * (np.arange(width) + 0.5) / width)
        directions = np.stack(
            [
                np.outer(np.cos(z_angle), np.cos(longitude)),
                np.outer(np.cos(z_angle), np.sin(longitude)),
                np.outer(np.sin(z_angle), np.ones(width)),
            ],
            axis=-1,
        ).reshape(-1, 3)
        return self.background_radiance(directions, geometry, tables, threads).reshape(height, width, 3)

    def background_radiance(
        self, directions: np.ndarray, geometry: GeometryArrays, tables: BsdfTables, threads: int = 1
    ) -> Float32Array:
        """The world's radiance in directions, (N, 3): float32 (N, 3); 0 where it is not finite."""
        radiance = np.empty((len(directions), 3), np.float32)
        # A whole number of batches for each thread.
        size = -(-len(directions) // (threads * LANE_COUNT)) * LANE_COUNT
        parts = [slice(start, start + size) for start in range(0, len(directions), size)]
        with ThreadPoolExecutor(threads, thread_name_prefix="background") as pool:
            list(pool.map(lambda part: self._look_at(directions[part], geometry, tables, radiance[part]), parts))
        radiance[~np.isfinite(radiance)] = 0.0
        return radiance

    def _look_at(
        self, directions: np.ndarray, geometry: GeometryArrays, tables: BsdfTables, radiance: Float32Array
    ) -> None:
        """Write the world's radiance in directions, (N, 3), to `radiance`, float32 (N, 3)."""
        batches = PointBatches(self.arrays)
        real, integer = batches.points.real, batches.points.integer
        real[:, POINT_RAY_LENGTH] = 1e30
        integer[:, [POINT_INSTANCE, POINT_TRIANGLE, POINT_LIGHT]] = -1
        integer[:, POINT_PROGRAM] = self.world_program
        integer[:, POINT_RAY_FLAGS] = RAY_EMISSION
        places = {POINT_P: directions, **dict.fromkeys((POINT_WO, POINT_NG, POINT_NS), -directions)}
        for part, count in batches.run(self.arrays, geometry, tables, MODE_EMISSION, places):
            radiance[part] = batches.closures.emission[:count, :3]

    def _map_width(self) -> int:
        """As wide as the widest image the world shows; small ones are interpolated and turned, and need more."""
        world = self.description.world
        widths = [0]
        if world is not None and world.graph is not None:
            for node in world.graph.nodes:
                image = node.properties.get("image", -1)
                if isinstance(image, int) and 0 <= image < len(self.description.images):
                    widths.append(self.description.images[image].pixels.shape[1])
        if find_sky_suns(world).has_others:
            return _LARGEST_MAP_WIDTH
        return max(*widths, _DEFAULT_MAP_WIDTH)


def compile_scene(description: SceneDescription, cache: ProgramCache | None = None) -> Programs:
    """Compile every node graph of a description.

    Parameters
    ----------
    description : SceneDescription
    cache : ProgramCache, optional
        Updated: programs and images that have not changed are not made again.
    """
    aovs = aov_columns(description.passes.aovs)

    def asked_of(graph: NodeGraph | None) -> tuple[AovColumns, ...]:
        return aovs if graph is not None and graph.aovs else ()

    sources = [
        ProgramSource(
            f"{material.user} / {material.name}" if material.user else f"material {material.name}",
            material.graph,
            pass_index=material.pass_index,
            dispersion=material.dispersion,
            use_bump_map_correction=material.use_bump_map_correction,
            has_smooth_voxels=material.has_smooth_voxels,
            use_transparent_shadow=material.use_transparent_shadow,
            aovs=asked_of(material.graph),
            displacement_method=material.displacement_method,
        )
        for material in description.materials
    ]
    default_program = len(sources)
    # What Cycles 5.0 gives faces without a material: the Principled BSDF as it is added.
    default = NodeGraph([Node("ShaderNodeBsdfPrincipled", "Principled BSDF")], surface=Link(0, "BSDF"))
    sources.append(ProgramSource("the default material", default))
    world_program = -1
    if description.world is not None:
        world_program = len(sources)
        world = description.world
        sources.append(
            ProgramSource(
                f"world {world.name}", world.graph, kind="WORLD", color=world.color, aovs=asked_of(world.graph)
            )
        )
    light_programs = np.full(len(description.lights), -1, np.int32)
    for index, light in enumerate(description.lights):
        if light.graph is not None:
            light_programs[index] = len(sources)
            facts = facts_of(light, light.graph)
            sources.append(ProgramSource(f"light {light.name}", light.graph, kind="LIGHT", lamp=facts))
    displacement_programs = np.full(len(description.materials), -1, np.int32)
    for index, material in enumerate(description.materials):
        if displaces(material):
            displacement_programs[index] = len(sources)
            sources.append(replace(sources[index], kind="DISPLACEMENT", aovs=()))
    arrays, attribute_names, notices = compile_programs(
        sources, description.images, camera_matrices(description.camera, description.frame), description.to_xyz,
        cache, frozenset(name for mesh in description.meshes for name in mesh.grids),
    )
    return Programs(
        arrays, attribute_names, notices, default_program, world_program, light_programs, displacement_programs,
        description,
    )


def displaces(material: Material) -> bool:
    """Whether a material moves vertices."""
    has_displacement = material.graph is not None and material.graph.displacement is not None
    return has_displacement and material.displacement_method != "BUMP"
