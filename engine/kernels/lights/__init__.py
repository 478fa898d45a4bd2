# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples lights: the tree that picks an emitter, and one file per shape with its sample, pdf and hit."""

from engine.kernels.lights.lamps import (
    distant_lamp_is_hit,
    distant_lamp_leaving,
    distant_lamp_pdf,
    lamp_hit,
    lamp_leaving,
    lamp_pdf,
)
from engine.kernels.lights.light import Choice, LightSample, Receiver
from engine.kernels.lights.sample import (
    ask_for_cell,
    background_emitter,
    background_pdf,
    choose_emitter,
    cluster_choice,
    column_of_map,
    draw_cell,
    draw_triangle,
    finds_all,
    is_of_map,
    row_of_map,
    sample_emitter,
    sample_light,
    tree_share,
    triangle_emitter,
    triangle_emitter_pdf,
    triangle_of,
)
from engine.kernels.lights.tree import group_of_few, pick_among_few
from engine.kernels.lights.triangle import drawn_triangle, put_triangle, sample_triangles

__all__ = [
    "Choice",
    "LightSample",
    "Receiver",
    "ask_for_cell",
    "background_emitter",
    "background_pdf",
    "choose_emitter",
    "cluster_choice",
    "column_of_map",
    "distant_lamp_is_hit",
    "distant_lamp_leaving",
    "distant_lamp_pdf",
    "draw_cell",
    "draw_triangle",
    "drawn_triangle",
    "finds_all",
    "group_of_few",
    "is_of_map",
    "lamp_hit",
    "lamp_leaving",
    "lamp_pdf",
    "pick_among_few",
    "put_triangle",
    "row_of_map",
    "sample_emitter",
    "sample_light",
    "sample_triangles",
    "tree_share",
    "triangle_emitter",
    "triangle_emitter_pdf",
    "triangle_of",
]
