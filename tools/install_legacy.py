# SPDX-License-Identifier: GPL-3.0-or-later
"""Installs NeuralGuide into a Blender older than 4.2, which knows no extensions: Debian's 3.4 for one.

`python tools/install_legacy.py /usr/bin/blender` copies the add-on into the user's scripts, has pip put what it needs
beside it (`scripts/modules` is on Blender's path), and enables it in the saved preferences. From then on
`blender -b scene.blend -E NEURALGUIDE -f 1` works.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

if __package__:
    from .blender_ranges import ROOT, lock_file, pinned
    from .build_extension import stage_sources
else:
    from blender_ranges import ROOT, lock_file, pinned
    from build_extension import stage_sources

#: Blender 3.4 of Debian comes without numpy.
REQUIREMENTS = ("numpy", "numba", "llvmlite", "embreex")

_ASK = (
    "import bpy, sys; print('SCRIPTS=' + bpy.utils.user_resource('SCRIPTS', create=True)); "
    "print('PYTHON=%d.%d' % sys.version_info[:2])"
)
_ENABLE = (
    "import addon_utils, bpy, sys; module = addon_utils.enable('neuralguide', default_set=True); "
    "bpy.ops.wm.save_userpref(); print('ENABLED=' + str(module is not None))"
)


def _run_in_blender(blender: str, code: str) -> str:
    command = [blender, "--background", "--python-exit-code", "1", "--python-expr", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"{blender} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def describe(blender: str) -> tuple[Path, str]:
    """The folder of the user's scripts, as that Blender names it, and the version of its Python."""
    facts = dict(line.split("=", 1) for line in _run_in_blender(blender, _ASK).splitlines() if "=" in line)
    return Path(facts["SCRIPTS"]), facts["PYTHON"]


def install(blender: str, *, link: bool = False) -> Path:
    """Install add-on and packages for `blender`, enable it; returns the add-on's folder.

    With `link` the add-on is a link to this checkout, for whoever works on it.
    """
    scripts, python = describe(blender)
    if not lock_file(python).is_file():
        raise SystemExit(f"{blender} has Python {python}, for which NeuralGuide pins no packages")
    folder = scripts / "addons" / "neuralguide"
    if folder.is_symlink():
        folder.unlink()
    if link:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.symlink_to(ROOT)
    else:
        stage_sources(folder)
    modules = scripts / "modules"
    # Blender's Python, which need not be this one.
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += ["--python-version", python, "--only-binary", ":all:", "--upgrade", "--target", str(modules)]
    subprocess.run([*command, *pinned(python, REQUIREMENTS)], check=True)
    if "ENABLED=True" not in _run_in_blender(blender, _ENABLE):
        raise SystemExit(f"{blender} could not enable the add-on in {folder}")
    return folder


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("blender", nargs="?", default="blender", help="the binary to install into")
    parser.add_argument("--link", action="store_true", help="link to this checkout instead of copying it")
    arguments = parser.parse_args()
    print(f"installed {install(arguments.blender, link=arguments.link)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
