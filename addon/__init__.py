# SPDX-License-Identifier: GPL-3.0-or-later
"""The Blender side of NeuralGuide: hooks of the render engine, panels, operators, passes and the command line."""

from __future__ import annotations

import os


def _use_extension_folder() -> None:
    """As an extension, keep compiled kernels in the folder Blender gives us (updates delete anything else)."""
    parent = (__package__ or "").rpartition(".")[0]
    if parent.startswith("bl_ext.") and not os.environ.get("NEURALGUIDE_KERNEL_CACHE"):
        import bpy

        # Whether it can be written is the cache's business.
        os.environ["NEURALGUIDE_KERNEL_CACHE"] = bpy.utils.extension_path_user(parent, path="kernels", create=False)


def _modules() -> list:  # type: ignore[type-arg]
    from . import (
        bug_report,
        denoise_after_render,
        engine,
        kept_frames,
        kept_frames_operator,
        last_render,
        learned_fields,
        light_mix_files,
        light_mix_lamps,
        light_mix_operator,
        light_mix_panel,
        light_mix_picture,
        log,
        make_light_groups,
        operators,
        preferences,
        properties,
        saved_settings,
        sequence,
        sequence_operator,
        ui,
        warm_up,
    )
    from .viewport import windows

    return [
        log, properties, saved_settings, engine, sequence, kept_frames, kept_frames_operator, learned_fields,
        operators, sequence_operator, denoise_after_render, light_mix_picture, light_mix_files, light_mix_lamps,
        light_mix_operator, make_light_groups, ui, light_mix_panel, last_render, bug_report, preferences, warm_up,
        windows,
    ]  # fmt: skip


_registered: list = []  # type: ignore[type-arg]


def register(addon_module: str = "addon") -> None:
    """Make NeuralGuide available in this process; does nothing where it already is.

    Parameters
    ----------
    addon_module : str
        The module that Blender knows as the add-on, whose preferences ours are.

    Raises
    ------
    ImportError
        Packages are missing. Blender shows the message, and does not enable the add-on.
    """
    if _registered:
        return
    from .packages import missing_packages

    if problem := missing_packages():
        raise ImportError(problem)
    from .preferences import NeuralGuidePreferences

    NeuralGuidePreferences.bl_idname = addon_module
    _use_extension_folder()
    for module in _modules():
        module.register()
        _registered.append(module)


def unregister() -> None:
    """Take it away again."""
    while _registered:
        _registered.pop().unregister()
