# SPDX-License-Identifier: GPL-3.0-or-later
"""What shader inputs read at a point: positions, displaced positions for bump mapping, mesh attributes, spaces."""

from engine.kernels.motion import (
    direction_to_object,
    direction_to_world,
    normal_to_object,
    normal_to_world,
    normals_at,
    point_to_object,
    triangle_at,
)
from engine.kernels.vector import add, cross, dot, negate, normalize, scale, subtract
from engine.runtime.jit import kernel
from engine.state.geometry import (
    ATTRIBUTE_COMPONENTS,
    ATTRIBUTE_DOMAIN,
    ATTRIBUTE_OFFSET,
    DOMAIN_ABSENT,
    DOMAIN_CORNER,
    DOMAIN_FACE,
    DOMAIN_GRID,
    DOMAIN_INSTANCE,
    DOMAIN_POINT,
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAGS,
    INSTANCE_MESH,
    MESH_FIRST_NORMAL,
    MESH_FIRST_TRIANGLE,
    MESH_FIRST_VERTEX,
    MESH_UNDEFORMED,
)
from engine.state.lanes import (
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_RADIUS,
    POINT_TIME,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
)


@kernel
def read_point(points, lane, column):
    """3-vector at `column` of `ShadePoints.real`."""
    return (points.real[lane, column], points.real[lane, column + 1], points.real[lane, column + 2])


@kernel
def footprint_axis(ng, axis):
    """Unit tangent spanning the footprint of the compact ray differential: axis 1 = x, 2 = y (Cycles' basis)."""
    if ng[0] != ng[1] or ng[0] != ng[2]:
        x = (ng[2] - ng[1], ng[0] - ng[2], ng[1] - ng[0])
    else:
        x = (ng[2] - ng[1], ng[0] + ng[2], -ng[1] - ng[0])
    x = normalize(x)
    if axis == 1:
        return x
    return cross(ng, x)


@kernel
def displaced_position(points, lane, axis, width):
    """P, moved by `width` footprint radii along `axis` (0 = not at all)."""
    p = read_point(points, lane, POINT_P)
    if axis == 0:
        return p
    direction = footprint_axis(read_point(points, lane, POINT_NG), axis)
    return add(p, scale(direction, points.real[lane, POINT_RADIUS] * width))


@kernel
def mirrored_position(points, lane, axis, width):
    """`displaced_position`, backwards on back faces, where Cycles negates dPdu and dPdv."""
    if points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING:
        width = -width
    return displaced_position(points, lane, axis, width)


@kernel
def edges(geometry, instance, triangle, time):
    """World space edges v1 - v0 and v2 - v0."""
    v0, v1, v2 = triangle_at(geometry, geometry.instance_table[instance, INSTANCE_MESH], triangle, time)
    e1 = subtract(v1, v0)
    e2 = subtract(v2, v0)
    if geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
        return e1, e2
    return direction_to_world(geometry, instance, time, e1), direction_to_world(geometry, instance, time, e2)


@kernel
def displaced_barycentrics(geometry, points, lane, axis, width):
    """Barycentrics of `mirrored_position`."""
    u = points.real[lane, POINT_U]
    v = points.real[lane, POINT_V]
    instance = points.integer[lane, POINT_INSTANCE]
    if axis == 0 or instance < 0:
        return u, v
    e1, e2 = edges(geometry, instance, points.integer[lane, POINT_TRIANGLE], points.real[lane, POINT_TIME])
    move = points.real[lane, POINT_RADIUS] * width
    if points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING:
        move = -move
    d = footprint_axis(read_point(points, lane, POINT_NG), axis)
    a = dot(e1, e1)
    b = dot(e1, e2)
    c = dot(e2, e2)
    determinant = a * c - b * b
    if not determinant > 0.0:
        return u, v
    d1 = dot(e1, d)
    d2 = dot(e2, d)
    move = move / determinant
    return u + (c * d1 - b * d2) * move, v + (a * d2 - b * d1) * move


@kernel
def barycentric_slopes(geometry, points, lane, axis):
    """How barycentrics grow along the footprint's unit axis [1/m]; backwards on back faces."""
    instance = points.integer[lane, POINT_INSTANCE]
    e1, e2 = edges(geometry, instance, points.integer[lane, POINT_TRIANGLE], points.real[lane, POINT_TIME])
    d = footprint_axis(read_point(points, lane, POINT_NG), axis)
    a = dot(e1, e1)
    b = dot(e1, e2)
    c = dot(e2, e2)
    determinant = a * c - b * b
    if not determinant > 0.0:
        return 0.0 * a, 0.0 * a
    d1 = dot(e1, d)
    d2 = dot(e2, d)
    sign = -1.0 if points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING else 1.0
    return sign * (c * d1 - b * d2) / determinant, sign * (a * d2 - b * d1) / determinant


