# SPDX-License-Identifier: GPL-3.0-or-later
"""Looking up the SD-tree at a point, and sampling the quadtree found there.

References: Müller et al. 2017, "Practical Path Guiding for Efficient Light-Transport Simulation"; Müller 2019,
"Practical Path Guiding in Production" (SIGGRAPH course), for the stochastic look-up.
"""

import math

import numpy as np

from engine.guiding.fields.sdtree.field import QUAD_LEAF, SPLIT_PHI, SPLIT_Z
from engine.kernels.binary_tree import find_leaf
from engine.kernels.constants import INV_FOUR_PI, INV_TWO_PI, ONE_MINUS_EPSILON, TWO_PI
from engine.kernels.vector import load
from engine.runtime.jit import kernel

#: Part of the predicted radiance that comes evenly from all directions, as in `predict_vmm`.
_EVEN_SHARE = np.float32(0.3)
_TEN_BITS = np.float32(1.0 / 1024.0)


@kernel
def find_blurred_region(field, region, p, bits):
    """Region of a point drawn from a box about p, as large as the cell that p lies in.

    Records are spread so, and look-ups may be: a border between cells then shows neither in what is learned nor in
    what is sampled.

    Parameters
    ----------
    field : SdTreeField
    region : int, of `find_leaf` at p
    p : float32 tuple, world
    bits : uint32
        Random bits, ten for each coordinate.

    Returns
    -------
    int, -1 only where `region` is
    """
    if region < 0:
        return -1
    x = p[0] + (np.float32(bits & 1023) - 511.5) * _TEN_BITS * field.extent[region, 0]
    y = p[1] + (np.float32((bits >> 10) & 1023) - 511.5) * _TEN_BITS * field.extent[region, 1]
    z = p[2] + (np.float32((bits >> 20) & 1023) - 511.5) * _TEN_BITS * field.extent[region, 2]
    x = min(max(x, field.bounds[0, 0]), field.bounds[1, 0])
    y = min(max(y, field.bounds[0, 1]), field.bounds[1, 1])
    z = min(max(z, field.bounds[0, 2]), field.bounds[1, 2])
    return find_leaf(field, (x, y, z))


@kernel
def look_up_sdtree(field, p, bits, is_blurred):
    """Region to guide with at point p: int, -1 = none (outside the bounds, or the cell has seen no light).

    Parameters
    ----------
    field : SdTreeField
    p : float32 tuple, world
    bits : uint32
        Random bits, see `find_blurred_region`.
    is_blurred : bool
        Whether to draw the cell from p's surroundings; a cell so drawn that has seen no light is not taken.
    """
    region = find_leaf(field, p)
    if region < 0 or field.is_ready[region] == 0:
        return -1
    if is_blurred:
        drawn = find_blurred_region(field, region, p, bits)
        if drawn >= 0 and field.is_ready[drawn] != 0:
            return drawn
    return region


@kernel
def find_sdtree_regions(field, position, region):
    """Write `find_leaf` of each point.

    Parameters
    ----------
    field : SdTreeField
    position : float32 (P, 3), world
    region : int32 (P,), written
    """
    for row in range(position.shape[0]):
        region[row] = find_leaf(field, load(position, row))


@kernel
def prepare_sdtree_guide(guide, lane, region):
    """Let a lane sample from a region, of `look_up_sdtree` and not negative."""
    guide.region[lane] = region
    guide.fluence[lane] = guide.tree.fluence[region]


@kernel
def direction_to_square(wi):
    """Point of the unit square (phi / 2 pi, (z + 1) / 2) of a unit direction: two float32 in [0, 1).

    Any other vector gives a point of the square too; NaN gives 0.
    """
    x = math.atan2(wi[1], wi[0]) * INV_TWO_PI
    x += 1.0 if x < 0.0 else np.float32(0.0)
    y = 0.5 * wi[2] + 0.5
    # Comparisons that fail for NaN.
    x = x if x > 0.0 else np.float32(0.0)
    y = y if y > 0.0 else np.float32(0.0)
    return min(x, ONE_MINUS_EPSILON), min(y, ONE_MINUS_EPSILON)


