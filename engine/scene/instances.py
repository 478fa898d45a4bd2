# SPDX-License-Identifier: GPL-3.0-or-later
"""Instances with nothing special about them, so that whoever writes a description by hand gives few numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.scene.description import VISIBLE_ALL, VISIBLE_RAYCAST, Instances


def plain_instances(
    transforms: npt.ArrayLike, *, meshes: int | Sequence[int] = 0, materials: int | Sequence[int] = 0,
    name: str = "Object",
) -> Instances:
    """Instances with nothing special about them, seen by every ray.

    Parameters
    ----------
    transforms : float (N, 4, 4), object to world
    meshes, materials : int or sequence of N
        One for all, or one for each.
    """
    transforms = np.asarray(transforms, np.float32).reshape(-1, 4, 4)
    count = len(transforms)
    of_each = not isinstance(materials, int)
    return Instances(
        mesh=np.full(count, meshes, np.int32),
        transform=transforms,
        material_offset=np.arange(count, dtype=np.int32) if of_each else np.zeros(count, np.int32),
        materials=np.atleast_1d(np.asarray(materials, np.int32)),
        visibility=np.full(count, VISIBLE_ALL | VISIBLE_RAYCAST, np.uint32),
        pass_index=np.zeros(count, np.int32),
        random=np.zeros(count, np.float32),
        color=np.ones((count, 4), np.float32),
        is_holdout=np.zeros(count, np.bool_),
        name=[name] * count,
        dupli_generated=np.zeros((count, 3), np.float32),
        dupli_uv=np.zeros((count, 2), np.float32),
    )


def select_instances(instances: Instances, rows: npt.NDArray[np.integer]) -> Instances:
    """These instances alone, in this order; their materials stay where they are."""
    number_of = {int(row): number for number, row in enumerate(rows)}
    whole = ("materials", "name", "asset", "motion", "properties")
    columns = {item.name: getattr(instances, item.name) for item in fields(instances) if item.name not in whole}
    chosen: dict[str, Any] = {name: None if column is None else column[rows] for name, column in columns.items()}
    return replace(
        instances,
        **chosen,
        name=[instances.name[row] for row in rows],
        asset=None if instances.asset is None else [instances.asset[row] for row in rows],
        motion={number_of[row]: steps for row, steps in instances.motion.items() if row in number_of},
        properties={name: values[rows] for name, values in instances.properties.items()},
    )


def empty_instances() -> Instances:
    """`Instances` of nothing."""
    return plain_instances(np.zeros((0, 4, 4)), materials=())