@kernel
def attribute_component(geometry, offset, stride, i0, i1, i2, u, v, component):
    """One interpolated component; `offset` in floats, rows of `stride` floats."""
    data = geometry.attribute_data
    w = 1.0 - u - v
    offset += component
    return w * data[offset + i0 * stride] + u * data[offset + i1 * stride] + v * data[offset + i2 * stride]


@kernel
def fetch_attribute(geometry, instance, triangle, slot, u, v):
    """Attribute `slot` of an instance or its mesh.

    Returns
    -------
    x, y, z, w : float32, zero beyond the attribute's width
    components : int, 0 = the mesh has no such attribute
    """
    if instance < 0 or slot < 0:
        return 0.0, 0.0, 0.0, 0.0, 0
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    row = mesh * geometry.attribute_count[0] + slot
    domain = geometry.attribute_table[row, ATTRIBUTE_DOMAIN]
    # A point inside is on no triangle, and voxels are inside.
    if domain == DOMAIN_ABSENT or domain == DOMAIN_GRID or (triangle < 0 and domain != DOMAIN_INSTANCE):
        return 0.0, 0.0, 0.0, 0.0, 0
    components = geometry.attribute_table[row, ATTRIBUTE_COMPONENTS]
    offset = geometry.attribute_table[row, ATTRIBUTE_OFFSET]
    i0 = 0
    i1 = 0
    i2 = 0
    if domain == DOMAIN_CORNER:
        i0 = 3 * (triangle - geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE])
        i1 = i0 + 1
        i2 = i0 + 2
    elif domain == DOMAIN_POINT:
        first = geometry.mesh_table[mesh, MESH_FIRST_VERTEX]
        i0 = int(geometry.triangles[triangle, 0]) - first
        i1 = int(geometry.triangles[triangle, 1]) - first
        i2 = int(geometry.triangles[triangle, 2]) - first
    elif domain == DOMAIN_FACE:
        i0 = triangle - geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE]
        i1 = i0
        i2 = i0
    elif domain == DOMAIN_INSTANCE:
        i0 = instance
        i1 = i0
        i2 = i0
    x = attribute_component(geometry, offset, components, i0, i1, i2, u, v, 0)
    y = 0.0
    z = 0.0
    w = 0.0
    if components > 1:
        y = attribute_component(geometry, offset, components, i0, i1, i2, u, v, 1)
    if components > 2:
        z = attribute_component(geometry, offset, components, i0, i1, i2, u, v, 2)
    if components > 3:
        w = attribute_component(geometry, offset, components, i0, i1, i2, u, v, 3)
    return x, y, z, w, components


@kernel
def to_object(geometry, instance, time, p):
    """World to object space; the point itself where there is no object."""
    if instance < 0:
        return p
    return point_to_object(geometry, instance, time, p)


@kernel
def unit_normal_to_object(geometry, instance, time, n):
    """World normal to object space, unit."""
    if instance < 0:
        return n
    return normalize(normal_to_object(geometry, instance, time, n))


@kernel
def unit_normal_to_world(geometry, instance, time, n):
    """Object space normal to world, unit."""
    if instance < 0:
        return n
    return normalize(normal_to_world(geometry, instance, time, n))


@kernel
def first_normal(geometry, points, lane):
    """MESH_FIRST_NORMAL of the point's mesh, -1 where it is flat."""
    mesh = geometry.instance_table[points.integer[lane, POINT_INSTANCE], INSTANCE_MESH]
    return geometry.mesh_table[mesh, MESH_FIRST_NORMAL]


@kernel
def outward_ng(points, lane):
    """Geometric normal, not flipped on back faces."""
    ng = read_point(points, lane, POINT_NG)
    if points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING:
        return negate(ng)
    return ng


@kernel
def corner_normals(geometry, points, lane, first):
    """The corners' normals of the point's triangle, in the space its mesh is stored in; `first` is not -1."""
    mesh = geometry.instance_table[points.integer[lane, POINT_INSTANCE], INSTANCE_MESH]
    return normals_at(geometry, mesh, first, points.integer[lane, POINT_TRIANGLE], points.real[lane, POINT_TIME])


@kernel
def blend3(a, b, c, u, v):
    """(1 - u - v) a + u b + v c."""
    w = 1.0 - u - v
    return (
        w * a[0] + u * b[0] + v * c[0],
        w * a[1] + u * b[1] + v * c[1],
        w * a[2] + u * b[2] + v * c[2],
    )


@kernel
def smooth_normal_object(geometry, points, lane, u, v):
    """Unit interpolated normal in object space, outward (not flipped on back faces)."""
    instance = points.integer[lane, POINT_INSTANCE]
    time = points.real[lane, POINT_TIME]
    first = first_normal(geometry, points, lane)
    if first < 0:
        return unit_normal_to_object(geometry, instance, time, outward_ng(points, lane))
    a, b, c = corner_normals(geometry, points, lane, first)
    n = blend3(a, b, c, u, v)
    if geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
        return unit_normal_to_object(geometry, instance, time, n)
    return normalize(n)


