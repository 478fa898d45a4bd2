# SPDX-License-Identifier: GPL-3.0-or-later
"""Methods where guiding is known to fail, at Blender's own settings: clamped, filtered, and stopped by the noise.

`tests/benchmarks/test_stability.py` has no clamp, so that nothing hides a bias. Here methods must not change what is
clamped away (docs/decisions/clamping.md): each is compared with unguided pictures of the same settings. These are not
denoised: pixels whose noise is shared would hide how noisy the mean is.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

pytest.importorskip("bpy")

from benchmarks.bias import find_bias
from benchmarks.stability import method_settings, render_case
from benchmarks.stability_cases import CASES, describe_case
from benchmarks.stability_figures import LEAST_BIAS

#: Blender's, as far as the engine reads them and pictures without denoising have them.
DEFAULTS: dict[str, Any] = {
    "clamp_indirect": 10.0, "filter_glossy": 1.0, "use_adaptive_sampling": True, "adaptive_threshold": 0.01,
}  # fmt: skip
#: Of the first the clamp takes 2% of the light; of the second the threshold stops pixels.
NAMES, SAMPLES = ("fireflies", "colors"), 127
METHODS = ("VMM", "SDTREE", "VMM_RIS", "AUTO", "VMM-CONVERGING")
SEEDS, REFERENCE_SEEDS = range(1, 5), range(1001, 1009)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_methods_are_unbiased_at_blenders_defaults(name: str) -> None:
    description, base = describe_case(CASES[name], threads=1)
    base = replace(base, samples=SAMPLES, **DEFAULTS)

    def images(settings: Any, seeds: range) -> list[Any]:
        return [render_case(description, replace(settings, seed=seed)).image for seed in seeds]

    references = images(method_settings("OFF", base, forced=False), REFERENCE_SEEDS)
    found = []
    for method in METHODS:
        bias = find_bias(images(method_settings(method, base, forced=method != "AUTO"), SEEDS), references)
        print(f"{name} {method}: {bias}")
        if bias.is_biased or bias.detectable > LEAST_BIAS:
            found.append(f"{method}: {bias}")
    assert not found
