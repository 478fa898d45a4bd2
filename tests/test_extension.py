# SPDX-License-Identifier: GPL-3.0-or-later
"""The packaged extension: what is in the zip, and that a user can install it, render with it and remove it."""

from __future__ import annotations

import ast
import importlib.metadata
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tools.build_extension import ROOT, absolute_imports, build, relative_imports

#: Runs as a user's Blender would: no repository, no site-packages but Blender's own and numpy, which Blender brings.
USER_SESSION = """
import json, os, sys
zip_path, image_path = sys.argv[1:]
assert not any(os.path.exists(os.path.join(path, "numba")) for path in sys.path), sys.path
import bpy
bpy.ops.extensions.package_install_files(filepath=zip_path, repo="user_default", enable_on_install=True)
facts = {"addons": sorted(bpy.context.preferences.addons.keys())}

bpy.ops.wm.read_homefile(use_empty=True)
scene = bpy.context.scene
bpy.ops.mesh.primitive_cube_add()
camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
camera.location, camera.rotation_euler = (0.0, -6.0, 0.0), (1.5707963, 0.0, 0.0)
scene.collection.objects.link(camera)
scene.camera = camera
scene.world = bpy.data.worlds.new("World")
scene.render.engine = "NEURALGUIDE"
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 24, 24, 100
scene.render.filepath = image_path
scene.render.image_settings.file_format = "OPEN_EXR"
scene.neuralguide.samples = 4
bpy.ops.render.render(write_still=True)

import numpy as np
image = bpy.data.images.load(image_path)
pixels = np.empty(len(image.pixels), np.float32)
image.pixels.foreach_get(pixels)
facts["finite"] = bool(np.isfinite(pixels).all())
pixels = pixels.reshape(24, 24, 4)
facts["centre"] = float(pixels[12, 12, 0])
facts["corner"] = float(pixels[1, 1, 0])
facts["kernel_cache"] = os.environ["NEURALGUIDE_KERNEL_CACHE"]
facts["kernels"] = sum(name.endswith(".nbc") for _, _, files in os.walk(facts["kernel_cache"]) for name in files)
facts["stamps"] = len([name for name in os.listdir(facts["kernel_cache"]) if name.endswith(".complete")])
facts["numba"] = sys.modules["numba"].__file__
import addon_utils
facts["policy"] = {key: value for key, value in addon_utils._extensions_warnings_get().items() if value}

repo_index = [repo.module for repo in bpy.context.preferences.extensions.repos].index("user_default")
folder = os.path.join(bpy.utils.user_resource("EXTENSIONS"), "user_default", "neuralguide")
facts["installed"] = os.path.isdir(folder)
bpy.ops.extensions.package_uninstall(repo_index=repo_index, pkg_id="neuralguide")
facts["removed"] = not os.path.exists(folder)
facts["left"] = [hasattr(bpy.types.Scene, "neuralguide"), hasattr(bpy.types, "NEURALGUIDE_PT_sampling")]
print("FACTS" + json.dumps(facts))
"""


@pytest.fixture(scope="module")
def extension_zip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh zip for Linux; validated by Blender's own checker while it is built."""
    path = build("linux-x64", tmp_path_factory.mktemp("dist"))
    assert path is not None, "the package index has no wheels of the pinned versions"
    return path


def test_imports_become_relative() -> None:
    source = (
        "from engine.scene.description import (\n    Mesh,\n)\nimport engine.jit as jit\nfrom engineering import x\n"
    )
    assert relative_imports(source, ("addon", "export")) == (
        "from ...engine.scene.description import (\n    Mesh,\n)\nfrom ...engine import jit as jit\n"
        "from engineering import x\n"
    )
    with pytest.raises(ValueError, match=r"line 1: write `import engine.jit`"):
        relative_imports("import engine.jit\n", ())
    assert absolute_imports("from engine.jit import kernel\nfrom .engine import x\n") == ["engine.jit"]


def test_the_zip_holds_what_it_should(extension_zip: Path) -> None:
    with zipfile.ZipFile(extension_zip) as archive:
        names = archive.namelist()
        sources = {name: archive.read(name).decode() for name in names if name.endswith(".py")}
    assert {"__init__.py", "blender_manifest.toml", "LICENSE", "addon/engine.py", "engine/session.py"} <= set(names)
    assert not [name for name in names if "__pycache__" in name or name.startswith(("tests", "benchmarks", "docs"))]
    wheels = [Path(name).name.partition("-")[0] for name in names if name.endswith(".whl")]
    assert sorted(wheels) == ["embreex", "llvmlite", "numba"]
    for name, text in sources.items():
        assert absolute_imports(text) == [], name
        ast.parse(text)


@pytest.mark.slow
def test_a_user_can_install_render_and_remove(extension_zip: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    site.mkdir()
    for name, distribution in (("bpy", "bpy"), ("numpy", "numpy"), ("numpy.libs", "numpy")):
        (site / name).symlink_to(str(importlib.metadata.distribution(distribution).locate_file(name)))
    script = tmp_path / "user_session.py"
    script.write_text(f"import sys; sys.path[0] = {str(site)!r}\n" + USER_SESSION)
    profile = tmp_path / "profile"
    profile.mkdir()
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("NEURALGUIDE_", "PYTHON"))}
    environment |= {"BLENDER_USER_RESOURCES": str(profile), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "-S", str(script), str(extension_zip), str(tmp_path / "image.exr")],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=900,
    )
    output = done.stdout + done.stderr
    assert "FACTS" in output, output[-5000:]
    facts = json.loads(output.partition("FACTS")[2].partition("\n")[0])
    assert "bl_ext.user_default.neuralguide" in facts["addons"]
    assert facts["installed"] and facts["removed"]
    assert facts["left"] == [False, False]
    assert facts["finite"]
    assert facts["centre"] > 0.01, "the cube is black"
    assert facts["corner"] > 0.01, "the world is black"
    assert facts["numba"].startswith(str(profile)), "numba did not come from the extension's wheel"
    assert facts["kernel_cache"].startswith(str(profile)) and facts["kernels"] > 0
    assert facts["stamps"] == 2, "no helper process compiled kernels"
    assert facts["policy"] == {}, "Blender lists violations of its rules for extensions"
    assert "Traceback" not in output
    assert ROOT.as_posix() not in facts["numba"]
