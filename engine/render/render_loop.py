# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render does from its first sample to its last, whoever traces it: threads of this process, or a cluster.

It hands out tasks, adds their results to the film, and learns between iterations. Which task is traced where and
when changes nothing: a tile's tasks follow each other in the order of their samples, and what was recorded is learned
from tile by tile.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Traced
from engine.guiding.policy.iterations import LearningRests
from engine.guiding.policy.learner import Learner
from engine.guiding.policy.sets import make_learner
from engine.guiding.policy.trial import ArmSamples
from engine.guiding.records.unit_records import UnitRecords
from engine.render.batch import Statistics
from engine.render.bridge import Bridge, bridge_samples
from engine.render.bridged import BridgedIterations
from engine.render.film import Film
from engine.render.looks import Looks
from engine.render.loop_state import LoopState
from engine.render.path_progress import PathProgress
from engine.render.plain_schedules import PlainPart
from engine.render.report import Progress
from engine.render.request import RenderRequest
from engine.render.schedule import (
    Begin,
    Iterations,
    Schedule,
    Task,
    task_samples,
)
from engine.render.strata import StrataFilm, StrataSchedule
from engine.render.tiles import FrameTiles, Tile, TrialTiles
from engine.render.time_left import TimeLeft
from engine.state.columns import rows_of
from engine.state.film import FilmTile
from engine.state.unit import ALL_STRATA, BRIDGE, CURRENT, PLAIN, Unit, UnitCosts

#: With fewer pixels guiding is tried on all of them: a quarter would say too little.
_LEAST_TRIAL_PIXELS = 1 << 12

#: See `RenderLoop`.
Follow = Callable[[Guidance, int], None]


def _put(film: Film, units: Sequence[Unit], sums: FilmTile, weight: float) -> FilmTile:
    """Put sums of samples on the film that weigh so much; returns them as of the whole of u."""
    pixels = np.concatenate([unit.film_index for unit in units]) if len(units) > 1 else units[0].film_index
    if isinstance(film, StrataFilm):
        return film.merge_stratum(pixels, sums, weight, units[0].stratum)
    film.merge(pixels, sums, weight)
    return sums


def _by_unit(units: Sequence[Unit], sums: FilmTile) -> Iterator[FilmTile]:
    """Sums of each unit; rows are of one unit after the other."""
    if len(units) == 1:
        yield sums
        return
    row = 0
    for unit in units:
        yield rows_of(sums, row, row + len(unit.pixels))
        row += len(unit.pixels)