@kernel
def blended_object_normal(geometry, points, lane):
    """Object space corner normals blended but not normalised, outward: the frame of tangent space normal maps."""
    instance = points.integer[lane, POINT_INSTANCE]
    time = points.real[lane, POINT_TIME]
    first = first_normal(geometry, points, lane)
    if first < 0:
        return unit_normal_to_object(geometry, instance, time, outward_ng(points, lane))
    a, b, c = corner_normals(geometry, points, lane, first)
    if geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
        a = unit_normal_to_object(geometry, instance, time, a)
        b = unit_normal_to_object(geometry, instance, time, b)
        c = unit_normal_to_object(geometry, instance, time, c)
    return blend3(a, b, c, points.real[lane, POINT_U], points.real[lane, POINT_V])


@kernel
def uv_tangent_object(geometry, points, lane, slot, uv_slot):
    """Tangent of a UV map in object space and the bitangent's sign (0 = neither tangents nor UVs).

    Reads the tangent attribute where the mesh has one, else takes the triangle's own dP/du.
    """
    instance = points.integer[lane, POINT_INSTANCE]
    triangle = points.integer[lane, POINT_TRIANGLE]
    u = points.real[lane, POINT_U]
    v = points.real[lane, POINT_V]
    x, y, z, w, components = fetch_attribute(geometry, instance, triangle, slot, u, v)
    if components >= 3:
        return (x, y, z), (-1.0 if w < 0.0 else 1.0)
    u0, v0, _z, _w, components = fetch_attribute(geometry, instance, triangle, uv_slot, 0.0, 0.0)
    if components < 2:
        return (0.0, 0.0, 0.0), 0.0
    u1, v1, _z, _w, _c = fetch_attribute(geometry, instance, triangle, uv_slot, 1.0, 0.0)
    u2, v2, _z, _w, _c = fetch_attribute(geometry, instance, triangle, uv_slot, 0.0, 1.0)
    determinant = (u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0)
    if determinant == 0.0:
        return (0.0, 0.0, 0.0), 0.0
    time = points.real[lane, POINT_TIME]
    e1, e2 = edges(geometry, instance, triangle, time)
    tangent = subtract(scale(e1, (v2 - v0) / determinant), scale(e2, (v1 - v0) / determinant))
    tangent = normalize(direction_to_object(geometry, instance, time, tangent))
    return tangent, (1.0 if determinant > 0.0 else -1.0)


@kernel
def generated(geometry, points, lane, axis, width):
    """Generated coordinates of `mirrored_position`: its place in the mesh's texture space box, before deformation."""
    instance = points.integer[lane, POINT_INSTANCE]
    p = mirrored_position(points, lane, axis, width)
    if instance < 0:
        return p
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    box = geometry.texture_space
    local = point_to_object(geometry, instance, points.real[lane, POINT_TIME], p)
    slot = geometry.mesh_table[mesh, MESH_UNDEFORMED]
    if slot >= 0:
        u, v = displaced_barycentrics(geometry, points, lane, axis, width)
        triangle = points.integer[lane, POINT_TRIANGLE]
        x, y, z, _w, components = fetch_attribute(geometry, instance, triangle, slot, u, v)
        if components == 3:
            local = (x, y, z)
    return (
        generated_axis(box, mesh, 0, local[0]),
        generated_axis(box, mesh, 1, local[1]),
        generated_axis(box, mesh, 2, local[2]),
    )


@kernel
def generated_axis(box, mesh, axis, x):
    """One coordinate of `generated`; the middle where the box is flat."""
    half = box[mesh, 3 + axis]
    if half != 0.0:
        return 0.5 + 0.5 * (x - box[mesh, axis]) / half
    return 0.5


@kernel
def radial_tangent(geometry, points, lane, axis):
    """Cycles' radial tangent about `axis` (0, 1, 2) from Generated coordinates, perpendicular to the normal."""
    g = generated(geometry, points, lane, 0, 0.0)
    if axis == 0:
        t = (0.0 * g[0], 0.5 - g[2], g[1] - 0.5)
    elif axis == 1:
        t = (0.5 - g[2], 0.0 * g[0], g[0] - 0.5)
    else:
        t = (0.5 - g[1], g[0] - 0.5, 0.0 * g[2])
    return orthogonal_tangent(geometry, points, lane, t)


@kernel
def orthogonal_tangent(geometry, points, lane, t):
    """Object space tangent `t` to world, made perpendicular to the shading normal."""
    n = read_point(points, lane, POINT_NS)
    instance = points.integer[lane, POINT_INSTANCE]
    world = unit_normal_to_world(geometry, instance, points.real[lane, POINT_TIME], t)
    return cross(n, normalize(cross(world, n)))
