# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes of mixture networks: what they see of a point, their layers, and what they are trained for.

References
----------
Dong et al. 2023, "Neural Parametric Mixtures for Path Guiding" (NPM), sections 4.3 and 5, Eqs. 13 and 14.
Huang et al. 2024, "Online Neural Path Guiding with Normalized Anisotropic Spherical Gaussians" (NASG), sections 5 and
6, Tables 1 and 2.
Dong et al. 2024, "Efficient Neural Path Guiding with 4D Modeling", sections 4.1, 5 and 6.2 (a further dimension u).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from engine.array_types import Float32Array
from engine.guiding.neural.networks.lobes.nasg import NASG_OUTPUTS
from engine.guiding.neural.networks.lobes.vmf import VMF_OUTPUTS
from engine.guiding.neural.networks.parameters import (
    TABLE_LIMIT,
    ParameterVector,
    check_sizes,
    draw_parameters,
    he_limit,
)
from engine.guiding.neural.networks.radiance import PlaneSizes, TrainingSettings, grid_offsets, grid_resolutions
from engine.guiding.records.training_rows import ROW_WIDTH

#: Raw outputs a lobe, by model of lobe.
LOBE_OUTPUTS = {"VMF": VMF_OUTPUTS, "NASG": NASG_OUTPUTS}

#: Features are a multiple of this many; those left over are 1, a stand-in for the bias that layers have not.
FEATURE_STEP = 8

#: NASG gives its learned share to the guide little by little, in equal steps over so many samples a pixel
#: (Huang et al. 2024, section 6: M = 4 images a step, B = 64 steps).
BLEND_STEP_SAMPLES = 4
BLEND_STEPS = 64

_DIRECTION_ENCODINGS = ("NONE", "RAW", "BLOB", "HARMONICS")


#: Arrays of `MixtureShape.layout` that features are interpolated from.
TABLES = ("table", "planes", "hashes")


