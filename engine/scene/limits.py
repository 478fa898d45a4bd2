# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be rendered: what is too large for this machine, and what would be outside of arrays."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np

from engine.scene.bake import bands_of
from engine.scene.description import Frame, SceneDescription

#: Memory for a pixel: the film's sums, the picture made of them and the host's copy, without passes.
_BYTES_PER_PIXEL = 80
#: Where Linux tells how much memory a container may use.
_LIMIT_FILES = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
#: What building a scene adds to its description at its most [bytes]: a triangle's share of the arrays and of Embree's
#: hierarchy, an instance, a light.
_BYTES_PER_TRIANGLE, _BYTES_PER_INSTANCE, _BYTES_PER_LIGHT = 160, 500, 3000
#: A key of a strand or a point, its share of the description included [bytes].
_BYTES_PER_KEY = 200
#: Memory for a channel of a pass: the engine's image of it and the host's.
_BYTES_PER_CHANNEL = 8
#: Memory for a texel of a bake, without the image itself: places as Blender has them, one of its passes as it is read,
#: and the picture; and for one of those that are rendered at once: its place as kernels read it, and its film
#: (docs/decisions/baking.md).
_BYTES_PER_TEXEL, _BYTES_PER_TEXEL_AT_ONCE = 60, 184
#: Where the system does not tell how much memory it has.
_USUAL_MEMORY = 1 << 35


def physical_memory() -> int:
    """Memory of this machine [bytes]."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # Windows has none of it
        return _USUAL_MEMORY


def usable_memory() -> int:
    """Memory that this process may use [bytes]: the machine's, or what it is limited to."""
    most = physical_memory()
    for path in _LIMIT_FILES:
        try:
            most = min(most, int(Path(path).read_text(encoding="ascii")))
        except (OSError, ValueError):  # there is no such file, or it says "max"
            continue
    return most


def swap_memory() -> int:
    """Memory that this machine has on disk [bytes]; 0 where the system does not tell."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next((int(line.split()[1]) << 10 for line in lines if line.startswith("SwapTotal")), 0)
    except (OSError, ValueError):
        return 0


def resident_memory() -> int:
    """Memory that this process has now [bytes]; 0 where the system does not tell."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, AttributeError):
        return 0


def check_memory(description: SceneDescription) -> None:
    """Refuse a scene that this machine cannot hold: before it is built, since the system would end the process.

    Raises
    ------
    ValueError
        Naming what is large, and saying what to do.
    """
    triangles = sum(len(mesh.triangles) for mesh in description.meshes)
    instances, lights = len(description.instances.mesh), len(description.lights)
    building = triangles * _BYTES_PER_TRIANGLE + instances * _BYTES_PER_INSTANCE + lights * _BYTES_PER_LIGHT
    needed, there = resident_memory() + building, usable_memory() + swap_memory()
    if needed > there:
        raise ValueError(
            f"the scene needs {needed / 2**30:.1f} GiB of memory and this machine has {there / 2**30:.1f}: it has "
            f"{triangles:,} triangles, {instances:,} instances and {lights:,} lights. Lower subdivisions, instance "
            "objects instead of copying them, or render parts of the scene on view layers of their own"
        )


def check_memory_of(triangles: int, subject: str) -> None:
    """Refuse so many triangles, before they are made, if this machine cannot hold them.

    Raises
    ------
    ValueError
        Saying how many it would be of `subject`, and what to do.
    """
    needed, there = resident_memory() + triangles * _BYTES_PER_TRIANGLE, usable_memory() + swap_memory()
    if needed > there:
        raise ValueError(
            f"{subject} would be about {triangles:,} triangles, which need {needed / 2**30:.1f} GiB of memory, and "
            f"this machine has {there / 2**30:.1f}: raise the dicing rate or lower Max Subdivisions"
        )


def check_memory_of_strands(keys: int, strands: int, subject: str) -> None:
    """Refuse so many strands, before they are read, if this machine cannot hold them.

    Raises
    ------
    ValueError
        Saying how many there are of `subject`, and what to do.
    """
    needed, there = resident_memory() + keys * _BYTES_PER_KEY, usable_memory() + swap_memory()
    if needed > there:
        raise ValueError(
            f"{subject} has {strands:,} strands of {keys:,} keys, which need {needed / 2**30:.1f} GiB of memory, and "
            f"this machine has {there / 2**30:.1f}: lower the number of strands or of their steps"
        )


