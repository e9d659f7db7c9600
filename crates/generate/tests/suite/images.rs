//! Image generators in Python, in the closed loop.

use std::path::{Path, PathBuf};

use image::RgbImage;
use point_skeleton::conditions::{ConditionOptions, MapKind, MapSet};
use point_skeleton::dataset::{LogReader, Recording};
use point_skeleton::geometry::ImageSize;
use point_skeleton::raster::{RasterizerDesc, RasterizerKind};
use point_skeleton::scene::{GroundTruthImages, SceneState};
use point_skeleton::skeleton::{BuildOptions, Skeleton};
use point_skeleton::{RenderOptions, Renderer};
use pskel_generate::{
    DenoiserRig, GenerationScene, ImageProcess, ImageProcessError, ImageRig, ImageSession, Recipe,
};
use pskel_sim::peer::{PeerAddress, PeerError, PeerSpec};
use pskel_sim::report::images::StepImages;
use pskel_sim::rollout::ImageGenerator;
use pskel_sim::{Committed, EgoPolicy, Rates, Scenario, SimOptions, Simulation, scene_state};
use pskel_testing::shared::skeleton_of;
use pskel_testing::six_cameras::{self, FRAMES};

const SIZE: ImageSize = ImageSize { height: 24, width: 40 };
/// Long enough for Python to start on a busy machine, seconds.
const PATIENT_S: f64 = 60.0;

/// Generator that runs some lines of Python: `see()` returns texts and tensors of the next message,
/// `say(texts, name=(dtype, shape, bytes))` answers.
fn script(folder: &Path, lines: &str) -> PeerAddress {
    let path = folder.join("images.py");
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    let head = format!(
        "import json, sys, time\nsys.dont_write_bytecode = True\nsys.path.insert(0, {examples:?})\n\
         from denoiser import struct, write\nsource, out = sys.stdin.buffer, sys.stdout.buffer\n\
         def see():\n    if not (length := source.read(8)):\n        return None\n    \
         message = source.read(*struct.unpack('<Q', length))\n    \
         start = 8 + struct.unpack_from('<Q', message)[0]\n    header = json.loads(message[8:start])\n    \
         part = lambda t: message[start + t['data_offsets'][0] : start + t['data_offsets'][1]]\n    \
         texts = header.pop('__metadata__')\n    \
         return texts, {{name: (t['dtype'], t['shape'], part(t)) for name, t in header.items()}}\n\
         def say(texts={{}}, **tensors):\n    write(out, texts, tensors)\n\
         HELLO = {{'protocol': 'pskel-images', 'version': '1', 'image_size': '24,40'}}\n\
         SHAPE = [6, 24, 40, 3]\n"
    );
    std::fs::write(&path, format!("{head}{lines}\n")).unwrap();
    PeerAddress::Command(format!("exec python3 {}", path.display()))
}

/// The log with six cameras, and its skeleton.
struct Scene {
    folder: tempfile::TempDir,
    log: point_skeleton::dataset::nuscenes::NuScenes,
    skeleton: Skeleton,
}

impl Scene {
    fn new() -> Self {
        let (folder, log) = six_cameras::read();
        let frames: Vec<usize> = (0..FRAMES).collect();
        let skeleton = skeleton_of(&folder.path().join("sk"), &log, &frames, &BuildOptions::default());
        Self { folder, log, skeleton }
    }

    fn path(&self) -> PathBuf {
        self.folder.path().to_owned()
    }

