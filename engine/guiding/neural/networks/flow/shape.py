# SPDX-License-Identifier: GPL-3.0-or-later
"""The flow's sizes, its parameters as one vector, and how it is trained; knows no torch.

Coupling layers act on the unit square that is mapped to the sphere: each leaves one coordinate as it is and moves the
other by a piecewise-quadratic distribution function, whose bins a small perceptron (ReLU, no bias but the last one's)
reads off the coordinate left alone and off the vertex.

References
----------
Müller et al. 2019, "Neural Importance Sampling", sections 3, 4.2, 4.3 and 6.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from engine.array_types import Float32Array
from engine.guiding.neural.networks.parameters import ParameterVector, check_sizes, draw_parameters, he_limit
from engine.guiding.neural.networks.radiance import TrainingSettings
from engine.guiding.records.training_rows import ROW_WIDTH

#: No bin is narrower: as in a layer of one bin this bounds the density, to 2 / MIN_WIDTH times the layer below it.
MIN_WIDTH = 1e-3
#: Part of each layer's density that is uniform. No bin is lighter than MIN_WIDTH * UNIFORM_SHARE, which is sixteen
#: steps of a float32 below 1: it can be told apart where a distribution function is inverted.
UNIFORM_SHARE = 1e-3
#: The perceptrons' outputs are clamped to this before exponentials, their activations to the other.
LOGIT_LIMIT = 30.0
ACTIVATION_LIMIT = 1e6

#: What the density is made proportional to: radiance times BSDF times cosine, or radiance alone.
TARGETS = ("PRODUCT", "RADIANCE")
DIVERGENCES = ("KL", "CHI2")


@dataclass(frozen=True)
class FlowShape(ParameterVector):
    """Sizes of the flow.

    layer_count : coupling layers; even ones move the azimuth, odd ones the height
    bin_count : bins of a layer's distribution
    blob_bins : one-blob bins for the coordinate that a layer leaves alone
    position_bins, direction_bins, roughness_bins : one-blob bins for each coordinate of what the flow is conditioned on
    width, hidden_layers : of each layer's perceptron

    Raises
    ------
    ValueError
        Naming the size that is out of range.
    """

    layer_count: int = 2
    bin_count: int = 32
    blob_bins: int = 32
    position_bins: int = 32
    direction_bins: int = 16
    roughness_bins: int = 8
    width: int = 64
    hidden_layers: int = 3

    kind: ClassVar[str] = "FLOW"

    def __post_init__(self) -> None:
        limits = {
            "layer_count": (2, 8),
            "bin_count": (2, 128),
            "blob_bins": (3, 128),
            "position_bins": (3, 128),
            "direction_bins": (3, 128),
            "roughness_bins": (3, 128),
            "width": (8, 256),
            "hidden_layers": (1, 8),
        }
        check_sizes(self, limits)

    @property
    def condition_bins(self) -> tuple[int, ...]:
        """One-blob bins of each coordinate conditioned on: three of position, of wo and of the normal, roughness."""
        return (self.position_bins,) * 3 + (self.direction_bins,) * 6 + (self.roughness_bins,)

    @property
    def condition_width(self) -> int:
        """Features of what the flow is conditioned on."""
        return sum(self.condition_bins)

    @property
    def output_width(self) -> int:
        """Outputs of a layer's perceptron: the bins' widths, then the heights of their edges."""
        return 2 * self.bin_count + 1

    @property
    def layout(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of each array of parameters, in the order of the parameter vector."""
        return {
            "condition_weights": (self.layer_count, self.condition_width, self.width),
            "passed_weights": (self.layer_count, self.blob_bins, self.width),
            "hidden_weights": (self.layer_count * (self.hidden_layers - 1), self.width, self.width),
            "output_weights": (self.layer_count, self.width, self.output_width),
            "output_bias": (self.layer_count, self.output_width),
        }

    @property
    def row_width(self) -> int:
        """Floats of a record that training needs."""
        return ROW_WIDTH

    @property
    def training_settings(self) -> TrainingSettings:
        """How it is trained if nothing else is said."""
        return FlowSettings()


@dataclass(frozen=True)
class FlowSettings(TrainingSettings):
    """How the flow is trained; what `TrainingSettings` says of tables does not apply.

    target : of TARGETS
    divergence : of DIVERGENCES, from the target to the flow: Kullback-Leibler, or chi-square (the variance of an
        estimator that samples the flow)
    weight_limit : no record weighs more than this many times the mean
    gradient_limit : norm of the gradient at most

    Raises
    ------
    ValueError
        If target or divergence is none of those.
    """

    learning_rate: float = 1e-3
    weight_decay: float = 0.0
    buffer_rows: int = 1 << 19
    target: str = "PRODUCT"
    divergence: str = "KL"
    weight_limit: float = 100.0
    gradient_limit: float = 1.0

    def __post_init__(self) -> None:
        if self.target not in TARGETS:
            raise ValueError(f"target is {self.target}: choose one of {', '.join(TARGETS)}")
        if self.divergence not in DIVERGENCES:
            raise ValueError(f"divergence is {self.divergence}: choose one of {', '.join(DIVERGENCES)}")


def initial_flow_parameters(shape: FlowShape, seed: int) -> Float32Array:
    """Parameters before training: layers of He's size, and outputs so small that the flow is all but uniform.

    Returns
    -------
    float32 (parameter_count,)
        A function of `shape` and `seed` alone.
    """
    # He's size were all features one: the coarse answer comes first, what each bin has to say later.
    first, hidden = he_limit(shape.condition_width + shape.blob_bins), he_limit(shape.width)
    return draw_parameters(shape, seed, {
        "condition_weights": first, "passed_weights": first, "hidden_weights": hidden, "output_weights": 0.1 * hidden,
        "output_bias": 0.0,
    })  # fmt: skip
