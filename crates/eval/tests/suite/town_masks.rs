//! Masks of vehicles of a town's class maps, against a segmentor that returns the true masks.

use point_skeleton::conditions::{ConditionOptions, ImageSize, MapKind, MapSet, reduce};
use point_skeleton::dataset::LogReader;
use point_skeleton::geometry::View;
use point_skeleton::scene::{EgoOffset, state_of_frame};
use point_skeleton::skeleton::{BuildInput, BuildRun, build};
use point_skeleton::{RenderOptions, Renderer};
use pskel_eval::{MaskDifference, MaskDifferences, MaskPair, MaskRule, VEHICLE_CLASS, vehicle_mask};
use pskel_testing::synthetic_town::other_town;

/// Key frames as nuScenes has them, a second apart instead of half a second; small images, which only give
/// colors.
const TOWN: &str = "seed=3,frames=4,hz=1,beams=64,lidar_hz=20,size=45x80";
/// Compared cameras: front, front right, back right.
const CAMERAS: usize = 3;
const RENDERED: ImageSize = ImageSize { height: 450, width: 800 };
const COMPARED: ImageSize = ImageSize { height: 256, width: 448 };

#[test]
fn true_masks_match_by_both_rules() {
    let folder = tempfile::tempdir().unwrap();
    let town = other_town(TOWN);
    let (inputs, run) = ([BuildInput::all(&town)], BuildRun::default());
    let out = folder.path().join("skeleton");
    let skeleton = build(&out, &inputs, &Default::default(), &|_| Ok(Vec::new()), &run).unwrap();
    let options = ConditionOptions {
        maps: MapSet::of(&[MapKind::Class, MapKind::Depth]),
        splat: "5:4,15:2,35:1,100:0".parse().unwrap(),
        size: Some(RENDERED),
        out_size: Some(COMPARED),
        ..ConditionOptions::default()
    };
    let mut state = state_of_frame(town.recording(), 2, EgoOffset::default()).unwrap();
    state.cameras.truncate(CAMERAS);
    let views: Vec<View> = state.cameras.iter().map(|camera| options.drawn_view(&camera.view)).collect();
    let truth = town.truth(state.t_us, &views).unwrap();
    let render = RenderOptions { conditions: options, ..RenderOptions::default() };
    let maps = Renderer::new(&skeleton, render).unwrap().render(&state).unwrap().set;
    for rule in MaskRule::ALL {
        let mut sums = [MaskDifferences::default()];
        for (map, seen) in maps.cameras.iter().zip(&truth) {
            let (class, depth_m) = (map.class.as_ref().unwrap(), map.depth_m.as_ref().unwrap());
            let true_class = reduce::nearest(&seen.class, RENDERED, COMPARED);
            let true_depth_m = reduce::nearest(&seen.depth_m, RENDERED, COMPARED);
            let vehicles: Vec<bool> = true_class.iter().map(|class| *class == VEHICLE_CLASS).collect();
            let width = COMPARED.width as usize;
            let mask = vehicle_mask(class, width, rule);
            let pair = MaskPair {
                width,
                mask: &mask,
                class,
                depth_m,
                truth: &vehicles,
                true_depth_m: &true_depth_m,
            };
            pair.add_to(&mut sums, |_| 0, |depth_m| if depth_m < 15.0 { 3 } else { 2 });
        }
        let [sums] = sums;
        let share = |pixels| sums.share(pixels).unwrap();
        assert!(share(sums.both) >= 0.9, "{rule}: {sums:?}");
        // Most of the rest are edges of splats and of the masks; no vehicle shines through a house.
        let of = |cause: MaskDifference| share(sums.causes[cause as usize]);
        let edges = of(MaskDifference::SplatEdge) + of(MaskDifference::MissingEdge);
        assert!(edges > 0.4 * (1.0 - share(sums.both)), "{rule}: {sums:?}");
        assert!(of(MaskDifference::SeenThrough) < 0.01, "{rule}: {sums:?}");
    }
}
