# SPDX-License-Identifier: GPL-3.0-or-later
"""All settings of a scene: those of the engine, and those that the add-on alone reads; needs no Blender.

A user's settings are properties of `scene.neuralguide`, those for experiments of `scene.neuralguide.experiment`.
"""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any

from engine.settings import EXPERIMENT_SECTIONS, MAX_SAMPLES, SETTINGS, Setting

#: Sections of a user's settings, as panels show them.
SECTIONS = (
    "Sampling", "Viewport", "Denoising", "Lights", "Advanced", "Guiding", "Trial and Training", "Learned Field",
    "Light Paths", "Film", "Performance",
)  # fmt: skip
#: The property of `scene.neuralguide` that holds the settings for experiments.
EXPERIMENT = "experiment"

_ADDON_SETTINGS = (
    Setting(
        "use_cycles_settings", True, "Use Cycles' Settings",
        "Samples, light paths, film and what else Cycles has too are those of the scene's Cycles settings."
        " Off: NeuralGuide has settings of its own, which Cycles does not see",
        "Sampling",
    ),
    Setting(
        "use_preview_adaptive_sampling", True, "Viewport Noise Threshold",
        "Stop sampling pixels of a viewport whose noise is below a threshold", "Viewport",
    ),
    Setting(
        "preview_adaptive_threshold", 0.1, "Viewport Threshold",
        "Noise that a pixel of a viewport may be left with (0 = by the number of samples)", "Viewport", minimum=0,
        maximum=1,
    ),
    Setting(
        "preview_samples", 1024, "Viewport Samples", "Paths to trace for every pixel of a viewport; 0: without end",
        "Viewport", minimum=0, maximum=MAX_SAMPLES,
    ),
    Setting(
        "preview_adaptive_min_samples", 0, "Viewport Min Samples",
        "Samples that every pixel of a viewport gets (0 = by the threshold)", "Viewport", minimum=0, maximum=4096,
    ),
    Setting(
        "denoise_over_time", False, "Over Time",
        "Once an animation is rendered, denoise its frames together, so that they flicker less. They must be saved as"
        " OpenEXR MultiLayer; the passes that this needs are added. Copies go to the folder denoised beside the frames",
        "Denoising",
    ),
    Setting(
        "use_preview_denoising", False, "Viewport Denoise", "Take the noise out of what a viewport shows", "Viewport",
    ),
    Setting(
        "preview_denoising_input_passes", "RGB_ALBEDO", "Viewport Passes",
        "What the denoiser of a viewport tells detail from noise by, besides the picture", "Viewport",
        choices=SETTINGS["denoising_input_passes"].choices,
    ),
    Setting(
        "preview_denoising_prefilter", "FAST", "Viewport Prefilter",
        "What a viewport does with albedo and normal, which have noise too", "Viewport",
        choices=SETTINGS["denoising_prefilter"].choices,
    ),
    Setting(
        "preview_denoising_quality", "BALANCED", "Viewport Quality", "How much time the denoiser of a viewport takes",
        "Viewport", choices=SETTINGS["denoising_quality"].choices,
    ),
    Setting(
        "preview_denoising_start_sample", 1, "Viewport Start Sample",
        "Samples a pixel before which a viewport is not denoised", "Viewport", minimum=0, maximum=MAX_SAMPLES,
    ),
    Setting(
        "sequence_field", False, "Sequence Field",
        "Train a neural mixture once for all frames from the scene's first to its last one, when the first"
        " of them is rendered, instead of anew in every frame. It tells the frames apart by the Mixture's Encoding"
        " (experiment.mixture_u)",
        "Trial and Training",
    ),
    Setting(
        "sequence_samples", 256, "Sequence Samples",
        "Paths traced for every pixel (of large pictures: of a smaller copy) to train the field, of all"
        " frames together: up to 32 spread over the sequence. They are no part of any picture",
        "Trial and Training", minimum=1, maximum=MAX_SAMPLES,
    ),
    Setting(
        "keep_learned", True, "Keep Learned",
        "A render starts from what the last one has learned, as long as lights, materials and geometry stay the same."
        " The noise then differs from render to render",
        "Guiding",
    ),
    Setting(
        "field_path", "", "File",
        "Renders start from what was learned and saved in this file: another view, another size, or on another machine",
        "Learned Field",
    ),
    Setting(
        "save_field", False, "Save After Render",
        "Save what was learned to the file after every render, in place of what was there",
        "Learned Field",
    ),
    Setting(
        "use_animated_seed", False, "Animate Seed",
        "Use another seed in every frame, so that noise does not stand still in an animation", "Advanced",
    ),
    Setting(
        "keep_unfinished", True, "Keep Unfinished Frames",
        "Keep a frame next to its file every minute while it is rendered, and when it is cancelled. Rendered again, it"
        " goes on from there, even after a crash. Frames that take less than a minute are not kept; the file goes once"
        " the frame is finished",
        "Performance",
    ),
    Setting(
        "keep_film", False, "Keep Finished Films",
        "Keep the film of a finished frame next to its file too, so that the command line can give it more samples"
        " (--add-samples), or merge it with others (--merge)",
        "Performance",
    ),
    Setting(
        "film_exposure", 1.0, "Exposure", "Brightness of the film: multiplies every colour pass", "Film", minimum=0,
    ),
)  # fmt: skip

#: By name, in the order of the sections.
SCENE_SETTINGS: dict[str, Setting] = {
    setting.name: setting
    for section in (*SECTIONS, *EXPERIMENT_SECTIONS)
    for setting in (*SETTINGS.values(), *_ADDON_SETTINGS)
    if setting.section == section
}


def scene_default(setting: Setting) -> Any:
    """What a scene has where nobody has set anything."""
    return setting.default if setting.scene_default is None else setting.scene_default


def settings_of(section: str) -> list[Setting]:
    """Settings of a section, in the order of its panel."""
    return [setting for setting in SCENE_SETTINGS.values() if setting.section == section]


def setting_owner(scene: Any, name: str) -> Any:
    """The group of a scene's properties that holds the setting called `name`."""
    ours = scene.neuralguide
    return getattr(ours, EXPERIMENT) if SCENE_SETTINGS[name].is_experiment else ours


def parse_setting(text: str) -> tuple[str, Any]:
    """Name and value of `name=value`, where `experiment.name` may stand for a name as well.

    Raises
    ------
    ValueError
        Naming the setting and what to choose.
    """
    full_name, equals, value = text.partition("=")
    group, _, name = full_name.strip().rpartition(".")
    setting = SCENE_SETTINGS.get(name)
    if setting is None or group not in ("", EXPERIMENT if setting.is_experiment else ""):
        close = get_close_matches(name, SCENE_SETTINGS, 3) or list(SCENE_SETTINGS)
        raise ValueError(f"no setting {full_name.strip()!r}; there are {', '.join(close)}")
    if not equals:
        raise ValueError(f"{name}: write {name}=VALUE")
    found = _parse_value(setting, value.strip())
    setting.check(found)
    return name, found


def _parse_value(setting: Setting, text: str) -> Any:
    kind = type(setting.default)
    if kind is bool:
        if text.lower() not in ("on", "off", "true", "false", "1", "0"):
            raise ValueError(f"{setting.name} is {text!r}: choose on or off")
        return text.lower() in ("on", "true", "1")
    try:
        return kind(text)
    except ValueError:
        form = "whole number" if kind is int else "number"
        raise ValueError(f"{setting.name} is {text!r}: choose a {form}, {setting.limits}") from None
