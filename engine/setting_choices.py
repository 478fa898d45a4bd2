# SPDX-License-Identifier: GPL-3.0-or-later
"""Values of settings that have names for values: name, label and sentence of each; new ones go last."""

CAUSTICS = (
    ("PATHS", "Paths", "By paths from the camera, which seldom meet a small lamp that way"),
    (
        "PHOTONS", "Photons",
        "By photons from the lamps too: caustics are blurred a little at first, and get sharp. Filter Glossy leaves "
        "surfaces that cast them as they are",
    ),
    ("AUTO", "Automatic", "By photons where a trial finds that they pay and Filter Glossy is 0, else by paths"),
)  # fmt: skip
SPECTRAL = (
    ("AUTO", "Automatic", "Where a material disperses light"),
    ("ON", "On", "In every scene"),
    ("OFF", "Off", "Never: what disperses light does not"),
)
DENOISING_PASSES = (
    ("RGB", "None", "The picture alone"),
    ("RGB_ALBEDO", "Albedo", "The colours of surfaces"),
    ("RGB_ALBEDO_NORMAL", "Albedo and Normal", "The colours of surfaces, and where they face"),
)
PREFILTERS = (
    ("NONE", "None", "Nothing: they are taken to be free of noise"),
    ("FAST", "Fast", "They are denoised together with the picture"),
    ("ACCURATE", "Accurate", "They are denoised first, which takes longer"),
)
DENOISING_QUALITIES = (
    ("HIGH", "High", "As well as possible"),
    ("BALANCED", "Balanced", "Nearly as well, in less time"),
    ("FAST", "Fast", "In the least time, for previews"),
)
