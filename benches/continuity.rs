//! Continuity of the wrench: windows along a scenario's path in which the motion from pose to pose is tiny.
//!
//! The length of a step bounds the motion of all points of the probe's bounding sphere:
//! |Δx| + R |Δθ|. Changes of the force are reported as |Δ**F**| / (k · step), those of the torque about the
//! sphere's centre as |Δ**τ**| / (k R · step), with the [`AreaLaw`]. For a continuous wrench these stay
//! bounded however small the steps are; for one that jumps they grow as the steps become smaller.

use palpate::core::mesh::Sphere;
use palpate::{Pose, Wrench};
use palpate_field::AreaLaw;

use crate::method::Method;
use crate::reference::LAW_REACH;
use crate::scenarios::Scenario;

/// Number of windows, spread evenly over the path, and of steps in each.
const WINDOWS: usize = 40;
const STEPS: usize = 50;
/// Number of parts into which the step with the largest change is subdivided.
const PARTS: usize = 10;

/// Change of the wrench in a step.
#[derive(Clone, Debug)]
pub struct Change {
    /// Change of the force, in units of k · step.
    pub force: f64,
    /// Change of the torque, in units of k R · step.
    pub torque: f64,
    step: Window,
}

/// Closely spaced poses of the probe.
#[derive(Clone, Debug)]
pub struct Window {
    poses: Vec<Pose>,
    /// Length of each step, m: one fewer than there are poses.
    steps: Vec<f64>,
}

impl Window {
    fn at(pose: Pose) -> Self {
        Self { poses: vec![pose], steps: Vec::with_capacity(STEPS) }
    }

    /// Appends poses up to `to`, in steps no longer than `longest` (m), while there are fewer than `most`.
    fn extend(&mut self, to: &Pose, longest: f64, most: usize, sphere: &Sphere) {
        let Some(from) = self.poses.last().copied() else { return };
        let [start, end] = [&from, to].map(|pose| pose.transform_point(sphere.center));
        let moved = start.distance(end) + sphere.radius * from.rotation_vector_to(to).length();
        let parts = (moved / longest).ceil();
        for part in (1..=parts as usize).take(most - self.steps.len()) {
            let share = part as f64 / parts;
            let rotation = from.rotation.slerp(to.rotation, share);
            let translation = start.lerp(end, share) - rotation * sphere.center;
            self.poses.push(Pose::new(translation, rotation));
            self.steps.push(moved / parts);
        }
    }

    /// Returns the number of steps.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Returns whether there are no steps.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }
}

/// Returns windows with steps no longer than `longest` (m). Where the path's own poses are closer, the steps
/// are shorter.
pub fn windows(scenario: &Scenario, longest: f64) -> Vec<Window> {
    let Scenario { probe, poses, .. } = scenario;
    let sphere = probe.mesh.bounding_sphere();
    let window = |index: usize| {
        let first = (2 * index + 1) * poses.len() / (2 * WINDOWS);
        let mut window = Window::at(poses[first]);
        for pose in &poses[first + 1..] {
            window.extend(pose, longest, STEPS, &sphere);
        }
        window
    };
    (0..WINDOWS).map(window).collect()
}

/// Returns the change of the wrench in each step in which a method finds contact.
pub fn changes(scenario: &Scenario, method: &mut dyn Method, windows: &[Window]) -> Vec<Change> {
    let sphere = scenario.probe.mesh.bounding_sphere();
    let mut law = AreaLaw::new(sphere.center, sphere.radius, LAW_REACH);
    let (mut found, mut changes) = (Vec::new(), Vec::new());
    for window in windows {
        let wrenches = window.poses.iter().map(|pose| {
            method.run(pose);
            found.clear();
            method.append_contacts(pose, &mut found);
            law.wrench(&found, scenario.tolerance, pose, pose.transform_point(sphere.center))
        });
        let wrenches: Vec<Wrench> = wrenches.collect();
        let pairs = wrenches.windows(2).zip(window.poses.windows(2)).zip(&window.steps);
        for ((wrenches, poses), step) in pairs {
            if wrenches.iter().any(|wrench| *wrench != Wrench::ZERO) {
                let [from, to] = [wrenches[0], wrenches[1]];
                changes.push(Change {
                    force: from.force.distance(to.force) / step,
                    torque: from.torque.distance(to.torque) / (sphere.radius * step),
                    step: Window { poses: poses.to_vec(), steps: vec![*step] },
                });
            }
        }
    }
    changes
}

