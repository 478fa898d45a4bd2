# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur: what moves while the shutter is open, seen at the times Cycles would look at it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import compress

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array
from engine.scene.description import Camera, Instances, SceneDescription

from .camera import export_camera
from .context import ExportContext
from .deformation import ShapeTrack
from .instances import Appearances, is_invertible
from .moments import Moment, Observer, find_again
from .shutter import Clock, Shutter, motion_step_count

#: What of two float32 matrices may differ without anything having moved, relative to their largest entry.
_NOISE = 4.0 * float(np.finfo(np.float32).eps)
#: What of a camera may change before it is worth a notice, relative.
_CAMERA_CHANGE = 1e-3


def add_motion(
    context: ExportContext,
    clock: Clock,
    shutter: Shutter,
    description: SceneDescription,
    appearances: Appearances,
    chosen: npt.NDArray[np.intp],
    camera_object: bpy.types.Object,
) -> None:
    """Visit all times of the shutter and put into `description` what moves.

    Times of objects with fewer steps are among those of objects with more. Blender stands at the middle of the
    shutter, and is left where the last time was.

    Parameters
    ----------
    appearances : Appearances
        Seen at the middle of the shutter.
    chosen : intp (N,)
        Rows of `appearances` that the instances of `description` are.
    camera_object : Object
        Original.

    Raises
    ------
    ExportCancelled
        Once `should_cancel()` is true.
    """
    instances = description.instances
    kind_steps = np.array([*(kind.motion_step_count for kind in appearances.kinds), 0], np.int64)
    steps = kind_steps[appearances.kind[chosen]]
    camera = CameraTrack(context, camera_object, description.camera)
    shapes = ShapeTrack(context, description, appearances, chosen, shutter)
    count = max(int(steps.max(initial=0)), camera.step_count, shapes.step_count)
    if count == 0:
        return
    track = TransformTrack(context, instances, steps, count)
    lights = np.array([*(kind.light is not None for kind in appearances.kinds), False], bool)[appearances.kind]
    restless = np.zeros(len(appearances.kind), bool)
    observer = Observer(context)
    middle = observer.look()
    for step in range(count):
        if 2 * step == count - 1:
            continue
        context.check_cancel()
        clock.go_to(shutter.time(2 * step / (count - 1) - 1))
        context.check_cancel()
        camera.look(step, count)
        moment = observer.look()
        where = find_again(middle.keys, moment.keys)[appearances.item]
        track.look(step, moment, where[chosen])
        shapes.look(step, count, moment, where)
        known = np.flatnonzero(lights & (where >= 0))
        before = middle.transform[appearances.item[known]]
        restless[known] |= differ(before, moment.transform[where[known]])
    camera.finish()
    instances.motion = track.result()
    shapes.finish()
    for row in np.unique(appearances.kind[restless]).tolist():
        context.notice(
            appearances.kinds[row].name,
            "moves while the shutter is open, and lamps are not blurred, as in Cycles",
            "where it is in the middle",
        )
    is_particle = np.array([*(kind.is_particle for kind in appearances.kinds), False], bool)[appearances.kind[chosen]]
    if (is_particle & track.is_missing).any():
        # As Cycles: nobody knows where a particle that is born or dies meanwhile comes from or goes.
        _keep(instances, ~(is_particle & track.is_missing))


def differ(a: Float32Array, b: Float32Array) -> npt.NDArray[np.bool_]:
    """Whether matrices differ by more than rounding; float32 (N, 4, 4) each, bool (N,)."""
    moved = np.zeros(len(a), bool)
    with np.errstate(invalid="ignore", over="ignore"):
        # Far from the origin the translation is rounded more than the rest.
        for part in (np.s_[:, :3, :3], np.s_[:, :3, 3:]):
            first, second = a[part], b[part]
            size = np.maximum(np.abs(first), np.abs(second)).max(axis=(1, 2))
            moved |= ~(np.abs(first - second).max(axis=(1, 2)) <= _NOISE * size)
    return moved


