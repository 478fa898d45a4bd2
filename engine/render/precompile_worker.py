# SPDX-License-Identifier: GPL-3.0-or-later
"""What a helper process of `engine.render.precompile` does: call every kernel of its part once, on a small scene."""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from engine.builder.dicing import dice
from engine.builder.lamps import LAMP_KINDS
from engine.kernels.bsdf.linked_lobes import link_lobes
from engine.kernels.lights.linked_portals import link_portals
from engine.kernels.shader.ops_patterns import link_patterns
from engine.render import precompile
from engine.render.compile_progress import report_to
from engine.runtime import kernel_cache
from engine.scene.bake import Bake
from engine.scene.description import (
    Camera,
    Frame,
    Light,
    Link,
    Material,
    Mesh,
    Node,
    NodeGraph,
    SceneDescription,
    World,
)
from engine.scene.dicing import Dicing
from engine.scene.fast_gi import FastGi
from engine.scene.instances import plain_instances
from engine.scene.passes import Aov, PassSettings
from engine.scene.rounds import ROUND, SPHERES, Rounds
from engine.spectral.wavelengths import WAVELENGTH_COUNT
from engine.state.lanes import RGB


def compile_part(part: str) -> None:
    """Put a part of the kernels into the cache, unless another process has or does.

    Parameters
    ----------
    part : str
        One of the parts that `precompile` names.

    Raises
    ------
    OSError
        If a kernel cannot be saved.
    """
    kernel_cache.must_save = True
    # Numba's data of a kernel are kept, in millions of small objects: looking for rubbish among them takes a sixth of
    # the time, and finds little.
    gc.disable()
    with precompile.exclusive(part):
        stamp = precompile.stamp_file(part)
        if not stamp.is_file():
            count = precompile.count_file(part)
            count.unlink(missing_ok=True)
            _report_kernels_to(count)
            {
                "shaders": _compile_shaders,
                "tracing": _compile_tracing,
                "guiding": _compile_guiding,
                "spectral": _compile_spectral,
                "spectral_guiding": _compile_spectral_guiding,
                "passes": _compile_passes,
                "media": _compile_media,
                "motion": _compile_motion,
                "subsurface": _compile_subsurface,
                "curves": _compile_curves,
                "closures": _compile_closures,
                "cache": _compile_cache,
                "learning": _compile_learning,
                "fields": _compile_fields,
            }[part]()
            stamp.touch()
            count.unlink(missing_ok=True)


def _report_kernels_to(file: Path) -> None:
    """Note each kernel that is compiled from now on in a file, for whoever waits."""
    others = kernel_cache.on_compiled

    def note(key: str, compiled: Any) -> None:
        if others is not None:
            others(key, compiled)
        report_to(file)

    kernel_cache.on_compiled = note


def _compile_shaders() -> None:
    from engine.builder.programs import compile_scene

    # The compiler runs programs on a stand-in surface.
    compile_scene(small_scene())


def _compile_tracing() -> None:
    from engine.kernels.shader import interpreter

    # The other helper has this kernel. It must go before any module imports it by name.
    interpreter.evaluate_shaders = _nothing_in_place_of("evaluate_shaders")

    # What Blender's own first scene needs: denoising, and a world of one colour beside the textured one.
    passes = ("Combined", "Normal", "Denoising Albedo", "Denoising Normal")
    _render("OFF", passes=passes)
    scene = small_scene()
    scene.world = World("grey", "Grey", None)
    _render("OFF", scene=scene, passes=passes)


def _compile_guiding() -> None:
    # Every method has a stage of its own; the rest is the same.
    _render("VMM_RIS", roulette="LEARNED")
    _render("TABLE_RIS")
    # Learns with regions of its own.
    _render("OFF", roulette="LEARNED", light_selection="LEARNED")


def _compile_spectral() -> None:
    _render("OFF", spectral="ON")


def _compile_spectral_guiding() -> None:
    _render("VMM_RIS", spectral="ON", roulette="LEARNED")
    _render("TABLE_RIS", spectral="ON")


