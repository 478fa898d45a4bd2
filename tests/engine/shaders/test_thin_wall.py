# SPDX-License-Identifier: GPL-3.0-or-later
"""What the compiler makes of the Principled BSDF's Thin Wall."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.kernels.bsdf import kinds
from engine.state.shaders import (
    MODE_CLOSURES,
    MODE_TRANSPARENCY,
    PROGRAM_FLAGS,
    PROGRAM_HAS_SUBSURFACE,
    PROGRAM_MAY_BE_TRANSPARENT,
    PROGRAM_TRANSPARENCY_CONSTANT,
)
from tests.helpers.shader_harness import Graph, compile_one, run

COLOR = (0.5, 0.5, 0.5, 1.0)
#: What a sheet of index 1.5 lets through straight on: its sides send back 4% each, and its inside lets half through.
THROUGH = 0.5 * 0.96 * 0.96 / (1.0 - (0.04 * 0.5) ** 2)


def _wall(**inputs: Any) -> tuple[Any, int]:
    graph = Graph()
    values = {"Base Color": COLOR, "Thin Wall": 1.0, **inputs}
    shaders, _names, notices = compile_one(graph.surface(graph.link("ShaderNodeBsdfPrincipled", "BSDF", inputs=values)))
    assert notices == []
    return shaders, int(shaders.programs[0, PROGRAM_FLAGS])


def test_a_leaf_has_no_inside() -> None:
    leaf = {"Subsurface Weight": 1.0, "Subsurface Anisotropy": 0.5, "Specular IOR Level": 0.0}
    for scale in (0.05, 0.0):
        shaders, flags = _wall(**leaf, **{"Subsurface Scale": scale})
        assert not flags & (PROGRAM_HAS_SUBSURFACE | PROGRAM_MAY_BE_TRANSPARENT)
        closures = run(shaders)
        assert closures.kind[0, : closures.count[0]].tolist() == [kinds.DIFFUSE, kinds.FIRST_TRANSLUCENT]
    _, flags = _wall(**leaf, **{"Subsurface Scale": 0.05, "Thin Wall": 0.0})
    assert flags & PROGRAM_HAS_SUBSURFACE


def test_shadow_rays_pass_smooth_glass_only() -> None:
    shaders, flags = _wall(**{"Transmission Weight": 1.0, "Roughness": 0.0, "Alpha": 0.5})
    assert flags & PROGRAM_MAY_BE_TRANSPARENT and not flags & PROGRAM_TRANSPARENCY_CONSTANT
    for mode in (MODE_CLOSURES, MODE_TRANSPARENCY):
        transparency = run(shaders, mode=mode).transparency[0, :3]
        np.testing.assert_allclose(transparency, 0.5 + 0.5 * THROUGH, rtol=1e-5)
    shaders, flags = _wall(**{"Transmission Weight": 1.0, "Roughness": 0.4})
    assert not flags & PROGRAM_MAY_BE_TRANSPARENT
    closures = run(shaders)
    assert sorted(closures.kind[0, : closures.count[0]].tolist()) == [kinds.THIN_GLASS, kinds.GLOSSY]
    assert not closures.transparency[0, :3].any()
    # Opaque surfaces have no other side.
    _, flags = _wall(**{"Roughness": 0.0})
    assert not flags & PROGRAM_MAY_BE_TRANSPARENT
