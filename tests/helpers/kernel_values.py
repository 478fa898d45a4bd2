# SPDX-License-Identifier: GPL-3.0-or-later
"""Values of leaf kernels at fixed arguments: `python -m tests.helpers.kernel_values FILE` writes them to an .npz file.

With NUMBA_DISABLE_JIT=1 the same functions run as plain Python over numpy's scalars, without LLVM, fast-math, numba's
typing or the rewiring of `engine.runtime.jit`.
"""

from __future__ import annotations

import sys
import warnings

import numba
import numpy as np

from engine.kernels.bsdf.fresnel import f82_b, fresnel_dielectric
from engine.kernels.bsdf.warp import sample_cosine_hemisphere
from engine.kernels.lights.mapping import uniform_cone, uniform_sphere
from engine.kernels.rng import SHIFTS, SOBOL, hash_combine, laine_karras, pixel_hash, reverse_bits, sample_4d
from engine.runtime.jit import kernel
from engine.scene.description import World
from tests.helpers import light_probe
from tests.helpers.bsdf_harness import (
    DIFFUSE,
    GGX,
    GLASS,
    GLOSSY,
    PRINCIPLED,
    REFRACTION,
    TRANSLUCENT,
    UP,
    Case,
    Lobes,
    at_cosine,
    sobol,
    vector,
)

BSDF_SAMPLES = 5  # a power of 2
LOBES = {
    "diffuse": Case(DIFFUSE),
    "oren-nayar": Case(DIFFUSE, {"roughness": 0.8}),
    "translucent": Case(TRANSLUCENT),
    "glossy": Case(GLOSSY, {"roughness": 0.3}),
    "glossy-anisotropic": Case(GLOSSY, {"roughness": 0.5, "anisotropic": 0.6, "rotation": 0.1}, GGX),
    "mirror": Case(GLOSSY, {"roughness": 0.0}),
    "refraction": Case(REFRACTION, {"roughness": 0.5}),
    "glass": Case(GLASS, {"roughness": 0.4, "color": (0.9, 0.5, 0.2)}),
    "glass-back": Case(GLASS, {"roughness": 0.4}, is_backfacing=True),
    "metal": Case(PRINCIPLED, {"metallic": 1.0, "color": (0.9, 0.6, 0.2), "specular_tint": (0.5, 0.8, 1.0)}),
    "layers": Case(
        PRINCIPLED,
        {"color": (0.8, 0.4, 0.1), "coat_weight": 0.7, "sheen_weight": 0.6, "transmission": 0.3, "alpha": 0.8},
    ),
}
LAMPS = {
    "point": light_probe.lamp("POINT", (1.0, 0.5, 2.0), radius=0.4),
    "spot": light_probe.lamp("SPOT", (0.0, 0.0, 3.0), radius=0.2, spot_angle=1.2, spot_blend=0.4),
    "area": light_probe.lamp("AREA", (0.3, 0.0, 2.0), size_x=1.5, size_y=0.7, shape="RECTANGLE"),
    "disk": light_probe.lamp("AREA", (0.3, 0.0, 2.0), size_x=1.5, size_y=1.5, shape="DISK"),
    "sun": light_probe.lamp("SUN", angle=0.2),
}


def _point(rng, sample, dimension):
    """`sample_4d` coordinate by coordinate, where that is vector instructions which Python has not."""
    seed = hash_combine(np.uint32(rng) >> np.uint32(6), np.uint32(dimension))
    place = int(laine_karras(np.uint32(rng), np.uint32(seed * np.uint32(0x9E3779B1)))) % 64
    index = reverse_bits(laine_karras(reverse_bits(np.uint32(sample)), seed))
    if sample < 1 << 16:
        index &= np.uint32(0xFFFF)
    numbers = []
    for d in range(4):
        bits = SHIFTS[place, d]
        for group in range(8):
            bits ^= SOBOL[16 * group + int(index >> np.uint32(4 * group)) % 16, d]
        scrambled = reverse_bits(laine_karras(bits, hash_combine(seed, np.uint32(d + 1))))
        numbers.append(np.float32(scrambled >> np.uint32(8)) * np.float32(2.0**-24))
    return numbers