def _compile_passes() -> None:
    from engine.render.film import PASS_NAMES
    from engine.render.light_passes import group_pass
    from engine.scene.pass_names import MATTE_KINDS, aov_pass, matte_passes

    scene = small_scene()
    scene.light_groups = ("Group",)
    scene.instances.light_group = np.zeros(len(scene.instances.name), np.int32)
    for light in scene.lights:
        light.light_group = 0
    mattes = [name for kind in MATTE_KINDS for name in matte_passes(kind, 2)]
    scene.passes = PassSettings(aovs=(Aov("AOV", is_color=False),))
    passes = (*PASS_NAMES, group_pass("Group"), *mattes, aov_pass("AOV"))
    for spectral in ("OFF", "ON"):
        _render("OFF", scene=scene, passes=passes, spectral=spectral)
    scene.world = World("grey", "Grey", None)
    for spectral in ("OFF", "ON"):
        _render("OFF", scene=scene, passes=passes, spectral=spectral)
    scene.bake = whole_bake(scene)
    for spectral in ("OFF", "ON"):
        _render("OFF", scene=scene, passes=passes, spectral=spectral)
    scene.bake = None
    scene.instances.is_shadow_catcher = np.arange(len(scene.instances.name)) == 1
    scene.fast_gi = FastGi(added=1.0)
    _render("OFF", scene=scene, passes=passes)


def _compile_media() -> None:
    scene = small_scene()
    fog = NodeGraph([Node("ShaderNodeVolumeScatter", "Fog", {"Density": 0.1})], volume=Link(0, "Volume"))
    scene.materials[0].graph = fog
    for method in ("OFF", "VMM"):
        _render(method, scene=scene, passes=("Combined", "Volume Direct", "Volume Indirect"))
    scene.fast_gi = FastGi(bounces=1)
    _render("OFF", scene=scene)


def _compile_subsurface() -> None:
    scene = small_scene()
    wax = NodeGraph([Node("ShaderNodeSubsurfaceScattering", "Wax", {"Scale": 0.1})], Link(0, "BSSRDF"))
    scene.materials[0].graph = wax
    # Seldom, too, and a stage of its own.
    scene.instances.shading_offset = np.ones(len(scene.instances.name), np.float32)
    for spectral in ("OFF", "ON"):
        _render("OFF", scene=scene, spectral=spectral)
    wax.nodes.append(Node("ShaderNodeVolumeScatter", "Fog", {"Density": 0.1}))
    wax.volume = Link(1, "Volume")
    _render("OFF", scene=scene)
    _compile_node_rays()
    _compile_fast_gi()
    _compile_photons()


def _compile_node_rays() -> None:
    scene = small_scene()
    nodes = [
        Node("ShaderNodeBsdfDiffuse", "Diffuse", {"Color": Link(1, "Color")}), Node("ShaderNodeAmbientOcclusion", "AO"),
    ]  # fmt: skip
    scene.materials[0].graph = NodeGraph(nodes, Link(0, "BSDF"))
    for spectral in ("OFF", "ON"):
        _render("OFF", scene=scene, spectral=spectral)


def _compile_fast_gi() -> None:
    scene = small_scene()
    for fast_gi in (FastGi(bounces=1), FastGi(added=1.0)):
        scene.fast_gi = fast_gi
        for spectral in ("OFF", "ON"):
            _render("OFF", scene=scene, spectral=spectral)


def _compile_photons() -> None:
    scene = small_scene()
    mirror = Node("ShaderNodeBsdfAnisotropic", "Mirror", {"Color": (1.0, 1.0, 1.0, 1.0), "Roughness": 0.0})
    scene.materials[0].graph = NodeGraph([mirror], Link(0, "BSDF"))
    for spectral in ("OFF", "ON"):
        _render("OFF", scene=scene, caustics="PHOTONS", filter_glossy=0.0, spectral=spectral)
    scene.materials[0].graph.nodes.append(Node("ShaderNodeVolumeScatter", "Fog", {"Density": 0.1}))
    scene.materials[0].graph.volume = Link(1, "Volume")
    _render("OFF", scene=scene, caustics="PHOTONS", filter_glossy=0.0)


def _compile_curves() -> None:
    for shape in (ROUND, SPHERES):
        scene = small_scene()
        # The scene's clear material lets shadows through some of them.
        scene.meshes[0] = strand(shape)
        for spectral in ("OFF", "ON"):
            _render("OFF", scene=scene, spectral=spectral)


def _compile_closures() -> None:
    for channel_count in (RGB, WAVELENGTH_COUNT):
        link_lobes(channel_count)
    link_patterns()
    link_portals()


def _compile_motion() -> None:
    scene = small_scene()
    scene.shutter = (-0.25, 0.25)
    ends = np.stack([scene.instances.transform[0]] * 2)
    ends[1, 0, 3] += 0.1
    scene.instances.motion = {0: ends}
    mesh = scene.meshes[0]
    mesh.motion_vertices = np.stack([mesh.vertices, mesh.vertices + np.float32(0.01)])
    for method in ("OFF", "VMM_RIS"):
        _render(method, scene=scene, passes=("Combined", "Vector"))
    dice(mesh, Dicing(1, np.eye(3, 4), 0.5, 0.0, np.zeros((0, 4)), 0.0))


