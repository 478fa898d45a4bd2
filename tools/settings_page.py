# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m tools.settings_page` writes docs/settings.md from the declarations of the settings."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from addon.declared_settings import EXPERIMENT, SECTIONS, scene_default, settings_of
from addon.shared_settings import SHARED_SETTINGS
from engine.settings import EXPERIMENT_SECTIONS, Setting

PAGE = Path(__file__).resolve().parents[1] / "docs" / "settings.md"

_HEAD = """\
# Settings

You need to set nothing. What Cycles has too is read from the scene's Cycles settings. The rest has defaults that
were measured. `python -m tools.settings_page` writes this page; the settings are declared in `engine/settings.py`
and `addon/declared_settings.py`.

## Whose settings count

- The scene's Cycles settings count for what Cycles has too. The panels show these very properties.
- A property of `scene.neuralguide` that a script sets counts before Cycles'. The panel shows it with a ✕, which
  leads back to Cycles' setting. A script goes back with `scene.neuralguide.property_unset("samples")`.
- With *Use Cycles' Settings* (`use_cycles_settings`) off all of ours count, and Cycles' do not.
  `bpy.ops.neuralguide.copy_cycles_settings()` sets ours to what Cycles' are now.
- Where the Cycles add-on is off ours count. Their defaults are Cycles' defaults.
- Files keep their pictures: *Use Cycles' Settings* is off in a file that an older version saved with settings of ours.
  Settings under former names are moved to `scene.neuralguide.experiment`.
- What Cycles' settings ask for and NeuralGuide does not have (the GPU and others) is
  said once a render.

## How to set them

- In panels of the render properties. The panel *Experiments* is there if the add-on's preferences say *Show
  settings for experiments*.
- By a script: `scene.neuralguide.guiding_method = 'OFF'`, `scene.neuralguide.experiment.strata = 8`.
- On the command line: `python -m addon scene.blend --set guiding_method=OFF --set experiment.strata=8 -f 1`. The
  name alone, `strata=8`, will do.

Panels keep values within their limits. The command line and the render refuse a value that makes no sense; they
name the setting and say what to choose instead.

## When the picture is the same

The image is a function of scene and settings, whatever the number of threads, unless what is learned depends on
time. It does under a time limit, with networks, and with `'AUTO'`, whose comparisons read the clock. With
`deterministic` networks and `'AUTO'` do not depend on time.

A guided render that starts from what was learned before has other noise than one that learns anew. Turn `keep_learned`
off, or `deterministic` on, to have the same image each time.
"""

#: Said under a section's table.
_NOTES = {
    "Sampling": """\
With `spectral` `'ON'` colours have smooth spectra everywhere and white light is D65. Reflections of colours in
colours differ a little from those of red, green and blue ([figures](results/wavelengths.md)).
""",
    "Guiding": """\
Panels offer `'AUTO'` and `'OFF'`; the other methods where the add-on's preferences show settings for experiments, or a
file has one. Methods from `'VMM'` to `'FLOW'` draw directions from what was learned. Those that end in `_RIS` weigh
several directions and take one (they resample). Networks do not pay on a processor at equal time
([figures](results/do-networks-pay.md)).
""",
    "Trial and Training": """\
`sequence_field` is for animations in which lights move and can be found by guiding only. It hardly pays in frames
between those of training if much changes from one of these to the next ([figures](results/sequences.md)).

- It needs a neural mixture: `guiding_method` or `experiment.source_field` is `'NPM'`, `'NPM_PRODUCT'` or `'NASG'`.
  Other methods and scenes in which nothing is animated do without it, and say so.
- With the first frame up to 32 frames are exported and visited, for `sequence_samples` samples a pixel in all, which
  are in no picture. `experiment.mixture_u` is how the network tells frames apart.
- Later frames of the same process use what was learned. It is trained anew for another file, other settings, or a
  frame that was changed since. Each view layer has a field of its own.
""",
    "Learned Field": """\
What a render learns is mixtures, how often to guide and to sample lights, and the table of `'TABLE_RIS'`. Networks and
SD-trees are learned anew. A render that starts from it is guided from its first sample, and goes on learning
([figures](results/learned-fields.md)).

- It fits any view, size, number of samples and method, as long as lights, materials, geometry and the world are the
  same. Otherwise, or where guiding did not pay in the earlier render, the render learns anew.
- The image is unbiased whatever a file holds, and has noise of its own.
- With `keep_learned` each view layer goes on from its last render until another file is opened. With `deterministic` a
  render uses a file only.
- `save_field` replaces the file after each render by what the last view layer has learned. A file that cannot be read
  is left alone.
- `bpy.ops.neuralguide.save_learned_field(filepath=...)` and `load_learned_field` are the panel's buttons.
- On the command line: `python -m addon scene.blend --set save_field=on --field scene.ngfield -f 1`, then
  `python -m addon scene.blend --field scene.ngfield -f 1`.
""",
    "Learning": """\
`guiding_probability` is where regions begin if `learn_guiding_probability` is on, and what all of them have if it
is off.
""",
    "Candidates": """\
These settings are for methods that resample. With `'ORCA'` a surface has as many candidates as pay for themselves;
[decisions](decisions/candidates.md) say why it is the default.
""",
    "Neural Mixtures": """\
These settings are for `'NPM'`, `'NPM_PRODUCT'` and `'NASG'`, as a method or as a source. `mixture_target` is for
`'NASG'` alone. [Decisions](decisions/trees-and-neural-mixtures.md) say why the preset is `'COMPACT'`.
""",
    "Time and Wavelengths": """\
The fourth dimension is called u ([glossary](glossary.md)). Where lights move while the shutter is open,
`guiding_method` `'NPM'` with `mixture_u` `'PLANES'` learns where they are when: 2.7 times less error than unguided
paths in three such scenes at equal samples, and 3.6 times in 8 `strata`. Both take many times as long
([figures](results/motion.md)). Both see the wavelength instead where nothing moves and a material disperses
([figures](results/wavelengths.md)).

A stratum needs 8 samples a pixel; a render of fewer has fewer strata.
""",
}

