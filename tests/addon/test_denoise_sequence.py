# SPDX-License-Identifier: GPL-3.0-or-later
"""A sequence of files of layers is denoised over time, and what cannot be denoised is said in plain words."""

import os
import shutil

import numpy as np
import OpenEXR
import pytest

from benchmarks.images import read_exr
from engine.denoise import library

bpy = pytest.importorskip("bpy")
pytestmark = pytest.mark.skipif(bool(library.problem()), reason="no Open Image Denoise here")

SIZE = (20, 30)
PASSES = {
    "Combined": "RGBA", "Noisy Image": "RGBA", "Vector": "XYZW", "Denoising Albedo": "RGB", "Denoising Normal": "XYZ",
}  # fmt: skip


def write_frame(path, seed, size=SIZE, passes=PASSES):
    """A grey wall that stands still, in two halves, with noise as denoisers leave it; an object's index beside it."""
    rng = np.random.default_rng(seed)
    values = {"Vector": 0.0, "Denoising Normal": 1.0}
    channels = {"ViewLayer.Index.X": np.full(size, seed, np.float32)}
    for name, letters in passes.items():
        spread = {"Combined": 0.05, "Noisy Image": 0.2}.get(name, 0.0)
        noise = spread * rng.standard_normal((len(letters), *size))
        for letter, one in zip(letters, noise, strict=True):
            channels[f"ViewLayer.{name}.{letter}"] = np.float32(values.get(name, 0.5) + one)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "Scene": "Wall"}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


@pytest.fixture
def frames(tmp_path):
    """Files of five frames."""
    for number in range(8, 13):
        write_frame(tmp_path / f"shot2_{number:04}.exr", number)
    return sorted(tmp_path.glob("*.exr"))


def denoise(path, **arguments):
    import addon

    addon.register()
    return bpy.ops.neuralguide.denoise_sequence(filepath=str(path), **arguments)


def test_frames_beside_the_chosen_one_are_denoised_and_all_else_in_their_files_stays(frames):
    assert denoise(frames[2]) == {"FINISHED"}
    made = sorted((frames[0].parent / "denoised").iterdir())
    assert [path.name for path in made] == [path.name for path in frames]
    for old, new in zip(frames, made, strict=True):
        before, after = (read_exr(path)[0] for path in (old, new))
        assert after[..., :3].std() < 0.6 * before[..., :3].std()
        assert np.array_equal(after[..., 3], before[..., 3])
        for name in ("Noisy Image", "Vector", "Index"):
            assert np.array_equal(read_exr(new, name)[0], read_exr(old, name)[0])
        assert read_exr(new)[1]["Scene"] == "Wall"


def test_the_command_line_does_the_same(frames, capsys):
    from addon.__main__ import main

    assert main(["--denoise-sequence", str(frames[0])]) == 0
    assert len(list((frames[0].parent / "denoised").iterdir())) == len(frames)
    frames[3].unlink()
    assert main(["--denoise-sequence", str(frames[0])]) == 2
    assert "frames are missing between 8 and 12: 11" in capsys.readouterr().err


def lose_a_pass(frames):
    write_frame(frames[0], 0, passes={name: letters for name, letters in PASSES.items() if name != "Vector"})


def lose_a_pass_later(frames):
    write_frame(frames[2], 0, passes={name: letters for name, letters in PASSES.items() if name != "Denoising Normal"})


def keep_one(frames):
    for path in frames[1:]:
        path.unlink()


def fill_the_folder(frames):
    (frames[0].parent / "denoised").write_text("no folder")


def truncate(frames):
    os.truncate(frames[1], 500)


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lose_a_pass, "lacks passes: switch on Vector in the view layer's properties"),
        (lose_a_pass_later, "shot2_0010.exr has no pass Denoising Normal in ViewLayer, which the first frame has"),
        (lambda frames: write_frame(frames[1], 0, (10, 30)), "has 30 x 10 pixels, and the first frame 30 x 20"),
        (lambda frames: frames[2].unlink(), "frames are missing between 8 and 12: 10. Render them first"),
        (keep_one, "is the only frame"),
        (lambda frames: frames[0].unlink(), "there is no file"),
        (truncate, "shot2_0009.exr"),
        (fill_the_folder, "shot2_0008.exr cannot be written"),
    ],
)
def test_what_cannot_be_denoised_is_said(frames, spoil, sentence):
    spoil(frames)
    with pytest.raises(RuntimeError, match="Error") as caught:
        denoise(frames[0])
    assert sentence in str(caught.value)
    assert "Traceback" not in str(caught.value)


def test_a_file_without_a_number_and_the_folder_of_the_frames_are_refused(frames, tmp_path):
    alone = shutil.copy(frames[0], tmp_path / "still.exr")
    with pytest.raises(RuntimeError, match=r"still\.exr has no frame number"):
        denoise(alone)
    with pytest.raises(RuntimeError, match="choose another folder"):
        denoise(frames[0], folder=str(tmp_path))


def test_a_full_disk_leaves_no_file_that_is_not_whole(frames):
    """Files that may not grow beyond a thousand bytes fail as on a disk that is full."""
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(RuntimeError, match="cannot be written"):
            denoise(frames[0])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list((frames[0].parent / "denoised").iterdir()) == []


def test_vectors_of_renders_lead_to_what_other_frames_show_of_the_same(tmp_path):
    """A camera flies over a plane: the world's position where vectors lead is that of the pixel."""
    import addon
    from addon.exr_layers import read_layers
    from benchmarks.scenes.studio import add_object, diffuse, quad
    from engine.denoise.motion import follow
    from tests.helpers.blender_scenes import empty_scene

    addon.register()
    scene = empty_scene()
    add_object("ground", quad("ground", diffuse((0.5, 0.5, 0.5), "grey"), 40.0, 40.0))
    for frame, place, turn in ((1, (0.0, -2.0, 3.0), 0.6), (3, (0.4, -1.6, 2.6), 0.7)):
        scene.camera.location, scene.camera.rotation_euler = place, (turn, 0.0, 0.1)
        for name in ("location", "rotation_euler"):
            scene.camera.keyframe_insert(name, frame=frame)
    scene.frame_start, scene.frame_end = 1, 3
    scene.render.engine = "NEURALGUIDE"
    scene.render.resolution_x, scene.render.resolution_y = 48, 32
    scene.neuralguide.samples, scene.neuralguide.guiding_method = 1, "OFF"
    layer = scene.view_layers[0]
    layer.use_pass_vector = layer.use_pass_position = True
    settings = scene.render.image_settings
    settings.media_type, settings.file_format, settings.color_depth = (
        "MULTI_LAYER_IMAGE", "OPEN_EXR_MULTILAYER", "32",
    )  # fmt: skip
    scene.render.filepath = str(tmp_path / "f_####")
    bpy.ops.render.render(animation=True)
    images = [read_layers(tmp_path / f"f_000{frame}.exr") for frame in (1, 2, 3)]
    vectors, places = (
        [image.image("ViewLayer", name, letters) for image in images]
        for name, letters in (("Vector", "XYZW"), ("Position", "XYZ"))
    )
    for direction, last in ((-1, 0), (1, 2)):
        (sighting,) = follow(vectors.__getitem__, 1, last, direction)
        assert 0.6 < sighting.is_seen.mean() < 1.0
        still = np.linalg.norm(places[last] - places[1], axis=2)[sighting.is_seen]
        apart = np.linalg.norm(places[last][sighting.places] - places[1], axis=2)[sighting.is_seen]
        # Within a pixel's size, where without vectors it is several.
        assert apart.mean() < 0.06 < 0.15 < still.mean()
