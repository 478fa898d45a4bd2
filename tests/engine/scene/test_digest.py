# SPDX-License-Identifier: GPL-3.0-or-later
"""Digests of long lists: the same for the same, another for any difference in any item."""

from __future__ import annotations

import os
import subprocess
import sys
from copy import deepcopy
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from engine.render.session import Session
from engine.scene.description import Light, Link, Node, NodeGraph
from engine.scene.digest import SceneDigest, content_digest, scene_digest
from engine.settings import RenderSettings
from tests.helpers.small_scenes import pit_scene

ROOT = Path(__file__).resolve().parents[3]
COUNT = 300
#: Of a light, another value for each field.
OTHERS = {
    "key": ("light", ("Lamp", 999)), "name": "Other", "kind": "SPOT", "transform": 2 * np.eye(4, dtype=np.float32),
    "color": (1.0, 1.0, 0.5), "energy": 1, "shape": "DISK", "graph": NodeGraph(), "max_bounces": 7, "visibility": 3,
    "light_group": 5, "object_color": (0.5, 1.0, 1.0, 1.0),
}  # fmt: skip


def lights():
    graph = NodeGraph([Node("ShaderNodeEmission", "Emission")], surface=Link(0, "Emission"))
    return [
        Light(
            key=("light", ("Lamp", number)), name="Lamp", kind="POINT", transform=np.eye(4, dtype=np.float32),
            color=(1.0, 0.5, 0.5), energy=1.0, graph=graph if number % 2 else None,
        )
        for number in range(COUNT)
    ]


def test_equal_lists_have_one_digest():
    assert content_digest(lights()) == content_digest(deepcopy(lights()))


@pytest.mark.parametrize("name", [field.name for field in fields(Light)])
def test_every_field_counts(name):
    changed = lights()
    before = getattr(changed[123], name)
    other = OTHERS[name] if name in OTHERS else not before if isinstance(before, bool) else before + 0.25
    setattr(changed[123], name, other)
    assert content_digest(changed) != content_digest(lights())


def test_sets_of_texts_have_one_digest_in_all_processes():
    """Their order in memory goes by the seed of hashes."""
    code = (
        "from engine.scene.description import Node; from engine.scene.digest import content_digest;"
        "print(content_digest(Node('A', 'a', changed=frozenset('abcdefgh'))), *frozenset('abcdefgh'))"
    )
    said = [
        subprocess.run(
            [sys.executable, "-c", code], env=os.environ | {"PYTHONHASHSEED": seed}, capture_output=True, text=True,
            cwd=ROOT, check=True,
        ).stdout.split(maxsplit=1)
        for seed in ("1", "2")
    ]  # fmt: skip
    assert said[0][1] != said[1][1], "the sets are to be in another order"
    assert said[0][0] == said[1][0]
    other = Node("A", "a", changed=frozenset("abcdefg"))
    assert content_digest(other) != said[0][0]


def test_what_is_left_out_does_not_count():
    changed = lights()
    changed[5].key, changed[6].light_group = "other", 2
    left_out = ("key", "light_group")
    assert content_digest(changed, left_out) == content_digest(lights(), left_out)


def test_what_is_inside_shared_parts_counts():
    changed = lights()
    changed[1].graph.nodes[0].properties["use"] = True
    assert content_digest(changed) != content_digest(lights())


def test_order_counts():
    changed = lights()
    changed[0], changed[1] = changed[1], changed[0]
    assert content_digest(changed, ("key",)) != content_digest(lights(), ("key",))


def test_a_scene_has_the_same_digest_once_it_is_built():
    """Whoever asks late is told of the scene as it was, though its meshes are gone by then."""
    whole = scene_digest(pit_scene())
    for keeps_meshes in (True, False):
        description = pit_scene()
        late = SceneDigest(description, keeps_meshes=keeps_meshes)
        Session(RenderSettings(threads=1)).load(description, keeps_meshes=keeps_meshes)
        assert (len(description.meshes[0].vertices) > 0) == keeps_meshes
        assert late.value == whole


@pytest.mark.parametrize("change", ["context", "mesh", "camera"])
def test_another_scene_has_another_digest(change):
    description = pit_scene()
    if change == "mesh":
        description.meshes[0].vertices = description.meshes[0].vertices + 1e-3
    if change == "camera":
        description.camera.transform = description.camera.transform + 1e-3
    assert SceneDigest(description, ("layer",) if change == "context" else ()).value != scene_digest(pit_scene())
