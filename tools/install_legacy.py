# SPDX-License-Identifier: GPL-3.0-or-later
"""Installs NeuralGuide into a Blender that takes no zip: one older than 4.2, or with another Python than its zip.

Blenders of Linux distributions are meant: Debian's 3.4 (Python 3.11) and 4.3 (Python 3.13).
`python3 tools/install_legacy.py /usr/bin/blender`, by any Python from 3.9 on, asks that Blender which Python it has,
copies the add-on into the user's scripts, has pip put what it needs beside it (`scripts/modules` is on Blender's path;
Open Image Denoise is part of that), and enables it in the saved preferences. From then on
`blender -b scene.blend -E NEURALGUIDE -f 1` works.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

if __package__:
    from .blender_ranges import RANGES, ROOT, lock_file, pinned
    from .staged_sources import stage_sources
else:
    from blender_ranges import RANGES, ROOT, lock_file, pinned
    from staged_sources import stage_sources

#: Debian's Blenders come without numpy.
REQUIREMENTS = ("numpy", "numba", "llvmlite", "embreex")
#: Open Image Denoise, of which these Blenders have none that the add-on could use. It is large, so no lock file has it.
DENOISER = "pyoidn==2.5.1.0"

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
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise SystemExit(f"{blender} does not run: {error.strerror}. Name the binary of a Blender") from None
    if done.returncode != 0:
        raise SystemExit(f"{blender} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def describe(blender: str) -> tuple[Path, str]:
    """The folder of the user's scripts, as that Blender names it, and the version of its Python."""
    facts = dict(line.split("=", 1) for line in _run_in_blender(blender, _ASK).splitlines() if "=" in line)
    return Path(facts["SCRIPTS"]), facts["PYTHON"]


def find_pip(python: str) -> list[str]:
    """The command of a pip: of this Python, else of one that is on the path.

    Raises
    ------
    SystemExit
        There is none.
    """
    names = (sys.executable, f"python{python}", "python3", "python")
    for interpreter in dict.fromkeys(path for name in names if (path := shutil.which(name))):
        done = subprocess.run([interpreter, "-m", "pip", "--version"], capture_output=True, check=False)
        if done.returncode == 0:
            return [interpreter, "-m", "pip"]
    raise SystemExit(f"{sys.executable} has no pip: install it (on Debian: apt install python3-pip) and try again")


def _download(python: str, packages: list[str], folder: Path) -> str:
    """Put packages for that version of Python, which need not be this one, into `folder`; what went wrong, or ''."""
    command = [*find_pip(python), "install", "--quiet", "--disable-pip-version-check", "--no-deps", "--upgrade"]
    # pip would ask whether packages are for the Python that it runs in; their wheels are chosen by version and tags.
    command += ["--python-version", python, "--only-binary", ":all:", "--ignore-requires-python"]
    command += ["--target", str(folder), *packages]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
    return "" if done.returncode == 0 else "\n".join(errors) or done.stderr or "pip failed"


def install(blender: str, *, link: bool = False, denoiser: bool = True) -> Path:
    """Install add-on and packages for `blender`, enable it; returns the add-on's folder.

    With `link` the add-on is a link to this checkout, for whoever works on it.

    Raises
    ------
    SystemExit
        It cannot be done; the message says why.
    """
    scripts, python = describe(blender)
    if not lock_file(python).is_file():
        versions = " and ".join(item.python for item in RANGES)
        raise SystemExit(f"{blender} runs Python {python}, and NeuralGuide has packages for {versions} only: "
                         "use a Blender of blender.org")  # fmt: skip
    # Packages first: an add-on without them would be found in Blender, and not work.
    modules = scripts / "modules"
    if problem := _download(python, pinned(python, REQUIREMENTS), modules):
        raise SystemExit(f"pip could not get the packages for Python {python}:\n{problem}")
    if denoiser and (problem := _download(python, [DENOISER], modules)):
        print(f"Without Open Image Denoise, so nothing is denoised; pip could not get it:\n{problem}", file=sys.stderr)
    folder = scripts / "addons" / "neuralguide"
    if folder.is_symlink():
        folder.unlink()
    if link:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.symlink_to(ROOT)
    else:
        stage_sources(folder)
    if "ENABLED=True" not in _run_in_blender(blender, _ENABLE):
        raise SystemExit(f"{blender} could not enable the add-on in {folder}")
    return folder


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("blender", nargs="?", default="blender", help="the binary to install into")
    parser.add_argument("--link", action="store_true", help="link to this checkout instead of copying it")
    parser.add_argument("--without-denoiser", action="store_true", help="save the 90 MB of Open Image Denoise")
    arguments = parser.parse_args()
    folder = install(arguments.blender, link=arguments.link, denoiser=not arguments.without_denoiser)
    print(f"installed {folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
