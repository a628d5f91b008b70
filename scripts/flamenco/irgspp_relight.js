// SPDX-License-Identifier: GPL-3.0-or-later
// A job type of Flamenco: the frames of a turntable or of a dataset's views, relit, in chunks over the workers of a farm.
// Put it into the folder `scripts` next to flamenco-manager; docs/farm.md lists what the workers need.

const JOB_TYPE = {
    label: "IRGS++ Relight",
    description: "Images of a finished IRGS++ run under any light, several frames per task",
    settings: [
        { key: "run", type: "string", subtype: "dir_path", required: true, visible: "submission",
          description: "Run folder, on storage that all workers can access" },
        { key: "output", type: "string", subtype: "dir_path", required: true, visible: "submission",
          description: "Folder for the images: a folder for each frame" },
        { key: "orbit", type: "int32", default: 120, propargs: { min: 0, max: 100000 }, visible: "submission",
          description: "Frames of a full turn around the object; 0: the cameras of a dataset" },
        { key: "views", type: "string", default: "", visible: "submission",
          description: "Dataset whose cameras are used, DATASET or DATASET:test; with a turn only their lens is used" },
        { key: "frames", type: "string", required: true, default: "0-119", visible: "submission",
          description: "Counted from 0. Examples: '47', '0-29', '3, 5-10, 47-119'" },
        { key: "chunk_size", type: "int32", default: 10, propargs: { min: 1, max: 1000 }, visible: "submission",
          description: "Frames per task: reading the run takes seconds, so not too few" },
        { key: "environment", type: "string", subtype: "file_path", default: "", visible: "submission",
          description: "Lat-long .exr or .hdr to light the object by; empty: the recovered light" },
        { key: "rotation", type: "float", default: 0.0, visible: "submission",
          description: "Degrees that the light is turned about the vertical" },
        { key: "strength", type: "float", default: 1.0, propargs: { min: 0 }, visible: "submission",
          description: "Factor of the brightness of the light" },
        { key: "samples", type: "string", default: "efficient", visible: "submission",
          description: "Light samples of a pixel: hq, efficient or a number" },
        { key: "layers", type: "string", default: "rgba", visible: "submission",
          description: "Of rgba, albedo, normal, depth, material, radiance" },
        { key: "command", type: "string", default: "blender", choices: ["blender", "irgspp"], visible: "submission",
          description: "blender: Blender with the extension; irgspp: the engine alone, at the path in the variable {irgspp}" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    const words = renderWords(settings);
    for (const chunk of frameChunker(settings.frames, settings.chunk_size)) {
        const task = author.Task(`relight-${chunk}`, "blender");
        task.addCommand(author.Command("exec", withFrames(settings.command, words, chunk)));
        job.addTask(task);
    }
}

// The words after `irgspp` that all tasks have in common.
function renderWords(settings) {
    if (!settings.orbit && !settings.views) {
        throw "IRGS++ Relight: give the frames of a turn (orbit) or a dataset whose cameras are used (views)";
    }
    let words = ["render", settings.run, "-o", settings.output, "--layers", settings.layers, "--samples", settings.samples];
    if (settings.views) {
        words = words.concat(["--views", settings.views]);
    }
    if (settings.orbit) {
        words = words.concat(["--orbit", `${settings.orbit}`]);
    }
    if (settings.environment) {
        words = words.concat(["--environment", settings.environment]);
        words = words.concat([`--rotation=${settings.rotation}`, `--strength=${settings.strength}`]);
    }
    return words;
}

function withFrames(command, words, chunk) {
    const all = words.concat(["--frames", chunk]);
    if (command == "irgspp") {
        return { exe: "{irgspp}", args: all };
    }
    return { exe: "{blender}", args: ["--background", "--command", "irgspp"].concat(all) };
}
