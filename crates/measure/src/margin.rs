//! Stability margin: how much stiffer contacts could be before a held object no longer comes to rest.

use palpate::dynamics::IntegratorKind;
use palpate::settings::ContactSettings;
use palpate::{Object, Pose, Scene, Settings};

use crate::error::MeasureError;
use crate::experiment::{Experiment, Trace};
use crate::judge::judge;
use crate::profile::{BodyPath, Profile};

/// Exponent of the smallest factor on the contact stiffness that is tried; factors are powers of two.
pub const MIN_EXPONENT: i32 = -6;
/// Exponent of the largest factor that is tried.
pub const MAX_EXPONENT: i32 = 8;
/// Time in which the object settles, s.
const SETTLING_TIME: f64 = 0.4;
/// Time after that from which the motion is judged, s.
const JUDGED_TIME: f64 = 1.0;

/// Smallest coefficient of friction with which objects are held. With less they may slide off.
const MIN_FRICTION: f64 = 0.8;
/// Force with which the hand presses through the coupling, N.
const PRESSING_FORCE: f64 = 0.5;

/// Returns the pose of the probe's mesh frame for a hand that presses it into the largest contact force on a
/// path. It is deeper than the object was by the displacement at which the coupling of `trace` exerts half a
/// newton.
pub fn pressed(trace: &Trace, path: &BodyPath, profile: &Profile, probe: &Object) -> Pose {
    let force = |index: &usize| profile.wrenches[*index].force;
    let hardest = (0..path.states.len()).max_by(|x, y| force(x).length().total_cmp(&force(y).length()));
    let Some(index) = hardest else { return Pose::IDENTITY };
    let body = path.states[index].pose;
    let further = -force(&index).normalize_or_zero() * (PRESSING_FORCE / trace.coupling_stiffness);
    let center = Pose::from_translation(-probe.clod.source.center_of_mass);
    Pose { translation: body.translation + further, ..body } * center
}

/// Returns the largest power of two by which the contact stiffness of `settings` can be multiplied so that an
/// object that an emulated hand holds in contact still comes to rest. Friction keeps it from sliding off. 0
/// if it does not come to rest with any factor that is [tried](MIN_EXPONENT). Contact damping that the
/// settings leave open stays critical.
///
/// The factor is found by bisection. If stability is not monotonic in the stiffness, one of the limits is
/// found. An object is at rest if it moves by at most two encoder steps of the device.
///
/// `held` is the pose of the probe's mesh frame that the hand intends, and `contact_rate` the rate of contact
/// queries (Hz), each of which takes its whole period.
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
                friction: settings.contact.friction.max(MIN_FRICTION),
                ..settings.contact
            },
            ..*settings
        };
        comes_to_rest(probe, scene, (settings, integrator), held, contact_rate)
    };
    // Most objects are stable up to the largest factor, so it is tried first.
    if stable(MAX_EXPONENT)? {
        return Ok(2.0_f64.powi(MAX_EXPONENT));
    }
    let (mut good, mut bad) = (MIN_EXPONENT - 1, MAX_EXPONENT);
    while bad - good > 1 {
        let middle = (good + bad).div_euclid(2);
        if stable(middle)? {
            good = middle;
        } else {
            bad = middle;
        }
    }
    Ok(if good < MIN_EXPONENT { 0.0 } else { 2.0_f64.powi(good) })
}

/// Returns whether an object that a hand holds in contact comes to rest.
fn comes_to_rest(
    probe: &Object,
    scene: &Scene,
    (settings, integrator): (Settings, IntegratorKind),
    held: Pose,
    contact_rate: f64,
) -> Result<bool, MeasureError> {
    let seconds = SETTLING_TIME + JUDGED_TIME;
    let experiment = Experiment { probe, scene, settings, integrator, contact_rate, frozen: false, seconds };
    let trace = experiment.emulate(held)?;
    let judged = (JUDGED_TIME * settings.timing.rate) as usize;
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