def check_film(frame: Frame, sums: int, channels: int) -> None:
    """Refuse a picture whose passes this machine cannot hold.

    Parameters
    ----------
    sums : int
        Size of a pixel of the film [bytes].
    channels : int
        Channels of all passes together.

    Raises
    ------
    ValueError
        Saying what to do.
    """
    x0, y0, x1, y1 = frame.region
    needed = resident_memory() + (x1 - x0) * (y1 - y0) * (sums + channels * _BYTES_PER_CHANNEL)
    there = usable_memory() + swap_memory()
    if needed > there:
        raise ValueError(
            f"{x1 - x0} x {y1 - y0} pixels with passes of {channels} channels need {needed / 2**30:.1f} GiB of memory "
            f"and this machine has {there / 2**30:.1f}: leave passes out, lower the resolution or set a render border"
        )


def check_copy(size: int) -> None:
    """Raise MemoryError where this process would need more memory than there is for so many bytes more: the system
    would end it.
    """
    if resident_memory() + size > usable_memory():
        raise MemoryError


def check_baked_image(width: int, height: int, subject: str) -> None:
    """Refuse an image to bake, before room is made for it, if this machine cannot hold what a bake of it takes.

    Raises
    ------
    ValueError
        Saying what of `subject` it is, and what to do.
    """
    at_once = width * max(end - first for first, end in bands_of(width, height))
    needed = resident_memory() + width * height * _BYTES_PER_TEXEL + at_once * _BYTES_PER_TEXEL_AT_ONCE
    there = usable_memory() + swap_memory()
    if needed > there:
        raise ValueError(
            f"{subject}: to bake an image of {width} x {height} pixels needs {needed / 2**30:.0f} GiB of memory and "
            f"this machine has {there / 2**30:.0f}: bake a smaller image, or spread UVs over tiles or several images"
        )


def texture_memory(chosen: int) -> int:
    """Memory that textures may take before they lie in a file [bytes].

    Parameters
    ----------
    chosen : int
        `RenderSettings.texture_memory` [MiB], 0 = half of what there is.
    """
    return chosen << 20 if chosen else usable_memory() // 2


def check_frame(frame: Frame) -> None:
    """Refuse an image that cannot be.

    Raises
    ------
    ValueError
        Saying what to do.
    """
    x0, y0, x1, y1 = frame.region
    if frame.width < 1 or frame.height < 1:
        raise ValueError(f"the image is {frame.width} x {frame.height}: set a resolution of at least 1 x 1")
    if not (0 <= x0 < x1 <= frame.width and 0 <= y0 < y1 <= frame.height):
        raise ValueError(f"the render border {frame.region} is empty or outside {frame.width} x {frame.height} pixels")
    if not 0.0 <= frame.exposure < math.inf:
        raise ValueError(f"the film's exposure is {frame.exposure}: choose a finite number, 0 or more")
    needed, there = (x1 - x0) * (y1 - y0) * _BYTES_PER_PIXEL, usable_memory()
    if needed > there:
        raise ValueError(
            f"{x1 - x0} x {y1 - y0} pixels need {needed / 2**30:.0f} GiB of memory and this machine has "
            f"{there / 2**30:.0f}: lower the resolution or set a render border"
        )


def check_links(description: SceneDescription) -> None:
    """Raise ValueError where light groups, or links of lights, are not those of the scene."""
    check_light_groups(description)
    if description.linking is not None:
        description.linking.check(len(description.instances.mesh), len(description.lights))


def check_light_groups(description: SceneDescription) -> None:
    """Refuse light groups that are not among the scene's: kernels count their light without looking.

    Raises
    ------
    ValueError
        Naming the object.
    """
    instances, world = description.instances, description.world
    groups = [(f"light {light.name}", light.light_group) for light in description.lights]
    if world is not None:
        groups.append((f"world {world.name}", world.light_group))
    if instances.light_group is not None and len(instances.light_group):
        for index in {int(np.argmin(instances.light_group)), int(np.argmax(instances.light_group))}:
            groups.append((f"object {instances.name[index]}", int(instances.light_group[index])))
    for subject, group in groups:
        if not -1 <= group < len(description.light_groups):
            raise ValueError(
                f"{subject} is of light group {group}: there are {len(description.light_groups)}, -1 is none"
            )
