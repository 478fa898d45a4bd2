# SPDX-License-Identifier: GPL-3.0-or-later
"""What a closure's instruction reads: its operands in memory, and the code that says where."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def pack_operands(operands: Sequence[Any], immediate: int) -> tuple[np.ndarray, np.ndarray]:
    """Memory, float32, with each operand, a number or several, and code, int32, that ends with an immediate number."""
    memory, code = np.zeros(64, np.float32), np.zeros(32, np.int32)
    at = 1
    for k, operand in enumerate(operands):
        values = np.atleast_1d(operand)
        memory[at : at + len(values)] = values
        code[3 + k] = at
        at += len(values)
    code[3 + len(operands)] = immediate
    return memory, code
