# SPDX-License-Identifier: GPL-3.0-or-later
"""Photometric data of IES Texture nodes: text of the scene, or of a file."""

from __future__ import annotations

from pathlib import Path

import bpy


def read_photometry(node: bpy.types.ShaderNodeTexIES) -> str:
    """Text that an IES Texture shows; '' if there is none.

    Raises
    ------
    ValueError
        If its file cannot be read.
    """
    if node.mode == "INTERNAL":
        return "" if node.ies is None else "".join(f"{line.body}\n" for line in node.ies.lines)
    if not node.filepath:
        return ""
    path = bpy.path.abspath(node.filepath, library=node.id_data.library)
    try:
        # Makers of lamps write in whatever encoding: numbers are the same in all.
        return Path(path).read_bytes().decode("latin-1").replace("\r\n", "\n")
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from error
