# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels: they come and go with the add-on, and show the very properties that count."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from tests.helpers.blender_scenes import stand_in
from tests.helpers.panel_layout import Layout


def draw(panel: Any, context: Any) -> Layout:
    """What a panel of ours draws."""
    layout = Layout()
    drawer = stand_in(panel, layout)
    for method in ("draw_header", "draw_header_preset", "draw"):
        if hasattr(panel, method):
            getattr(panel, method)(drawer, context)
    return layout


def render_panels() -> list[Any]:
    """Our panels among the properties of renders: those that show settings which Cycles has too."""
    import bpy

    panels = [getattr(bpy.types, name) for name in dir(bpy.types) if name.startswith("NEURALGUIDE_PT_")]
    return [panel for panel in panels if getattr(panel, "bl_context", "") == "render"]


def draw_all(context: Any) -> Layout:
    whole = Layout()
    for panel in render_panels():
        part = draw(panel, context)
        whole.drawn += part.drawn
        whole.operators += part.operators
        whole.choices += part.choices
    return whole


@pytest.fixture
def preferences(blender: Any) -> Iterator[Any]:
    """The add-on's preferences, as of a user who has enabled it."""
    from addon.preferences import NeuralGuidePreferences

    entry = blender.context.preferences.addons.new()
    entry.module = NeuralGuidePreferences.bl_idname
    yield entry.preferences
    blender.context.preferences.addons.remove(entry)


def test_panels_come_and_go(blender: Any) -> None:
    import addon

    def panels() -> list[str]:
        return [name for name in dir(blender.types) if name.startswith("NEURALGUIDE_")]

    def with_engine() -> list[str]:
        return [
            panel.__name__
            for panel in blender.types.Panel.__subclasses__()
            if "NEURALGUIDE" in getattr(panel, "COMPAT_ENGINES", ())
        ]

    assert {"NEURALGUIDE_PT_sampling", "NEURALGUIDE_MATERIAL_PT_surface", "NEURALGUIDE_LIGHT_PT_light"} <= set(panels())
    # There is one panel of what Cycles draws too.
    assert "OBJECT_PT_visibility" not in with_engine() and "NEURALGUIDE_OBJECT_PT_visibility" in panels()
    assert "RENDER_PT_output" in with_engine() or "RENDER_PT_format" in with_engine()
    addon.unregister()
    assert panels() == [] and with_engine() == []
    assert not hasattr(blender.types.Scene, "neuralguide")
    addon.register()


def test_borrowed_panels_ask_for_our_engine_and_cycles_conditions(blender: Any) -> None:
    panel = blender.types.NEURALGUIDE_LIGHT_PT_light
    sun = blender.data.lights.new("Sun", "SUN")
    assert panel.poll(SimpleNamespace(engine="NEURALGUIDE", light=sun))
    assert not panel.poll(SimpleNamespace(engine="NEURALGUIDE", light=None))
    assert not panel.poll(SimpleNamespace(engine="CYCLES", light=sun))


def test_fast_gi_is_shown_where_cycles_settings_count(blender: Any) -> None:
    panel, scene = blender.types.NEURALGUIDE_PT_light_paths_fast_gi, blender.context.scene
    context = SimpleNamespace(engine="NEURALGUIDE", scene=scene)
    scene.world = blender.data.worlds.new("World")
    scene.cycles.fast_gi_method = "ADD"
    assert panel.poll(context)
    shown = {name for _, name in draw(panel, context).drawn}
    assert shown == {"use_fast_gi", "fast_gi_method", "ao_factor", "distance"}
    scene.cycles.fast_gi_method = "REPLACE"
    assert {name for _, name in draw(panel, context).drawn} == shown | {"ao_bounces", "ao_bounces_render"}
    scene.neuralguide.use_cycles_settings = False
    assert not panel.poll(context)


def test_panels_show_the_property_that_counts(blender: Any) -> None:
    """Cycles' own while the scene follows it, ours where a script has set it or the switch is off; each once."""
    from addon.shared_settings import SHARED_SETTINGS

    context, scene = blender.context, blender.context.scene
    ours = scene.neuralguide

    def shown(layout: Layout) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, (owner_name, their_name) in SHARED_SETTINGS.items():
            theirs = getattr(scene, owner_name)
            owners = [
                owner
                for owner, drawn in layout.drawn
                if (owner == ours and drawn == name) or (owner == theirs and drawn == their_name)
            ]
            assert len(owners) == 1, (name, owners)
            found[name] = owners[0]
        return found

    following = draw_all(context)
    assert all(owner != ours for owner in shown(following).values())
    assert (scene.render, "threads") in following.drawn and (scene.render, "threads_mode") in following.drawn
    assert following.operators.count("neuralguide.follow_cycles_setting") == 0

    ours.clamp_indirect, ours.threads = 3.0, 2
    one_set = draw_all(context)
    assert [name for name, owner in shown(one_set).items() if owner == ours] == ["clamp_indirect"]
    assert (ours, "threads") in one_set.drawn and (scene.render, "threads") not in one_set.drawn
    assert one_set.operators.count("neuralguide.follow_cycles_setting") == 2
    assert "neuralguide.copy_cycles_settings" not in one_set.operators

    ours.use_cycles_settings = False
    separate = draw_all(context)
    assert all(owner == ours for owner in shown(separate).values())
    assert "neuralguide.copy_cycles_settings" in separate.operators


