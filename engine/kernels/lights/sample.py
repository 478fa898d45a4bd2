# SPDX-License-Identifier: GPL-3.0-or-later
"""Light sampling as the stages use it: `sample_light` and the densities of hits, all with the tree's choice included.

A hit must be weighed for the same `Receiver` that the sample was drawn for. Lights that are a delta (points without a
radius, suns without an angle, area lights without spread) are found by sampling alone: `use_mis` is False.
"""

import numpy as np

from engine.kernels.bsdf import keeps_to_geometry
from engine.kernels.constants import DISTANT
from engine.kernels.lights.background import (
    ask_for_columns,
    ask_for_guide,
    disc_of,
    disc_pdf,
    find_column,
    find_row,
    map_pdf,
    patch_of,
    patch_pdf,
    sample_cell,
    sample_disc,
    sample_patch,
)
from engine.kernels.lights.lamps import sample_lamp
from engine.kernels.lights.light import Choice, LightSample
from engine.kernels.lights.linked_portals import has_portals, of_portals, sample_linked_portals, with_portals
from engine.kernels.lights.linking import (
    background_emitter,
    emitter_in_tree,
    first_patch,
    has_blockers,
    tree_of_emitter,
)
from engine.kernels.lights.tree import (
    cluster_of,
    cluster_pmf,
    emitter_pmf,
    pick_emitter,
    selection_row,
    tree_choice,
)
from engine.kernels.lights.triangle import emissive_triangle, sample_triangle, triangle_pdf
from engine.kernels.vector import add, cross, dot, length, scale
from engine.runtime.jit import kernel
from engine.state.lights import (
    EMITTER_BACK,
    EMITTER_FLAGS,
    EMITTER_FRONT,
    EMITTER_INSTANCE,
    EMITTER_KIND,
    EMITTER_LAMP,
    EMITTER_MIRRORED,
    EMITTER_PROGRAM,
    EMITTER_TRIANGLE,
    EMITTER_VISIBILITY,
    HEADER_BACKGROUND_MAX_BOUNCES,
    HEADER_BACKGROUND_SHADOW,
    HEADER_BANDS,
    HEADER_FIRST_DISC,
    HEADER_SECTORS,
    LIGHT_BACKGROUND,
    LIGHT_TRIANGLE,
    TRIANGLE_RADIANCE,
)

_UNLIMITED = 1 << 20


@kernel
def _sides(flags, facing):
    """Whether a triangle is sampled towards the side where dot(cross(edge1, edge2), wi) = `facing`, wi towards it."""
    is_front = facing < 0.0
    if flags & EMITTER_MIRRORED:
        is_front = facing > 0.0
    if is_front:
        return (flags & EMITTER_FRONT) != 0
    return (flags & EMITTER_BACK) != 0


@kernel
def finds_all(lights, closures, lane, ng):
    """Whether a surface leaves the background's dim parts to scattering, which finds all that light sampling would.

    Regions that have learned to choose among its patches sample what they have learned all the same.
    """
    return lights.compensated_conditional.shape[0] > 0 and keeps_to_geometry(closures, lane, ng)


@kernel(forceinline=True)
def sample_light(lights, geometry, receiver, time, u_pick, u0, u1):
    """Choose an emitter and a direction towards it for next-event estimation.

    Parameters
    ----------
    lights : LightArrays
    geometry : GeometryArrays
        Read where emissive triangles move: those that do not are kept in world space in `lights`.
    receiver : Receiver
    time : float32 in [0, 1], of the shutter
    u_pick, u0, u1 : float32 in [0, 1)

    Returns
    -------
    LightSample
    """
    choice = choose_emitter(lights, receiver.tree, receiver.p, receiver.n, receiver.has_transmission, u_pick)
    drawn = draw_triangle(lights, geometry, choice.emitter, receiver.p, time, u0, u1)
    cell = draw_cell(lights, choice.emitter, choice.patch, receiver.leaves_dim, u0, u1)
    return sample_emitter(lights, geometry, choice, drawn, cell, receiver, time, u0, u1)


