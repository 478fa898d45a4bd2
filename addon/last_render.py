# SPDX-License-Identifier: GPL-3.0-or-later
"""What the last render of a scene had to say: in a panel, with a way to the objects that it names."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING

import bpy

from . import engine, kept_frames
from .progress import format_duration

if TYPE_CHECKING:
    from engine.scene.description import Notice

    from .engine import Outcome

#: Words before a name in subjects of notices.
_KINDS = ("object ", "light ", "mesh ", "image ")
#: Notices that are shown at most: Blender draws the panel again with every move of the mouse.
_MOST_NOTICES = 30
#: Width of a letter in panels at a scale of 1 [pixels], about.
_LETTER_WIDTH = 7.0


def last_outcomes(scene: bpy.types.Scene) -> list[Outcome]:
    """How the last render of a scene ended, a view layer each; empty if there was none."""
    found: dict[str, Outcome] = {}
    for outcome in reversed(engine.outcomes):
        if outcome.scene != scene.name:
            continue
        if outcome.view_layer in found or any(outcome.frame != other.frame for other in found.values()):
            break
        found[outcome.view_layer] = outcome
    return list(reversed(found.values()))


def last_notices(scene: bpy.types.Scene) -> list[Notice]:
    """What the last render of a scene said, each notice once."""
    return list(dict.fromkeys(notice for outcome in last_outcomes(scene) for notice in outcome.notices))


def guiding_sentence(scene: bpy.types.Scene) -> str:
    """What guiding came to in the last render of a scene, '' if there was none that was guided."""
    sentences = [outcome.report.guiding.sentence for outcome in last_outcomes(scene) if outcome.report is not None]
    return next((sentence for sentence in sentences if sentence), "")


def cache_sentence(scene: bpy.types.Scene) -> str:
    """What ending paths in a radiance cache came to in the last render of a scene, '' where it was unbiased."""
    sentences = [one.report.guiding.cache_sentence for one in last_outcomes(scene) if one.report is not None]
    return next((sentence for sentence in sentences if sentence), "")


def denoised_sentence(scene: bpy.types.Scene) -> str:
    """What the last render of a scene estimated of its denoised picture, '' where it estimated nothing."""
    sentences = [one.report.denoised_sentence for one in last_outcomes(scene) if one.report is not None]
    return next((sentence for sentence in sentences if sentence), "")


def objects_of(scene: bpy.types.Scene, subject: str) -> list[bpy.types.Object]:
    """Objects of a scene that the subject of a notice means.

    Parameters
    ----------
    subject : str
        Names from the whole to the part, such as "Cube / Glass / Wave Texture": an object, a light's or mesh's data, or
        a material comes first.

    Returns
    -------
    list of Object
        Empty where the subject is no object, nor anything that an object has.
    """
    name = subject.split(" / ")[0]
    for kind in _KINDS:
        name = name.removeprefix(kind)
    item = scene.objects.get(name)
    if item is not None:
        return [item]
    return [
        item
        for item in scene.objects
        if (item.data is not None and item.data.name == name)
        or any(slot.material is not None and slot.material.name == name for slot in item.material_slots)
    ]


def wrapped(text: str, region: bpy.types.Region | None, scale: float = 1.0) -> list[str]:
    """A text in lines that a region has room for; panels cut what is longer."""
    width = 60 if region is None else max(int(region.width / (_LETTER_WIDTH * max(scale, 0.1))) - 6, 20)
    return textwrap.wrap(text, width)


def draw_text(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "NONE") -> None:
    """A text of as many labels as it has lines."""
    scale = context.preferences.system.ui_scale
    column = layout.column()
    column.scale_y = 0.8
    for line in wrapped(text, context.region, scale):
        column.label(text=line, icon=icon)
        icon = "NONE" if icon == "NONE" else "BLANK1"


def _headlines(scene: bpy.types.Scene) -> Iterator[tuple[str, str]]:
    """What to say of each view layer, and an icon."""
    for outcome in last_outcomes(scene):
        name, report = outcome.view_layer, outcome.report
        if outcome.status == "FAILED":
            yield f"{name}: {outcome.message}", "ERROR"
        elif report is not None:
            kept = f", {outcome.resumed} of them kept from before" if outcome.resumed else ""
            yield f"{name}: {report.sample_count:.4g} samples in {format_duration(report.render_seconds)}{kept}", "NONE"
        else:
            yield f"{name}: cancelled", "NONE"


def _draw_notice(layout: bpy.types.UILayout, context: bpy.types.Context, notice: Notice) -> None:
    row = layout.row()
    row.label(text=notice.subject, icon="INFO")
    if objects_of(context.scene, notice.subject):
        row.operator("neuralguide.select_subject", text="", icon="RESTRICT_SELECT_OFF").subject = notice.subject
    draw_text(layout, context, f"{notice.problem}; {notice.fallback}")


class NEURALGUIDE_OT_select_subject(bpy.types.Operator):  # noqa: N801 (Blender's convention)
    """Select the objects that this message is about, and make the first of them active"""

    bl_idname = "neuralguide.select_subject"
    bl_label = "Select"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}  # noqa: RUF012

    subject: bpy.props.StringProperty(name="Subject")  # type: ignore[valid-type]

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Select what the view layer shows of them."""
        found = [item for item in objects_of(context.scene, self.subject) if item.visible_get()]
        if not found:
            self.report({"WARNING"}, f"{self.subject}: nothing of that name is visible in this view layer")
            return {"CANCELLED"}
        for item in context.view_layer.objects:
            item.select_set(item in found)
        context.view_layer.objects.active = found[0]
        return {"FINISHED"}


class NEURALGUIDE_PT_last_render(bpy.types.Panel):  # noqa: N801
    """How the last render ended, and what looks different from what the scene asks for."""

    bl_label = "Last Render"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with our engine, once something was rendered."""
        return context.engine == engine.NeuralGuideRenderEngine.bl_idname and bool(last_outcomes(context.scene))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw."""
        layout, scene = self.layout, context.scene
        for text, icon in _headlines(scene):
            draw_text(layout, context, text, icon)
        for sentence in (cache_sentence(scene), denoised_sentence(scene)):
            if sentence:
                draw_text(layout, context, sentence)
        kept = kept_frames.kept_of(scene)
        if kept is not None:
            box = layout.box()
            draw_text(box, context, f"Frame {kept.frame} goes on when it is rendered again: {kept.path}", "FILE_TICK")
            if kept.frame == scene.frame_current:
                box.operator("neuralguide.discard_unfinished", icon="TRASH")
        notices = last_notices(scene)
        if not notices:
            layout.label(text="Everything in the scene is rendered as it asks for", icon="CHECKMARK")
        for notice in notices[:_MOST_NOTICES]:
            _draw_notice(layout.box(), context, notice)
        if len(notices) > _MOST_NOTICES:
            layout.label(text=f"{len(notices) - _MOST_NOTICES} more messages are in the console")


_classes = (NEURALGUIDE_OT_select_subject, NEURALGUIDE_PT_last_render)


def register() -> None:
    """Register the panel and its operator."""
    for cls in _classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister them."""
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
