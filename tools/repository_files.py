# SPDX-License-Identifier: GPL-3.0-or-later
"""Which files belong to the repository."""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def repository_files(pattern: str) -> list[Path]:
    """Files that match a pattern of git, those not yet added included, ignored ones not."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", pattern]
    names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    return sorted(path for name in set(names) if (path := ROOT / name).is_file())
