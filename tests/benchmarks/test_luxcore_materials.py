# SPDX-License-Identifier: GPL-3.0-or-later
"""What LuxCore's own scenes need: mixed and glowing materials, absorption, skies, sensors and shifts."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from benchmarks.luxcore.camera import export_camera
from benchmarks.luxcore.export import export_scene
from benchmarks.luxcore.materials import export_material
from benchmarks.scenes import studio
from tests.helpers.grey_floor import open_grey_floor


@pytest.fixture
def floor(blender: Any) -> Any:
    """The open scene: a grey floor, seen from above; no light."""
    return open_grey_floor(blender, 32, 24)


def _exported(surface: Callable[[Any], Any], volume: Callable[[Any], Any] | None = None) -> dict[str, Any]:
    return export_material(studio.material("tried", surface, volume), "m")


def _mixed(nodes: Any, factor: float = 0.08) -> Any:
    clear = nodes("BsdfTransparent", Color=(0.9, 0.8, 0.7))
    mirror = nodes("BsdfAnisotropic", Color=(0.6, 0.5, 0.4), Roughness=0.0)
    return nodes("MixShader", None, {0: factor, 1: clear, 2: mirror})


def test_a_mix_is_made_of_what_it_mixes(blender: Any) -> None:
    found = _exported(_mixed)
    assert found["scene.materials.m.type"] == "mix"
    assert found["scene.materials.m.amount"] == pytest.approx(0.08)
    names = list(found)
    expected = (("ma", "null", "transparency", (0.9, 0.8, 0.7)), ("mb", "mirror", "kr", (0.6, 0.5, 0.4)))
    for name, kind, socket, color in expected:
        assert found[f"scene.materials.{name}.type"] == kind
        assert found[f"scene.materials.{name}.{socket}"] == pytest.approx(color)
        # LuxCore knows no material that comes later.
        assert names.index(f"scene.materials.{name}.type") < names.index("scene.materials.m.type")


def test_glass_absorbs_by_distance_as_in_blender(blender: Any) -> None:
    found = _exported(
        lambda nodes: nodes("BsdfGlass", Color=(1.0, 1.0, 1.0), Roughness=0.0, IOR=1.33),
        lambda nodes: nodes("VolumeAbsorption", Color=(0.0, 0.75, 1.0), Density=0.2),
    )
    volume = found["scene.materials.m.volume.interior"]
    assert found[f"scene.volumes.{volume}.type"] == "clear"
    assert found[f"scene.volumes.{volume}.absorption"] == pytest.approx([0.2, 0.05, 0.0])
    assert found[f"scene.volumes.{volume}.ior"] == found["scene.materials.m.interiorior"] == pytest.approx(1.33)


@pytest.mark.parametrize(
    ("surface", "volume", "message"),
    [
        (lambda nodes: nodes("BsdfTranslucent"), None, "it has Translucent BSDF"),
        (
            lambda nodes: nodes("BsdfDiffuse", Color=nodes("TexChecker")),
            None,
            "its input Color is linked; LuxCore would not show it alike",
        ),
        (
            lambda nodes: nodes("BsdfDiffuse"), lambda nodes: nodes("VolumeAbsorption"),
            "it has a volume inside, and is no Glass",
        ),
        (
            lambda nodes: nodes("BsdfGlass", Roughness=0.0), lambda nodes: nodes("VolumeScatter"),
            "it has a Volume Scatter inside",
        ),
        (lambda nodes: nodes("BsdfGlass", Roughness=0.0, Thin_Film_Thickness=300.0), None, "its glass has a thin film"),
    ],
)  # fmt: skip
def test_materials_that_luxcore_would_not_show_alike_are_named(
    blender: Any, surface: Any, volume: Any, message: str
) -> None:
    with pytest.raises(ValueError, match=f"the material 'tried.*': {message}"):
        _exported(surface, volume)


def _glow(scene: Any) -> tuple[np.ndarray, np.ndarray]:
    """Corners and normals of the triangles that glow, (T, 3, 3) each."""
    found = export_scene(scene)
    name = next(name for name in found.properties if name.endswith("emission.gain")).split(".")[2]
    points, triangles, normals = found.meshes[name]
    assert found.properties[f"scene.materials.{name}.emission.gain"] == [800.0] * 3
    return points[triangles], normals[triangles]


@pytest.mark.parametrize("turned", [0.0, 180.0])
def test_what_glows_does_so_on_the_side_that_is_not_covered(floor: Any, turned: float) -> None:
    lamp = studio.quad("Lamp", studio.emitter((1.0, 1.0, 1.0), 800.0), 0.4, 0.3)
    studio.add_object("Lamp", lamp, (0.0, 0.0, 1.5), (turned, 0.0, 0.0))
    with pytest.raises(ValueError, match="'Lamp' glows on both sides, of which none is covered"):
        export_scene(floor)
    lid = studio.quad("Lid", studio.diffuse((0.0, 0.0, 0.0)), 0.4, 0.3)
    studio.add_object("Lid", lid, (0.0, 0.0, 1.501))
    corners, normals = _glow(floor)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (across[:, 2] < 0.0).all() and (normals[..., 2] < 0.0).all()


def test_what_glows_and_is_closed_does_so_outside(floor: Any) -> None:
    studio.add_object("Lamp", studio.sphere("Lamp", studio.emitter((1.0, 1.0, 1.0), 800.0), 0.1), (0.0, 0.0, 1.5))
    corners, _ = _glow(floor)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outwards = corners.mean(axis=1) - (0.0, 0.0, 1.5)
    assert (np.einsum("tk,tk->t", across, outwards) > 0.0).all()


def test_faces_of_two_materials_are_refused(floor: Any) -> None:
    box = studio.box("Box", studio.diffuse((0.5, 0.5, 0.5)))
    box.materials.append(studio.diffuse((0.1, 0.1, 0.1)))
    box.polygons[0].material_index = 1
    studio.add_object("Box", box)
    with pytest.raises(ValueError, match="'Box' has faces of a second material"):
        export_scene(floor)


def test_a_mirrored_mesh_keeps_its_front(floor: Any) -> None:
    floor.objects["Floor"].scale = (-1.0, 1.0, 1.0)
    points, triangles, normals = next(iter(export_scene(floor).meshes.values()))
    corners = points[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (across[:, 2] * normals[triangles][:, 0, 2] > 0.0).all()


@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("size", [(40, 24), (24, 40)])
def test_the_camera_sees_what_blender_s_sees(floor: Any, fit: str, size: tuple[int, int]) -> None:
    import bpy
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    studio.resolution(*size)
    data = floor.camera.data
    data.sensor_fit, data.shift_x, data.shift_y, data.sensor_height = fit, 0.1, -0.05, 20.0
    bpy.context.view_layer.update()
    found = export_camera(floor)
    left, right, low, high = found["scene.camera.screenwindow"]
    origin, target, up = (np.array(found[f"scene.camera.{name}"]) for name in ("lookat.orig", "lookat.target", "up"))
    forward = target - origin
    for place in ((0.3, 0.2, 0.0), (-0.4, 0.1, 0.5)):
        seen = np.array(place) - origin
        scale = (seen @ forward) * math.tan(math.radians(0.5 * found["scene.camera.fieldofview"]))
        x, y = seen @ np.cross(forward, up) / scale, seen @ up / scale
        expected = world_to_camera_view(floor, floor.camera, Vector(place))
        assert (x - left) / (right - left) == pytest.approx(expected.x, abs=1e-4)
        # LuxCore counts its rows from one above the lowest.
        assert (y - low) / (high - low) - 1.0 / size[1] == pytest.approx(expected.y, abs=1e-4)


def _sky(color: Any, **settings: Any) -> None:
    studio.world_nodes(
        lambda nodes: nodes(
            "Background", Strength=2.0,
            Color=nodes("TexEnvironment", {"image": studio.image("sky", color, True, "Linear Rec.709"), **settings}),
        )
    )  # fmt: skip


def test_a_picture_of_the_sky_is_a_light(floor: Any) -> None:
    picture = np.random.default_rng(1).random((4, 8, 4)).astype(np.float32)
    _sky(picture)
    found = export_scene(floor)
    assert found.properties["scene.lights.world.type"] == "infinite"
    assert found.properties["scene.lights.world.gain"] == [2.0] * 3
    np.testing.assert_allclose(found.images["world"], picture[::-1, :, :3])
    _sky(picture, projection="MIRROR_BALL")
    with pytest.raises(ValueError, match="its picture is not equirectangular"):
        export_scene(floor)
