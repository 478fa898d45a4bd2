# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages called through pointers: what a loop passes is what they take, and the loop in Python does the same."""

from __future__ import annotations

from types import FunctionType

import numba
import numpy as np
import pytest

from engine.methods import METHODS
from engine.render import photon_tracing, tracer
from engine.render.data_passes import SPECULAR_MOTION
from engine.render.precompile_worker import small_scene, strand
from engine.render.session import Session
from engine.runtime.bundle import Bundle
from engine.runtime.jit import BoundKernel, in_python, kernel
from engine.runtime.stage_table import StageTable, StageType
from engine.scene.description import Link, Node, NodeGraph, SceneDescription
from engine.scene.fast_gi import FastGi
from engine.scene.grids import VolumeMotion
from engine.scene.linking import ALL_SETS, Linking
from engine.scene.passes import Aov, PassSettings
from engine.settings import RenderSettings
from engine.wavefront.trace_photons import trace_photons
from engine.wavefront.trace_rounds import trace_rounds
from tests.helpers.bakes import first_triangle
from tests.helpers.caustic_scenes import mirror_scene
from tests.helpers.media_scenes import grid_of
from tests.helpers.misty_scenes import mirror_in_fog
from tests.helpers.subsurface_scenes import below

_OF_WAVELENGTHS = {"upsample_emission", "upsample_lights", "upsample_closures"}
_OF_CACHE = {"end_in_cache", "follow_footprints", "collect_cache_records"}
_OF_CATCHERS = {"meet_catchers", "show_background"}
_OF_MEDIA = {
    "start_media", "find_gaps", "sample_medium", "cross_boundaries", "prepare_collisions", "scatter_collisions",
    "begin_tracking", "find_collisions", "move_media", "meet_media", "begin_shadows", "find_shadow_collisions",
    "dim_shadows", "light_segments", "leave_segments", "prepare_collision_guides", "guide_collisions",
    "draw_collision_candidates", "resample_collisions",
}  # fmt: skip
_OF_SUBSURFACE = {"walk_subsurface", "leave_subsurface"}
_OF_CURVES = {"prepare_rounds", "prepare_passed_rounds"}
#: And of shading offsets, which that scene has too.
_OF_LINKS = {
    "meet_hidden_lamps", "leave_hidden_lamps", "meet_varying_lamps", "keep_varying_lamps", "add_varying_lamps",
    "shift_terminator",
}  # fmt: skip
#: Of Fast GI, which adds light to the scene with media; short rays are for unguided renders.
_OF_FAST_GI = {"shorten_rays", "lengthen_rays", "dim_background"}
#: Of the loop that sends photons off; and of paths where photons are.
_OF_PHOTON_LOOP = {"place_photons", "launch_photons", "follow_photons", "keep_photons", "keep_at_collisions"}
_OF_PHOTONS = _OF_PHOTON_LOOP | {
    "gather_photons", "leave_to_photons", "mark_caustics", "gather_at_collisions", "mark_collisions"
}
_OF_BAKES = {"aim_at_baked", "meet_baked"}
_OF_ADDED_LIGHT = {"aim_added_light", "leave_added_light"}
#: Where media vary others are in its place.
_OF_UNIFORM_MEDIA = {"attenuate_shadows"}


def _link_lamps(description: SceneDescription) -> None:
    """Let nothing but the first surface cast shadows in the lamps' light, and one lamp vary over its surface."""
    instances, lamps = len(description.instances.mesh), len(description.lights)
    every = np.full(max(instances, lamps), ALL_SETS, np.uint64)
    description.linking = Linking(
        np.zeros(instances, np.int32), np.minimum(np.arange(instances), 1).astype(np.int32), every[:instances],
        every[:instances], every[:lamps], np.full(lamps, 1, np.uint64),
    )  # fmt: skip
    gradient = NodeGraph(
        [
            Node("ShaderNodeTexCoord", "Coordinates", {}, {}),
            Node("ShaderNodeTexGradient", "Gradient", {"Vector": Link(0, "UV")}, {"gradient_type": "LINEAR"}),
            Node("ShaderNodeEmission", "Emission", {"Color": Link(1, "Color"), "Strength": 1.0}),
        ],
        Link(2, "Emission"),
    )
    area = next(light for light in description.lights if light.kind == "AREA")
    area.graph = gradient


@kernel
def _add(values, amount):
    for k in range(values.shape[0]):
        values[k] += amount


@kernel
def _double(values):
    for k in range(values.shape[0]):
        values[k] *= 2.0


@kernel
def _first(values):
    return values[0]


@kernel
def _both(stages, values):
    stages.add(values, np.float32(2.0))
    stages.double(values)


class _Numbers(Bundle):
    values: np.ndarray


class _Pair(Bundle):
    first: np.ndarray
    second: np.ndarray


class _Holder(Bundle):
    _opaque = frozenset({"held"})

    before: np.ndarray
    held: Bundle
    after: np.ndarray


@kernel
def _take_nothing(held, values):
    """In the place of a stage that is plugged in."""


