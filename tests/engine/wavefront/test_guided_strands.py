# SPDX-License-Identifier: GPL-3.0-or-later
"""What is learned changes no mean of fibres, whose lobes send light all around."""

from __future__ import annotations

import numpy as np
import pytest

from engine.scene.description import Link, Material, Mesh, Node, NodeGraph, SceneDescription
from engine.scene.digest import light_digest
from engine.scene.rounds import RIBBONS, ROUND, Rounds
from tests.helpers.media_renders import means_by_seed
from tests.helpers.media_scenes import media_scene, placed
from tests.helpers.small_scenes import material

_STRANDS = 40


def fur_scene(shape: str) -> SceneDescription:
    """Fibres of Chiang's model on top of a box, of which some 20 cm are seen, under a white sky."""
    rng = np.random.default_rng(7)
    keys = rng.uniform(-0.12, 0.12, (_STRANDS, 1, 3)) * (1.0, 1.0, 0.0)
    keys = keys + np.arange(3)[None, :, None] * (rng.normal(0.0, 0.02, (_STRANDS, 1, 3)) + (0.0, 0.0, 0.04))
    first = 3 * np.arange(_STRANDS)
    rows = np.stack([np.stack([first + k, first + k + 1, first], axis=1) for k in range(2)], axis=1).reshape(-1, 3)
    rounds = Rounds(shape, np.full(3 * _STRANDS, 0.006, np.float32))
    inputs = {"Color": (0.7, 0.5, 0.3, 1.0), "Roughness": 0.4, "Radial Roughness": 0.4, "IOR": 1.55}
    properties = {"model": "CHIANG", "parametrization": "COLOR"}
    hair = NodeGraph([Node("ShaderNodeBsdfHairPrincipled", "Hair", inputs, properties)], Link(0, "BSDF"))
    scene = media_scene([material(), Material("hair", "Hair", hair)], [placed(offset=(0.0, 0.0, -1.0)), np.eye(4)])
    vertices = keys.reshape(-1, 3).astype(np.float32)
    slots = np.zeros(len(rows), np.int32)
    scene.meshes.append(Mesh("s", "S", vertices, rows.astype(np.uint32), None, slots, rounds=rounds))
    scene.instances.mesh[1] = 1
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("shape", [RIBBONS, ROUND])
@pytest.mark.parametrize(
    "settings", [{"guiding_method": "VMM", "guiding_trial": False}, {"radiance_cache": "CONVERGING"}]
)
def test_what_is_learned_changes_no_mean_of_fur(settings: dict, shape: str) -> None:
    """By four standard errors, which are within 1% of the mean."""
    scene = fur_scene(shape)
    plain, learned = (means_by_seed(scene, samples=128, seeds=12, **given) for given in ({}, settings))
    error = np.hypot(plain.std(axis=0, ddof=1), learned.std(axis=0, ddof=1)) / np.sqrt(12)
    assert (4.0 * error <= 0.01 * plain.mean(axis=0)).all()
    assert (np.abs(plain.mean(axis=0) - learned.mean(axis=0)) <= 4.0 * error).all()


def test_learned_light_is_of_strands_of_these_radii() -> None:
    """A saved field is trusted less where anything that light depends on is another."""
    scene, same = fur_scene(ROUND), fur_scene(ROUND)
    assert light_digest(scene) == light_digest(same)
    strands = same.meshes[-1].rounds
    assert strands is not None
    strands.radii = strands.radii * np.float32(2.0)
    assert light_digest(scene) != light_digest(same)
    strands.radii, strands.motion_radii = strands.radii / np.float32(2.0), np.stack([strands.radii, strands.radii])
    assert light_digest(scene) != light_digest(same)
    assert light_digest(scene) != light_digest(fur_scene(RIBBONS))
