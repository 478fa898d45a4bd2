# SPDX-License-Identifier: GPL-3.0-or-later
"""Pits with what a camera or a scene may have besides: long paths, for all that is learned while a picture renders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from engine.scene.description import SceneDescription
from engine.scene.instances import plain_instances
from engine.scene.panorama import StereoEye
from engine.scene.rounds import RIBBONS
from tests.helpers.fur_scenes import fur_scene
from tests.helpers.media_scenes import placed
from tests.helpers.placed_quads import steps, turned
from tests.helpers.small_scenes import looking_down, material, pit_scene
from tests.helpers.subsurface_scenes import below, box_scene

_SIZE = 16, 16


def out_of_focus() -> SceneDescription:
    """Seen through a lens of 0.5 m, in focus 4 m above the floor."""
    scene = pit_scene(_SIZE)
    scene.camera = replace(scene.camera, use_dof=True, focus_distance=6.0, aperture_fstop=0.05)
    return scene


def eye_all_around() -> SceneDescription:
    """One eye of a panorama in stereo, in the middle of the pit."""
    scene = pit_scene(_SIZE)
    scene.camera = replace(looking_down(2.0), kind="PANO", eye=StereoEye(0.3, convergence=4.0))
    return scene


def moving_camera() -> SceneDescription:
    """The camera turns and goes to the side while the shutter is open."""
    scene = pit_scene(_SIZE)
    scene.camera.motion = steps(*(turned(0.2 * t, 1, (0.8 * t, 0.0, 10.0)) for t in (-1.0, 0.0, 1.0)))
    return scene


def holdout() -> SceneDescription:
    """One of the walls is a hole in the picture."""
    scene = pit_scene(_SIZE)
    scene.instances.is_holdout[1] = True
    return scene


def under_a_leaf() -> SceneDescription:
    """A translucent sheet covers part of the floor: the light below it has come through, or round it."""
    scene = pit_scene(_SIZE)
    sheet = np.diag([0.04, 0.04, 1.0, 1.0]).astype(np.float32)
    sheet[2, 3] = 2.0
    scene.instances = plain_instances([*scene.instances.transform, sheet], materials=[0, 0, 0, 0, 0, 1])
    scene.materials.append(material("Leaf", (0.6, 0.9, 0.3), "ShaderNodeBsdfTranslucent"))
    return scene


def with_skin() -> SceneDescription:
    """Light goes into the floor and the walls, and into a box that stands there."""
    scene, box = pit_scene(_SIZE), box_scene(below(color=(0.9, 0.8, 0.7), scale=0.3))
    scene.meshes.append(box.meshes[0])
    places = [*scene.instances.transform, placed((0.5, 0.5, 0.5), (0.5, 0.0, 0.6))]
    scene.instances = plain_instances(places, meshes=[0] * 5 + [1], materials=[0] * 5 + [1])
    scene.materials = [below("BURLEY", (0.9, 0.85, 0.8), scale=0.1), *box.materials]
    return scene


def with_hair() -> SceneDescription:
    """Fibres of more than a metre on the floor."""
    scene, fur = pit_scene(_SIZE), fur_scene(RIBBONS)
    strands = fur.meshes[1]
    assert strands.rounds is not None
    rounds = replace(strands.rounds, radii=15.0 * strands.rounds.radii)
    scene.meshes.append(replace(strands, vertices=15.0 * strands.vertices, rounds=rounds))
    places = [*scene.instances.transform, np.eye(4)]
    scene.instances = plain_instances(places, meshes=[0] * 5 + [1], materials=[0] * 5 + [1])
    scene.materials.append(fur.materials[1])
    return scene


PITS: dict[str, Callable[[], SceneDescription]] = {
    "out of focus": out_of_focus, "stereo panorama": eye_all_around, "moving camera": moving_camera,
    "holdout": holdout, "leaf": under_a_leaf, "skin": with_skin, "hair": with_hair,
}  # fmt: skip
