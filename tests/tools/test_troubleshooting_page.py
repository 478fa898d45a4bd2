# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/troubleshooting.md holds what the sources may say."""

from __future__ import annotations

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
    assert sentences(source) == {"… is bad: mend it", "has no shape → left out", "rendered"}


def test_every_module_of_the_add_on_has_advice() -> None:
    files = [file.relative_to(ROOT).as_posix() for file in (ROOT / "addon").rglob("*.py")]
    assert len(files) > 20 and all(topic_of(file) for file in files)
