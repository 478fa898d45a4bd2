# SPDX-License-Identifier: GPL-3.0-or-later
"""What renders have learned: kept in memory from one to the next, saved to a file and loaded from one.

Fields in memory belong to a scene and a view layer. They are freed when another file is opened.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
from bpy_extras.io_utils import ExportHelper, ImportHelper

from .log import logger

if TYPE_CHECKING:
    from engine.guiding.saved.learned import LearnedField
    from engine.scene.description import Notice
    from engine.settings import RenderSettings

#: Ends names of files; `engine.guiding.saved.file.SUFFIX`, which takes seconds to import.
SUFFIX = ".ngfield"
_SUBJECT = "Learned Field"


def _stamp(path: Path | None) -> Any:
    """What tells a file from what it was; None where there is none."""
    if path is None:
        return None
    try:
        facts = path.stat()
    except OSError:
        return None
    return path, facts.st_mtime_ns, facts.st_size, facts.st_ino


@dataclasses.dataclass(frozen=True)
class _Kept:
    """What was learned, and the file that was looked at or saved last by then (`_stamp`)."""

    learned: LearnedField
    file: Any


#: By names of scene and view layer.
_kept: dict[tuple[str, str], _Kept] = {}
#: The last file that was read or written, so that frames do not read it again: stamp and content.
_last_file: tuple[Any, LearnedField] | None = None


def kept_field(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> LearnedField | None:
    """What renders of a view layer have learned, while it is in memory."""
    kept = _kept.get((scene.name, view_layer.name))
    return None if kept is None else kept.learned


def field_path(scene: bpy.types.Scene) -> Path | None:
    """The file that the scene names, None if it names none."""
    text = scene.neuralguide.field_path
    return Path(bpy.path.abspath(text)) if text else None


def read(path: Path) -> LearnedField:
    """The field of a file.

    Raises
    ------
    FieldFileError
        Naming the file, what is wrong with it and what to do.
    """
    global _last_file
    from engine.guiding.saved.file import load_field

    stamp = _stamp(path)
    if stamp is None or _last_file is None or _last_file[0] != stamp:
        _last_file = (stamp, load_field(path))
    return _last_file[1]


def write(path: Path, learned: LearnedField) -> None:
    """Save a field.

    Raises
    ------
    FieldFileError
        If it cannot be written.
    """
    global _last_file
    from engine.guiding.saved.file import save_field

    save_field(path, learned)
    _last_file = (_stamp(path), learned)


class FieldPlan:
    """What renders of a view layer start from, and where they save what they learn.

    Parameters
    ----------
    depsgraph : Depsgraph
    settings : RenderSettings
        Settings of the layer.
    """

    def __init__(self, depsgraph: bpy.types.Depsgraph, settings: RenderSettings) -> None:
        scene = depsgraph.scene_eval
        ours = scene.neuralguide
        self._owner = (scene.name, depsgraph.view_layer_eval.name)
        self._path = field_path(scene) if settings.is_guided else None
        self._keeps = settings.is_guided and ours.keep_learned
        self._saves = self._path is not None and ours.save_field
        # The same image every time: not another one since there was a render before.
        self._uses_memory = self._keeps and not settings.deterministic
        self._may_write = True

    @property
    def keeps(self) -> bool:
        """Whether what is learned is wanted."""
        return self._keeps or self._saves

    def start(self, session: Any) -> tuple[LearnedField | None, list[Notice]]:
        """What a render of the session's scene starts from, and what the user should know."""
        kept = _kept.get(self._owner) if self._uses_memory else None
        if kept is not None and kept.learned.light_digest != session.light_digest:
            kept = None
        if self._path is None:
            return (None if kept is None else kept.learned), []
        stamp = _stamp(self._path)
        if kept is not None and stamp == kept.file:
            return kept.learned, []
        if stamp is None and self._saves:
            # The first render makes it.
            return (None if kept is None else kept.learned), []
        from engine.guiding.saved.file import FieldFileError
        from engine.scene.description import Notice

        try:
            found = read(self._path)
        except FieldFileError as error:
            self._may_write = stamp is None
            return (None if kept is None else kept.learned), [Notice(_SUBJECT, str(error), "the render learns anew")]
        if kept is not None and found.light_digest != session.light_digest:
            return kept.learned, []
        return found, []

    def take(self, learned: LearnedField | None) -> list[Notice]:
        """Keep what a render has learned, and save it; returns what went wrong."""
        if learned is None:
            return []
        notices = self._save(learned) if self._saves else []
        if self._keeps:
            _kept[self._owner] = _Kept(learned, _stamp(self._path))
        return notices

    def _save(self, learned: LearnedField) -> list[Notice]:
        from engine.guiding.saved.file import FieldFileError
        from engine.scene.description import Notice

        assert self._path is not None
        where = "it stays in memory" if self._keeps else "it is lost with this render"
        if not self._may_write:
            problem = f"{self._path} could not be read, so it is not overwritten: choose another file, or remove it"
            return [Notice(_SUBJECT, problem, where)]
        try:
            write(self._path, learned)
        except FieldFileError as error:
            return [Notice(_SUBJECT, str(error), where)]
        logger.info(f"learned field saved to {self._path}: {learned}")
        return []


