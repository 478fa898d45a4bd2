# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a figure was taken: commit, machine, versions, memory."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import platform
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent


def thread_count() -> int:
    """Cores this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def _git(*arguments: str) -> str:
    try:
        return subprocess.run(
            ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True, timeout=10
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


def _cpu() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


@cache
def sources_hash() -> str:
    """Hash of everything that makes our picture: the sources of engine and add-on."""
    digest = hashlib.sha256()
    for folder in ("engine", "addon"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


@cache
def describe() -> dict[str, Any]:
    """Commit ("+" where engine or add-on differ from it), CPU and versions, for the record of a render."""
    commit = _git("rev-parse", "--short=12", "HEAD")
    if _git("status", "--porcelain", "--untracked-files=no", "engine", "addon"):
        commit += "+"
    versions = {"python": platform.python_version()}
    for package in ("bpy", "numba", "numpy", "embreex"):
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = ""
    return {
        "commit": commit,
        "sources_hash": sources_hash(),
        "cpu": _cpu(),
        "cores": thread_count(),
        "system": platform.system(),
        "versions": versions,
    }


def reset_peak_memory() -> None:
    """Start measuring peak memory anew, where the system lets a process do so (Linux)."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        pass


def peak_memory_mib() -> float:
    """Largest resident memory since `reset_peak_memory` [MiB]; nan where unknown."""
    try:
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) / 1024.0
    except OSError:
        pass
    return float("nan")
