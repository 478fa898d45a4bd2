# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/troubleshooting.md holds what the sources may say."""

from __future__ import annotations

import pytest

from tools.troubleshooting_page import PAGE, ROOT, page, sentences, topic_of


def test_the_page_is_the_one_that_is_generated() -> None:
    assert PAGE.read_text("utf-8") == page(), "run python -m tools.troubleshooting_page"


def test_sentences_are_found() -> None:
    source = (
        'raise ValueError(f"{name} is bad: " + "mend it")\n'
        'notices.append(Notice(subject, "has no shape", "left out"))\n'
        'logger.info("rendered")\n'
        'x = ValueError("not raised")\n'
    )
    assert sentences(source) == {"Cube is bad: mend it", "has no shape → left out", "rendered"}


def test_sentences_stand_there_as_they_are_seen() -> None:
    """Names are followed to what they hold; what only a scene knows is an example."""
    source = (
        "KINDS = {'a': 'hair is', 'b': 'smoke is'}\n"
        "def check(scene):\n"
        "    for is_asked, problem, fallback in ((1, 'no wood', 'steel'), (2, 'no glass', 'water')):\n"
        "        found.append(Notice(scene.name, problem, fallback))\n"
        "    problem = 'the first' if scene else 'the second'\n"
        "    notices.append(Notice('x', problem, 'gone'))\n"
        "    problem = 'the third'\n"
        "    notices.append(Notice('x', problem, f'{count} left'))\n"
        "    context.notice(scene.name, f'{KINDS[kind]} not supported', 'left out')\n"
        "def say(problem, fallback):\n"
        "    context.notice(subject, f'it {problem}', fallback)\n"
        "say('burns', 'put out')\n"
        "say('drowns', 'dried')\n"
        "def unknown(problem, error):\n"
        "    context.notice(subject, problem, 'nothing')\n"
        "    raise ValueError(str(error))\n"
    )
    assert sentences(source) == {
        "no wood → steel", "no glass → water", "the first → gone", "the second → gone", "the third → 4 left",
        "hair is not supported → left out", "smoke is not supported → left out", "it burns → put out",
        "it drowns → dried",
    }  # fmt: skip


def test_no_sentence_is_a_template() -> None:
    listed = [line for line in page().splitlines() if line.startswith("- `")]
    assert len(listed) > 150
    assert not [line for line in listed if "…" in line or "{" in line or "%s" in line]


def test_what_a_user_sees_is_on_the_page() -> None:
    """By messages of the engine's own, made here."""
    from addon.cli_arguments import CommandLineError, parse_arguments

    with pytest.raises(CommandLineError) as error:
        parse_arguments(["--threads", "-1"])
    assert f"- `{error.value}`" in page()


def test_every_module_of_the_add_on_has_advice() -> None:
    files = [file.relative_to(ROOT).as_posix() for file in (ROOT / "addon").rglob("*.py")]
    assert len(files) > 20 and all(topic_of(file) for file in files)
