# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings: the names scripts depend on, and whose settings count, Cycles' or ours."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from engine.settings import EXPERIMENT_SECTIONS, SETTINGS, RenderSettings
from tests.helpers.fake_engine import FakeEngine

#: Programs say what they want; a user of Blender gets what pays, and else what Cycles does by default.
DEFAULTS = RenderSettings(
    guiding_method="AUTO", radiance_cache="AUTO", caustics="AUTO", samples=4096, clamp_indirect=10.0,
    use_adaptive_sampling=True, use_denoising=True,
)

#: Name of ours: owner below the scene, name there, a value that is not the default.
CYCLES_VALUES: dict[str, tuple[str, str, Any]] = {
    "samples": ("cycles", "samples", 9),
    "use_adaptive_sampling": ("cycles", "use_adaptive_sampling", False),
    "adaptive_threshold": ("cycles", "adaptive_threshold", 0.25),
    "adaptive_min_samples": ("cycles", "adaptive_min_samples", 40),
    "time_limit": ("cycles", "time_limit", 12.5),
    "seed": ("cycles", "seed", 5),
    "max_bounces": ("cycles", "max_bounces", 1),
    "diffuse_bounces": ("cycles", "diffuse_bounces", 0),
    "glossy_bounces": ("cycles", "glossy_bounces", 0),
    "transmission_bounces": ("cycles", "transmission_bounces", 1),
    "volume_bounces": ("cycles", "volume_bounces", 2),
    "transparent_max_bounces": ("cycles", "transparent_max_bounces", 0),
    "min_light_bounces": ("cycles", "min_light_bounces", 12),
    "min_transparent_bounces": ("cycles", "min_transparent_bounces", 12),
    "light_sampling_threshold": ("cycles", "light_sampling_threshold", 0.9),
    "use_caustics_reflective": ("cycles", "caustics_reflective", False),
    "use_caustics_refractive": ("cycles", "caustics_refractive", False),
    "filter_glossy": ("cycles", "blur_glossy", 5.0),
    "clamp_direct": ("cycles", "sample_clamp_direct", 0.25),
    "clamp_indirect": ("cycles", "sample_clamp_indirect", 0.25),
    "pixel_filter": ("cycles", "pixel_filter_type", "BOX"),
    "filter_width": ("cycles", "filter_width", 4.0),
    "film_exposure": ("cycles", "film_exposure", 1.75),
    "film_transparent": ("render", "film_transparent", True),
    "use_denoising": ("cycles", "use_denoising", False),
    "denoising_input_passes": ("cycles", "denoising_input_passes", "RGB"),
    "denoising_prefilter": ("cycles", "denoising_prefilter", "FAST"),
    "denoising_quality": ("cycles", "denoising_quality", "BALANCED"),
}


@pytest.fixture
def without_cycles(blender: Any) -> Iterator[None]:
    """The Cycles add-on switched off."""
    import addon_utils

    addon_utils.disable("cycles")
    try:
        yield
    finally:
        addon_utils.enable("cycles")


def settings_of(scene: Any) -> RenderSettings:
    from addon.properties import render_settings

    return render_settings(scene)


def as_read(settings: RenderSettings) -> dict[str, Any]:
    """Floats as Blender holds them."""
    return {
        name: pytest.approx(value) if isinstance(value, float) else value
        for name, value in dataclasses.asdict(settings).items()
    }


def test_scene_settings_have_the_engine_s_names_and_cycles_defaults(blender: Any) -> None:
    from addon.declared_settings import setting_owner
    from addon.shared_settings import SHARED_SETTINGS

    scene = blender.context.scene
    ours = scene.neuralguide
    held = {name: getattr(setting_owner(scene, name), name) for name in dataclasses.asdict(DEFAULTS)}
    assert held == as_read(DEFAULTS)
    assert dataclasses.asdict(settings_of(scene)) == as_read(DEFAULTS)
    for name, (owner, their_name) in SHARED_SETTINGS.items():
        theirs = getattr(scene, owner).bl_rna.properties[their_name]
        assert ours.bl_rna.properties[name].default == theirs.default, name


