//! `pskel generate` and `pskel simulate --generator` through the command line.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use image::RgbImage;
use serde_json::{Value, json};

use super::{assert_page_is_whole, built, planner};
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{CAMERAS, HEIGHT, TinyLog, WIDTH, assert_failed, picture, tree};
use pskel_testing::small_network::weights;

const GENERATE: &str = "generate nuscenes:log --skeleton sk --out out --rasterizer cpu --maps color \
    --generator process:./denoiser.sh";

/// Writes the example denoiser as a command without spaces, modified by some lines.
pub(crate) fn denoiser(log: &TinyLog, lines: &str) {
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    let script = format!(
        "#!/usr/bin/env python3\nimport array, os, sys, time\nsys.path.insert(0, {examples:?})\n\
         sys.dont_write_bytecode = True\nimport denoiser\n{lines}\n\
         out, sys.stdout = sys.stdout.buffer, sys.stderr\ndenoiser.serve(sys.stdin.buffer, out)\n"
    );
    let path = log.path("denoiser.sh");
    std::fs::write(&path, script).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
}

/// Returns lines that run a statement in the n-th call.
pub(crate) fn at_call(number: usize, happens: &str) -> String {
    format!(
        "inner, calls = denoiser.predict, []\ndef predict(tensors):\n    calls.append(0)\n    \
         if len(calls) == {number}:\n        {happens}\n    return inner(tensors)\ndenoiser.predict = predict"
    )
}

fn image(path: &Path) -> RgbImage {
    image::open(path).unwrap_or_else(|error| panic!("{error}: {}", path.display())).into_rgb8()
}

fn kinds(log: &TinyLog, steps: usize) -> Vec<Value> {
    (0..steps).map(|step| log.json(&format!("out/steps/{step:06}/generated.json"))["kind"].clone()).collect()
}

/// Returns the means of 8 x 8 pixel blocks.
fn block_means(image: &RgbImage) -> RgbImage {
    RgbImage::from_fn(image.width() / 8, image.height() / 8, |x, y| {
        let block = image::imageops::crop_imm(image, 8 * x, 8 * y, 8, 8).to_image();
        let mean = |color: usize| block.pixels().map(|p| f32::from(p.0[color])).sum::<f32>() / 64.0;
        image::Rgb([0, 1, 2].map(|color| mean(color).round() as u8))
    })
}

#[test]
fn images_are_generated_from_the_logs_conditions() {
    let log = built();
    denoiser(&log, "");
    let summary = log.succeed(&format!("{GENERATE} --window 2 --profile profile.json"));
    assert!(summary.contains("2 frames generated, median "), "{summary}");
    let summary = log.succeed(&format!("{GENERATE} --window 4"));
    assert!(summary.contains("no frames generated: all planning steps are references"), "{summary}");
    log.succeed(&format!("{GENERATE} --window 2 --profile profile.json"));
    assert_eq!(kinds(&log, 3), ["reference", "generated", "generated"]);
    assert_page_is_whole(&log, "out", 3);
    // The color maps of the same frames, rendered by another command.
    log.succeed(
        "render nuscenes:log --skeleton sk --out maps --maps color --size 256x448 --out-size 64x112 \
         --splat 15:1,100:0 --color-filter visible-area --at 1000000000,1000500000,1001000000 --rasterizer \
         cpu",
    );
    for step in 1..3 {
        for camera in CAMERAS {
            let made = image(&log.path(&format!("out/steps/{step:06}/generated/{camera}.png")));
            assert_eq!((made.width(), made.height()), (14, 8));
            let t_us = 1_000_000_000 + 500_000 * step;
            let expected = block_means(&image(&log.path(&format!("maps/{t_us}/{camera}/color.png"))));
            let off = made.iter().zip(expected.iter()).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(off <= Some(1), "step {step}, {camera}: off by {off:?}");
            assert!(expected.iter().any(|level| *level > 0), "there is something to see");
        }
    }
    // References and ground truth are the log's images, reduced.
    let own = image(&log.path(&picture(0, CAMERAS[0])));
    let reduced = image::imageops::resize(&own, 14, 8, image::imageops::FilterType::Triangle);
    for name in ["generated", "truth"] {
        assert_eq!(image(&log.path(&format!("out/steps/000000/{name}/CAM_FRONT.png"))), reduced);
    }
    let options = &log.json("out/rollout.json")["generator"];
    assert_eq!(
        (&options["window"], &options["steps"], &options["strategy"]),
        (&json!(2), &json!(2), &json!("reset_and_roll"))
    );
    let medians = &log.json("profile.json")["medians"];
    assert!(medians["generate_network_s"].as_f64() > Some(0.0), "{medians}");
}

