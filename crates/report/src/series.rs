//! Curves of a report, from a recording.

use palpate::Record;
use palpate::glam::DVec3;

use crate::plot::{Curve, Figure};

/// Width of the windows in which rates are counted, s.
const RATE_WINDOW: f64 = 0.1;
/// Maximum number of points of a curve; a screen shows no more.
const MAX_POINTS: usize = 1600;

/// Returns a plot per quantity, so that no curve hides another; `grasp` is the point at which the hand holds
/// the object, in the mesh's frame, m.
pub(crate) fn figures(records: &[Record], grasp: DVec3) -> Vec<Figure> {
    let curve = |name: &str, value: &dyn Fn(&Record) -> f64| Curve {
        name: name.to_owned(),
        points: thin(records.iter().map(|record| (record.time, value(record))).collect()),
    };
    let figure = |caption: &str, axis: &str, curve: Curve| Figure {
        caption: caption.to_owned(),
        across: "s".to_owned(),
        axis: axis.to_owned(),
        curves: vec![curve],
    };
    let end = records.last().map_or(0.0, |record| record.time);
    let haptic = rate(records.iter().map(|record| record.time), end);
    let contact = rate(model_times(records), end);
    vec![
        figure(
            "Deepest penetration that the contact query reported.",
            "mm",
            curve("penetration", &|r| 1e3 * r.depth),
        ),
        figure("Force sent to the device.", "N", curve("coupling", &|r| r.coupling.force.length())),
        figure("Contact force on the grasped object.", "N", curve("contact", &|r| r.contact.force.length())),
        figure(
            "Torque sent to the device, about its origin.",
            "mN·m",
            curve("torque", &|r| 1e3 * r.coupling.torque.length()),
        ),
        figure(
            "Stretch of the coupling: distance of the object from where the device holds it, at the grasp.",
            "mm",
            curve("distance", &|r| 1e3 * r.stretch(grasp)),
        ),
        figure(
            "Contacts found, before clustering.",
            "contacts",
            curve("contacts", &|r| f64::from(r.contacts)),
        ),
        figure(
            "Haptic steps per second, in windows of 0.1 s.",
            "Hz",
            Curve { name: "haptic".to_owned(), points: haptic },
        ),
        figure(
            "Contact models per second, in windows of 0.1 s.",
            "Hz",
            Curve { name: "contact".to_owned(), points: contact },
        ),
    ]
}

/// Iterates over the times at which contact models were first used, s.
fn model_times(records: &[Record]) -> impl Iterator<Item = f64> + '_ {
    let mut last = f64::NAN;
    records.iter().filter_map(move |record| {
        let made = record.time - record.model_age;
        // A step later the same model gives the same time, except for rounding.
        let same = (made - last).abs() < 1e-9;
        let fresh = made.is_finite() && !same;
        last = if made.is_finite() { made } else { last };
        fresh.then_some(record.time)
    })
}

/// Returns the rate of events in windows of [`RATE_WINDOW`] up to time `end` (s), at the centre of each. An
/// incomplete window at the end is left out. A window includes its end, at which the step that completes it
/// is.
fn rate(times: impl Iterator<Item = f64>, end: f64) -> Vec<(f64, f64)> {
    // Times are multiples of periods; the tolerance absorbs their rounding.
    const TOLERANCE: f64 = 1e-6;
    let complete = (end / RATE_WINDOW + TOLERANCE).max(0.0) as usize;
    let mut counts = vec![0u32; complete];
    for time in times {
        let window = ((time / RATE_WINDOW - TOLERANCE).ceil() - 1.0).max(0.0) as usize;
        if let Some(count) = counts.get_mut(window) {
            *count += 1;
        }
    }
    let point = |(window, count): (usize, &u32)| {
        ((window as f64 + 0.5) * RATE_WINDOW, f64::from(*count) / RATE_WINDOW)
    };
    counts.iter().enumerate().map(point).collect()
}

