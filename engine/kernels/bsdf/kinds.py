# SPDX-License-Identifier: GPL-3.0-or-later
"""Kinds of closures and where their parameters lie in a row of `Closures.param`.

Columns 0 to 7 are common (`engine.state.lanes`: weight, normal, sample weight); the rest is the kind's. Diffuse kinds
have a file each, with their number and their columns, and `lobes.LOBES` lists them. Those of the others:

==================  ==================================================================================================
GLOSSY              ALPHA_X, ALPHA_Y, ENERGY_SCALE, TANGENT (3, of anisotropic lobes)
GLOSSY_DIELECTRIC   as GLOSSY, and ETA
GLOSSY_SCHLICK      as GLOSSY_DIELECTRIC, and F0 (4), F0_REAL
GLOSSY_F82          as GLOSSY, and F0 (4), F82_B (4)
REFRACTION          ALPHA_X = ALPHA_Y, ETA, ENERGY_SCALE, ETA_D (where the lane disperses)
GLASS               as REFRACTION, and F0 (4), F0_REAL, REFLECTION_TINT (4), TRANSMISSION_TINT (4)
TRANSPARENT         none
LINKED_*            see `linked.py`
SUBSURFACE          see `subsurface.py`: it has no value in any direction, and is sampled only
==================  ==================================================================================================

The microfacet kinds say their Fresnel term. Colours take four columns: RGB and 0 as shaders leave them, values at the
path's wavelengths once `engine.wavefront.upsample` has been there.
A lobe with alpha_x * alpha_y <= DELTA_ALPHA_SQUARED is a delta lobe.
"""

import numpy as np

from engine.state.lanes import CLOSURE_KIND_PARAMS, CLOSURE_WIDTH

NONE = 0

# Diffuse kinds, up to LAST_DIFFUSE: those below FIRST_TRANSLUCENT reflect, the others transmit.
DIFFUSE = 1
#: Those whose kernels are compiled where a scene has one (`linked.py`), here and below.
LINKED_DIFFUSE = 4
FIRST_TRANSLUCENT = 16
#: What a rough thin wall lets through (`thin_wall.py`).
THIN_TRANSLUCENT = 18
#: Phase function of a medium: sends light all around.
PHASE = 17
#: Fibres and what comes through thin glass, FIRST_HAIR to LAST_DIFFUSE: as diffuse kinds they have no delta part, but
#: their rays are glossy.
FIRST_HAIR = 19
HAIR_REFLECTION = 19
HAIR_TRANSMISSION = 20
CHIANG = 21
HUANG = 22
THIN_GLASS = 23
LAST_DIFFUSE = 23

# Microfacet kinds: FIRST_MICROFACET to LAST_MICROFACET; those from REFRACTION on transmit.
FIRST_MICROFACET = 24
GLOSSY = 24
GLOSSY_DIELECTRIC = 25
GLOSSY_SCHLICK = 26
GLOSSY_F82 = 27
LINKED_GLOSSY = 28
REFRACTION = 29
GLASS = 30
LINKED_REFRACTION = 31
LINKED_GLASS = 32
LAST_MICROFACET = 32

TRANSPARENT = 33
#: Light that goes in and comes out elsewhere (`subsurface.py`).
SUBSURFACE = 34
KIND_COUNT = 35

# Values of the `distribution` argument of add_*.
GGX = 0
MULTI_GGX = 1
BECKMANN = 2
ASHIKHMIN_SHIRLEY = 3

# Bits of Closures.flags.
CLOSURE_NO_BUMP_CORRECTION = 1
CLOSURE_NO_REFLECTIVE_CAUSTICS = 2
CLOSURE_NO_REFRACTIVE_CAUSTICS = 4
#: Set behind the shader, in renders with wavelengths: the lane has lobes whose refractive index depends on them
#: (`bsdf.dispersion`); it is seen from the back, where refractive indices are inverted.
CLOSURE_DISPERSES = 8
CLOSURE_IS_BACK = 16
#: The path has been scattered by something diffuse.
CLOSURE_IS_BEHIND_DIFFUSE = 32
#: The surface is a curve, where bumped normals are taken as they are.
CLOSURE_IS_ON_STRAND = 64
#: A lobe whose normal is no number takes all others along (`no_normal.py`).
CLOSURE_IS_LOST = 128

# Bits that `summarize` returns.
HAS_EVAL = 1
HAS_TRANSMISSION = 2
HAS_DELTA = 4
HAS_TRANSPARENT = 8

# Columns of Closures.param. The first cache line ends at column 15.
#: Smooth shading normal of a bumped closure, and whether there is one: 0 no (SMOOTH_N is not set), 1 yes, 2 yes but the
#: material turned bump correction off. The fraction is half the object's Shadow Terminator Shading Offset: to lobes
#: without either, which nearly all are, both cost one comparison.
BUMP = CLOSURE_KIND_PARAMS
SMOOTH_N = CLOSURE_WIDTH - 3

ALPHA_X = CLOSURE_KIND_PARAMS + 1
ALPHA_Y = CLOSURE_KIND_PARAMS + 2
ETA = CLOSURE_KIND_PARAMS + 3  # refractive index of the far side over the viewer's side
ENERGY_SCALE = CLOSURE_KIND_PARAMS + 4
F0_REAL = CLOSURE_KIND_PARAMS + 5
#: Of fibres by Chiang's model: variance along the fibre, that of what is reflected first, scale around it.
CHIANG_WIDTHS = CLOSURE_KIND_PARAMS + 4
#: And by Huang's: their facets' alpha. They have no SMOOTH_N.
HUANG_ALPHA = CLOSURE_WIDTH - 1
ETA_D = CLOSURE_KIND_PARAMS + 6  # ETA at the d line, where ETA goes through the wavelengths
F0 = CLOSURE_KIND_PARAMS + 7
REFLECTION_TINT = F0 + 4
F82_B = REFLECTION_TINT
TRANSMISSION_TINT = REFLECTION_TINT + 4
# Glass has no tangent.
TANGENT = TRANSMISSION_TINT

#: Closures whose mean weight is below are dropped (Cycles' cutoff).
WEIGHT_CUTOFF = np.float32(1e-5)
#: Product of the alphas up to which a microfacet lobe is a delta lobe (Cycles' threshold).
DELTA_ALPHA_SQUARED = np.float32(2e-10)
