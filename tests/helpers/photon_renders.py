# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures with photons beside those by paths alone, and how far their means differ."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from unittest import mock

import numpy as np

from engine.render import photon_maps, photon_radius
from engine.render.session import Session
from engine.scene.description import SceneDescription
from engine.scene.digest import scene_digest
from engine.settings import RenderSettings
from tests.helpers.seeded_renders import Z_LIMIT

#: Pictures that were rendered, by all that they depend on: several tests compare with the same.
_rendered: dict[tuple[Any, ...], np.ndarray] = {}


def pictures(
    scene: SceneDescription, caustics: str, seeds: Iterable[int] = range(4), shown: str = "Combined",
    neighbours: int = 3, **settings,
) -> np.ndarray:
    """A pass of each seed, float32 (S, height, width, 3). The same is rendered once in a run of the tests.

    Parameters
    ----------
    neighbours : int
        Photons within a disc, at most: few, since such small pictures show what large discs blur. Then no disc
        has a least size.
    """
    chosen = {"caustics": caustics, "samples": 256, "threads": 1, "filter_glossy": 0.0} | settings
    # Paths have no neighbours.
    known = scene_digest(scene), shown, neighbours * (caustics != "PATHS"), tuple(sorted(chosen.items()))
    found = []
    least = 0.0 if neighbours < photon_radius.MOST_NEIGHBOURS else photon_maps.LEAST_PIXELS
    most_neighbours = mock.patch.object(photon_radius, "MOST_NEIGHBOURS", neighbours)
    with most_neighbours, mock.patch.object(photon_maps, "LEAST_PIXELS", least):
        for seed in seeds:
            if (seed, *known) not in _rendered:
                _rendered[seed, *known] = _picture(scene, shown, {"seed": seed} | chosen)
            found.append(_rendered[seed, *known])
    return np.stack(found)


def _picture(scene: SceneDescription, shown: str, settings: dict[str, Any]) -> np.ndarray:
    session = Session(RenderSettings(**settings))
    session.load(scene)
    result = session.render(passes=["Combined", shown])
    session.close()
    assert not any(notice.subject == "Caustics by photons" for notice in result.report.notices)
    return result.passes[shown][..., :3]


def assert_same_light(a: np.ndarray, b: np.ndarray, bound: float) -> None:
    """Means over pictures and over their columns, by channel, are the same: none of these differs by `Z_LIMIT` standard
    errors of the seeds, the means by no more than a share `bound` either.

    Parameters
    ----------
    a, b : float32 (S, height, width, 3)
    bound : float
    """
    whole = [one.mean(axis=(1, 2)) for one in (a, b)]
    np.testing.assert_allclose(whole[0].mean(axis=0), whole[1].mean(axis=0), rtol=bound)
    assert abs(_z(*whole)).max() < Z_LIMIT
    # Each column is known by few seeds: errors are those of all columns.
    columns = [one.mean(axis=1) for one in (a, b)]
    difference = columns[0].mean(axis=0) - columns[1].mean(axis=0)
    error = np.sqrt(sum(one.var(axis=0, ddof=1).mean() / len(one) for one in columns))
    assert abs(difference).max() < Z_LIMIT * error


def _z(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    error = np.sqrt(a.var(axis=0, ddof=1) / len(a) + b.var(axis=0, ddof=1) / len(b))
    return (a.mean(axis=0) - b.mean(axis=0)) / error
