# SPDX-License-Identifier: GPL-3.0-or-later
"""What a session keeps between loads: nothing stale, whatever changes, and nothing built twice."""

import copy
import dataclasses
import functools
import inspect
import itertools
import tempfile
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from engine.builder.scene import Scene, SceneCache, build_scene
from engine.render.session import Session
from engine.scene import description as contract
from engine.scene import passes
from engine.scene.attribute_names import UNDEFORMED
from engine.scene.description import (
    VISIBLE_ALL,
    VISIBLE_CAMERA,
    Attribute,
    Camera,
    Frame,
    Image,
    Light,
    Link,
    Material,
    Mesh,
    Node,
    NodeGraph,
    Notice,
    SceneDescription,
    World,
)
from engine.scene.dicing import Dicing
from engine.scene.fast_gi import FastGi
from engine.scene.grids import Grid, VolumeMotion, pack_grid
from engine.scene.instances import plain_instances
from engine.scene.panorama import Panorama, StereoEye
from engine.scene.passes import Aov, PassMotion, PassSettings
from engine.scene.rounds import SPHERES, Rounds
from engine.settings import RenderSettings
from engine.spectral.observer import XYZ_TO_REC709
from engine.state.geometry import INSTANCE_FLAG_BAKED, INSTANCE_FLAGS
from tests.helpers.bakes import first_triangle
from tests.helpers.linked_lights import linkings
from tests.helpers.media_scenes import media_scene, placed, varying
from tests.helpers.scene_arrays import different_arrays, scene_arrays

_SETTINGS = RenderSettings(samples=2, threads=1, max_bounces=3, spectral="OFF")


def _at(x: float, y: float, z: float) -> np.ndarray:
    matrix = np.eye(4, dtype=np.float32)
    matrix[:3, 3] = x, y, z
    return matrix


def _bumpy(key: str, seed: int) -> Mesh:
    """A square of 4 x 4 quads with hills, a UV map and a colour."""
    rng = np.random.default_rng(seed)
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-1.0, 1.0, 5), np.linspace(-1.0, 1.0, 5)))
    vertices = np.stack([x, y, 0.2 * rng.random(25)], axis=1).astype(np.float32)
    corner = (np.arange(4)[:, None] * 5 + np.arange(4)).ravel()
    triangles = np.concatenate(
        [np.stack([corner, corner + 1, corner + 6], axis=1), np.stack([corner, corner + 6, corner + 5], axis=1)]
    ).astype(np.uint32)
    normals = np.tile(np.array([0.1, 0.0, 0.995], np.float32), (len(triangles), 3, 1))
    slots = np.arange(len(triangles), dtype=np.int32) % 2
    return Mesh(
        key, key.title(), vertices, triangles, normals, slots,
        {
            "UV": Attribute("CORNER", vertices[triangles.ravel(), :2].copy()),
            "Other": Attribute("CORNER", vertices[triangles.ravel(), 1::-1].copy()),
            **{name: Attribute("POINT", rng.random((25, 4)).astype(np.float32)) for name in ("Tint", "Tone")},
        },
        default_uv="UV", default_color="Tint", texture_space=np.array([(0, 0, 0), (1, 1, 1)], np.float32),
    )  # fmt: skip


def _grid() -> Grid:
    grid, _ = pack_grid("grid", np.eye(4), (0, 0, 0), (7, 7, 7), lambda start, shape: np.ones((*shape, 1)))
    return grid


def _materials() -> list[Material]:
    textured = NodeGraph(
        [
            Node("ShaderNodeTexImage", "Picture", {}, {"image": 0}),
            Node("ShaderNodeBsdfPrincipled", "Principled",
                 {"Base Color": Link(0, "Color"), "Roughness": Link(0, "Color")}),
        ],
        Link(1, "BSDF"),
    )  # fmt: skip
    ramp = np.random.default_rng(3).random((257, 4)).astype(np.float32)
    glow = NodeGraph(
        [
            Node("ShaderNodeTexCoord", "Where"),
            Node("ShaderNodeValToRGB", "Ramp", {"Fac": Link(0, "Camera")}, {"ramp": ramp, "interpolate": True}),
            Node("ShaderNodeEmission", "Glow", {"Color": Link(1, "Color"), "Strength": 3.0}),
        ],
        Link(2, "Emission"),
    )
    tinted = NodeGraph(
        [
            Node("ShaderNodeVertexColor", "Tint"),
            Node("ShaderNodeObjectInfo", "Object"),
            Node("ShaderNodeVectorMath", "Sum", {"Vector": Link(0, "Color"), "Vector_001": Link(1, "Color")},
                 {"operation": "ADD"}),
            Node("ShaderNodeTexCoord", "Where", {}, {"from_nobody": True}),
            Node("ShaderNodeVectorMath", "More", {"Vector": Link(2, "Vector"), "Vector_001": Link(3, "Generated")},
                 {"operation": "ADD"}),
            Node("ShaderNodeMath", "Numbers", {"Value": Link(1, "Random"), "Value_001": Link(1, "Material Index")},
                 {"operation": "ADD"}),
            Node("ShaderNodeMath", "Index", {"Value": Link(5, "Value"), "Value_001": Link(1, "Object Index")},
                 {"operation": "ADD"}),
            Node("ShaderNodeVectorMath", "All", {"Vector": Link(4, "Vector"), "Vector_001": Link(6, "Value")},
                 {"operation": "ADD"}),
            Node("ShaderNodeBump", "Bump", {"Height": Link(3, "UV"), "Strength": 0.5}),
            Node("ShaderNodeBsdfDiffuse", "Diffuse",
                 {"Color": Link(7, "Vector"), "Roughness": 0.0, "Normal": Link(8, "Normal")}),
        ],
        Link(9, "BSDF"),
    )  # fmt: skip
    instancer = NodeGraph(
        [
            Node("ShaderNodeTexCoord", "Where", {}, {"from_instancer": True}),
            Node("ShaderNodeVectorMath", "Sum", {"Vector": Link(0, "Generated"), "Vector_001": Link(0, "UV")},
                 {"operation": "ADD"}),
            Node("ShaderNodeAttribute", "Dirt", {}, {"attribute_type": "OBJECT", "attribute_name": "dirt"}),
            Node("ShaderNodeVectorMath", "More", {"Vector": Link(1, "Vector"), "Vector_001": Link(2, "Color")},
                 {"operation": "ADD"}),
            Node("ShaderNodeBsdfTransparent", "Clear", {"Color": Link(3, "Vector")}),
        ],
        Link(4, "BSDF"),
    )  # fmt: skip
    return [
        Material("textured", "Textured", textured),
        Material("glow", "Glow", glow),
        Material("tinted", "Tinted", tinted, pass_index=1),
        Material("clear", "Clear", instancer),
    ]


