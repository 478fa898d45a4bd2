# SPDX-License-Identifier: GPL-3.0-or-later
"""Sampling lights: the tree that picks an emitter, and one file per shape with its sample, pdf and hit."""

from engine.kernels.lights.sample import (
    background_pdf,
    cluster_choice,
    finds_all,
    lamp_factor,
    lamp_hit,
    lamp_pdf,
    sample_emitter,
    sample_light,
    sun_is_hit,
    sun_pdf,
    triangle_emitter_pdf,
)

__all__ = [
    "background_pdf",
    "cluster_choice",
    "finds_all",
    "lamp_factor",
    "lamp_hit",
    "lamp_pdf",
    "sample_emitter",
    "sample_light",
    "sun_is_hit",
    "sun_pdf",
    "triangle_emitter_pdf",
]
