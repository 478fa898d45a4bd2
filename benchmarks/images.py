# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading float EXR files and showing them: row 0 is the top, as in the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Float32Array = npt.NDArray[np.float32]


def _assemble(channels: dict[str, Any]) -> Float32Array:
    """RGBA from the channels of one part, whether OpenEXR grouped them ("RGBA") or not ("R", "G", ...)."""
    for group in ("RGBA", "RGB"):
        if group in channels:
            return np.asarray(channels[group].pixels, np.float32)
    return np.stack([np.asarray(channels[name].pixels, np.float32) for name in "RGBA" if name in channels], axis=-1)


def read_exr(path: Path | str, layer: str = "Combined") -> tuple[Float32Array, dict[str, Any]]:
    """One layer of an EXR file and the header of its part.

    Parameters
    ----------
    path : path
        A plain RGB(A) file or a multi-layer one, of one part or many.
    layer : str
        A pass by the end of its name ("Combined" of "ViewLayer.Combined"); plain channels count as "Combined".

    Returns
    -------
    pixels : float32 (height, width, channels)
    header : dict
    """
    import OpenEXR

    with OpenEXR.File(str(path)) as file:
        for part in file.parts:
            header = dict(part.header)
            is_whole_part = str(header.get("name", "")).endswith(f".{layer}") or str(header.get("name", "")) == layer
            plain: dict[str, Any] = {}
            for name, channel in part.channels.items():
                prefix, _, component = str(name).rpartition(".")
                if prefix.endswith(layer) or (not prefix and (layer == "Combined" or is_whole_part)):
                    plain[component] = channel
                elif str(name) == layer or str(name).endswith(f".{layer}"):
                    plain["RGBA"] = channel  # OpenEXR grouped R, G, B, A under the layer's name.
            if plain:
                if set(plain) & {"RGBA", "RGB", "R"}:
                    return _assemble(plain), header
                stacked = np.stack([np.asarray(channel.pixels, np.float32) for channel in plain.values()], axis=-1)
                return stacked, header
    raise ValueError(f"{path} has no layer {layer!r}")


def read_sample_counts(path: Path | str) -> Float32Array:
    """Samples of each pixel of a multi-layer file, float32 (height, width); Cycles' are shares of what it went through.

    Raises
    ------
    ValueError
        If it has no such pass.
    """
    return read_exr(path, "Sample Count")[0][..., 0]


def write_exr(path: Path | str, pixels: Float32Array) -> None:
    """Write float32 (height, width, 3 or 4) as a plain EXR."""
    import OpenEXR

    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    name = "RGBA" if pixels.shape[-1] == 4 else "RGB"
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {name: np.ascontiguousarray(pixels, np.float32)}) as file:
        file.write(str(path))


def auto_exposure(image: Float32Array) -> float:
    """Factor that brings the 90th percentile of the brightest channel to 0.8; 1 for a black image."""
    bright = float(np.percentile(np.nan_to_num(image[..., :3]).max(axis=-1), 90.0))
    return 0.8 / bright if bright > 0.0 else 1.0


def tone_map(image: Float32Array, exposure: float = 1.0) -> npt.NDArray[np.uint8]:
    """Linear RGB times exposure through the sRGB curve, clipped; uint8 (height, width, 3)."""
    linear = np.clip(np.nan_to_num(image[..., :3].astype(np.float64) * exposure), 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.asarray((encoded * 255.0 + 0.5).astype(np.uint8))


def signed_difference(image: Float32Array, reference: Float32Array, full_scale: float) -> npt.NDArray[np.uint8]:
    """Relative difference as colour: red where `image` is brighter, blue where darker, white where equal.

    Differences are relative to the reference plus a tenth of its mean, and saturate at `full_scale`. White where it
    is NaN, and so not known.
    """
    x, r = image[..., :3].astype(np.float64).mean(axis=-1), reference[..., :3].astype(np.float64).mean(axis=-1)
    denominator = np.abs(r) + 0.1 * max(float(np.nanmean(np.abs(r))), 1e-6)
    t = np.clip(np.nan_to_num((x - r) / denominator / full_scale), -1.0, 1.0)
    red, green, blue = 1.0 + np.minimum(t, 0.0), 1.0 - np.abs(t), 1.0 - np.maximum(t, 0.0)
    return np.asarray((np.stack([red, green, blue], axis=-1) * 255.0 + 0.5).astype(np.uint8))
