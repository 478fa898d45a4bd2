# SPDX-License-Identifier: GPL-3.0-or-later
"""The Principled BSDF of most materials: a dielectric of one roughness over a diffuse base whose colour may vary.

Where roughness, refractive index, specular level and tint are constants, all of the specular lobe but its weight and
normal is the same at every point, and its albedo and what it lacks in energy follow from the cosine alone: a column of
the albedo tables between two roughnesses and refractive indices is a piecewise linear function of the cosine, as the
tables are. `fold_principled` computes that once a program, `run_plain_principled` reads it. The lobes are those of
`principled.add_principled`, but for rounding.
"""

from collections.abc import Sequence

import numpy as np

from engine.array_types import Float32Array
from engine.kernels.bsdf.closures import append_closure
from engine.kernels.bsdf.fresnel import eta_of_f0, f0_of_eta, interface_mean_blend
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    CLOSURE_NO_REFLECTIVE_CAUSTICS,
    DIFFUSE,
    ENERGY_SCALE,
    ETA,
    F0,
    F0_REAL,
    GLOSSY_SCHLICK,
)
from engine.kernels.bsdf.lookup import FRESNEL_BLEND, GLOSSY_ALBEDO, GLOSSY_MEAN
from engine.kernels.bsdf.normals import safe_normal, valid_specular_normal
from engine.kernels.bsdf.piecewise import interpolate, value_between
from engine.kernels.memory import read3
from engine.kernels.vector import dot
from engine.runtime.jit import in_python, kernel
from engine.state.lanes import CLOSURE_SAMPLE_WEIGHT, CLOSURE_WEIGHT

_BLENDS = 16
_ALBEDOS = 32

# Columns of what `fold_principled` returns.
_REFLECTS = 0  # 0: there is no specular lobe
_ALPHA = 1
_ETA = 2
_F0_REAL = 3
_F0 = 4
_BOUNCES = 7  # Fresnel term of light that is scattered between facets, by channel
_BLEND = 10  # from F0 to white, by cosine
_SINGLE = _BLEND + _BLENDS  # albedo of single scattering without Fresnel, by cosine
_WIDTH = _SINGLE + _ALBEDOS


_f0_of_eta, _eta_of_f0, _mean_blend = (in_python(one) for one in (f0_of_eta, eta_of_f0, interface_mean_blend))


def fold_principled(
    data: Float32Array, roughness: float, ior: float, specular_level: float, specular_tint: tuple[float, ...],
    *, is_multiple: bool,
) -> tuple[float, ...]:
    """What `run_plain_principled` reads, of inputs as `principled.PrincipledInputs` has them.

    Parameters
    ----------
    data : float32, `BsdfTables.data`
    is_multiple : bool, whether light that is scattered repeatedly between facets counts
    """
    real, one = np.float32, np.float32(1.0)
    rough = real(min(max(roughness, 0.0), 1.0))
    eta = max(real(ior), real(1e-5))
    f0_real = _f0_of_eta(eta)
    level = real(max(specular_level, 0.0))
    if level != 0.5:
        f0_real *= real(2.0) * level
        eta = real(_eta_of_f0(f0_real))
        if ior < 1.0:
            eta = one / eta
    f0 = np.clip(np.maximum(np.asarray(specular_tint, real), real(0.0)) * real(f0_real), real(0.0), one)

    folded = np.zeros(_WIDTH, real)
    folded[_REFLECTS] = eta != 1.0
    folded[_ALPHA] = rough * rough
    folded[_ETA] = eta
    folded[_F0_REAL] = _f0_of_eta(eta)
    folded[_F0 : _F0 + 3] = f0
    blends = data[FRESNEL_BLEND : FRESNEL_BLEND + _BLENDS**3].reshape(_BLENDS, _BLENDS, _BLENDS)
    z = np.sqrt(abs((eta - one) / (eta + one)))
    folded[_BLEND:_SINGLE] = value_between(value_between(blends, rough).T, z)
    folded[_SINGLE:] = 1.0
    if is_multiple:
        mean = value_between(data[GLOSSY_MEAN : GLOSSY_MEAN + _ALBEDOS], rough)
        fresnel = f0 + (one - f0) * real(_mean_blend(eta))
        folded[_BOUNCES : _BOUNCES + 3] = fresnel * mean / np.maximum(one - fresnel * (one - mean), real(1e-2))
        singles = data[GLOSSY_ALBEDO : GLOSSY_ALBEDO + _ALBEDOS**2].reshape(_ALBEDOS, _ALBEDOS)
        folded[_SINGLE:] = np.maximum(value_between(singles, rough), real(1e-6))
    return tuple(float(x) for x in folded)


def alpha_of_principled(folded: Sequence[float]) -> float:
    """Alpha of the facets that `fold_principled` was told of."""
    return folded[_ALPHA]


@kernel(forceinline=True)
def run_plain_principled(closures, tables, lane, view, weight, memory, code, pc):
    """Instruction `weight, normal, base color, folded`: PRINCIPLED with the inputs that `fold_principled` was given,
    and everything else off.
    """
    n = safe_normal(read3(memory, code[pc + 3]), view.ns)
    base_color = read3(memory, code[pc + 4])
    folded = code[pc + 5]
    below = weight
    if memory[folded + _REFLECTS] != 0.0 and closures.flags[lane] & CLOSURE_NO_REFLECTIVE_CAUSTICS == 0:
        specular_n = valid_specular_normal(closures, lane, view.ng, view.wo, n)
        i = append_closure(closures, lane, GLOSSY_SCHLICK, (weight, weight, weight), specular_n)
        if i >= 0:
            cos_o = dot(specular_n, view.wo)
            blend = interpolate(memory, folded + _BLEND, _BLENDS, cos_o)
            single = interpolate(memory, folded + _SINGLE, _ALBEDOS, cos_o)
            param = closures.param
            total = 0.0
            reflected = 0.0
            darkening_sum = 0.0
            for c in range(3):
                f0 = memory[folded + _F0 + c]
                albedo = f0 + (1.0 - f0) * blend
                # (1 + missing * bounces) / (1 + missing), where single is 1 / (1 + missing).
                darkening = single + (1.0 - single) * memory[folded + _BOUNCES + c]
                total += albedo
                reflected = max(reflected, darkening * albedo)
                darkening_sum += darkening
                param[lane, i, F0 + c] = f0
                param[lane, i, CLOSURE_WEIGHT + c] = weight * darkening
            param[lane, i, F0 + 3] = 0.0
            param[lane, i, CLOSURE_SAMPLE_WEIGHT] = weight * total * darkening_sum * (1.0 / 9.0)
            param[lane, i, ALPHA_X] = memory[folded + _ALPHA]
            param[lane, i, ALPHA_Y] = memory[folded + _ALPHA]
            param[lane, i, ETA] = memory[folded + _ETA]
            param[lane, i, ENERGY_SCALE] = 1.0 / single
            param[lane, i, F0_REAL] = memory[folded + _F0_REAL]
            below = weight * max(1.0 - reflected, 0.0)
    diffuse = (
        below * max(base_color[0], 0.0),
        below * max(base_color[1], 0.0),
        below * max(base_color[2], 0.0),
    )
    append_closure(closures, lane, DIFFUSE, diffuse, n)