@kernel
def _take_numbers(held, values):
    for k in range(values.shape[0]):
        values[k] = held.values[k]


@kernel
def _take_pair(held, values):
    for k in range(values.shape[0]):
        values[k] = held.first[k] + held.second[k]


@kernel
def _pass_on(stages, holder):
    stages.take(holder.held, holder.after)


@kernel
def _loop(stages, values, turns):
    for _ in range(turns):
        _both(stages, values)
    return values.shape[0]


def _table(values: np.ndarray) -> StageTable:
    table = StageTable({"add": _add, "double": _double, "unused": _first})
    assert table.link({"add": (values, np.float32(0.0)), "double": (values,)})
    return table


def test_a_compiled_loop_calls_stages_as_python_does() -> None:
    values, again = np.arange(3, dtype=np.float32), np.arange(3, dtype=np.float32)
    table = _table(values)
    np.testing.assert_array_equal(values, [0.0, 1.0, 2.0])
    assert BoundKernel(_loop)(table, values, 2) == in_python(_loop)(table, again, 2) == 3
    np.testing.assert_array_equal(values, [12.0, 16.0, 20.0])
    np.testing.assert_array_equal(again, values)


class Numbers(Bundle):
    """One array."""

    values: np.ndarray


@kernel
def _add_to_field(stages, numbers):
    stages.add(numbers.values, np.float32(1.0))


def test_a_field_reaches_a_stage_as_the_array_that_it_is() -> None:
    numbers = Numbers(np.arange(3, dtype=np.float32))
    BoundKernel(_add_to_field)(_table(numbers.values), numbers)
    np.testing.assert_array_equal(numbers.values, [1.0, 2.0, 3.0])


def test_a_plain_function_cannot_be_linked() -> None:
    assert not StageTable({"add": lambda values: None}).link({"add": (np.ones(1),)})


def test_a_stage_that_returns_something_is_an_error() -> None:
    with pytest.raises(TypeError, match="stage first returns float32"):
        StageTable({"first": _first}).link({"first": (np.ones(1, np.float32),)})


def test_python_sees_the_stages_and_no_others() -> None:
    values = np.ones(4, np.float32)
    table = _table(values)
    table.add(values, np.float32(1.0))
    np.testing.assert_array_equal(values, 2.0)
    with pytest.raises(AttributeError):
        table.nothing  # noqa: B018


def _fill_with_fog(graph: NodeGraph) -> None:
    graph.nodes.append(Node("ShaderNodeTexNoise", "Noise"))
    # So dense that what rays skip at surfaces matters.
    factor = {"Value": Link(len(graph.nodes) - 1, "Fac"), "Value_001": 1e5}
    graph.nodes.append(Node("ShaderNodeMath", "Times", factor, {"operation": "MULTIPLY"}))
    density = Link(len(graph.nodes) - 1, "Value")
    graph.nodes.append(Node("ShaderNodeVolumeScatter", "Fog", {"Density": density}, {"phase": "HENYEY_GREENSTEIN"}))
    graph.volume = Link(len(graph.nodes) - 1, "Volume")


def test_a_loop_passes_on_bundles_that_it_does_not_know() -> None:
    """It is compiled once; the stage that is plugged in knows what it gets."""
    one, two, out = np.arange(3.0, dtype=np.float32), np.full(3, 10.0, np.float32), np.zeros(3, np.float32)
    table = StageTable({"take": _take_nothing})
    first = _Holder(two, _Numbers(one), out)
    second = first._replace(held=_Pair(one, two))
    assert numba.typeof(first) == numba.typeof(second)
    loop = BoundKernel(_pass_on)
    loop.bind(table, first)
    assert table.plug("take", _take_numbers, first.held, out)
    loop(table, first)
    np.testing.assert_array_equal(out, one)
    assert table.plug("take", _take_pair, second.held, out)
    loop(table, second)
    np.testing.assert_array_equal(out, one + two)
    assert not table.plug("take", lambda held, values: None, second.held, out)