class NEURALGUIDE_OT_save_learned_field(bpy.types.Operator, ExportHelper):  # noqa: N801 (Blender's convention)
    """Save what renders of this view layer have learned to a file, for later renders to start from"""

    bl_idname = "neuralguide.save_learned_field"
    bl_label = "Save Learned Field"
    filename_ext = SUFFIX
    filter_glob: bpy.props.StringProperty(default=f"*{SUFFIX}", options={"HIDDEN"})  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where something was learned."""
        return context.scene is not None and kept_field(context.scene, context.view_layer) is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Save, and have later renders start from the file."""
        from engine.guiding.saved.file import FieldFileError

        scene, layer = context.scene, context.view_layer
        learned = kept_field(scene, layer)
        assert learned is not None
        path = Path(bpy.path.abspath(self.filepath))
        try:
            write(path, learned)
        except FieldFileError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        scene.neuralguide.field_path = self.filepath
        _kept[scene.name, layer.name] = _Kept(learned, _stamp(path))
        self.report({"INFO"}, f"Saved to {path}: {learned}")
        return {"FINISHED"}


class NEURALGUIDE_OT_load_learned_field(bpy.types.Operator, ImportHelper):  # noqa: N801
    """Have renders of this scene start from a file that was saved before; what was learned since is forgotten"""

    bl_idname = "neuralguide.load_learned_field"
    bl_label = "Load Learned Field"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012
    filename_ext = SUFFIX
    filter_glob: bpy.props.StringProperty(default=f"*{SUFFIX}", options={"HIDDEN"})  # type: ignore[valid-type]

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Look whether it can be read, and name it in the scene."""
        from engine.guiding.saved.file import FieldFileError

        scene = context.scene
        path = Path(bpy.path.abspath(self.filepath))
        try:
            learned = read(path)
        except FieldFileError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        scene.neuralguide.field_path = self.filepath
        for owner in [owner for owner in _kept if owner[0] == scene.name]:
            del _kept[owner]
        self.report({"INFO"}, f"Renders start from {path}: {learned}")
        return {"FINISHED"}


@bpy.app.handlers.persistent
def forget(*_args: Any) -> None:
    """Free all fields."""
    global _last_file
    _last_file = None
    _kept.clear()


_classes = (NEURALGUIDE_OT_save_learned_field, NEURALGUIDE_OT_load_learned_field)


def register() -> None:
    """Register the operators, and have fields freed when another file is opened."""
    for cls in _classes:
        bpy.utils.register_class(cls)
    bpy.app.handlers.load_pre.append(forget)


def unregister() -> None:
    """Undo `register`, and free all fields."""
    if forget in bpy.app.handlers.load_pre:
        bpy.app.handlers.load_pre.remove(forget)
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
    forget()
