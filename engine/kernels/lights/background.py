# SPDX-License-Identifier: GPL-3.0-or-later
"""The background as a light: directions drawn from a map of its radiance, or from discs in it.

Rows are bands of latitude, row 0 around z = -1; columns follow Blender's equirectangular projection:
u = 1/2 - atan2(y, x) / 2 pi. Within a cell directions are uniform in solid angle, so the density is constant per cell
and exact at the poles.
"""

import math

import numpy as np

from engine.kernels.angles import sine_and_cosine, upper_angle
from engine.kernels.constants import INV_PI, INV_TWO_PI, PI, TWO_PI
from engine.kernels.eight import WIDTH, count_of, load_from
from engine.kernels.lights.mapping import uniform_cone
from engine.kernels.prefetch import prefetch_byte
from engine.runtime.jit import kernel
from engine.state.lights import DISC_AXIS, DISC_ONE_MINUS_COS, MAP_GUIDE_SIZE

_GUIDE_STEPS = np.float32(MAP_GUIDE_SIZE)
_FLOAT_BYTES = 4


@kernel
def find_row(marginal, guide, row_count, u):
    """Last row of a map whose cumulative probability is not above u."""
    step = int(u * _GUIDE_STEPS)
    low = np.int64(guide[row_count, step])
    high = np.int64(guide[row_count, step + 1]) + 1
    while high - low > 1:
        middle = (low + high) >> 1
        if marginal[middle, 0] <= u:
            low = middle
        else:
            high = middle
    return low


@kernel
def _search(cumulative, row, low, high, u):
    """Last column of [low, high) of a row whose value is not above u."""
    while high - low > 1:
        middle = (low + high) >> 1
        if cumulative[row, middle] <= u:
            low = middle
        else:
            high = middle
    return low


@kernel
def ask_for_guide(guide, row, u):
    """Fetch what `ask_for_columns` reads."""
    prefetch_byte(guide, row, np.int64(u * _GUIDE_STEPS) * _FLOAT_BYTES)


@kernel
def ask_for_columns(conditional, guide, row, u):
    """Fetch what `find_column` reads, or most of it."""
    step = int(u * _GUIDE_STEPS)
    first, last = np.int64(guide[row, step]), np.int64(guide[row, step + 1])
    prefetch_byte(conditional, row, first * _FLOAT_BYTES)
    prefetch_byte(conditional, row, ((first + last) >> 1) * _FLOAT_BYTES)
    prefetch_byte(conditional, row, (last + 1) * _FLOAT_BYTES)


@kernel
def find_column(conditional, guide, row, u):
    """Last column of a row whose cumulative probability is not above u."""
    step = int(u * _GUIDE_STEPS)
    low = np.int64(guide[row, step])
    high = np.int64(guide[row, step + 1]) + 1
    while high - low > 2 * WIDTH:
        middle = (low + high) >> 1
        if conditional[row, middle] <= u:
            low = middle
        else:
            high = middle
    if low + 2 * WIDTH >= conditional.shape[1]:
        return _search(conditional, row, low, high, u)
    # All values from `high` on are above u. The processor need not guess how each comparison ends.
    near = load_from(conditional, row, low + 1) <= u
    return low + count_of(near) + count_of(load_from(conditional, row, low + 1 + WIDTH) <= u)


@kernel
def _cell_pdf(marginal, conditional, row, column, column_count):
    probability = (marginal[row + 1, 0] - marginal[row, 0]) * (
        conditional[row, column + 1] - conditional[row, column]
    )
    height = marginal[row + 1, 1] - marginal[row, 1]
    return probability * np.float32(column_count) * INV_TWO_PI / height


@kernel
def _share_of(low, high, u):
    """How far between two cumulative probabilities u is: in [0, 1]."""
    return min(1.0, (u - low) / (high - low)) if high > low else 0.0 * u


@kernel
def _direction(marginal, row, column, column_count, dv, du):
    """Direction towards a point of a cell, which is so far across its row and column."""
    z = marginal[row, 1] + dv * (marginal[row + 1, 1] - marginal[row, 1])
    phi = PI - TWO_PI * ((np.float32(column) + du) / np.float32(column_count))
    r = math.sqrt(max(0.0, 1.0 - z * z))
    sine, cosine = sine_and_cosine(abs(phi))
    return r * cosine, r * (-sine if phi < 0.0 else sine), z


@kernel
def sample_cell(marginal, conditional, row, column, u0, u1):
    """Direction towards the background, of the numbers by which the cell was found, and its density [sr^-1]
    (0 = none).
    """
    column_count = conditional.shape[1] - 1
    dv = _share_of(marginal[row, 0], marginal[row + 1, 0], u1)
    du = _share_of(conditional[row, column], conditional[row, column + 1], u0)
    pdf = _cell_pdf(marginal, conditional, row, column, column_count)
    return pdf, _direction(marginal, row, column, column_count, dv, du)


