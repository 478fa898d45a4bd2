# SPDX-License-Identifier: GPL-3.0-or-later
"""Guiding methods, a record each: what directions are drawn from, and what weighs them before one is picked.

A new source is a module of `engine.guiding.sources` and a line of SOURCES. A new rung of AUTO is a line of RUNGS.
Networks (`engine.guiding.neural`) are found by the names of modules that stand here, and in no other way.
This module imports nothing: Blender's menus are made of it when the add-on is enabled.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Source:
    """What directions can be drawn from.

    Attributes
    ----------
    name : str
        As settings and scripts write it.
    label, sentence : str
        For menus.
    implementation : str
        Module with the source's kernels and model (`engine.guiding.sources.guide_kernels.Implementation`), relative to
        `engine.guiding.sources` if it begins with a dot.
    is_network : bool
        A process of its own trains it beside the render.
    is_mixture : bool
        It gives a mixture of lobes: it can know u, learn it by strata, and be trained once for a sequence.
    """

    name: str
    label: str
    sentence: str
    implementation: str
    is_network: bool = False
    is_mixture: bool = False


@dataclass(frozen=True)
class TrainedPredictor:
    """What weighs directions and is trained by a process of its own beside the render.

    Attributes
    ----------
    name : str
        As `Method.predictor` has it.
    implementation : str
        Module that brings it (`engine.guiding.models.predictors.Implementation`), relative to `engine.guiding.models`.
    part : str
        Of a learned field, that holds its state.
    candidate_cost : float
        Of a candidate that it weighs [rays], before there is anything to measure.
    """

    name: str
    implementation: str
    part: str
    candidate_cost: float


@dataclass(frozen=True)
class Method:
    """What a user can choose, or AUTO chooses.

    Attributes
    ----------
    name, label, sentence : str
        As for `Source`.
    words : str
        What the report calls it.
    source : str
        What directions are drawn from; empty: what the setting `source_field` says.
    resamples : bool
        Several directions are drawn at a vertex, weighed and one of them picked.
    predictor : str
        What weighs them (`engine.guiding.models.predictors.PREDICTORS`); empty: the guide's own lobes.
    always_resamples : bool
        The number of candidates is that of the setting at every vertex, whatever the allocation.
    rungs : tuple of str
        Methods that are compared while the image is rendered, coarsest first; of most methods it is the only one.
    """

    name: str
    label: str
    sentence: str
    words: str = ""
    source: str = ""
    resamples: bool = False
    predictor: str = ""
    always_resamples: bool = False
    rungs: tuple[str, ...] = ()


_MIXTURE = "..neural.sources.mixture"

#: Files hold a source's place among these, so new ones go last.
SOURCES: dict[str, Source] = {
    source.name: source
    for source in (
        Source("VMM", "Mixtures", "Learn lobes of incident light", ".vmm"),
        Source("SDTREE", "SD-Tree", "Learn a tree of space and directions", ".sdtree"),
        Source("SDTREE_VARIANCE", "SD-Tree, Variance-Aware", "Learn a tree for the least variance", ".sdtree"),
        Source("NPM", "Neural Mixtures", "Train a network for lobes of incident light", _MIXTURE, True, True),
        Source(
            "NPM_PRODUCT", "Neural Mixtures, Product", "Train a network for light times the material", _MIXTURE, True,
            True,
        ),
        Source(
            "NASG", "Neural Anisotropic Mixtures", "Train a larger network for stretched lobes", _MIXTURE, True, True
        ),
        Source(
            "FLOW", "Neural Flow", "Train a network for any shape; far too slow but for comparisons",
            "..neural.sources.flow", True,
        ),
    )
}  # fmt: skip

#: By the name that methods give; what candidates cost: docs/decisions/candidates.md.
TRAINED_PREDICTORS: dict[str, TrainedPredictor] = {
    "NETWORK": TrainedPredictor("NETWORK", "..neural.models.network_predictor", "network", 0.4),
}

#: Module that trains one field for many frames (`engine.guiding.sources.sequence`), relative to
#: `engine.guiding.sources`.
SEQUENCE_TRAINING = "..neural.sources.sequence_field"

#: Module of the process that trains networks, as the renderer starts and ends it
#: (`engine.guiding.models.training_process`), relative to `engine.guiding.models`.
TRAINING_PROCESS = "..neural.trainer.standby"

#: What may train networks (`engine.guiding.neural.worker.devices`): name, label, and what it is in a sentence.
TRAINING_DEVICES = (
    ("AUTO", "Automatic", "Whichever takes less for a few steps, the processor or a GPU, as measured"),
    ("CPU", "Processor", "The processor, beside the threads that trace"),
    ("CUDA", "GPU", "A GPU of NVIDIA, by a torch that has CUDA; small networks may be slower there"),
)

#: What AUTO compares, coarsest first. A finer one is tried once those before it have been, where resampling promises
#: to pay, and as soon as its predictor is ready.
RUNGS: tuple[str, ...] = (
    "VMM",
    "VMM_RIS",
    "TABLE_RIS",
    "NEURAL_RIS",
)


#: Sources that come before the methods that resample; those of later follow, since files hold a method's place.
_FIRST_SOURCES = ("SDTREE", "SDTREE_VARIANCE", "NPM", "NPM_PRODUCT", "NASG", "FLOW")


def _alone(source: Source) -> Method:
    """Sampling by a source, one direction at a vertex."""
    return Method(source.name, source.label, source.sentence, source.label.lower(), source=source.name)


#: What a user can choose, by name; files hold a method's place among these, so new ones go last.
METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method("AUTO", "Automatic", "Learn what pays in the scene, and render by that", rungs=RUNGS),
        Method(
            "OFF", "Off",
            "Sample materials and lights only. Nothing is learned, unless lights or roulette are told to",
        ),
        Method(
            "VMM", "Mixtures", "Learn lobes of incident light, and draw from them or from the material",
            "statistical mixtures", source="VMM",
        ),
        *(_alone(SOURCES[name]) for name in _FIRST_SOURCES),
        Method(
            "VMM_RIS", "Mixtures, Resampled", "Weigh several directions by the learned lobes times the material",
            "resampling by statistical mixtures", resamples=True, always_resamples=True,
        ),
        Method(
            "TABLE_RIS", "Tables, Resampled", "Weigh several directions by learned tables times the material",
            "resampling by tables", resamples=True, predictor="TABLE",
        ),
        Method(
            "NEURAL_RIS", "Neural, Resampled", "Weigh several directions by a neural network times the material",
            "resampling by a neural network", resamples=True, predictor="NETWORK",
        ),
        *(_alone(source) for source in SOURCES.values() if source.name not in ("VMM", *_FIRST_SOURCES)),
    )
}  # fmt: skip


def rungs_of(method: Method) -> tuple[str, ...]:
    """Methods that a render by `method` may go by, coarsest first."""
    return method.rungs or (method.name,)
