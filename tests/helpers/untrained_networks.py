# SPDX-License-Identifier: GPL-3.0-or-later
"""Networks that know nothing: whatever they say, a render by them has to stay unbiased."""

from __future__ import annotations

from functools import partial

import numpy as np

from engine.guiding.models.predictors import PREDICTORS, Predictions, Predictor
from engine.guiding.models.source_model import SourceModel
from engine.guiding.neural.models import network_predictor
from engine.guiding.neural.models.radiance_model import RadianceModel
from engine.guiding.neural.networks.flow.field import make_flow_field
from engine.guiding.neural.networks.flow.shape import FlowShape, initial_flow_parameters
from engine.guiding.neural.networks.mixture.inference import make_mixture_network
from engine.guiding.neural.networks.mixture.shape import initial_parameters
from engine.guiding.neural.networks.radiance import NETWORK_SHAPES, Snapshot, network_shape
from engine.guiding.neural.networks.radiance_query import make_network_field, no_network
from engine.guiding.neural.sources import network_design

#: Of what the networks are to see [m].
BOUNDS = np.array(((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)), np.float32)


class Untrained(SourceModel):
    """A network source that has learned nothing: its parameters are drawn at random, and wild."""

    is_asynchronous = has_stand_in = True

    def __init__(self, settings, scale):
        super().__init__()
        shape = network_design(settings).shape
        is_flow = isinstance(shape, FlowShape)
        initial = initial_flow_parameters if is_flow else initial_parameters
        parameters = scale * initial(shape, settings.seed)
        snapshot = Snapshot(1, 1, 0.0, 1.0, BOUNDS, parameters.astype(np.float32))
        self.field = make_flow_field(shape, snapshot) if is_flow else make_mixture_network(shape, snapshot)


class Late(Untrained):
    """Knows nothing until it has been asked to learn so many times."""

    def __init__(self, settings, scale, silence):
        super().__init__(settings, scale)
        self._later, self.field, self._silence = self.field, None, silence

    def learn(self, *_arguments):
        self._silence -= 1
        if self._silence == 0:
            self.field = self._later


class BadNetwork:
    """Predicts by `kind` instead of by what was learned."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._random = np.random.default_rng(1)

    def __call__(self, memory, candidates, vertex_count, row_count):
        rows, directions = candidates.radiance[:row_count], candidates.direction[:row_count]
        if self._kind == "random":
            rows[:] = 10.0 ** self._random.uniform(-2.0, 2.0, rows.shape)
        elif self._kind == "inverted":
            # The pit's light comes from its walls and floor; from the sky comes nothing.
            rows[:] = np.where(directions[:, 2:] > 0.0, 10.0, 1e-3)
        else:
            rows[:] = {"constant": 1.0, "zero": 0.0, "NaN": np.nan}[self._kind]


class Fixed(Predictor):
    """Has learned everything from the beginning."""

    has_begun = is_ready = True

    def __init__(self, model, settings, report, notices):
        super().__init__(settings, report, notices)
        self.predictions = Predictions(model=model)

    predictions = Predictions()


def ask(network, monkeypatch):
    """Have renders ask `network`, from the first iteration on."""
    model = RadianceModel(no_network(NETWORK_SHAPES["COMPACT"]))
    model.kernel = network
    monkeypatch.setitem(PREDICTORS, "NETWORK", partial(Fixed, model))


def guess(monkeypatch):
    """Have renders ask a network whose parameters are drawn at random, and wild; returns the settings it is made by."""
    seen = []

    def make(settings, report, notices):
        seen.append(settings)
        shape = network_shape(settings)
        rng = np.random.default_rng(settings.seed)
        parameters = rng.normal(0.0, 0.5, shape.parameter_count).astype(np.float32)
        bounds = np.array(((-5.0, -5.0, -5.0), (5.0, 5.0, 5.0)), np.float32)
        field = make_network_field(shape, Snapshot(1, 1, 0.0, 1.0, bounds, parameters))
        return Fixed(RadianceModel(field), settings, report, notices)

    monkeypatch.setattr(network_predictor, "make_predictor", make)
    return seen
