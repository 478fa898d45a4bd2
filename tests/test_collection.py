# SPDX-License-Identifier: GPL-3.0-or-later
"""What must not happen while pytest only makes the list of tests."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

CALLS_A_KERNEL = """
from engine.kernels.angles import upper_angle
ANGLE = upper_angle(1.0, 0.0)
def test_it(): ...
"""


def test_no_kernel_is_called(tmp_path: Path) -> None:
    (tmp_path / "test_some.py").write_text(CALLS_A_KERNEL)
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "tests.conftest", "--rootdir", str(tmp_path)]
    command += ["-p", "no:cacheprovider", "-c", os.devnull, str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode != 0
    assert "a kernel was called while tests were collected" in done.stdout + done.stderr
