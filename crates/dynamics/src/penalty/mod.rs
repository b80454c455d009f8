//! Penalty contacts: springs that push the body back from planes, in the form that the contact thread hands
//! to the haptic thread (§5.2.4, §5.4.3).
//!
//! Each contact is the plane through p₀ with normal n, fixed in the world, against the point r of the body.
//! With a = R r, δ = n · (x + a − p₀) and δ̇ = n · (v + ω × a), the contact pushes the body along −n with
//!
//! λ = k (δ + d) + b δ̇ while both δ + d > 0 and λ > 0, else 0;  F_p = −λ n,  T_p = a × F_p.
//!
//! Departures from Eq. 5.37–5.38: the lever arm of the damper is in world axes, and contact is unilateral: no
//! force while δ + d ≤ 0, and the damper never makes it attract. The model keeps the contacts, not their
//! Taylor expansion (Eq. 5.14), so force, clamp and derivatives are those of the body's present placement
//! however far it has moved.
//!
//! A contact may also brake before it is closed: with a time τ, and δ + d < 0,
//!
//! λ = b (δ̇ + (δ + d) / τ) while that is positive,
//!
//! so that the remaining gap takes at least about τ to close. The law is continuous with the one above where
//! the gap closes, and only takes energy. A fast body is slowed before it feels the force of the closed
//! contact, and does not pass a thin wall before the next contacts are found (§5.6.1).
//!
//! The scene may move: each contact has the [motion of its surface](SurfaceMotion). Dampers and friction act
//! on velocities relative to it, and a step uses the planes and the friction anchors at its end
//! ([`LinearContactModel::advance`]).
//!
//! With friction, the point is also held along the plane, by a spring and damper of the same gains that yield
//! at the Coulomb limit ([`coulomb`]).
//!
//! A contact between detailed surfaces is more than a plane: [`CurvedContact`], whose [curvature
//! terms](curvature) turn the plane as the body moves on.
//!
//! The stiffness that the body feels is at most k times the number of contacts, which is at most
//! [`MAX_CLUSTERS`]: this is the purpose of the clustering of §5.4.2. While one model [blends
//! into](ContactBlend) the next, the two share the stiffness.
//!
//! Each file uses only those before it: [`coulomb`], [`contact`], [`friction`], [`curvature`], [`model`], and
//! on top [`evaluate`], [`friction_transfer`] and [`blend`].

mod blend;
mod contact;
mod coulomb;
mod curvature;
mod evaluate;
mod friction;
mod friction_transfer;
mod model;
#[cfg(test)]
mod tests;

pub use blend::ContactBlend;
pub(crate) use contact::ContactState;
pub use contact::{ContactParameters, ContactPatch, MovingBody, PenaltyContact, SurfaceMotion};
pub(crate) use coulomb::Strain;
pub use coulomb::{Friction, FrictionAnchor};
pub use curvature::CurvedContact;
pub use evaluate::ContactResponse;
pub(crate) use friction::FrictionForce;
pub use model::{
    ContactClass, FoundContact, LinearContactModel, MAX_APPROACHING, MAX_CLUSTERS, MAX_PENALTY_CONTACTS,
};
