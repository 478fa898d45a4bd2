# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders Blender's cube with passes of ours and reads them from the file: `python -m examples.read_passes`.

Unlike the other examples this one needs `bpy`, and the package OpenEXR.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
import OpenEXR

import addon


def render_passes(path: Path) -> None:
    """Render the scene that Blender begins with into an EXR file of many layers."""
    addon.register()
    bpy.ops.wm.read_factory_settings()
    scene = bpy.context.scene
    render, layer = scene.render, scene.view_layers[0]
    render.engine = "NEURALGUIDE"
    render.resolution_x, render.resolution_y, render.resolution_percentage = 96, 54, 100
    scene.neuralguide.samples = 64
    # Passes of ours are the view layer's; others are Blender's own switches.
    layer.neuralguide.use_pass_albedo = True
    layer.neuralguide.use_pass_sample_count = True
    layer.neuralguide.use_pass_variance = True
    layer.use_pass_normal = True
    image = render.image_settings
    if hasattr(image, "media_type"):  # Blender 5.0 and later
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"
    render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    print(f"wrote {path}")


def read_passes(path: Path, layer: str = "ViewLayer") -> dict[str, np.ndarray]:
    """Passes of a view layer by name, float32 (height, width, channels), row 0 at the top.

    Channels are in the order in which Blender has them: R, G, B, A or X, Y, Z, W.
    """
    order = "RGBAXYZWUV"
    channels: dict[str, dict[str, np.ndarray]] = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            for name, channel in part.channels.items():
                # "ViewLayer.Variance.R"
                view_layer, _, rest = name.partition(".")
                render_pass, _, letter = rest.rpartition(".")
                if view_layer == layer:
                    channels.setdefault(render_pass, {})[letter] = np.array(channel.pixels, np.float32)
    return {
        name: np.stack([found[letter] for letter in sorted(found, key=order.index)], axis=-1)
        for name, found in channels.items()
    }


def main(folder: Path = Path("out/examples")) -> dict[str, np.ndarray]:
    """Render, read, and say where the picture is noisy; the passes."""
    path = folder.resolve() / "passes.exr"
    path.parent.mkdir(parents=True, exist_ok=True)
    render_passes(path)
    passes = read_passes(path)
    for name, image in sorted(passes.items()):
        print(f"{name:14} {image.shape[2]} channels, mean {image.mean():.3f}")

    # The variance is that of a pixel's mean before denoising: its root is the standard error.
    error = np.sqrt(passes["Variance"].mean(axis=2))
    row, column = np.unravel_index(error.argmax(), error.shape)
    count = passes["Sample Count"][row, column, 0]
    print(f"the noisiest pixel is in row {row} from the top, column {column}: "
          f"off by about {error[row, column]:.3f} after {count:g} samples")  # fmt: skip
    return passes


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
