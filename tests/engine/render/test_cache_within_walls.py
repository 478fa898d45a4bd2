# SPDX-License-Identifier: GPL-3.0-or-later
"""What is sealed stays black beside lit things of its own material, though paths end in cells of several times a wall's
thickness. The camera sees into it through what only light meets.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from engine.scene.description import VISIBLE_CAMERA, Camera, Frame, Mesh, SceneDescription, World
from engine.scene.instances import plain_instances
from tests.helpers.seeded_renders import render
from tests.helpers.small_scenes import material

pytestmark = pytest.mark.estimator

#: Of a box: corners, and triangles whose fronts are outside.
CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
TRIANGLES = np.array(
    [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
     (1, 5, 7), (1, 7, 3)], np.uint32,
)  # fmt: skip
SIZE = (48, 36)


def looking(eye, at):
    """A camera that looks from one point at another [m]."""
    back = np.subtract(eye, at) / np.linalg.norm(np.subtract(eye, at))
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(back, right), back, eye], axis=1)
    return Camera(transform=matrix.astype(np.float32))


def boxes(corners, hidden, camera):
    """White boxes from one corner to the other under a sky; the camera does not see one of them."""
    transforms = []
    for low, high in corners:
        matrix = np.diag([*np.subtract(high, low), 1.0])
        matrix[:3, 3] = low
        transforms.append(matrix)
    instances = plain_instances(transforms, name="Box")
    instances.visibility[hidden] &= ~np.uint32(VISIBLE_CAMERA)
    return SceneDescription(
        camera=camera, frame=Frame(*SIZE, (0, 0, *SIZE)),
        meshes=[Mesh("box", "Box", CORNERS, TRIANGLES, None, np.zeros(len(TRIANGLES), np.int32))],
        instances=instances, materials=[material(color=(0.8, 0.8, 0.8))], images=[], lights=[],
        world=World("sky", "Sky", None, (1.0, 1.0, 1.0)),
    )  # fmt: skip


def thing_in_a_slab(thickness):
    """The slab floats above a lit floor."""
    inside = ((-0.3, -0.3, 0.3 + 0.2 * thickness), (0.3, 0.3, 0.3 + 0.5 * thickness))
    slab = ((-2, -2, 0.3), (2, 2, 0.3 + thickness))
    return boxes([((-8, -8, -0.5), (8, 8, 0)), slab, inside], 1, looking((0, -2, 2), (0, 0, 0.3)))


def sealed_room(wall):
    """A room of a metre without a lamp, of six slabs, on a lit floor; the last slab is the one that is not seen."""
    i, o, low, high = 0.5, 0.5 + wall, 0.3 + wall, 1.3 + wall
    slabs = [
        ((-o, -o, 0.3), (o, o, low)), ((-o, -o, high), (o, o, high + wall)), ((-o, -o, low), (-i, o, high)),
        ((i, -o, low), (o, o, high)), ((-i, i, low), (i, o, high)), ((-i, -o, low), (i, -i, high)),
    ]  # fmt: skip
    return boxes([((-8, -8, -0.5), (8, 8, 0)), *slabs], 6, looking((0, -3, 0.9), (0, 0, 0.8)))


def light_where_none_is(description, cache):
    """Mean of what is sealed over that of the picture, and the share of paths that ended in cells after one bounce."""
    settings = {"scene": lambda: description, "samples": 64, "max_bounces": 12, "diffuse_bounces": 12}
    true, cached = (render("OFF", seed, radiance_cache=how, **settings) for seed, how in ((1, "OFF"), (2, cache)))
    truth, picture = (one.passes["Combined"][..., :3].mean(axis=-1) for one in (true, cached))
    # Pixels at its edge see what is outside too.
    is_sealed = binary_erosion(truth == 0.0, np.ones((3, 3)))
    assert is_sealed.mean() > 0.03 and truth.mean() > 0.1
    return picture[is_sealed].mean() / truth.mean(), cached.report.cached_shares[0]


@pytest.mark.parametrize("thickness", [0.1, 0.3])
def test_a_thing_within_a_slab_does_not_see_what_lights_the_slab(thickness):
    """7 and 5% of the picture's mean where both sides of a face shared a cell."""
    light, ended = light_where_none_is(thing_in_a_slab(thickness), "FAST")
    assert ended > 0.5 and light < 0.01


@pytest.mark.parametrize("wall", [0.02, 0.1])
def test_light_does_not_come_through_the_walls_of_a_sealed_room(wall):
    light, ended = light_where_none_is(sealed_room(wall), "FAST")
    assert ended > 0.2 and light == 0.0
    light, _ = light_where_none_is(sealed_room(wall), "CONVERGING")
    assert light < 0.002
