# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether light that a program's surface scatters stays together, so that it may make caustics: from its instructions.

What a program gives at a point is looked at again where photons arrive (`engine.kernels.caustics`); this says where it
is worth to let them begin.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from engine.kernels.bsdf import plain_glass, plain_principled
from engine.kernels.bsdf.kinds import DELTA_ALPHA_SQUARED
from engine.kernels.bsdf.linked_lobes import ADDED
from engine.kernels.caustics import LEAST_ROUGH_ALPHA
from engine.kernels.shader import ops_closure
from engine.shaders.program import Constant, Instruction, Value, is_zero

#: Which operands of PRINCIPLED are these, behind the weight.
_METALLIC, _ROUGHNESS, _TRANSMISSION, _COAT_WEIGHT, _COAT_ROUGHNESS, _SHEEN = 5, 6, 13, 14, 15, 18
#: Of GLASS, REFRACTION and GLOSSY, behind weight, normal and colour.
_ROUGHNESS_OF_NODE = 3
#: Where closures with folded inputs have their alpha.
_FOLDED_ALPHA: Mapping[str, Callable[[Sequence[float]], float]] = {
    "PLAIN_GLASS": plain_glass.alpha_of_glass,
    "PLAIN_GLOSSY": plain_glass.alpha_of_glossy,
    "PLAIN_PRINCIPLED": plain_principled.alpha_of_principled,
}
#: Linked closures whose lobes are of facets.
_LINKED_FACETS = tuple(ADDED[name] for name in ("METAL", "METAL_BY_INDEX", "GLASS"))


def makes_caustics(instructions: Sequence[Instruction], roots: Sequence[int]) -> bool:
    """Whether some lobe is sure to be a delta lobe, or no lobe is sure to be rough and one may be sharp."""
    closures = [instructions[root] for root in roots]
    if any(_has_delta(closure) for closure in closures):
        return True
    lobes = [closure for closure in closures if closure.opcode >= ops_closure.LOBES_FIRST]
    return bool(lobes) and all(_may_be_sharp(closure) for closure in lobes)


def _has_delta(closure: Instruction) -> bool:
    for name, find_alpha in _FOLDED_ALPHA.items():
        if closure.opcode == ops_closure.opcode(name):
            folded = closure.inputs[-1]
            return isinstance(folded, Constant) and _is_delta(find_alpha(folded.value))
    if closure.opcode == ops_closure.opcode("PRINCIPLED"):
        has_coat = not is_zero(closure.inputs[_COAT_WEIGHT]) and _is_mirrors(closure.inputs[_COAT_ROUGHNESS])
        return has_coat or _is_mirrors(closure.inputs[_ROUGHNESS])
    if closure.opcode in _nodes():
        return _is_mirrors(closure.inputs[_ROUGHNESS_OF_NODE])
    return False


def _may_be_sharp(closure: Instruction) -> bool:
    """Whether all lobes of a closure may be sharp somewhere."""
    if closure.opcode == ops_closure.opcode("PRINCIPLED"):
        inputs = closure.inputs
        has_base = not (_may_be_one(inputs[_METALLIC]) or _may_be_one(inputs[_TRANSMISSION]))
        if has_base or not _may_be_sharp_at(inputs[_ROUGHNESS]):
            return False
        has_coat, has_sheen = not is_zero(inputs[_COAT_WEIGHT]), not is_zero(inputs[_SHEEN])
        is_rough_above = (has_coat and not _may_be_sharp_at(inputs[_COAT_ROUGHNESS])) or has_sheen
        return not is_rough_above
    for name in ("PLAIN_GLASS", "PLAIN_GLOSSY"):
        if closure.opcode == ops_closure.opcode(name):
            folded = closure.inputs[-1]
            return not isinstance(folded, Constant) or _FOLDED_ALPHA[name](folded.value) < LEAST_ROUGH_ALPHA
    if closure.opcode == ops_closure.opcode("LINKED"):
        return closure.immediates[0] in _LINKED_FACETS
    return closure.opcode in _nodes() and _may_be_sharp_at(closure.inputs[_ROUGHNESS_OF_NODE])


def _nodes() -> list[int]:
    return [ops_closure.opcode(name) for name in ("GLASS", "REFRACTION", "GLOSSY")]


def _may_be_one(value: Value) -> bool:
    return not isinstance(value, Constant) or value.value[0] >= 1.0


def _alpha(roughness: float) -> float:
    return float(min(max(roughness, 0.0), 1.0) ** 2)


def _may_be_sharp_at(roughness: Value) -> bool:
    return not isinstance(roughness, Constant) or _alpha(roughness.value[0]) < LEAST_ROUGH_ALPHA


def _is_mirrors(roughness: Value) -> bool:
    """Whether facets of this roughness are a mirror's."""
    return isinstance(roughness, Constant) and _is_delta(_alpha(roughness.value[0]))


def _is_delta(alpha: float) -> bool:
    return alpha * alpha <= float(DELTA_ALPHA_SQUARED)
