//! Contact queries of the proxy, by levels of detail or in fields.

use palpate_collide::{QueryError, QuerySettings, SceneOutcome, SceneQuery};
use palpate_core::Pose;

use super::contact::ProxyContact;

/// A contact query at a pose of the proxy.
pub(crate) trait ContactFinder {
    /// Whether two patches have only one contact at a time, which jumps as they rock.
    const CONTACTS_JUMP: bool;

    /// Distance within which contacts are found, m.
    fn reach(&self) -> f64;

    /// Finds the contacts of the probe with its mesh's frame at a pose; `true` if all objects in reach were
    /// queried.
    fn find(&mut self, mesh: &Pose, report: &mut QueryReport) -> bool;

    /// The contacts of the last query.
    fn contacts(&self) -> impl Iterator<Item = ProxyContact>;

    /// The largest depth (m) that the last query found in each scene object, with the object's place.
    fn depths(&self) -> impl Iterator<Item = (usize, f64)>;
}

/// Outcome of the queries of a step of the proxy.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct QueryReport {
    /// Number of contacts dropped because there were too many.
    pub dropped: usize,
    /// Whether a query failed, or left out an object that cannot be queried.
    pub refused: bool,
    /// Number of pairs of hulls that did not converge.
    pub not_converged: usize,
}

impl QueryReport {
    fn count(&mut self, outcome: &Result<SceneOutcome, QueryError>) {
        match outcome {
            Ok(SceneOutcome { query, invalid, .. }) => {
                self.dropped += query.dropped;
                self.refused |= *invalid > 0;
                self.not_converged += query.not_converged;
            }
            Err(_) => self.refused = true,
        }
    }
}

/// The proxy's contact search by levels of detail.
pub(crate) struct LevelFinder<'a> {
    pub scene: &'a mut SceneQuery,
    /// Query settings, with the reach as their tolerance.
    pub settings: QuerySettings,
}

impl ContactFinder for LevelFinder<'_> {
    const CONTACTS_JUMP: bool = true;

    fn reach(&self) -> f64 {
        self.settings.tolerance
    }

    fn find(&mut self, mesh: &Pose, report: &mut QueryReport) -> bool {
        let outcome = self.scene.run(mesh, &self.settings);
        report.count(&outcome);
        outcome.is_ok_and(|outcome| outcome.invalid == 0)
    }

    fn contacts(&self) -> impl Iterator<Item = ProxyContact> {
        self.scene.contacts().flat_map(|with| {
            let object = with.object.place();
            with.contacts.iter().map(move |&contact| ProxyContact::new(contact, object))
        })
    }

    fn depths(&self) -> impl Iterator<Item = (usize, f64)> {
        self.scene.contacts().filter_map(|with| Some((with.object.place(), with.outcome.deepest?)))
    }
}
