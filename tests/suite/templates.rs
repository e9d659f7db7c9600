//! Templates of a real recording, and those built in.

use point_skeleton::Log;
use point_skeleton::cloud::Point;
use point_skeleton::skeleton::{
    Asset, BuildOptions, Instances, TemplateKind, TemplateOptions, default_templates,
};
use pskel_testing::shared::{shared, skeleton_of};

/// Returns real-world extents of a kind: length, width, height, each min and max, meters.
fn known(kind: TemplateKind) -> [[f64; 2]; 3] {
    match kind {
        TemplateKind::Sedan => [[3.2, 5.3], [1.5, 2.3], [1.1, 1.8]],
        TemplateKind::Suv => [[4.0, 5.5], [1.6, 2.4], [1.5, 2.1]],
        TemplateKind::Pickup => [[4.2, 6.9], [1.7, 2.6], [1.8, 3.0]],
        TemplateKind::Pedestrian => [[0.3, 1.2], [0.3, 1.2], [1.2, 2.1]],
        TemplateKind::Bike => [[1.4, 2.5], [0.4, 1.1], [0.9, 2.0]],
        _ => [[2.0, 20.0], [1.4, 4.5], [1.4, 6.0]],
    }
}

#[test]
fn templates_of_a_real_recording_have_plausible_sizes() {
    let Some(folder) = shared("the PandaSet drive") else { return };
    let folder = folder.join("data/pandaset-002/nuscenes");
    let dataset = Log::open(&format!("nuscenes:{}", folder.display())).unwrap();
    let frames: Vec<usize> = (0..dataset.recording().frames.len()).step_by(4).collect();
    let options = BuildOptions::default();
    let scratch = tempfile::tempdir().unwrap();
    let built = skeleton_of(&scratch.path().join("s"), dataset.reader(), &frames, &options);
    let assets: Vec<(&Asset, &[Point])> = built.manifest.actors.iter().zip(built.actors().unwrap()).collect();
    let mut instances = Instances::new(TemplateOptions::default());
    instances.add(&assets);
    let (templates, report) = instances.templates();
    let kinds: Vec<TemplateKind> = templates.iter().map(|(t, _)| t.kind).collect();
    for kind in [TemplateKind::Sedan, TemplateKind::Suv, TemplateKind::Truck] {
        assert!(kinds.contains(&kind), "{kinds:?}");
    }
    for (template, points) in templates.iter().chain(&default_templates()) {
        println!("{:?}: {} points, {:?}", template.kind, points.len(), template.bounds);
        for (axis, [least, most]) in known(template.kind).into_iter().enumerate() {
            let extent = f64::from(template.bounds.max[axis]) - f64::from(template.bounds.min[axis]);
            assert!((least..=most).contains(&extent), "{:?}: {extent} m along axis {axis}", template.kind);
        }
    }
    // Every actor is accounted for.
    let used: usize = report.templates.iter().map(|t| t.instances).sum();
    let not_used = report.templates.iter().flat_map(|t| &t.clusters).filter(|c| !c.used);
    let of_another_size: usize = not_used.map(|c| c.members.len()).sum();
    assert!(of_another_size < used);
    let left: usize = report.notes.iter().filter(|(n, _)| n.starts_with("actors")).map(|(_, c)| c).sum();
    assert_eq!(used + left, assets.len());
}
