# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of charts in a real browser: the wheel, a drag, keys and clicks move all pictures of a scene together."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.report.page import write_report
from tests.helpers.browser import CHROMEDRIVER, CHROMIUM, Browser
from tests.helpers.synthetic_records import HEIGHT, WIDTH, write_line, write_reference, write_render
from tests.helpers.waiting import wait_until

pytestmark = pytest.mark.skipif(
    CHROMIUM is None or CHROMEDRIVER is None, reason="no Chromium with chromedriver (Debian: chromium, chromium-driver)"
)

_VIEWER = "document.querySelector('.viewer')"
_SHOWN = "[...document.querySelectorAll('.viewer')[0].querySelectorAll('.pane:not([hidden])')]"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    profile = Path(tempfile.mkdtemp(prefix="chromium-"))
    window = Browser(profile)
    yield window
    window.close()
    shutil.rmtree(profile, ignore_errors=True)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A scene with two rivals, two budgets and a reference, and a plain one."""
    folder = tmp_path_factory.mktemp("page")
    rng = np.random.default_rng(3)
    truth = rng.uniform(0.2, 1.0, (HEIGHT, WIDTH, 4)).astype(np.float32)
    write_reference(folder / "references", truth, scene="hall")
    for rival, error in (("cycles", 0.2), ("OFF", 0.1)):
        write_line(
            folder / "sweep", rival, {1.0: 2.0 * error, 4.0: error}, lambda d, seed: truth * (1.0 + d), scene="hall"
        )
    write_render(folder / "sweep", "OFF", 1, truth, scene="room", seconds=1.0)
    return write_report(folder / "sweep", folder / "page", folder / "references").as_uri()


@pytest.fixture
def opened(browser: Browser, page: str) -> Browser:
    browser.emulate("prefers-color-scheme", "light")
    browser.open(page)
    # Pictures that come later move what lies below them away from under the pointer.
    browser.run("document.querySelectorAll('img').forEach(image => { image.loading = 'eager' })")
    wait_until(lambda: browser.run("return [...document.images].every(image => image.complete)"))
    return browser


def view(browser: Browser, index: int = 0) -> dict[str, float]:
    """Scale and corner of a scene's pictures."""
    data = browser.run(f"return {{...document.querySelectorAll('.viewer')[{index}].dataset}}")
    return {name: float(data[name]) for name in ("scale", "x", "y")}


def frame(browser: Browser, index: int = 0) -> dict[str, float]:
    """Place of a shown frame in the window, scrolled into it."""
    return browser.run(
        f"const f = {_SHOWN}[{index}].querySelector('.frame');"
        "f.scrollIntoView({block: 'center', behavior: 'instant'});"
        "const b = f.getBoundingClientRect();"
        "return {left: b.left, top: b.top, width: b.width, height: b.height}"
    )


def at(box: dict[str, float], x: float, y: float) -> tuple[int, int]:
    return round(box["left"] + x * box["width"]), round(box["top"] + y * box["height"])


def labels(browser: Browser) -> list[str]:
    return browser.run(f"return {_SHOWN}.map(pane => pane.querySelector('img').alt)")


def shown_corners(browser: Browser) -> list[tuple[float, float, float]]:
    """Scale and corner as the pictures really lie in their frames: not what the script believes."""
    found: list[Any] = browser.run(
        f"return {_SHOWN}.map(pane => {{ const f = pane.querySelector('.frame');"
        "const o = f.getBoundingClientRect(), i = pane.querySelector('img').getBoundingClientRect();"
        "const w = f.clientWidth;"
        "return [i.width / w, (o.left + f.clientLeft - i.left) / i.width, (o.top + f.clientTop - i.top) / i.height] })"
    )
    return [tuple(one) for one in found]


def test_the_wheel_zooms_all_pictures_about_the_pointer(opened: Browser) -> None:
    assert labels(opened) == ["hall, reference", "hall, cycles, 4s", "hall, OFF, 4s"]
    box = frame(opened, 1)
    before = opened.run("return window.scrollY")
    opened.wheel(*at(box, 0.75, 0.25), -400)
    scale = math.exp(0.8)
    wait_until(lambda: view(opened)["scale"] == pytest.approx(scale, rel=1e-3))
    seen = view(opened)
    # What was under the pointer is still there: 0.75 = x + 0.75 / scale. A pixel of the frame is 0.003 of it.
    assert seen["x"] + 0.75 / scale == pytest.approx(0.75, abs=0.004)
    assert seen["y"] + 0.25 / scale == pytest.approx(0.25, abs=0.004)
    assert opened.run("return window.scrollY") == before, "the page stays while a picture is zoomed"
    corners = shown_corners(opened)
    assert len(corners) == 3
    for corner in corners:
        assert corner == pytest.approx((seen["scale"], seen["x"], seen["y"]), abs=0.005)
    assert view(opened, 1) == {"scale": 1.0, "x": 0.0, "y": 0.0}, "the other scene has a view of its own"


