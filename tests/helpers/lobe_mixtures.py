# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixtures decoded by the renderer's kernels, and the parameters at which they are tested."""

from __future__ import annotations

import numpy as np

from engine.guiding.fields.vmm.field import GUIDE_KAPPA, GUIDE_WEIGHT, GUIDE_X, GUIDE_Z, allocate_guide
from engine.guiding.fields.vmm.query import eval_vmm, predict_vmm, sample_vmm
from engine.guiding.neural.networks.lobes.nasg import (
    LOG_A_HIGH,
    NASG_A,
    NASG_COS_TAU,
    NASG_COS_THETA,
    NASG_LAMBDA,
    NASG_LOG_A,
    NASG_LOG_LAMBDA,
    NASG_LOGIT,
    NASG_OUTPUTS,
    NASG_WEIGHT,
    NASG_X,
    NASG_Z,
    allocate_nasg,
    decode_nasg,
    eval_nasg,
    predict_nasg,
    sample_nasg,
)
from engine.guiding.neural.networks.lobes.vmf import (
    LOG_KAPPA_HIGH,
    VMF_LOG_KAPPA,
    VMF_LOGIT,
    VMF_OUTPUTS,
    VMF_PHI,
    VMF_THETA,
    decode_vmf,
    multiply_cosine,
)
from engine.runtime.jit import kernel
from tests.helpers.guiding_harness import unit

CAP = float(np.exp(np.float64(LOG_KAPPA_HIGH)))
A_CAP = float(np.exp(np.float64(LOG_A_HIGH)))
KAPPAS = [1.1e-3, 0.05, 1.0, 30.0, 1500.0, CAP]
ECCENTRICITIES = [5e-5, 0.5, 25.0, A_CAP]
#: tanh(x / 2) and sigmoid(x) of it are at the end of their range.
END = 1e4
HOSTILE = [np.nan, np.inf, -np.inf, 1e30, -1e30, 3e38, 0.0, -0.0, 1e-40, 17.0]


@kernel
def _decode_vmf(raw, first, lobe_count, guide, fluence):
    for i in range(raw.shape[0]):
        decode_vmf(raw, i, first, lobe_count, guide, i, fluence)


@kernel
def _decode_nasg(raw, first, lobe_count, guide, fluence):
    for i in range(raw.shape[0]):
        decode_nasg(raw, i, first, lobe_count, guide, i, fluence)


@kernel
def _query_vmf(guide, lane, directions, out):
    for i in range(directions.shape[0]):
        wi = (directions[i, 0], directions[i, 1], directions[i, 2])
        out[i, 0] = eval_vmm(guide, lane, wi)
        out[i, 1] = predict_vmm(guide, lane, wi, out[i, 0])


@kernel
def _query_nasg(guide, lane, directions, out):
    for i in range(directions.shape[0]):
        wi = (directions[i, 0], directions[i, 1], directions[i, 2])
        out[i, 0] = eval_nasg(guide, lane, wi)
        out[i, 1] = predict_nasg(guide, lane, wi, out[i, 0])


@kernel
def _sample_vmf(guide, lane, u, out):
    for i in range(u.shape[0]):
        out[i, 0], out[i, 1], out[i, 2] = sample_vmm(guide, lane, u[i, 0], u[i, 1], u[i, 2])


@kernel
def _sample_nasg(guide, lane, u, out):
    for i in range(u.shape[0]):
        out[i, 0], out[i, 1], out[i, 2] = sample_nasg(guide, lane, u[i, 0], u[i, 1], u[i, 2])


@kernel
def _multiply_cosine(guide, n):
    for i in range(n.shape[0]):
        multiply_cosine(guide, i, (n[i, 0], n[i, 1], n[i, 2]))


OUTPUTS = {"vmf": VMF_OUTPUTS, "nasg": NASG_OUTPUTS}