    fn renderer(&self) -> Renderer<'_> {
        let rasterizer = RasterizerDesc::from(RasterizerKind::Cpu);
        let log = Some(self.log.recording().name.as_str());
        Renderer::new(&self.skeleton, RenderOptions { rasterizer, log, ..RenderOptions::default() }).unwrap()
    }

    fn start(&self, address: PeerAddress, timeout_s: f64) -> Result<ImageProcess, ImageProcessError> {
        let (rig, log) = (DenoiserRig::of(self.log.recording(), 5.0), "town-3".to_owned());
        let rig = ImageRig { log, rig, has_map: false, seed: 7 };
        ImageProcess::start(&PeerSpec { address, timeout_s }, recipe(), &rig)
    }

    fn session(&self, process: ImageProcess) -> ImageSession<'_> {
        ImageSession::new(process, self.generation())
    }

    fn generation(&self) -> GenerationScene<'_> {
        GenerationScene {
            has_map: false,
            prompt: "a street".to_owned(),
            captions: None,
            truth: Some(GroundTruthImages::new(&self.log)),
            ego_follows_log: false,
            actors_follow_log: true,
        }
    }

    fn simulation(&self) -> Simulation<'_> {
        let scenario =
            Scenario { log: self.log.recording(), map: None, rates: Rates { sim_hz: 5.0, plan_hz: 5.0 } };
        let options =
            SimOptions { steps: 12, warmup_frames: 3, ego: EgoPolicy::Straight, ..SimOptions::default() };
        Simulation::new(&scenario, options).unwrap()
    }
}

fn shown(simulation: &Simulation<'_>, log: &Recording) -> Committed<SceneState> {
    simulation.committed().map(|instant| scene_state(log, instant, None))
}

fn recipe() -> Recipe {
    Recipe { drawn: SIZE, size: SIZE, ..Recipe::default() }
}

/// Drives on to the end; returns the images of each step, and what was saved with it.
fn drive(
    log: &Recording,
    simulation: &mut Simulation<'_>,
    session: &mut ImageSession<'_>,
    renderer: &mut Renderer<'_>,
) -> Vec<(StepImages, Option<Vec<u8>>)> {
    let mut all = Vec::new();
    loop {
        let frame = simulation.committed().get().step;
        let expected = simulation.forecast(session.forecasts()).into_iter();
        let expected: Vec<_> = expected.map(|next| next.map(|next| scene_state(log, &next, None))).collect();
        let now = shown(simulation, log);
        let made = session.generate(frame, now.as_ref(), &expected, renderer).unwrap().unwrap();
        all.push((made, session.save().unwrap()));
        if simulation.step().unwrap().is_none() {
            return all;
        }
    }
}

