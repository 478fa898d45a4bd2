# SPDX-License-Identifier: GPL-3.0-or-later
"""A user of a Blender binary who has installed the add-on."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tools.install_legacy import install


def installed(blender: str, folder: Path) -> dict[str, str]:
    """Install and enable the add-on for a user whose settings lie in `folder`; that user's environment."""
    paths = {"BLENDER_USER_CONFIG": str(folder / "config"), "BLENDER_USER_SCRIPTS": str(folder / "scripts")}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in paths.items():
            patch.setenv(name, value)
        patch.delenv("PYTHONPATH", raising=False)
        # A link, so that the kernels this run of the tests has compiled already serve here too.
        install(blender, link=True, denoiser=False)
    return {key: value for key, value in os.environ.items() if key != "PYTHONPATH"} | paths
