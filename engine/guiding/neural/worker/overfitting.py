# SPDX-License-Identifier: GPL-3.0-or-later
"""Training that has begun to learn rows by heart, told by rows held out of it, goes back to where it was best."""

from __future__ import annotations

import math

import torch


class BestParameters:
    """The parameters whose loss on held-out rows is least, since the rows last changed.

    With light in few rows a network first learns where light is, then which rows have it, and is dark between them:
    no number of looks at rows is right for every scene.
    """

    def __init__(self) -> None:
        self._parameters: torch.Tensor | None = None
        self._losses: torch.Tensor | None = None

    @property
    def is_known(self) -> bool:
        """Whether there are any."""
        return self._parameters is not None

    def forget(self) -> None:
        """The rows changed: there is nothing to compare with."""
        self._parameters = self._losses = None

    def see(self, losses: torch.Tensor, parameters: torch.Tensor) -> bool:
        """Keep these parameters if they are the best, or put the best in their place if they are worse than those.

        Worse is what lies above the best by more than the standard error of the difference.

        Parameters
        ----------
        losses : (N,)
            Loss of each held-out row.
        parameters : (parameter_count,)
            Written to if they are worse.

        Returns
        -------
        bool
            Whether they were worse.
        """
        if self._parameters is None or self._losses is None:
            self._parameters, self._losses = parameters.detach().clone(), losses
            return False
        excess = (losses - self._losses).double()
        mean = excess.mean().item()
        if mean <= 0.0:
            self._parameters.copy_(parameters.detach())
            self._losses = losses
            return False
        error = excess.std(correction=0).item() / math.sqrt(len(excess))
        if mean <= error:
            return False
        with torch.no_grad():
            parameters.copy_(self._parameters)
        return True
