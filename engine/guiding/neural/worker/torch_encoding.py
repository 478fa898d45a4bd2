# SPDX-License-Identifier: GPL-3.0-or-later
"""What the radiance network sees, in torch's operations: `encoding.py` for a GPU."""

from __future__ import annotations

import math

import torch

from engine.guiding.neural.networks.encoding import HASH_Y, HASH_Z
from engine.guiding.neural.networks.grids import PLANES
from engine.guiding.neural.networks.radiance import INNER_EXTENT


def encode_positions_torch(
    encoding_level: torch.Tensor,
    center: torch.Tensor,
    inverse_extent: torch.Tensor,
    table: torch.Tensor,
    positions: torch.Tensor,
) -> torch.Tensor:
    """`encode_positions` of encoding.py in torch's operations, for the GPU; differentiable in `table`."""
    u = _contract_torch(positions, center, inverse_extent)
    features = []
    for resolution, offset, mask in encoding_level.tolist():
        x = u * resolution
        cell = x.long().clamp(max=resolution - 1)
        fraction = x - cell
        value = torch.zeros((positions.shape[0], table.shape[1]), device=table.device)
        for corner in range(8):
            step = torch.tensor([corner & 1, (corner >> 1) & 1, corner >> 2], device=cell.device)
            share = torch.where(step > 0, fraction, 1.0 - fraction).prod(dim=1, keepdim=True)
            point = cell + step
            if mask:
                entry = (point[:, 0] ^ (point[:, 1] * int(HASH_Y)) ^ (point[:, 2] * int(HASH_Z))) & mask
            else:
                entry = (point[:, 2] * (resolution + 1) + point[:, 1]) * (resolution + 1) + point[:, 0]
            value = value + share * table[offset + entry]
        features.append(value)
    return torch.cat(features, dim=1)


def _contract_torch(positions: torch.Tensor, center: torch.Tensor, inverse_extent: torch.Tensor) -> torch.Tensor:
    u = (positions - center) * inverse_extent
    outer = torch.sign(u) * (1.0 - (1.0 - INNER_EXTENT) / u.abs().clamp(min=1.0))
    u = torch.where(u.abs() > 1.0, outer, INNER_EXTENT * u)
    return (0.5 + 0.5 * u).clamp(0.0, 1.0)


def encode_u_torch(
    encoding_plane_level: torch.Tensor,
    center: torch.Tensor,
    inverse_extent: torch.Tensor,
    planes: torch.Tensor,
    frequency_count: int,
    positions: torch.Tensor,
    u: torch.Tensor,
) -> torch.Tensor:
    """`encode_u` of encoding.py in torch's operations, for the GPU; differentiable in `planes`."""
    place = _contract_torch(positions, center, inverse_extent)
    u = u.clamp(0.0, 1.0)
    features = []
    for resolution, offset, _ in encoding_plane_level.tolist():
        for plane in range(PLANES):
            x = torch.stack((place[:, plane], u), dim=1) * resolution
            cell = x.long().clamp(max=resolution - 1)
            fraction = x - cell
            value = torch.zeros((positions.shape[0], planes.shape[1]), device=planes.device)
            for corner in range(4):
                step = torch.tensor([corner & 1, corner >> 1], device=cell.device)
                share = torch.where(step > 0, fraction, 1.0 - fraction).prod(dim=1, keepdim=True)
                point = cell + step
                entry = (plane * (resolution + 1) + point[:, 1]) * (resolution + 1) + point[:, 0]
                value = value + share * planes[offset + entry]
            features.append(value)
    for octave in range(frequency_count):
        angle = math.pi * 2.0**octave * u[:, None]
        features += [torch.sin(angle), torch.cos(angle)]
    return torch.cat(features, dim=1)
