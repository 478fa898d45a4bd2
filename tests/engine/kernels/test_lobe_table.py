# SPDX-License-Identifier: GPL-3.0-or-later
"""What the table of closures promises of its lines."""

from __future__ import annotations

from engine.kernels.bsdf import kinds
from engine.kernels.bsdf.lobes import COLOR_COLUMNS, INSTRUCTIONS, LOBES
from engine.kernels.shader.opcodes import IMAGE_FIRST
from engine.kernels.shader.ops_closure import LOBES_FIRST, opcode
from engine.state.lanes import CLOSURE_CHANNELS, CLOSURE_KIND_PARAMS


def test_kinds_are_numbered_apart_and_where_diffuse_kinds_are() -> None:
    numbers = [lobe.kind for lobe in LOBES]
    assert len(set(numbers)) == len(numbers)
    assert all(kinds.NONE < number <= kinds.LAST_DIFFUSE < kinds.FIRST_MICROFACET for number in numbers)
    assert kinds.LAST_MICROFACET < kinds.TRANSPARENT < kinds.SUBSURFACE < kinds.KIND_COUNT


def test_colors_lie_between_the_kinds_number_and_the_normal_of_bumped_lobes() -> None:
    columns = COLOR_COLUMNS[COLOR_COLUMNS != 0]
    assert (columns > kinds.BUMP).all() and kinds.BUMP == CLOSURE_KIND_PARAMS
    assert (columns + CLOSURE_CHANNELS <= kinds.SMOOTH_N).all()


def test_opcodes_of_instructions_stay_within_their_range() -> None:
    assert [opcode(name) for name in INSTRUCTIONS] == list(range(LOBES_FIRST, LOBES_FIRST + len(INSTRUCTIONS)))
    assert opcode(list(INSTRUCTIONS)[-1]) < IMAGE_FIRST
