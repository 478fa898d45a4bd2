# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume objects: what becomes of the grids of their files, and what is said of files that are broken or empty."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.scene.grids import unpack_values
from tests.helpers.blender_scenes import empty_scene


@pytest.fixture
def openvdb() -> Any:
    from addon.export.openvdb_module import find_openvdb

    module = find_openvdb()
    if module is None:
        pytest.skip("this Blender brings no module for OpenVDB")
    return module


@pytest.fixture
def scene() -> Any:
    return empty_scene()


def write(openvdb: Any, path: Path, **grids: np.ndarray) -> Path:
    """A file of these grids; voxels of 0.5 m, the first at index (4, -3, 2)."""
    written = []
    for name, values in grids.items():
        grid = openvdb.Vec3SGrid() if values.ndim == 4 else openvdb.FloatGrid()
        grid.copyFromArray(np.ascontiguousarray(values, np.float32), ijk=(4, -3, 2))
        grid.transform, grid.name = openvdb.createLinearTransform(voxelSize=0.5), name
        written.append(grid)
    openvdb.write(str(path), grids=written)
    return path


def add_volume(scene: Any, path: Path | str, name: str = "Cloud") -> Any:
    import bpy

    data = bpy.data.volumes.new(name)
    data.filepath = str(path)
    made = bpy.data.objects.new(name, data)
    scene.collection.objects.link(made)
    return made


def export(cache: Any = None) -> Any:
    import bpy

    from addon.export import export_scene

    return export_scene(bpy.context.evaluated_depsgraph_get(), cache=cache)


def test_a_volume_is_a_box_with_the_grids_that_its_material_reads(scene: Any, openvdb: Any, tmp_path: Path) -> None:
    values = np.random.default_rng(1).random((5, 6, 7)).astype(np.float32)
    made = add_volume(scene, write(openvdb, tmp_path / "a.vdb", density=values, other=values))
    made.scale = (2.0, 2.0, 2.0)
    description = export()
    assert description.notices == []
    (mesh,) = description.meshes
    # Voxels fade out within one beyond the first and the last.
    assert np.allclose(mesh.vertices.min(axis=0), 0.5 * np.array([3, -4, 1]))
    assert np.allclose(mesh.vertices.max(axis=0), 0.5 * np.array([9, 3, 9]))
    assert list(mesh.grids) == ["density"]
    grid = mesh.grids["density"]
    index = grid.to_index[:3, :3] @ np.array([2.0, -1.5, 1.0]) + grid.to_index[:3, 3]
    assert np.allclose(index, (4, -3, 2))
    assert (grid.voxels > 0).sum() >= values.size - 8
    # In object space what is twice as large is half as dense.
    assert np.allclose(description.instances.medium_density, 0.5)
    made.data.render.space = "WORLD"
    assert np.allclose(export().instances.medium_density, 1.0)


def test_a_file_that_is_the_same_is_not_read_again(scene: Any, openvdb: Any, tmp_path: Path) -> None:
    from addon.export import ExportCache

    cache = ExportCache()
    add_volume(scene, write(openvdb, tmp_path / "a.vdb", density=np.ones((4, 4, 4))))
    first, second = (export(cache).meshes[0] for _ in range(2))
    assert first is second


def test_what_is_wrong_with_files_and_grids_is_named(scene: Any, openvdb: Any, tmp_path: Path) -> None:
    broken = tmp_path / "broken.vdb"
    broken.write_bytes(b"no such thing")
    odd = openvdb.FloatGrid()
    odd.name = "density"
    for place, value in enumerate((1.0, np.nan, np.inf, -1.0)):
        odd.getAccessor().setValueOn((place, 0, 0), value)
    openvdb.write(str(tmp_path / "odd.vdb"), grids=[odd])
    for name, path in {
        "Broken": broken, "Missing": tmp_path / "missing.vdb", "None": "",
        "Another": write(openvdb, tmp_path / "b.vdb", smoke=np.ones((4, 4, 4))),
        "Empty": write(openvdb, tmp_path / "c.vdb", density=np.zeros((4, 4, 4))),
        "Odd": tmp_path / "odd.vdb",
    }.items():  # fmt: skip
        add_volume(scene, path, name)
    description = export()
    found = {notice.subject: notice for notice in description.notices}
    assert len(description.meshes) == 1
    for name in ("Broken", "Missing", "None", "Another"):
        assert found[name].fallback == "left out of the picture"
    assert "smoke" in found["Another"].problem and "density" in found["Another"].problem
    assert "empty" in found["Empty / density"].problem
    odd_ones = [notice.problem for notice in description.notices if notice.subject == "Odd / density"]
    assert any("2 voxels are no numbers" in problem for problem in odd_ones)
    assert any("1 voxels have a negative density" in problem for problem in odd_ones)