class RenderLoop:
    """One render's loop.

    Who shares it among threads holds `changed` for `has_task`, `take`, `clear` and `finish`, and `film_lock` for
    `keep`. `begin_next` takes `changed` itself.

    Parameters
    ----------
    request : RenderRequest
    film : Film
        As `request.make_film` makes it.
    thread_count : int
        To learn with.
    follow : callable (Guidance, arm) -> None
        Is told what tasks go by that are handed out after the call. No task is out meanwhile but those of the arm
        BRIDGE, for which it is told so itself.
    light_clusters : bool (C,), optional
        As of `RenderContext`.

    Attributes
    ----------
    changed : threading.Condition
        To be notified when there may be tasks.
    ended_by : str
        Of `ENDINGS`, once it is known.
    has_image : bool
        Whether every tile has been handed out once.
    guidance : Guidance or None
        What `follow` was told last.
    tiles : sequence of Tile
        That tasks speak of; a noise threshold changes them between steps.
    strata : int
    largest : int
        Pixels of the largest tile.
    looks : Looks
    time_left : TimeLeft
    paths : PathProgress
    """

    def __init__(
        self, request: RenderRequest, film: Film, thread_count: int, follow: Follow,
        light_clusters: npt.NDArray[np.bool_] | None = None,
    ) -> None:
        frame, settings, resumed = request.frame, request.settings, request.resumed
        self.film, self.settings, self.samples = film, settings, request.samples + resumed.skipped
        self._follow = follow
        self.film_lock, self.changed = threading.Lock(), threading.Condition()
        self.ended_by, self.has_image = resumed.ended_by, resumed.has_image
        #: Whether somebody learns now, so that nobody may ask what was learned.
        self._is_busy = False
        self.guidance: Guidance | None = None
        tiles = FrameTiles(frame)
        self.tiles: Sequence[Tile] = tiles
        self.strata = max(settings.strata, 1)
        self.looks = Looks(request, film, tiles, thread_count)
        #: Which pixels go on, where there is a noise threshold.
        self._active = self.looks.active
        whole = ALL_STRATA if self.strata > 1 else 0
        self.time_left = TimeLeft(settings.time_limit, resumed.seconds)
        self._plain = PlainPart(self.samples, self.looks, self.time_left, whole, resumed.skipped)
        #: What iterations count samples from.
        self._offset = resumed.samples + resumed.skipped
        self._schedule: Schedule
        self._iterations: BridgedIterations | None = None
        self.largest, pixel_count = tiles.largest, tiles.pixel_count
        #: All pixels in other units, where guiding can be tried on a part of them.
        self._frame_tiles = tiles
        #: What is traced while the learner learns.
        self._bridge = Bridge(partial(_put, film))
        tries_on_part = settings.is_guided and pixel_count >= _LEAST_TRIAL_PIXELS and self.strata == 1
        self._trial_tiles = TrialTiles(frame) if tries_on_part else None
        trial_share = 1.0 if self._trial_tiles is None else self._trial_tiles.trial_pixels / pixel_count
        left = replace(settings, samples=max(settings.samples - resumed.samples, 1))
        self.learner: Learner | None = None if self._offset >= self.samples else make_learner(
            left, thread_count, pixel_count, tiles.largest, request.learning,
            light_clusters if settings.learns_lights else None, trial_share,
            has_media=film.layout.has_media and self.strata == 1,
        )
        if self.learner is not None:
            if self._active is not None and self._active.has_looked:
                self.tiles = self._active.tiles
                self.learner.narrow(self._active.count, self._active.expected_paths)
            strata = StrataSchedule(left, self.strata) if self.strata > 1 else None
            iterations = Iterations(self.samples - self._offset, strata, self.time_left.fit)
            self._iterations = BridgedIterations(iterations, self._bridge)
            self._schedule = self._iterations
            self._iterations.begin(self.learner.arms, len(self.tiles))
        else:
            self._offset = 0
            self._go_on_plainly(resumed.begin)
        self._units: dict[int, list[UnitRecords]] = {}
        #: Whether samples may be left unlearned from: not where what is learned outlives the render.
        self._bridges = request.learning.bridges(settings)
        #: What `_begin_iteration` takes, until the bridge to it is traced.
        self._planned: tuple[tuple[int, int], Sequence[Tile], bool] | None = None
        #: What the last learning has left, while iterations go by that nothing is learned from; None while none do.
        self._learned: Guidance | None = None
        self._rests = LearningRests(pixel_count, request.learning.rules)
        self._before = Statistics()
        self.paths = PathProgress(pixel_count, self.samples, settings.time_limit, resumed)

    # -- tasks --------------------------------------------------------------------------------------------------------

    def ready(self) -> None:
        """Say what the first tasks go by."""
        if self.learner is not None:
            self._go_by(self.learner.first())
        elif self._plain.is_between_steps and not self.ended_by:
            # It was interrupted before somebody looked at the picture.
            self.begin_next(self._before)

    def begin(self) -> None:
        """The first task is about to be traced: time runs from here on."""
        self.time_left.begin()
        if self.learner is not None:
            self.learner.begin()

    @property
    def time_is_up(self) -> bool:
        """Whether a time limit is reached, and there is an image."""
        return self.has_image and self.time_left.is_up

    @property
    def has_task(self) -> bool:
        """Whether there is something to hand out now. Once the time is up there is not."""
        if self._schedule.has_task and (self.time_is_up or self.ended_by):
            self.ended_by = self.ended_by or "TIME_LIMIT"
            self._schedule.clear()
        return self._schedule.has_task

    def take(self) -> Task:
        """The next task; there must be one."""
        task = self._schedule.take()
        if self._is_learning:
            self._try_bridge()
        return task

    def unit(self, task: Task) -> Unit:
        """What there is to trace."""
        return Unit(*self.tiles[task.tile], *self.arm_samples(task), task.stratum, self.strata, task.is_aside)

    def arm_samples(self, task: Task) -> ArmSamples:
        """Which samples a task is of, counted from the film's first."""
        first, count, arm = task.arm_samples
        return ArmSamples(self._offset + first, count, arm)

    def finish(self, task: Task) -> bool:
        """Take note of a task that `keep` has taken; True if `begin_next` is to be called: there is no other task."""
        is_waiting = self._schedule.finish(task)
        self._go_on()
        if not task.is_first or not self._schedule.lacks_first_tasks:
            self.has_image = True
        return is_waiting

    # -- their results -------------------------------------------------------------------------------------------------

    def records(self, arm: int) -> bool:
        """Whether what units of an arm record is of use now."""
        return self.learner is not None and arm not in (PLAIN, BRIDGE) and self._is_learning

    def keep(self, task: Task, unit: Unit, sums: FilmTile, costs: UnitCosts, records: UnitRecords | None) -> None:
        """Put a finished unit on the film, and what it recorded aside (None: nothing that `records` asks for)."""
        self.keep_alike([task], [unit], sums, [costs], None if records is None else [records])

    def keep_alike(
        self, tasks: Sequence[Task], units: Sequence[Unit], sums: FilmTile, costs: Sequence[UnitCosts],
        records: Sequence[UnitRecords] | None,
    ) -> None:
        """As `keep`, of alike tasks of several tiles (`is_alike`); rows of `sums` are of one unit after the other."""
        task, unit, learner = tasks[0], units[0], self.learner
        self._plain.keep(tasks)
        for index, of_unit in enumerate(records or ()):
            self._units.setdefault(tasks[index].tile, []).append(of_unit)
        self.paths.add(sum(one.path_count for one in units), unit.sample_first + unit.sample_count)
        if unit.arm == BRIDGE:
            self._bridge.keep(units, sums)
            return
        sums = _put(self.film, units, sums, 1.0 if learner is None else learner.weight(task.weighs_as, unit.arm))
        if learner is not None:
            for one, of_one, its_costs in zip(units, _by_unit(units, sums), costs, strict=True):
                learner.compare(one, of_one, its_costs)

    def end(self) -> float:
        """Nobody traces any more: put on the film what a learning that was cut off held. Time since `begin` [s]."""
        self.ended_by = self.ended_by or "SAMPLES"
        with self.film_lock:
            self._bridge.let_go()
        return self.time_left.elapsed - self.time_left.before

    @property
    def has_all_pixels(self) -> bool:
        """Whether `tiles` are those of the whole frame (`FrameTiles`)."""
        return self.tiles is self._frame_tiles

    def progress(self, rays: int, message: str = "") -> Progress:
        """Where it stands now, with so many rays traced; `message` is for while nobody knows how the render ends."""
        return self.paths.report(self.time_left.elapsed, rays, self.ended_by, message, self._active)

    # -- between iterations and steps ---------------------------------------------------------------------------------

    @property
    def _is_learning(self) -> bool:
        """Whether the render goes in iterations: it is guided, and guiding has not been given up."""
        return self._schedule is self._iterations

    def begin_next(self, counted: Statistics, *, is_stopped: bool = False) -> None:
        """After the last unit of an iteration or a step: look at the picture, learn, and begin the next.

        Nobody else calls anything meanwhile but `has_task` and `progress`.

        Parameters
        ----------
        counted : Statistics
            What all units have counted so far.
        is_stopped : bool
            Whether nothing more is to be rendered.
        """
        if self._is_learning:
            self._finish_iteration(counted, is_stopped)
            return
        steps, active = self._plain.steps, self._active
        assert steps is not None
        if steps.is_last or self._look(steps.next_sample):
            return
        with self.changed:
            self.tiles = self.tiles if active is None else active.tiles
            self._plain.begin_step(len(self.tiles))

    def _go_by(self, guidance: Guidance) -> None:
        self.guidance = guidance
        self._follow(guidance, CURRENT)

    def _go_on_plainly(self, begin: Begin) -> None:
        """Render the rest unguided."""
        if self._active is not None:
            self.tiles = self._active.tiles
        self._schedule = self._plain.begin(len(self.tiles), begin)

    def state(self, *, is_over: bool) -> LoopState | None:
        """How far it has come, for who holds `changed` and `film_lock`; None: a while later there will be an answer.

        `is_over`: whether nobody traces, learns or looks any more.
        """
        plain = self._plain.state(self.paths.finished, self.ended_by)
        if self._is_learning and self._iterations is not None:
            begun, end = self._iterations.in_hand
            return None if self._is_busy else plain.anew(self._offset + begun, self._offset + end)
        if self.learner is not None and len(plain.ends):
            plain = plain.anew(int(plain.ends.min()), int(plain.ends.max()))
        return None if self._plain.is_between_steps and not is_over else plain

    def _look(self, samples: int) -> bool:
        """Look at the picture, if it is time to; True if it is good enough."""
        ending = self.looks.look(self._offset + samples - self._plain.skipped, self.paths.expect)
        self.ended_by = ending or self.ended_by
        return bool(ending)

    def _finish_iteration(self, counted: Statistics, is_stopped: bool) -> None:
        """After the last unit of an iteration."""
        learner, iterations = self.learner, self._iterations
        assert learner is not None and iterations is not None
        samples = iterations.next_sample
        following = iterations.plan(self.time_left.elapsed)
        time_is_up = self.time_is_up
        if following is not None and time_is_up:
            self.ended_by = "TIME_LIMIT"
        is_last = following is None or time_is_up or self._look(samples)
        has_rested = self._learned is not None
        if is_stopped or (is_last and (has_rested or not learner.wants_last)):
            return
        units = [records for tile in range(len(self.tiles)) for records in self._units.get(tile, ())]
        self._units = {}
        if is_last:
            learner.take_last(units)
            return
        assert following is not None
        costs, self._before = counted.since(self._before), counted
        tiles: Sequence[Tile] = self._frame_tiles
        if self._active is not None:
            tiles = self._active.tiles
            learner.narrow(self._active.count, self._active.expected_paths)
        learns = not has_rested and (learner.wants_last or not self.time_left.is_short(*following))
        if learns:
            assert self.guidance is not None
            with self.changed:
                self._is_busy = True
                bridged = self._begin_bridge(following, tiles)
                self.changed.notify_all()
            following = following[0] + bridged, following[1] - bridged
            traced = Traced(
                units, self.guidance.record_threshold / 2**32, self.film.sums, (self.film.height, self.film.width),
                costs, following, iterations.is_whole,
            )
            self._go_by(learner.learn(traced))
            self._is_busy = False
            with self.film_lock:
                self._bridge.let_go()
        with self.changed:
            self._planned = following, tiles, learns
            self._go_on()

    def _try_bridge(self) -> None:
        """Begin the bridge while the iteration's last tasks are out, where nobody looks at the picture in between."""
        iterations, learner = self._iterations, self.learner
        assert iterations is not None and learner is not None
        if self._active is not None or self._learned is not None or not iterations.lacks_bridge:
            return
        if self.looks.wait_for(self._offset + iterations.next_sample - self._plain.skipped):
            return
        following = iterations.plan(self.time_left.elapsed)
        if following is not None and (learner.wants_last or not self.time_left.is_short(*following)):
            self._begin_bridge(following, self._frame_tiles)

    def _begin_bridge(self, following: tuple[int, int], tiles: Sequence[Tile]) -> int:
        """Hand out the first samples of the iteration that follows, to go by what there is; how many a pixel."""
        learner, iterations, guidance = self.learner, self._iterations, self.guidance
        assert learner is not None and iterations is not None and guidance is not None
        if iterations.bridged is None:
            first, count = following
            iterations.bridged = bridge_samples(learner.arms, learner.other_arms, count) if self._bridges else 0
            if iterations.bridged:
                self._follow(guidance.without_records(), BRIDGE)
                self.tiles = tiles
                iterations.begin_bridge(first, len(tiles), learner.weight(first, CURRENT))
        return iterations.bridged

    def _go_on(self) -> None:
        """Begin the iteration that is planned: tile by tile where it has the bridge's, else once all that is traced."""
        if self._planned is None:
            return
        assert self.learner is not None
        if self._bridge.is_traced or not (self.learner.is_over or self.learner.other_arms):
            planned, self._planned = self._planned, None
            self._begin_iteration(*planned)

    def _begin_iteration(self, following: tuple[int, int], tiles: Sequence[Tile], learns: bool) -> None:
        """Hand out the next iteration, of these samples, as the learner has planned it."""
        learner, iterations = self.learner, self._iterations
        assert learner is not None and iterations is not None
        if learner.is_over:
            # Nobody waits for anybody from here on, but for a look at the picture.
            self.tiles = tiles
            first, self._offset = self._offset + following[0], 0
            self._go_on_plainly(Begin(first, task_samples(first)))
            return
        arms = self._arms_of(*following)
        other_arms: Sequence[ArmSamples] = ()
        first_other = 0
        if learns and self._learned is None and learner.other_arms:
            assert self._trial_tiles is not None
            tiles, other_arms = self._trial_tiles, learner.other_arms
            first_other = self._trial_tiles.trial_count
        self.tiles = tiles
        iterations.begin(arms, len(self.tiles), other_arms, first_other)

    def _arms_of(self, first: int, count: int) -> Sequence[ArmSamples]:
        """Parts of the next iteration: as the learner says, or all alike where nothing is to be learned from it."""
        assert self.learner is not None
        rested, self._learned = self._learned, None
        if rested is not None:
            self._go_by(rested)
        active, guidance = self._active, self.guidance
        assert guidance is not None
        rests = active is not None and active.has_looked and self._rests.take(active.count, count)
        if rests or self.time_left.is_short(first, count):
            self._learned = guidance
            self._go_by(guidance.without_records())
        if rested is None and self._learned is None:
            return self.learner.arms
        return [ArmSamples(first, count, CURRENT)]
