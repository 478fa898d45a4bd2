# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks fingerprints`: hashes of many small pictures, to tell whether a change of code changes any.

Most cases are rendered by one thread and by two, which must agree to the bit. The hashes go into a JSON file and the
pictures into an .npz beside it, so that a difference from an earlier file can be measured. Hashes of different
machines or versions of libraries do not compare: floating-point results differ. So do, in their last digits, those of
a process that compiles kernels and of one that loads them: if any had to be compiled, all is rendered again by a new
process.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks import environment
from benchmarks.fingerprint_cases import CASES, FingerprintCase
from benchmarks.images import Float32Array
from benchmarks.patterns import matching
from benchmarks.scene_files import BUILTIN, SceneSource, open_scene
from engine.scene.description import SceneDescription
from engine.settings import RenderSettings

if TYPE_CHECKING:
    from engine.render.report import RenderReport

#: About so many pixels has a picture, if nothing else is asked for: more than one tile, and fast.
PIXELS = 1536
#: Samples a pixel that a sequence's field is trained with.
_SEQUENCE_TRAINING = 7


@dataclass(frozen=True)
class ImageFingerprint:
    """An image in few words: hash of its shape and float32 bytes, mean over everything."""

    hash: str
    mean: float

    @classmethod
    def of(cls, image: Float32Array) -> ImageFingerprint:
        """That of an image, float32 (height, width, channels)."""
        content = str(image.shape).encode() + np.ascontiguousarray(image, np.float32).tobytes()
        return cls(hashlib.sha256(content).hexdigest()[:16], float(image.mean(dtype=np.float64)))


@dataclass
class CaseFingerprint:
    """What a case came to.

    Attributes
    ----------
    images : dict
        By pass; of a sequence by pass and frame.
    thread_dependent : list of str
        Images that differ between the case's numbers of threads.
    trials : list of str
        What the renders compared while they went, for people (`GuidingReport.trials`).
    notices : list of str
        What the engine said of guiding: with a lost training process a picture is not that of the method.
    seconds : float
        Sum over all renders.
    """

    images: dict[str, ImageFingerprint] = field(default_factory=dict)
    thread_dependent: list[str] = field(default_factory=list)
    trials: list[str] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    seconds: float = 0.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.json", help="pictures go beside it, as .npz")
    parser.add_argument("--against", type=Path, metavar="OTHER.json", help="earlier fingerprints to compare with")
    parser.add_argument("--only", nargs="+", default=[], metavar="PATTERN", help="cases by name; default: all")
    parser.add_argument("--pixels", type=int, default=PIXELS, help="about so many a picture (default: %(default)s)")
    # What is rendered again after kernels were compiled.
    parser.add_argument("--again", action="store_true", help=argparse.SUPPRESS)


def fingerprints(chosen: argparse.Namespace, say: Callable[[str], None] = print) -> int:
    """Take fingerprints as the command line says.

    Returns
    -------
    int
        How many things are wrong: cases whose pictures depend on the number of threads or in which guiding failed,
        and pictures that differ from `--against`.

    Raises
    ------
    ValueError
        If there is no such case, `--against` is no file of fingerprints, or compiled kernels cannot be kept.
    """
    from numba.core import event

    if chosen.out.suffix != ".json":
        raise ValueError(f"--out {chosen.out}: give a file whose name ends in .json")
    cases = [CASES[name] for name in matching(CASES, chosen.only, "case")]
    # Before anything is rendered, and before --out may write to the same file.
    other = _Stored.read(chosen.against) if chosen.against else None
    taken: dict[str, CaseFingerprint] = {}
    pictures: dict[str, Float32Array] = {}
    with event.install_recorder("numba:compile") as compilations:
        for case in cases:
            found, images = take(case, chosen.pixels)
            taken[case.name] = found
            pictures.update({f"{case.name}/{name}": image for name, image in images.items()})
            say(f"{case.name}: {found.images[next(iter(images))].hash}, {found.seconds:.1f} s")
            for name in found.thread_dependent:
                say(f"  {name} depends on the number of threads")
            for notice in found.notices:
                say(f"  {notice}")
    if compilations.buffer:
        if chosen.again:
            raise ValueError("kernels are compiled each time: make sure that the kernel cache can be written")
        say("kernels were compiled: once more, by a process that loads them")
        return _again(chosen)
    stored = _Stored({name: asdict(found) for name, found in taken.items()}, pictures)
    stored.write(chosen.out, chosen.pixels)
    wrong = sum(bool(found.thread_dependent or found.notices) for found in taken.values())
    say(f"{len(pictures)} pictures of {len(taken)} cases; cases that depend on threads, or failed to guide: {wrong}")
    if other is not None:
        differences = list(compare(stored, other, all_cases=not chosen.only))
        for line in differences:
            say(line)
        say(f"differences from {chosen.against}: {len(differences)}")
        wrong += len(differences)
    return wrong


def _again(chosen: argparse.Namespace) -> int:
    """The same command by a new process; returns its exit status."""
    command = [sys.executable, "-m", "benchmarks", "fingerprints", "--again", "--out", str(chosen.out)]
    command += ["--pixels", str(chosen.pixels)]
    if chosen.against:
        command += ["--against", str(chosen.against)]
    if chosen.only:
        command += ["--only", *chosen.only]
    return subprocess.run(command, check=False).returncode