_ELSEWHERE = """\
## What is set elsewhere

- **Dispersion** is what the Principled BSDF says from Blender 5.3 on. For other nodes and older Blenders it is a panel
  of materials whose Glass, Refraction or Principled node transmits: an Abbe number or Cauchy's coefficients
  (`material.neuralguide.dispersion`, `abbe_number`, `cauchy_a`, `cauchy_b`). The node's IOR stays that of the d line,
  587.6 nm.
- **Motion blur** is Blender's own, with each object's switch and steps where Cycles has them, and Cycles' rolling
  shutter.
- **Threads** are Blender's own (*Performance*) unless `threads` is set.
- **Passes** are chosen by view layer. Blender's are Combined, Depth, Position, Normal, indices, Emission, Environment,
  Ambient Occlusion, Shadow Catcher, light taken apart, light groups, Mist, UV, Vector, Shader AOVs and Cryptomatte (a
  multilayer EXR of 32 bits; turn *Interleave* on for programs that read one part only). Those of
  `view_layer.neuralguide` are Albedo, Sample Count, Variance, Candidate Count and Guiding Benefit.
- **View layers** have Blender's own rules: *Filter*, *Override*, holdout, indirect only and exclusion.
"""

_GONE = """\
## Settings that have gone

A file that has one of these opens without an error.

| setting | what it did | why it went |
|---|---|---|
| `orca_error` | `'ABSOLUTE'` had allocation reduce the plain error instead of the relative one | \
it was worse in each of [four scenes](decisions/candidates.md#allocation-against-fixed-counts), and nothing used it
|

Other values that no measurement recommends stay because they are a [paper's](papers/README.md) method or
comparison, or because a benchmark sets them.
"""


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"`'{value}'`" if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else str(value)


def _values(setting: Setting) -> str:
    """The default, and what else there is."""
    default = _value(scene_default(setting))
    if setting.choices or isinstance(setting.default, bool):
        return default
    if isinstance(setting.default, str):
        return "a path; `//` is the .blend's folder"
    return f"{default}; {setting.limits}" + (f" [{setting.unit}]" if setting.unit else "")


def _table(section: str) -> Iterator[str]:
    settings = settings_of(section)
    is_shared = any(setting.name in SHARED_SETTINGS for setting in settings)
    yield "| setting | default; values |" + (" Cycles' |" if is_shared else "") + " meaning |"
    yield "|---|---|" + ("---|" if is_shared else "") + "---|"
    for setting in settings:
        cells = [f"`{setting.name}`: {setting.label}", _values(setting)]
        if is_shared:
            cells.append(f"`{'.'.join(SHARED_SETTINGS[setting.name])}`" if setting.name in SHARED_SETTINGS else "")
        yield "| " + " | ".join([*cells, f"{setting.sentence}."]) + " |"


def _choices(section: str, listed: dict[object, str]) -> Iterator[str]:
    """Lists of choices; where an earlier setting has the same ones, its name. `listed` holds the earlier settings."""
    for setting in settings_of(section):
        if setting.choices:
            earlier = listed.setdefault(tuple(setting.choices), setting.name)
            if earlier != setting.name:
                yield f"\n`{setting.name}`: as `{earlier}`."
                continue
            yield f"\n`{setting.name}`:\n"
            for choice in setting.choices:
                yield f"- `'{choice.name}'` ({choice.label}): {choice.sentence}."


def _section(section: str, listed: dict[object, str]) -> str:
    lines = [f"### {section}\n", *_table(section), *_choices(section, listed)]
    if section in _NOTES:
        lines += ["", _NOTES[section].rstrip("\n")]
    return "\n".join(lines) + "\n"


def page() -> str:
    """The whole page."""
    listed: dict[object, str] = {}
    return "\n".join([
        _HEAD,
        "## For users: `scene.neuralguide`\n",
        "Before the semicolon stands the default; the choices of a setting are listed below its table.",
        "The column *Cycles'* says which of the scene's properties counts instead while the scene follows Cycles.\n",
        *(_section(section, listed) for section in SECTIONS),
        _ELSEWHERE,
        f"## For experiments: `scene.neuralguide.{EXPERIMENT}`\n",
        "Hardly anybody needs to change these. Benchmarks and reproductions of papers set them.\n",
        *(_section(section, listed) for section in EXPERIMENT_SECTIONS),
        _GONE,
    ])  # fmt: skip


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")
    print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