def test_properties_are_what_the_declarations_say(blender: Any) -> None:
    from addon.declared_settings import SCENE_SETTINGS, setting_owner

    scene = blender.context.scene
    # The light mix changes pictures, not renders.
    groups = {"name", "rna_type", "experiment", "light_mix", "use_light_mix"}
    for is_experiment, owner in ((False, scene.neuralguide), (True, scene.neuralguide.experiment)):
        declared = {setting.name for setting in SCENE_SETTINGS.values() if setting.is_experiment == is_experiment}
        assert set(owner.bl_rna.properties.keys()) - groups == declared
    for setting in SCENE_SETTINGS.values():
        found = setting_owner(scene, setting.name).bl_rna.properties[setting.name]
        assert (found.name, found.description) == (setting.label, setting.sentence)
        assert setting.sentence and not setting.sentence.endswith("."), setting.name
        if setting.choices:
            items = [(item.identifier, item.name, item.description) for item in found.enum_items]
            assert items == [tuple(choice) for choice in setting.choices]
        elif setting.maximum is not None and setting.scene_minimum is None:
            assert (found.hard_min, found.hard_max) == (pytest.approx(setting.minimum), pytest.approx(setting.maximum))


def test_a_scene_can_hold_every_limit(blender: Any) -> None:
    """Blender's floats are rounded; what a slider offers must not be refused."""
    from addon.declared_settings import setting_owner

    scene = blender.context.scene
    scene.neuralguide.use_cycles_settings = False
    for setting in SETTINGS.values():
        owner = setting_owner(scene, setting.name)
        for limit in (setting.minimum, setting.maximum):
            if limit is not None:
                setattr(owner, setting.name, type(setting.default)(limit))
                assert getattr(settings_of(scene), setting.name) == pytest.approx(limit)


def test_a_user_sees_few_settings_and_experiments_are_apart() -> None:
    """Beside what Cycles or Blender has too."""
    from addon.declared_settings import SCENE_SETTINGS
    from addon.shared_settings import SHARED_SETTINGS

    seen = {setting.name for setting in SCENE_SETTINGS.values() if not setting.is_experiment}
    assert seen - SHARED_SETTINGS.keys() == {
        "use_cycles_settings", "guiding_method", "radiance_cache", "caustics", "spectral", "light_selection",
        "guiding_trial", "training_share", "training_device", "deterministic", "sequence_field", "sequence_samples",
        "keep_learned",
        "field_path", "save_field", "threads", "texture_memory", "denoise_over_time", "denoised_threshold",
        "keep_unfinished", "keep_film",
    }  # fmt: skip
    assert {setting.section for setting in SCENE_SETTINGS.values() if setting.is_experiment} == {*EXPERIMENT_SECTIONS}


#: Numbers by which files know choices: a new one goes last, none may move.
SAVED_CHOICES = {
    "guiding_method": "AUTO OFF VMM SDTREE SDTREE_VARIANCE NPM NPM_PRODUCT NASG FLOW VMM_RIS TABLE_RIS NEURAL_RIS",
    "spectral": "AUTO ON OFF",
    "pixel_filter": "BOX GAUSSIAN BLACKMAN_HARRIS",
    "sample_weighting": "ITERATION UNIFORM",
    "source_field": "VMM SDTREE SDTREE_VARIANCE NPM NPM_PRODUCT NASG FLOW",
    "candidate_allocation": "ORCA FIXED",
    "ris_target": "COLOR SCALAR",
    "network_size": "COMPACT PAPER",
    "network_backend": "KERNEL ONNXRUNTIME AUTO",
    "training_device": "AUTO CPU CUDA",
    "radiance_cache": "OFF FAST CONVERGING AUTO",
    "light_selection": "AUTO TREE LEARNED",
    "mixture_preset": "PAPER OFFICIAL COMPACT SMALL",
    "mixture_target": "RADIANCE COSINE PRODUCT",
    "mixture_lobes": "OWN VMF NASG SG",
    "u_dimension": "NONE AUTO TIME WAVELENGTH",
    "mixture_u": "NONE FREQUENCY PLANES HASH4D",
    "network_u": "AUTO NONE FREQUENCY PLANES",
    "denoising_input_passes": "RGB RGB_ALBEDO RGB_ALBEDO_NORMAL",
    "denoising_prefilter": "NONE FAST ACCURATE",
    "denoising_quality": "HIGH BALANCED FAST",
    "roulette": "AUTO THROUGHPUT LEARNED",
    "caustics": "PATHS PHOTONS AUTO",
}


