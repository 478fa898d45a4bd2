# SPDX-License-Identifier: GPL-3.0-or-later
"""NeuralGuide as Blender finds it: forwards to `addon`.

In the packaged extension every import is relative (tools/build_extension.py sees to it), since an extension may put
nothing on `sys.path`. In a checkout the packages are called `addon` and `engine`; used as an add-on straight from
there, the folder has to be on the path.
"""

import importlib
import sys
from pathlib import Path

# Read by Blender before 4.2; later ones read blender_manifest.toml.
bl_info = {
    "name": "NeuralGuide",
    "author": "NeuralGuide developers",
    "version": (0, 1, 0),
    "blender": (3, 4, 0),
    "location": "Properties > Render > Render Engine",
    "description": "CPU path tracer that renders scenes made for Cycles",
    "category": "Render",
}

_FOLDER = Path(__file__).resolve().parent


def _addon():
    if (_FOLDER / "pyproject.toml").is_file():
        if str(_FOLDER) not in sys.path:
            sys.path.append(str(_FOLDER))
        return importlib.import_module("addon")
    return importlib.import_module(".addon", __package__)


def register():
    """Called by Blender when the add-on is enabled."""
    _addon().register(__name__)


def unregister():
    """Called by Blender when it is disabled."""
    _addon().unregister()
