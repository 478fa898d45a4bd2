# SPDX-License-Identifier: GPL-3.0-or-later
"""Adam: that of torch, bit for bit, without what its import costs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.training import require_torch

torch = require_torch()

from engine.guiding.neural.worker.adam import BETAS, EPSILON, TABLE_EPSILON, Adam, Group  # noqa: E402

ROOT = Path(__file__).resolve().parents[5]
SIZES = (7, 5), (33,), (2, 3, 4)


@pytest.mark.parametrize("epsilon", [EPSILON, TABLE_EPSILON])
def test_steps_are_those_of_torch(epsilon: float) -> None:
    """With two groups, a decay of one of them, gradients of very different sizes, and steps without one of them."""
    generator = torch.Generator().manual_seed(0)
    start = [torch.randn(size, generator=generator) for size in SIZES]
    ours, theirs = ([tensor.clone().requires_grad_() for tensor in start] for _ in range(2))
    adam = Adam([Group(ours[:2], 0.01, 0.1), Group(ours[2:], 0.002)], epsilon)
    reference = torch.optim.Adam(
        [{"params": theirs[:2], "lr": 0.01, "weight_decay": 0.1}, {"params": theirs[2:], "lr": 0.002}],
        betas=BETAS, eps=epsilon,
    )
    for step in range(50):
        adam.forget_gradients()
        reference.zero_grad()
        for index, (mine, its) in enumerate(zip(ours, theirs, strict=True)):
            if step % 5 == index:
                continue
            gradient = torch.randn(mine.shape, generator=generator) * 10.0 ** (step % 7 - 4)
            mine.grad, its.grad = gradient.clone(), gradient.clone()
        adam.step()
        reference.step()
        for mine, its in zip(ours, theirs, strict=True):
            assert torch.equal(mine, its), f"step {step}"
    assert not any(torch.equal(mine, before) for mine, before in zip(ours, start, strict=True))


def test_a_worker_gets_ready_without_the_compiler_of_torch() -> None:
    """Its import took a third of the time until a network could learn; sympy came with it."""
    script = (
        "import sys; from engine.guiding.neural.worker.kinds import warm_up; warm_up('AUTO');"
        "print(*[name for name in ('torch', 'torch._dynamo', 'sympy') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = done.stdout.split()
    assert "torch" in found and "torch._dynamo" not in found and "sympy" not in found
