# SPDX-License-Identifier: GPL-3.0-or-later
"""Scaling: exponents out of timings made up, and one curve measured from end to end."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import scaling
from benchmarks.__main__ import main
from benchmarks.scaling_fit import SCALING_FILE, Curve, curves_of, fit_power


@pytest.mark.parametrize("exponent", [-1.0, 0.0, 0.5, 1.0, 2.0])
def test_exact_powers_are_recovered(exponent: float) -> None:
    xs = [1.0, 10.0, 100.0, 1000.0]
    fit = fit_power(xs, [3.0 * x**exponent for x in xs])
    assert fit.exponent == pytest.approx(exponent, abs=1e-12)
    assert fit.factor == pytest.approx(3.0) and fit.standard_error == pytest.approx(0.0, abs=1e-9)
    assert fit.predict(50.0) == pytest.approx(3.0 * 50.0**exponent)


def test_standard_errors_are_honest_about_noise() -> None:
    xs = np.geomspace(1.0, 1e4, 6)
    rng = np.random.default_rng(4)
    fits = [fit_power(list(xs), list(2.0 * xs**0.7 * np.exp(rng.normal(0.0, 0.1, 6)))) for _ in range(2000)]
    found = np.array([fit.exponent for fit in fits])
    # 0.1 over the root of the spread of log x; the mean of 2000 is good to 0.0002, their deviation to 1.6%.
    deviation = 0.1 / math.sqrt(((np.log(xs) - np.log(xs).mean()) ** 2).sum())
    assert found.mean() == pytest.approx(0.7, abs=5.0 * deviation / math.sqrt(2000))
    assert found.std() == pytest.approx(deviation, rel=0.08)
    # Their squares estimate the variance without bias (4 degrees of freedom: 1.6% over 2000 fits).
    assert np.mean([fit.standard_error**2 for fit in fits]) == pytest.approx(deviation**2, rel=0.08)


def test_what_cannot_be_fitted_is_refused() -> None:
    with pytest.raises(ValueError, match="two different x"):
        fit_power([2.0, 2.0], [1.0, 3.0])
    with pytest.raises(ValueError, match="positive"):
        fit_power([1.0, 2.0], [1.0, 0.0])
    two = fit_power([1.0, 2.0], [8.0, 4.0])
    assert two.exponent == pytest.approx(-1.0) and math.isnan(two.standard_error) and str(two) == "exponent -1.00"


def test_curves_survive_json() -> None:
    curve = Curve("lights", "OFF", "lights", "ns per ray", [1.0, 2.0, 4.0], [5.0, 6.0, 7.5])
    assert curves_of(json.loads(json.dumps({"curves": [curve.stored()]}))) == [curve]


def test_costs_are_medians_of_what_reports_say() -> None:
    def report(seconds: float) -> SimpleNamespace:
        return SimpleNamespace(render_seconds=seconds, sample_count=4.0, thread_count=2, rays={"a": 600, "b": 400})

    reports = [report(2.0), report(4.0), report(100.0)]
    assert scaling.seconds_per_sample(reports) == 1.0
    assert scaling.nanoseconds_per_ray(reports) == pytest.approx(1e9 * 4.0 * 2 / 1000)


def test_thinning_keeps_both_ends() -> None:
    assert scaling.Effort(1.0, 1, 2).thin([1, 2, 4, 8, 16, 32]) == [1, 4, 16, 32]
    assert scaling.Effort(1.0, 1, 1).thin([1, 2, 4]) == [1, 2, 4]


def test_asking_larger_networks_costs_more(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scaling", "--quick", "--only", "network", "--threads", "1", "--out", str(tmp_path)]) == 0
    assert "network size" in capsys.readouterr().out
    stored = json.loads((tmp_path / SCALING_FILE).read_text(encoding="utf-8"))
    curve = stored["curves"][0]
    assert curve["ys"][-1] > curve["ys"][0] > 0.0 and 0.2 < curve["exponent"] < 1.5
    assert main(["scaling", "--only", "weather"]) == 2
    assert "no scaling with weather" in capsys.readouterr().err


def test_scenes_grow_as_asked(blender) -> None:
    from benchmarks.scenes import growing

    assert growing.terrain(1000) == 968
    assert len(blender.data.meshes["Hills"].polygons) == 968
    growing.lamps(50)
    assert len(blender.data.meshes["Lamps"].polygons) == 50


@pytest.mark.slow
def test_depth_is_measured_from_end_to_end(blender) -> None:
    curves = scaling.depth_curves(scaling.Effort(0.2, 1, 3), 1)
    # Nothing leaves the room and nothing absorbs: each scattering costs about the same.
    assert 0.4 < curves[0].fit.exponent < 1.2
