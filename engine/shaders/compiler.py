# SPDX-License-Identifier: GPL-3.0-or-later
"""Node graphs to `ShaderArrays`: constants folded, equal work shared, one run of code for each mode of evaluation."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from engine.array_types import Float32Array
from engine.scene.description import Image, Notice
from engine.shaders.assembly import shader_arrays
from engine.shaders.compiled_program import ProgramSource
from engine.shaders.pools import ScenePools
from engine.shaders.program_cache import ProgramCache
from engine.state.shaders import ShaderArrays, identity_camera

#: Deep chains of nodes recurse a few Python frames per node.
_RECURSION_LIMIT = 50_000


def compile_programs(
    sources: Sequence[ProgramSource],
    images: Sequence[Image],
    camera: Float32Array | None = None,
    to_xyz: Float32Array | None = None,
    cache: ProgramCache | None = None,
    grid_names: frozenset[str] = frozenset(),
) -> tuple[ShaderArrays, list[str], list[Notice]]:
    """Compile one program per source, in their order.

    Parameters
    ----------
    camera : float32 (CAMERA_ROWS, CAMERA_WIDTH), optional
        Spaces of the camera, as `ShaderArrays.camera`; None: all are the world.
    to_xyz : float32 (3, 3), optional
        From the working space to CIE XYZ (D65); None for Rec.709.
    cache : ProgramCache, optional
        Updated: programs and images that have not changed are not made again.
    grid_names : frozenset of str
        Grids that any volume of the scene has.

    Returns
    -------
    ShaderArrays
    attribute_names : list of str
        Name of each attribute slot that programs read. `'X.tangent'` is the tangent of UV map X, `'.tangent'` that of
        each mesh's render-active UV map; `'object:x'` and `'instancer:x'` are properties of instances. A mesh without
        the attribute leaves the slot absent.
    notices : list of Notice
        What is not supported, with `'name / node'` as subject.
    """
    cache = ProgramCache() if cache is None else cache
    pools = ScenePools(images, to_xyz, grid_names)
    with _recursion():
        compiled = cache.compile(pools, sources)
    camera = identity_camera() if camera is None else camera
    image_pool = cache.images.get(images)
    # An estimate of emission may see the camera.
    seen = camera.tobytes() if any(program.emission is None and program.sees_camera for program in compiled) else b""
    # Names and graphs of sources are in the programs.
    numbers = tuple((source.kind, source.pass_index, source.dispersion) for source in sources)
    arrays = cache.arrays.get(
        (compiled, numbers, cache.images.version, seen),
        lambda: shader_arrays(sources, compiled, pools, image_pool, camera),
    )
    if not np.array_equal(arrays.camera, camera):
        arrays = arrays._replace(camera=camera)
    return arrays, pools.attribute_names, pools.notices + image_pool.notices


@contextmanager
def _recursion() -> Iterator[None]:
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(max(limit, _RECURSION_LIMIT))
    try:
        yield
    finally:
        sys.setrecursionlimit(limit)