@kernel(forceinline=True)
def choose_emitter(lights, tree, p, n, has_transmission, u):
    """The emitter that `sample_light` chooses: Choice."""
    emitter, pmf, patch = pick_emitter(lights, selection_row(lights, tree, p), tree, p, n, has_transmission, u)
    return Choice(emitter, pmf, patch)


@kernel(forceinline=True)
def triangle_of(lights, geometry, emitter, time):
    """Whether an emitter that has been chosen is a triangle, and `emissive_triangle`; -1 is no emitter."""
    if emitter >= 0 and lights.emitters[emitter, EMITTER_KIND] == LIGHT_TRIANGLE:
        return True, emissive_triangle(lights, geometry, emitter, time)
    nothing = 0.0 * time
    zero = (nothing, nothing, nothing)
    return False, (zero, zero, zero)


@kernel
def draw_triangle(lights, geometry, emitter, p, time, u0, u1):
    """Draw a point of an emitter that has been chosen, if it is a triangle; returns as `sample_triangle` does."""
    is_triangle, (v0, edge1, edge2) = triangle_of(lights, geometry, emitter, time)
    if is_triangle:
        return sample_triangle(v0, edge1, edge2, p, u0, u1)
    nothing = 0.0 * u0
    return nothing, p, nothing, nothing, nothing


@kernel
def is_of_map(lights, emitter, patch):
    """Whether a direction is drawn from the whole map of the background; takes what `pick_emitter` returns."""
    if emitter < 0 or patch >= 0 or lights.emitters[emitter, EMITTER_KIND] != LIGHT_BACKGROUND:
        return False
    return lights.emitters[emitter, EMITTER_LAMP] < 0


@kernel
def row_of_map(lights, leaves_dim, u0, u1):
    """Row of the map in which a direction is drawn. What `ask_for_cell` reads is asked for."""
    _, u1 = of_portals(lights, u1)
    row_count = lights.map_conditional.shape[0]
    if leaves_dim:
        row_count = lights.compensated_conditional.shape[0]
        row = find_row(lights.compensated_marginal, lights.compensated_guide, row_count, u1)
        ask_for_guide(lights.compensated_guide, row, u0)
    else:
        row = find_row(lights.map_marginal, lights.map_guide, row_count, u1)
        ask_for_guide(lights.map_guide, row, u0)
    return row


@kernel
def ask_for_cell(lights, leaves_dim, row, u0):
    """Have fetched what `column_of_map` reads."""
    if leaves_dim:
        ask_for_columns(lights.compensated_conditional, lights.compensated_guide, row, u0)
    else:
        ask_for_columns(lights.map_conditional, lights.map_guide, row, u0)


@kernel
def column_of_map(lights, leaves_dim, row, u0):
    """Column of the map in which a direction is drawn."""
    if leaves_dim:
        return find_column(lights.compensated_conditional, lights.compensated_guide, row, u0)
    return find_column(lights.map_conditional, lights.map_guide, row, u0)


@kernel
def draw_cell(lights, emitter, patch, leaves_dim, u0, u1):
    """Row and column of the map in which a direction is drawn; (-1, -1): in none."""
    row = np.int64(-1)
    column = np.int64(-1)
    if is_of_map(lights, emitter, patch):
        row = row_of_map(lights, leaves_dim, u0, u1)
        column = column_of_map(lights, leaves_dim, row, u0)
    return row, column


@kernel(forceinline=True)
def sample_emitter(lights, geometry, choice, drawn, cell, receiver, time, u0, u1):
    """Draw a direction towards an emitter that has been chosen; takes and returns the rest as `sample_light` does.

    Parameters
    ----------
    choice : Choice
    drawn : tuple, `draw_triangle` of the same numbers; not read unless the emitter is a triangle
    cell : tuple, `draw_cell` of the same numbers; not read unless the emitter is the background, and no patch of it
    """
    emitter = choice.emitter
    if emitter < 0:
        return _no_sample(receiver.p, u0)
    kind = lights.emitters[emitter, EMITTER_KIND]
    if kind == LIGHT_TRIANGLE:
        return _sample_triangle(lights, geometry, choice, drawn, time, u0)
    if kind == LIGHT_BACKGROUND:
        return _sample_background(lights, choice, cell, receiver, u0, u1)
    return sample_lamp(lights, choice, receiver, u0, u1)


