# SPDX-License-Identifier: GPL-3.0-or-later
"""Entry of the engine's processes, run by path: `python .../processes/__main__.py`.

Standard input brings one line of JSON with the configuration, then messages; its end is the order to go. Standard
output carries answers. Nothing of the engine can be imported before the configuration tells what its package is called:
`engine` in a checkout, a part of Blender's own packages in an extension.
"""

import importlib
import json
import os
import sys
import types
from pathlib import Path


def find_engine(engine: str) -> None:
    """Make `engine` (the engine's own name in the renderer) importable, without running an add-on's `__init__`."""
    root = Path(__file__).resolve().parents[2]
    parents = engine.split(".")[:-1]
    if not parents:
        sys.path.insert(0, str(root))
    for depth in range(len(parents)):
        name = ".".join(parents[: depth + 1])
        module = types.ModuleType(name)
        module.__path__ = [str(root)] if depth == len(parents) - 1 else []
        sys.modules[name] = module


def main() -> None:
    """Read the configuration, hand over to the service."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # What libraries print must not look like an answer.
    line = sys.stdin.buffer.readline()
    if not line:
        return
    config = json.loads(line)
    if config["has_same_path"]:
        sys.path[:] = config["path"]
    # The folder of this file came first on the path: its modules are not top-level ones.
    sys.path[:] = [entry for entry in sys.path if Path(entry or ".").resolve() != Path(__file__).resolve().parent]
    sys.path.extend(entry for entry in config["path"] if entry not in sys.path)
    find_engine(config["engine"])
    try:
        service = importlib.import_module(f"{config['engine']}.{config['service']}")
    except ImportError as error:
        answers.write(json.dumps({"kind": "failed", "reason": f"{error} (in {sys.executable})"}) + "\n")
        answers.flush()
        sys.exit(f"{error} (in {sys.executable})")
    service.serve(config, sys.stdin.buffer, answers)


if __name__ == "__main__":
    main()
