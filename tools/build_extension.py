# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds the Blender extension: `python tools/build_extension.py` puts its zips into dist/.

There is one for each range of Blenders (tools/blender_ranges.py) and platform.

Blender's rules for extensions forbid entries on `sys.path` and top-level modules. The packages `addon` and `engine` are
therefore copied with their imports of each other made relative, and live inside the extension's own package. numba,
llvmlite, embreex and onnxruntime travel as wheels at the versions of the lock file for that Blender's Python; Blender
brings numpy, and what else onnxruntime names as its needs it does without when it runs a network.

Kernels are compiled ahead (tools/kernel_library.py), for which that Python has to be here with numba: this one, or that
of `.venv-3.13`. That takes minutes, and it says which parts and how long; `--quick` does without. Zips for other
systems, and for a Python that is not here, go without, and compile at the first render.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path

if __package__:
    from . import kernel_library
    from .blender_ranges import RANGES, ROOT, BlenderRange, pinned, range_of
    from .staged_sources import stage_sources
else:
    import kernel_library
    from blender_ranges import RANGES, ROOT, BlenderRange, pinned, range_of
    from staged_sources import stage_sources

WHEELS = ("numba", "llvmlite", "embreex", "onnxruntime")

#: Blender's name of a platform: tags of wheels that run there, best first.
PLATFORMS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_14_0_arm64", "macosx_12_0_arm64", "macosx_11_0_arm64"),
}


def download_wheels(python: str, platform: str, folder: Path) -> list[Path]:
    """Wheels for a Python and a platform, from the package index unless in `folder`; empty if there are none."""
    pins = pinned(python, WHEELS)

    def present() -> list[Path]:
        return sorted(path for pin in pins for path in folder.glob(pin.replace("==", "-") + "-*.whl"))

    if len(present()) == len(pins):
        return present()
    folder.mkdir(parents=True, exist_ok=True)
    # Put into place whole: several processes may build at the same time.
    with tempfile.TemporaryDirectory(dir=folder) as downloads:
        tags = [item for tag in PLATFORMS[platform] for item in ("--platform", tag)]
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
        command += ["--only-binary", ":all:", "--python-version", python, "--dest", downloads, *tags, *pins]
        if subprocess.run(command, check=False).returncode != 0:
            return []
        for path in Path(downloads).glob("*.whl"):
            path.replace(folder / path.name)
    return present()


def write_manifest(target: Path, blenders: BlenderRange, platform: str, wheels: Sequence[Path]) -> None:
    """The repository's manifest with the range of Blenders, platform and wheels filled in."""
    text = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    listed = "".join(f'    "./wheels/{path.name}",\n' for path in wheels)
    lines = [f'blender_version_min = "{blenders.first}"']
    if blenders.end:
        lines.append(f'blender_version_max = "{blenders.end}"')
    lines += [f'platforms = ["{platform}"]', f"wheels = [\n{listed}]"]
    text, count = re.subn(r"^blender_version_min = .*$", "\n".join(lines), text, flags=re.MULTILINE)
    assert count == 1
    (target / "blender_manifest.toml").write_text(text, encoding="utf-8")
    (target / "wheels").mkdir(exist_ok=True)
    for path in wheels:
        shutil.copy(path, target / "wheels" / path.name)


def blender_extension_tool() -> Path:
    """Blender's own command-line tool for extensions, in the `bpy` package; it runs without Blender."""
    try:
        folder = Path(str(importlib.metadata.distribution("bpy").locate_file("bpy")))
    except importlib.metadata.PackageNotFoundError:
        raise SystemExit("bpy is not installed: it brings the tool that builds and checks extensions") from None
    found = sorted(folder.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    if not found:
        raise SystemExit("this bpy brings no tool for extensions")
    return found[-1]


def python_with_numba(version: str) -> str | None:
    """The Python of that version here that can compile kernels, None if there is none."""
    if version == f"{sys.version_info.major}.{sys.version_info.minor}":
        return sys.executable
    python = ROOT / f".venv-{version}" / "bin" / "python"
    if not python.is_file():
        return None
    done = subprocess.run([str(python), "-c", "import numba"], capture_output=True, check=False)
    return str(python) if done.returncode == 0 else None


def add_kernels(stage: Path, blenders: BlenderRange, platform: str, parts: Sequence[Sequence[str]]) -> None:
    """Compile the kernels of staged sources ahead, where that is possible; else say why not."""
    if platform != kernel_library.PLATFORM or not kernel_library.can_build():
        return
    python = python_with_numba(blenders.python)
    if python is None:
        print(f"{blenders.name}: no Python {blenders.python} with numba is here, so it compiles kernels at the first "
              f"render (`make .venv-{blenders.python}/installed` gets one)", file=sys.stderr)  # fmt: skip
        return
    print(f"{blenders.name} on {platform}: kernels are compiled ahead (--quick does without)", file=sys.stderr)
    kernel_library.build(
        stage, stage / kernel_library.OUTPUT.relative_to(ROOT), package=f"{stage.name}.engine", parts=parts,
        python=python,
    )


def build(
    blenders: BlenderRange, platform: str, output: Path, parts: Sequence[Sequence[str]] = kernel_library.PARTS
) -> Path | None:
    """Build and check the zip for a range of Blenders on one platform; None where there are no wheels for it.

    `parts` of the kernels are compiled ahead where that is possible.
    """
    wheels = download_wheels(blenders.python, platform, ROOT / "build" / "wheels" / blenders.python / platform)
    if not wheels:
        print(f"{blenders.name} on {platform}: there are no wheels for it", file=sys.stderr)
        return None
    output.mkdir(parents=True, exist_ok=True)
    tool = [sys.executable, str(blender_extension_tool())]
    with tempfile.TemporaryDirectory() as folder:
        stage = Path(folder) / "neuralguide"
        stage_sources(stage)
        if parts:
            add_kernels(stage, blenders, platform, parts)
        write_manifest(stage, blenders, platform, wheels)
        version = tomllib.loads((stage / "blender_manifest.toml").read_text(encoding="utf-8"))["version"]
        target = output / f"neuralguide-{version}-{blenders.name}-{platform}.zip"
        subprocess.run(
            [*tool, "build", "--source-dir", str(stage), "--output-filepath", str(target)],
            check=True,
            stdout=sys.stderr,
        )
    subprocess.run([*tool, "validate", str(target)], check=True, stdout=sys.stderr)
    return target


def _range_argument(version: str) -> BlenderRange:
    try:
        return range_of(version)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def main() -> int:
    """Command line; its exit status is 1 if a zip that was asked for is missing."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--platform", action="append", choices=PLATFORMS, help="default: all")
    parser.add_argument(
        "--blender",
        action="append",
        type=_range_argument,
        metavar="VERSION",
        help="only the zips that this Blender takes, as in `--blender 4.5`; default: all",
    )
    parser.add_argument("--output", type=Path, default=ROOT / "dist")
    parser.add_argument(
        "--quick", "--no-kernels", action="store_true", help="leave it to the first render to compile kernels"
    )
    arguments = parser.parse_args()
    parts = () if arguments.quick else kernel_library.PARTS
    if arguments.quick:
        print("no kernels are compiled: the first render will, for a minute or two", file=sys.stderr)
    built = [
        build(blenders, platform, arguments.output, parts)
        for blenders in dict.fromkeys(arguments.blender or RANGES)
        for platform in dict.fromkeys(arguments.platform or PLATFORMS)
    ]
    for path in built:
        if path is not None:
            print(path)
    return 0 if all(built) else 1


if __name__ == "__main__":
    sys.exit(main())