@kernel(forceinline=True)
def _no_sample(p, u0):
    """Where no emitter was chosen: LightSample."""
    none = 0.0 * u0
    one = none + 1.0
    up = (none, none, one)
    return LightSample(
        none, -1, 0, up, none, p, up, none, none, -1, -1, -1, (one, one, one), 0, True, _UNLIMITED, True, False, none
    )


@kernel(forceinline=True)
def _sample_triangle(lights, geometry, choice, drawn, time, u0):
    """The point that was drawn of a triangle: LightSample."""
    emitter = choice.emitter
    v0, edge1, edge2 = emissive_triangle(lights, geometry, emitter, time)
    pdf, wi, distance, u, v = drawn
    normal = cross(edge1, edge2)
    facing = dot(normal, wi)
    flags = lights.emitters[emitter, EMITTER_FLAGS]
    if facing == 0.0 or not _sides(flags, facing):
        pdf = 0.0 * u0
    point = add(v0, add(scale(edge1, u), scale(edge2, v)))
    ng = scale(normal, (-1.0 if facing > 0.0 else 1.0) / length(normal))
    instance = np.int64(lights.emitters[emitter, EMITTER_INSTANCE])
    triangle = np.int64(lights.emitters[emitter, EMITTER_TRIANGLE])
    program = np.int64(lights.emitters[emitter, EMITTER_PROGRAM])
    visibility = np.int64(lights.emitters[emitter, EMITTER_VISIBILITY])
    radiance = (
        lights.triangles[emitter, TRIANGLE_RADIANCE],
        lights.triangles[emitter, TRIANGLE_RADIANCE + 1],
        lights.triangles[emitter, TRIANGLE_RADIANCE + 2],
    )
    cast_shadow, use_mis = True, not has_blockers(lights, emitter)
    shows_back = facing < 0.0 if flags & EMITTER_MIRRORED else facing > 0.0
    return LightSample(
        pdf * choice.pmf, emitter, LIGHT_TRIANGLE, wi, distance, point, ng, u, v, instance, triangle, program, radiance,
        visibility, cast_shadow, _UNLIMITED, use_mis, shows_back, choice.pmf,
    )  # fmt: skip


@kernel(forceinline=True)
def _sample_background(lights, choice, cell, receiver, u0, u1):
    """Draw a direction towards the background: LightSample."""
    emitter = choice.emitter
    disc = np.int64(lights.emitters[emitter, EMITTER_LAMP])
    if disc >= 0:
        pdf, wi = sample_disc(lights.discs, disc, u0, u1)
        pdf *= choice.pmf
    else:
        pdf, wi = _sample_map(lights, choice, cell, receiver, u0, u1)
    none = 0.0 * u0
    one = none + 1.0
    # Each direction is either the map's or one disc's.
    if disc_of(lights.discs, wi) != disc:
        pdf = none
    program = np.int64(lights.emitters[emitter, EMITTER_PROGRAM])
    visibility = np.int64(lights.emitters[emitter, EMITTER_VISIBILITY])
    cast_shadow, use_mis, shows_back = lights.header[HEADER_BACKGROUND_SHADOW] != 0, True, False
    max_bounces = np.int64(lights.header[HEADER_BACKGROUND_MAX_BOUNCES])
    return LightSample(
        pdf, emitter, LIGHT_BACKGROUND, wi, DISTANT, wi, (-wi[0], -wi[1], -wi[2]), none, none, -1, -1,
        program, (one, one, one), visibility, cast_shadow, max_bounces, use_mis, shows_back, choice.pmf,
    )  # fmt: skip


