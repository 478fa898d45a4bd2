# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark of kernel and onnxruntime: it times both, and shows them side by side."""

from __future__ import annotations

import json

import pytest

from benchmarks import backends
from benchmarks.backends import Cost, describe, main


def test_costs_stand_side_by_side():
    costs = [Cost("a, 8 wide", 64, 0.5, 1.0), Cost("a, 8 wide", 16, 0.25, 2.0), Cost("b, 8 wide", 16, 3.0, 4.0)]
    costs.append(Cost("b, 8 wide", 64, 5.0, 6.0))
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in describe(costs).splitlines()]
    assert lines[0] == ["network", "16", "64"]
    assert lines[2] == ["a, 8 wide", "0.25, 2.00", "0.50, 1.00"]
    assert lines[3] == ["b, 8 wide", "3.00, 4.00", "5.00, 6.00"]


@pytest.mark.parametrize("network", ["compact grids, 32 wide", "NASG, 128 wide"])
def test_both_are_timed(network, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(backends, "least_seconds", lambda calls, *_: [float(call()) * 1e-6 for call in calls])
    assert main(["--networks", network, "--batches", "8", "--output", str(tmp_path / "costs.png")]) == 0
    assert (tmp_path / "costs.png").stat().st_size > 1000
    assert json.loads((tmp_path / "costs.json").read_text()) == [
        {"network": network, "batch": 8, "kernel": pytest.approx(1 / 8), "runtime": pytest.approx(1 / 8)}
    ]
    assert "0.12, 0.12" in capsys.readouterr().out
