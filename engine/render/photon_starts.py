# SPDX-License-Identifier: GPL-3.0-or-later
"""Where photons begin: by what paths and photons have told so far, and a little everywhere.

What weighs them against paths goes by these densities, so that they decide about noise alone.
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, FloatArray
from engine.render.photons_within import scattered_power
from engine.state.photons import PHOTON_POWER, PHOTON_START, CasterArrays, PhotonMap, no_photons

#: Shares of photons that begin by area, where paths look for lamps, where photons have brought light from, and by both
#: together.
_EVERYWHERE, _SEEN, _LIT, _BOTH = 0.1, 0.15, 0.15, 0.6
#: And before photons have brought any: by area, the others where paths look for lamps.
_EVERYWHERE_AT_FIRST = 0.25
#: Of how many photons' worth is what is known of a whole side of an object, when a group of pieces is judged.
_PRIOR = 4.0
#: Bounds on the relative variance of how often groups of one side of an object are looked for lamps from.
_DIFFER = (1e-3, 20.0)


class Starts:
    """The sides of casters' pieces, S = 2 Q rows as in PhotonMap, and their groups."""

    def __init__(self, casters: CasterArrays) -> None:
        sides = np.arange(2)
        self.area = np.repeat(casters.area.astype(np.float64), 2)
        self._group = (2 * casters.group.astype(np.int64)[:, None] + sides).ravel()
        instance = casters.instance[casters.row].astype(np.int64)
        self._object = (2 * instance[:, None] + sides).ravel()
        self._area_of_group = np.bincount(self._group, self.area)
        self._object_of_group = np.zeros(len(self._area_of_group), np.int64)
        self._object_of_group[self._group] = self._object

    def at_first(self, seen: Float32Array | None = None) -> PhotonMap:
        """A map without photons that says how they begin.

        Parameters
        ----------
        seen : float32 (S,), or None
            How often paths have looked for lamps from there.
        """
        probability = self.area / self.area.sum()
        if seen is not None and seen.any():
            probability *= _EVERYWHERE_AT_FIRST
            probability += (1.0 - _EVERYWHERE_AT_FIRST) * self._by_area(self._looks(seen))
        return self._begins(probability)

    def by_light(self, seen: Float32Array, before: PhotonMap, emitted: int) -> PhotonMap:
        """As `at_first`, once photons have told how much light comes from where.

        Parameters
        ----------
        before : PhotonMap
            Their map.
        emitted : int
            How many have been sent off for it.
        """
        if not seen.any() or not len(before.photons) + len(before.within):
            return self.at_first(seen)
        start = np.concatenate([before.photons, before.within])[:, PHOTON_START].astype(np.int64)
        power = np.concatenate([_power(before.photons), scattered_power(before)])
        density = before.place_density.astype(np.float64)
        # What a photon has brought, times the density with which it began, is light per area.
        brought = np.bincount(start, power * density[start], len(self.area))
        begun = emitted * density * self.area
        of_object = np.bincount(self._object, brought) / np.maximum(np.bincount(self._object, begun), 1.0)
        prior = np.bincount(self._group, of_object[self._object] * self.area) / np.maximum(self._area_of_group, 1e-30)
        of_group = np.bincount(self._group, brought) + _PRIOR * prior
        lit = (of_group / (np.bincount(self._group, begun) + _PRIOR))[self._group]
        looks = self._looks(seen)
        if not (lit * looks).any():
            return self.at_first(seen)
        probability = _EVERYWHERE * self.area / self.area.sum()
        for share, wanted in ((_SEEN, looks), (_LIT, lit), (_BOTH, lit * looks)):
            probability += share * self._by_area(wanted)
        return self._begins(probability)

    def _looks(self, seen: Float32Array) -> FloatArray:
        """The square root of how often paths look for lamps per area, of each row: float64 (S,).

        Noise is least where photons go by the light they bring and the root of how often it is seen. A few paths meet
        a group, or none does by chance: so what a group has is drawn towards the mean of its object's side, the more
        the less groups differ beyond chance (gamma-Poisson shrinkage; Efron and Morris 1973).
        """
        counts = np.bincount(self._group, seen)
        per_area = np.bincount(self._object, seen) / np.maximum(np.bincount(self._object, self.area), 1e-30)
        expected = per_area[self._object_of_group] * self._area_of_group
        differ = np.bincount(self._object_of_group, (counts - expected) ** 2 - expected)
        differ /= np.maximum(np.bincount(self._object_of_group, expected**2), 1e-30)
        shape = 1.0 / np.clip(differ, *_DIFFER)[self._object_of_group]
        looks: FloatArray = np.sqrt(per_area[self._object_of_group] * (counts + shape) / (expected + shape))
        return looks[self._group]

    def _by_area(self, per_area: FloatArray) -> FloatArray:
        """Probabilities of rows that go by something per area: float64 (S,)."""
        probability: FloatArray = per_area * self.area
        return probability / probability.sum()

    def _begins(self, probability: FloatArray) -> PhotonMap:
        cumulative = np.cumsum(probability)
        cumulative /= cumulative[-1]
        return no_photons((probability / self.area).astype(np.float32), cumulative)


def _power(photons: Float32Array) -> FloatArray:
    """What each has brought, mean over channels [W]: float64."""
    power: FloatArray = np.abs(photons[:, PHOTON_POWER : PHOTON_POWER + 3]).mean(axis=1, dtype=np.float64)
    return power
