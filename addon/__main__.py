# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m addon -b scene.blend -E NEURALGUIDE -o //render_#### -f 1`: Blender's command line without Blender."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence

from . import console
from .cli_arguments import USAGE, CommandLineError, parse_arguments


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line; returns the exit code."""
    try:
        return _run(arguments)
    finally:
        console.leave()


def _run(arguments: Sequence[str] | None) -> int:
    try:
        actions = parse_arguments(sys.argv[1:] if arguments is None else arguments)
    except CommandLineError as error:
        console.complain(str(error))
        return 2
    names = {action.name for action in actions}
    if "help" in names or not actions:
        console.say(USAGE.rstrip("\n"))
        return 0 if actions else 2
    if importlib.util.find_spec("bpy") is None:
        console.complain("this Python has no bpy; `make demo` sets one up")
        return 2
    if "version" in names:
        import bpy

        from .bug_report import our_version

        console.say(f"Blender {bpy.app.version_string} as a module")
        console.say(f"NeuralGuide {our_version()}")
        return 0
    if "report" in names:
        from .bug_report import bug_report

        console.say(bug_report().rstrip("\n"))
        return 0
    from . import cli

    return cli.run(actions)


if __name__ == "__main__":
    sys.exit(main())