@kernel
def _sample_map(lights, choice, cell, receiver, u0, u1):
    """Draw a direction towards the background by its map or through portals: density [sr^-1], and the direction."""
    tree, is_through_portal = tree_of_emitter(lights, choice.emitter), False
    if has_portals(lights):
        is_through_portal, u1 = of_portals(lights, u1)
    if choice.patch >= 0:
        pdf, wi = sample_patch(
            lights.map_marginal, lights.map_conditional, lights.map_patches, lights.header[HEADER_BANDS],
            lights.header[HEADER_SECTORS], choice.patch - first_patch(lights, tree), u0, u1,
        )
    elif receiver.leaves_dim:
        pdf, wi = sample_cell(lights.compensated_marginal, lights.compensated_conditional, cell[0], cell[1], u0, u1)
    else:
        pdf, wi = sample_cell(lights.map_marginal, lights.map_conditional, cell[0], cell[1], u0, u1)
    if not has_portals(lights):
        return pdf * choice.pmf, wi
    if is_through_portal:
        x, y, z, possible = sample_linked_portals(lights, receiver.p, u0, u1)
        if possible > 0.0:
            wi = (x, y, z)
    row = selection_row(lights, tree, receiver.p) if choice.patch >= 0 else np.int64(-1)
    return _map_pdf(lights, tree, row, choice.pmf, receiver.p, receiver.leaves_dim, wi), wi


@kernel
def _map_pdf(lights, tree, row, pmf, p, leaves_dim, wi):
    """Density [sr^-1] with which a direction in no disc is drawn by the background's map or through portals.

    Parameters
    ----------
    row : int, of the region that chooses among the map's patches; -1: the map is chosen as a whole
    pmf : float32, with which it is then
    """
    if row >= 0:
        patch, pdf = patch_pdf(
            lights.map_marginal, lights.map_conditional, lights.map_patches, lights.header[HEADER_BANDS],
            lights.header[HEADER_SECTORS], wi,
        )
        first = first_patch(lights, tree)
        pdf *= cluster_pmf(lights, row, first + patch)
        if has_portals(lights):
            last = first + np.int64(lights.header[HEADER_BANDS]) * np.int64(lights.header[HEADER_SECTORS])
            cumulative = lights.selection.cumulative
            pdf = with_portals(lights, p, wi, pdf, cumulative[row, last] - cumulative[row, first])
        return pdf
    if leaves_dim:
        pdf = map_pdf(lights.compensated_marginal, lights.compensated_conditional, wi) * pmf
    else:
        pdf = map_pdf(lights.map_marginal, lights.map_conditional, wi) * pmf
    if has_portals(lights):
        pdf = with_portals(lights, p, wi, pdf, pmf)
    return pdf


@kernel
def triangle_emitter_pdf(lights, geometry, receiver, instance, triangle, wi, distance, time):
    """Density [sr^-1] with which `sample_light` would have proposed this point of an emissive triangle.

    `wi` and `distance` lead from the receiver to the hit, through transparent surfaces if need be. 0 for triangles that
    are not sampled, and for sides that are not: such a hit counts whole. Which side was hit follows from `wi`.
    """
    p, tree = receiver.p, receiver.tree
    emitter = triangle_emitter(lights, tree, instance, triangle)
    if emitter < 0:
        return 0.0 * distance
    v0, edge1, edge2 = emissive_triangle(lights, geometry, emitter, time)
    if not _sides(lights.emitters[emitter, EMITTER_FLAGS], dot(cross(edge1, edge2), wi)):
        return 0.0 * distance
    pdf = triangle_pdf(v0, edge1, edge2, p, wi, distance)
    if not pdf > 0.0:
        return pdf
    return pdf * emitter_pmf(
        lights, selection_row(lights, tree, p), emitter, p, receiver.n, receiver.has_transmission
    )


@kernel
def triangle_emitter(lights, tree, instance, triangle):
    """Row of `lights.emitters` of an emissive triangle in a light tree; -1: it is not sampled."""
    first = lights.lookup_offset[instance, 0]
    if first < 0:
        return np.int64(-1)
    return emitter_in_tree(lights, tree, np.int64(lights.lookup[first + triangle - lights.lookup_offset[instance, 1]]))