/// Returns the largest change of the force, and that in a tenth of the same step: the same where the force is
/// steep there, ten times as large where it jumps.
pub fn largest(scenario: &Scenario, method: &mut dyn Method, changes: &[Change]) -> [f64; 2] {
    let Some(largest) = changes.iter().max_by(|a, b| a.force.total_cmp(&b.force)) else { return [0.0; 2] };
    let Window { poses, steps } = &largest.step;
    let mut finer = Window::at(poses[0]);
    // Rounding may add a step.
    finer.extend(&poses[1], steps[0] / PARTS as f64, PARTS + 1, &scenario.probe.mesh.bounding_sphere());
    let within = self::changes(scenario, method, &[finer]);
    [largest.force, within.iter().map(|change| change.force).fold(0.0, f64::max)]
}

#[cfg(test)]
mod tests {
    use palpate::glam::{DQuat, DVec3};
    use palpate::{Contact, Object};
    use palpate_field::AreaContact;

    use super::*;
    use crate::scenarios::Body;

    const D: f64 = 1e-4;
    const STEP: f64 = 1e-6;
    const JUMP: f64 = 5e-6;

    /// Method for a floor at z = 0 that the probe's frame dips into; the floor is lower by [`JUMP`] where x >
    /// 0.
    struct Floor;

    impl Method for Floor {
        fn run(&mut self, _: &Pose) {}

        fn append_contacts(&self, pose: &Pose, found: &mut Vec<AreaContact>) {
            let point = pose.translation;
            let depth = if point.x > 0.0 { -point.z - JUMP } else { -point.z };
            let contact = Contact { point, scene_point: point, normal: DVec3::NEG_Z, depth };
            found.push(AreaContact { contact, area: 1.0 });
        }

        fn bytes(&self) -> usize {
            0
        }
    }

    /// Returns a path that sinks by 10 µm from pose to pose, turns, and crosses x = 0.
    fn scenario() -> Scenario {
        let object = Object::model("ellipsoid@100").expect("a model");
        let mesh =
            palpate::open_mesh("ellipsoid@100", &palpate::OpenOptions::default()).expect("a model").mesh;
        let body = Body { object, mesh };
        let pose = |index: u32| {
            let turn = DQuat::from_scaled_axis(DVec3::new(0.3, 0.2, 1.0) * 1e-4 * f64::from(index));
            Pose::new(
                DVec3::new(1e-5 * (f64::from(index) - 196.5), 0.0, 1e-3 - 1e-5 * f64::from(index)),
                turn,
            )
        };
        Scenario {
            name: "floor".to_owned(),
            probe: body.clone(),
            scene: body,
            poses: (0..400).map(pose).collect(),
            tolerance: D,
        }
    }

    #[test]
    fn no_point_moves_by_more_than_a_step() {
        let scenario = scenario();
        let windows = windows(&scenario, STEP);
        assert_eq!(windows.len(), WINDOWS);
        for window in &windows {
            assert_eq!((window.poses.len(), window.steps.len()), (STEPS + 1, STEPS));
            for (pair, step) in window.poses.windows(2).zip(&window.steps) {
                assert!(*step <= STEP && *step > 0.8 * STEP, "{step}");
                for vertex in scenario.probe.mesh.vertices() {
                    let [from, to] = [pair[0], pair[1]].map(|pose| pose.transform_point(*vertex));
                    assert!(
                        from.distance(to) < step * (1.0 + 1e-6),
                        "{} in a step of {step}",
                        from.distance(to)
                    );
                }
            }
        }
    }

    #[test]
    fn a_jump_is_seen_and_a_slope_is_not_a_jump() {
        let scenario = scenario();
        let changes = changes(&scenario, &mut Floor, &windows(&scenario, STEP));
        assert!(
            changes.len() > 10 * STEPS && changes.len() < WINDOWS * STEPS,
            "{} in contact",
            changes.len()
        );
        let jumps = changes.iter().filter(|change| change.force > 1.0).count();
        assert_eq!(jumps, 1);
        let [jump, within] = largest(&scenario, &mut Floor, &changes);
        assert!((4.0..6.5).contains(&jump), "{jump}");
        assert!((9.0 * jump..12.5 * jump).contains(&within), "{within}");
        let steep: Vec<Change> = changes.into_iter().filter(|change| change.force < 1.0).collect();
        let [slope, within] = largest(&scenario, &mut Floor, &steep);
        assert!((within - slope).abs() < 0.01 * slope, "{within} {slope}");
    }
}