_sample = _point if numba.config.DISABLE_JIT else sample_4d


@kernel
def _random(seed, out):
    for i in range(out.shape[0]):
        numbers = _sample(pixel_hash(seed, np.int64(7 * i), np.int64(3 * i)), np.int64(i * i), np.int64(3 + i % 5))
        for k in range(4):
            out[i, k] = numbers[k]


@kernel
def _warps(n, u, out):
    for i in range(u.shape[0]):
        normal = (n[0], n[1], n[2])
        first, out[i, 11] = sample_cosine_hemisphere(normal, u[i, 0], u[i, 1])
        second, out[i, 12] = uniform_cone(normal, u[i, 2], u[i, 0], u[i, 1])
        third = uniform_sphere(u[i, 0], u[i, 1])
        for axis in range(3):
            out[i, axis] = first[axis]
            out[i, 3 + axis] = second[axis]
            out[i, 6 + axis] = third[axis]
        out[i, 9], out[i, 13] = fresnel_dielectric(u[i, 0], 1.5)
        out[i, 10] = f82_b(u[i, 0], u[i, 1])


def values() -> dict[str, np.ndarray]:
    """All of them, by name."""
    found: dict[str, np.ndarray] = {}
    u = sobol(BSDF_SAMPLES)
    random = np.zeros((64, 4), np.float32)
    _random(np.int64(5), random)
    found["random"] = random
    warps = np.zeros((len(u), 14), np.float32)
    _warps(np.array(vector(0.3, -0.5, 0.8), np.float32), u, warps)
    found["warps"] = warps
    for name, case in LOBES.items():
        lobes = Lobes(case, wo=at_cosine(0.6), tangent=vector(0.8, 0.6, 0.0), ng=UP)
        pdfs, directions, labels, weights = lobes.sample(u)
        found[f"{name} sampled"] = np.column_stack([pdfs, directions, labels, weights])
        grid = np.stack([np.array(at_cosine(c, 6.0 * c)) for c in np.linspace(-0.95, 0.95, 20)])
        pdf, value = lobes.evaluate(grid)
        found[f"{name} evaluated"] = np.column_stack([pdf, value])
    for name, lamp in LAMPS.items():
        lights, geometry = light_probe.build(light_probe.make_description([lamp]))
        samples = light_probe.draw(lights, geometry, (0.1, 0.2, 0.0), (0.0, 0.0, 1.0), u)
        found[f"{name} light"] = samples
        directions = samples[:, light_probe.WI : light_probe.WI + 3]
        found[f"{name} density"] = light_probe.hit_pdf(lights, (0.1, 0.2, 0.0), (0.0, 0.0, 1.0), directions)
    places = np.random.default_rng(3).uniform(-8.0, 8.0, (30, 3))
    lights, _ = light_probe.build(light_probe.make_description([light_probe.lamp("AREA", place) for place in places]))
    receivers = np.random.default_rng(4).uniform(-8.0, 8.0, (20, 3))
    found["light tree"] = light_probe.pmfs(lights, receivers, np.tile((0.0, 0.6, 0.8), (len(receivers), 1)))
    description, info = light_probe.emissive_scene(
        [(-1, -1, 2), (1, -1, 2), (0, 1, 2.5), (5, 5, 1)], [(0, 1, 2), (1, 3, 2)], emission=(2.0, 1.0, 0.5)
    )
    description.world = World("w", "World", None, (1.0, 1.0, 1.0))
    lights, geometry = light_probe.build(description, info)
    samples = light_probe.draw(lights, geometry, (0.1, 0.2, 0.0), (0.0, 0.0, 1.0), u)
    found["triangles light"] = samples
    found["triangles density"] = light_probe.triangle_pdf(
        lights, geometry, samples[samples[:, light_probe.TRIANGLE] >= 0], (0.1, 0.2, 0.0), (0.0, 0.0, 1.0)
    )
    return found


if __name__ == "__main__":
    # Hashes wrap around, on purpose; numpy warns of it for scalars.
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    np.savez(sys.argv[1], **values())
