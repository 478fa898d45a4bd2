# SPDX-License-Identifier: GPL-3.0-or-later
"""The line of Blender's status bar: Cycles' words, in Cycles' order."""

from addon.progress import status_line
from engine.render.report import Progress


def progress(**changes: object) -> Progress:
    values = {
        "fraction": 0.1, "sample": 12, "samples": 128, "elapsed": 7.0, "remaining": 75.4, "rays_per_second": 1.25e6,
        "message": "",
    }  # fmt: skip
    return Progress(**{**values, **changes})  # type: ignore[arg-type]


def test_it_reads_as_cycles_own() -> None:
    line = status_line(progress(), "Scene, ViewLayer", 812 * 2**20)
    # Cycles: Remaining:01:15.40 | Mem:712.00M, Peak:812.00M | Scene, ViewLayer | Sample 12/128
    assert line == "Remaining:01:15.40 | Peak:812.00M | Scene, ViewLayer | Sample 12/128 | 1.25 Mrays/s"
    hours = status_line(progress(remaining=4000.0, noisy_share=0.0312), "Scene, ViewLayer")
    assert hours == "Remaining:01:06:40.00 | Scene, ViewLayer | Sample 12/128 | 3.12% of pixels left | 1.25 Mrays/s"


def test_it_says_what_is_done_before_and_after_samples_are_taken() -> None:
    before = progress(sample=0, remaining=None, message="Building the scene", elapsed=0.5)
    assert status_line(before, "Scene, ViewLayer") == "Scene, ViewLayer | Building the scene"
    assert status_line(progress(sample=0, remaining=None, message="Compiling", elapsed=75.0)) == "Compiling | 1:15"
    after = progress(sample=128, remaining=None, message="Denoising")
    assert status_line(after) == "Sample 128/128 | Denoising | 1.25 Mrays/s"
    # No minute of 60 seconds.
    assert status_line(progress(remaining=59.999)).startswith("Remaining:00:59.99 |")
