# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels: they come and go with the add-on, and show the very properties that count."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from tests.helpers.blender_scenes import stand_in


class Layout:
    """Notes what a panel draws: owners and names of properties, and operators."""

    def __init__(self) -> None:
        self.drawn: list[tuple[Any, str]] = []
        self.operators: list[str] = []
        self.active = self.enabled = True

    def prop(self, owner: Any, name: str, **_look: Any) -> None:
        getattr(owner, name)
        self.drawn.append((owner, name))

    def column(self, **_look: Any) -> Layout:
        return self

    row = box = column

    def label(self, **_look: Any) -> None:
        pass

    def template_curve_mapping(self, owner: Any, name: str) -> None:
        self.prop(owner, name)

    def operator(self, name: str, **_look: Any) -> Any:
        self.operators.append(name)
        return SimpleNamespace()


def draw(panel: Any, context: Any) -> Layout:
    """What a panel of ours draws."""
    layout = Layout()
    drawer = stand_in(panel, layout)
    for method in ("draw_header", "draw"):
        if hasattr(panel, method):
            getattr(panel, method)(drawer, context)
    return layout


def render_panels() -> list[Any]:
    """Our panels among the properties of renders: those that show settings which Cycles has too."""
    import bpy

    panels = [getattr(bpy.types, name) for name in dir(bpy.types) if name.startswith("NEURALGUIDE_PT_")]
    return [panel for panel in panels if panel.bl_context == "render"]


def draw_all(context: Any) -> Layout:
    whole = Layout()
    for panel in render_panels():
        part = draw(panel, context)
        whole.drawn += part.drawn
        whole.operators += part.operators
    return whole


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
    # Of what Cycles draws too there is one panel.
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


def test_every_setting_of_a_user_is_in_a_panel(blender: Any) -> None:
    """But for threads, which stand there once they are set: else Blender's own number does."""
    from addon.declared_settings import SCENE_SETTINGS

    scene = blender.context.scene
    scene.neuralguide.use_cycles_settings, scene.neuralguide.threads = False, 2
    drawn = {name for owner, name in draw_all(blender.context).drawn if owner == scene.neuralguide}
    assert drawn == {setting.name for setting in SCENE_SETTINGS.values() if not setting.is_experiment}


def test_layer_samples_are_offered_where_a_layer_has_its_own(blender: Any) -> None:
    from addon import ui

    scene = blender.context.scene
    assert (scene.cycles, "use_layer_samples") not in draw(ui.NEURALGUIDE_PT_sampling_advanced, blender.context).drawn
    scene.view_layers[0].samples = 5
    assert (scene.cycles, "use_layer_samples") in draw(ui.NEURALGUIDE_PT_sampling_advanced, blender.context).drawn


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
