//! The shapes in a scene, each with the workspaces that its objects share.

use palpate_core::glam::DVec3;

use crate::ball::Ball;
use crate::query::{ContactQuery, QueryOutcome};
use crate::shape::Shape;

/// The query with an object, and its last outcome.
#[derive(Clone, Debug)]
pub(crate) struct Workspace {
    pub query: ContactQuery,
    pub outcome: QueryOutcome,
}

/// A shape that objects of the scene have.
#[derive(Clone, Debug)]
pub(crate) struct Kind {
    pub shape: Shape,
    pub ball: Ball,
    /// Corners of the box, m.
    pub low: DVec3,
    pub high: DVec3,
    /// Distance of the furthest corner of the box from the sphere's centre, m.
    pub corner: f64,
    /// Workspaces that no object holds, with room for all.
    #[expect(clippy::vec_box, reason = "objects hold boxes, which are passed on without a copy")]
    pub spare: Vec<Box<Workspace>>,
    /// Number of workspaces, including those that objects hold.
    pub workspaces: usize,
    /// Number of objects that have the shape.
    pub objects: usize,
}

impl Kind {
    pub fn new(shape: &Shape) -> Self {
        let points = || shape.clod().vertices.iter().copied();
        let (low, high) =
            (points().fold(DVec3::INFINITY, DVec3::min), points().fold(DVec3::NEG_INFINITY, DVec3::max));
        let ball = shape.ball();
        let corner = (high - ball.center).abs().max((low - ball.center).abs()).length();
        Self { shape: shape.clone(), ball, low, high, corner, spare: Vec::new(), workspaces: 0, objects: 0 }
    }

    /// Adds a workspace to the spare ones.
    pub fn add_workspace(&mut self, query: ContactQuery) {
        self.workspaces += 1;
        self.spare.reserve(self.workspaces - self.spare.len());
        self.spare.push(Box::new(Workspace { query, outcome: QueryOutcome::default() }));
    }

    /// Bytes of memory held by the spare workspaces and their list.
    pub fn bytes(&self) -> usize {
        let of_workspaces = self.spare.iter().map(|workspace| workspace.bytes());
        size_of::<Self>() + 8 * self.spare.capacity() + of_workspaces.sum::<usize>()
    }
}

impl Workspace {
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.query.bytes()
    }
}