def test_choices_keep_the_numbers_that_files_hold() -> None:
    found = {name: [choice.name for choice in setting.choices] for name, setting in SETTINGS.items() if setting.choices}
    assert found == {name: names.split() for name, names in SAVED_CHOICES.items()}


def test_without_cycles_our_defaults_hold(without_cycles: None, blender: Any) -> None:
    scene = blender.context.scene
    assert not hasattr(scene, "cycles")
    assert scene.neuralguide.use_cycles_settings
    assert dataclasses.asdict(settings_of(scene)) == as_read(DEFAULTS)
    scene.neuralguide.max_bounces = 3
    assert settings_of(scene).max_bounces == 3
    with pytest.raises(RuntimeError, match="poll"):
        blender.ops.neuralguide.copy_cycles_settings()


def test_every_shared_setting_is_in_the_table_of_this_test() -> None:
    from addon.shared_settings import SHARED_SETTINGS

    named = {name: (owner, their_name) for name, (owner, their_name, _) in CYCLES_VALUES.items()}
    # What these do is not to be seen in the settings of a render.
    others = {name: ("cycles", name) for name in ("use_animated_seed", "preview_denoising_start_sample")}
    others |= {name: ("cycles", name) for name in VIEWPORT_VALUES}
    assert named | others == SHARED_SETTINGS


#: What Cycles' viewports have: a value, and the setting of a viewport that it comes to.
VIEWPORT_VALUES = {
    "preview_samples": (77, "samples"),
    "use_preview_adaptive_sampling": (False, "use_adaptive_sampling"),
    "preview_adaptive_threshold": (0.25, "adaptive_threshold"),
    "preview_adaptive_min_samples": (9, "adaptive_min_samples"),
    "use_preview_denoising": (True, "use_denoising"),
    "preview_denoising_input_passes": ("RGB", "denoising_input_passes"),
    "preview_denoising_prefilter": ("NONE", "denoising_prefilter"),
    "preview_denoising_quality": ("FAST", "denoising_quality"),
}


@pytest.mark.parametrize("name", VIEWPORT_VALUES)
def test_viewports_have_settings_of_their_own(name: str, blender: Any) -> None:
    """Cycles', or ours where they are set or the scene does not follow it; a render sees nothing of them."""
    from addon.viewport.settings import preview_settings

    scene = blender.context.scene
    value, seen_as = VIEWPORT_VALUES[name]
    before, default = settings_of(scene), getattr(scene.neuralguide, name)
    assert default != value and getattr(preview_settings(scene), seen_as) == pytest.approx(default)
    setattr(scene.cycles, name, value)
    assert getattr(preview_settings(scene), seen_as) == pytest.approx(value)
    scene.neuralguide.use_cycles_settings = False
    assert getattr(preview_settings(scene), seen_as) == pytest.approx(default)
    setattr(scene.neuralguide, name, value)
    assert getattr(preview_settings(scene), seen_as) == pytest.approx(value)
    scene.neuralguide.use_cycles_settings = True
    assert settings_of(scene) == before


@pytest.mark.parametrize("name", CYCLES_VALUES)
def test_cycles_settings_count_until_ours_is_set(name: str, blender: Any) -> None:
    from addon.shared_settings import setting_value

    scene = blender.context.scene
    ours = scene.neuralguide
    owner, their_name, value = CYCLES_VALUES[name]
    default = getattr(ours, name)
    assert default != value
    setattr(getattr(scene, owner), their_name, value)
    assert setting_value(scene, name) == pytest.approx(value)
    if name != "film_exposure":  # the export's, in the frame
        assert getattr(settings_of(scene), name) == pytest.approx(value)
    # A script that sets ours means it, even where it is what we have by default.
    setattr(ours, name, default)
    assert ours.use_cycles_settings
    assert setting_value(scene, name) == default
    others = set(CYCLES_VALUES) - {name}
    assert not any(ours.is_property_set(other) for other in others)
    assert blender.ops.neuralguide.follow_cycles_setting(setting=name) == {"FINISHED"}
    assert setting_value(scene, name) == pytest.approx(value)
    # Separate settings.
    ours.use_cycles_settings = False
    assert setting_value(scene, name) == default
    assert blender.ops.neuralguide.copy_cycles_settings() == {"FINISHED"}
    assert getattr(ours, name) == pytest.approx(value)


