# SPDX-License-Identifier: GPL-3.0-or-later
"""Smoke and fire of simulations: what becomes of a domain's grids.

The solver of bpy, the module, does not run (its classes inherit nothing), so that a stand-in has what a domain would.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from engine.scene.grids import TILE, unpack_values
from tests.helpers.blender_scenes import empty_scene

SIZE = (4, 5, 6)


class _Values(list):
    """Numbers of a domain as Blender hands them out."""

    def foreach_get(self, target: np.ndarray) -> None:
        target[:] = self


def domain(**changes: Any) -> SimpleNamespace:
    """Settings of a domain: voxel (i, j, k) has the density 1 + i + 10 j + 100 k, and so on."""
    k, j, i = np.meshgrid(*(np.arange(count) for count in SIZE[::-1]), indexing="ij")
    density = (1.0 + i + 10.0 * j + 100.0 * k).astype(np.float32)
    color = np.stack([0.5 * density, 0.0 * density, density, density], axis=-1)
    velocity = np.stack([2.0 + 0.0 * density, 0.0 * density, -1.0 + 0.0 * density], axis=-1)
    settings = {
        "domain_resolution": SIZE, "use_noise": False, "noise_scale": 2, "clipping": 1e-6, "velocity_scale": 3.0,
        "cache_frame_start": 1, "cache_frame_end": 50, "density_grid": _Values(density.ravel()),
        "color_grid": _Values(color.ravel()), "velocity_grid": _Values(velocity.ravel()), "flame_grid": _Values(),
        "heat_grid": _Values(), "temperature_grid": _Values(0.0 * density.ravel()),
    }
    return SimpleNamespace(**{**settings, **changes})


@pytest.fixture
def scene() -> Any:
    import bpy

    scene = empty_scene()
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    made = bpy.context.object
    # From 1 to 3, -2 to 3 and 0 to 6 in its own space.
    for vertex in made.data.vertices:
        x, y, z = vertex.co
        vertex.co = (2.0 + x, 0.5 + 2.5 * y, 3.0 + 3.0 * z)
    material = bpy.data.materials.new("Smoke")
    material.use_nodes = True
    tree = material.node_tree
    volume = tree.nodes.new("ShaderNodeVolumePrincipled")
    volume.inputs["Color Attribute"].default_value = "color"
    tree.links.new(volume.outputs[0], tree.nodes["Material Output"].inputs["Volume"])
    made.data.materials.append(material)
    return scene


def export(monkeypatch: Any, settings: SimpleNamespace) -> Any:
    import bpy

    from addon.export import export_scene, instances

    monkeypatch.setattr(instances, "gas_of", lambda shown: settings)
    return export_scene(bpy.context.evaluated_depsgraph_get())


def value(grid: Any, index: tuple[int, ...]) -> np.ndarray:
    place = np.array(index) - grid.first
    within = np.ravel_multi_index(tuple(place % TILE), (TILE,) * 3)
    return unpack_values(grid)[grid.tiles[tuple(place // TILE)], within]


def test_a_domain_is_a_box_with_the_grids_that_its_material_reads(scene: Any, monkeypatch: Any) -> None:
    description = export(monkeypatch, domain())
    assert description.notices == []
    (mesh,) = description.meshes
    # There is nothing of the flame, and the temperature is 0 everywhere.
    assert sorted(mesh.grids) == ["color", "density"] and mesh.volume_motion is None
    for index in ((0, 0, 0), (3, 4, 5), (1, 2, 3)):
        density = 1.0 + index[0] + 10.0 * index[1] + 100.0 * index[2]
        assert value(mesh.grids["density"], index)[0] == pytest.approx(density, rel=1e-3, abs=0.02)
        expected = np.array([0.5, 0.0, 1.0, 1.0]) * density
        assert np.allclose(value(mesh.grids["color"], index), expected, rtol=1e-3, atol=0.02)
    # Centres of voxels lie half a voxel inside of the bounds.
    to_index = mesh.grids["density"].to_index
    for corner, index in (((1.0, -2.0, 0.0), (-0.5, -0.5, -0.5)), ((3.0, 3.0, 6.0), (3.5, 4.5, 5.5))):
        assert np.allclose(to_index[:3, :3] @ corner + to_index[:3, 3], index, atol=1e-5)
    assert np.allclose(mesh.vertices.min(axis=0), (0.75, -2.5, -0.5), atol=1e-5)
    assert np.allclose(mesh.texture_space, [(2.0, 0.5, 3.0), (1.0, 2.5, 3.0)])


def test_a_domain_moves_by_its_velocity(scene: Any, monkeypatch: Any) -> None:
    scene.render.use_motion_blur, scene.render.motion_blur_shutter, scene.render.fps = True, 0.5, 24
    (mesh,) = export(monkeypatch, domain()).meshes
    assert mesh.volume_motion.scale == pytest.approx(3.0 * 0.5 / 24.0)
    assert np.allclose(value(mesh.volume_motion.velocity, (1, 2, 3)), (2.0, 0.0, -1.0), atol=1e-3)


def test_noise_has_finer_voxels_and_what_a_domain_lacks_is_named(scene: Any, monkeypatch: Any) -> None:
    fine = np.ones(8 * SIZE[0] * SIZE[1] * SIZE[2], np.float32)
    settings = domain(use_noise=True, density_grid=_Values(fine))
    (mesh,) = export(monkeypatch, settings).meshes
    # The colours here are as many as without noise.
    assert list(mesh.grids) == ["density"]
    assert np.allclose(np.diag(mesh.grids["density"].to_index)[:3], (4.0, 2.0, 2.0))
    empty = export(monkeypatch, domain(density_grid=_Values(), color_grid=_Values()))
    assert empty.meshes == [] and "density" in empty.notices[0].problem
    late = export(monkeypatch, domain(cache_frame_start=2))
    assert late.meshes == [] and "at this frame" in late.notices[0].problem