#[test]
fn presets_set_recipe_window_steps_and_guidance() {
    let log = built();
    denoiser(&log, "");
    for (options, window, steps, scale) in
        [("", 10, 30, 2.0), ("--window 5 --infer-steps 5 --guidance 1.5 --guide all", 5, 5, 1.5)]
    {
        let summary = log.succeed(&format!("{GENERATE} --recipe pas-nuplan {options}"));
        assert!(summary.contains("no frames generated: all planning steps are references"), "{summary}");
        let generator = &log.json("out/rollout.json")["generator"];
        assert_eq!((&generator["window"], &generator["steps"]), (&json!(window), &json!(steps)));
        assert_eq!(generator["guidance"]["scale"], json!(scale));
        let recipe = &generator["recipe"];
        assert_eq!((&recipe["drawn"], &recipe["splat"]), (&json!("1080x1920"), &json!("25:1,50:0")));
        std::fs::remove_dir_all(log.path("out")).unwrap();
    }
    let output = log.run(&format!("{GENERATE} --recipe pas-other"));
    assert_failed(&output, 1, &["cannot read", "pas-other"]);
}

#[test]
fn generated_images_are_written_back_into_the_data_set() {
    let log = built();
    denoiser(&log, "");
    let output = log.run(&format!("{GENERATE} --window 2 --dataset copy"));
    let reported = String::from_utf8(output.stdout).unwrap();
    assert!(reported.lines().last().unwrap().starts_with("4 images replaced, 2 kept: copy"), "{reported}");
    let (before, after) = (tree(&log.path("log")), tree(&log.path("copy")));
    assert_eq!(before.keys().collect::<Vec<_>>(), after.keys().collect::<Vec<_>>());
    for (name, bytes) in &before {
        let is_made = ["samples/1-CAM", "samples/2-CAM"].iter().any(|start| name.starts_with(start));
        assert_eq!(after[name] == *bytes, !is_made, "{name}");
    }
    let new = image(&log.path("copy/samples/1-CAM_FRONT.png"));
    assert_eq!((new.width(), new.height()), (WIDTH, HEIGHT));
    let small = image(&log.path("out/steps/000001/generated/CAM_FRONT.png"));
    assert_eq!(new, image::imageops::resize(&small, WIDTH, HEIGHT, image::imageops::FilterType::CatmullRom));
    // The copy is a valid data set.
    assert!(log.run("info nuscenes:copy").status.success());
    // A data set written by `pskel` is replaced, unless it contains other files.
    assert!(log.run(&format!("{GENERATE} --window 2 --dataset copy")).status.success());
    assert!(tree(&log.path("copy")) == after);
    std::fs::write(log.path("copy/mine.txt"), "mine").unwrap();
    let parts = ["expected only files that pskel wrote", "another file: copy/mine.txt"];
    assert_failed(&log.run(&format!("{GENERATE} --window 2 --dataset copy")), 1, &parts);
    let other = GENERATE.replace("nuscenes:log", "town:seed=1,frames=2");
    assert_failed(&log.run(&format!("{other} --dataset new")), 2, &["nuscenes:", "--dataset", "town:"]);
}