def make_telling_scene(scene: Any) -> None:
    """A picture that every setting changes: glass, a mirror, a card and a cloud under a bright world and two lamps."""
    import bpy

    def material(name: str, kind: str, where: str = "Surface", **inputs: Any) -> Any:
        made = bpy.data.materials.new(name)
        made.use_nodes = True
        nodes, links = made.node_tree.nodes, made.node_tree.links
        nodes.clear()
        shader, output = nodes.new(kind), nodes.new("ShaderNodeOutputMaterial")
        for key, value in inputs.items():
            shader.inputs[key].default_value = value
        links.new(shader.outputs[0], output.inputs[where])
        return made

    def add(operator: Any, surface: Any, **arguments: Any) -> None:
        operator(**arguments)
        bpy.context.object.data.materials.append(surface)

    primitive = bpy.ops.mesh
    white = (0.9, 0.9, 0.9, 1.0)
    add(primitive.primitive_plane_add, material("Floor", "ShaderNodeBsdfDiffuse", Color=white), size=9.0)
    glass = material("Glass", "ShaderNodeBsdfGlass", Roughness=0.05)
    mirror = material("Mirror", "ShaderNodeBsdfGlossy", Roughness=0.1)
    add(primitive.primitive_uv_sphere_add, glass, radius=0.7, location=(-1.0, 0.0, 0.7))
    add(primitive.primitive_cube_add, mirror, size=1.2, location=(1.0, 0.4, 0.6))
    card = material("Card", "ShaderNodeBsdfTransparent", Color=(0.7, 0.8, 0.9, 1.0))
    add(primitive.primitive_plane_add, card, size=2.0, location=(0.6, -1.5, 0.8), rotation=(1.57, 0.0, 0.0))
    cloud = material("Cloud", "ShaderNodeVolumeScatter", "Volume", Density=5.0)
    add(primitive.primitive_cube_add, cloud, size=0.6, location=(-0.2, -1.2, 0.4))
    world = scene.world = bpy.data.worlds.new("World")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.6, 0.7, 0.9, 1.0)
    for energy, x in ((300.0, 2.0), (4.0, -2.0)):
        lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
        lamp.data.energy, lamp.location = energy, (x, -1.0, 3.0)
        scene.collection.objects.link(lamp)


def test_each_of_cycles_settings_has_an_effect_on_the_picture(cube_scene: Any, blender: Any, tmp_path: Path) -> None:
    """What is set on `scene.cycles` alone changes pixels of a render with the same random numbers."""
    import OpenEXR

    from addon import engine

    scene = cube_scene
    make_telling_scene(scene)
    for name in ("samples", "seed"):
        scene.neuralguide.property_unset(name)
    scene.neuralguide.guiding_method = "OFF"
    scene.cycles.samples, scene.cycles.use_adaptive_sampling = 4, False
    scene.cycles.sample_clamp_indirect = 0.0

    def render() -> np.ndarray:
        scene.render.filepath = str(tmp_path / "image.exr")
        engine.outcomes.clear()
        blender.ops.render.render(write_still=True)
        with OpenEXR.File(scene.render.filepath) as file:
            return np.array(file.channels()["RGBA"].pixels)

    scene.cycles.use_denoising = False
    plain = render()
    np.testing.assert_array_equal(render(), plain)
    scene.cycles.use_denoising = True
    denoised = render()
    without_effect = []
    for name, (owner_name, their_name, value) in CYCLES_VALUES.items():
        owner = getattr(scene, owner_name)
        before = getattr(owner, their_name)
        if "adaptive" in name:  # of no effect on so few samples
            continue
        scene.cycles.use_denoising = is_denoised = "denoising" in name
        if name == "time_limit":  # of so many samples that only the clock can end it
            scene.cycles.samples, value = 1 << 20, 0.2
        setattr(owner, their_name, value)
        changed = render()
        if name == "time_limit":
            assert 1.0 <= engine.outcomes[-1].report.sample_count < 1 << 20
            scene.cycles.samples = 4
        elif np.array_equal(changed, denoised if is_denoised else plain):
            without_effect.append(name)
        setattr(owner, their_name, before)
    assert not without_effect
    scene.cycles.use_denoising = False
    scene.cycles.use_animated_seed = True
    assert np.any(render() != plain)
    np.testing.assert_array_equal(render(), render())
    scene.cycles.samples, scene.cycles.adaptive_threshold, scene.cycles.adaptive_min_samples = 64, 0.1, 4
    counts = [64.0]
    for name in ("use_adaptive_sampling", "adaptive_threshold", "adaptive_min_samples"):
        setattr(scene.cycles, name, True if name == "use_adaptive_sampling" else CYCLES_VALUES[name][2])
        render()
        counts.append(engine.outcomes[-1].report.sample_count)
    # Fewer with a threshold, fewer still with a larger one; the least is 48, the next look after 40.
    assert 64.0 > counts[1] > counts[2] and counts[3] >= 48.0, counts


