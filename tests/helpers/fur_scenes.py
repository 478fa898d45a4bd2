# SPDX-License-Identifier: GPL-3.0-or-later
"""Fibres on a box, and such on a box that light goes into."""

from __future__ import annotations

import numpy as np

from engine.scene.description import Link, Material, Mesh, Node, NodeGraph, SceneDescription
from engine.scene.rounds import RIBBONS, Rounds
from tests.helpers.media_scenes import media_scene, placed
from tests.helpers.small_scenes import material
from tests.helpers.subsurface_scenes import below

_STRANDS = 40


def chiang() -> Material:
    """Fibres of Chiang's model."""
    inputs = {"Color": (0.7, 0.5, 0.3, 1.0), "Roughness": 0.4, "Radial Roughness": 0.4, "IOR": 1.55}
    properties = {"model": "CHIANG", "parametrization": "COLOR"}
    hair = NodeGraph([Node("ShaderNodeBsdfHairPrincipled", "Hair", inputs, properties)], Link(0, "BSDF"))
    return Material("hair", "Hair", hair)


def hair_fibre(component: str) -> Material:
    """Fibres of the Hair BSDF's Reflection or Transmission."""
    inputs = {"Color": (0.7, 0.5, 0.3, 1.0), "Offset": 0.0, "RoughnessU": 0.4, "RoughnessV": 0.4}
    hair = NodeGraph([Node("ShaderNodeBsdfHair", "Hair", inputs, {"component": component})], Link(0, "BSDF"))
    return Material("hair", "Hair", hair)


def fur_scene(shape: str, ground: Material | None = None, fibre: Material | None = None) -> SceneDescription:
    """Fibres on top of a box, of which some 20 cm are seen, under a white sky; `fibre` by default `chiang()`."""
    rng = np.random.default_rng(7)
    keys = rng.uniform(-0.12, 0.12, (_STRANDS, 1, 3)) * (1.0, 1.0, 0.0)
    keys = keys + np.arange(3)[None, :, None] * (rng.normal(0.0, 0.02, (_STRANDS, 1, 3)) + (0.0, 0.0, 0.04))
    first = 3 * np.arange(_STRANDS)
    rows = np.stack([np.stack([first + k, first + k + 1, first], axis=1) for k in range(2)], axis=1).reshape(-1, 3)
    rounds = Rounds(shape, np.full(3 * _STRANDS, 0.006, np.float32))
    materials = [ground or material(), fibre or chiang()]
    scene = media_scene(materials, [placed(offset=(0.0, 0.0, -1.0)), np.eye(4)])
    vertices = keys.reshape(-1, 3).astype(np.float32)
    slots = np.zeros(len(rows), np.int32)
    scene.meshes.append(Mesh("s", "S", vertices, rows.astype(np.uint32), None, slots, rounds=rounds))
    scene.instances.mesh[1] = 1
    return scene


def fur_on_skin() -> SceneDescription:
    """Flat fibres on a box that light goes into."""
    return fur_scene(RIBBONS, below("RANDOM_WALK_SKIN", (0.8, 0.5, 0.4), scale=0.1))
