//! How much stiffer contacts could be until a held object is not at rest any more.

use palpate::dynamics::IntegratorKind;
use palpate::settings::ContactSettings;
use palpate::{Object, Pose, Scene, Settings};

use crate::error::MeasureError;
use crate::experiment::{Experiment, Trace};
use crate::judge::judge;
use crate::profile::{BodyPath, Profile};

/// The factors on the contact stiffness that are tried are powers of two, from this one on.
pub const WEAKEST: i32 = -6;
/// The largest one.
pub const STIFFEST: i32 = 8;
/// Seconds in which the object settles, and that are judged.
const SETTLING: f64 = 0.4;
const JUDGED: f64 = 1.0;

/// Coefficient of friction with which objects are held, at least.
const ROUGH: f64 = 0.8;
/// Force with which the hand presses, through the coupling, N.
const PRESS: f64 = 0.5;

/// Where a hand presses a probe, of its mesh's frame, against what pushes it hardest on a path: further in than the object then
/// was, as far as the coupling of `trace` gives way to half a newton.
pub fn pressed(trace: &Trace, path: &BodyPath, profile: &Profile, probe: &Object) -> Pose {
    let force = |index: &usize| profile.wrenches[*index].force;
    let hardest = (0..path.states.len()).max_by(|x, y| force(x).length().total_cmp(&force(y).length()));
    let Some(index) = hardest else { return Pose::IDENTITY };
    let body = path.states[index].pose;
    let further = -force(&index).normalize_or_zero() * (PRESS / trace.coupling_stiffness);
    let center = Pose::from_translation(-probe.clod.source.center_of_mass);
    Pose { translation: body.translation + further, ..body } * center
}

/// The largest power of two by which the contact stiffness of `settings` can be multiplied so that the object comes to rest when
/// an emulated hand holds it where it touches, by friction so that it does not slide off; 0 if it does with none that is [tried](WEAKEST). Contact damping that the settings
/// leave open stays critical.
///
/// By bisection: where stability comes and goes with stiffness, one of the limits is found. At rest is what moves by no more
/// than two encoder steps of the device.
///
/// `held` is where the hand means the probe's mesh frame to be, and `contact_rate` how many contact queries there are a second
/// (Hz), each taking its whole period.
///
/// # Errors
/// If a setting is refused.
pub fn stability_margin(
    probe: &Object,
    scene: &Scene,
    (settings, integrator): (&Settings, IntegratorKind),
    held: Pose,
    contact_rate: f64,
) -> Result<f64, MeasureError> {
    let stable = |exponent: i32| -> Result<bool, MeasureError> {
        let contact_stiffness = (settings.contact.stiffness * 2.0_f64.powi(exponent)).min(1e8);
        let settings = Settings {
            contact: ContactSettings {
                stiffness: contact_stiffness,
                friction: settings.contact.friction.max(ROUGH),
                ..settings.contact
            },
            ..*settings
        };
        comes_to_rest(probe, scene, (settings, integrator), held, contact_rate)
    };
    // That is where most end.
    if stable(STIFFEST)? {
        return Ok(2.0_f64.powi(STIFFEST));
    }
    let (mut good, mut bad) = (WEAKEST - 1, STIFFEST);
    while bad - good > 1 {
        let middle = (good + bad).div_euclid(2);
        if stable(middle)? {
            good = middle;
        } else {
            bad = middle;
        }
    }
    Ok(if good < WEAKEST { 0.0 } else { 2.0_f64.powi(good) })
}

/// Whether an object that a hand holds in contact is at rest after a while, or will be.
fn comes_to_rest(
    probe: &Object,
    scene: &Scene,
    (settings, integrator): (Settings, IntegratorKind),
    held: Pose,
    contact_rate: f64,
) -> Result<bool, MeasureError> {
    let seconds = SETTLING + JUDGED;
    let experiment = Experiment { probe, scene, settings, integrator, contact_rate, frozen: false, seconds };
    let trace = experiment.emulate(held)?;
    let judged = (JUDGED * settings.timing.rate) as usize;
    if !trace.is_stable() || trace.samples.len() < judged {
        return Ok(false);
    }
    let radius = probe.bounding_radius();
    let coordinates: Vec<[f64; 6]> = trace.samples[trace.samples.len() - judged..]
        .iter()
        .map(|sample| {
            let moved = sample.record.object.translation - held.translation;
            let turned = held.rotation_vector_to(&sample.record.object) * radius;
            [moved.x, moved.y, moved.z, turned.x, turned.y, turned.z]
        })
        .collect();
    let (outcome, _) = judge(&coordinates, trace.floor);
    Ok(outcome.is_stable())
}