def _image(key: str, seed: int) -> Image:
    pixels = np.random.default_rng(seed).integers(0, 255, (4, 8, 4)).astype(np.uint8)
    return Image(key, key.title(), pixels)


def _original() -> SceneDescription:
    transforms = np.stack([_at(-2, 0, 0), _at(0, 0, 0), _at(2, 0, 0), _at(0, 2, 0), _at(0, -2, 0), _at(0, 0, 1.5)])
    instances = plain_instances(transforms, meshes=[0, 0, 1, 2, 3, 0], name="Thing")
    instances.materials = np.array([0, 2, 1, 2, 3, 3, 0, 0], np.int32)
    instances.material_offset = np.array([0, 0, 2, 2, 6, 4], np.int32)
    instances.terminator_offset, instances.shading_offset = np.full((2, 6), 0.1, np.float32)
    instances.light_group = np.full(6, -1, np.int32)
    instances.properties = {"object:dirt": np.linspace(0.0, 0.5, 24, dtype=np.float32).reshape(6, 4)}
    instances.is_shadow_catcher = np.zeros(6, np.bool_)
    instances.motion = {1: np.stack([_at(0, 0, -0.2), _at(0, 0, 0.2)])}
    meshes = [_bumpy(key, seed) for seed, key in enumerate(("shared", "single", "other", "waving"))]
    waving = meshes[3]
    waving.motion_vertices = np.stack([waving.vertices - 0.1, waving.vertices + 0.1]).astype(np.float32)
    waving.motion_normals = np.stack([waving.corner_normals, waving.corner_normals])  # type: ignore[list-item]
    sky = NodeGraph(
        [
            Node("ShaderNodeTexEnvironment", "Sky", {}, {"image": 1, "projection": "EQUIRECTANGULAR"}),
            Node("ShaderNodeBackground", "Background", {"Color": Link(0, "Color"), "Strength": 0.7}),
        ],
        Link(1, "Background"),
    )
    flicker = NodeGraph([Node("ShaderNodeEmission", "Flicker", {"Strength": 2.0})], Link(0, "Emission"))
    white = (1.0, 0.9, 0.8)
    materials = _materials()
    tinted = materials[0].graph
    assert tinted is not None
    tinted.nodes.append(Node("ShaderNodeOutputAOV", "AOV", {"Color": white, "Value": 0.5}, {"aov_name": "Tint"}))
    tinted.aovs.append(len(tinted.nodes) - 1)
    return SceneDescription(
        camera=Camera(transform=_at(0.1, 0.2, 9), motion=np.stack([_at(0, 0.2, 9), _at(0.2, 0.2, 9)]),
                      lens_motion=np.array([(49, 36, 24), (51, 36, 24)], np.float32), use_dof=True),
        frame=Frame(8, 6, (0, 0, 8, 6)),
        meshes=meshes,
        instances=instances,
        materials=materials,
        images=[_image("picture", 1), _image("sky", 2)],
        lights=[
            Light("spot", "Spot", "SPOT", _at(0, 0, 4), white, 300.0, radius=0.2, spot_angle=1.5),
            Light("sun", "Sun", "SUN", _at(0, 0, 4), white, 1.0, angle=0.1),
            Light("area", "Area", "AREA", _at(1, 1, 3), white, 100.0, shape="RECTANGLE", graph=flicker),
        ],
        world=World("world", "World", sky, sampling="MANUAL", map_resolution=16),
        shutter=(0.0, 1.0),
        shutter_curve=np.array([0.5, 1.0, 0.5], np.float32),
        passes=PassSettings(aovs=(Aov("Tint", True),)),
        light_groups=("Key",),
    )  # fmt: skip


Change = Callable[[SceneDescription], None]