def test_dragging_moves_all_pictures(opened: Browser) -> None:
    box = frame(opened, 1)
    opened.wheel(*at(box, 0.5, 0.5), -400)
    wait_until(lambda: view(opened)["scale"] == pytest.approx(math.exp(0.8), rel=1e-3))
    before = view(opened)
    opened.drag(at(box, 0.5, 0.5), at(box, 0.4, 0.6))
    wait_until(lambda: view(opened)["x"] - before["x"] == pytest.approx(0.1 / before["scale"], abs=0.004))
    wait_until(lambda: view(opened)["y"] - before["y"] == pytest.approx(-0.1 / before["scale"], abs=0.004))
    after = view(opened)
    assert all(corner == pytest.approx((after["scale"], after["x"], after["y"]), abs=0.005)
               for corner in shown_corners(opened))  # fmt: skip
    # No further than the edge.
    opened.drag(at(box, 0.1, 0.1), at(box, 0.95, 0.95))
    opened.drag(at(box, 0.1, 0.1), at(box, 0.95, 0.95))
    wait_until(lambda: (view(opened)["x"], view(opened)["y"]) == (0.0, 0.0))


def test_keys_zoom_move_and_reset(opened: Browser) -> None:
    frame(opened, 1)
    selector = ".viewer .pane:not([hidden]) .frame"
    opened.press(selector, "++")
    assert view(opened)["scale"] == pytest.approx(2.25)
    x = view(opened)["x"]
    opened.press(selector, "\ue014")  # right arrow
    assert view(opened)["x"] == pytest.approx(x + 0.1 / 2.25)
    opened.press(selector, "0")
    assert view(opened) == {"scale": 1.0, "x": 0.0, "y": 0.0}
    assert opened.run(f"return {_SHOWN}[0].querySelector('.frame').tabIndex") == 0


def test_rivals_budgets_and_error_maps_are_chosen(opened: Browser) -> None:
    opened.click(".viewer input[value=cycles]")
    assert labels(opened) == ["hall, reference", "hall, OFF, 4s"]
    opened.press(".viewer select[name=budget]", "1s")
    assert labels(opened) == ["hall, reference", "hall, OFF, 1s"]
    opened.press(".viewer select[name=content]", "error maps")
    assert labels(opened) == ["error of hall, OFF, 1s"]
    source = opened.run(f"return {_SHOWN}[0].querySelector('img').getAttribute('src')")
    assert source.endswith("_OFF_1s_error.png")
    opened.click(".viewer input[value=cycles]")
    assert labels(opened) == ["error of hall, cycles, 1s", "error of hall, OFF, 1s"]


def test_exposure_multiplies_light_and_pixels_stay_sharp(opened: Browser) -> None:
    opened.press(".viewer input[name=exposure]", "\ue012\ue012")  # left arrow twice
    assert opened.run(f"return {_VIEWER}.querySelector('output').textContent") == "-1 stops"
    slope = "return document.getElementById('exposure-' + document.querySelector('.viewer').id.slice(7))"
    assert opened.run(slope + ".querySelector('feFuncG').getAttribute('slope')") == "0.5"
    style = opened.run(
        f"const s = getComputedStyle({_SHOWN}[1].querySelector('img')); return [s.filter, s.imageRendering]"
    )
    assert "exposure-" in style[0] and style[1] == "pixelated"
    opened.click(".viewer button[name=reset]")
    assert opened.run(f"return getComputedStyle({_SHOWN}[1].querySelector('img')).filter") == "none"


def test_light_and_dark_pages_have_their_charts(opened: Browser) -> None:
    def shows(file: str) -> bool:
        return opened.run("return document.querySelector('picture img').currentSrc").endswith(file)

    opened.run("document.querySelector('picture img').scrollIntoView()")
    ground = "return getComputedStyle(document.body).backgroundColor"
    assert opened.run(ground) == "rgb(255, 255, 255)"
    wait_until(lambda: shows("/efficiency.png"))
    opened.emulate("prefers-color-scheme", "dark")
    assert opened.run(ground) == "rgb(27, 29, 33)"
    wait_until(lambda: shows("/efficiency-dark.png"))


def test_the_page_loads_without_complaint(opened: Browser) -> None:
    opened.complaints()
    opened.run("document.querySelectorAll('img').forEach(image => { image.loading = 'eager' })")
    opened.open(opened.run("return location.href"))
    assert opened.complaints() == []
    assert opened.run("return performance.getEntriesByType('resource').every(e => e.name.startsWith('file:'))")
