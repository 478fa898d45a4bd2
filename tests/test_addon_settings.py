# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings, operators and panels: the names scripts depend on, and what Cycles' settings become."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import pytest

from engine.settings import RenderSettings


def test_scene_settings_have_the_engine_s_names_and_defaults(blender: Any) -> None:
    from addon.properties import render_settings

    settings = blender.context.scene.neuralguide
    # Programs say what they want; a user of Blender gets what pays.
    expected = dataclasses.asdict(RenderSettings(guiding_method="AUTO"))
    for name, value in expected.items():
        assert getattr(settings, name) == pytest.approx(value), name
    made = dataclasses.asdict(render_settings(blender.context.scene))
    for name, value in expected.items():
        assert made[name] == pytest.approx(value) if isinstance(value, float) else made[name] == value, name


def test_cycles_settings_are_taken_over(blender: Any) -> None:
    scene = blender.context.scene
    cycles, ours = scene.cycles, scene.neuralguide
    cycles.samples, cycles.seed, cycles.time_limit = 77, 5, 12.5
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 9, 8, 7
    cycles.transmission_bounces, cycles.transparent_max_bounces = 6, 5
    cycles.sample_clamp_direct, cycles.sample_clamp_indirect = 3.0, 2.0
    cycles.blur_glossy, cycles.caustics_reflective, cycles.caustics_refractive = 0.25, False, True
    cycles.pixel_filter_type, cycles.filter_width, cycles.film_exposure = "GAUSSIAN", 2.5, 1.75
    cycles.use_adaptive_sampling, cycles.use_denoising, cycles.use_guiding = False, False, True
    scene.render.film_transparent = True
    assert blender.ops.neuralguide.copy_cycles_settings() == {"FINISHED"}
    expected = dict(
        samples=77, seed=5, time_limit=12.5, max_bounces=9, diffuse_bounces=8, glossy_bounces=7,
        transmission_bounces=6, transparent_max_bounces=5, clamp_direct=3.0, clamp_indirect=2.0, filter_glossy=0.25,
        use_caustics_reflective=False, use_caustics_refractive=True, pixel_filter="GAUSSIAN", filter_width=2.5,
        film_exposure=1.75, film_transparent=True,
    )  # fmt: skip
    assert {name: getattr(ours, name) for name in expected} == expected
    from addon.properties import copy_cycles_settings

    assert copy_cycles_settings(scene) == ["path guiding"]
    # Blender's own, and read as it is.
    scene.render.use_motion_blur = True
    assert copy_cycles_settings(scene) == ["path guiding"]
    cycles.rolling_shutter_type = "TOP"
    assert copy_cycles_settings(scene) == ["path guiding"]


def test_without_cycles_the_reason_is_given(blender: Any) -> None:
    from addon.properties import copy_cycles_settings

    with pytest.raises(ValueError, match="enable the Cycles add-on"):
        copy_cycles_settings(SimpleNamespace(neuralguide=None))


def test_an_animated_seed_differs_between_frames_and_repeats(blender: Any) -> None:
    from addon.properties import render_settings

    scene = blender.context.scene
    scene.neuralguide.use_animated_seed = True

    def seed(frame: int) -> int:
        scene.frame_set(frame)
        return render_settings(scene).seed

    seeds = [seed(frame) for frame in range(1, 20)]
    assert len(set(seeds)) == len(seeds)
    assert seed(1) == seeds[0]


def test_threads_follow_the_scene_s_fixed_number(blender: Any) -> None:
    from addon.properties import render_settings

    scene = blender.context.scene
    scene.render.threads_mode, scene.render.threads = "FIXED", 3
    assert render_settings(scene).threads == 3
    scene.neuralguide.threads = 1
    assert render_settings(scene).threads == 1


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


def test_motion_blur_can_be_chosen(blender: Any) -> None:
    from addon import ui

    drawn: list[str] = []

    class Layout:
        active = True

        def prop(self, owner: Any, name: str, text: str = "") -> None:
            getattr(owner, name)
            drawn.append(name)

        def column(self, align: bool = False) -> Any:
            return self

        row = column

        def template_curve_mapping(self, owner: Any, name: str) -> None:
            self.prop(owner, name)

        def operator(self, name: str, icon: str, text: str) -> Any:
            assert name == "render.shutter_curve_preset"
            return SimpleNamespace()

    for panel in (ui.NEURALGUIDE_PT_motion_blur, ui.NEURALGUIDE_PT_motion_blur_curve):
        drawer = type("Drawer", (ui._RenderPanel,), {"layout": Layout()})()
        for method in ("draw_header", "draw"):
            if hasattr(panel, method):
                getattr(panel, method)(drawer, blender.context)
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
