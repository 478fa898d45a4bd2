# SPDX-License-Identifier: GPL-3.0-or-later
"""What older Blenders' nodes mean in the terms of Blender 5.2."""

from __future__ import annotations

from typing import Any

import pytest

from addon.export import node_versions
from engine.scene.description import Link, Node


@pytest.mark.parametrize("kind, name", [
    ("ShaderNodeSubsurfaceScattering", "Anisotropy"), ("ShaderNodeBsdfPrincipled", "Subsurface Anisotropy"),
])  # fmt: skip
def test_backward_scattering_counts_as_even_before_blender_5_2(kind: str, name: str, monkeypatch: Any) -> None:
    """Means of Cycles 5.0 for -0.6 and for 0 agree in five digits."""
    monkeypatch.setattr(node_versions, "is_since", lambda since: since <= (5, 1))
    assert node_versions.modernize(Node(kind, kind, {name: -0.6}), 7)[-1].inputs[name] == 0.0
    assert node_versions.modernize(Node(kind, kind, {name: 0.4}), 7)[-1].inputs[name] == 0.4
    most, node = node_versions.modernize(Node(kind, kind, {name: Link(3, "Value")}), 7)
    assert node.inputs[name] == Link(7, "Value")
    assert (most.kind, most.properties["operation"]) == ("ShaderNodeMath", "MAXIMUM")
    assert most.inputs == {"Value": Link(3, "Value"), "Value_001": 0.0}
    monkeypatch.setattr(node_versions, "is_since", lambda since: True)
    (node,) = node_versions.modernize(Node(kind, kind, {name: -0.6}), 7)
    assert node.inputs[name] == -0.6


@pytest.mark.parametrize("version", [(5, 0), (5, 2), (5, 3)])
@pytest.mark.parametrize("kind", ["ShaderNodeBsdfDiffuse", "ShaderNodeBsdfPrincipled"])
def test_rough_diffuse_says_how_its_version_tints(kind: str, version: tuple[int, int], monkeypatch: Any) -> None:
    monkeypatch.setattr(node_versions, "is_since", lambda since: version >= since)
    node = node_versions.modernize(Node(kind, kind), 0)[-1]
    assert node.properties["tints_by_bounce"] == (version >= (5, 3))
