# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render came to, in figures: in the log and in the picture's metadata."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import bpy

from . import passes
from .log import logger
from .progress import format_count, format_duration

if TYPE_CHECKING:
    from engine.scene.description import Notice, SceneDescription

#: Characters of notices in a file's metadata, at most.
_MOST_CHARACTERS = 4000
#: What the log says of kernels by now.
_said_of_kernels = ""


def log_figures(layer_name: str, frame: int, seconds: float, report: Any) -> None:
    """Put how a view layer's render went into the log; `seconds` is how long it took, export included."""
    from engine.render.report import ENDINGS

    ray_count = sum(report.rays.values())
    logger.info(
        f"{layer_name}, frame {frame}: {'cancelled after' if report.cancelled else 'finished in'} "
        f"{format_duration(seconds)}, {ENDINGS[report.ended_by].lower()}, "
        f"{report.sample_count:.4g} samples, "
        f"{format_count(ray_count)}rays, {format_count(ray_count / max(report.render_seconds, 1e-6))}rays/s, "
        f"peak memory {report.peak_memory / 2**20:.0f} MiB"
    )
    if report.denoise_seconds:
        logger.info(f"denoised in {format_duration(report.denoise_seconds)}")
    if report.denoised_sentence:
        logger.info(report.denoised_sentence)
    for line in report.guiding.lines:
        logger.info(line)
    _log_kernels(report.kernels)


def _log_kernels(said: str) -> None:
    """Say where kernels came from, the first time and whenever there are more."""
    global _said_of_kernels
    if said != _said_of_kernels:
        _said_of_kernels = said
        logger.info(said)


def _stamp(engine: bpy.types.RenderEngine, field: str, value: str) -> None:
    """Write a field of the picture's metadata."""
    # Only the full result's fields reach the file, not those of the part being rendered.
    engine.get_result().stamp_data_add_field(field, value)


def stamp_figures(engine: bpy.types.RenderEngine, layer_name: str, report: Any, notices: Sequence[Notice]) -> None:
    """Write into the file's metadata how a view layer's render went, and what was left out."""
    from engine.render.report import ENDINGS

    for field, value in (
        ("ended_by", ENDINGS[report.ended_by]),
        ("samples", f"{report.sample_count:.6g}"),
        ("render_time", f"{report.render_seconds:.3f}"),
        ("denoise_time", f"{report.denoise_seconds:.3f}"),
        ("denoised_error", report.denoised_sentence),
        ("build_time", f"{report.build_seconds:.3f}"),
        ("kernel_time", f"{report.compile_seconds + report.prepare_seconds:.3f}"),
        ("kernels", report.kernels),
        ("rays", str(sum(report.rays.values()))),
        ("rejects", str(report.reject_count)),
        ("rejected_records", str(report.record_reject_count)),
        ("dropped_records", str(report.record_drop_count)),
        ("guiding", "; ".join(report.guiding.lines)),
        ("peak_memory_mib", f"{report.peak_memory / 2**20:.0f}"),
        ("notices", "; ".join(f"{item.subject}: {item.problem}" for item in notices)[:_MOST_CHARACTERS]),
    ):
        _stamp(engine, f"neuralguide.{layer_name}.{field}", value)


def stamp_mattes(engine: bpy.types.RenderEngine, layer: bpy.types.ViewLayer, description: SceneDescription) -> None:
    """Write into the file's metadata whose ids are in Cryptomattes."""
    from engine.scene.cryptomatte import matte_metadata

    instances = description.instances
    names = {
        "CryptoObject": instances.name,
        "CryptoMaterial": [material.name for material in description.materials],
        "CryptoAsset": instances.asset or (),
    }
    for kind in passes.requested_mattes(layer):
        for field, value in matte_metadata(f"{layer.name}.{kind}", names[kind]).items():
            _stamp(engine, field, value)
