# SPDX-License-Identifier: GPL-3.0-or-later
"""What traces the rays of nodes in materials, linked where a scene has such nodes."""

from __future__ import annotations

from collections.abc import Sequence

from engine.render.batch import Batch
from engine.runtime.stage_table import StageTable
from engine.wavefront.node_rays import trace_op
from engine.wavefront.work import SceneView, Work


class LinkedNodeRays:
    """The kernel that the interpreter calls through a pointer."""

    def __init__(self) -> None:
        self._stages = StageTable({"trace_op": trace_op})
        self._linked_for: object = None

    def ready(self, batches: Sequence[Batch], scene: SceneView, traces: bool) -> None:
        """Have threads take a scene; none may be tracing.

        Parameters
        ----------
        traces : bool
            Whether a material has nodes that trace rays: then the kernel is loaded, or compiled.
        """
        for batch in batches:
            batch.take(scene, self._stages if traces else None)
        if traces and batches:
            self._link(scene, batches[0].work)

    def _link(self, scene: SceneView, work: Work) -> None:
        memory = work.registers
        taken = memory, memory.rays, scene.shaders, scene.geometry, work.points
        types = tuple(bundle._numba_type_ for bundle in taken)
        if types != self._linked_for:
            self._stages.link({"trace_op": (*taken, 0, 0)})
            self._linked_for = types
