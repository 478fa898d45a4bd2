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

You need to set nothing. The scene's Cycles settings count for what Cycles has too. The rest has defaults that were
measured. `python -m tools.settings_page` writes this page from `engine/settings.py` and `addon/declared_settings.py`.

## Whose settings count

- The scene's Cycles settings, which the panels show.
- Before them a property of `scene.neuralguide` that a script sets. The panel shows it with a ✕, which leads back to
  Cycles' setting, as does `scene.neuralguide.property_unset("samples")`.
- With *Use Cycles' Settings* (`use_cycles_settings`) off NeuralGuide's own settings alone.
  `bpy.ops.neuralguide.copy_cycles_settings()` sets ours to what Cycles' are now.
- Where the Cycles add-on is off NeuralGuide's own, whose defaults are Cycles'.
- *Use Cycles' Settings* is off in a file that an older version saved with NeuralGuide's own, so it keeps its picture.

What Cycles' settings ask for and NeuralGuide does not have (the GPU and others) is said once a render.

## How to set them

- In panels of the render properties. *Experiments* is there if the add-on's preferences say *Show settings for
  experiments*.
- By a script: `scene.neuralguide.guiding_method = 'OFF'`, `scene.neuralguide.experiment.strata = 8`.
- On the command line: `python -m addon scene.blend --set guiding_method=OFF --set experiment.strata=8 -f 1`, or
  `strata=8` alone.

The command line and the render refuse a value that makes no sense: they name the setting and say what to choose.

## When the picture is the same

Scene and settings decide the image, not the number of threads. Three things make it depend on time: a time limit,
networks, and `'AUTO'`, which reads the clock to compare. With `deterministic` the last two do not.

A render that starts from what was learned before has other noise than one that learns anew. Turn `keep_learned` off, or
`deterministic` on, to have the same image each time.
"""

#: Said under a section's list.
_NOTES = {
    "Sampling": """\
With `spectral` `'ON'` colours have smooth spectra everywhere and white light is D65. Reflections of colours in colours
differ a little from those of RGB ([figures](results/wavelengths.md)).
""",
    "Denoising": """\
A noise threshold looks at the samples. With a denoiser a picture is good much sooner, and `denoised_threshold` tells
when: halves of the samples are denoised apart, and what they differ by tells what the denoised picture errs by. The
log, *Last Render* and the file's metadata say at which sample the render stopped, and the error that was estimated.

- 0.03 is a preview, 0.01 a good picture, 0.005 hard to tell from a clean one. Values are those of the sRGB curve, where
  1 is white, so 0.01 is two and a half steps of 8 bits. Hard scenes err by more at thousands of samples: *Samples* and
  the time limit count as ever.
