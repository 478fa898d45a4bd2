# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of closures: what a newcomer extends, by a line here, a file of its own and an entry for its node.

The file (`translucent.py` is an example) has the kind's number, its columns of `Closures.param`, and kernels: one that
appends the lobe, those of its `Lobe`, and the one of its instruction,

    run_*(closures, tables, lane, view, weight, memory, code, pc),

where `weight` is what Mix and Add Shader nodes give the closure (not 0), `view` a `View`, and the operands are
memory[code[pc + 3]] and on, as the node's entry in `engine/shaders/nodes_closure.py` lists them behind the weight.
There `ops_closure.opcode` gives the instruction's opcode by its name here. Give `run_*` `forceinline=True`: two arrays
as arguments are a dozen stores at every call.

A closure that few scenes have is linked (`linked.py`): its kernels are compiled where a scene has one.

Kinds that are neither diffuse, transparent nor subsurface are microfacet lobes, one family that differs by Fresnel
terms (`microfacet.py`).
"""

import numpy as np

from engine.kernels.bsdf import (
    chiang,
    diffuse,
    glossy,
    hair,
    huang,
    linked,
    oren_nayar,
    phase,
    plain_glass,
    plain_principled,
    principled,
    sheen,
    subsurface,
    thin_wall,
    translucent,
)
from engine.kernels.bsdf.kinds import (
    F0,
    F82_B,
    GLASS,
    GLOSSY_F82,
    GLOSSY_SCHLICK,
    KIND_COUNT,
    REFLECTION_TINT,
    SUBSURFACE,
    TRANSMISSION_TINT,
)
from engine.kernels.bsdf.subsurface import SUBSURFACE_ALBEDO, SUBSURFACE_RADIUS
from engine.runtime.jit import by_number

#: Diffuse kinds of lobes, and that of media; they are asked in this order.
_DIFFUSE_LOBES = (oren_nayar.LOBE, sheen.LOBE, thin_wall.TRANSLUCENT_LOBE, translucent.LOBE, phase.LOBE, diffuse.LOBE)
#: Those whose rays are glossy: what fibres have, and what thin glass lets through.
HAIR_LOBES = (*hair.LOBES, chiang.LOBE, huang.LOBE, thin_wall.GLASS_LOBE)
LOBES = (*HAIR_LOBES, *_DIFFUSE_LOBES)

#: Instructions that add lobes, by name; they are asked in this order.
INSTRUCTIONS = {
    "DIFFUSE": diffuse.run_diffuse,
    "PLAIN_PRINCIPLED": plain_principled.run_plain_principled,
    "PRINCIPLED": principled.run_principled,
    "PLAIN_GLASS": plain_glass.run_plain_glass,
    "PLAIN_GLOSSY": plain_glass.run_plain_glossy,
    "TRANSLUCENT": translucent.run_translucent,
    "GLOSSY": glossy.run_glossy,
    "REFRACTION": glossy.run_refraction,
    "GLASS": glossy.run_glass,
    "HAIR": hair.run_hair,
    "CHIANG": chiang.run_chiang,
    "HUANG": huang.run_huang,
    "HUANG_OUTSIDE": huang.run_huang_outside,
    "SUBSURFACE": subsurface.run_subsurface,
    "LINKED": linked.run_linked,
}

eval_lobe = by_number({lobe.kind: lobe.evaluate for lobe in LOBES}, "eval_lobe", __name__)
sample_lobe = by_number({lobe.kind: lobe.sample for lobe in _DIFFUSE_LOBES}, "sample_lobe", __name__)
sample_hair = by_number({lobe.kind: lobe.sample for lobe in HAIR_LOBES}, "sample_hair", __name__)
hair_albedo = by_number({lobe.kind: lobe.albedo for lobe in HAIR_LOBES}, "hair_albedo", __name__)
hair_roughness = by_number({lobe.kind: lobe.roughness for lobe in HAIR_LOBES}, "hair_roughness", __name__)
run_instruction = by_number(dict(enumerate(INSTRUCTIONS.values())), "run_instruction", __name__)

_OTHER_COLORS = {
    GLOSSY_SCHLICK: (F0,),
    GLOSSY_F82: (F0, F82_B),
    GLASS: (F0, REFLECTION_TINT, TRANSMISSION_TINT),
    SUBSURFACE: (SUBSURFACE_ALBEDO, SUBSURFACE_RADIUS),
}


def _color_columns() -> np.ndarray:
    columns = np.zeros((KIND_COUNT, 3), np.int32)
    for kind, colors in {**{lobe.kind: lobe.colors for lobe in LOBES}, **_OTHER_COLORS}.items():
        columns[kind, : len(colors)] = colors
    return columns


#: By kind: where its colours begin in `Closures.param`, but for the weight; 0 where there are no more.
COLOR_COLUMNS = _color_columns()
