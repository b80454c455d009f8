//! Immediate examination: pairs are examined as soon as the descent reaches them.

use super::bodies::{Bodies, Decision};
use super::context::Context;
use super::descent::Sink;
use super::front::Pair;
use super::outcome::Report;
use super::patch_query::PatchQuery;

/// Sink that examines pairs at once and reports their contacts in the order of the descent.
#[derive(Debug)]
pub(crate) struct Immediate<'r>(pub &'r mut Report);

impl Sink for Immediate<'_> {
    const DEFERS: bool = false;

    fn examine(
        &mut self,
        decision: Decision,
        pair: &mut Pair,
        _: Option<u32>,
        weight: f64,
        (bodies, context, patch_query): (&Bodies, &Context, &mut PatchQuery),
    ) -> Decision {
        let decides = decision == Decision::ExamineToDecide;
        let decision = bodies.examine(pair, decides, context, patch_query);
        let weight = weight * (1.0 - pair.refined_share);
        for contact in &patch_query.contacts {
            self.0.add(contact, [pair.a, pair.b], weight, &context.probe_pose);
        }
        decision
    }
}
