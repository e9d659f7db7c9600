use std::collections::BTreeMap;

use glam::DVec3;
use smartcore::cluster::kmeans::{KMeans, KMeansParameters};
use smartcore::linalg::basic::matrix::DenseMatrix;

use super::kind::Family;
use super::{TemplateKind, TemplateOptions};

/// Cluster of actors: indices into the clustered list, and kind.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Cluster {
    pub(super) kind: TemplateKind,
    /// Mean length, width, height, meters.
    pub(super) size_m: DVec3,
    pub(super) members: Vec<usize>,
}

/// Clusters actors by category family and size. The kind of a cluster follows from its mean size. Sorted by
/// kind, then size.
pub(super) fn clusters(actors: &[(Family, DVec3)], options: &TemplateOptions) -> Vec<Cluster> {
    let mut families: BTreeMap<Family, Vec<usize>> = BTreeMap::new();
    for (index, (family, _)) in actors.iter().enumerate() {
        families.entry(*family).or_default().push(index);
    }
    let mut all = Vec::new();
    for (family, members) in families {
        let sizes: Vec<DVec3> = members.iter().map(|i| actors[*i].1).collect();
        for part in partition(&sizes, options) {
            let size_m = mean(&part, &sizes);
            let members = part.into_iter().map(|i| members[i]).collect();
            all.push(Cluster { kind: family.kind(size_m), size_m, members });
        }
    }
    let volume = |c: &Cluster| c.size_m.element_product();
    all.sort_by(|a, b| a.kind.cmp(&b.kind).then(volume(a).total_cmp(&volume(b))));
    all
}

/// Splits actors into the fewest clusters with members of similar size, at most `max_clusters`.
fn partition(sizes: &[DVec3], options: &TemplateOptions) -> Vec<Vec<usize>> {
    let mut distinct: Vec<[u64; 3]> = sizes.iter().map(|s| s.to_array().map(f64::to_bits)).collect();
    distinct.sort_unstable();
    distinct.dedup();
    let most = options.max_clusters.clamp(1, distinct.len().max(1));
    let mut parts = vec![(0..sizes.len()).collect()];
    for count in 2..=most {
        if parts.iter().all(|part: &Vec<usize>| spread(part, sizes) <= options.size_spread) {
            break;
        }
        parts = k_means(sizes, count);
    }
    parts
}

/// Number of k-means starts; the one with the smallest spread is used.
const STARTS: u64 = 8;

/// Clusters by the logarithms of length, width and height, so that relative differences count.
fn k_means(sizes: &[DVec3], count: usize) -> Vec<Vec<usize>> {
    let rows: Vec<Vec<f64>> = sizes.iter().map(|s| s.to_array().map(f64::ln).to_vec()).collect();
    let start = |seed: u64| -> Option<Vec<Vec<usize>>> {
        let matrix = DenseMatrix::from_2d_vec(&rows).ok()?;
        let parameters = KMeansParameters { k: count, max_iter: 100, seed: Some(seed) };
        let labels: Vec<u32> = KMeans::fit(&matrix, parameters).ok()?.predict(&matrix).ok()?;
        let mut parts = vec![Vec::new(); count];
        labels.iter().enumerate().for_each(|(index, label)| parts[*label as usize].push(index));
        parts.retain(|part| !part.is_empty());
        Some(parts)
    };
    let cost = |parts: &[Vec<usize>]| -> f64 {
        parts.iter().map(|part| spread(part, sizes).powi(2) * part.len() as f64).sum()
    };
    let starts = (0..STARTS).filter_map(start).map(|parts| (cost(&parts), parts));
    let best = starts.min_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or_else(|| vec![(0..sizes.len()).collect()], |(_, parts)| parts)
}

fn mean(part: &[usize], sizes: &[DVec3]) -> DVec3 {
    part.iter().map(|i| sizes[*i]).sum::<DVec3>() / part.len().max(1) as f64
}

/// Returns the root mean square deviation from the mean, relative to it: the maximum over the axes.
fn spread(part: &[usize], sizes: &[DVec3]) -> f64 {
    let centre = mean(part, sizes);
    let squares: DVec3 = part.iter().map(|i| (sizes[*i] / centre - 1.0).powf(2.0)).sum();
    (squares / part.len().max(1) as f64).max_element().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use TemplateKind as Kind;

    /// Returns sizes within 3 % of a size.
    fn around(size: [f64; 3], count: usize) -> Vec<DVec3> {
        let off = |i: usize, axis: usize| 1.0 + 0.03 * ((i * 7 + axis * 3) as f64).sin();
        (0..count).map(|i| DVec3::from_array(std::array::from_fn(|axis| size[axis] * off(i, axis)))).collect()
    }

    #[test]
    fn known_sizes_get_their_kinds() {
        let groups = [
            (Family::Car, [4.7, 1.85, 1.45], 20, Kind::Sedan),
            (Family::Car, [4.8, 1.95, 1.9], 9, Kind::Suv),
            (Family::Car, [5.6, 2.05, 2.3], 5, Kind::Pickup),
            (Family::AnyVehicle, [12.0, 3.0, 3.3], 3, Kind::Bus),
            (Family::AnyVehicle, [4.5, 1.8, 1.5], 6, Kind::Sedan),
            (Family::Of(Kind::Truck), [8.0, 2.5, 3.2], 2, Kind::Truck),
            (Family::Of(Kind::Pedestrian), [0.7, 0.7, 1.75], 12, Kind::Pedestrian),
        ];
        let mut actors = Vec::new();
        let mut expected: BTreeMap<Kind, Vec<usize>> = BTreeMap::new();
        for (family, size, count, kind) in groups {
            expected.entry(kind).or_default().extend(actors.len()..actors.len() + count);
            actors.extend(around(size, count).into_iter().map(|s| (family, s)));
        }
        let found = clusters(&actors, &TemplateOptions::default());
        assert_eq!(found.len(), groups.len(), "{found:?}");
        let mut by_kind: BTreeMap<Kind, Vec<usize>> = BTreeMap::new();
        for cluster in &found {
            by_kind.entry(cluster.kind).or_default().extend(&cluster.members);
        }
        by_kind.values_mut().for_each(|members| members.sort_unstable());
        assert_eq!(by_kind, expected);
    }

    #[test]
    fn equal_and_few_sizes_are_clustered() {
        let options = TemplateOptions { size_spread: 0.0, ..TemplateOptions::default() };
        let car = (Family::Car, DVec3::new(4.0, 2.0, 1.5));
        assert!(clusters(&[], &options).is_empty());
        assert_eq!(clusters(&[car], &options).len(), 1);
        assert_eq!(clusters(&[car; 50], &options).len(), 1);
        let other = (Family::Car, DVec3::new(40.0, 2.0, 1.5));
        let two = clusters(&[car, other, car, other], &options);
        assert_eq!(two.iter().map(|c| c.members.clone()).collect::<Vec<_>>(), [vec![0, 2], vec![1, 3]]);
        // A thousand sizes give no more clusters than allowed.
        let many: Vec<_> = (1..=1000).map(|i| (Family::Car, DVec3::splat(0.1 * f64::from(i)))).collect();
        let found = clusters(&many, &TemplateOptions { max_clusters: 5, ..options });
        assert_eq!(found.len(), 5);
        assert_eq!(found.iter().map(|c| c.members.len()).sum::<usize>(), 1000);
    }
}