/// Answers with the color maps; reports what it sees on standard error only if something is wrong.
const COLOR: &str = "
see()
counts = {'references': '2', 'history': '3', 'forecasts': '4'}
say(HELLO | counts | {'maps': '[\"color\", \"depth\", \"instance\"]'})
while (message := see()) is not None:
    texts, tensors = message
    times, frame = json.loads(texts['t_us']), int(texts['frame'])
    count = len(times)
    assert 3 <= count <= 5, times  # the plan ends sooner where it has just begun
    assert texts['ask'] == 'generate' and json.loads(texts['prompts']) == ['a street'] * len(times), texts
    dtype, shape, color = tensors['color']
    assert (dtype, list(shape)) == ('U8', [count, *SHAPE]), (dtype, shape)
    assert tensors['depth'][0] == 'F32' and list(tensors['depth'][1]) == [count, 6, 24, 40]
    assert tensors['instance'][0] == 'U16' and list(tensors['instance'][1]) == [count, 6, 24, 40]
    poses = struct.unpack(f'<{16 * count}d', tensors['global_from_ego'][2])
    assert poses[16 * (count - 1) + 3] > poses[3] and poses[15] == 1.0
    assert list(tensors['intrinsics'][1]) == [count, 6, 3, 3]
    actors = json.loads(texts['actors'])
    assert {actor['track'] for actor in actors[0]} <= {'ahead', 'cone', 'left'}
    assert len(actors) == count
    assert list(tensors['images'][1]) == [min(frame, 3), *SHAPE], tensors['images'][1]
    earlier = tensors['images'][2]
    image = color[: len(color) // count]
    last = earlier[-len(image):]
    # The last image, one level brighter, where the color map is empty.
    mixed = bytes(c or (b + 1) % 256 for c, b in zip(image, last))
    say({'frame': texts['frame']}, images=('U8', SHAPE, mixed))
";

#[test]
fn images_follow_the_color_maps_and_the_earlier_images() {
    let scene = Scene::new();
    let mut renderer = scene.renderer();
    let process = scene.start(script(&scene.path(), COLOR), PATIENT_S).unwrap();
    assert_eq!((process.size(), process.window(), process.forecasts()), (SIZE, 3, 4));
    let mut session = scene.session(process);
    let log = scene.log.recording();
    let whole = drive(log, &mut scene.simulation(), &mut session, &mut renderer);
    assert_eq!(whole.len(), 13);

    // The expected images, from the maps of a renderer.
    let options = ConditionOptions { maps: MapSet::of(&[MapKind::Color]), ..recipe().options(false) };
    let maps = point_skeleton::MapOptions::new(options, recipe().selection());
    let mut simulation = scene.simulation();
    let mut before: Vec<RgbImage> = Vec::new();
    for (frame, (made, saved)) in whole.iter().enumerate() {
        assert_eq!((made.is_reference, saved.is_some()), (frame < 2, frame >= 2), "{frame}");
        let state = scene_state(log, simulation.committed().get(), None);
        let set = renderer.render_with(&state, &maps).unwrap().set;
        if made.is_reference {
            let truth = GroundTruthImages::new(&scene.log);
            before = truth.of(&state, Clone::clone, SIZE, true).unwrap();
        } else {
            for (image, camera) in before.iter_mut().zip(&set.cameras) {
                let color = camera.color.as_ref().unwrap().as_flattened();
                for (value, level) in image.iter_mut().zip(color) {
                    *value = if *level == 0 { value.wrapping_add(1) } else { *level };
                }
            }
        }
        assert!(made.images == before, "frame {frame}");
        simulation.step().unwrap();
    }

    // Resumed after any step, with a new process: the same images.
    for after in [0, 1, 2, 3, 7] {
        let process = scene.start(script(&scene.path(), COLOR), PATIENT_S).unwrap();
        let mut session = scene.session(process);
        let (mut simulation, mut last) = (scene.simulation(), Vec::new());
        for _ in 0..=after {
            last.push(shown(&simulation, log));
            simulation.step().unwrap();
        }
        let window = last.len().saturating_sub(session.window());
        let saved = whole[after].1.as_deref();
        session.resume(after + 1, &last[window..], saved, &mut renderer).unwrap();
        let rest = drive(log, &mut simulation, &mut session, &mut renderer);
        assert!(rest == whole[after + 1..], "after {after}");
        // Another frame's state is refused.
        let (process, mut renderer) =
            (scene.start(script(&scene.path(), COLOR), PATIENT_S).unwrap(), scene.renderer());
        let refused = scene.session(process).resume(after + 3, &[], saved, &mut renderer);
        let refused = refused.unwrap_err().to_string();
        assert!(refused.starts_with("cannot resume: expected "), "{refused}");
    }
}

#[test]
fn a_generator_may_want_poses_alone() {
    let lines = "
see()
say(HELLO | {'maps': '[]', 'references': '0', 'history': '0'})
while (message := see()) is not None:
    texts, tensors = message
    assert sorted(tensors) == ['ego_from_camera', 'global_from_ego', 'intrinsics'], sorted(tensors)
    say({}, images=('U8', SHAPE, bytes([int(texts['frame'])]) * (6 * 24 * 40 * 3)))
";
    let scene = Scene::new();
    let mut renderer = scene.renderer();
    let process = scene.start(script(&scene.path(), lines), PATIENT_S).unwrap();
    assert_eq!((process.window(), process.forecasts()), (1, 0));
    let mut session = scene.session(process);
    let all = drive(scene.log.recording(), &mut scene.simulation(), &mut session, &mut renderer);
    for (frame, (made, saved)) in all.iter().enumerate() {
        assert!(!made.is_reference && saved.is_some());
        assert!(
            made.images.iter().all(|image| image.as_raw().iter().all(|level| usize::from(*level) == frame))
        );
    }
}

#[test]
fn bad_hellos_are_errors() {
    let scene = Scene::new();
    for (answer, part) in [
        ("say(HELLO | {'version': '2'})", "found `protocol` \"pskel-images\" of `version` \"2\""),
        ("say()", "found `protocol` none of `version` none"),
        ("del HELLO['image_size']\nsay(HELLO)", "`image_size` \"H,W\" of positive numbers"),
        (
            "say(HELLO | {'image_size': '30000,30000'})",
            "at most 29826161 pixels from the image generator, found",
        ),
        ("say(HELLO | {'references': '101'})", "`references` from 0 to 100, if any"),
        ("say(HELLO | {'history': '-1'})", "`history` from 0 to 100, if any"),
        ("say(HELLO | {'forecasts': 'all'})", "`forecasts` from 0 to 100, if any"),
        ("say(HELLO | {'maps': '[\"map\"]'})", "list of color, depth, class, instance, boxes, each"),
        ("say(HELLO | {'maps': '[\"color\", \"color\"]'})", "each at most once"),
        ("say(HELLO | {'maps': 'color'})", "found \"color\""),
        ("say({'error': 'no GPU'})", "images from the image generator, found the error \"no GPU\""),
        ("print('loading ...', flush=True)", "bytes \"loading \""),
    ] {
        let address = script(&scene.path(), &format!("see()\n{answer}\ntime.sleep(600)"));
        let Err(error) = scene.start(address, PATIENT_S) else { panic!("{answer}") };
        assert!(matches!(error, ImageProcessError::Peer(PeerError::Answer { .. })), "{error}");
        assert!(error.to_string().contains(part), "{answer}: {error}");
    }
    let gone = scene.start(script(&scene.path(), "see()\nsys.exit(3)"), PATIENT_S).err().unwrap();
    assert!(gone.to_string().contains("found its end (exit status: 3)"), "{gone}");
    let silent = scene.start(script(&scene.path(), "time.sleep(600)"), 1.0).err().unwrap();
    assert!(silent.to_string().contains("within 1 s, found none"), "{silent}");
}

#[test]
fn bad_images_are_errors_and_end_the_session() {
    let scene = Scene::new();
    let mut renderer = scene.renderer();
    let now = |simulation: &Simulation<'_>| shown(simulation, scene.log.recording());
    let bytes = 6 * 24 * 40 * 3;
    for (answer, part) in [
        (format!("say(images=('F32', SHAPE, bytes(4 * {bytes})))"), "`images` as U8 from"),
        (format!("say(images=('U8', [6, 40, 24, 3], bytes({bytes})))"), "`images` of [6, 24, 40, 3] from"),
        (format!("say(images=('U8', SHAPE, bytes({bytes} - 1)))"), "a safetensors file from"),
        (format!("say(image=('U8', SHAPE, bytes({bytes})))"), "a tensor `images` from"),
        (
            format!("say({{'frame': '9'}}, images=('U8', SHAPE, bytes({bytes})))"),
            "images of `frame` \"1\" from",
        ),
        ("say({'error': 'out of memory'})".to_owned(), "found the error \"out of memory\""),
    ] {
        let lines = format!("see()\nsay(HELLO)\nsee()\n{answer}\ntime.sleep(600)");
        let mut session = scene.session(scene.start(script(&scene.path(), &lines), PATIENT_S).unwrap());
        let mut simulation = scene.simulation();
        session.generate(0, now(&simulation).as_ref(), &[], &mut renderer).unwrap();
        simulation.step().unwrap();
        let error =
            session.generate(1, now(&simulation).as_ref(), &[], &mut renderer).unwrap_err().to_string();
        assert!(error.contains(part), "{answer}: {error}");
        let again =
            session.generate(1, now(&simulation).as_ref(), &[], &mut renderer).unwrap_err().to_string();
        assert!(again.contains("found its end"), "{again}");
    }
}
