# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of layers that have light groups: what a mix is made of, whether it can be made, and the file with the mix."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt

from . import light_mix
from .exr_layers import LayeredImage, LayersError
from .light_mix_passes import Mixer, Noted

Float32Array = npt.NDArray[np.float32]

#: Factors by group.
Mix = Mapping[str, light_mix.Factor]


def mix_in(image: LayeredImage) -> Mix:
    """The mix that a file's metadata has from its render.

    Raises
    ------
    LayersError
        If there is none, or it makes no sense.
    """
    text = image.metadata(light_mix.FIELD)
    if not text:
        raise LayersError(f"{image.path} says no light mix: it was rendered without light groups, or by another engine")
    try:
        return light_mix.from_text(text)
    except ValueError as error:
        raise LayersError(f"{image.path}: {error}") from None


def check_mix(image: LayeredImage, mix: Mix) -> None:
    """Look whether a file can be mixed.

    Raises
    ------
    LayersError
        If it has no light groups, lacks one that the mix changes, or is mixed already.
    """
    from engine.render.light_mix import checked_factors, missing_groups

    layers = image.layers()
    if not layers:
        raise LayersError(f"{image.path} has no pass Combined: render frames as OpenEXR MultiLayer")
    if image.metadata(light_mix.APPLIED_FIELD):
        raise LayersError(f"{image.path} is mixed already: choose frames as they were rendered")
    known = [group for layer in layers for group in rendered_groups(image, layer)]
    if not known:
        raise LayersError(
            f"{image.path} has no light groups: put lamps into groups in the view layer's properties, under Passes, "
            "and render again as OpenEXR MultiLayer"
        )
    try:
        checked_factors(mix)
    except ValueError as error:
        raise LayersError(f"{image.path}: {error}") from None
    if missing := missing_groups(mix, known):
        raise LayersError(
            f"{image.path} was rendered without light group {', '.join(missing)}, which is in the mix: there are "
            f"{', '.join(dict.fromkeys(known))}. Set its factor to 1, or render again"
        )


def mix_layers(image: LayeredImage, mix: Mix, threads: int = 0) -> LayeredImage:
    """A file with its view layers mixed, and with metadata that says so.

    Raises
    ------
    LayersError
        As `check_mix`, or if it takes a denoiser and there is none.
    """
    check_mix(image, mix)
    known: list[str] = []
    for layer in image.layers():
        groups = rendered_groups(image, layer)
        known += groups
        image = _mix_layer(image, layer, {group: mix.get(group, light_mix.NEUTRAL) for group in groups}, threads)
    applied = {group: mix.get(group, light_mix.NEUTRAL) for group in known}
    return image.stamped(light_mix.APPLIED_FIELD, light_mix.to_text(applied))


def _mix_layer(image: LayeredImage, layer: str, mix: Mix, threads: int) -> LayeredImage:
    from engine.denoise.library import problem
    from engine.render.light_mix import changes, mixed

    if not changes(mix):
        return image
    passes = layer_passes(image, layer, changes(mix))
    if passes.picture is None:
        return image
    if passes.sampled is not None and (text := problem()):
        raise LayersError(f"{image.path} is denoised, and so its light groups have to be: {text}")
    picture = Mixer(passes, threads).picture(mix)[..., :3]
    image = image.changed(layer, "Combined", "RGB", picture)
    if image.find(layer, "Noisy Image", "RGB") is None:
        return image
    noisy = picture if passes.sampled is None else mixed(passes.sampled, passes.groups, mix)
    return image.changed(layer, "Noisy Image", "RGB", noisy)


def layer_passes(image: LayeredImage, layer: str, needed: Iterable[str] | None = None) -> Noted:
    """Passes of a view layer that a mix is made of, as a file has them.

    Parameters
    ----------
    image : LayeredImage
    layer : str
    needed : iterable of str, optional
        Groups that a mix changes; without it all are read, and so they are where the picture is denoised.
    """
    picture = image.image(layer, "Combined", "RGB")
    if picture is None:
        return Noted()
    alpha = image.image(layer, "Combined", "A")
    whole = np.concatenate([picture, np.ones_like(picture[..., :1]) if alpha is None else alpha], axis=-1)
    sampled = image.image(layer, "Noisy Image", "RGB")
    if sampled is not None and np.array_equal(sampled, picture, equal_nan=True):
        sampled = None
    groups = rendered_groups(image, layer)
    if needed is not None and sampled is None:
        groups = [group for group in groups if group in {*needed}]
    noted = Noted(whole, {group: _light(image, layer, group) for group in groups}, sampled=sampled)
    if sampled is not None:
        noted.albedo = image.image(layer, "Denoising Albedo", "RGB")
        noted.normal = image.image(layer, "Denoising Normal", "XYZ")
    return noted


def _light(image: LayeredImage, layer: str, group: str) -> Float32Array:
    """Light of a group as it is in Combined."""
    from engine.render.light_mix import without_background

    light = image.image(layer, light_mix.PASS_PREFIX + group, "RGB")
    assert light is not None
    environment = None
    if group == image.metadata(light_mix.BACKGROUND_FIELD.format(layer=layer)):
        environment = _environment(image, layer)
    return light if environment is None else without_background(light, environment)


def _environment(image: LayeredImage, layer: str) -> Float32Array | None:
    """The pass Environment, which Blender before 5.0 calls Env."""
    for name in ("Environment", "Env"):
        environment = image.image(layer, name, "RGB")
        if environment is not None:
            return environment
    return None


def rendered_groups(image: LayeredImage, layer: str) -> list[str]:
    """Light groups that a file has passes of."""
    names = [name for name in image.passes(layer) if name.startswith(light_mix.PASS_PREFIX)]
    return [
        name.removeprefix(light_mix.PASS_PREFIX) for name in names if image.find(layer, name, "RGB") is not None
    ]
