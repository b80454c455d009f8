//! The contacts that a model keeps when there are more than it has room for; the others are counted.

use std::num::NonZeroU32;

use glam::DVec3;
use palpate_core::{Contact, Pose, Twist};

use crate::body::BodyState;
use crate::penalty::{
    ContactClass, ContactParameters, CurvedContact, FoundContact, Friction, LinearContactModel,
    MAX_APPROACHING, MAX_CLUSTERS, MovingBody,
};

const GAINS: ContactParameters =
    ContactParameters { stiffness: 1.0, damping: 0.0, tolerance: 0.0, friction: Friction::NONE };

const APPROACHING: ContactClass = ContactClass::Approaching { braking_time: 0.01 };

/// A moving object that receives reactions.
const MOVING: MovingBody =
    MovingBody { twist: Twist { linear: DVec3::X, angular: DVec3::ZERO }, object: NonZeroU32::new(1) };

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Still,
    Moving,
    Curved,
}

const KINDS: [Kind; 3] = [Kind::Still, Kind::Moving, Kind::Curved];

/// A contact of detailed surfaces with a linear and two quadratic terms.
fn curved(depth: f64) -> CurvedContact {
    let mut second = [[0.0; 6]; 6];
    (second[0][0], second[1][1]) = (2.0, 3.0);
    CurvedContact { point: DVec3::ZERO, depth, linear: DVec3::Z, angular: DVec3::Z * 0.1, second, lever: 1.0 }
}

fn push(model: &mut LinearContactModel, kind: Kind, class: ContactClass, depth: f64) {
    let contact = Contact { point: DVec3::ZERO, scene_point: DVec3::ZERO, normal: DVec3::Z, depth };
    match kind {
        Kind::Still => model.push(class, contact, &GAINS, &MovingBody::STILL),
        Kind::Moving => model.push(class, contact, &GAINS, &MOVING),
        Kind::Curved => {
            let contact = curved(depth);
            let found = FoundContact::Curved(&contact, &Pose::IDENTITY);
            model.push(class, found, &GAINS, &MovingBody::STILL);
        }
    }
}

/// Depths of the contacts of a class, in their order in the model.
fn depths(model: &LinearContactModel, class: ContactClass) -> Vec<f64> {
    let brakes = class != ContactClass::Touching;
    model.contacts().iter().filter(|c| c.brakes() == brakes).map(|c| -c.scene_point.z).collect()
}

fn sorted(mut depths: Vec<f64>) -> Vec<f64> {
    depths.sort_by(f64::total_cmp);
    depths
}

/// Depths from 0 to n − 1, out of order.
fn shuffled(n: usize) -> impl Iterator<Item = f64> {
    assert!(!n.is_multiple_of(7), "7 and {n} are to be coprime");
    (0..n).map(move |i| ((i * 7) % n) as f64)
}

#[test]
fn each_class_keeps_its_deepest_and_counts_the_others() {
    for kind in KINDS {
        for (class, budget) in [(ContactClass::Touching, MAX_CLUSTERS), (APPROACHING, MAX_APPROACHING)] {
            let mut model = LinearContactModel::empty(&Pose::IDENTITY, 3.0);
            shuffled(25).for_each(|depth| push(&mut model, kind, class, depth));
            let deepest: Vec<_> = (25 - budget..25).map(|depth| depth as f64).collect();
            assert_eq!(sorted(depths(&model, class)), deepest, "{kind:?}, {class:?}");
            assert_eq!((model.overflow(), model.refused()), (25 - budget as u32, 0), "{kind:?}, {class:?}");
            assert_eq!(model.total_stiffness(), budget as f64);
            assert_eq!(model.age(3.25), 0.25);
        }
    }
}

