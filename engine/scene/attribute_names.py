# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of attributes that no host has: what the engine itself reads of meshes."""

#: Positions before deformation, POINT.
UNDEFORMED = "__undeformed"
#: Of meshes that their materials displace: normals of vertices over all faces around them, POINT, where Cycles has such
#: (where it has normals of corners there are none); and which triangles are smooth, FACE, 1 or 0.
VERTEX_NORMALS = "__vertex_normals"
SMOOTH = "__smooth"
#: Which corners of a vertex stay together when the mesh is displaced, CORNER, by any number; without it all do.
FANS = "__fans"
#: What a displaced mesh had before, for materials that ask: positions, POINT, and normals, CORNER, 0 on flat faces.
UNDISPLACED = "__undisplaced"
UNDISPLACED_NORMALS = "__undisplaced_normals"
#: Behind the name of a UV map: its tangents, CORNER, width 4; and those after displacement.
TANGENT = ".tangent"
DISPLACED_TANGENT = ".displaced_tangent"
#: Outputs of Geometry nodes that are attributes of meshes: POINT and FACE, width 1.
GEOMETRY_ATTRIBUTES = {"Pointiness": "standard:pointiness", "Random Per Island": "standard:random_per_island"}
#: Before the outputs of Particle Info, and these with their widths: properties of instances.
PARTICLE = "particle:"
PARTICLE_OUTPUTS = {
    "Index": 1, "Random": 1, "Age": 1, "Lifetime": 1, "Location": 3, "Size": 1, "Velocity": 3, "Angular Velocity": 3
}  # fmt: skip
