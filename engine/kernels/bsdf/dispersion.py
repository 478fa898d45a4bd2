# SPDX-License-Identifier: GPL-3.0-or-later
"""Lobes whose refractive index depends on the wavelength: which has its turn, and what it does at smooth surfaces.

A lane's transmissive lobes have the refractive index of the hero, channel 0, but while `eval_channels` goes through the
others. References: Wilkie et al. 2014, "Hero Wavelength Spectral Sampling".
"""

from engine.kernels.bsdf.closures import read3
from engine.kernels.bsdf.fresnel import f0_of_eta
from engine.kernels.bsdf.kinds import (
    CLOSURE_IS_BACK,
    ENERGY_SCALE,
    ETA,
    ETA_D,
    F0,
    F0_REAL,
    GLASS,
    REFRACTION,
)
from engine.kernels.bsdf.microfacet import fresnel_blend, glass_reflection_pmf, lobe_color
from engine.kernels.vector import dot
from engine.runtime.jit import kernel
from engine.spectral.dispersion import ior_at
from engine.state.lanes import CLOSURE_N, CLOSURE_WEIGHT


@kernel
def disperses(kind):
    """Whether lobes of this kind have a refractive index that goes by the wavelength."""
    return kind == REFRACTION or kind == GLASS


@kernel
def dispersed_eta(closures, lane, eta_d, c):
    """Relative refractive index of a lobe at the wavelength of channel `c`, from that at the d line."""
    is_back = closures.flags[lane] & CLOSURE_IS_BACK != 0
    ior = ior_at(1.0 / eta_d if is_back else eta_d, closures.dispersion[lane], closures.wavelength[lane, c])
    return 1.0 / ior if is_back else ior


@kernel
def begin_dispersion(closures, lane):
    """Keep the refractive indices that the shader gave, and give each channel's F0 its own; once a vertex."""
    param = closures.param
    for i in range(closures.count[lane]):
        kind = closures.kind[lane, i]
        if not disperses(kind):
            continue
        eta_d = param[lane, i, ETA]
        param[lane, i, ETA_D] = eta_d
        if kind == GLASS:
            f0_d = f0_of_eta(eta_d)
            for c in range(len(closures.channels)):
                f0 = f0_of_eta(dispersed_eta(closures, lane, eta_d, c))
                # What the material has made of it stays a factor.
                if f0_d > 0.0:
                    param[lane, i, F0 + c] = min(param[lane, i, F0 + c] * f0 / f0_d, 1.0)


@kernel
def set_channel(closures, lane, c):
    """Let the lane's lobes refract as they do at the wavelength of channel `c`."""
    param = closures.param
    for i in range(closures.count[lane]):
        if disperses(closures.kind[lane, i]):
            eta = dispersed_eta(closures, lane, param[lane, i, ETA_D], c)
            param[lane, i, ETA] = eta
            if closures.kind[lane, i] == GLASS:
                param[lane, i, F0_REAL] = f0_of_eta(eta)


@kernel
def delta_channels(closures, lane, i, wo, selection_pmf, pmf, is_refracted, out, row):
    """Value and probability by channel of a delta lobe of a lane that disperses, where the hero went.

    Parameters
    ----------
    i : int
        The lobe.
    selection_pmf, pmf : float32
        Probability of the lobe, and of the lobe and what the hero did there.
    out : float32 (R, 3 C)
        Row `row` holds the hero's values, and receives those of all.

    Returns
    -------
    float32
        Probability, mean over the channels' shares.
    """
    param = closures.param
    kind = closures.kind[lane, i]
    count = len(closures.channels)
    if not disperses(kind):
        for c in range(count):
            out[row, count + c] = pmf
        return pmf
    out[row, count] = pmf
    mean = closures.share[lane, 0] * pmf
    cos_o = dot(read3(param, lane, i, CLOSURE_N), wo)
    for c in range(1, count):
        value = 0.0
        pmf_c = 0.0
        # Refracted, the others go another way.
        if not is_refracted:
            set_channel(closures, lane, c)
            blend, _ = fresnel_blend(param, lane, i, kind, cos_o)
            pmf_c = selection_pmf * max(glass_reflection_pmf(param, closures.channels, lane, i, blend), 0.0)
            value = param[lane, i, CLOSURE_WEIGHT + c] * param[lane, i, ENERGY_SCALE]
            value *= lobe_color(param, lane, i, kind, blend, False, c)
        out[row, c] = value
        out[row, count + c] = pmf_c
        mean += closures.share[lane, c] * pmf_c
    if not is_refracted:
        set_channel(closures, lane, 0)
    return mean


@kernel
def share_densities(paths, lane, pdf, densities, row):
    """Give each wavelength its new share in the path's density, once the path has gone on in a direction.

    The balance heuristic over the heroes (Wilkie et al. 2014), vertex by vertex.

    Parameters
    ----------
    pdf : float32
        Density of the direction, mean over the shares.
    densities : float32 (R, 3 C)
        The same by channel in columns C to 2 C of row `row`.
    """
    count = len(paths.channels)
    for c in range(count):
        paths.share[lane, c] = paths.share[lane, c] * densities[row, count + c] / pdf