/// Thins a curve. The smallest and largest value of each run of points are kept, so that no peak is lost.
fn thin(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    if points.len() <= MAX_POINTS {
        return points;
    }
    let run = points.len().div_ceil(MAX_POINTS / 2);
    let by_value = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
    points
        .chunks(run)
        .flat_map(|chunk| {
            let extremes = [chunk.iter().min_by(by_value), chunk.iter().max_by(by_value)];
            let mut kept: Vec<(f64, f64)> = extremes.into_iter().flatten().copied().collect();
            kept.sort_by(|a, b| a.0.total_cmp(&b.0));
            kept
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_peaks_and_order() {
        let mut points: Vec<(f64, f64)> = (0..100_000).map(|i| (f64::from(i), 0.0)).collect();
        points[54_321].1 = 7.0;
        points[99_999].1 = -3.0;
        let kept = thin(points);
        assert!(kept.len() <= MAX_POINTS + 2, "{}", kept.len());
        assert!(kept.contains(&(54_321.0, 7.0)) && kept.contains(&(99_999.0, -3.0)));
        assert!(kept.is_sorted_by(|a, b| a.0 <= b.0));
    }

    /// If the object is held far from the mesh's origin and rotated slightly about the grasp, its distance is
    /// much smaller than that of its origin.
    #[test]
    fn distance_is_measured_at_the_grasp() {
        use palpate::Pose;
        use palpate::glam::DQuat;
        let grasp = DVec3::new(0.2, 0.0, 0.0);
        let turn = DQuat::from_rotation_z(0.02);
        let behind = DVec3::new(0.0, 0.0, 4e-4);
        let object = Pose::new(grasp + behind - turn * grasp, turn);
        let wrench = palpate::Wrench::ZERO;
        let record = palpate::Record {
            time: 0.0,
            device: Pose::IDENTITY,
            handle: Pose::IDENTITY,
            object,
            coupling: wrench,
            contact: wrench,
            depth: 0.0,
            contacts: 0,
            model_age: f64::NAN,
        };
        let shown = |grasp: DVec3| {
            let figures = figures(&[record], grasp);
            let wanted = figures.iter().find(|figure| figure.caption.starts_with("Stretch")).unwrap();
            wanted.curves[0].points[0].1
        };
        assert!((shown(grasp) - 0.4).abs() < 1e-9, "{} mm", shown(grasp));
        assert!(shown(DVec3::ZERO) > 4.0, "the origin is further: {} mm", shown(DVec3::ZERO));
    }

    #[test]
    fn rate_counts_events_per_second() {
        // Slightly more than a second, at a rate whose multiples round both up and down.
        let rates = rate((1..=1040).map(|i| f64::from(i) * 1e-3), 1.04);
        assert_eq!(rates.len(), 10, "the incomplete window is left out");
        assert!(rates.iter().all(|&(_, hz)| (hz - 1000.0).abs() < 1e-9), "{rates:?}");
        assert!((rates[0].0 - 0.05).abs() < 1e-12);
        assert_eq!(rate([f64::NAN].into_iter(), f64::NAN), []);
    }

    #[test]
    fn contact_model_counts_once() {
        let pose = palpate::Pose::IDENTITY;
        let wrench = palpate::Wrench::ZERO;
        // Models of the times 0, 0.003, 0.006 …, each used for three steps, from 2 ms later; no model at
        // first.
        let record = |step: i32| palpate::Record {
            time: f64::from(step) * 1e-3,
            device: pose,
            handle: pose,
            object: pose,
            coupling: wrench,
            contact: wrench,
            depth: 0.0,
            contacts: 0,
            model_age: if step < 2 { f64::NAN } else { f64::from(2 + (step - 2) % 3) * 1e-3 },
        };
        let records: Vec<Record> = (1..=32).map(record).collect();
        let times: Vec<f64> = model_times(&records).map(|time| (time * 1e3).round()).collect();
        assert_eq!(times, [2.0, 5.0, 8.0, 11.0, 14.0, 17.0, 20.0, 23.0, 26.0, 29.0, 32.0]);
    }
}