def test_an_animated_seed_differs_between_frames_and_repeats(blender: Any) -> None:
    scene = blender.context.scene
    scene.cycles.use_animated_seed = True

    def seed(frame: int) -> int:
        scene.frame_set(frame)
        return settings_of(scene).seed

    seeds = [seed(frame) for frame in range(1, 20)]
    assert len(set(seeds)) == len(seeds)
    assert seed(1) == seeds[0]
    scene.cycles.seed = 1
    assert seed(1) != seeds[0]


def test_threads_follow_the_scene_s_fixed_number(blender: Any) -> None:
    scene = blender.context.scene
    scene.render.threads_mode, scene.render.threads = "FIXED", 3
    assert settings_of(scene).threads == 3
    scene.neuralguide.threads = 1
    assert settings_of(scene).threads == 1


def test_a_setting_of_ours_can_be_animated(cube_scene: Any, blender: Any, monkeypatch: Any, tmp_path: Path) -> None:
    """An animated value is set like one that a script sets."""
    fake = FakeEngine(monkeypatch)
    scene = cube_scene
    scene.neuralguide.property_unset("samples")
    scene.cycles.samples = 50
    scene.neuralguide.keyframe_insert("samples", frame=1)
    scene.neuralguide.samples = 30
    scene.neuralguide.keyframe_insert("samples", frame=11)
    scene.render.filepath = str(tmp_path / "x")
    scene.frame_set(11)
    blender.ops.render.render()
    assert fake.sessions[-1].settings.samples == 30


@pytest.mark.parametrize(("rule", "follows", "expected"), [
    ("USE", True, (7, 70, 20)), ("BOUNDED", True, (7, 20, 20)), ("IGNORE", True, (20, 20, 20)),
    ("IGNORE", False, (7, 70, 20)),
])  # fmt: skip
def test_layer_samples_follow_cycles_rule(rule: str, follows: bool, expected: Any, blender: Any) -> None:
    from addon.shared_settings import layer_samples

    scene = blender.context.scene
    scene.cycles.use_layer_samples = rule
    scene.neuralguide.use_cycles_settings = follows
    layers = [SimpleNamespace(samples=count) for count in (7, 70, 0)]
    assert tuple(layer_samples(scene, layer, 20) for layer in layers) == expected


UNSUPPORTED = {
    "subset of samples": ("cycles", "use_sample_subset", True),
    "in one way only": ("cycles", "direct_light_sampling_type", "FORWARD_PATH_TRACING"),
    "transparent glass": ("cycles", "film_transparent_glass", True),
    "pixel jitter": ("cycles", "use_pixel_jitter", True),
    "Open Shading Language": ("cycles", "shading_system", True),
    "GPU": ("cycles", "device", "GPU"),
}


@pytest.mark.parametrize("problem", UNSUPPORTED)
def test_what_cycles_settings_ask_for_in_vain_is_named(problem: str, blender: Any) -> None:
    from addon.unsupported_settings import unsupported_settings

    scene = blender.context.scene
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.render.film_transparent = True
    layer = scene.view_layers[0]
    assert unsupported_settings(scene, layer) == []
    owner, name, value = UNSUPPORTED[problem]
    if not hasattr(getattr(scene, owner), name):
        pytest.skip(f"this Blender has no {name}")
    setattr(getattr(scene, owner), name, value)
    (notice,) = unsupported_settings(scene, layer)
    assert problem in notice.problem and "not supported" in notice.problem and notice.fallback
    # It does not concern a scene with settings of its own.
    scene.neuralguide.use_cycles_settings = False
    assert unsupported_settings(scene, layer) == []
