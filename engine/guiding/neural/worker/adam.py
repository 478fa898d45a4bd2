# SPDX-License-Identifier: GPL-3.0-or-later
"""Adam for tensors, on any device. `torch.optim` has it too, but imports torch's compiler, which takes seconds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch

#: Decay of the running averages, of tables (`tables.py`) too.
BETAS = (0.9, 0.99)
#: Least denominator of networks that have tables.
TABLE_EPSILON = 1e-15
#: That of the others, as torch has it.
EPSILON = 1e-8


class Group(NamedTuple):
    """Tensors that are stepped alike.

    Attributes
    ----------
    tensors : sequence of torch.Tensor
        Leaves with a gradient, changed in place.
    learning_rate : float
    weight_decay : float
        Times the parameter, added to its gradient.
    skips : bool
        Whether rows of a tensor whose gradient is zero are left alone, moments included, as by `step_table`: most of a
        table belongs to no record of a batch.
    """

    tensors: Sequence[torch.Tensor]
    learning_rate: float
    weight_decay: float = 0.0
    skips: bool = False


class _State:
    """What Adam knows of one tensor."""

    def __init__(self, tensor: torch.Tensor) -> None:
        self.moment = torch.zeros_like(tensor, requires_grad=False)
        self.variance = torch.zeros_like(tensor, requires_grad=False)
        self.step_count = 0


class Adam:
    """Steps tensors by their gradients, with the bits of `torch.optim.Adam` for one tensor after the other.

    Parameters
    ----------
    groups : sequence of Group
    epsilon : float
        Least denominator.

    References
    ----------
    Kingma and Ba 2014, Algorithm 1.
    """

    def __init__(self, groups: Sequence[Group], epsilon: float = EPSILON) -> None:
        self._groups = [(group, [_State(tensor) for tensor in group.tensors]) for group in groups]
        self._epsilon = epsilon

    def forget_gradients(self) -> None:
        """Have the next gradients take the place of these, not be added to them."""
        for group, _ in self._groups:
            for tensor in group.tensors:
                tensor.grad = None

    @torch.no_grad()
    def step(self) -> None:
        """Step all tensors that have a gradient."""
        for group, states in self._groups:
            for tensor, state in zip(group.tensors, states, strict=True):
                if tensor.grad is not None:
                    self._step(group, tensor, tensor.grad, state)

    def _step(self, group: Group, tensor: torch.Tensor, gradient: torch.Tensor, state: _State) -> None:
        state.step_count += 1
        if group.skips:
            self._step_rows(group, tensor, gradient, state)
            return
        if group.weight_decay:
            gradient = gradient.add(tensor, alpha=group.weight_decay)
        state.moment.lerp_(gradient, 1.0 - BETAS[0])
        state.variance.mul_(BETAS[1]).addcmul_(gradient, gradient, value=1.0 - BETAS[1])
        rate = group.learning_rate / (1.0 - BETAS[0] ** state.step_count)
        correction = (1.0 - BETAS[1] ** state.step_count) ** 0.5
        denominator = (state.variance.sqrt() / correction).add_(self._epsilon)
        tensor.addcdiv_(state.moment, denominator, value=-rate)

    def _step_rows(self, group: Group, tensor: torch.Tensor, gradient: torch.Tensor, state: _State) -> None:
        """The step of `step_table`, of the rows that have a gradient."""
        has_gradient = gradient.abs().sum(dim=1, keepdim=True) > 0.0
        moment = state.moment.lerp(gradient, 1.0 - BETAS[0])
        variance = (state.variance * BETAS[1]).addcmul_(gradient, gradient, value=1.0 - BETAS[1])
        rate = group.learning_rate * (1.0 - BETAS[1] ** state.step_count) ** 0.5 / (1.0 - BETAS[0] ** state.step_count)
        step = moment / variance.sqrt().add_(self._epsilon) * rate
        state.moment.copy_(torch.where(has_gradient, moment, state.moment))
        state.variance.copy_(torch.where(has_gradient, variance, state.variance))
        tensor.sub_(torch.where(has_gradient, step, 0.0))
