# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m addon -b scene.blend -E NEURALGUIDE -o //render_#### -f 1`: Blender's command line without Blender."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence

from .cli_arguments import USAGE, CommandLineError, parse_arguments


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line; returns the exit code."""
    try:
        actions = parse_arguments(sys.argv[1:] if arguments is None else arguments)
    except CommandLineError as error:
        print(f"NeuralGuide: Error: {error}", file=sys.stderr)
        return 2
    names = {action.name for action in actions}
    if "help" in names or not actions:
        print(USAGE, end="")
        return 0 if actions else 2
    if importlib.util.find_spec("bpy") is None:
        print("NeuralGuide: Error: this Python has no bpy; `make demo` sets one up", file=sys.stderr)
        return 2
    if "version" in names:
        import bpy

        from .bug_report import our_version

        print(f"Blender {bpy.app.version_string} as a module")
        print(f"NeuralGuide {our_version()}")
        return 0
    if "report" in names:
        from .bug_report import bug_report

        print(bug_report(), end="")
        return 0
    from . import cli

    return cli.run(actions)


if __name__ == "__main__":
    sys.exit(main())