#[test]
fn a_closed_loop_resumes_to_the_same_bytes() {
    let log = built();
    weights().write(&log.path("w.safetensors")).unwrap();
    let args = |out: &str| {
        format!(
            "simulate nuscenes:log --skeleton sk --out {out} --rasterizer cpu --maps color,instance --sim-hz \
                10 \
             --plan-hz 5 --ego lane_change --generator network:w.safetensors --window 3 --infer-steps 3"
        )
    };
    log.succeed(&format!("{} --steps 11", args("whole")));
    let whole = tree(&log.path("whole"));
    assert_page_is_whole(&log, "whole", 12);
    // Planning steps have images, the other steps show the latest one; off the log there is no ground truth.
    for step in 0..12 {
        let has = |name: &str| whole.contains_key(&format!("steps/{step:06}/{name}"));
        let is_plan = step % 2 == 0;
        assert_eq!(
            [
                has("generated/CAM_BACK.png"),
                has("generated.json"),
                has("generator.safetensors"),
                has("view/generated.jpg")
            ],
            [is_plan, is_plan, is_plan && step >= 4, true],
            "step {step}"
        );
        assert!(!has("truth/CAM_BACK.png") && !has("view/truth.jpg"));
    }
    // Interrupted among the references, at a planning step, and between two.
    for until in [1, 4, 7] {
        let out = format!("out{until}");
        log.succeed(&format!("{} --steps {until}", args(&out)));
        log.succeed(&format!("{} --steps 11 --resume", args(&out)));
        let found = tree(&log.path(&out));
        for (name, bytes) in &whole {
            let same_steps = !["rollout.json", "index.json", "index.html"].contains(&name.as_str());
            assert!(!same_steps || found.get(name) == Some(bytes), "{name} of {out}");
        }
        assert_eq!(found.len(), whole.len());
    }
    // The number of threads does not change the result.
    let alone = log.run_with(&format!("{} --steps 11", args("alone")), "1");
    assert!(alone.status.success());
    assert!(tree(&log.path("alone")) == whole);
    // Another seed gives other images.
    log.succeed(&format!("{} --steps 4 --noise-seed 1", args("other")));
    let front = "steps/000004/generated/CAM_FRONT.png";
    assert_ne!(tree(&log.path("other"))[front], whole[front]);
    let message = ["expected the options of the rollout", "generator", "rollout.json"];
    assert_failed(&log.run(&format!("{} --steps 11 --resume --guidance 2", args("whole"))), 1, &message);
}

#[test]
fn a_failing_denoiser_leaves_a_resumable_rollout() {
    let log = built();
    denoiser(&log, "");
    log.succeed(&format!("{GENERATE} --window 2"));
    let whole = tree(&log.path("out"));
    for (happens, parts) in [
        ("os.kill(os.getpid(), 9)", ["found its end", "stopped after 2 steps"]),
        ("time.sleep(600)", ["within 4 s", "stopped after 2 steps"]),
        ("return array.array('f', [float('nan')] * 1344)", ["finite values", "stopped after 2 steps"]),
        ("return array.array('f', [0.0] * 5)", ["safetensors", "stopped after 2 steps"]),
    ] {
        // Each frame takes two calls.
        denoiser(&log, &at_call(3, happens));
        let hasty = format!("{GENERATE} --window 2 --generator-timeout 4");
        assert_failed(&log.run(&hasty), 1, &parts);
        let metrics = log.json("out/metrics.json");
        assert!(metrics["failure"].as_str().unwrap().contains("step 000002"), "{metrics}");
        denoiser(&log, "");
        log.succeed(&format!("{GENERATE} --window 2 --resume"));
        assert!(tree(&log.path("out")) == whole, "{happens}");
    }
}