def _compile_cache() -> None:
    for kind in ("CONVERGING", "FAST"):
        for method in ("OFF", "VMM"):
            _render(method, radiance_cache=kind)


def _compile_learning() -> None:
    from engine.settings import LEAST_GUIDED_SAMPLES

    # Choosing looks at all methods in turn. What AUTO asks a network by once it trains one, a method that names it
    # loads.
    for method in ("AUTO", "NEURAL_RIS"):
        for spectral in ("OFF", "ON"):
            _render(method, samples=4 * LEAST_GUIDED_SAMPLES, spectral=spectral)
    _render("OFF", use_adaptive_sampling=True, use_denoising=True)


def _compile_fields() -> None:
    # Networks of mixtures are only trained where torch is, which Blender does not bring.
    _render("SDTREE")


def _render(
    guiding_method: str, scene: SceneDescription | None = None, passes: Sequence[str] = ("Combined", "Normal"),
    samples: int = 3, **settings: Any,
) -> None:
    from engine.builder.scene import SceneCache, build_scene
    from engine.render.session import Session
    from engine.settings import RenderSettings

    chosen = RenderSettings(samples=samples, threads=1, guiding_method=guiding_method, **settings)
    session = Session(chosen)
    # Not by `load`, which has kernels compiled by processes such as this.
    session.scene = build_scene(scene or small_scene(), chosen, SceneCache(), threads=1)
    session.render(passes=passes)


def _nothing_in_place_of(name: str) -> Callable[..., None]:
    """A function of that name, by which stages are called, that does nothing."""

    def nothing(*_arguments: Any) -> None:
        return None

    nothing.__name__ = name
    return nothing


def small_scene() -> SceneDescription:
    """A scene in which every stage has something to do: all kinds of lights, see-through shadows, a textured world."""
    up = np.eye(4, dtype=np.float32)
    up[2, 3] = 2.0
    down = np.eye(4, dtype=np.float32)
    down[2, 3] = -1.0
    gradient = NodeGraph(
        [
            Node("ShaderNodeTexGradient", "Gradient", {}, {"gradient_type": "LINEAR"}),
            Node("ShaderNodeBackground", "Background", {"Color": Link(0, "Color"), "Strength": 1.0}),
        ],
        Link(1, "Background"),
    )
    see_through = NodeGraph(
        [Node("ShaderNodeBsdfTransparent", "Clear", {"Color": (1.0, 1.0, 1.0, 1.0)})], Link(0, "BSDF")
    )
    glowing = NodeGraph([Node("ShaderNodeEmission", "Glow", {"Color": (1.0, 1.0, 1.0, 1.0), "Strength": 5.0})])
    glowing.surface = Link(0, "Emission")
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)
    mesh = Mesh("square", "Square", corners, np.array([(0, 1, 2), (0, 2, 3)], np.uint32), None, np.zeros(2, np.int32))
    white = (1.0, 1.0, 1.0)
    return SceneDescription(
        camera=Camera(transform=up),
        frame=Frame(4, 4, (0, 0, 4, 4)),
        meshes=[mesh],
        instances=plain_instances(np.stack([np.eye(4), down, 2.0 * down]), materials=range(3), name="Square"),
        materials=[Material(name, name, graph) for name, graph in (("a", None), ("b", see_through), ("c", glowing))],
        images=[],
        lights=[Light(kind, kind, kind, up, white, 10.0, **of.example) for kind, of in LAMP_KINDS.items()],
        world=World("world", "World", gradient, sampling="MANUAL", map_resolution=8),
    )


def whole_bake(scene: SceneDescription) -> Bake:
    """A bake of the first triangle of the first instance, to all pixels of the frame."""
    shape = scene.frame.height, scene.frame.width
    places = np.zeros(shape, np.int32), np.full((*shape, 2), 0.25, np.float32), np.zeros((*shape, 4), np.float32)
    return Bake(0, *places)


def strand(shape: str = ROUND) -> Mesh:
    """A strand of two segments along the square's edges, or two spheres at its corners."""
    square = small_scene().meshes[0]
    rows = [(0, 0, 0), (1, 1, 1)] if shape == SPHERES else [(0, 1, 0), (1, 2, 0)]
    rounds = Rounds(shape, np.full(len(square.vertices), 0.1, np.float32))
    return Mesh(shape, shape, square.vertices, np.array(rows, np.uint32), None, np.zeros(2, np.int32), rounds=rounds)
