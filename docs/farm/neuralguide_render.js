// SPDX-License-Identifier: GPL-3.0-or-later
// A job type for Flamenco 3: frames of a .blend, rendered by NeuralGuide in Blender. See docs/farm.md.

const JOB_TYPE = {
    label: "NeuralGuide Frames",
    settings: [
        { key: "frames", type: "string", required: true,
          eval: "f'{C.scene.frame_start}-{C.scene.frame_end}'",
          evalInfo: { showLinkButton: true, description: "Frames of the scene" },
          description: "Frames to render: '47', '1-30', '3, 5-10, 47-327'" },
        { key: "chunk_size", type: "int32", default: 1, visible: "submission",
          description: "Frames that a worker renders at a time" },
        { key: "keep_existing", type: "bool", default: true, visible: "submission",
          description: "Leave frames alone whose files are there, as Blender does with Overwrite off" },
        { key: "learned_field", type: "string", subtype: "file_path", visible: "submission",
          description: "File for what is learned; the first frame makes it, all others start from it. Empty: " +
                       "each frame learns anew" },
        { key: "render_output_root", type: "string", subtype: "dir_path", required: true, visible: "submission",
          description: "Folder of renders; parts of the job's own are added" },
        { key: "add_path_components", type: "int32", required: true, default: 0, propargs: { min: 0, max: 32 },
          visible: "submission", description: "How many folders of the .blend's path are added" },
        { key: "render_output_path", type: "string", subtype: "file_path", editable: false,
          eval: "str(Path(abspath(settings.render_output_root), last_n_dir_parts(settings.add_path_components), " +
                "jobname, '######'))",
          description: "Where frames are saved" },
        { key: "blendfile", type: "string", required: true, visible: "web", description: "The .blend" },
        { key: "format", type: "string", required: true, eval: "C.scene.render.image_settings.file_format",
          visible: "web" },
    ],
};

const MOVIE_FORMATS = ["FFMPEG", "AVI_RAW", "AVI_JPEG"];

function compileJob(job) {
    const settings = job.settings;
    if (MOVIE_FORMATS.indexOf(settings.format) >= 0) {
        throw "This job type renders images; the scene's format is " + settings.format;
    }
    let chunks = frameChunker(settings.frames, settings.chunk_size);
    let first = null;
    if (settings.learned_field) {
        const frames = framesOf(settings.frames);
        first = renderTask(settings, "learn-" + frames[0], [frames[0]], true);
        job.addTask(first);
        const others = frames.slice(1);
        chunks = others.length ? frameChunker(others.join(","), settings.chunk_size) : [];
    }
    for (const chunk of chunks) {
        const task = renderTask(settings, "render-" + chunk, framesOf(chunk), false);
        if (first !== null) {
            task.addDependency(first);
        }
        job.addTask(task);
    }
}

// Numbers of frames: "3, 5-7" is 3, 5, 6, 7.
function framesOf(text) {
    const frames = [];
    for (const part of text.split(",")) {
        const ends = part.trim().split("-").map(Number);
        for (let frame = ends[0]; frame <= ends[ends.length - 1]; frame++) {
            frames.push(frame);
        }
    }
    return frames;
}

function renderTask(settings, name, frames, savesField) {
    const task = author.Task(name, "blender");
    task.addCommand(author.Command("blender-render", {
        exe: "{blender}",
        exeArgs: "{blenderArgs}",
        argsBefore: ["--background"],
        blendfile: settings.blendfile,
        args: [
            "--engine", "NEURALGUIDE",
            "--render-output", settings.render_output_path,
            "--render-format", settings.format,
            // Blender calls a frame that failed a success: what follows makes the task fail.
            "--python-exit-code", "1",
            "--python-expr", preparation(settings, frames, savesField),
            "--render-frame", frames.join(","),
            "--python-expr", check(frames),
        ],
    }));
    return task;
}

// Python that sets what Blender's command line has no options for.
function preparation(settings, frames, savesField) {
    const lines = [
        "import bpy, os",
        "scene = bpy.context.scene",
        "scene.render.use_overwrite = " + (settings.keep_existing ? "False" : "True"),
        // The manager gives each frame to one worker. A placeholder would outlive a worker that is killed.
        "scene.render.use_placeholder = False",
        "paths = [scene.render.frame_path(frame=frame) for frame in [" + frames.join(", ") + "]]",
        "for path in [path for path in paths if os.path.exists(path) and not os.path.getsize(path)]: os.remove(path)",
    ];
    if (settings.learned_field) {
        lines.push("scene.neuralguide.field_path = " + JSON.stringify(settings.learned_field));
        lines.push("scene.neuralguide.save_field = " + (savesField ? "True" : "False"));
    }
    return lines.join("\n");
}

// Python that raises where a frame has no file.
function check(frames) {
    return [
        "import bpy, os",
        "paths = [bpy.context.scene.render.frame_path(frame=frame) for frame in [" + frames.join(", ") + "]]",
        "missing = [path for path in paths if not os.path.exists(path) or not os.path.getsize(path)]",
        "if missing: raise FileNotFoundError('not rendered: ' + ', '.join(missing))",
    ].join("\n");
}