def _set(path: str, value: Any) -> Change:
    """Assign the attribute at the end of a path such as `lights.0.angle`."""

    def change(description: SceneDescription) -> None:
        item: Any = description
        *way, last = path.split(".")
        for step in way:
            item = item[int(step)] if step.isdigit() else getattr(item, step)
        setattr(item, last, value)

    return change


def _all(**values: Any) -> Change:  # several at once, by paths with __ for points
    return lambda d: [_set(path.replace("__", "."), value)(d) for path, value in values.items()]


def _edit(path: str, edit: Callable[[Any], Any]) -> Change:
    """Assign what `edit` makes of the attribute."""

    def change(description: SceneDescription) -> None:
        item: Any = description
        for step in path.split("."):
            item = item[int(step)] if step.isdigit() else getattr(item, step)
        _set(path, edit(item))(description)

    return change


def _with_entry(index: Any, value: Any) -> Callable[[np.ndarray], np.ndarray]:
    """A copy of an array with another value in one place."""

    def edit(array: np.ndarray) -> np.ndarray:
        changed = array.copy()
        changed[index] = value
        return changed

    return edit


def _relink(description: SceneDescription) -> None:
    description.materials[0].graph.nodes[1].inputs["Base Color"] = Link(0, "Alpha")  # type: ignore[union-attr]


def _give_unknown_links_another_value(description: SceneDescription) -> None:
    inputs = description.materials[0].graph.nodes[1].inputs  # type: ignore[union-attr]
    inputs["Base Color"] = Link(0, "Nothing", (0.9, 0.1, 0.1, 1.0))


def _link_elsewhere(description: SceneDescription) -> None:
    description.materials[2].graph.surface = Link(7, "Vector")  # type: ignore[union-attr]


def _append(path: str, item: Any) -> Change:
    return _edit(path, lambda items: [*items, item])


def _graph(path: str, node: int, name: str, value: Any, part: str = "inputs") -> Change:
    return _edit(f"{path}.graph.nodes.{node}.{part}", lambda values: {**values, name: value})


_VOXELS = NodeGraph(
    [
        Node("ShaderNodeVolumeScatter", "Fog", {"Density": Link(1, "Fac")}),
        Node("ShaderNodeAttribute", "Voxels", {}, {"attribute_type": "GEOMETRY", "attribute_name": "Tint"}),
    ],
    None,
    Link(0, "Volume"),
)
_PLAIN = NodeGraph([Node("ShaderNodeBsdfDiffuse", "D", {"Color": (0.2, 0.3, 0.9, 1.0)})], Link(0, "BSDF"))

