# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks.luxcore.process FOLDER`: a process that renders with `pyluxcore`, and with nothing of Blender.

It reads `scene.json`, `meshes.npz` and `images.npz` of the folder, and leaves `image.npy`, row 0 at the top, and
`result.json`.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

#: How often it is looked whether the time is over [s].
_LOOK = 0.02


def _properties(lux: Any, values: dict[str, Any]) -> Any:
    made = lux.Properties()
    for name, value in values.items():
        made.Set(lux.Property(name, value))
    return made


def render(folder: Path) -> None:
    """Render the scene in a folder for as many seconds as it says, preparations included."""
    import pyluxcore as lux

    job = json.loads((folder / "scene.json").read_text("utf-8"))
    lux.Init()
    scene = lux.Scene()
    with np.load(folder / "meshes.npz") as arrays:
        for name in job["meshes"]:
            points, triangles, normals = (arrays[f"{name}.{part}"] for part in ("points", "triangles", "normals"))
            rows = [list(map(tuple, part.tolist())) for part in (points, triangles, normals)]
            scene.DefineMesh(name, *rows, None, None, None)
    with np.load(folder / "images.npz") as images:
        for name in images.files:
            height, width, channels = images[name].shape
            scene.DefineImageMap(name, images[name].ravel(), 1.0, channels, width, height)
    scene.Parse(_properties(lux, job["scene"]))
    session = lux.RenderSession(lux.RenderConfig(_properties(lux, job["config"]), scene))
    began = time.perf_counter()
    session.Start()
    started = time.perf_counter() - began
    while time.perf_counter() - began < job["seconds"]:
        time.sleep(_LOOK)
    session.UpdateStats()
    session.Stop()
    seconds = time.perf_counter() - began
    width, height = job["config"]["film.width"], job["config"]["film.height"]
    image = np.zeros((height, width, 3), np.float32)
    session.GetFilm().GetOutputFloat(lux.FilmOutputType.RGB, image)
    np.save(folder / "image.npy", image[::-1])
    samples = session.GetStats().Get("stats.renderengine.pass").GetInt()
    found = {"seconds": seconds, "preparation": started, "samples": samples, "version": lux.Version()}
    (folder / "result.json").write_text(json.dumps(found) + "\n", encoding="utf-8")


if __name__ == "__main__":
    render(Path(sys.argv[1]))
