# SPDX-License-Identifier: GPL-3.0-or-later
"""How large image files are, without reading their pixels: by OpenImageIO as Blender brings it."""

from __future__ import annotations

from collections.abc import Container

import bpy

from .bundled_modules import find_bundled

#: Values of a texel.
_CHANNELS = 4


def texel_bytes(path: str) -> int:
    """Memory of a file's texels as the engine has them [bytes]; 0 where that cannot be told."""
    library = find_bundled("OpenImageIO")
    if library is None:
        return 0
    opened = library.ImageInput.open(path)
    if opened is None:
        library.geterror()
        return 0
    size = opened.spec()
    opened.close()
    return int(size.width * size.height * _CHANNELS * (1 if size.format == "uint8" else 4))


def expected_bytes(known: Container[str]) -> int:
    """Memory of the texels of all image files that materials, worlds, lights and node groups use [bytes].

    Parameters
    ----------
    known : container of str
        Full names of the images that do not count.
    """
    total = 0
    for image, users in bpy.data.user_map(key_types={"IMAGE"}).items():
        is_file = image.source == "FILE" and image.packed_file is None
        if is_file and image.name_full not in known and any(isinstance(user, _USERS) for user in users):
            total += texel_bytes(bpy.path.abspath(image.filepath_raw, library=image.library))
    return total


_USERS = (bpy.types.Material, bpy.types.World, bpy.types.Light, bpy.types.NodeTree)
