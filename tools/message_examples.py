# SPDX-License-Identifier: GPL-3.0-or-later
"""What a message may say of a scene, by the expression that is put in: examples for docs/troubleshooting.md."""

from __future__ import annotations

_GIB = {"needed / 2 ** 30": "96.0", "there / 2 ** 30": "32.0"}
_SIZES = {
    "frame.width": "1920", "frame.height": "0", "width": "1920", "height": "1080", "x1 - x0": "32768", "y1 - y0": "32768",
    "frame.region": "(1900, 0, 1900, 1080)", "channels": "30", "channel_count": "3", "target.channels": "4",
    "len(target.rect)": "2073600", "triangles": "900000000", "instances": "12", "lights": "3", "size": "0.001 m",
    "pixels.shape": "(64, 64, 9)", "radiance.shape": "(512, 1024)", "image.shape": "(540, 960)", "(*shape, 3)": "(540, 960, 3)",
    "shape": "(7, 3)", "len(raw)": "17", "len(self)": "8", "MOST_KEYS": "129", "count": "4", "len(pool.workers())": "3",
    "int((~keep).sum())": "12", "wrong.negative": "40", "wrong.not_finite": "40", "_MOST_FAILURES": "3",
}  # fmt: skip
_NAMES = {
    "camera_object.name": "Camera", "context.scene.name": "Scene", "camera.kind": "FISHEYE_LENS", "name": "Cube",
    "self.subject": "Cube", "subject": "Cube", "identifier": "Density", "node.object.name": "Empty", "link.output": "Fac",
    "node.kind": "ShaderNodeBsdfHair", "part": "Sharpness", "title": "Glossy BSDF", "default": "GGX", "kind": "CUBEMAP",
    "space": "ACEScg", "data_type": "ROTATION", "lights[index].kind": "GLOW", "lights[index].name": "Lamp",
    "grid.valueTypeName": "bool", "parts[0].valueTypeName": "string", "wanted": "temperature", "index": "12", "group": "5",
    "target.name": "Depth", "self.name": "samples", "setting.name": "samples", "full_name.strip()": "sample",
    "', '.join(close)": "samples, preview_samples", "', '.join(_names(self.choices))": "AUTO, ON, OFF",
    "', '.join(bpy.data.scenes.keys())": "Scene, Scene.001", "known": "CYCLES, NEURALGUIDE",
    "', '.join(PREFILTERS)": "NONE, FAST, ACCURATE", "', '.join(QUALITIES)": "HIGH, BALANCED, FAST", "prefilter": "SLOW",
    "', '.join(_KINDS)": "PERSP, ORTHO, PANO", "quality": "BEST",
}  # fmt: skip
_VALUES = {
    "value": "-1", "form": "whole number", "self.limits": "1 to 16777216", "setting.limits": "1 to 16777216", "low": "0",
    "high": "1024", "text": "abc", "argument": "--frames", "span[0]": "1", "span[1]": "1", "scene.frame_start": "10",
    "scene.frame_end": "1", "version": "3", "VERSION": "2", "texts['rung']": "VMM_RIS2", "texts['verdict']": "MAYBE",
    "len(description.light_groups)": "2", "len(instances.mesh)": "10", "depsgraph.scene.frame_current": "1",
    "learned": "1,204 regions of 6.1 lobes", "item": "tile 12", "variable": "DASK_DISTRIBUTED__COMM__TLS__CA_FILE",
}  # fmt: skip
_PLACES = {
    "path": "/renders/room.ngfield", "self._path": "/renders/room.ngfield", "folder": "/tmp", "self._folder": "/tmp",
    "address": "tcp://10.0.0.5:8786", "cache_root()": "/home/ada/.cache/neuralguide/kernels",
    "volume.grids.error_message": "no such file",
}  # fmt: skip
_REASONS = {
    "error": "Permission denied", "error.strerror or error": "No space left on device", "error.name": "distributed",
    "str(error)": "Permission denied", "reason": "it was killed", "_operator_message(error)": "no such file",
    "status.message": "No space left on device", "str(failure)": "out of memory", "failure.what": "needs onnxruntime",
    "failure.why": "the package is missing", "kept.problem": "another scene has trained it",
    "self._kept.field": "a mixture of 12 frames",
}  # fmt: skip
_FIGURES = {
    "format_count(ray_count / max(report.render_seconds, 1e-06))": "1.25 M", "format_count(ray_count)": "120 M",
    "format_duration(report.denoise_seconds)": "0:04", "report.sample_count": "128", "megabytes": "812",
    "format_duration(time.monotonic() - self._started)": "1:36", "ENDINGS[report.ended_by].lower()": "all samples taken",
}  # fmt: skip

#: By the expression's source text.
EXAMPLES: dict[str, str] = {**_GIB, **_SIZES, **_NAMES, **_VALUES, **_PLACES, **_REASONS, **_FIGURES}

#: Where a module means something else by the same words, or by words that are too short to be known everywhere.
EXAMPLES_IN: dict[str, dict[str, str]] = {
    "addon/cli.py": {"name": "EEVEE", "path": "/scenes/room.blend", "text": "room.ngfield"},
    "addon/cli_arguments.py": {"argument": "--threads", "value": "-1", "error": "'-1' is no whole number from 0 to 1024"},
    "addon/declared_settings.py": {"name": "samples"},
    "addon/engine.py": {"', '.join(missing)": "Shadow, Render Time", "name": "ViewLayer"},
    "addon/export/images.py": {"bpy.path.abspath(image.filepath)": "/scenes/wood.png", "most / 2 ** 30": "16.0"},
    "addon/export/object_properties.py": {"name": "tint"},
    "addon/export/nodes.py": {"socket.name": "Base Color"},
    "addon/export/scene.py": {"name": "ACEScg"},
    "addon/export/volumes.py": {"', '.join(names) or 'it has none'": "density", "path": "/caches/smoke_0001.vdb"},
    "addon/sequence.py": {"description.frame_current": "60", "frame": "60", "first": "1", "last": "48"},
    "engine/accel.py": {"'; '.join(problems)": "libembree4.so: cannot open shared object file", "error": "4"},
    "engine/builder/lights.py": {"', '.join(_KINDS)": "POINT, SPOT, AREA, SUN"},
    "engine/cluster/job.py": {"sentence": "out of memory", "name": "tcp://10.0.0.6:41307"},
    "engine/denoise/filter.py": {"name": "albedo"},
    "engine/guiding/models/network_backend.py": {"PROVIDERS[instead]": "CPUExecutionProvider"},
    "engine/guiding/saved/file.py": {"MOST_BYTES >> 20": "512", "size >> 20": "2048", "name": "regions", "kind": "float64"},
    "engine/render/sequence.py": {"settings.source": "VMM", "mixtures": "NPM, NPM_PRODUCT, NASG"},
    "engine/render/session.py": {
        "MAX_MEDIA": "4", "counted.majorant_excess_count": "120", "counted.medium_reject_count": "120",
        "counted.tracking_end_count": "120",
    },
    "engine/shaders/options.py": {"name": "distribution", "value": "SHARP", "default": "GGX"},
}
