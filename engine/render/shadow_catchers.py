# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of shadow catchers: the share of their light that the rest of the scene leaves them, and the picture with
their shadows over what is behind.

All as in Cycles, so that what users have learned of compositing holds.
"""

from __future__ import annotations

import numpy as np

from engine.state.film import CAUGHT_ALONE, CAUGHT_BACKGROUND, CAUGHT_COUNT, CAUGHT_COVER, CAUGHT_LIGHT
from engine.state.lanes import RGB

CATCHER_PASS = "Shadow Catcher"


def caught_share(caught: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Light of catchers over what they would have alone, over white: float32 (P, 3), 1 where there are none.

    Parameters
    ----------
    caught : float32 (P, CAUGHT_WIDTH)
        Sums or means of samples.
    alpha : float32 (P,)
        Opacity of the picture with its catchers.
    """
    light, alone = caught[:, CAUGHT_LIGHT : CAUGHT_LIGHT + RGB], caught[:, CAUGHT_ALONE : CAUGHT_ALONE + RGB]
    share = np.where(alone != 0.0, light / np.where(alone != 0.0, alone, np.float32(1.0)), np.float32(1.0))
    over = 1.0 + np.clip(alpha, 0.0, 1.0)[:, None] * (share - 1.0)
    return np.where(caught[:, CAUGHT_COUNT : CAUGHT_COUNT + 1] > 0.0, over, 1.0).astype(np.float32)


def with_shadows(
    color: np.ndarray, alpha: np.ndarray, caught: np.ndarray, *, is_transparent: bool, has_pass: bool
) -> tuple[np.ndarray, np.ndarray]:
    """The picture without its catchers, their shadows over what is behind.

    Parameters
    ----------
    color, alpha : float32 (P, 3) and (P,)
        Means of samples, catchers included.
    caught : float32 (P, CAUGHT_WIDTH)
        Means of samples.
    is_transparent : bool
        Shadows are alpha then; else they darken the background.
    has_pass : bool
        The Shadow Catcher pass is asked for: shadows are left to whoever puts the passes together.

    Returns
    -------
    color, alpha : float32 (P, 3) and (P,)
    """
    matte = color - caught[:, CAUGHT_LIGHT : CAUGHT_LIGHT + RGB]
    matte_alpha = np.clip(alpha - caught[:, CAUGHT_COVER], 0.0, 1.0)
    if has_pass:
        return matte, matte_alpha
    shadow = 1.0 - np.clip(caught_share(caught, alpha).mean(axis=1), 0.0, 1.0)
    covered = (1.0 - matte_alpha) * shadow + matte_alpha
    if is_transparent:
        return matte, covered
    background = caught[:, CAUGHT_BACKGROUND : CAUGHT_BACKGROUND + RGB]
    return matte + background * (1.0 - covered)[:, None], np.ones_like(covered)