class Mixtures:
    """Decoded rows of outputs, one a lane."""

    def __init__(self, model, raw, lobe_count=None, first=0, fluence=1.0):
        raw = np.ascontiguousarray(raw, np.float32)
        lobe_count = lobe_count or (raw.shape[1] - first) // OUTPUTS[model]
        self.model = model
        if model == "vmf":
            self.guide = allocate_guide(len(raw))
            # What an earlier use left behind must not matter.
            self.guide.lobes[:] = 7.0
            _decode_vmf(raw, first, lobe_count, self.guide, np.float32(fluence))
        else:
            self.guide = allocate_nasg(len(raw), lobe_count)
            self.guide.lobes[:] = 7.0
            _decode_nasg(raw, first, lobe_count, self.guide, np.float32(fluence))

    def query(self, directions, lane=0):
        """Densities and predictions."""
        out = np.zeros((len(directions), 2), np.float32)
        query = _query_vmf if self.model == "vmf" else _query_nasg
        query(self.guide, lane, np.ascontiguousarray(directions, np.float32), out)
        return out.T

    def pdf(self, directions, lane=0):
        return self.query(directions, lane)[0]

    def sample(self, u, lane=0):
        u = np.random.default_rng(17).random((u, 3)) if isinstance(u, int) else u
        out = np.zeros((len(u), 3), np.float32)
        sample = _sample_vmf if self.model == "vmf" else _sample_nasg
        sample(self.guide, lane, np.minimum(np.asarray(u, np.float32), np.float32(1.0 - 2.0**-24)), out)
        return out

    def multiply_cosine(self, n):
        _multiply_cosine(self.guide, np.ascontiguousarray(n, np.float32))

    @property
    def weights(self):
        return self.guide.lobes[:, GUIDE_WEIGHT if self.model == "vmf" else NASG_WEIGHT, : self.guide.count[0]]

    def lobe(self, k=0, lane=0):
        """kappa, a, and the axes x, y, z as rows, in float64."""
        lobes = self.guide.lobes[lane, :, k].astype(np.float64)
        if self.model == "vmf":
            z = lobes[GUIDE_X : GUIDE_Z + 1]
            x = unit(np.cross(z, (1.0, 0.0, 0.0) if abs(z[0]) < 0.6 else (0.0, 1.0, 0.0)))
            return lobes[GUIDE_KAPPA], 0.0, np.stack([x, np.cross(z, x), z])
        z, x = lobes[NASG_Z : NASG_Z + 3], lobes[NASG_X : NASG_X + 3]
        return lobes[NASG_LAMBDA], lobes[NASG_A], np.stack([x, np.cross(z, x), z])


def outputs_of(model, kappa=1.0, a=1.0, orientation=(0.3, -0.7, 0.4, 0.9, 0.2), logit=0.0):
    """Outputs of one lobe; the orientation is that of NASG (vMF takes its first two for theta and phi)."""
    raw = np.zeros(OUTPUTS[model])
    if model == "vmf":
        raw[[VMF_LOGIT, VMF_LOG_KAPPA]] = logit, np.log(kappa)
        raw[[VMF_THETA, VMF_PHI]] = -orientation[0], orientation[1]
    else:
        raw[[NASG_LOGIT, NASG_LOG_LAMBDA, NASG_LOG_A]] = logit, np.log(kappa), np.log(a)
        raw[NASG_COS_THETA : NASG_COS_TAU + 1] = orientation
    return raw


#: A general one; both poles; axes of the world; a pair without ratio.
ORIENTATIONS = [
    (0.3, -0.7, 0.4, 0.9, 0.2),
    (END, 0.3, 0.1, -0.5, 0.6),
    (-END, -0.2, -0.9, 0.8, 0.3),
    (0.0, 0.0, END, 0.0, END),
    (2.0, 0.0, 0.0, 0.0, 0.0),
]


def from_quantiles(s, rho, kappa, a, axes):
    """Directions of a lobe at quantiles s in [0, 1) and azimuths rho, and solid angle over ds drho.

    The solid angle is 2 dg dphi, g = b^(1 / (1 + q)) with 1 + q = (1 + a) / (1 + a sin(rho)^2), and
    dphi = sqrt(1 + a) / (1 + a sin(rho)^2) drho: geometry alone, nothing of the density's normalisation.
    """
    mass = -np.expm1(-2.0 * kappa) if kappa > 0.0 else 0.0
    below = -np.log1p(-s * mass) / (2.0 * kappa) if kappa > 0.0 else s
    stretch = 1.0 + a * np.sin(rho) ** 2
    h = -np.expm1(np.log1p(-below) * stretch / (1.0 + a))
    phi = np.arctan2(np.sqrt(1.0 + a) * np.sin(rho), np.cos(rho))
    sine = 2.0 * np.sqrt(h * (1.0 - h))
    local = np.stack([sine * np.cos(phi), sine * np.sin(phi), 1.0 - 2.0 * h], -1)
    slope = mass / (2.0 * kappa * (1.0 - s * mass)) if kappa > 0.0 else 1.0
    return local @ axes, 2.0 * (1.0 - h) / ((1.0 - below) * np.sqrt(1.0 + a)) * slope
