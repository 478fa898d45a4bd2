# SPDX-License-Identifier: GPL-3.0-or-later
"""Light portals: samples of the background follow the density that hits are weighed by."""

from typing import Any

import numpy as np
import pytest

from engine.scene.description import Portal, World
from engine.state.portals import PORTAL_SHARE
from tests.helpers import light_probe as probe
from tests.helpers.chi2 import cell_integrals, histogram, p_value

UP = (0.0, 0.0, 1.0)
#: Towards x, from the side and above.
_WINDOW = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]).T


def _portal(position: Any, shape: str = "RECTANGLE", size: Any = (1.2, 0.8), turn: Any = None) -> Portal:
    return Portal(probe.matrix(position, turn), shape, *size)


def _sky() -> np.ndarray:
    sky = np.random.default_rng(0).random((16, 32, 3)).astype(np.float32)
    sky[12, 5] = 20.0
    return sky


def _lights(*portals: Portal, sky: np.ndarray | None = None) -> Any:
    world = World("w", "World", None, portals=list(portals))
    return probe.build(probe.make_description(world=world), background=_sky() if sky is None else sky)


_PORTALS = {
    "rectangle": (_portal((0.3, -0.2, 1.0)),),
    "disk": (_portal((0.3, -0.2, 1.0), "DISK", (0.9, 0.0)),),
    "ellipse": (_portal((0.0, 0.2, 0.8), "ELLIPSE", (1.5, 0.6)),),
    # They overlap, and one shines away from the receiver.
    "several": (
        _portal((0.3, -0.2, 1.0)), _portal((0.0, 0.0, 1.5), "SQUARE", (1.0, 0.0)), _portal((0.0, 0.0, -1.0)),
        _portal((-1.0, 0.0, 0.7), turn=_WINDOW),
    ),
    "behind": (_portal((0.0, 0.0, -1.0)),),
}  # fmt: skip


@pytest.mark.parametrize("leaves_dim", [False, True])
@pytest.mark.parametrize("kind", _PORTALS)
def test_samples_follow_their_density(kind: str, leaves_dim: bool) -> None:
    """Chi-square at 1e-3; the density of a sample is that of a hit in its direction."""
    lights, geometry = _lights(*_PORTALS[kind])
    count = 40_000
    u = np.random.default_rng(9).random((count, 3), np.float32)
    samples = probe.draw(lights, geometry, (0, 0, 0), UP, u, leaves_dim=leaves_dim)
    wi = samples[:, probe.WI : probe.WI + 3]

    def density(directions: np.ndarray) -> np.ndarray:
        return probe.hit_pdf(lights, (0, 0, 0), UP, directions, leaves_dim=leaves_dim)

    expected = cell_integrals(density, 32, 32, points=3, subdivisions=16)
    assert expected.sum() == pytest.approx(1.0, abs=0.02)
    assert p_value(histogram(wi, 32, 32), expected / expected.sum(), count) > 1e-3
    assert (np.abs(density(wi) - samples[:, probe.PDF]) <= 1e-3 * samples[:, probe.PDF]).mean() > 0.999


def test_a_share_of_samples_goes_through_the_portal() -> None:
    """As many more as `PORTAL_SHARE` says; all but as many as before from behind it."""
    plain, _ = _lights()
    lights, geometry = _lights(_portal((0.0, 0.0, 1.0), "SQUARE", (1.0, 0.0)))
    u = np.random.default_rng(3).random((20_000, 3), np.float32)

    def share(of: Any, height: float) -> float:
        wi = probe.draw(of, geometry, (0, 0, height), UP, u)[:, probe.WI : probe.WI + 3].astype(float)
        with np.errstate(divide="ignore"):
            place = wi[:, :2] / wi[:, 2:]
        return float(((wi[:, 2] > 0.0) & (np.abs(place) < 0.5).all(axis=1)).mean())

    drawn = float(lights.portals[0, PORTAL_SHARE])
    before = share(plain, 0.0)
    assert share(lights, 0.0) == pytest.approx(drawn + (1.0 - drawn) * before, abs=0.015)
    assert share(lights, 2.0) == pytest.approx(before, abs=0.015)


def test_nothing_is_linked_without_portals() -> None:
    """Nor for those without an area, or of a background that is not sampled."""
    flat, broken = _portal((0, 0, 1), size=(0.0, 1.0)), _portal((np.nan, 0, 1))
    for lights, _ in (_lights(), _lights(flat, broken), _lights(_portal((0, 0, 1)), sky=np.zeros((8, 16, 3), "f4"))):
        assert not len(lights.portals) and not lights.portal_kernels.any()
    assert _lights(_portal((0, 0, 1)))[0].portal_kernels.all()
