# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks.luxcore`: LuxCore beside Cycles and ours, at equal seconds, by the error to a reference.

`pyluxcore` is no part of this project. Install it by
`python -m pip install --no-deps --target out/pyluxcore pyluxcore`.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import environment
from benchmarks.images import Float32Array, write_exr
from benchmarks.luxcore.export import export_scene
from benchmarks.luxcore.properties import LuxScene, Properties
from benchmarks.luxcore.rows import HEADER, row
from benchmarks.reference import Reference, load_reference
from benchmarks.rendering import RenderRecord, render_scene
from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import SceneSource, expand, open_scene
from benchmarks.tables import table

#: Scenes that mean the same in LuxCore.
SCENES = ("builtin:caustic-glass-matte", "builtin:caustic-ball-matte")
#: Radius of photons in LuxCore, in pixels; how far it shrinks.
_PHOTON_RADIUS, _LEAST_PHOTON_RADIUS = 1.5, 0.3
#: Paths that look where photons are wanted, and photons, by second of the render: by its defaults it is not ready then.
_LOOKS_A_SECOND, _PHOTONS_A_SECOND = 2500, 25_000
_BIDIR: Properties = {"renderengine.type": "BIDIRCPU", "sampler.type": "METROPOLIS"}
_PATH: Properties = {"renderengine.type": "PATHCPU", "sampler.type": "SOBOL"}
_PHOTONS: Properties = {**_PATH, "path.photongi.caustic.enabled": True, "path.photongi.indirect.enabled": False}
_HYBRID: Properties = {**_PATH, "path.hybridbackforward.enable": True}
#: LuxCore's ways, with its defaults but for what `configuration` adds.
ENGINES: dict[str, Properties] = {
    "luxcore-path": _PATH, "luxcore-bidir": _BIDIR, "luxcore-photons": _PHOTONS, "luxcore-hybrid": _HYBRID,
}  # fmt: skip


def configuration(engine: str, scene: LuxScene, seed: int, threads: int, bounces: int, seconds: float) -> Properties:
    """LuxCore's properties of a render: as many bounces as Blender's, nothing clamped, no tone mapping."""
    film = {name: value for name, value in scene.properties.items() if name.startswith("film.")}
    depths = {f"path.pathdepth.{kind}": bounces + 1 for kind in ("total", "diffuse", "glossy", "specular")}
    radii = {}
    if engine == "luxcore-photons":
        radii = {
            "path.photongi.caustic.lookup.radius": _PHOTON_RADIUS * scene.footprint,
            "path.photongi.caustic.updatespp.minradius": _LEAST_PHOTON_RADIUS * scene.footprint,
            "path.photongi.photon.maxdepth": bounces + 1,
            "path.photongi.visibility.maxsamplecount": round(_LOOKS_A_SECOND * seconds),
            "path.photongi.photon.maxcount": round(_PHOTONS_A_SECOND * seconds),
        }
    return {
        **film, **depths, **radii, **ENGINES[engine], "path.maxdepth": bounces + 1, "light.maxdepth": bounces + 1,
        "path.clamping.variance.maxvalue": 0.0, "renderengine.seed": seed, "native.threads.count": threads,
        "film.imagepipelines.0.0.type": "NOP",
    }  # fmt: skip


def render_luxcore(
    scene: LuxScene, config: Properties, seconds: float, luxcore: Path
) -> tuple[Float32Array, dict[str, Any]]:
    """Render in a process of its own.

    Parameters
    ----------
    luxcore : path
        Where `pyluxcore` was installed to.

    Returns
    -------
    image : float32 (height, width, 3), row 0 at the top
    facts : dict, 'seconds' and 'preparation' [s], 'samples' a pixel and 'version'

    Raises
    ------
    ValueError
        If `pyluxcore` is not there.
    RuntimeError
        With what the process said last, if it failed.
    """
    if not (luxcore / "pyluxcore").is_dir():
        install = f"python -m pip install --no-deps --target {luxcore} pyluxcore"
        raise ValueError(f"no pyluxcore in {luxcore}: {install}, or --luxcore FOLDER")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        parts = ("points", "triangles", "normals")
        arrays = {
            f"{mesh}.{part}": array
            for mesh, found in scene.meshes.items()
            for part, array in zip(parts, found, strict=True)
        }
        np.savez(folder / "meshes.npz", **arrays)
        np.savez(folder / "images.npz", **scene.images)
        described = {key: value for key, value in scene.properties.items() if key.startswith("scene.")}
        job = {"scene": described, "config": config, "meshes": list(scene.meshes), "seconds": seconds}
        (folder / "scene.json").write_text(json.dumps(job), encoding="utf-8")
        root = Path(__file__).parents[2]
        paths = os.pathsep.join([str(root), str(luxcore.resolve())])
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.luxcore.process", str(folder)], capture_output=True, text=True,
            env={**os.environ, "PYTHONPATH": paths}, cwd=root, check=False,
        )  # fmt: skip
        if done.returncode or not (folder / "result.json").is_file():
            lines = (done.stderr or done.stdout).strip().splitlines() or [f"exit status {done.returncode}"]
            raise RuntimeError(f"LuxCore failed: {lines[-1]}")
        facts: dict[str, Any] = json.loads((folder / "result.json").read_text("utf-8"))
        return np.load(folder / "image.npy"), facts


