# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays that several tests need and that take long to make, kept in a folder for the workers of one run."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


class KeptArrays:
    """Arrays in files of a folder.

    Parameters
    ----------
    folder : Path
        Of one run of the tests: what is made of other sources must not be found.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(self, name: str, make: Callable[[], np.ndarray[Any, Any]]) -> np.ndarray[Any, Any]:
        """The array of that name, made if it is not there yet.

        Who needs one while another worker makes it makes it too: waiting would take as long.
        """
        path = self._folder / f"{name}.npy"
        if path.is_file():
            return np.asarray(np.load(path, allow_pickle=False))
        made = make()
        # Put into place whole.
        handle, unfinished = tempfile.mkstemp(dir=self._folder)
        with os.fdopen(handle, "wb") as file:
            np.save(file, made, allow_pickle=False)
        os.replace(unfinished, path)
        return made
