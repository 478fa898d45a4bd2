# SPDX-License-Identifier: GPL-3.0-or-later
"""The flattened scene as kernels read it: named tuples of C-contiguous arrays, built by `engine.builder.scene`.

A kernel takes the tuple whole, never a slice of its arrays (a slice costs reference counting in a hot loop): pass
array and index.
"""

from __future__ import annotations

from engine.array_types import Float32Array, Int32Array, Int64Array, Uint32Array
from engine.runtime.bundle import Bundle
from engine.state.grids import GridArrays

# Columns of GeometryArrays.instance_table
INSTANCE_MESH = 0
INSTANCE_MATERIAL_OFFSET = 1
INSTANCE_PASS_INDEX = 2
INSTANCE_VISIBILITY = 3
INSTANCE_FLAGS = 4
#: Rows of `motion_transforms`, 0 of them where it stands still.
INSTANCE_FIRST_KEY = 5
INSTANCE_KEY_COUNT = 6
#: Index of the light group in the view layer, -1 = none.
INSTANCE_LIGHT_GROUP = 7
INSTANCE_WIDTH = 8

# Columns of GeometryArrays.instance_values
VALUE_RANDOM = 0
VALUE_COLOR = 1
VALUE_GENERATED = 5
VALUE_UV = 8
#: Cosine below which shadow rays start off a smooth surface, 0 = never.
VALUE_TERMINATOR = 10
#: Factor on the density of media inside that vary.
VALUE_DENSITY = 11
#: Shadow Terminator Shading Offset in [0, 1], 0 = none.
VALUE_SHADING_OFFSET = 12
#: How far short rays look that leave it [m], 0 = as far as others.
VALUE_OCCLUSION = 13
VALUE_WIDTH = 14

#: Vertices of this instance's mesh are stored in world space (its only user): hits need no transform.
INSTANCE_FLAG_BAKED = 1
#: The transform mirrors (negative determinant).
INSTANCE_FLAG_MIRRORED = 2
INSTANCE_FLAG_HOLDOUT = 4
#: The transform depends on time (`engine.kernels.motion`); never with BAKED.
INSTANCE_FLAG_MOVING = 8
#: A shadow catcher, and no holdout.
INSTANCE_FLAG_CATCHER = 16
#: Rays start and end on it in place, not a rounding error off: see `engine.builder.same_place`.
INSTANCE_FLAG_IN_PLACE = 32

# Columns of GeometryArrays.mesh_table
MESH_FIRST_TRIANGLE = 0
MESH_TRIANGLE_COUNT = 1
MESH_FIRST_VERTEX = 2
MESH_VERTEX_COUNT = 3
#: Row in `corner_normals` of the mesh's first triangle, -1 = flat.
MESH_FIRST_NORMAL = 4
#: Slot numbers (see `attribute_table`) of the render-active UV map and colour, and of positions before deformation,
#: -1 = none.
MESH_DEFAULT_UV = 5
MESH_DEFAULT_COLOR = 6
MESH_UNDEFORMED = 7
#: Row of `motion_table`, -1 where the mesh keeps its shape.
MESH_MOTION = 8
#: What the rows of `triangles` are: SHAPE_*.
MESH_SHAPE = 9
#: Row of `radii` of the mesh's first vertex, -1 where it has triangles.
MESH_FIRST_RADIUS = 10
#: How finely Embree follows curves.
MESH_SUBDIVISIONS = 11
#: Whether it encloses a space (`engine.builder.solids`).
MESH_SOLID = 12
MESH_WIDTH = 13

# A row of `triangles` names the corners of a triangle. A segment of a curve names the vertices (keys) that it goes
# between, and the first of its curve; so points are weighed as a triangle's are, with a v of 0. A sphere names its
# centre three times.
SHAPE_TRIANGLES = 0
SHAPE_RIBBONS = 1
SHAPE_ROUND = 2
SHAPE_ROUND_LINEAR = 3
SHAPE_SPHERES = 4

# Columns of GeometryArrays.motion_table: a mesh's steps from the shutter's opening to its closing lie one after the
# other, each as long as the mesh itself.
MOTION_STEP_COUNT = 0
MOTION_FIRST_VERTEX = 1
#: -1 = flat
MOTION_FIRST_NORMAL = 2
MOTION_WIDTH = 4

# Columns of GeometryArrays.attribute_table: one row per (mesh, attribute slot), row = mesh * attribute_count + slot.
#: 0 absent, 1 point, 2 triangle, 3 corner, 4 whole instance, 5 voxels
ATTRIBUTE_DOMAIN = 0
ATTRIBUTE_COMPONENTS = 1
#: First float in `attribute_data`, or row of `grids.table`
ATTRIBUTE_OFFSET = 2
ATTRIBUTE_WIDTH = 3

DOMAIN_ABSENT = 0
DOMAIN_POINT = 1
DOMAIN_FACE = 2
DOMAIN_CORNER = 3
DOMAIN_INSTANCE = 4
DOMAIN_GRID = 5


class GeometryArrays(Bundle):
    """Meshes concatenated, instances, attributes.

    vertices : float32 (V, 3), object space, or world where the instance is baked; of meshes that change their shape
        at the middle of the shutter, and then its steps
    triangles : uint32 (T, 3), rows of `vertices` (already offset by mesh)
    corner_normals : float32 (N, 9), three unit normals a triangle, same space and steps as `vertices`
    material_slots : int32 (T,), slot in the instance's material list
    mesh_table : int32 (M, MESH_WIDTH)
    instance_table : int32 (I, INSTANCE_WIDTH)
    transforms, inverses : float32 (I, 12), object to world and back (of the original object, also where baked), at the
        middle of the shutter
    instance_values : float32 (I, VALUE_WIDTH)
    instance_materials : int32 (K,), program (= material) of slot k: `instance_materials[offset + slot]`
    attribute_table : int64 (M * A, ATTRIBUTE_WIDTH)
    attribute_data : float32 (D,)
    radii : float32 (R,), of the vertices of curves and spheres, in the space that these are stored in
    texture_space : float32 (M, 6), centre and half size
    attribute_count : int64 (1,), A
    motion_table : int32 (X, MOTION_WIDTH)
    motion_transforms : float32 (K, 12), object to world of what moves, at evenly spaced times
    grids : voxels
    """

    vertices: Float32Array
    triangles: Uint32Array
    corner_normals: Float32Array
    material_slots: Int32Array
    mesh_table: Int32Array
    instance_table: Int32Array
    transforms: Float32Array
    inverses: Float32Array
    instance_values: Float32Array
    instance_materials: Int32Array
    attribute_table: Int64Array
    attribute_data: Float32Array
    radii: Float32Array
    texture_space: Float32Array
    attribute_count: Int64Array
    motion_table: Int32Array
    motion_transforms: Float32Array
    grids: GridArrays
