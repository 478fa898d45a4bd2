# SPDX-License-Identifier: GPL-3.0-or-later
"""Judges random scenes: `python -m tests.helpers.fuzz 17`, or `… 1000 6000 --keep out/fuzz` for a range.

It keeps the .blend and both pictures side by side for each scene that fails, and for a single one.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np

import addon
from tests.helpers.fuzz.judge import Verdict, judge


def main() -> int:
    """Command line."""
    about = (__doc__ or "").partition("\n")[0]
    parser = argparse.ArgumentParser(prog="python -m tests.helpers.fuzz", description=about)
    parser.add_argument("first", type=int, help="the scene's seed, or the first of a range")
    parser.add_argument("end", type=int, nargs="?", help="the seed after the last")
    parser.add_argument("--keep", type=Path, default=Path("out/fuzz"), help="where to keep what fails")
    chosen = parser.parse_args()
    addon.register()
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        seeds = range(chosen.first, chosen.first + 1 if chosen.end is None else chosen.end)
        for seed in seeds:
            with _quiet():
                verdict = judge(seed, Path(folder))
            if verdict.problems or chosen.end is None:
                print(seed, *verdict.problems, *(f"({notice})" for notice in verdict.notices), sep="; ", flush=True)
                _keep(verdict, chosen.keep)
            failed += bool(verdict.problems)
    print(f"{failed} of {len(seeds)} scenes fail")
    return int(failed > 0)


@contextlib.contextmanager
def _quiet():  # type: ignore[no-untyped-def]
    """Without what Blender and renders print."""
    sys.stdout.flush()
    kept, nothing = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nothing)


def _keep(verdict: Verdict, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with _quiet():
        bpy.ops.wm.save_as_mainfile(filepath=str((folder / f"{verdict.seed}.blend").resolve()), copy=True)
        pictures = [image for image in (verdict.ours, verdict.theirs) if image is not None]
        if not pictures:
            return
        pixels = np.concatenate([image.repeat(16, 0).repeat(16, 1)[::-1] for image in pictures], axis=1)
        pixels[..., :3] = np.clip(np.nan_to_num(pixels[..., :3]), 0.0, 1.0) ** (1.0 / 2.2)
        pixels[..., 3] = 1.0
        shown = bpy.data.images.new("Pair", pixels.shape[1], pixels.shape[0])
        shown.pixels.foreach_set(pixels.astype(np.float32).ravel())
        shown.filepath_raw, shown.file_format = str((folder / f"{verdict.seed}.png").resolve()), "PNG"
        shown.save()


if __name__ == "__main__":
    sys.exit(main())