def test_settings_for_experiments_are_shown_where_the_preferences_ask_for_it(blender: Any) -> None:
    from addon import ui
    from addon.declared_settings import SCENE_SETTINGS
    from addon.preferences import NeuralGuidePreferences

    context, scene = blender.context, blender.context.scene
    scene.render.engine = "NEURALGUIDE"
    experiment = scene.neuralguide.experiment
    panel = ui.NEURALGUIDE_PT_experiments
    drawn = [name for owner, name in draw(panel, context).drawn if owner == experiment]
    assert drawn == [setting.name for setting in SCENE_SETTINGS.values() if setting.is_experiment]
    assert panel in render_panels()
    others = [owner for part in render_panels() if part is not panel for owner, _ in draw(part, context).drawn]
    assert others and experiment not in others
    assert not panel.poll(context)
    entry = context.preferences.addons.new()
    entry.module = NeuralGuidePreferences.bl_idname
    try:
        assert not panel.poll(context)
        entry.preferences.show_experiments = True
        assert panel.poll(context)
        scene.render.engine = "CYCLES"
        assert not panel.poll(context)
    finally:
        context.preferences.addons.remove(entry)


def test_artists_choose_automatic_or_off_and_keep_the_method_of_a_file(preferences: Any, blender: Any) -> None:
    from addon import guiding_panels

    ours, panel = blender.context.scene.neuralguide, guiding_panels.NEURALGUIDE_PT_guiding
    layout = draw(panel, blender.context)
    assert layout.choices == ["AUTO", "OFF"] and "Automatic" in layout.texts
    assert (ours, "guiding_method") not in layout.drawn
    ours.guiding_method = "VMM_RIS"  # a script, or a file
    layout = draw(panel, blender.context)
    assert layout.choices == ["AUTO", "OFF", "VMM_RIS"] and "Mixtures, Resampled" in layout.texts
    assert ours.guiding_method == "VMM_RIS"
    preferences.show_experiments = True
    layout = draw(panel, blender.context)
    assert (ours, "guiding_method") in layout.drawn and layout.choices == []


def test_viewport_and_render_are_apart_as_in_cycles(blender: Any) -> None:
    from addon import sampling_panels

    scene = blender.context.scene
    cycles = scene.cycles
    viewport = draw(sampling_panels.NEURALGUIDE_PT_sampling_viewport, blender.context)
    assert viewport.drawn == [
        (cycles, name)
        for name in (
            "use_preview_adaptive_sampling", "preview_adaptive_threshold", "preview_samples",
            "preview_adaptive_min_samples",
        )
    ]  # fmt: skip
    assert viewport.popovers == ["CYCLES_PT_viewport_sampling_presets"]
    final = draw(sampling_panels.NEURALGUIDE_PT_sampling_render, blender.context)
    assert final.drawn == [
        (cycles, name)
        for name in ("use_adaptive_sampling", "adaptive_threshold", "samples", "adaptive_min_samples", "time_limit")
    ]
    assert final.popovers == ["CYCLES_PT_sampling_presets"]
    assert "Max Samples" in viewport.texts and "Max Samples" in final.texts
    cycles.use_preview_adaptive_sampling = False
    viewport = draw(sampling_panels.NEURALGUIDE_PT_sampling_viewport, blender.context)
    assert (cycles, "preview_adaptive_min_samples") not in viewport.drawn and "Samples" in viewport.texts
    denoised = draw(sampling_panels.NEURALGUIDE_PT_sampling_viewport_denoise, blender.context)
    assert [name for _, name in denoised.drawn] == [
        "use_preview_denoising", "preview_denoising_input_passes", "preview_denoising_prefilter",
        "preview_denoising_quality", "preview_denoising_start_sample",
    ]  # fmt: skip
    denoised = draw(sampling_panels.NEURALGUIDE_PT_sampling_render_denoise, blender.context)
    assert (scene.neuralguide, "denoised_threshold") in denoised.drawn
    # Presets set what Cycles has: where that does not count they would do nothing.
    scene.neuralguide.use_cycles_settings = False
    final = draw(sampling_panels.NEURALGUIDE_PT_sampling_render, blender.context)
    assert final.popovers == [] and (scene.neuralguide, "adaptive_threshold") in final.drawn