@dataclass(frozen=True)
class MixtureShape(PlaneSizes, ParameterVector):
    """Sizes and meaning of a mixture network; the defaults are those of `NPM`.

    Where light depends on more than the position, on the time, say, that is `u` in [0, 1]. It can be seen by planes, by
    four-dimensional grids, or by frequencies; all may be there at once.

    lobe_model : 'VMF' or 'NASG'
    lobe_count : lobes of a mixture
    position_encoding : 'GRID', dense grids of learned features, interpolated; 'BLOB', one-blob; 'NONE', where
        four-dimensional grids see it
    level_count, level_features : grids, and features of each
    base_resolution, growth : cells along an axis of the coarsest grid, and by how much each next one is finer
    interpolation : 'LINEAR' or 'SMOOTH' (smoothstep) between a grid's points
    position_bins : of the one-blob encoding, for each coordinate
    normal_encoding, wo_encoding : of the shading normal and of the direction to the viewer: 'NONE', 'RAW' (the three
        coordinates), 'BLOB' (one-blob), 'HARMONICS' (spherical, all bands below a degree)
    normal_size, wo_size : bins a coordinate of 'BLOB', degree of 'HARMONICS'
    roughness_bins : of the one-blob encoding of 1 - exp(-roughness), 0 = not seen
    u_frequencies : octaves of the frequency encoding of u, 0 = none
    plane_levels, plane_features : levels of the three planes of learned features (x, u), (y, u) and (z, u), 0 = none;
        and features of each plane and level
    plane_resolution, plane_growth : cells along an axis of the coarsest planes, and by how much each next one is finer
    hash_levels, hash_features, hash_resolution, hash_growth : the same of grids over (x, y, z, u)
    hash_size : entries of such a grid at most, a power of two; points of finer ones share entries, by a hash
    width, hidden_layers : of the perceptron, which has no bias
    target : what the mixture is proportional to: 'RADIANCE' (incident), 'COSINE' (radiance times |cos|) or 'PRODUCT'
        (radiance times BSDF times |cos|)
    has_selection : whether a last output learns how often to prefer the mixture to the BSDF

    Raises
    ------
    ValueError
        Naming what is out of range.
    """

    lobe_model: str = "VMF"
    lobe_count: int = 8
    position_encoding: str = "GRID"
    level_count: int = 8
    level_features: int = 4
    base_resolution: int = 8
    growth: float = 1.405
    interpolation: str = "LINEAR"
    position_bins: int = 19
    normal_encoding: str = "NONE"
    normal_size: int = 0
    wo_encoding: str = "NONE"
    wo_size: int = 0
    roughness_bins: int = 0
    u_frequencies: int = 0
    plane_levels: int = 0
    plane_features: int = 2
    plane_resolution: int = 8
    plane_growth: float = 2.0
    hash_levels: int = 0
    hash_features: int = 4
    hash_resolution: int = 8
    hash_growth: float = 1.405
    hash_size: int = 1 << 22
    width: int = 64
    hidden_layers: int = 2
    target: str = "RADIANCE"
    has_selection: bool = False

    kind: ClassVar[str] = "MIXTURE"

    def __post_init__(self) -> None:
        choices = {
            "lobe_model": tuple(LOBE_OUTPUTS),
            "position_encoding": ("GRID", "BLOB", "NONE"),
            "interpolation": ("LINEAR", "SMOOTH"),
            "normal_encoding": _DIRECTION_ENCODINGS,
            "wo_encoding": _DIRECTION_ENCODINGS,
            "target": ("RADIANCE", "COSINE", "PRODUCT"),
        }
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name} is {getattr(self, name)!r}: choose one of {', '.join(allowed)}")
        limits = {
            "lobe_count": (1, 16),
            "level_count": (1, 16),
            "level_features": (4, 8),
            "base_resolution": (1, 128),
            "growth": (1.0, 4.0),
            "position_bins": (3, 64),
            "roughness_bins": (0, 64),
            "u_frequencies": (0, 16),
            "plane_levels": (0, 10),
            "plane_features": (2, 8),
            "plane_resolution": (1, 128),
            "plane_growth": (1.0, 4.0),
            "hash_levels": (0, 16),
            "hash_features": (4, 8),
            "hash_resolution": (1, 128),
            "hash_growth": (1.0, 4.0),
            "hash_size": (16, 1 << 22),
            "width": (8, 256),
            "hidden_layers": (1, 8),
        }
        sizes = {"BLOB": (3, 64), "HARMONICS": (1, 4)}
        limits["normal_size"] = sizes.get(self.normal_encoding, (0, 0))
        limits["wo_size"] = sizes.get(self.wo_encoding, (0, 0))
        check_sizes(self, limits)
        for name in ("level_features", "hash_features"):
            if getattr(self, name) % 4:
                raise ValueError(f"{name} is {getattr(self, name)}: choose 4 or 8")
        if self.plane_features % 2:
            raise ValueError(f"plane_features is {self.plane_features}: choose an even number")
        if self.hash_size & (self.hash_size - 1):
            raise ValueError(f"hash_size is {self.hash_size}: choose a power of two")
        if self.position_encoding == "NONE" and not self.hash_levels:
            raise ValueError("position_encoding is 'NONE': choose another, or grids that see it (hash_levels)")
        if 0 < self.roughness_bins < 3:
            raise ValueError(f"roughness_bins is {self.roughness_bins}: choose 0, or 3 and more")
        if self.wo_encoding != "NONE" and self.target != "PRODUCT":
            raise ValueError(f"wo_encoding is {self.wo_encoding!r}: only the target 'PRODUCT' depends on the viewer")
        for name, resolutions, most in (
            ("growth", self.resolutions, 256),
            ("plane_growth", self.plane_resolutions, 2048),
            ("hash_growth", self.hash_resolutions, 2048),
        ):
            if max(resolutions, default=0) > most:
                raise ValueError(
                    f"{name} is {getattr(self, name)}: the finest grid has {max(resolutions)} cells, choose {most}"
                )

    @property
    def resolutions(self) -> tuple[int, ...]:
        """Cells along an axis of each grid; none without grids."""
        if self.position_encoding != "GRID":
            return ()
        return grid_resolutions(self.base_resolution, self.growth, self.level_count)

    @property
    def hash_resolutions(self) -> tuple[int, ...]:
        """Cells along an axis of each four-dimensional grid."""
        return grid_resolutions(self.hash_resolution, self.hash_growth, self.hash_levels)

    @property
    def level_offsets(self) -> tuple[int, ...]:
        """First entry of each grid in the table, and the number of all entries at the end."""
        return grid_offsets((resolution + 1) ** 3 for resolution in self.resolutions)

    @property
    def hash_offsets(self) -> tuple[int, ...]:
        """First entry of each four-dimensional grid in their table, and the number of all entries at the end."""
        return grid_offsets(min((resolution + 1) ** 4, self.hash_size) for resolution in self.hash_resolutions)

    @property
    def position_width(self) -> int:
        """Features of the position alone, which come first."""
        widths = {"GRID": self.level_count * self.level_features, "BLOB": 3 * self.position_bins, "NONE": 0}
        return widths[self.position_encoding]

    @property
    def hash_width(self) -> int:
        """Features of the four-dimensional grids, which come after those of the planes."""
        return self.hash_levels * self.hash_features

    @property
    def sees_u(self) -> bool:
        """Whether any feature depends on u."""
        return bool(self.u_frequencies or self.plane_levels or self.hash_levels)

    @property
    def used_width(self) -> int:
        """Features without those that are always 1."""
        direction_width = {"NONE": lambda size: 0, "RAW": lambda size: 3, "BLOB": lambda size: 3 * size}
        direction_width["HARMONICS"] = lambda size: size * size
        normal = direction_width[self.normal_encoding](self.normal_size)
        wo = direction_width[self.wo_encoding](self.wo_size)
        learned = self.plane_width + self.hash_width
        return self.position_width + learned + normal + wo + self.roughness_bins + 2 * self.u_frequencies

    @property
    def feature_width(self) -> int:
        """Inputs of the perceptron."""
        return -(-self.used_width // FEATURE_STEP) * FEATURE_STEP

    @property
    def selection_column(self) -> int:
        """Which raw output is the logit of the guide's share, after those of the lobes; -1 = there is none."""
        return self.lobe_count * LOBE_OUTPUTS[self.lobe_model] if self.has_selection else -1

    @property
    def output_width(self) -> int:
        """Raw outputs."""
        return self.lobe_count * LOBE_OUTPUTS[self.lobe_model] + int(self.has_selection)

    @property
    def row_width(self) -> int:
        """Floats of a record that training needs."""
        return ROW_WIDTH

    @property
    def training_settings(self) -> TrainingSettings:
        """How it is trained if nothing else is said: as the paper of its position's encoding has it."""
        return NASG_SETTINGS if self.position_encoding == "BLOB" else NPM_SETTINGS

    @property
    def layout(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of each array of parameters, in the order of the parameter vector."""
        layout: dict[str, tuple[int, ...]] = {}
        if self.position_encoding == "GRID":
            layout["table"] = (self.level_offsets[-1], self.level_features)
        if self.plane_levels:
            layout["planes"] = (self.plane_offsets[-1], self.plane_features)
        if self.hash_levels:
            layout["hashes"] = (self.hash_offsets[-1], self.hash_features)
        layout["input_weights"] = (self.feature_width, self.width)
        layout["hidden_weights"] = (self.hidden_layers - 1, self.width, self.width)
        layout["output_weights"] = (self.width, self.output_width)
        return layout

    def matrices(self, parameters: Float32Array) -> list[Float32Array]:
        """Weight matrices (inputs, outputs) of the perceptron's layers, views into the parameter vector."""
        arrays = self.split(parameters)
        return [arrays["input_weights"], *arrays["hidden_weights"], arrays["output_weights"]]


#: Incident radiance, and the whole integrand, as in the paper: three linear layers. Where it is silent (degree of the
#: harmonics, encoding of the roughness) its authors' program speaks.
NPM = MixtureShape(normal_encoding="HARMONICS", normal_size=2, roughness_bins=4)
NPM_PRODUCT = replace(NPM, wo_encoding="HARMONICS", wo_size=2, target="PRODUCT")
#: The sizes of its authors' program, which leaves the cosine to a product at sampling; here it is learned too.
NPM_OFFICIAL = MixtureShape(
    interpolation="SMOOTH", normal_encoding="BLOB", normal_size=4, wo_encoding="HARMONICS", wo_size=2, roughness_bins=4,
    hidden_layers=3, target="PRODUCT",
)
NASG = MixtureShape(
    lobe_model="NASG", position_encoding="BLOB", normal_encoding="RAW", width=128, hidden_layers=4, has_selection=True
)
NASG_COSINE = replace(NASG, target="COSINE")
NASG_PRODUCT = replace(NASG, target="PRODUCT", wo_encoding="RAW")
#: Isotropic lobes in the same network: as many parameters as eight anisotropic ones have, roughly.
SG = replace(NASG_PRODUCT, lobe_model="VMF", lobe_count=14)


@dataclass(frozen=True)
class MixtureSettings(TrainingSettings):
    """How a mixture network is trained: what `TrainingSettings` says, and

    Its first snapshot comes later: it puts the mixture field out of its place, so it must know more than that.

    epsilon : [sr^-1] added to the density that a direction was drawn with, and to the mixture's
    averaging : share of its past that the average of parameters keeps at every step; snapshots carry the average
    selection_share : of the loss, that goes to the mixture and the BSDF together (e of Huang et al. 2024, Eq. 18)
    outlier_share : of the weight of a batch, or of all rows held if `is_drawn_by_weight`, that a row has at most. Where
        there are fewer than 8 / outlier_share rows it is raised to 8 over their number, so that eight can bear all
        weight: to 8 / 4096 in batches of the default size
    kept_weight : of all weight, that must be left when rows are cut so; else they are cut less, down to a hard limit
    is_drawn_by_weight : whether batches hold rows as often as they weigh, rather than evenly and weighted
    gradient_limit : length that the perceptron's gradient is cut to
    mis_compensation : learn what the BSDF's own sampling leaves over (Dong et al. 2024, Eq. 12)
    bsdf_share : of the directions, that are drawn from the BSDF; for the compensation
    follows_u : forget rows whose u is not among or next to those of the newest ones, as a render that goes on from
        stratum to stratum asks for
    u_pieces : equal parts of [0, 1], each of which has a piece of every stratum
    """

    learning_rate: float = 5e-3
    table_learning_rate: float = 5e-3
    weight_decay: float = 1e-6
    first_snapshot_seconds: float = 1.0
    epsilon: float = 1e-5
    averaging: float = 0.95
    selection_share: float = 0.2
    outlier_share: float = 1e-3
    kept_weight: float = 0.0
    is_drawn_by_weight: bool = False
    gradient_limit: float = 10.0
    mis_compensation: bool = False
    bsdf_share: float = 0.5
    follows_u: bool = False
    u_pieces: int = 1


#: Learning rates of the papers and of the NPM authors' program. That program compensates too; here the render setting
#: `mis_compensation` decides for all presets (`engine.guiding.neural.sources.mixture.mixture_training`).
NPM_SETTINGS = MixtureSettings()
NPM_OFFICIAL_SETTINGS = MixtureSettings(learning_rate=1e-2, table_learning_rate=1e-2)
#: For NASG a caustic that is seen late must stay learnable (section 8.3 of its paper;
#: docs/decisions/trees-and-neural-mixtures.md): rows that have most of the light are not cut, and each batch has its
#: share of them.
NASG_SETTINGS = MixtureSettings(
    learning_rate=2e-3, averaging=0.0, outlier_share=1e-4, kept_weight=0.75, is_drawn_by_weight=True
)


def selection_blend(samples: float) -> float:
    """Factor in [0, 1] of the learned share after so many samples a pixel (b of Huang et al. 2024, section 6)."""
    return min(1.0, math.floor(max(samples, 0.0) / BLEND_STEP_SAMPLES) / BLEND_STEPS)


def initial_parameters(shape: MixtureShape, seed: int) -> Float32Array:
    """Parameters before training: grids next to zero, He-initialised layers, a broad mixture everywhere.

    Returns
    -------
    float32 (parameter_count,)
        A function of `shape` and `seed` alone.
    """
    hidden = he_limit(shape.width)
    return draw_parameters(shape, seed, {
        **dict.fromkeys(TABLES, TABLE_LIMIT), "input_weights": he_limit(shape.feature_width), "hidden_weights": hidden,
        # The first lobes are broad.
        "output_weights": 0.1 * hidden,
    })  # fmt: skip
