//! Small maps for the tests of the writers.

use crate::conditions::{CameraConditions, ConditionSet};

/// Returns two cameras of 4x6 pixels with all maps except point numbers and model tensor.
pub(in super::super) fn test_set() -> ConditionSet {
    let camera = |name: &str, seed: u32| {
        let all = |f: &dyn Fn(u32) -> u32| (0..24).map(|i| f(i + seed)).collect::<Vec<u32>>();
        let rgb =
            |k: u32| all(&|i| i * k).into_iter().map(|v| [v as u8, (v * 3) as u8, (v * 7) as u8]).collect();
        CameraConditions {
            name: name.parse().unwrap(),
            width: 6,
            height: 4,
            color: Some(rgb(5)),
            depth_m: Some(
                all(&|i| i)
                    .iter()
                    .map(|i| if i % 5 == 0 { f32::INFINITY } else { *i as f32 * 0.75 })
                    .collect(),
            ),
            class: Some(all(&|i| i % 5).iter().map(|c| *c as u8).collect()),
            instance: Some(all(&|i| i * 1000)),
            boxes: Some(rgb(9)),
            map: Some(rgb(11)),
            point: None,
            tensor: None,
        }
    };
    ConditionSet { cameras: vec![camera("left", 0), camera("right", 31)] }
}
