# SPDX-License-Identifier: GPL-3.0-or-later
"""What a report of a bug needs beside the bug: versions, system, processor, kernels and the end of the log.

`python -m addon --report` prints it; a button in the add-on's preferences copies it.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
import tomllib
from pathlib import Path

import bpy

from .log import log_file

_MANIFEST = Path(__file__).resolve().parents[1] / "blender_manifest.toml"
#: Packages whose version may matter, where they are there.
_PACKAGES = ("numpy", "numba", "llvmlite", "embreex", "onnxruntime", "torch")
#: Lines of the log that are shown.
_LOG_LINES = 60


def our_version() -> str:
    """Version of NeuralGuide, as its manifest has it."""
    with _MANIFEST.open("rb") as file:
        return str(tomllib.load(file)["version"])


def _processor() -> str:
    """The processor's name, as its maker writes it where the system tells."""
    try:
        for line in Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _package_version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not there"


def _log_end(file: Path) -> list[str]:
    try:
        return file.read_text("utf-8", "replace").splitlines()[-_LOG_LINES:]
    except OSError:
        return ["(nothing was logged)"]


def _without_home(text: str) -> str:
    """A text that does not say who the user is."""
    home = str(Path.home()) if "HOME" in os.environ or "USERPROFILE" in os.environ else ""
    return text.replace(home, "~") if len(home) > 1 else text


def bug_report() -> str:
    """The whole report, in lines that can be pasted."""
    from engine.denoise.library import problem as denoiser_problem
    from engine.runtime.kernel_cache import cache_root, describe_kernels
    from engine.runtime.kernel_cache import problem as cache_problem
    from engine.scene.limits import physical_memory

    log = log_file()
    lines = [
        f"NeuralGuide: {our_version()}",
        f"Blender: {bpy.app.version_string}" + (" (window)" if not bpy.app.background else " (background or module)"),
        f"Python: {platform.python_version()}",
        f"System: {platform.platform()}",
        f"Processor: {_processor()}, {os.cpu_count()} threads",
        f"Memory: {physical_memory() / 2**30:.1f} GiB",
        f"Packages: {', '.join(f'{name} {_package_version(name)}' for name in _PACKAGES)}",
        f"Kernels: {describe_kernels().removeprefix('kernels: ')}",
        f"Kernel cache: {cache_root()} {cache_problem()}".rstrip(),
        f"Denoiser: {denoiser_problem() or 'there'}",
        f"Command: {Path(sys.argv[0]).name}",
        f"Log: {log}",
        *(f"  {line}" for line in _log_end(log)),
    ]
    return _without_home("\n".join(lines)) + "\n"


class NEURALGUIDE_OT_copy_bug_report(bpy.types.Operator):  # noqa: N801 (Blender's convention)
    """Copy versions, system, processor and the end of the log, to be pasted into a report of a bug"""

    bl_idname = "neuralguide.copy_bug_report"
    bl_label = "Copy Bug Report"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Copy it, and print it for those who have no clipboard."""
        text = bug_report()
        context.window_manager.clipboard = text
        print(text, end="")
        self.report({"INFO"}, "Copied; it is in the system console too")
        return {"FINISHED"}


def register() -> None:
    """Register the operator."""
    bpy.utils.register_class(NEURALGUIDE_OT_copy_bug_report)


def unregister() -> None:
    """Unregister it."""
    bpy.utils.unregister_class(NEURALGUIDE_OT_copy_bug_report)