@kernel
def square_to_direction(x, y):
    """Unit direction of a point of the unit square, the inverse of `direction_to_square`: float32 tuple."""
    sine = 2.0 * math.sqrt(max(y * (1.0 - y), 0.0))
    phi = TWO_PI * x
    return sine * math.cos(phi), sine * math.sin(phi), 2.0 * y - 1.0


@kernel
def eval_sdtree(guide, lane, wi):
    """Density of `sample_sdtree` at unit direction wi: float32 [sr^-1], 0 if wi is NaN."""
    if not abs(wi[0]) + abs(wi[1]) + abs(wi[2]) < 4.0:
        return np.float32(0.0)
    tree = guide.tree
    root = np.int64(tree.quad_root[guide.region[lane]])
    x, y = direction_to_square(wi)
    pdf = INV_FOUR_PI
    node = np.int64(root)
    while True:
        x *= 2.0
        y *= 2.0
        column = 1 if x >= 1.0 else 0
        row = 1 if y >= 1.0 else 0
        x -= np.float32(column)
        y -= np.float32(row)
        phi_share = tree.quad_split[node, SPLIT_PHI]
        z_share = tree.quad_split[node, SPLIT_Z + column]
        pdf *= 4.0 * (1.0 - phi_share if column == 1 else phi_share) * (1.0 - z_share if row == 1 else z_share)
        child = np.int64(tree.quad_child[node, column + 2 * row])
        if child == QUAD_LEAF:
            return pdf
        node = root + child


@kernel
def sample_sdtree(guide, lane, u0, u1, u2):
    """Draw a unit direction from lane `lane` of `guide`: float32 tuple.

    Parameters
    ----------
    guide : SdTreeGuide
    lane : int
    u0, u1 : float32 in [0, 1): along phi and z; what is left of them after the choice of a quadrant chooses on
    u2 : float32
        Not used: a quadtree needs no third number, other guides do.
    """
    tree = guide.tree
    root = np.int64(tree.quad_root[guide.region[lane]])
    x = np.float32(0.0)
    y = np.float32(0.0)
    size = np.float32(1.0)
    node = np.int64(root)
    while True:
        phi_share = tree.quad_split[node, SPLIT_PHI]
        is_upper = u0 >= phi_share
        z_share = tree.quad_split[node, SPLIT_Z + 1] if is_upper else tree.quad_split[node, SPLIT_Z]
        is_above = u1 >= z_share
        child = np.int64(tree.quad_child[node, (1 if is_upper else 0) + (2 if is_above else 0)])
        u0 = (u0 - phi_share if is_upper else u0) / (1.0 - phi_share if is_upper else phi_share)
        u1 = (u1 - z_share if is_above else u1) / (1.0 - z_share if is_above else z_share)
        u0 = min(u0, ONE_MINUS_EPSILON)
        u1 = min(u1, ONE_MINUS_EPSILON)
        size *= 0.5
        x += size if is_upper else np.float32(0.0)
        y += size if is_above else np.float32(0.0)
        if child == QUAD_LEAF:
            break
        node = root + child
    return square_to_direction(x + size * u0, y + size * u1)


@kernel
def predict_sdtree(guide, lane, wi, guide_pdf):
    """Incident radiance (mean over channels) along unit direction wi, given `guide_pdf` = `eval_sdtree` there.

    Fluence times density, part of it held even as in `predict_vmm`. A variance-aware tree's density is that of the
    root of the second moment: larger than radiance alone gives where the light varies.
    """
    density = (1.0 - _EVEN_SHARE) * guide_pdf + _EVEN_SHARE * INV_FOUR_PI
    return guide.fluence[lane] * density
