//! Measurements of one setting on one scenario.

use palpate_measure::{
    BodyPath, Difference, Experiment, MeasureError, Profile, Trace, penetration, pressed, quantile,
    stability_margin,
};

use super::scenario::Scenario;
use super::variation::Variation;

/// Rate of contact steps in sessions, Hz, whatever they take, so that sessions are reproducible.
pub const CONTACT_RATE: f64 = 500.0;

/// Session that others are compared with: at full resolution, or with representative contacts at the smallest
/// EPS, with a contact step in each haptic step.
pub struct Reference {
    pub trace: Trace,
    /// States that its contact queries saw, at the sessions' rate.
    pub path: BodyPath,
    /// Contact steps along the path.
    pub profile: Profile,
}

/// Cost and accuracy of a setting.
#[derive(Clone, Debug)]
pub struct Measured {
    pub variation: Variation,
    /// Times of contact steps in contact along the session's own path, s: median and 99th percentile.
    pub contact: [f64; 2],
    /// Times of haptic steps with the emulated device, s: median and 99th percentile.
    pub haptic: [f64; 2],
    /// Memory of hierarchies and workspaces.
    pub bytes: usize,
    /// Difference of the contact wrenches at the reference's states.
    pub rendered: Difference,
    /// Difference of the wrenches at the device.
    pub felt: Difference,
    /// Largest penetration, m.
    pub penetration: f64,
    pub stability_margin: f64,
}

fn session<'a>(scenario: &'a Scenario, variation: &Variation, contact_rate: f64) -> Experiment<'a> {
    Experiment {
        probe: &scenario.probe,
        scene: &scenario.scene,
        settings: variation.settings,
        integrator: variation.integrator,
        contact_rate,
        frozen: false,
        seconds: scenario.seconds,
    }
}

impl Reference {
    /// Renders the reference of a scenario.
    ///
    /// # Errors
    /// If it cannot be rendered, or the objects never touch.
    pub fn of(scenario: &Scenario, full: &Variation) -> Result<Self, String> {
        let experiment = session(scenario, full, full.settings.timing.rate);
        let trace = experiment.emulate(scenario.hand()?).map_err(|error| error.to_string())?;
        let path = BodyPath::of(&trace).thinned_to(CONTACT_RATE);
        let profile = Profile::along(&path, &scenario.probe, &scenario.scene, &full.settings, 1)
            .map_err(|error| error.to_string())?;
        if profile.touching().next().is_none() {
            return Err(format!("{}: the objects never touch", scenario.name));
        }
        Ok(Self { trace, path, profile })
    }
}

impl Measured {
    /// Measures a setting on a scenario.
    ///
    /// # Errors
    /// If it cannot be rendered.
    pub fn of(
        scenario: &Scenario,
        variation: &Variation,
        full: &Variation,
        reference: &Reference,
    ) -> Result<Self, String> {
        let Scenario { probe, scene, .. } = scenario;
        let settings = &variation.settings;
        let say = |error: MeasureError| error.to_string();
        let trace = session(scenario, variation, CONTACT_RATE).emulate(scenario.hand()?).map_err(say)?;
        let mut timed = Profile::along(&BodyPath::of(&trace), probe, scene, settings, 1).map_err(say)?;
        for (least, query) in timed.times.iter_mut().zip(&trace.queries) {
            *least = least.min(query.took);
        }
        let same = Profile::along(&reference.path, probe, scene, settings, 1).map_err(say)?;
        let held = pressed(&reference.trace, &reference.path, &reference.profile, probe);
        Ok(Self {
            contact: [0.5, 0.99].map(|fraction| timed.time(fraction)),
            haptic: [0.5, 0.99].map(|fraction| quantile(&trace.step_times, fraction)),
            bytes: timed.bytes,
            rendered: Difference::of(&same, &reference.profile, 1.0 / reference.path.period),
            felt: Difference::felt(&trace, &reference.trace),
            penetration: penetration(&trace, probe, scene, &full.settings).map_err(say)?,
            stability_margin: stability_margin(
                probe,
                scene,
                (settings, variation.integrator),
                held,
                CONTACT_RATE,
            )
            .map_err(say)?,
            variation: variation.clone(),
        })
    }

    /// Returns the error of the wrench at the device, relative to the reference's.
    pub fn felt_error(&self) -> f64 {
        self.felt.force.relative().max(self.felt.torque.relative())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trade::behaviour_row;
    use crate::trade::scenario::tests::small;
    use crate::trade::variation::{Axis, variations};

    #[test]
    fn left_out_detail_is_felt_and_measured_reproducibly() {
        let scenario = small();
        let variations = variations(&scenario);
        let full = &variations[0];
        assert_eq!((full.axis, full.settings.detail.error), (Axis::Error, 0.0));
        let reference = Reference::of(&scenario, full).unwrap();
        let measure = |variation| Measured::of(&scenario, variation, full, &reference).unwrap();
        let coarse = variations.iter().rfind(|variation| variation.axis == Axis::Error).unwrap();
        let (exact, coarse, again) = (measure(full), measure(coarse), measure(coarse));
        assert_eq!(exact.rendered.force.mean, 0.0, "{:?}", exact.rendered);
        assert!(coarse.rendered.force.mean > 0.0, "{:?}", coarse.rendered);
        assert!(coarse.felt_error() > exact.felt_error(), "{:?} {:?}", coarse.felt, exact.felt);
        assert!(exact.stability_margin >= 1.0 && exact.contact[0] > 0.0 && exact.haptic[0] > 0.0);
        assert_eq!(behaviour_row("small", &coarse), behaviour_row("small", &again));
        // Forward Euler is stable with less stiff contacts than the semi-implicit integrator.
        let forward = variations.iter().find(|variation| variation.value == "forward-euler").unwrap();
        let (implicit, forward) = (exact.stability_margin, measure(forward).stability_margin);
        assert!(forward < implicit, "{forward} {implicit}");
    }
}