@kernel
def find_cell(conditional, direction):
    """Row and column of the map's cell that a direction (any length) lies in."""
    row_count = conditional.shape[0]
    column_count = conditional.shape[1] - 1
    x, y, z = direction
    v = 1.0 - upper_angle(math.sqrt(x * x + y * y), z) * INV_PI
    turn = upper_angle(abs(y), x) * INV_TWO_PI
    u = 0.5 + turn if y < 0.0 else 0.5 - turn
    row = min(row_count - 1, max(0, int(v * np.float32(row_count))))
    column = min(column_count - 1, max(0, int(u * np.float32(column_count))))
    return row, column


@kernel
def map_pdf(marginal, conditional, direction):
    """Density [sr^-1] of `sample_map` for a direction (any length)."""
    row, column = find_cell(conditional, direction)
    return _cell_pdf(marginal, conditional, row, column, conditional.shape[1] - 1)


@kernel
def disc_of(discs, direction):
    """The first disc that a unit direction lies in, -1: none."""
    for k in range(discs.shape[0]):
        x = direction[0] - discs[k, DISC_AXIS]
        y = direction[1] - discs[k, DISC_AXIS + 1]
        z = direction[2] - discs[k, DISC_AXIS + 2]
        if 0.5 * (x * x + y * y + z * z) <= discs[k, DISC_ONE_MINUS_COS]:
            return np.int64(k)
    return np.int64(-1)


@kernel
def disc_pdf(discs, disc):
    """Density [sr^-1] of directions within a disc."""
    return INV_TWO_PI / discs[disc, DISC_ONE_MINUS_COS]


@kernel
def sample_disc(discs, disc, u0, u1):
    """Direction towards a disc, and its density [sr^-1]."""
    axis = (discs[disc, DISC_AXIS], discs[disc, DISC_AXIS + 1], discs[disc, DISC_AXIS + 2])
    wi, _ = uniform_cone(axis, discs[disc, DISC_ONE_MINUS_COS], u0, u1)
    return disc_pdf(discs, disc), wi


@kernel
def first_of_part(part, part_count, count):
    """First of `count` rows (columns) that lies in a band (sector) of `part_count`."""
    return (part * count + part_count - 1) // part_count


@kernel
def patch_of(conditional, bands, sectors, direction):
    """Number of the patch that a direction lies in."""
    row, column = find_cell(conditional, direction)
    return (row * bands // conditional.shape[0]) * sectors + column * sectors // (conditional.shape[1] - 1)


@kernel
def _patch_cell_pdf(marginal, conditional, patches, patch, first_row, row, column, west, east):
    """Density [sr^-1] within a patch of one of its cells; 0 where single precision leaves nothing of its row."""
    across = conditional[row, east] - conditional[row, west]
    if not across > 0.0:
        return 0.0 * across
    probability = patches[patch, row - first_row + 1] - patches[patch, row - first_row]
    probability *= (conditional[row, column + 1] - conditional[row, column]) / across
    height = marginal[row + 1, 1] - marginal[row, 1]
    return probability * np.float32(conditional.shape[1] - 1) * INV_TWO_PI / height


@kernel
def sample_patch(marginal, conditional, patches, bands, sectors, patch, u0, u1):
    """Direction towards a patch of the background, and its density [sr^-1] within the patch (0 = none)."""
    row_count = conditional.shape[0]
    column_count = conditional.shape[1] - 1
    band = patch // sectors
    sector = patch - band * sectors
    first_row = first_of_part(band, bands, row_count)
    last_row = first_of_part(band + 1, bands, row_count)
    west = first_of_part(sector, sectors, column_count)
    east = first_of_part(sector + 1, sectors, column_count)
    offset = _search(patches, patch, np.int64(0), np.int64(last_row - first_row), u1)
    row = first_row + offset
    dv = _share_of(patches[patch, offset], patches[patch, offset + 1], u1)
    begin = conditional[row, west]
    u0 = begin + u0 * (conditional[row, east] - begin)
    column = _search(conditional, row, np.int64(west), np.int64(east), u0)
    du = _share_of(conditional[row, column], conditional[row, column + 1], u0)
    pdf = _patch_cell_pdf(marginal, conditional, patches, patch, first_row, row, column, west, east)
    return pdf, _direction(marginal, row, column, column_count, dv, du)


@kernel
def patch_pdf(marginal, conditional, patches, bands, sectors, direction):
    """The patch that a direction (any length) lies in, and its density [sr^-1] within it."""
    row, column = find_cell(conditional, direction)
    band = row * bands // conditional.shape[0]
    sector = column * sectors // (conditional.shape[1] - 1)
    patch = band * sectors + sector
    west = first_of_part(sector, sectors, conditional.shape[1] - 1)
    east = first_of_part(sector + 1, sectors, conditional.shape[1] - 1)
    first_row = first_of_part(band, bands, conditional.shape[0])
    return patch, _patch_cell_pdf(marginal, conditional, patches, patch, first_row, row, column, west, east)