class TransformTrack:
    """Transforms of all instances at all times, of which only those that moved are kept."""

    def __init__(
        self, context: ExportContext, instances: Instances, steps: npt.NDArray[np.int64], count: int
    ) -> None:
        self._context = context
        self._instances = instances
        self._steps = steps
        # An instance is looked at every so many times; one that is not blurred never.
        self._stride = np.where(steps > 0, (count - 1) // np.maximum(steps - 1, 1), count)
        self._moved: list[tuple[int, npt.NDArray[np.intp], Float32Array]] = []
        #: Whether an instance was not shown at one of its times.
        self.is_missing = np.zeros(len(steps), bool)

    def look(self, step: int, moment: Moment, where: npt.NDArray[np.intp]) -> None:
        """Compare the time `step` with the middle; `where` intp (N,) has rows of `moment`, -1 = not shown."""
        rows = np.flatnonzero((self._steps > 0) & (step % self._stride == 0))
        is_shown = where[rows] >= 0
        self.is_missing[rows[~is_shown]] = True
        rows = rows[is_shown]
        transform = moment.transform[where[rows]]
        is_good = is_invertible(transform)
        for row in rows[~is_good].tolist():
            self._context.notice(
                self._instances.name[row],
                "has a transform that is not finite or flattens it (zero scale) while the shutter is open",
                "then where it is in the middle",
            )
        has_moved = is_good & differ(transform, self._instances.transform[rows])
        if has_moved.any():
            self._moved.append((step, rows[has_moved], transform[has_moved]))

    def result(self) -> dict[int, Float32Array]:
        """Transforms of each instance that moved, at its own times."""
        motion: dict[int, Float32Array] = {}
        for step, rows, transforms in self._moved:
            for row, transform in zip(rows.tolist(), transforms, strict=True):
                if row not in motion:
                    motion[row] = np.repeat(self._instances.transform[row][None], self._steps[row], axis=0)
                motion[row][step // self._stride[row]] = transform
        return dict(sorted(motion.items()))


@dataclass
class CameraTrack:
    """The camera at its own times, and its field of view at the ends of the shutter."""

    context: ExportContext
    camera_object: bpy.types.Object
    middle: Camera
    _transforms: dict[int, Float32Array] = field(default_factory=dict)
    _lenses: dict[int, tuple[float, float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        #: 0 if it is not blurred.
        self.step_count = motion_step_count(self.camera_object.evaluated_get(self.context.depsgraph))

    def look(self, step: int, count: int) -> None:
        """Read it at the time `step` of `count`, if that is one of its own."""
        is_own = self.step_count > 0 and step % ((count - 1) // (self.step_count - 1)) == 0
        # As Cycles: it zooms even where it does not move by its own switch.
        is_end = step in (0, count - 1)
        if not (is_own or is_end):
            return
        name = self.camera_object.name
        try:
            camera = export_camera(self.context, self.camera_object)
        except ValueError:
            problem = "is scaled to zero or infinity while the shutter is open"
            self.context.notice(name, problem, "then where it is in the middle")
            return
        if is_own:
            self._transforms[step * (self.step_count - 1) // (count - 1)] = camera.transform
        if is_end and camera.kind == "PERSP":
            lens = _lens(camera)
            if all(0.0 < length < math.inf for length in lens):
                self._lenses[0 if step == 0 else 1] = lens
            else:
                problem = "has a lens or sensor of no size, NaN or infinity while the shutter is open"
                self.context.notice(name, problem, "then as in the middle")
        if _is_adjusted(camera, self.middle):
            problem = "changes scale, shift or focus while the shutter is open, which does not blur, as in Cycles"
            self.context.notice(name, problem, "as at the frame itself")

    def finish(self) -> None:
        """Put into the middle's camera how it moves and zooms."""
        if self._transforms:
            motion = np.repeat(self.middle.transform[None], self.step_count, axis=0)
            for step, transform in self._transforms.items():
                motion[step] = transform
            if differ(motion, np.broadcast_to(self.middle.transform, motion.shape)).any():
                self.middle.motion = motion
        lens = _lens(self.middle)
        ends = self._lenses.get(0, lens), self._lenses.get(1, lens)
        if ends != (lens, lens):
            self.middle.lens_motion = np.array(ends, np.float32)


def _lens(camera: Camera) -> tuple[float, float, float]:
    """What of a perspective camera makes its field of view."""
    return camera.lens, camera.sensor_width, camera.sensor_height


def _is_adjusted(camera: Camera, middle: Camera) -> bool:
    """Whether something changes that Cycles looks at once for all times."""
    names = ["shift_x", "shift_y"]
    if middle.kind == "ORTHO":
        names.append("ortho_scale")
    if middle.use_dof:
        names += ["focus_distance", "aperture_fstop"]
    for name in names:
        now, then = getattr(camera, name), getattr(middle, name)
        if not abs(now - then) <= _CAMERA_CHANGE * max(abs(now), abs(then)):
            return True
    return False


def _keep(instances: Instances, is_kept: npt.NDArray[np.bool_]) -> None:
    """Leave only some of the instances."""
    count = len(is_kept)
    rows = np.cumsum(is_kept) - 1
    instances.motion = {int(rows[row]): motion for row, motion in instances.motion.items() if is_kept[row]}
    instances.name = list(compress(instances.name, is_kept))
    if instances.asset is not None:
        instances.asset = list(compress(instances.asset, is_kept))
    for name, values in vars(instances).items():
        if isinstance(values, np.ndarray) and name != "materials" and len(values) == count:
            setattr(instances, name, values[is_kept])
