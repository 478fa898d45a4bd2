# SPDX-License-Identifier: GPL-3.0-or-later
"""What a mixture network sees of the points of rows, in torch's operations: `encode_features` for a device."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from engine.array_types import Float32Array
from engine.guiding.neural.networks.encoding import center_and_scale
from engine.guiding.neural.networks.grids import grid_levels
from engine.guiding.neural.networks.mixture.shape import MixtureShape
from engine.guiding.neural.worker.torch_encoding import blobs, contract_torch, frequencies, read_grid, read_planes
from engine.guiding.records.training_rows import ROW_NORMAL, ROW_POSITION, ROW_ROUGHNESS, ROW_U, ROW_WO


def harmonics(direction: torch.Tensor, degree: int) -> torch.Tensor:
    """Real spherical harmonics of all bands below `degree`, up to 4, of directions (N, 3): (N, degree^2)."""
    x, y, z = direction.unbind(1)
    bands = [
        torch.full_like(x, 0.28209479),
        -0.48860251 * y, 0.48860251 * z, -0.48860251 * x,
        1.09254843 * x * y, -1.09254843 * y * z, 0.94617470 * z * z - 0.31539157, -1.09254843 * x * z,
        0.54627422 * (x * x - y * y),
        -0.59004359 * y * (3.0 * x * x - y * y), 2.89061144 * x * y * z, -0.45704580 * y * (5.0 * z * z - 1.0),
        0.37317633 * z * (5.0 * z * z - 3.0), -0.45704580 * x * (5.0 * z * z - 1.0), 1.44530572 * z * (x * x - y * y),
        -0.59004359 * x * (x * x - 3.0 * y * y),
    ]  # fmt: skip
    return torch.stack(bands[: degree * degree], dim=1)


def _encode_direction(direction: torch.Tensor, encoding: str, size: int) -> list[torch.Tensor]:
    direction = direction.clamp(-1.0, 1.0)
    if encoding == "RAW":
        return [direction]
    if encoding == "BLOB":
        return [blobs(0.5 + 0.5 * direction, size)]
    return [harmonics(direction, size)] if encoding == "HARMONICS" else []


class TorchFeatures:
    """The features of a mixture network, of rows that lie on a device.

    Parameters
    ----------
    shape : MixtureShape
    bounds : float32 (2, 3) [m]
    tables : mapping
        Of `shape.layout`, as far as they are `TABLES`; what is learned of features goes into their gradients.
    place : str
        The device.
    """

    def __init__(
        self, shape: MixtureShape, bounds: Float32Array, tables: Mapping[str, torch.Tensor], place: str
    ) -> None:
        self._shape, self._tables = shape, tables
        self._center, self._inverse_extent = (
            torch.from_numpy(array).to(place) for array in center_and_scale(bounds)
        )
        self._levels = grid_levels(shape.resolutions, shape.level_offsets).tolist()
        self._plane_levels = torch.from_numpy(grid_levels(shape.plane_resolutions, shape.plane_offsets))
        self._hash_levels = grid_levels(shape.hash_resolutions, shape.hash_offsets, shape.hash_size, 4).tolist()

    def __call__(self, rows: torch.Tensor) -> torch.Tensor:
        """Features (N, feature_width) of fit rows (N, ROW_WIDTH); differentiable in the tables."""
        shape, tables = self._shape, self._tables
        is_smooth = shape.interpolation == "SMOOTH"
        place = contract_torch(rows[:, ROW_POSITION : ROW_POSITION + 3], self._center, self._inverse_extent)
        u = rows[:, ROW_U].clamp(0.0, 1.0)
        if shape.position_encoding == "BLOB":
            features = [blobs(place, shape.position_bins)]
        else:
            features = [read_grid(tables["table"], tuple(level), place, is_smooth=is_smooth) for level in self._levels]
        if "planes" in tables:
            features += read_planes(self._plane_levels, tables["planes"], place, u, is_smooth=is_smooth)
        place_and_u = torch.cat((place, u[:, None]), dim=1)
        features += [
            read_grid(tables["hashes"], tuple(level), place_and_u, is_smooth=is_smooth) for level in self._hash_levels
        ]
        features += _encode_direction(rows[:, ROW_NORMAL : ROW_NORMAL + 3], shape.normal_encoding, shape.normal_size)
        features += _encode_direction(rows[:, ROW_WO : ROW_WO + 3], shape.wo_encoding, shape.wo_size)
        if shape.roughness_bins:
            seen = 1.0 - torch.exp(-rows[:, ROW_ROUGHNESS].clamp(0.0, 1.0))
            features.append(blobs(seen[:, None], shape.roughness_bins))
        features.append(frequencies(u, shape.u_frequencies))
        width = sum(feature.shape[1] for feature in features)
        features.append(torch.ones((len(rows), shape.feature_width - width), device=rows.device))
        return torch.cat(features, dim=1)