@kernel
def emitter_towards(lights, tree, direction):
    """The emitter that a direction of the background is of: a disc, or the map; -1: none, it is not sampled."""
    return _emitter_of(lights, tree, disc_of(lights.discs, direction))


@kernel
def _emitter_of(lights, tree, disc):
    if disc >= 0:
        return emitter_in_tree(lights, tree, np.int64(lights.header[HEADER_FIRST_DISC]) + disc)
    return background_emitter(lights, tree)


@kernel
def background_pdf(lights, tree, p, n, has_transmission, leaves_dim, direction):
    """Density [sr^-1] with which `sample_light` would have proposed this direction as background; 0: never."""
    disc = disc_of(lights.discs, direction)
    emitter = _emitter_of(lights, tree, disc)
    if emitter < 0:
        return 0.0 * p[0]
    row = selection_row(lights, tree, p)
    if disc >= 0:
        return disc_pdf(lights.discs, disc) * emitter_pmf(lights, row, emitter, p, n, has_transmission)
    one = 0.0 * p[0] + 1.0
    if row >= 0:
        return _map_pdf(lights, tree, row, one, p, leaves_dim, direction)
    pdf = _map_pdf(lights, tree, row, one, p, leaves_dim, direction)
    if not pdf > 0.0:
        return pdf
    return pdf * emitter_pmf(lights, row, emitter, p, n, has_transmission)


@kernel
def cluster_choice(lights, emitter, pmf, p, n, has_transmission, leaves_dim, wi):
    """The cluster of a light sample, and how likely it was chosen; `emitter` and `pmf` as `sample_light` said.

    Where the background's dim parts are left to scattering, or it is drawn through portals, its density within a patch
    is another one: probabilities are then such that they give, times the density of the whole map within the patch, the
    density of the direction.

    Returns
    -------
    cluster : int
    pmf : float, with which `sample_light` has chosen it
    tree_pmf : float, with which the light tree alone would have; 0 for what it leaves to scattering
    """
    patch = -1
    ratio = 0.0 * p[0] + 1.0
    tree = tree_of_emitter(lights, emitter)
    if emitter == background_emitter(lights, tree):
        patch = first_patch(lights, tree) + patch_of(
            lights.map_conditional, lights.header[HEADER_BANDS], lights.header[HEADER_SECTORS], wi
        )
        if leaves_dim or has_portals(lights):
            whole = map_pdf(lights.map_marginal, lights.map_conditional, wi)
            part = _map_pdf(lights, tree, np.int64(-1), ratio, p, leaves_dim, wi)
            ratio = part / whole if whole > 0.0 else 0.0 * whole
    row = selection_row(lights, tree, p)
    cluster, chosen_pmf = cluster_of(lights, emitter, patch, pmf, p, n, has_transmission)
    if row < 0:
        chosen_pmf *= ratio
        return cluster, chosen_pmf, chosen_pmf
    tree_pmf = ratio * tree_choice(lights, emitter, cluster, p, n, has_transmission)
    chosen_pmf = cluster_pmf(lights, row, cluster)
    if patch >= 0 and has_portals(lights):
        whole = map_pdf(lights.map_marginal, lights.map_conditional, wi)
        drawn = _map_pdf(lights, tree, row, ratio, p, leaves_dim, wi)
        chosen_pmf = drawn * lights.cluster_share[cluster] / whole if whole > 0.0 else 0.0 * whole
    return cluster, chosen_pmf, tree_pmf


@kernel
def tree_share(lights, emitter, p, n, has_transmission, leaves_dim, wi):
    """What the light tree alone would have as density of a light sample, over the density that it has: float32.

    Parameters
    ----------
    emitter : int
        Row of `lights.emitters`.
    p, n, has_transmission, leaves_dim, wi : as `cluster_choice` takes them
    """
    if selection_row(lights, tree_of_emitter(lights, emitter), p) < 0:
        return np.float32(1.0)
    _, pmf, tree_pmf = cluster_choice(
        lights, emitter, np.float32(1.0), p, n, has_transmission, leaves_dim, wi
    )
    return np.float32(tree_pmf / pmf) if pmf > 0.0 else np.float32(0.0)
