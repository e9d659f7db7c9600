//! Boxes of pieces in a tree with eight branches.

use glam::Vec3A;
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::bvh2::node::Bvh2Node;

use super::fan::Fan;
use super::lanes::{LANES, Lanes};

/// A bounding volume hierarchy whose leaves are pieces.
pub(super) struct Tree {
    /// The first is the root; none without pieces.
    nodes: Vec<Node>,
}

/// A node of a tree.
#[derive(Clone, Copy, Debug)]
struct Node {
    /// Centers of the branches' boxes, meters.
    centers: [Lanes<LANES>; 3],
    /// Half sizes of these boxes, meters; not numbers for branches that are not used.
    halves: [Lanes<LANES>; 3],
    branches: [Branch; LANES],
}

/// What a branch leads to: the number of a node, or of a piece, whose highest bit is set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Branch(u32);

impl Branch {
    const PIECE: u32 = 1 << 31;

    #[inline(always)]
    pub(super) fn piece(self) -> Option<usize> {
        (self.0 & Self::PIECE != 0).then_some((self.0 & !Self::PIECE) as usize)
    }
}

/// A branch that rays in a fan may meet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Visit {
    /// Least distance at which they can meet it, in the boxes' frame.
    pub(super) near: f32,
    pub(super) branch: Branch,
    /// First of the rays, and the one behind the last.
    pub(super) rays: [u32; 2],
}

impl Tree {
    /// Creates the tree of boxes. Returns it, and the numbers of the boxes in its order.
    pub(super) fn of(boxes: &[Aabb]) -> (Self, Vec<u32>) {
        let (mut tree, mut order) = (Self { nodes: Vec::new() }, Vec::with_capacity(boxes.len()));
        if boxes.is_empty() {
            return (tree, order);
        }
        let params = BvhBuildParams { max_prims_per_leaf: 1, ..BvhBuildParams::fast_build() };
        let binary = build_bvh2(boxes, params, &mut Default::default());
        tree.add(&binary, vec![binary.nodes[0]], &mut order);
        (tree, order)
    }

    /// Returns the root's branches that rays in a fan may meet, the nearest last.
    #[inline(always)]
    pub(super) fn start(&self, origin: Vec3A, fan: &Fan) -> Vec<Visit> {
        let mut left = Vec::with_capacity(8 * LANES);
        if !self.nodes.is_empty() {
            self.branch(Branch(0), origin, fan, &mut left);
        }
        left
    }

    /// Adds a node's branches that rays in a fan may meet, the nearest last.
    #[inline(always)]
    pub(super) fn branch(&self, node: Branch, origin: Vec3A, fan: &Fan, left: &mut Vec<Visit>) {
        let node = &self.nodes[node.0 as usize];
        let [x, y, z] = node.centers;
        let centers = [x - origin.x, y - origin.y, z - origin.z];
        let reach = fan.reach_boxes(centers, node.halves);
        let before = left.len();
        for i in (0..LANES).filter(|i| reach.is_met[*i]) {
            let rays = fan.rays(&reach, i);
            if rays[0] >= rays[1] {
                continue;
            }
            let visit = Visit { near: reach.near.0[i], branch: node.branches[i], rays };
            let mut at = left.len();
            left.push(visit);
            while at > before && left[at - 1].near < visit.near {
                left[at] = left[at - 1];
                at -= 1;
            }
            left[at] = visit;
        }
    }

    /// Returns the memory of the tree, bytes.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.nodes.as_slice())
    }

    /// Adds a node with branches from a binary tree, and all below it. Returns its number.
    fn add(&mut self, binary: &Bvh2, mut branches: Vec<Bvh2Node>, order: &mut Vec<u32>) -> u32 {
        let area = |node: &Bvh2Node| node.aabb().half_area();
        while branches.len() < LANES {
            let inner = branches.iter().enumerate().filter(|(_, node)| !node.is_leaf());
            let Some((largest, _)) = inner.max_by(|(_, a), (_, b)| area(a).total_cmp(&area(b))) else {
                break;
            };
            let first = branches.swap_remove(largest).first_index as usize;
            branches.extend([binary.nodes[first], binary.nodes[first + 1]]);
        }
        let number = self.nodes.len();
        self.nodes.push(Node::of(&branches));
        for (i, branch) in branches.into_iter().enumerate() {
            self.nodes[number].branches[i] = if branch.is_leaf() {
                order.push(binary.primitive_indices[branch.first_index as usize]);
                Branch((order.len() as u32 - 1) | Branch::PIECE)
            } else {
                Branch(self.add(binary, vec![branch], order))
            };
        }
        number as u32
    }
}

impl Node {
    fn of(branches: &[Bvh2Node]) -> Self {
        let [mut centers, mut halves] = [0.0, f32::NAN].map(|value| [Lanes::all(value); 3]);
        for (i, branch) in branches.iter().enumerate() {
            let bounds = branch.aabb();
            let [center, half]: [Vec3A; 2] = [bounds.center(), bounds.diagonal() / 2.0];
            for axis in 0..3 {
                (centers[axis].0[i], halves[axis].0[i]) = (center[axis], half[axis]);
            }
        }
        Self { centers, halves, branches: [Branch(0); LANES] }
    }
}
