# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m tools.troubleshooting_page` writes docs/troubleshooting.md: what the engine may say, and what to do then.

Sentences are collected from the sources: notices, reports and log messages of the add-on, and errors of the modules of
`TOPICS`. They stand there as they are seen, with examples for what they name in a scene (`seen_sentences.py`).
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tools.message_examples import EXAMPLES, EXAMPLES_IN
from tools.seen_sentences import Module

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "troubleshooting.md"


class Topic(NamedTuple):
    """What a part of the sources is about, and what to do about what it says."""

    title: str
    paths: tuple[str, ...]
    advice: str


TOPICS = (
    Topic(
        "Learned fields and sequences", ("addon/learned_fields.py", "addon/sequence.py", "engine/guiding/saved"),
        "The picture does not depend on it: a render without a field that fits learns anew. Save the field again, or "
        "choose the file that was saved for this scene.",
    ),
    Topic(
        "Denoising a sequence of frames",
        (
            "addon/denoise_sequence.py", "addon/denoise_after_render.py", "addon/denoise_over_time.py",
            "addon/exr_layers.py", "addon/frame_by_frame.py",
        ),
        "Nothing is changed but files in the folder of denoised frames; those that are finished stay. "
        "[denoised-animations.md](denoised-animations.md) says what frames must have.",
    ),
    Topic(
        "Mixing lights",
        (
            "addon/light_mix.py", "addon/light_mix_lamps.py", "addon/light_mix_operator.py", "addon/light_mix_panel.py",
            "addon/light_mix_picture.py", "addon/light_mix_images.py", "addon/light_mix_files.py",
            "addon/light_mix_layers.py", "addon/light_mix_sequence.py", "addon/exr_metadata.py",
            "addon/make_light_groups.py", "addon/cli_mixing.py", "engine/render/light_mix.py",
        ),
        "The picture is there as it was rendered. [light-mixing.md](light-mixing.md) says what a mix needs, and what "
        "can be written back to lamps.",
    ),
    Topic(
        "The command line", ("addon/cli.py", "addon/cli_arguments.py", "addon/output_files.py"),
        "Correct the option or the file that is named. `python -m addon --help` lists the options.",
    ),
    Topic(
        "Checkpoints of frames",
        (
            "addon/checkpoints.py", "addon/kept_frames.py", "addon/kept_frames_operator.py",
            "engine/render/checkpoint.py", "engine/render/checkpoint_file.py", "engine/render/checkpointing.py",
        ),
        "The picture does not depend on them: a frame without one that fits begins anew. "
        "[frames-that-go-on.md](frames-that-go-on.md) says what fits, and where they lie.",
    ),
    Topic(
        "Settings",
        (
            "addon/declared_settings.py", "addon/shared_settings.py", "addon/unsupported_settings.py",
            "engine/settings.py",
        ),
        "Change the setting that is named, as the sentence says. [settings.md](settings.md) lists all values.",
    ),
    Topic(
        "Memory and textures",
        (
            "addon/export/images.py", "addon/export/image_headers.py", "engine/scene/limits.py",
            "engine/scene/texel_file.py", "engine/shaders/image_pool.py",
        ),
        "Where an image cannot be read, find it by *File > External Data > Find Missing Files*. Where something does "
        "not fit, make what the sentence names smaller, or render a part by a render border. *Performance > Texture "
        "Memory* says how much of the memory textures may have.",
    ),
    Topic(
        "Volumes", ("addon/export/volumes.py", "addon/export/openvdb_module.py", "engine/builder/media.py",
                    "engine/builder/majorants.py", "engine/builder/grids.py", "engine/shaders/media.py",
                    "engine/shaders/varying_media.py"),
        "Look at the volume's file and frame, and at the material's volume output: what is named there is left out.",
    ),
    Topic(
        "Motion blur", ("addon/export/motion.py", "addon/export/shutter.py", "addon/export/deformation.py",
                        "addon/export/moments.py", "engine/builder/motion.py"),
        "What is named stands still, or keeps its shape. Where a modifier changes the number of vertices from frame to "
        "frame, there is no motion between them: turn *Deformation* off in the object's motion blur to do without the "
        "message.",
    ),
    Topic(
        "Several machines", ("engine/cluster",),
        "Look whether the scheduler runs, and whether all machines have the same NeuralGuide. [farm.md](farm.md) "
        "says how they are started.",
    ),
    Topic(
        "Materials and nodes", ("engine/shaders", "addon/export/nodes.py", "addon/export/materials.py",
                                "addon/export/node_tables.py", "addon/export/attributes.py"),
        "Replace the node, or accept what is shown instead. "
        "[differences.md](differences.md) lists what is not supported.",
    ),
    Topic(
        "Objects, lights and cameras",
        ("addon/export", "engine/builder", "engine/scene"),
        "Look at the object that is named: correct it, or accept what is shown instead.",
    ),
    Topic(
        "Rendering, guiding and memory",
        ("engine/render", "engine/guiding/models", "engine/guiding/neural/models", "engine/accel", "engine/denoise"),
        "Read what is done instead. Where the render stops, do what the sentence says, make the scene smaller, or look "
        "into `neuralguide.log` beside the kernel cache.",
    ),
    Topic(
        "Viewport", ("addon/viewport", "engine/viewport"),
        "The window says what it lacks. Switch to another shading and back to start its process anew; "
        "[viewport.md](viewport.md) says what it does.",
    ),
    Topic(
        "Packages and Blender's interface", ("addon",),
        "Do what the sentence says. Details of an error are in `neuralguide.log` beside the kernel cache.",
    ),
)  # fmt: skip

