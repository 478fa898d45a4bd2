# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks.backends`: what asking a network costs, by the kernel and by onnxruntime, by width and batch.

Both are asked the same rows in turns on one thread, and the least time that the thread was at it counts: a busy machine
only adds to it. onnxruntime is asked on the processor: a GPU works beside the thread, and cannot be timed so.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.tables import table
from engine.guiding.neural.models.network_backend import kernel_call, least_seconds, make_probe, session_call
from engine.guiding.neural.networks.mixture import shape as mixtures
from engine.guiding.neural.networks.mixture.inference import (
    allocate_mixture_scratch,
    evaluate_mixtures,
    make_mixture_network,
)
from engine.guiding.neural.networks.mixture.shape import MixtureShape
from engine.guiding.neural.networks.onnx_files.files import StoredNetwork, network_to_onnx
from engine.guiding.neural.networks.onnx_session import RadianceSession, RuntimeProviders
from engine.guiding.neural.networks.radiance import COMPACT_SHAPE, NetworkShape, Snapshot, initial_parameters
from engine.guiding.neural.networks.radiance_query import make_network_field

#: Rows of a batch; a round of a thread has up to 4096 candidates.
BATCHES = (16, 64, 256, 1024, 4096)
#: Networks by name, in all widths that kernels take. Mixtures are asked once a vertex.
RADIANCE = {
    **{f"compact grids, {width} wide": replace(COMPACT_SHAPE, width=width) for width in (32, 64, 128)},
    **{f"paper's grids, {width} wide": NetworkShape(width=width) for width in (32, 64, 128)},
}
MIXTURES = {
    "NPM, 64 wide": mixtures.NPM,
    "NASG, 128 wide": mixtures.NASG,
    "NASG, 256 wide": replace(mixtures.NASG, width=256),
}
NETWORKS: dict[str, NetworkShape | MixtureShape] = {**RADIANCE, **MIXTURES}

_BOUNDS = np.array(((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)), np.float32)
#: Rows that each is asked in all, and turns at least and at most.
_ROWS, _TURNS = 1 << 18, (60, 1000)


@dataclass(frozen=True)
class Cost:
    """Time a row [us] of a network in batches of so many rows, by kernel and by onnxruntime."""

    network: str
    batch: int
    kernel: float
    runtime: float


def _mixture_calls(shape: MixtureShape, batch: int) -> list[Callable[[], bool]]:
    """Calls of kernel and onnxruntime; mixtures are not asked by sessions in a render."""
    import onnxruntime

    snapshot = Snapshot(1, 1, 0.0, 1.0, _BOUNDS, mixtures.initial_parameters(shape, 0))
    network, scratch = make_mixture_network(shape, snapshot), allocate_mixture_scratch(shape)
    probe = make_probe(_BOUNDS, batch, 1)
    points = (probe.positions, probe.directions, -probe.directions, probe.time, probe.hero)
    raw = np.zeros((batch, shape.output_width), np.float32)

    def by_kernel() -> bool:
        evaluate_mixtures(network, *points, batch, scratch, raw)
        return True

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = onnxruntime.InferenceSession(
        network_to_onnx(StoredNetwork(shape, snapshot)), options, providers=["CPUExecutionProvider"]
    )
    binding, feeds = session.io_binding(), dict(zip(("position", "normal", "wo", "roughness", "u"), points))
    for name in (item.name for item in session.get_inputs()):
        array = feeds[name]
        binding.bind_input(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
    binding.bind_output("raw", "cpu", 0, np.float32, raw.shape, raw.ctypes.data)

    def by_runtime() -> bool:
        session.run_with_iobinding(binding)
        return True

    return [by_kernel, by_runtime]


def _radiance_calls(shape: NetworkShape, batch: int, per_vertex: int) -> list[Callable[[], bool]]:
    providers = RuntimeProviders(["CPUExecutionProvider"])
    snapshot = Snapshot(1, 1, 0.0, 1.0, _BOUNDS, initial_parameters(shape, 0))
    session = RadianceSession(providers, shape, snapshot)
    if not session.provider:
        raise SystemExit(f"{providers.failures[0].what}: {providers.failures[0].why}")
    probe = make_probe(_BOUNDS, batch, per_vertex)
    out = np.zeros((batch, shape.channel_count), np.float32)
    return [kernel_call(make_network_field(shape, snapshot), probe, out), session_call(session, probe, out)]


def measure(name: str, batch: int, per_vertex: int = 4) -> Cost:
    """Time both on one network of `NETWORKS`."""
    shape = NETWORKS[name]
    if isinstance(shape, NetworkShape):
        calls = _radiance_calls(shape, batch, per_vertex)
    else:
        calls = _mixture_calls(shape, batch)
    least, most = _TURNS
    seconds = least_seconds(calls, max(least, min(most, _ROWS // batch)), time.thread_time)
    return Cost(name, batch, *(1e6 * one / batch for one in seconds))


def describe(costs: Sequence[Cost]) -> str:
    """Costs as a table in Markdown: kernel and onnxruntime [us a row], a line a network."""
    batches = sorted({cost.batch for cost in costs})
    found = {(cost.network, cost.batch): f"{cost.kernel:.2f}, {cost.runtime:.2f}" for cost in costs}
    rows = [
        [name, *(found[name, batch] for batch in batches)] for name in dict.fromkeys(cost.network for cost in costs)
    ]
    return table(["network", *map(str, batches)], rows)


def draw(costs: Sequence[Cost], path: Path) -> None:
    """Time a row against the batch, a panel a kind of network: kernels' lines are solid, onnxruntime's dashed."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    kinds = list(dict.fromkeys(cost.network.split(",")[0] for cost in costs))
    figure = Figure(figsize=(3.6 * len(kinds), 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(kinds), sharey=True, squeeze=False)[0]
    for panel, kind in zip(panels, kinds):
        names = [name for name in dict.fromkeys(cost.network for cost in costs) if name.split(",")[0] == kind]
        for index, name in enumerate(names):
            mine = sorted((cost for cost in costs if cost.network == name), key=lambda cost: cost.batch)
            batches, color = [cost.batch for cost in mine], f"C{index}"
            width = name.split(", ")[1]
            panel.plot(batches, [cost.kernel for cost in mine], "o-", color=color, label=f"kernel, {width}")
            panel.plot(batches, [cost.runtime for cost in mine], "s--", color=color, label=f"onnxruntime, {width}")
        panel.set(title=kind, xscale="log", yscale="log", xlabel="rows of a batch")
        panel.set_xticks(batches, [str(batch) for batch in batches])
        panel.minorticks_off()
        panel.grid(alpha=0.3)
        panel.legend(fontsize=7)
    panels[0].set_ylabel("time a row [us]")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.backends", description="What asking a network costs by kernel and by onnxruntime."
    )
    parser.add_argument("--networks", nargs="+", default=list(NETWORKS), choices=NETWORKS, metavar="NAME")
    parser.add_argument("--batches", nargs="+", type=int, default=list(BATCHES), help="rows (default: %(default)s)")
    parser.add_argument("--per-vertex", type=int, default=4, help="candidates of a vertex (default: %(default)s)")
    parser.add_argument(
        "--output", type=Path, default=Path("out/backends.png"), help="figure; numbers go to .json beside it"
    )
    given = parser.parse_args(arguments)
    costs = [measure(name, batch, given.per_vertex) for name in given.networks for batch in given.batches]
    draw(costs, given.output)
    given.output.with_suffix(".json").write_text(json.dumps([asdict(cost) for cost in costs], indent=1))
    print(describe(costs))
    return 0


if __name__ == "__main__":
    sys.exit(main())
