# SPDX-License-Identifier: GPL-3.0-or-later
"""The site's page of what scripts use, made of docstrings. It reads sources and imports none: the site needs no engine.

`tools/site_hooks.py` makes the page whenever the site is built, so that it cannot be out of date.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]


class Section(NamedTuple):
    """Names, by module, under a heading; a sentence says what one does with them."""

    title: str
    sentence: str
    names: dict[str, tuple[str, ...]]


SECTIONS = (
    Section("Render", "Load a description, render it, get passes and a report.", {
        "engine.render.session": ("Session", "LoadCancelled"),
        "engine.render.report": ("RenderResult", "RenderReport", "Progress"),
    }),
    Section("Settings", "[Settings](settings.md) lists all fields.", {
        "engine.settings": ("RenderSettings", "SETTINGS", "Setting"),
    }),
    Section("Describe a scene", "What a renderer needs to know of a scene, as plain data.", {
        "engine.scene.description": (
            "SceneDescription", "Camera", "Frame", "Mesh", "Attribute", "Instances", "Material", "NodeGraph", "Node",
            "Link", "Light", "World", "Notice",
        ),
        "engine.scene.passes": ("PassSettings", "Aov", "PassMotion"),
        "engine.scene.fast_gi": ("FastGi",),
        "engine.scene.panorama": ("Panorama", "StereoEye"),
        "engine.scene.image": ("Image",),
        "engine.scene.instances": ("plain_instances", "empty_instances"),
        "engine.scene.grids": ("Grid", "VolumeMotion"),
    }),
    Section("Passes", "Names of passes, for `Session.render` and for what it gives back.", {
        "engine.render.film": ("PASS_NAMES",),
        "engine.render.light_passes": ("group_pass",),
        "engine.scene.pass_names": ("aov_pass", "matte_passes"),
        "engine.scene.cryptomatte": ("matte_id",),
    }),
    Section("Learned fields", "What a render has learned, for others to start from.", {
        "engine.guiding.saved.learned": ("LearnedField",),
        "engine.guiding.saved.file": ("save_field", "load_field", "FieldFileError"),
    }),
    Section("Sources of directions", "[For researchers](researchers.md) says how to add one.", {
        "engine.methods": ("SOURCES", "Source", "METHODS", "Method"),
        "engine.guiding.sources.guide_kernels": ("Implementation", "GuideKernels"),
        "engine.guiding.models.source_model": ("SourceModel",),
    }),
)  # fmt: skip
#: Public methods that are not for scripts.
NOT_FOR_SCRIPTS = {"Session.trace_tiles"}
#: Classes whose fields another page lists.
LISTED_ELSEWHERE = {"RenderSettings"}

_HEADING = re.compile(r"(Attributes|Parameters|Raises|Returns|References)\n-+(?:\n|\Z)")
#: What begins an item of numpydoc: `name : type`, or in sections of what is raised or returned the type alone.
_NAMED = re.compile(r"([A-Za-z_]\w*(?:, \w+)*) : (.+)")


def _module(name: str) -> tuple[str, ast.Module]:
    text = ROOT.joinpath(*name.split(".")).with_suffix(".py").read_text("utf-8")
    return text, ast.parse(text)


def _definition(tree: ast.Module, name: str) -> ast.stmt:
    """The class, function or value of a name at a module's top.

    Raises
    ------
    LookupError
        If the module does not define it.
    """
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if getattr(node, "name", "") == name or any(isinstance(t, ast.Name) and t.id == name for t in targets):
            return node
    raise LookupError(f"{name} is not defined")


def _items(lines: Sequence[str], is_bare: bool) -> Iterator[str]:
    """Lines of Markdown for lines of a docstring: items become lists, all else stays; `is_bare` without names."""
    is_item = is_head = False
    for line in lines:
        text = line.strip()
        named = _NAMED.fullmatch(line)
        if named or (is_bare and text and line == text):
            name, rest = named.groups() if named else (text, "")
            if not is_item:
                yield ""
            is_item = is_head = True
            yield f"- **{name}**" + (f": {rest}" if rest else "")
        elif is_item and text and line != text:
            yield f"    <br>{text}" if is_head else f"    {text}"
            is_head = False
        elif text:
            if is_item:
                yield ""
            is_item = False
            yield text
        elif not is_item:
            yield ""


def _prose(docstring: str) -> Iterator[str]:
    """Markdown of a docstring."""
    first, *sections = _HEADING.split(inspect.cleandoc(docstring))
    yield from _items(first.split("\n"), False)
    for title, text in zip(sections[::2], sections[1::2], strict=True):
        yield from ("", f"*{title}*", *_items(text.strip("\n").split("\n"), title in ("Raises", "Returns")))


def _code(lines: Sequence[str]) -> Iterator[str]:
    yield from ("", "```python", *inspect.cleandoc("\n".join(["", *lines])).split("\n"), "```", "")


def _signature(text: list[str], node: ast.FunctionDef) -> list[str]:
    """Lines of a function's head, as the source has them."""
    lines = text[node.lineno - 1 : node.body[0].lineno - 1]
    # From its own line on: decorators say how it is done, but for properties.
    is_property = any(isinstance(item, ast.Name) and item.id == "property" for item in node.decorator_list)
    return ["    " * (node.col_offset // 4) + "@property", *lines] if is_property else lines


def _fields(text: list[str], node: ast.ClassDef) -> list[str]:
    """Lines of a class's fields, comments included."""
    at = [index for index, item in enumerate(node.body) if isinstance(item, ast.AnnAssign)]
    if not at:
        return []
    before = node.body[at[0] - 1] if at[0] else None
    start = (before.end_lineno or 0) if before else node.lineno
    lines = text[start : node.body[at[-1]].end_lineno]
    return lines[next(index for index, line in enumerate(lines) if line.strip()) :]


def _entry(module: str, name: str) -> Iterator[str]:
    """Lines about one name."""
    source, tree = _module(module)
    text, node = source.split("\n"), _definition(tree, name)
    yield from ("", f"### {name}", "", f"`from {module} import {name}`", "")
    if isinstance(node, ast.FunctionDef):
        yield from _code(_signature(text, node))
    if not isinstance(node, ast.FunctionDef | ast.ClassDef):
        # A value: what its comment says, or else the value.
        above = node.lineno - 1
        comments = []
        while text[above - 1].startswith("#:"):
            above -= 1
            comments.insert(0, text[above][2:].strip())
        yield from [" ".join(comments)] if comments else _code(text[node.lineno - 1 : node.end_lineno])
        return
    yield from _prose(ast.get_docstring(node, clean=False) or "")
    if not isinstance(node, ast.ClassDef):
        return
    if name not in LISTED_ELSEWHERE and (fields := _fields(text, node)):
        yield from _code(fields)
    for method in node.body:
        is_shown = isinstance(method, ast.FunctionDef) and (method.name == "__init__" or method.name[0] != "_")
        if is_shown and f"{name}.{method.name}" not in NOT_FOR_SCRIPTS:
            yield from ("", *_code(_signature(text, method)), *_prose(ast.get_docstring(method, clean=False) or ""))


def api_page() -> str:
    """The page, as Markdown.

    Raises
    ------
    LookupError
        If a name is listed that its module does not define.
    """
    lines = ["# For scripts", "", "What scripts use, from the docstrings. [Examples](examples.md) show how."]
    for section in SECTIONS:
        lines += ["", f"## {section.title}", "", section.sentence]
        for module, names in section.names.items():
            for name in names:
                lines += _entry(module, name)
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)) + "\n"