- The mean over the picture counts. What both halves get wrong alike (fine shadows, reflections that are smeared) is
  accounted for as it was measured ([figures](decisions/denoising.md#a-threshold-on-the-denoised-picture)): the true
  error was 0.5 to 1.2 times the estimated one, against references of one scene that were noisy in the dark up to 1.6.
- It looks first at 16 samples, then each time at half as many again. A look takes about as long as a sample a pixel,
  in pictures below 80,000 pixels as six.
- Without *Denoise* it does nothing, and the render says so. Viewports have none.
""",
    "Guiding": """\
Panels offer `'AUTO'` and `'OFF'`, and the others where settings for experiments are shown or a file has one. Methods
from `'VMM'` to `'FLOW'` draw directions from what was learned; those that end in `_RIS` weigh several and take one.
Networks do not pay on a processor at equal time ([figures](results/do-networks-pay.md)).
""",
    "Trial and Training": """\
`sequence_field` is for animations whose moving lights only guiding finds. It hardly pays if much changes from one frame
of training to the next ([figures](results/sequences.md)).

- `guiding_method` or `experiment.source_field` must be `'NPM'`, `'NPM_PRODUCT'` or `'NASG'`, and something animated;
  else the render says that it does without.
- With the first frame up to 32 frames are exported and visited, for `sequence_samples` samples in all.
- Later frames of the process use the field. Another file, other settings or a changed frame train it anew. Each view
  layer has its own.
""",
    "Learned Field": """\
A field holds mixtures, how often to guide and to sample lights, and the table of `'TABLE_RIS'`. Networks and SD-trees
are learned anew. A render that starts from it is guided from its first sample and goes on learning
([figures](results/learned-fields.md)).

- It fits any view, size, number of samples and method, while lights, materials, geometry and world are the same.
  Otherwise, or where guiding did not pay before, the render learns anew.
- The image is unbiased whatever a file holds.
- With `keep_learned` each view layer goes on from its last render until another file is opened. With `deterministic` a
  render uses a file only.
- `save_field` saves what the last view layer has learned. A file that cannot be read is left alone.
- `bpy.ops.neuralguide.save_learned_field(filepath=...)` and `load_learned_field` are the panel's buttons.
- `python -m addon scene.blend --set save_field=on --field scene.ngfield -f 1` saves, the same without `--set` starts
  from it.
""",
    "Learning": """\
Regions begin at `guiding_probability`, and keep it if `learn_guiding_probability` is off.
""",
    "Candidates": """\
These are for methods that resample. [Decisions](decisions/candidates.md) say why `'ORCA'` is the default.
""",
    "Neural Mixtures": """\
These are for `'NPM'`, `'NPM_PRODUCT'` and `'NASG'`, as a method or a source; `mixture_target` for `'NASG'` alone.
[Decisions](decisions/trees-and-neural-mixtures.md) say why the preset is `'COMPACT'`.
""",
    "Time and Wavelengths": """\
The fourth dimension is called u ([glossary](glossary.md)). Where lights move while the shutter is open, `'NPM'` with
`mixture_u` `'PLANES'` learns where they are when: 2.7 times less error than unguided paths in three such scenes at
equal samples, 3.6 times in 8 `strata`, for many times the time ([figures](results/motion.md)). Where nothing moves and
a material disperses both see the wavelength instead ([figures](results/wavelengths.md)). A stratum needs 8 samples.
Where there are fewer strata than asked for, a notice says why.
""",
}

_ELSEWHERE = """\
## What is set elsewhere

- **Dispersion** is the Principled BSDF's from Blender 5.3 on. For other nodes and older Blenders materials whose Glass,
  Refraction or Principled node transmits have a panel: an Abbe number or Cauchy's coefficients
  (`material.neuralguide.dispersion`, `abbe_number`, `cauchy_a`, `cauchy_b`). The node's IOR is that of 587.6 nm (d).
- **Motion blur** is Blender's own, with objects' switches and steps, and Cycles' rolling shutter.
- **Threads** are Blender's own (*Performance*) unless `threads` is set.
- **Passes** are chosen by view layer. Blender's are Combined, Depth, Position, Normal, indices, Emission, Environment,
  Ambient Occlusion, Shadow Catcher, light taken apart, light groups, Mist, UV, Vector, Shader AOVs and Cryptomatte (a
  multilayer EXR of 32 bits; turn *Interleave* on for programs that read one part only). Ours, in
  `view_layer.neuralguide`, are Albedo, Sample Count, Variance, Candidate Count and Guiding Benefit. Variance is of
  what paths brought: choose *Accuracy* Unbiased for that of the picture.
- **View layers** have Blender's own rules: *Filter*, *Override*, holdout, indirect only and exclusion.
"""

_GONE = """\
## Settings that have gone

A file that has one opens without an error; settings under former names move to `scene.neuralguide.experiment`.
`orca_error` `'ABSOLUTE'` had allocation reduce the plain error instead of the relative one. It was worse in each of
[four scenes](decisions/candidates.md#allocation-against-fixed-counts).

Other values that no measurement recommends stay as a [paper's](papers/README.md) method, or for a benchmark.
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


def _listed(section: str) -> Iterator[str]:
    for setting in settings_of(section):
        known = [setting.label, _values(setting)]
        theirs = ".".join(SHARED_SETTINGS.get(setting.name, ()))
        if theirs == f"cycles.{setting.name}":
            known[0] += "°"
        elif theirs:
            known.append(f"`{theirs}`")
        yield f"- `{setting.name}` ({'; '.join(known)}): {setting.sentence}."


def _earlier(setting: Setting, listed: dict[str, Setting]) -> str:
    """The earlier setting that has all choices of this one; empty: there is none."""
    return next((name for name, other in listed.items() if set(setting.choices) <= set(other.choices)), "")


def _choices(section: str, listed: dict[str, Setting]) -> Iterator[str]:
    """Lists of choices; where an earlier setting has them too, its name. `listed` holds the earlier settings."""
    for setting in settings_of(section):
        if not setting.choices:
            continue
        if earlier := _earlier(setting, listed):
            is_all = len(setting.choices) == len(listed[earlier].choices)
            names = "" if is_all else ": " + ", ".join(f"`'{choice.name}'`" for choice in setting.choices)
            yield f"\n`{setting.name}`: as `{earlier}`{names}."
            continue
        listed[setting.name] = setting
        yield f"\n`{setting.name}`:\n"
        for choice in setting.choices:
            yield f"- `'{choice.name}'` ({choice.label}): {choice.sentence}."


def _section(section: str, listed: dict[str, Setting]) -> str:
    lines = [f"### {section}\n", *_listed(section), *_choices(section, listed)]
    if section in _NOTES:
        lines += ["", _NOTES[section].rstrip("\n")]
    return "\n".join(lines) + "\n"


def page() -> str:
    """The whole page."""
    listed: dict[str, Setting] = {}
    return "\n".join([
        _HEAD,
        "## For users: `scene.neuralguide`\n",
        "In brackets: label; default; values; the scene's property that counts while it follows Cycles (°: that of",
        "`scene.cycles` with the same name).\n",
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