def test_a_volume_of_geometry_nodes_is_read_though_it_has_no_file(scene: Any, openvdb: Any) -> None:
    import bpy

    bpy.ops.mesh.primitive_cube_add()
    tree = bpy.data.node_groups.new("Volume", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    cube, output = tree.nodes.new("GeometryNodeVolumeCube"), tree.nodes.new("NodeGroupOutput")
    tree.links.new(cube.outputs[0], output.inputs[0])
    bpy.context.object.modifiers.new("Nodes", "NODES").node_group = tree
    description = export()
    assert description.notices == []
    # Without a material it is what Cycles shows then: a Principled Volume.
    assert [material.name for material in description.materials] == ["default volume"]
    assert description.meshes[0].grids["density"].voxels.size > 0


def test_a_sequence_shows_the_file_of_the_frame(scene: Any, openvdb: Any, tmp_path: Path) -> None:
    from addon.export import ExportCache

    for frame in (1, 2, 3):
        write(openvdb, tmp_path / f"smoke_{frame:04}.vdb", density=np.full((4, 4, 4), 0.25 * frame))
    made = add_volume(scene, tmp_path / "smoke_0001.vdb")
    made.data.is_sequence, made.data.frame_duration, made.data.frame_start = True, 3, 11
    cache = ExportCache()
    densities = []
    for frame in (11, 12, 13, 12):
        scene.frame_set(frame)
        description = export(cache)
        assert description.notices == []
        densities.append(float(unpack_values(description.meshes[0].grids["density"]).max()))
    assert np.allclose(densities, [0.25, 0.5, 0.75, 0.5])
    # Before the sequence there is nothing, and that is said.
    scene.frame_set(1)
    description = export(cache)
    assert len(description.meshes) == 0 and "Cloud" in [notice.subject for notice in description.notices]


def test_a_sequence_with_a_file_missing_says_which(scene: Any, openvdb: Any, tmp_path: Path) -> None:
    made = add_volume(scene, write(openvdb, tmp_path / "smoke_0001.vdb", density=np.ones((4, 4, 4))))
    made.data.is_sequence, made.data.frame_duration, made.data.frame_start = True, 3, 1
    scene.frame_set(2)
    (notice,) = export().notices
    assert notice.subject == "Cloud" and "smoke_0002.vdb" in notice.problem


def test_instances_of_a_volume_share_its_voxels_and_move(scene: Any, openvdb: Any, tmp_path: Path) -> None:
    import bpy

    made = add_volume(scene, write(openvdb, tmp_path / "a.vdb", density=np.ones((4, 4, 4))))
    linked = bpy.data.objects.new("Linked", made.data)
    linked.location.x = 9.0
    scene.collection.objects.link(linked)
    group = bpy.data.collections.new("Group")
    group.objects.link(made)
    empty = bpy.data.objects.new("Empty", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", group
    scene.collection.objects.link(empty)
    for frame, place in ((0, -1.0), (2, 1.0)):
        empty.location.y = place
        empty.keyframe_insert("location", frame=frame)
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    scene.frame_set(1)
    description = export()
    assert description.notices == [] and len(description.meshes) == 1
    instances = description.instances
    assert len(instances.mesh) == 3 and np.allclose(instances.medium_density, 1.0)
    assert sorted(instances.transform[:, 0, 3].tolist()) == [0.0, 0.0, 9.0]
    ((_, steps),) = instances.motion.items()
    assert steps[-1, 1, 3] - steps[0, 1, 3] > 0.5


#: Bytes of NanoVDB's nodes of its type Fp16, which keeps 16 bits a value between the limits of a leaf, as tiles here
#: do: a leaf of 8^3 voxels, a node of 16^3 leaves, one of 32^3 of these, and grid, tree and root (NanoVDB.h).
NANO_LEAF, NANO_LOWER, NANO_UPPER, NANO_ROOT = 1120, 33_856, 270_400 + 32, 832


def test_a_cloud_takes_no_more_memory_than_in_nanovdb(scene: Any, openvdb: Any, tmp_path: Path) -> None:
    axis = np.linspace(-1.0, 1.0, 96, dtype=np.float32)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    waves = np.sin(9.0 * x + 3.0 * y) * np.sin(8.0 * y - 5.0 * z) * np.sin(11.0 * z + 2.0 * x)
    density = np.clip(4.0 * (0.8 - np.sqrt(x * x + y * y + z * z) + 0.3 * waves), 0.0, 1.0)
    path = write(openvdb, tmp_path / "cloud.vdb", density=density)
    add_volume(scene, path)
    grid = export().meshes[0].grids["density"]
    (read,), _ = openvdb.readAll(str(path))
    tiles = grid.first // 8 + np.argwhere(grid.tiles >= 0)
    lower, upper = (len(np.unique(tiles // size, axis=0)) for size in (16, 16 * 32))
    assert read.nonLeafCount() == lower + upper + 1
    nano = read.leafCount() * NANO_LEAF + lower * NANO_LOWER + upper * NANO_UPPER + NANO_ROOT
    # Even without the nodes above its leaves, of which a cloud as small as this one makes little use.
    assert grid.nbytes <= 1.2 * read.leafCount() * NANO_LEAF <= 1.2 * nano


def test_voxels_too_far_apart_are_named(scene: Any, openvdb: Any, tmp_path: Path) -> None:
    far = openvdb.FloatGrid()
    far.name = "density"
    for place in (0, 200_000):
        far.getAccessor().setValueOn((place,) * 3, 1.0)
    openvdb.write(str(tmp_path / "far.vdb"), grids=[far])
    add_volume(scene, tmp_path / "far.vdb")
    description = export()
    assert len(description.meshes) == 0
    problem = description.notices[0].problem
    assert "200001 x 200001 x 200001" in problem and "too far apart" in problem


def test_a_volume_moves_by_its_velocity_as_cycles_has_it(scene: Any, openvdb: Any, tmp_path: Path) -> None:
    density, speed = np.ones((6, 6, 6)), np.zeros((6, 6, 6, 3))
    speed[..., 0], speed[2:, ..., 1] = 3.0, -1.0
    made = add_volume(scene, write(openvdb, tmp_path / "a.vdb", density=density, velocity=speed))
    still = export().meshes[0]
    assert still.volume_motion is None
    scene.render.use_motion_blur, scene.render.motion_blur_shutter, scene.render.fps = True, 0.5, 24
    description = export()
    (mesh,) = description.meshes
    assert description.notices == [] and description.is_moving
    # By the frame, however long the shutter is open: in the middle everything is where its grids say.
    assert (mesh.volume_motion.still, mesh.volume_motion.scale) == (0.5, 1.0)
    assert np.allclose(mesh.vertices.min(axis=0), still.vertices.min(axis=0) - (1.5, 0.5, 0.0), atol=1e-4)
    assert np.allclose(mesh.vertices.max(axis=0), still.vertices.max(axis=0) + (1.5, 0.5, 0.0), atol=1e-4)
    assert np.allclose(mesh.texture_space, still.texture_space)
    made.data.velocity_unit, made.data.velocity_scale = "SECOND", 4.0
    made.data.update_tag()
    assert export().meshes[0].volume_motion.scale == pytest.approx(4.0 * 0.5 / 24.0)
    scene.render.motion_blur_position = "START"
    assert export().meshes[0].volume_motion.still == 0.0
    scene.render.motion_blur_position = "END"
    assert export().meshes[0].volume_motion.still == -0.5
    made.cycles.use_motion_blur = False
    made.update_tag()
    assert export().meshes[0].volume_motion is None


def test_a_velocity_may_be_three_grids_of_numbers_or_have_another_name(
    scene: Any, openvdb: Any, tmp_path: Path
) -> None:
    import bpy

    axes = {f"velocity_{axis}": np.full((4, 4, 4), value) for axis, value in zip("xyz", (1.0, 2.0, 3.0), strict=True)}
    first = add_volume(scene, write(openvdb, tmp_path / "a.vdb", density=np.ones((4, 4, 4)), **axes), "Axes")
    scene.render.use_motion_blur = True
    motion = export().meshes[0].volume_motion
    assert np.allclose(unpack_values(motion.velocity).max(axis=(0, 1)), (1.0, 2.0, 3.0))
    bpy.data.objects.remove(first)
    path = write(openvdb, tmp_path / "b.vdb", density=np.ones((4, 4, 4)), speed=np.full((4, 4, 4, 3), 2.0))
    other = add_volume(scene, path, "Vectors")
    assert export().meshes[0].volume_motion is None
    other.data.grids.load()
    other.data.velocity_grid = "speed"
    other.data.update_tag()
    assert unpack_values(export().meshes[0].volume_motion.velocity).max() == pytest.approx(2.0)
    # A density is no velocity, and nothing is left out for that.
    other.data.velocity_grid = "density"
    other.data.update_tag()
    (notice,) = export().notices
    assert notice.subject == "Vectors / density" and notice.fallback == "it stands still"


def test_voxels_by_splines_reach_a_voxel_further(scene: Any, openvdb: Any, tmp_path: Path) -> None:
    import bpy

    made = add_volume(scene, write(openvdb, tmp_path / "a.vdb", density=np.ones((4, 4, 4))))
    material = bpy.data.materials.new("Smoke")
    material.use_nodes = True
    tree = material.node_tree
    volume = tree.nodes.new("ShaderNodeVolumePrincipled")
    tree.links.new(volume.outputs[0], tree.nodes["Material Output"].inputs["Volume"])
    made.data.materials.append(material)
    lines = export()
    material.cycles.volume_interpolation = "CUBIC"
    material.update_tag()
    splines = export()
    assert [item.has_smooth_voxels for item in (*lines.materials, *splines.materials)] == [False, True]
    assert np.allclose(splines.meshes[0].vertices.max(axis=0), lines.meshes[0].vertices.max(axis=0) + 0.5)