def take(case: FingerprintCase, pixels: int) -> tuple[CaseFingerprint, dict[str, Float32Array]]:
    """Render a case by each of its numbers of threads: its fingerprint, and the pictures by the first of them."""
    started = time.monotonic()
    found = CaseFingerprint()
    images, reports = render(case, pixels, case.threads[0])
    found.trials = [trial for report in reports for trial in report.guiding.trials]
    found.images = {name: ImageFingerprint.of(image) for name, image in images.items()}
    for threads in case.threads[1:]:
        again, more = render(case, pixels, threads)
        reports += more
        differing = [name for name, image in again.items() if ImageFingerprint.of(image) != found.images[name]]
        found.thread_dependent = [name for name in images if name in {*differing, *found.thread_dependent}]
    notices = [notice for report in reports for notice in report.notices if notice.subject.startswith("Guiding")]
    found.notices = list(dict.fromkeys(f"{notice.subject}: {notice.problem}; {notice.fallback}" for notice in notices))
    found.seconds = round(time.monotonic() - started, 2)
    return found, images


@cache
def _describe(scene_name: str, pixels: int, frames: tuple[float, ...]) -> list[SceneDescription]:
    """A built-in scene as it is exported; at each of `frames`, without motion blur, if there are any."""
    import bpy

    import addon
    from addon.export import ExportCache, export_frames, export_scene
    from benchmarks.scenes.studio import sort_faces

    # Some scenes do it themselves: what is exported must not depend on which of them came before.
    addon.register()
    scene = open_scene(SceneSource(BUILTIN + scene_name), pixels)
    for mesh in bpy.data.meshes:
        # The evening room has spheres of Blender's own.
        sort_faces(mesh)
    if not frames:
        return [export_scene(bpy.context.evaluated_depsgraph_get())]
    scene.render.use_motion_blur = False
    return export_frames(bpy.context.evaluated_depsgraph_get(), frames, cache=ExportCache())


def render(case: FingerprintCase, pixels: int, threads: int) -> tuple[dict[str, Float32Array], list[RenderReport]]:
    """A case's pictures by so many threads, and the renders' reports."""
    from engine.render.sequence import train_sequence
    from engine.render.session import Session

    settings = RenderSettings(**case.settings, threads=threads, deterministic=True)
    descriptions = _describe(case.scene, pixels, tuple(case.sequence))
    trained = None
    if case.sequence:
        span = (case.sequence[0], case.sequence[-1])
        trained = train_sequence(settings, descriptions, span, samples=_SEQUENCE_TRAINING)
    images: dict[str, Float32Array] = {}
    reports: list[RenderReport] = []
    for description in descriptions:
        session = Session(settings)
        try:
            session.load(description)
            source = None if trained is None else trained.source(settings, description)
            result = session.render(passes=case.passes, source=source)
        finally:
            session.close()
        suffix = f" of frame {description.frame_current:g}" if case.sequence else ""
        images.update({name + suffix: image for name, image in result.passes.items()})
        reports.append(result.report)
    return images, reports


@dataclass(frozen=True)
class _Stored:
    """A file of fingerprints and its pictures, by 'case/image'; none where the .npz is missing."""

    cases: Mapping[str, Any]
    pictures: Mapping[str, Float32Array]

    @classmethod
    def read(cls, path: Path) -> _Stored:
        """From a JSON file.

        Raises
        ------
        ValueError
            If it is none, or not of fingerprints.
        """
        try:
            cases = json.loads(path.read_text(encoding="utf-8"))["cases"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ValueError(f"--against {path}: no file that `fingerprints --out` wrote ({error})") from error
        beside = path.with_suffix(".npz")
        if not beside.is_file():
            return cls(cases, {})
        with np.load(beside) as archive:
            return cls(cases, dict(archive))

    def write(self, path: Path, pixels: int) -> None:
        """Into a JSON file and an .npz beside it."""
        path.parent.mkdir(parents=True, exist_ok=True)
        content = {"environment": environment.describe(), "pixels": pixels, "cases": self.cases}
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        np.savez_compressed(path.with_suffix(".npz"), **self.pictures)

    def hashes(self) -> dict[str, str]:
        """Hash of every picture, by 'case/image'."""
        return {
            f"{case}/{name}": image["hash"]
            for case, found in self.cases.items()
            for name, image in found["images"].items()
        }


def compare(new: _Stored, old: _Stored, *, all_cases: bool) -> Iterator[str]:
    """What differs, a line for each picture.

    Parameters
    ----------
    all_cases : bool
        Whether a case that only `old` has is a difference too.
    """
    hashes, before = new.hashes(), old.hashes()
    for name in hashes:
        if name not in before:
            yield f"{name}: new"
        elif hashes[name] != before[name]:
            yield f"{name}: {_measure(new.pictures.get(name), old.pictures.get(name))}"
    for name in before.keys() - hashes.keys():
        if all_cases or name.partition("/")[0] in new.cases:
            yield f"{name}: gone"


def _measure(new: Float32Array | None, old: Float32Array | None) -> str:
    """How far two pictures are apart, in words."""
    if new is None or old is None:
        return "differs; no picture is stored to measure it by"
    if new.shape != old.shape:
        return f"its shape was {old.shape} and is {new.shape}"
    difference = new.astype(np.float64) - old
    rms = np.sqrt(np.mean(difference**2))
    size = np.sqrt(np.mean(old.astype(np.float64) ** 2))
    relative = rms / size if size > 0.0 else float("inf")
    return (
        f"max abs difference {np.abs(difference).max():.3g}, relative RMS {relative:.3g}, "
        f"{(difference != 0.0).mean():.1%} of the values, mean {old.mean():.6g} -> {new.mean():.6g}"
    )