_HEAD = """\
# Troubleshooting

What NeuralGuide may say, by what it is about, and what to do then. Names, numbers and paths are examples: yours are
those of your scene. Behind an arrow stands what is shown or done instead.
`python -m tools.troubleshooting_page` writes this page.
"""

_REPORT = """\
## Report a bug

In Blender *Preferences > Add-ons > NeuralGuide > Copy Bug Report* copies what a report needs: versions, system,
processor, kernels and the end of the log. From a checkout this command prints it:

```
.venv/bin/python -m addon --report
```

Paste it into a new issue of the repository, for which `.github/ISSUE_TEMPLATE/bug_report.md` is the form. Say what
happens, what you expected, and how to make it happen: best by a .blend as small as possible.
"""

#: In this module a plain `ValueError` is no sentence, but the reason within one.
_HAS_REASONS = "engine/guiding/saved/file.py"
_NOTICES = {"Notice", "notice", "_notice"}
_LOGGED = {"info", "warning", "error"}


def _said(call: ast.Call, is_raised: bool) -> list[ast.expr]:
    """The expressions of a call that users read: two of a notice, one of a message, none of other calls."""
    function = call.func
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
    owner = getattr(function.value, "id", "") if isinstance(function, ast.Attribute) else ""
    if name in _NOTICES and len(call.args) >= 2:
        return call.args[-2:]
    if (name == "report" and len(call.args) == 2) or (is_raised and call.args and name.endswith("Error")):
        return call.args[-1:]
    return call.args[:1] if owner == "logger" and name in _LOGGED else []


def sentences(source: str, path: str = "") -> set[str]:
    """Sentences that a module's text may say; those of which nothing is known there are left out."""
    module = Module(source, EXAMPLES | EXAMPLES_IN.get(path, {}))
    raised = {id(node.exc) for node in ast.walk(module.tree) if isinstance(node, ast.Raise)}
    found = set()
    for call in ast.walk(module.tree):
        if path == _HAS_REASONS and getattr(getattr(call, "func", None), "id", "") == "ValueError":
            continue
        if isinstance(call, ast.Call) and (said := _said(call, id(call) in raised)):
            found |= {" → ".join(texts) for texts in module.texts(*said)}
    # What logging puts together was said elsewhere.
    return {text for text in found if any(letter.isalpha() for letter in text) and "%s" not in text}


def topic_of(path: str) -> Topic | None:
    """The first topic that a module, by its path in the repository, belongs to."""
    return next((topic for topic in TOPICS if any(path == p or path.startswith(f"{p}/") for p in topic.paths)), None)


def _collected() -> Iterator[tuple[Topic, str]]:
    for package in ("addon", "engine"):
        for file in sorted((ROOT / package).rglob("*.py")):
            path = file.relative_to(ROOT).as_posix()
            topic = topic_of(path)
            if topic is not None:
                yield from ((topic, text) for text in sentences(file.read_text("utf-8"), path))


def _without_variants(texts: set[str]) -> list[str]:
    """Sorted; not what another one says with an addition in brackets, and once what differs in what is done instead."""
    plain = [text for text in sorted(texts) if not (text.endswith(")") and text.rpartition(" (")[0] in texts)]
    instead: dict[str, list[str]] = {}
    for text in plain:
        problem, _arrow, fallback = text.partition(" → ")
        instead.setdefault(problem, []).append(fallback)
    return [f"{problem} → {' / '.join(found)}" if found != [""] else problem for problem, found in instead.items()]


def page() -> str:
    """The whole page."""
    found = list(_collected())
    lines = [_HEAD, _REPORT]
    listed: set[str] = set()
    for topic in TOPICS:
        lines += [f"## {topic.title}\n", f"{topic.advice}\n"]
        texts = {" ".join(text.replace("`", "'").split()) for owner, text in found if owner is topic} - listed
        listed |= texts
        lines += [*(f"- `{text}`" for text in _without_variants(texts)), ""]
    return "\n".join(lines).rstrip("\n") + "\n"


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")
    print(f"wrote {PAGE}")


if __name__ == "__main__":
    main()