def _reference(folder: Path, scene: str) -> Reference:
    found = load_reference(folder, scene)
    if found is None:
        raise ValueError(f"no reference of {scene} in {folder}: python -m benchmarks.light_tracing")
    return found


def compare(
    source: SceneSource, rivals: Sequence[str], seconds: float, seeds: int, *, references: Sequence[Path],
    luxcore: Path, out: Path, threads: int, pixels: int = 0, first_seed: int = 1,
) -> list[list[float | int | str | None]]:  # fmt: skip
    """Rows of the table of a scene, of ours, Cycles' and LuxCore's rivals.

    Parameters
    ----------
    references : sequence of path
        Folders of none, one or two.
    pixels : int
        Size without a reference, about; 0 leaves the scene's.

    Raises
    ------
    ValueError, RuntimeError
        Without a reference, or what LuxCore would not show alike, or what failed.
    """
    found = [_reference(folder, source.name) for folder in references]
    size = (found[0].image.shape[1], found[0].image.shape[0]) if found else None
    truths = [reference.image for reference in found]
    scene = open_scene(source, pixels, size)
    size, bounces = (scene.render.resolution_x, scene.render.resolution_y), scene.cycles.max_bounces
    exported = export_scene(scene)
    threads = threads or environment.thread_count()
    unknown = [name for name in rivals if name.startswith("luxcore") and name not in ENGINES]
    if unknown:
        raise ValueError(f"no rival {unknown[0]!r}; of LuxCore there are: {', '.join(ENGINES)}")

    def check(record: RenderRecord) -> None:
        for reference in found:
            reference.require(record)

    others = [find_rival(name) for name in rivals if name not in ENGINES]
    renders, failures = render_scene(
        source, others, Budget(0, seconds), seeds, out=out, size=size, threads=threads, check=check,
        first_seed=first_seed,
    )  # fmt: skip
    if failures:
        raise RuntimeError(f"{failures[0].rival}: {failures[0].message}")
    rows = {
        name: row(
            source.name, name, [render.image for render in done], [render.record.render_seconds for render in done],
            [render.record.samples for render in done], truths,
        )
        for name, done in renders.items()
    }  # fmt: skip
    for name in (name for name in rivals if name in ENGINES):
        images, facts = [], []
        for seed in range(first_seed, first_seed + seeds):
            config = configuration(name, exported, seed, threads, bounces, seconds)
            image, fact = render_luxcore(exported, config, seconds, luxcore)
            write_exr(out / source.name / f"{name}_{seconds:g}s_seed{seed}.exr", image)
            images.append(image)
            facts.append(fact)
        spent, samples = ([fact[key] for fact in facts] for key in ("seconds", "samples"))
        rows[name] = row(source.name, name, images, spent, samples, truths)
    return [rows[name] for name in rivals]


def main(arguments: Sequence[str] | None = None) -> int:
    """Render and print a table; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.luxcore", description=__doc__)
    parser.add_argument("scenes", nargs="*", default=list(SCENES), help=".blend files or builtin:NAME (default: two)")
    rivals = ["cycles", "OFF", "AUTO-AUTO", *ENGINES]
    parser.add_argument("--rivals", nargs="+", default=rivals, help=f"(default: {' '.join(rivals)})")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each render (default: %(default)g)")
    parser.add_argument("--seeds", type=int, default=3, help="(default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=1, help="others for pictures that are to be references")
    parser.add_argument("--threads", type=int, default=0, help="0 = all cores")
    parser.add_argument("--references", type=Path, nargs="*", default=[], help="one folder of NAME.exr, or two")
    parser.add_argument("--pixels", type=int, default=0, help="scale scenes to about so many, without references")
    parser.add_argument("--luxcore", type=Path, default=Path("out/pyluxcore"), help="folder that has pyluxcore")
    parser.add_argument("--out", type=Path, default=Path("out/luxcore"), help="folder for pictures")
    chosen = parser.parse_args(arguments)
    rows = []
    try:
        for source in expand(chosen.scenes):
            rows += compare(
                source, chosen.rivals, chosen.seconds, chosen.seeds, references=chosen.references,
                luxcore=chosen.luxcore, out=chosen.out, threads=chosen.threads, pixels=chosen.pixels,
                first_seed=chosen.first_seed,
            )  # fmt: skip
    except (ValueError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(table(HEADER, rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
