# SPDX-License-Identifier: GPL-3.0-or-later
"""Pages point at what exists: links and anchors, pages named in sources, sources named in pages."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from tools.repository_files import ROOT, repository_files

MOST_MANUAL_WORDS = 1500

_CODE_BLOCK = re.compile(r"^ *```.*?^ *```[^\n]*$", re.MULTILINE | re.DOTALL)
_CODE_SPAN = re.compile(r"`([^`\n]+)`")
_LINK = re.compile(r"\]\(\s*<?([^)\s>]+)>?\s*\)")
_HEADING = re.compile(r"^#+ +(.*?) *#*$", re.MULTILINE)
_PAGE_IN_SOURCE = re.compile(r"docs/[\w./-]+\.md(?:#[\w-]+)?")
_SOURCE_IN_PAGE = re.compile(r"(?:addon|benchmarks|demo|engine|tests|tools)/[\w./*-]*\w\.(?:py|sh|npz)")


def _anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    anchors: set[str] = set()
    for heading in _HEADING.findall(_CODE_BLOCK.sub("", page.read_text("utf-8"))):
        text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        base = re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")
        anchor, count = base, 0
        while anchor in anchors:
            count += 1
            anchor = f"{base}-{count}"
        anchors.add(anchor)
    return anchors


def _section(page: Path, anchor: str) -> str:
    """Text below a page's heading of the second level, down to the next one; empty for other headings."""
    for part in re.split(r"^## ", page.read_text("utf-8"), flags=re.MULTILINE)[1:]:
        heading, _, text = part.partition("\n")
        if re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") == anchor:
            return text
    return ""


def _is_missing(page: Path, anchor: str) -> bool:
    return not page.exists() or (anchor != "" and (page.suffix != ".md" or anchor not in _anchors(page)))


def _broken_links(page: Path) -> Iterator[str]:
    text = _CODE_SPAN.sub("", _CODE_BLOCK.sub("", page.read_text("utf-8")))
    for link in _LINK.findall(text):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        if _is_missing((page.parent / path).resolve() if path else page, anchor):
            yield link


def test_the_index_of_decisions_has_them_all() -> None:
    folder = ROOT / "docs/decisions"
    index = (folder / "README.md").read_text("utf-8")
    listed = set(_LINK.findall(index))
    pages = [page for page in sorted(folder.glob("*.md")) if page.name != "README.md"]
    sections = {
        f"{page.name}#{anchor}"
        for page in pages
        for anchor in _anchors(page)
        if re.search(r"\*\*Decision\.\*\*", _section(page, anchor))
    }
    assert len(sections) > 100
    assert not sections - listed, "docs/decisions/README.md lacks these sections"


def test_decisions_come_before_their_figures() -> None:
    late = [
        f"{page.name}: {part.partition(chr(10))[0]}"
        for page in repository_files("docs/decisions/*.md")
        for part in re.split(r"^## ", page.read_text("utf-8"), flags=re.MULTILINE)[1:]
        if (figures := part.find("**Figure")) >= 0 and not 0 <= part.find("**Decision.**") < figures
    ]
    assert late == []


def test_links_point_at_what_exists() -> None:
    pages = repository_files("*.md")
    assert len(pages) > 20
    broken = [f"{page.relative_to(ROOT)}: {link}" for page in pages for link in _broken_links(page)]
    assert not broken, "\n".join(broken)


def test_broken_links_are_found(tmp_path: Path) -> None:
    (tmp_path / "other.md").write_text("# There, `too`\n## Twice\n## Twice\n", "utf-8")
    page = tmp_path / "page.md"
    page.write_text(
        "# Here\n[a](other.md) [b](#here) [c](other.md#there-too) [d](other.md#twice-1) `[e](code.md)` [f](https://g.h)\n"
        "[i](nowhere.md) [j](#nowhere) [k](other.md#nowhere) ![l](nowhere.png)\n",
        "utf-8",
    )
    assert list(_broken_links(page)) == ["nowhere.md", "#nowhere", "other.md#nowhere", "nowhere.png"]


def test_the_manual_of_the_benchmarks_is_short() -> None:
    assert len((ROOT / "docs/benchmarks.md").read_text("utf-8").split()) <= MOST_MANUAL_WORDS


def test_sources_name_pages_that_exist() -> None:
    sources = repository_files("*.py")
    named = [(source, name) for source in sources for name in _PAGE_IN_SOURCE.findall(source.read_text("utf-8"))]
    assert len(named) > 20
    missing = []
    for source, name in named:
        path, _, anchor = name.partition("#")
        if _is_missing(ROOT / path, anchor):
            missing.append(f"{source.relative_to(ROOT)}: {name}")
    assert missing == []


def test_pages_name_sources_that_exist() -> None:
    pages = [ROOT / "README.md", *repository_files("docs/*.md")]
    named = [
        (page, path)
        for page in pages
        for span in _CODE_SPAN.findall(_CODE_BLOCK.sub("", page.read_text("utf-8")))
        for path in _SOURCE_IN_PAGE.findall(span)
    ]
    assert len(named) > 20
    assert [f"{page.relative_to(ROOT)}: {path}" for page, path in named if not any(ROOT.glob(path))] == []


def test_pages_name_tests_that_exist() -> None:
    named = [
        (page, *match.groups())
        for page in repository_files("docs/*.md")
        for match in re.finditer(r"`(tests/[\w/]+\.py)::(\w+)`", page.read_text("utf-8"))
    ]
    assert len(named) > 30
    assert [
        f"{page.relative_to(ROOT)}: {path}::{name}"
        for page, path, name in named
        if f"def {name}(" not in (ROOT / path).read_text("utf-8")
    ] == []


def _commands() -> Iterator[tuple[Path, str, str]]:
    """Page, program and what it runs: targets of make, and modules that Python runs."""
    for page in repository_files("*.md"):
        text = "\n".join([*_CODE_BLOCK.findall(page.read_text("utf-8")), *_CODE_SPAN.findall(page.read_text("utf-8"))])
        yield from ((page, "make", target) for target in re.findall(r"^ *make ([a-z0-9./-]+)", text, re.MULTILINE))
        yield from ((page, "python", module) for module in re.findall(r"python -m ([\w.]+)", text))


def test_commands_in_pages_are_there() -> None:
    """That what they run exists; what each does is tested where it is."""
    targets = re.findall(r"^([a-z0-9./%-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    is_target = re.compile("|".join(re.escape(target).replace("%", r"[\w.]+") for target in targets))
    commands = list(_commands())
    assert {program for _page, program, _what in commands} == {"make", "python"} and len(commands) > 20
    missing = []
    for page, program, what in commands:
        if program == "make":
            is_there = is_target.fullmatch(what) is not None
        else:
            path = ROOT.joinpath(*what.split("."))
            is_there = path.with_suffix(".py").is_file() or (path / "__main__.py").is_file()
            is_there = is_there or what in ("pip", "pytest")
        if not is_there:
            missing.append(f"{page.relative_to(ROOT)}: {program} {what}")
    assert missing == []