/// Denoiser with its own encoder: its latents are one channel of 2 x 2: the mean gray in each quarter of a 16
/// x 24 image.
const WITH_CODEC: &str = "\
def serve(source, out):
    told = denoiser.read(source)[0]
    hello = {'protocol': 'pskel-denoiser', 'version': '1', 'dtype': 'F32', 'image_size': '16,24'}
    denoiser.write(out, hello | {'latent_shape': '%s,1,2,2' % told['views']})
    while message := denoiser.read(source):
        texts, tensors = message
        ask, values = texts['ask'], array.array('f')
        if ask == 'encode':
            name, ((views, _, rows, columns), given) = 'latents', tensors['images']
            shape = [views, 1, 2, 2]
            for view in range(views):
                for quarter in range(4):
                    top, left = 8 * (quarter // 2), 12 * (quarter % 2)
                    at = lambda c, y, x: given[((view * 3 + c) * rows + top + y) * columns + left + x]
                    values.append(sum(at(c, y, x) for c in range(3) for y in range(8) for x in range(12)) / \
                    288)
        elif ask == 'decode':
            name, ((views, *_), given) = 'images', tensors['latents']
            shape = [views, 3, 16, 24]
            for view in range(views):
                for _ in range(3):
                    values.extend(given[4 * view + 2 * (y // 8) + x // 12] for y in range(16) for x in \
                    range(24))
        else:  # Holds the grey of the first frame of the window, which is a reference.
            name, (shape, given) = 'prediction', tensors['latents']
            frame = len(given) // shape[0]
            for place, value in enumerate(given):
                values.append((value - given[place % frame]) / tensors['sigmas'][1][place // frame])
        denoiser.write(out, {}, {name: ('F32', shape, values.tobytes())})
denoiser.serve = serve";

#[test]
fn a_process_may_have_its_own_codec() {
    let log = built();
    denoiser(&log, WITH_CODEC);
    log.succeed(&format!("{GENERATE} --strategy causal --window 2 --infer-steps 3"));
    let own = image(&log.path(&picture(0, CAMERAS[1])));
    let reference = image::imageops::resize(&own, 24, 16, image::imageops::FilterType::Triangle);
    assert_eq!(image(&log.path("out/steps/000000/generated/CAM_BACK.png")), reference);
    for step in 1..3 {
        let made = image(&log.path(&format!("out/steps/{step:06}/generated/CAM_BACK.png")));
        for (quarter, [x, y]) in [[0, 0], [12, 0], [0, 8], [12, 8]].into_iter().enumerate() {
            let part = image::imageops::crop_imm(&reference, x, y, 12, 8).to_image();
            let grey = part.iter().map(|level| f32::from(*level)).sum::<f32>() / 288.0;
            let found = image::imageops::crop_imm(&made, x, y, 12, 8).to_image();
            assert!(
                found.iter().all(|level| (f32::from(*level) - grey).abs() < 1.0),
                "{step} {quarter}: {grey}"
            );
        }
    }
    denoiser(&log, &WITH_CODEC.replace("shape = [views, 3, 16, 24]", "shape = [views, 3, 24, 16]"));
    assert_failed(
        &log.run(&format!("{GENERATE} --window 2")),
        1,
        &["`images` of [2, 3, 16, 24]", "[2, 3, 24, 16]"],
    );
    denoiser(&log, &WITH_CODEC.replace("'16,24'", "'16x24'"));
    assert_failed(&log.run(&format!("{GENERATE} --window 2")), 1, &["`image_size`", "16x24"]);
    denoiser(&log, &WITH_CODEC.replace("'16,24'", "'32768,32768'"));
    assert_failed(&log.run(&format!("{GENERATE} --window 2")), 1, &["images of at most", "32768,32768"]);
}

#[test]
fn planners_see_generated_images_instead_of_ground_truth() {
    let log = built();
    denoiser(&log, "");
    planner(&log, "while read -r observation; do echo \"$observation\" >> seen.txt; answer; done");
    let town = "town:seed=5,frames=5,size=57x100";
    log.succeed(&format!("build {town} --out town"));
    let simulate = format!(
        "simulate {town} --skeleton town --maps color --size 57x100 --sim-hz 10 --plan-hz 5 --steps 8 --ego \
            external \
         --planner ./planner.sh --generator process:./denoiser.sh --window 2 --infer-steps 2"
    );
    log.succeed(&format!("{simulate} --out out"));
    assert!(log.path("out/steps/000004/truth/CAM_FRONT.png").is_file());
    let seen = std::fs::read_to_string(log.path("seen.txt")).unwrap();
    assert!(seen.lines().count() > 2);
    for line in seen.lines() {
        assert!(line.contains("generated/CAM_FRONT.png") && line.contains("CAM_BACK/color.png"), "{line}");
        assert!(!line.contains("truth") && !line.contains("generator.safetensors"), "{line}");
    }
    // With a warm-up of L - 1 frames, the planner takes over at the last reference, one plan earlier.
    log.succeed(&format!("{simulate} --out early --warmup 1"));
    let all = std::fs::read_to_string(log.path("seen.txt")).unwrap();
    assert_eq!(all.lines().count(), 2 * seen.lines().count() + 1);
    for (step, kind) in [("000000", "reference"), ("000002", "generated")] {
        assert_eq!(log.json(&format!("early/steps/{step}/generated.json"))["kind"], kind);
    }
}

#[test]
fn invalid_generators_are_rejected_before_writing() {
    let log = built();
    denoiser(&log, "");
    weights().write(&log.path("w.safetensors")).unwrap();
    let network = GENERATE.replace("process:./denoiser.sh", "network:w.safetensors");
    for (args, code, parts) in [
        (GENERATE.replace("process:", "procession:"), 2, ["network:FILE", "process:"]),
        (format!("{GENERATE} --window 1"), 2, ["window", "found"]),
        (format!("{GENERATE} --window 3 --infer-steps 4"), 2, ["multiple of 3", "found 4"]),
        (format!("{GENERATE} --guidance=-1"), 2, ["--guidance", "factor"]),
        (format!("{network} --window 5"), 2, ["expected a window of at most 4", "found 5"]),
        (format!("{network} --sampler ddim_sample"), 2, ["process:.. with --sampler", "found"]),
        (
            format!("{network} --generator-timeout 5"),
            2,
            ["process:.. or images:.. with --generator-timeout", "found"],
        ),
        (format!("{network} --strategy causal,clean=1"), 2, ["history_noise=N with causal", "clean=1"]),
        (format!("{network} --guide all"), 2, ["--guidance other than 1 with --guide", "found"]),
        (network.replace("w.safetensors", "missing"), 1, ["cannot read", "missing"]),
        (GENERATE.replace("./denoiser.sh", "true"), 1, ["denoiser", "true"]),
    ] {
        log.fail(&args, code, &parts);
    }
    let simulate = "simulate nuscenes:log --skeleton sk --out out --rasterizer cpu --steps 4 --warmup 2";
    log.fail(
        &format!("{simulate} --noise-seed 3"),
        2,
        &["expected --generator with --noise-seed", "found none"],
    );
    let few = format!("{simulate} --generator network:w.safetensors --window 4");
    log.fail(&few, 2, &["--warmup of 3 or more", "found 2"]);
    std::fs::write(log.path("w.safetensors"), "no weights").unwrap();
    log.fail(&network, 1, &["weights", "w.safetensors"]);
}

#[test]
fn captions_are_assigned_to_frames() {
    let log = built();
    // The prompts of each call as a line.
    let keeps = "import json\nread = denoiser.predict\ndef predict(tensors):\n    return read(tensors)\n\
                 texts = json.loads\ndef loads(text, *more, **options):\n    value = texts(text, *more, \
                 **options)\n    \
                 if isinstance(value, dict) and 'prompts' in value.get('__metadata__', {}):\n        \
                 open('prompts.txt', 'a').write(value['__metadata__']['prompts'] + '\\n')\n    return value\n\
                 json.loads = loads";
    denoiser(&log, keeps);
    // The images of the second frame have a caption, and the log has one.
    let token = "d1CAM_BACK";
    let captions = json!({token: "rain", "tiny": "sun", "other": "fog"}).to_string();
    std::fs::write(log.path("c.json"), captions).unwrap();
    log.succeed(&format!("{GENERATE} --window 2 --captions c.json"));
    let text = std::fs::read_to_string(log.path("prompts.txt")).unwrap();
    let mut prompts: Vec<&str> = text.lines().collect();
    prompts.dedup();
    // Windows of the second and of the third frame; the first roll ahead shows the forecast.
    assert_eq!(prompts, [r#"["sun","rain"]"#, r#"["rain","sun"]"#]);
    let record = log.json("out/rollout.json")["generator"]["captions"].to_string();
    assert!(record.contains("sun") && record.contains("rain") && !record.contains("fog"), "{record}");
    std::fs::write(log.path("c.json"), json!({"other": "fog"}).to_string()).unwrap();
    let output = log.run(&format!("{GENERATE} --window 2 --captions c.json"));
    assert_failed(&output, 1, &["expected captions of log tiny or of its images", "c.json"]);
    let output = log.run("simulate nuscenes:log --skeleton sk --out s --steps 1 --captions c.json");
    assert_failed(&output, 2, &["expected --generator with --captions"]);
}