def test_subpanels_follow_their_parents_in_cycles_order(blender: Any) -> None:
    from addon import ui

    labels = [panel.bl_label for panel in render_panels_in_order(ui)]
    order = ["Sampling", "Viewport", "Denoise", "Render", "Denoise", "Light Paths", "Simplify", "Motion Blur", "Film"]
    assert [label for label in labels if label in order][:5] == order[:5]
    places = [labels.index(label) for label in order[5:]]
    assert places == sorted(places)


def render_panels_in_order(ui: Any) -> list[Any]:
    """As registered, which is the order of the properties editor."""
    return [panel for panel in ui.CLASSES if panel in render_panels()]


def test_simplify_is_shown_and_grease_pencil_is_not(blender: Any) -> None:
    from addon import simplify_panels

    render = blender.context.scene.render
    drawn = [entry for panel in simplify_panels.PANELS for entry in draw(panel, blender.context).drawn]
    assert {(render, "use_simplify"), (render, "simplify_subdivision"), (render, "simplify_subdivision_render")} <= {
        *drawn
    }
    shown = [
        panel
        for panel in blender.types.Panel.__subclasses__()
        if "NEURALGUIDE" in getattr(panel, "COMPAT_ENGINES", ()) or panel.__name__.startswith("NEURALGUIDE")
    ]
    names = [f"{panel.__name__} {getattr(panel, 'bl_label', '')}".lower() for panel in shown]
    assert names and not [name for name in names if "gpencil" in name or "grease" in name]


def test_every_pass_that_can_be_written_has_a_box(blender: Any) -> None:
    from addon import passes, ui

    layer = blender.context.view_layer
    drawn = draw(ui.NEURALGUIDE_PT_passes, blender.context).drawn
    drawn += draw(ui.NEURALGUIDE_PT_passes_cryptomatte, blender.context).drawn
    for owner, switches in (
        (layer, [*passes.LIGHT, *(name for name, is_ours, _ in passes.OPTIONAL if not is_ours)]),
        (layer.neuralguide, [name for name, is_ours, _ in passes.OPTIONAL if is_ours]),
        (layer.cycles, [*passes.CYCLES_LIGHT, "denoising_store_passes"]),
        # From Blender 5.3 on.
        (layer.cycles, [name for name in ("denoising_store_motion_passes",) if hasattr(layer.cycles, name)]),
        (layer, [name for name, _ in passes.MATTES]),
    ):
        assert not [name for name in switches if (owner, name) not in drawn]


def test_texture_memory_says_when_it_is_automatic(blender: Any) -> None:
    from addon import ui

    ours = blender.context.scene.neuralguide
    assert "Automatic" in draw(ui.NEURALGUIDE_PT_performance, blender.context).texts
    ours.texture_memory = 512
    assert "Automatic" not in draw(ui.NEURALGUIDE_PT_performance, blender.context).texts


def test_every_setting_of_a_user_is_in_a_panel(preferences: Any, blender: Any) -> None:
    """But for threads, which stand there once they are set: else Blender's own number does."""
    from addon.declared_settings import SCENE_SETTINGS

    scene = blender.context.scene
    scene.neuralguide.use_cycles_settings, scene.neuralguide.threads = False, 2
    preferences.show_experiments = True
    drawn = {name for owner, name in draw_all(blender.context).drawn if owner == scene.neuralguide}
    assert drawn == {setting.name for setting in SCENE_SETTINGS.values() if not setting.is_experiment}


def test_layer_samples_are_offered_where_a_layer_has_its_own(blender: Any) -> None:
    from addon import sampling_panels

    scene = blender.context.scene
    panel = sampling_panels.NEURALGUIDE_PT_sampling_advanced
    assert (scene.cycles, "use_layer_samples") not in draw(panel, blender.context).drawn
    scene.view_layers[0].samples = 5
    assert (scene.cycles, "use_layer_samples") in draw(panel, blender.context).drawn


def test_motion_blur_can_be_chosen(blender: Any) -> None:
    from addon import ui

    drawn = [
        name
        for panel in (ui.NEURALGUIDE_PT_motion_blur, ui.NEURALGUIDE_PT_motion_blur_curve)
        for _owner, name in draw(panel, blender.context).drawn
    ]
    assert drawn == [
        "use_motion_blur", "motion_blur_position", "motion_blur_shutter", "rolling_shutter_type",
        "rolling_shutter_duration", "motion_blur_shutter_curve",
    ]  # fmt: skip
    assert {"NEURALGUIDE_PT_motion_blur", "NEURALGUIDE_OBJECT_PT_motion_blur"} <= set(dir(blender.types))
    cube, lamp = SimpleNamespace(type="MESH"), SimpleNamespace(type="LIGHT", instance_type="NONE")
    poll = blender.types.NEURALGUIDE_OBJECT_PT_motion_blur.poll
    assert poll(SimpleNamespace(engine="NEURALGUIDE", object=cube))
    assert not poll(SimpleNamespace(engine="NEURALGUIDE", object=lamp))
    assert not poll(SimpleNamespace(engine="CYCLES", object=cube))