@pytest.mark.parametrize(
    ("method", "spectral", "roulette"),
    [
        ("VMM", "OFF", "AUTO"), ("VMM_RIS", "OFF", "LEARNED"), ("TABLE_RIS", "OFF", "AUTO"),
        pytest.param("TABLE_RIS", "ON", "AUTO", marks=pytest.mark.slow),
    ],
)
def test_the_main_loop_passes_what_its_stages_take(
    method: str, spectral: str, roulette: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing else would notice: calls through pointers are not checked."""
    arguments: list[tuple] = []

    class KeepingLoop(BoundKernel):
        def __call__(self, *given: object) -> object:
            arguments.append(given)
            return super().__call__(*given)

    monkeypatch.setattr(tracer, "BoundKernel", KeepingLoop)
    # Wavelengths have no cache.
    cache = "CONVERGING" if method == "TABLE_RIS" else "OFF"
    session = Session(
        RenderSettings(
            samples=8, threads=1, guiding_method=method, spectral=spectral, radiance_cache=cache, roulette=roulette
        )
    )
    description = small_scene()
    has_media = method == "VMM"
    if has_media:
        _fill_with_fog(next(item.graph for item in description.materials if item.graph is not None))
        velocity = np.full((4, 4, 4, 3), 0.1, np.float32)
        description.meshes[0].volume_motion = VolumeMotion(grid_of(velocity, np.eye(4)), 0.5, 1.0)
        description.fast_gi = FastGi(added=1.0)
    has_subsurface = method == "VMM_RIS"
    if has_subsurface:
        description.materials[0].graph = below().graph
        # Shadow rays pass a strand of the clear material.
        description.meshes.append(strand())
        description.instances.mesh[1] = 1
        description.bake = first_triangle(description.frame.width, description.frame.height)
    has_links = method == "TABLE_RIS" and spectral == "OFF"
    if has_links:
        _link_lamps(description)
    has_catchers = cache == "OFF"  # for with them there is no cache
    description.instances.is_shadow_catcher = np.full(len(description.instances.mesh), has_catchers)
    description.passes = PassSettings(aovs=(Aov("Value", False),))
    offset = 0.5 if has_links else 0.0
    description.instances.shading_offset = np.full(len(description.instances.mesh), offset, np.float32)
    session.load(description)
    # A pass of each kind: they have stages of their own.
    passes = ("Combined", "Normal", "Mist", "Denoising Albedo", "Glossy Color", "Ambient Occlusion", SPECULAR_MOTION)
    session.render(passes=passes)
    assert arguments, "the loop was not compiled"
    table = arguments[-1][0]
    assert isinstance(table, StageTable)

    function = trace_rounds.py_func
    copy = FunctionType(function.__code__, function.__globals__, "not_in_the_cache")
    numba.njit(nogil=True, _nrt=False)(copy).compile(tuple(numba.typeof(argument) for argument in arguments[-1]))
    stages = table.as_dict()
    bound = {name: stage for name, stage in stages.items() if stage.is_bound}  # type: ignore[attr-defined]
    assert set(StageType.called_with) >= set(stages) - _OF_PHOTON_LOOP
    # The world is not constant in this scene, no model weighs candidates, none has portals, nor media and subsurface.
    unused = {"fill_background", "ask_model", "cross_below", "enter_portals"} | _OF_UNIFORM_MEDIA | _OF_FAST_GI
    unused |= _OF_PHOTONS
    if spectral == "OFF":
        unused |= _OF_WAVELENGTHS
    if cache == "OFF" or spectral == "ON":
        unused |= _OF_CACHE
    if not has_catchers:
        unused |= _OF_CATCHERS
    if not has_media:
        unused |= _OF_MEDIA
    if not has_media or cache == "OFF":
        unused |= {"follow_collisions"}
    if not has_media:
        unused |= _OF_ADDED_LIGHT
    if not has_subsurface:
        unused |= _OF_SUBSURFACE | _OF_CURVES | _OF_BAKES
    if not has_links:
        unused |= _OF_LINKS
    if roulette != "LEARNED":
        unused |= {"play_adjoint_roulette"}
    assert set(stages) - set(bound) == unused
    for name, stage in bound.items():
        assert stage.signature.args in StageType.called_with[name], name  # type: ignore[attr-defined]


def test_the_loops_pass_what_stages_of_photons_take(monkeypatch: pytest.MonkeyPatch) -> None:
    arguments: dict[str, tuple] = {}

    class KeepingLoop(BoundKernel):
        def __call__(self, *given: object) -> object:
            arguments[str(len(given))] = given
            return super().__call__(*given)

    for module in (tracer, photon_tracing):
        monkeypatch.setattr(module, "BoundKernel", KeepingLoop)
    session = Session(RenderSettings(samples=1, threads=1, caustics="PHOTONS", filter_glossy=0.0))
    session.load(mirror_in_fog())
    session.render()
    assert len(arguments) == 2, "a loop was not compiled"
    for loop, given in zip((trace_photons, trace_rounds), (arguments["6"], arguments["7"]), strict=True):
        copy = FunctionType(loop.py_func.__code__, loop.py_func.__globals__, "not_in_the_cache")
        numba.njit(nogil=True, _nrt=False)(copy).compile(tuple(numba.typeof(argument) for argument in given))
    stages = arguments["7"][0].as_dict()
    for name in _OF_PHOTONS:
        assert stages[name].signature.args in StageType.called_with[name], name


@pytest.mark.parametrize(("method", "caustics"), [("OFF", "PATHS"), ("VMM_RIS", "PATHS"), ("OFF", "PHOTONS")])
def test_the_loop_in_python_makes_the_same_image(method: str, caustics: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert method in METHODS

    def render() -> np.ndarray:
        session = Session(
            RenderSettings(samples=20, threads=1, guiding_method=method, seed=5, caustics=caustics, filter_glossy=0.0)
        )
        session.load(small_scene() if caustics == "PATHS" else mirror_scene())
        return session.render().passes["Combined"]

    compiled = render()
    monkeypatch.setattr(StageTable, "link", lambda self, arguments: False)
    np.testing.assert_array_equal(render(), compiled)
