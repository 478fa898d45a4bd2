# SPDX-License-Identifier: GPL-3.0-or-later
"""Records what Cycles gives: `python -m tests.helpers.parity`, for all that is not current (all: an hour)."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from tests.helpers.parity import recorded
from tests.helpers.parity.scenes import COMPARISONS


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.helpers.parity", description=(__doc__ or "").strip())
    parser.add_argument("comparisons", nargs="*", help="those to record; none: all", metavar="COMPARISON")
    parser.add_argument("--again", action="store_true", help="what is current too")
    parser.add_argument("--seeds", type=int, default=recorded.SEEDS, help="pictures of a scene, 2 or more")
    chosen = parser.parse_args()
    names = [comparison.name for comparison in COMPARISONS]
    if unknown := sorted({*chosen.comparisons} - {*names}):
        parser.error(f"no comparison {', '.join(unknown)}; there are: {', '.join(names)}")
    version = recorded.blender_version()
    for comparison in COMPARISONS:
        if chosen.comparisons and comparison.name not in chosen.comparisons:
            continue
        known = recorded.read(comparison)
        is_kept = known["blender"] == version and not chosen.again
        scenes = {name: record for name, record in known["scenes"].items() if is_kept and name in comparison.scenes}
        for scene in comparison.scenes:
            if recorded.is_current(comparison, scene, scenes.get(scene)):
                continue
            with tempfile.TemporaryDirectory() as folder:
                images = comparison.render(scene, "cycles", chosen.seeds, Path(folder))
            scenes[scene] = recorded.as_record(comparison, scene, recorded.grid_means(images))
            recorded.write(comparison, version, scenes)
            print(f"{comparison.name}: {scene}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
