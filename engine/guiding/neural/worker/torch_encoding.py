# SPDX-License-Identifier: GPL-3.0-or-later
"""What networks see of a point, in torch's operations: what a device needs of `encoding.py` and `grids.py`."""

from __future__ import annotations

import math

import torch

from engine.guiding.neural.networks.encoding import HASH_Y, HASH_Z
from engine.guiding.neural.networks.grids import PLANES
from engine.guiding.neural.networks.mixture.features import HASH_U
from engine.guiding.neural.networks.radiance import INNER_EXTENT

#: What the coordinates of a grid's points are multiplied with before they are hashed.
_PRIMES = (1, int(HASH_Y), int(HASH_Z), int(HASH_U))


def contract_torch(positions: torch.Tensor, center: torch.Tensor, inverse_extent: torch.Tensor) -> torch.Tensor:
    """`contract` of finite positions (N, 3) [m]."""
    u = (positions - center) * inverse_extent
    outer = torch.sign(u) * (1.0 - (1.0 - INNER_EXTENT) / u.abs().clamp(min=1.0))
    u = torch.where(u.abs() > 1.0, outer, INNER_EXTENT * u)
    return (0.5 + 0.5 * u).clamp(0.0, 1.0)


def one_blob(coordinate: torch.Tensor, bin_count: int) -> torch.Tensor:
    """`blob` for coordinates (N,) in [0, 1], all bins: (N, bin_count); differentiable."""
    position = coordinate[:, None] * (bin_count - 2)
    distance = (position - torch.arange(bin_count, device=coordinate.device) + 0.5).abs()
    return torch.where(distance < 0.5, 0.75 - distance.square(), 0.5 * (1.5 - distance).clamp(min=0.0).square())


def blobs(coordinates: torch.Tensor, bin_count: int) -> torch.Tensor:
    """`one_blob` of each column of coordinates (N, D) in [0, 1]: (N, D * bin_count)."""
    return torch.cat([one_blob(column, bin_count) for column in coordinates.unbind(1)], dim=1)


def frequencies(u: torch.Tensor, count: int) -> torch.Tensor:
    """`write_frequencies` of u (N,) in [0, 1]: (N, 2 * count)."""
    angle = math.pi * u[:, None] * 2.0 ** torch.arange(count, device=u.device)
    return torch.stack((torch.sin(angle), torch.cos(angle)), dim=2).flatten(1)


def read_grid(
    table: torch.Tensor, level: tuple[int, int, int], coordinates: torch.Tensor, *, is_smooth: bool = False
) -> torch.Tensor:
    """Features between the points of a grid, as `interpolate` and its like have them; differentiable in `table`.

    Parameters
    ----------
    table : (entries, features)
    level : (int, int, int), LEVEL_* of `grids.py`
    coordinates : (N, D) in [0, 1], of up to four axes, the fastest one first
    is_smooth : bool, smoothstep between points

    Returns
    -------
    (N, features)
    """
    resolution, first, mask = level
    x = coordinates * resolution
    cell = x.long().clamp(max=resolution - 1)
    fraction = x - cell
    if is_smooth:
        fraction = fraction * fraction * (3.0 - 2.0 * fraction)
    axes = range(coordinates.shape[1])
    value = torch.zeros((len(coordinates), table.shape[1]), device=table.device)
    for corner in range(1 << len(axes)):
        share = torch.ones_like(fraction[:, 0])
        entry = torch.zeros_like(cell[:, 0])
        # Behind the last axis the one before it counts: by Horner's rule, from the slowest one on.
        for axis in reversed(axes):
            is_upper = (corner >> axis) & 1
            share = share * (fraction[:, axis] if is_upper else 1.0 - fraction[:, axis])
            point = cell[:, axis] + is_upper
            entry = entry ^ (point * _PRIMES[axis]) if mask else entry * (resolution + 1) + point
        value = value + share[:, None] * table[first + (entry & mask if mask else entry)]
    return value


def read_planes(
    levels: torch.Tensor, planes: torch.Tensor, place: torch.Tensor, u: torch.Tensor, *, is_smooth: bool = False
) -> list[torch.Tensor]:
    """`write_planes` at places (N, 3) in the unit cube and u (N,) in [0, 1]: (N, features) of each plane."""
    features = []
    for resolution, offset, _ in levels.tolist():
        for plane in range(PLANES):
            level = resolution, offset + plane * (resolution + 1) ** 2, 0
            features.append(read_grid(planes, level, torch.stack((place[:, plane], u), 1), is_smooth=is_smooth))
    return features


def encode_positions_torch(
    encoding_level: torch.Tensor,
    center: torch.Tensor,
    inverse_extent: torch.Tensor,
    table: torch.Tensor,
    positions: torch.Tensor,
) -> torch.Tensor:
    """`encode_positions` of encoding.py; differentiable in `table`."""
    place = contract_torch(positions, center, inverse_extent)
    return torch.cat([read_grid(table, tuple(level), place) for level in encoding_level.tolist()], dim=1)


def encode_u_torch(
    encoding_plane_level: torch.Tensor,
    center: torch.Tensor,
    inverse_extent: torch.Tensor,
    planes: torch.Tensor,
    frequency_count: int,
    positions: torch.Tensor,
    u: torch.Tensor,
) -> torch.Tensor:
    """`encode_u` of encoding.py; differentiable in `planes`."""
    u = u.clamp(0.0, 1.0)
    place = contract_torch(positions, center, inverse_extent)
    return torch.cat([*read_planes(encoding_plane_level, planes, place, u), frequencies(u, frequency_count)], dim=1)