#[test]
fn a_full_class_takes_no_room_from_the_other() {
    let mut model = LinearContactModel::empty(&Pose::IDENTITY, 0.0);
    for depth in shuffled(25) {
        push(&mut model, KINDS[depth as usize % 3], APPROACHING, -1.0 - depth);
        push(&mut model, KINDS[depth as usize % 3], ContactClass::Touching, depth);
    }
    assert_eq!(sorted(depths(&model, APPROACHING)), [-4.0, -3.0, -2.0, -1.0]);
    assert_eq!(depths(&model, ContactClass::Touching).len(), MAX_CLUSTERS);
    assert_eq!(model.overflow() as usize, 50 - MAX_CLUSTERS - MAX_APPROACHING);
}

#[test]
fn the_shallowest_is_replaced_whatever_its_kind() {
    for old in KINDS {
        for new in KINDS {
            let mut model = LinearContactModel::empty(&Pose::IDENTITY, 0.0);
            (1..=4).for_each(|depth| push(&mut model, old, APPROACHING, f64::from(depth)));
            // A new contact as deep as the shallowest, or less deep, is dropped.
            push(&mut model, new, APPROACHING, 1.0);
            push(&mut model, new, APPROACHING, 0.5);
            assert_eq!(depths(&model, APPROACHING), [1.0, 2.0, 3.0, 4.0], "{old:?}, {new:?}");
            // Deeper ones replace the shallowest, one after another.
            push(&mut model, new, APPROACHING, 2.5);
            push(&mut model, new, APPROACHING, 5.0);
            assert_eq!(depths(&model, APPROACHING), [2.5, 5.0, 3.0, 4.0], "{old:?}, {new:?}");
            push(&mut model, new, APPROACHING, 6.0);
            assert_eq!(depths(&model, APPROACHING), [6.0, 5.0, 3.0, 4.0], "{old:?}, {new:?}");
            assert_eq!(model.overflow(), 5);
            assert_eq!(model.reacts(), old == Kind::Moving || new == Kind::Moving);
        }
    }
}

#[test]
fn constraints_pushed_as_they_are_keep_to_the_same_budgets() {
    let mut all = LinearContactModel::empty(&Pose::IDENTITY, 0.0);
    for depth in shuffled(25) {
        let mut one = LinearContactModel::empty(&Pose::IDENTITY, 0.0);
        push(&mut one, Kind::Still, ContactClass::Touching, depth);
        all.push_contact(one.contacts()[0]);
    }
    assert_eq!(sorted(depths(&all, ContactClass::Touching)), (9..25).map(f64::from).collect::<Vec<_>>());
    assert_eq!(all.overflow(), 9);
}

/// Contacts that were replaced leave nothing behind: the model is that of the others alone.
#[test]
fn a_replaced_contact_removes_its_curvature_terms() {
    let mut model = LinearContactModel::empty(&Pose::IDENTITY, 0.0);
    for (i, depth) in shuffled(40).enumerate() {
        push(&mut model, KINDS[i % 3], ContactClass::Touching, 1.0 + 0.01 * depth);
    }
    let kind = |c: &crate::penalty::PenaltyContact, terms: usize| match (terms, c.surface.object) {
        (0, None) => Kind::Still,
        (0, Some(_)) => Kind::Moving,
        _ => Kind::Curved,
    };
    let mut expected = LinearContactModel::empty(&Pose::IDENTITY, 0.0);
    for (i, c) in model.contacts().iter().enumerate() {
        let terms = model.terms_of(i).count();
        assert!(terms == 0 || terms == 3, "{terms} terms");
        push(&mut expected, kind(c, terms), ContactClass::Touching, -c.scene_point.z);
    }
    let all = model.curvature_terms();
    assert!(all.len() > 6 && all.iter().all(|term| term.contact < MAX_CLUSTERS), "{} terms", all.len());
    assert_eq!(all.len(), expected.curvature_terms().len());
    let state = BodyState::at_rest(Pose::from_translation(DVec3::new(0.02, -0.03, 0.01)));
    let off = model.wrench(&state) - expected.wrench(&state);
    assert!(off.force.length() < 1e-12 && off.torque.length() < 1e-12, "{off:?}");
}
