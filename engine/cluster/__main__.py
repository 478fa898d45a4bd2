# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m engine.cluster tcp://HOST:PORT`: makes this machine a worker of the scheduler there."""

from __future__ import annotations

import argparse
import os
import sys

from engine.cluster.pool import ClusterError
from engine.cluster.work import THREADS_VARIABLE


def main() -> int:
    """Run a worker; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m engine.cluster", description=__doc__)
    parser.add_argument("address", help="of the scheduler: tcp://HOST:PORT or tls://HOST:PORT")
    parser.add_argument(
        "--host", help="address of this machine to listen on; default: the one that it reaches the scheduler from"
    )
    parser.add_argument(
        "--trust-network", action="store_true",
        help="listen to other machines without TLS: whoever reaches this worker runs code as this user",
    )
    parser.add_argument("--threads", type=int, default=0, help="to trace with; 0: as many as the scene's settings say")
    parser.add_argument("--name", help="under which the scheduler lists this worker")
    arguments = parser.parse_args()
    os.environ[THREADS_VARIABLE] = str(arguments.threads)
    try:
        from engine.cluster.dask_pool import run_worker
    except ModuleNotFoundError as error:
        problem = f"Python package {error.name} is missing: install the package distributed"
        print(f"NeuralGuide: Error: {problem}", file=sys.stderr)
        return 2
    try:
        run_worker(
            arguments.address, arguments.host, arguments.name, trusts_network=arguments.trust_network,
            on_listening=lambda address: print(f"NeuralGuide: this worker listens on {address}", flush=True),
        )
    except ClusterError as error:
        print(f"NeuralGuide: Error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