_OFF, _ON = ("background_moves", "looks_up_transmission"), ("follows_mirrors", "weighs_by_roughness")  # passes
#: How each field of the description is changed, in a way that arrays or pictures show: every field has an entry.
CHANGES: dict[str, list[Change]] = {
    "SceneDescription.camera": [_set("camera", Camera(transform=_at(0, 0, 12)))],
    "SceneDescription.frame": [_set("frame", Frame(9, 5, (0, 0, 9, 5)))],
    "SceneDescription.meshes": [_edit("meshes", lambda m: [m[1], m[0], *m[2:]])],
    "SceneDescription.instances": [_set("instances", plain_instances([_at(0, 0, 0)], materials=[0, 1]))],
    "SceneDescription.materials": [_edit("materials", lambda m: [m[1], m[0], *m[2:]]),
                                   _append("materials", Material("new", "New", _PLAIN))],
    "SceneDescription.images": [_edit("images", lambda i: i[::-1]), _append("images", _image("third", 9)),
                                _edit("images", lambda i: i[:1])],
    "SceneDescription.lights": [_edit("lights", lambda lights: lights[1:]), _set("lights", [])],
    "SceneDescription.world": [_set("world", None), _set("world", World("w", "W", None, (0.3, 0.2, 0.1)))],
    "SceneDescription.notices": [_set("notices", [Notice("a", "b", "c")])],
    "SceneDescription.working_space": [_set("working_space", "ACEScg")],
    "SceneDescription.to_xyz": [
        _set("to_xyz", (np.linalg.inv(XYZ_TO_REC709) @ np.diag([0.9, 1.0, 1.1])).astype(np.float32))],
    "SceneDescription.frame_current": [_set("frame_current", 7.0)],
    "SceneDescription.shutter": [_set("shutter", (0.0, 0.5))],
    "SceneDescription.shutter_curve": [_set("shutter_curve", c) for c in (None, np.array([0.0, 1.0, 0.1], np.float32))],
    "SceneDescription.light_groups": [_set("light_groups", ("Key", "Rim"))],
    "SceneDescription.linking": [_set("linking", linking) for linking in linkings(6, 3)],
    "SceneDescription.rolling_shutter_duration": [_set("rolling_shutter_duration", 0.3)],
    "Camera.kind": [_set("camera.kind", "ORTHO"), _set("camera.kind", "PANO")],
    "Camera.transform": [_set("camera.transform", _at(0.5, 0, 7))],
    "Camera.lens": [_set("camera.lens", 35.0)],
    "Camera.sensor_width": [_set("camera.sensor_width", 30.0)],
    "Camera.sensor_height": [_all(camera__sensor_fit="VERTICAL", camera__sensor_height=9.0)],
    "Camera.sensor_fit": [_set("camera.sensor_fit", "VERTICAL")],
    "Camera.ortho_scale": [_all(camera__kind="ORTHO", camera__ortho_scale=3.0)],
    "Camera.shift_x": [_set("camera.shift_x", 0.2)],
    "Camera.shift_y": [_set("camera.shift_y", 0.2)],
    "Camera.clip_start": [_set("camera.clip_start", 7.7)],
    "Camera.clip_end": [_set("camera.clip_end", 8.9)],
    "Camera.use_dof": [_set("camera.use_dof", False)],
    "Camera.focus_distance": [_set("camera.focus_distance", 2.0)],
    "Camera.aperture_fstop": [_set("camera.aperture_fstop", 0.1)],
    "Camera.aperture_blades": [_set("camera.aperture_blades", 5)],
    "Camera.aperture_rotation": [_set("camera.aperture_rotation", 0.4)],
    "Camera.aperture_ratio": [_set("camera.aperture_ratio", 2.0)],
    "Camera.panorama": [_all(camera__kind="PANO", camera__panorama=Panorama(kind)) for kind in
                        ("MIRRORBALL", "FISHEYE_EQUIDISTANT")],
    "Camera.eye": [_set("camera.eye", StereoEye(0.1)), _set("camera.eye", StereoEye(0.1, 2.0, 0.3, 0.4))],
    "Camera.motion": [_set("camera.motion", None)],
    "Camera.lens_motion": [_set("camera.lens_motion", None)],
    "Frame.width": [_set("frame.width", 9)],
    "Frame.height": [_set("frame.height", 9)],
    "Frame.region": [_set("frame.region", (2, 1, 7, 5))],
    "Frame.pixel_aspect_x": [_set("frame.pixel_aspect_x", 2.0)],
    "Frame.pixel_aspect_y": [_set("frame.pixel_aspect_y", 2.0)],
    "Frame.exposure": [_set("frame.exposure", 2.0)],
    "World.key": [_set("world.key", "another")], "World.name": [_set("world.name", "Another")],
    "World.graph": [_set("world.graph", None), _graph("world", 1, "Strength", 0.1)],
    "World.color": [_set("world", World("world", "World", None, (0.9, 0.1, 0.1)))],
    "World.visibility": [_set("world.visibility", VISIBLE_CAMERA)],
    "World.sampling": [_set("world.sampling", "NONE"), _set("world.sampling", "AUTOMATIC")],
    "World.map_resolution": [_set("world.map_resolution", 32)], "World.max_bounces": [_set("world.max_bounces", 0)],
    "World.cast_shadow": [_set("world.cast_shadow", False)],
    **{name: [_set("world.portals", [contract.Portal(_at(0, 0, 4), "DISK", 1.0, 2.0)])] for name in
       ("World.portals", "Portal.transform", "Portal.shape", "Portal.size_x", "Portal.size_y")},
    "World.light_group": [_set("world.light_group", 0)],
    "Light.key": [_set("lights.0.key", "another")],
    "Light.name": [_set("lights.0.name", "Another")],
    "Light.kind": [_set("lights.0.kind", "POINT")],
    "Light.transform": [_set(f"lights.{k}.transform", _at(0.5, 0, 3)) for k in (0, 2)],
    "Light.color": [_set("lights.0.color", (0.1, 0.1, 0.9))],
    "Light.energy": [_set("lights.1.energy", 7.0)],
    "Light.is_normalized": [_set("lights.0.is_normalized", False)],
    "Light.radius": [_set("lights.0.radius", 0.4)],
    "Light.angle": [_set("lights.1.angle", 0.4)],
    "Light.spot_angle": [_set("lights.0.spot_angle", 0.3)],
    "Light.spot_blend": [_set("lights.0.spot_blend", 0.9)],
    "Light.shape": [_set("lights.2.shape", "ELLIPSE")],
    "Light.size_x": [_set("lights.2.size_x", 2.0)],
    "Light.size_y": [_set("lights.2.size_y", 2.0)],
    "Light.spread": [_set("lights.2.spread", 1.0)],
    "Light.use_soft_falloff": [_set("lights.0.use_soft_falloff", False)],
    "Light.cast_shadow": [_set("lights.0.cast_shadow", False)],
    "Light.use_mis": [_set("lights.0.use_mis", False)],
    "Light.max_bounces": [_set("lights.0.max_bounces", 0)],
    "Light.visibility": [_set("lights.0.visibility", VISIBLE_ALL & ~2)],
    "Light.graph": [_set("lights.2.graph", None), _graph("lights.2", 0, "Strength", 0.1)],
    "Light.random": [_set("lights.0.random", 0.7)], "Light.pass_index": [_set("lights.0.pass_index", 3)],
    "Light.object_color": [_set("lights.0.object_color", (0.5,) * 4)],
    "Light.light_group": [_set("lights.0.light_group", 0)], "Light.temperature": [_set("lights.0.temperature", 3000.0)],
    "Material.key": [_set("materials.0.key", "another")],
    "Material.name": [_set("materials.0.name", "Another")],
    "Material.graph": [_set("materials.0.graph", None), _set("materials.1.graph", _PLAIN)],
    "Material.pass_index": [_set("materials.2.pass_index", 3)],
    "Material.use_bump_map_correction": [_set("materials.2.use_bump_map_correction", False)],
    # What has voxels inside.
    "Material.has_smooth_voxels": [_all(
        meshes__0__grids={"Tint": _grid()}, materials__0__graph=_VOXELS, materials__0__has_smooth_voxels=True)],
    "Material.use_transparent_shadow": [_set("materials.3.use_transparent_shadow", False)],
    "Material.emission_sampling": [_set("materials.1.emission_sampling", sides) for sides in ("BACK", "NONE")],
    "Material.dispersion": [_set("materials.0.dispersion", 0.02)],
    "Material.displacement_method": [_all(
        materials__2__graph__displacement=Link(4, "Vector"), materials__2__displacement_method="BOTH")],
    "Material.user": [_set("materials.0.user", "Somebody")],
    "NodeGraph.nodes": [_append("materials.0.graph.nodes", Node("ShaderNodeMath", "Unused")),
                        _edit("materials.1.graph.nodes", lambda n: n[:2])],
    "NodeGraph.aovs": [_set("materials.0.graph.aovs", [])],
    "NodeGraph.surface": [_set("materials.1.graph.surface", None)],
    "NodeGraph.volume": [_set("materials.0.graph.volume", Link(1, "BSDF"))],
    "NodeGraph.displacement": [_set("materials.2.graph.displacement", Link(4, "Vector"))],
    "Node.kind": [_set("materials.2.graph.nodes.9.kind", "ShaderNodeBsdfTranslucent")],
    "Node.name": [_set("materials.0.graph.nodes.0.name", "Another")],
    "Node.inputs": [_graph("materials.0", 1, "Roughness", 0.9), _graph("materials.1", 2, "Strength", 9.0)],
    "Node.properties": [
        _graph("materials.1", 1, "ramp", np.full((257, 4), 0.5, np.float32), "properties"),
        _graph("materials.1", 1, "ramp", np.full((100, 4), 0.5, np.float32), "properties"),
        _graph("materials.0", 0, "image", 1, "properties"),
        _graph("materials.0", 0, "image", -1, "properties"),
    ],
    "Node.changed": [_set("materials.2.graph.nodes.3.changed", frozenset({"from_nobody"}))],
    "Link.node": [_link_elsewhere], "Link.output": [_relink],
    "Link.otherwise": [_give_unknown_links_another_value],
    "Image.key": [_set("images.0.key", "another")], "Image.name": [_set("images.0.name", "Another")],
    "Image.pixels": [_edit("images.0.pixels", lambda p: p // 2), _edit("images.1.pixels", lambda p: p // 2),
                     _edit("images.1.pixels", lambda p: p.astype(np.float32)),
                     _set("images.0.pixels", np.zeros((0, 0, 4), np.uint8))],
    "Image.encoding": [_set("images.0.encoding", "LINEAR"), _set("images.1.encoding", "RAW")],
    "Image.is_associated": [_set("images.0.is_associated", True)],
    "Image.alpha_mode": [_set("images.0.alpha_mode", "NONE")],
    "Image.tiles": [_set("images.0.tiles", ((1001, 1),))],
    "Image.folder": [_set("images.0.folder", tempfile.gettempdir())],
    "Attribute.domain": [lambda d: (_set("meshes.0.attributes", {
        **d.meshes[0].attributes, "UV": Attribute("FACE", d.meshes[0].attributes["UV"].data[::3].copy())})(d))],
    "Attribute.data": [lambda d: (_set("meshes.1.attributes", {
        **d.meshes[1].attributes, "UV": Attribute("CORNER", 2.0 * d.meshes[1].attributes["UV"].data)})(d))],
    "Mesh.key": [_set("meshes.0.key", "another")], "Mesh.name": [_set("meshes.0.name", "Another")],
    "Mesh.vertices": [_edit(f"meshes.{k}.vertices", lambda v: 0.7 * v) for k in (0, 1)]
                     + [_edit("meshes.0.vertices", _with_entry(3, np.nan))],
    "Mesh.triangles": [_edit("meshes.0.triangles", _with_entry(2, (0, 1, 2))),
                       _edit("meshes.1.triangles", _with_entry(2, (0, 1, 99)))],
    "Mesh.corner_normals": [_set("meshes.0.corner_normals", None),
                            _edit("meshes.1.corner_normals", lambda n: n * np.float32([-1, 1, 1]))],
    "Mesh.material_slots": [_edit("meshes.2.material_slots", lambda s: 1 - s)],
    "Mesh.attributes": [_edit("meshes.0.attributes", lambda a: {k: v for k, v in a.items() if k != "UV"}),
                        lambda d: (_set("meshes.0.attributes", {
        **d.meshes[0].attributes, UNDEFORMED: Attribute("POINT", 0.5 * d.meshes[0].vertices)})(d))],
    "Mesh.default_uv": [_set("meshes.0.default_uv", "Other")],
    "Mesh.default_color": [_set("meshes.0.default_color", "Tone")],
    "Mesh.texture_space": [_set("meshes.0.texture_space", np.array([(0, 0, 0), (3, 3, 3)], np.float32))],
    "Mesh.motion_vertices": [_edit("meshes.3.motion_vertices", lambda v: 1.1 * v),
                             _all(meshes__3__motion_vertices=None, meshes__3__motion_normals=None)],
    "Mesh.grids": [_set("meshes.0.grids", {"Tint": _grid()})],
    "Mesh.volume_motion": [_set("meshes.0.volume_motion", VolumeMotion(_grid(), 0.5, 2.0))],
    "Mesh.dicing": [_set("meshes.0.dicing", Dicing(2, np.eye(3, 4), 0.3, 0.0, np.zeros((0, 4)), 0.0))],
    "Mesh.rounds": [_set("meshes.0.rounds", Rounds(SPHERES, np.full(25, 0.1, np.float32)))],
    "Mesh.motion_normals": [_edit("meshes.3.motion_normals", lambda n: n[..., ::-1].copy())],
    "Instances.mesh": [_edit("instances.mesh", _with_entry(1, 3)), _edit("instances.mesh", _with_entry(1, 1))],
    "Instances.transform": [_edit("instances.transform", _with_entry(k, _at(0.5, 0.5, 0.5))) for k in (0, 2, 5)]
                           + [_edit("instances.transform", _with_entry(0, 0.0))],
    "Instances.material_offset": [_edit("instances.material_offset", _with_entry(0, 2))],
    "Instances.materials": [_edit("instances.materials", _with_entry(0, row)) for row in (-1, 3)],
    "Instances.visibility": [_edit("instances.visibility", _with_entry(0, VISIBLE_CAMERA)),
                             _edit("instances.visibility", _with_entry(2, 0))],
    "Instances.pass_index": [_edit("instances.pass_index", _with_entry(0, 2))],
    "Instances.random": [_edit("instances.random", _with_entry(0, 0.5))],
    "Instances.color": [_edit("instances.color", _with_entry(0, 0.3))],
    "Instances.is_holdout": [_edit("instances.is_holdout", _with_entry(0, True))],
    "Instances.name": [_edit("instances.name", lambda names: ["Another", *names[1:]])],
    "Instances.dupli_generated": [_edit("instances.dupli_generated", _with_entry(5, 0.4))],
    "Instances.dupli_uv": [_edit("instances.dupli_uv", _with_entry(5, 0.4))],
    "Instances.terminator_offset": [_set("instances.terminator_offset", None),
                                    _edit("instances.terminator_offset", _with_entry(0, 0.5))],
    "Instances.shading_offset": [_edit("instances.shading_offset", _with_entry(0, 0.5))],
    "Instances.light_group": [_edit("instances.light_group", _with_entry(0, 0))],
    "Instances.medium_density": [_set("instances.medium_density", np.full(6, 0.5, np.float32))],
    "Instances.is_shadow_catcher": [_edit("instances.is_shadow_catcher", _with_entry(0, True))],
    "Instances.occlusion_distance": [_set("instances.occlusion_distance", np.full(6, 0.5, np.float32))],
    "Instances.motion": [_set("instances.motion", {}),
                         _set("instances.motion", {1: np.stack([_at(0, 0, -0.5), _at(0, 0, 0.5)])}),
                         _set("instances.motion", {2: np.stack([_at(2, 0, -0.5), _at(2, 0, 0.5)])})],
    "Instances.asset": [_set("instances.asset", ["Whole"] * 6)],
    "Instances.properties": [_set("instances.properties", {}),
                             _edit("instances.properties", lambda p: {k: 0.5 * v for k, v in p.items()})],
    "SceneDescription.passes": [_set("passes", PassSettings())],
    "SceneDescription.fast_gi": [_set("fast_gi", FastGi(1))],
    "SceneDescription.asks_for_caustics": [_set("asks_for_caustics", True)],
    "SceneDescription.bake": [_set("bake", first_triangle(8, 6))],
    "PassSettings.alpha_threshold": [_set("passes.alpha_threshold", 0.9)],
    **{f"PassSettings.{name}": [_set(f"passes.{name}", 2.0)]
       for name in ("mist_start", "mist_depth", "mist_falloff", "occlusion_distance")},
    **{f"PassSettings.{name}": [_set(f"passes.{name}", name in _OFF)] for name in _OFF + _ON},
    "PassSettings.aovs": [_set("passes.aovs", ()), _set("passes.aovs", (Aov("Before", False), Aov("Tint", True)))],
    "PassSettings.motion": [_set("passes.motion", PassMotion())],
    "PassMotion.camera": [_set("passes.motion", PassMotion(camera=np.stack([_at(0, 0, 9), _at(0, 1, 9)])))],
    "PassMotion.lens": [_set("passes.motion", PassMotion(lens=np.full((2, 3), 40.0, np.float32)))],
    "PassMotion.instances": [_set("passes.motion", PassMotion(instances={0: np.stack([_at(0, 0, 0), _at(0, 1, 0)])}))],
    "PassMotion.shapes": [_set("passes.motion", PassMotion(shapes={0: np.zeros((2, 1, 3), np.float32)}))],
    "Aov.name": [_set("passes.aovs", (Aov("Another", True),))],
    "Aov.is_color": [_set("passes.aovs", (Aov("Tint", False),))],
    **{f"Notice.{name}": [_set("notices", [dataclasses.replace(Notice("a", "b", "c"), **{name: "x"})])]
       for name in ("subject", "problem", "fallback")},
}  # fmt: skip

#: Fields that tell hosts or messages something, or that this scene's kernels do not read: no array shows them.
UNSEEN = frozenset({
    "SceneDescription.working_space", "SceneDescription.frame_current", "SceneDescription.shutter", "World.key",
    "World.name", "Light.key", "Light.name", "Light.random", "Light.object_color", "Light.pass_index", "Material.key",
    "Material.name", "Material.user", "Node.name", "Image.key", "Image.name", "Image.folder", "Mesh.key", "Mesh.name",
    "Instances.name", "Instances.asset", "PassSettings.alpha_threshold", "PassSettings.mist_start",
    "PassSettings.mist_depth", "PassSettings.mist_falloff", "PassSettings.motion", "PassMotion.camera",
    "PassMotion.lens", "PassMotion.instances", "PassMotion.shapes", "PassSettings.occlusion_distance",
    *(f"PassSettings.{name}" for name in _OFF + _ON), "SceneDescription.light_groups", "SceneDescription.fast_gi",
    "World.light_group", "SceneDescription.asks_for_caustics",
})  # fmt: skip


def _changed(change: Change) -> SceneDescription:
    description = copy.deepcopy(_original())
    change(description)
    return description


def test_each_field_of_the_description_has_an_entry() -> None:
    homes = (contract.__name__, Image.__module__, PassSettings.__module__)
    members = [*inspect.getmembers(contract), *inspect.getmembers(passes)]
    classes = {item for _, item in members if dataclasses.is_dataclass(item) and item.__module__ in homes}
    names = {f"{item.__name__}.{field.name}" for item in classes for field in dataclasses.fields(item)}
    assert names == set(CHANGES)
    assert names >= UNSEEN


class Fresh(NamedTuple):
    """What a session that has kept nothing makes of a scene."""

    scene: Scene
    notices: list[Notice]
    passes: dict[str, Any]


def _fresh(description: SceneDescription) -> Fresh:
    fresh = Session(_SETTINGS)
    notices = fresh.load(description)
    scene = fresh.scene
    assert scene is not None
    found = Fresh(scene, notices, fresh.render(passes=("Combined", "Depth")).passes)
    fresh.close()
    return found


@functools.cache
def _fresh_original() -> Fresh:
    """Of what all changes are made to."""
    return _fresh(_original())


@functools.cache
def _built_original() -> Scene:
    return build_scene(_original(), _SETTINGS, SceneCache(), threads=1)


@pytest.fixture(scope="module")
def session() -> Session:
    return Session(_SETTINGS)


@pytest.mark.parametrize(
    ("field", "change"),
    [
        pytest.param(name, change, id=f"{name}-{k}")
        for name, changes in CHANGES.items()
        for k, change in enumerate(changes)
    ],
)
def test_what_was_kept_is_what_would_be_built(field: str, change: Change, session: Session) -> None:
    """Forward, and back again: the second way shows what the first left behind."""
    session.load(_original())
    for description, expected in ((_changed(change), _fresh(_changed(change))), (_original(), _fresh_original())):
        notices = session.load(description)
        assert session.scene is not None and different_arrays(session.scene, expected.scene) == []
        assert notices == expected.notices
        image = session.render(passes=("Combined", "Depth")).passes
        assert all(np.array_equal(image[name], expected.passes[name], equal_nan=True) for name in expected.passes)


@pytest.mark.parametrize("field", sorted(set(CHANGES) - UNSEEN))
def test_changes_show(field: str) -> None:
    """A field whose changes nothing shows would test nothing."""
    original = _built_original()
    shown = []
    for change in CHANGES[field]:
        description = _changed(change)
        changed = build_scene(description, _SETTINGS, SceneCache(), threads=1)
        same_facts = original.notices == changed.notices and original.description.frame == description.frame
        shown.append(bool(different_arrays(original, changed)) or not same_facts)
    assert any(shown)


def _loaded(session: Session, description: SceneDescription) -> Scene:
    session.load(description)
    assert session.scene is not None
    return session.scene


def _other_objects(a: Scene, b: Scene) -> set[str]:
    """Names of arrays that are not the same objects."""
    first, second = scene_arrays(a), scene_arrays(b)
    facts = {"world_program", "has_transparent_shadows"}
    names = {name for name in first if name not in facts and not name.startswith("bake.")}  # They are always made anew.
    return {name for name in names if first[name] is not second[name]}


def test_a_change_of_camera_builds_nothing_but_the_camera(session: Session) -> None:
    description = _original()
    # This one's emission sees the camera: its estimate would be another, rightly.
    description.materials[1].graph = _PLAIN
    before = _loaded(session, description)
    moved = copy.deepcopy(description)
    moved.camera.transform = _at(0.3, 0.1, 8)
    moved.camera.motion = None
    after = _loaded(session, moved)
    assert _other_objects(before, after) == {
        "camera.real", "camera.motion", "camera.filter", "camera.shutter", "shaders.camera"
    }
    assert after.accelerator is before.accelerator


def test_a_change_of_one_material_compiles_that_material_alone(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    from engine.shaders.surface_compiler import SurfaceCompiler

    before = _loaded(session, _original())
    names: list[str] = []
    program_of = SurfaceCompiler.compile

    def count(self: Any) -> Any:
        names.append(self.source.name)
        return program_of(self)

    monkeypatch.setattr(SurfaceCompiler, "compile", count)
    after = _loaded(session, _changed(_graph("materials.0", 1, "Roughness", 0.9)))
    assert names == ["material Textured"]
    others = _other_objects(before, after)
    assert not any(name.startswith(("geometry.", "lights.")) for name in others)
    assert not others & {"shaders.images", "shaders.pixels_byte", "shaders.pixels_float"}
    assert after.accelerator is before.accelerator


@pytest.mark.parametrize(("instance", "is_baked"), [(0, False), (2, True)])
def test_a_change_of_one_transform_keeps_the_hierarchies_of_meshes(
    instance: int, is_baked: bool, session: Session
) -> None:
    before = _loaded(session, _original())
    assert bool(before.geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED) == is_baked
    after = _loaded(session, _changed(_edit("instances.transform", _with_entry(instance, _at(0.5, 0.5, 0.5)))))
    assert after.accelerator is not before.accelerator
    assert len(before.accelerator.meshes) == 1
    assert all(a is b for a, b in zip(after.accelerator.meshes, before.accelerator.meshes, strict=True))
    shared = {"geometry.vertices", "geometry.corner_normals"}
    assert bool(_other_objects(before, after) & shared) == is_baked


def test_a_build_that_fails_leaves_nothing_stale(session: Session) -> None:
    session.load(_original())
    with pytest.raises(ValueError, match="a motion is of instance"):
        session.load(_changed(_set("instances.motion", {99: np.stack([_at(0, 0, 0)] * 2)})))
    fresh = Session(_SETTINGS)
    assert different_arrays(_loaded(session, _original()), _loaded(fresh, _original())) == []


@pytest.mark.parametrize("sees_camera", [False, True])
def test_a_look_by_another_camera_is_what_a_load_would_be(sees_camera: bool, session: Session) -> None:
    """Also where an emission sees the camera, so that more than the camera is another."""
    description = _original()
    if not sees_camera:
        description.materials[1].graph = _PLAIN
    before = _loaded(session, description)
    camera = dataclasses.replace(description.camera, transform=_at(0.3, 0.1, 8), motion=None)
    frame = Frame(12, 10, (2, 2, 12, 8))
    session.look(camera, frame)
    assert session.scene is not None
    fresh = Session(_SETTINGS)
    expected = _loaded(fresh, dataclasses.replace(description, camera=camera, frame=frame))
    assert different_arrays(session.scene, expected) == []
    assert session.scene.description.frame == frame and session.scene.notices == before.notices
    assert session.scene.accelerator is before.accelerator
    images = [item.render(passes=("Combined", "Depth")).passes for item in (session, fresh)]
    assert all(np.array_equal(images[0][name], images[1][name], equal_nan=True) for name in images[1])
    fresh.close()


def test_what_is_moved_again_builds_the_top_level_alone() -> None:
    """It is instanced, and what stands still has a hierarchy of its own; pictures are the same but for rounding."""
    session = Session(_SETTINGS, expects_moves=True)
    moves = [
        _changed(_edit("instances.transform", _with_entry(2, _at(2.0, 0.5 * step, 0.25 * step)))) for step in range(4)
    ]
    scenes = [_loaded(session, move) for move in moves]
    # Instances 2, 3 and 4 are each the only user of a mesh; the last one changes its shape.
    baked = [(scene.geometry.instance_table[:, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED) != 0 for scene in scenes]
    assert baked[0][2:4].all() and all(not item[2] and item[3] for item in baked[1:])
    # The first move takes its shape out of world space.
    for before, after in itertools.pairwise(scenes[1:]):
        shapes = {f"geometry.{name}" for name in ("vertices", "triangles", "corner_normals", "attribute_data")}
        assert not _other_objects(before, after) & shapes
        assert after.accelerator is not before.accelerator
        assert all(a is b for a, b in zip(after.accelerator.meshes, before.accelerator.meshes, strict=True))
    fresh = Session(_SETTINGS)
    _loaded(fresh, moves[-1])
    (moved, expected) = (item.render(passes=("Combined", "Depth")).passes for item in (session, fresh))
    assert np.allclose(moved["Depth"], expected["Depth"], rtol=1e-4, equal_nan=True)
    different = ~np.isclose(moved["Combined"], expected["Combined"], rtol=1e-2, atol=1e-3).all(axis=-1)
    assert different.mean() < 0.1
    # Nobody moves anything: no instances, no hierarchy of its own.
    still = Session(_SETTINGS, expects_moves=True)
    assert len(_loaded(still, moves[0]).accelerator.meshes) == len(_loaded(fresh, moves[0]).accelerator.meshes)
    for item in (session, fresh, still):
        item.close()


def test_a_scene_that_keeps_no_meshes_is_built_of_them_all_the_same():
    """Boxes of media that vary come from meshes, after geometry has been copied."""
    description = media_scene([varying("Absorption", "Density", 1.5)], [placed()])
    kept = build_scene(copy.deepcopy(description), RenderSettings(), SceneCache())
    given_up = build_scene(description, RenderSettings(), SceneCache(), keeps_meshes=False)
    assert len(description.meshes[0].vertices) == 0
    assert np.array_equal(given_up.geometry.vertices, kept.geometry.vertices)
    majorants, others = kept.media.arrays.majorants, given_up.media.arrays.majorants
    assert majorants.values.max() > 0.0
    assert np.array_equal(others.values, majorants.values) and np.array_equal(others.space, majorants.space)
