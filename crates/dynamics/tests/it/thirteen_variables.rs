//! The six-unknown step against the dissertation's own: semi-implicit backward Euler in (x, q, P, L),
//! thirteen variables, by Eq. 5.1–5.29 and 5.37–5.46, with the quaternion derivatives of §A.2 and these slips
//! put right: the lever arms are in world axes (5.15, 5.23, 5.28, 5.29, 5.37), the damper's turning arm is in
//! 5.23, u_c is normalised (5.18, and 5.25 follows it), and contact is unilateral.
//!
//! Both are first-order methods for one system, so a step of each from one state might differ by O(h²), and a
//! given time of both by O(h). They do better: both are the one Newton iterate of backward Euler on momentum
//! and placement, and differ only by how the placement's own curvature is treated, so a step differs by O(h³)
//! and a given time by O(h²). That is what the tests hold; a first derivative missing or wrong in either
//! formulation would show as the lower order.

#![allow(clippy::print_stdout, reason = "measured differences, shown by --nocapture")]

use palpate_core::glam::{DMat3, DQuat, DVec3};
use palpate_core::{Contact, Pose, Twist};
use palpate_dynamics::{
    Body, BodyState, ContactParameters, DeviceMotion, Friction, LinearContactModel, VirtualCoupling,
    semi_implicit_step,
};

const N: usize = 13;
type Vector = [f64; N];
type Matrix = [[f64; N]; N];

/// A body under a coupling, contacts and gravity.
struct Scene {
    body: Body,
    coupling: VirtualCoupling,
    device: DeviceMotion,
    contacts: LinearContactModel,
    gravity: DVec3,
}

/// R of Eq. A.21, a homogeneous polynomial of q = (x, y, z, s), so that it may be differentiated in all four.
fn rotation(q: [f64; 4]) -> DMat3 {
    let [x, y, z, s] = q;
    rows(
        [x * x - y * y - z * z + s * s, 2.0 * (y * x - z * s), 2.0 * (z * x + y * s)],
        [2.0 * (x * y + z * s), -x * x + y * y - z * z + s * s, 2.0 * (z * y - x * s)],
        [2.0 * (x * z - y * s), 2.0 * (y * z + x * s), -x * x - y * y + z * z + s * s],
    )
}

fn rows(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> DMat3 {
    DMat3::from_cols_array_2d(&[a, b, c]).transpose()
}

/// Eq. A.23.
fn rotation_derivatives(q: [f64; 4]) -> [DMat3; 4] {
    let [x, y, z, s] = q;
    [
        rows([x, y, z], [y, -x, -s], [z, s, -x]) * 2.0,
        rows([-y, x, s], [x, y, z], [-s, z, -y]) * 2.0,
        rows([-z, -s, x], [s, -z, y], [x, y, z]) * 2.0,
        rows([s, -z, y], [z, s, -x], [-y, x, s]) * 2.0,
    ]
}

/// Q ω of Eq. A.25, which is linear in q as well.
fn quaternion_rate(q: [f64; 4], w: DVec3) -> [f64; 4] {
    let [x, y, z, s] = q;
    [
        0.5 * (s * w.x + z * w.y - y * w.z),
        0.5 * (-z * w.x + s * w.y + x * w.z),
        0.5 * (y * w.x - x * w.y + s * w.z),
        0.5 * (-x * w.x - y * w.y - z * w.z),
    ]
}

fn unit4(i: usize) -> [f64; 4] {
    std::array::from_fn(|k| f64::from(u8::from(k == i)))
}

fn split(y: &Vector) -> (DVec3, [f64; 4], DVec3, DVec3) {
    let v = |i: usize| DVec3::new(y[i], y[i + 1], y[i + 2]);
    (v(0), [y[3], y[4], y[5], y[6]], v(7), v(10))
}

fn join(x: DVec3, q: [f64; 4], p: DVec3, l: DVec3) -> Vector {
    let mut y = [0.0; N];
    y[..3].copy_from_slice(&x.to_array());
    y[3..7].copy_from_slice(&q);
    y[7..10].copy_from_slice(&p.to_array());
    y[10..].copy_from_slice(&l.to_array());
    y
}

fn to_vector(body: &Body, state: &BodyState) -> Vector {
    let q = state.pose.rotation.to_array();
    join(state.pose.translation, q, state.twist.linear * body.mass, body.angular_momentum(state))
}

fn to_state(body: &Body, y: &Vector) -> BodyState {
    let (x, q, p, l) = split(y);
    let q = DQuat::from_array(q).normalize();
    let angular = q * (body.inertia.inverse() * (q.conjugate() * l));
    BodyState { pose: Pose::new(x, q), twist: Twist::new(p / body.mass, angular) }
}

/// Δq = q_h q_c⁻¹ q⁻¹ (Eq. 5.19) as the matrix C of Eq. 5.20, rows of four.
fn deviation_matrix(scene: &Scene) -> [[f64; 4]; 4] {
    let a = scene.device.pose.rotation * scene.coupling.grasp.rotation.conjugate();
    // Eq. A.15, with the sign of the inverse (A.13) taken into the first three columns.
    [[-a.w, a.z, -a.y, a.x], [-a.z, -a.w, a.x, a.y], [a.y, -a.x, -a.w, a.z], [a.x, a.y, a.z, a.w]]
}

/// u_c for the shorter rotation, and its derivative by each q_i.
fn coupling_turn(scene: &Scene, q: [f64; 4]) -> (DVec3, [DVec3; 4]) {
    let c = deviation_matrix(scene);
    let mut dq: [f64; 4] = std::array::from_fn(|i| (0..4).map(|k| c[i][k] * q[k]).sum());
    let sign = if dq[3] < 0.0 { -1.0 } else { 1.0 };
    dq = dq.map(|v| v * sign);
    let (vector, scalar) = (DVec3::new(dq[0], dq[1], dq[2]), dq[3]);
    let length = vector.length();
    let axis = vector / length;
    let half = length.atan2(scalar);
    let square = length * length + scalar * scalar;
    let derivative = std::array::from_fn(|i| {
        let dv = DVec3::new(c[0][i], c[1][i], c[2][i]) * sign;
        let ds = c[3][i] * sign;
        let along = axis * axis.dot(dv);
        2.0 * (along * (scalar / square) + (dv - along) * (half / length) - axis * (ds * length / square))
    });
    (axis * (2.0 * half), derivative)
}

/// ẏ (Eq. 5.1) and ∂ẏ/∂y (Eq. 5.8).
fn motion(scene: &Scene, y: &Vector) -> (Vector, Matrix) {
    let (x, q, p, l) = split(y);
    let (body, gains) = (&scene.body, &scene.coupling);
    let r = rotation(q);
    let inverse_inertia = body.inertia.inverse();
    let spin_by_l = r * inverse_inertia * r.transpose();
    let w = spin_by_l * l;
    let v = p / body.mass;
    let (arm, turn) = (r * gains.grasp.translation, coupling_turn(scene, q));

    let coupling_force = (scene.device.pose.translation - x - arm) * gains.linear_stiffness
        + (scene.device.twist.linear - v - w.cross(arm)) * gains.linear_damping;
    let coupling_torque = arm.cross(coupling_force)
        + turn.0 * gains.angular_stiffness
        + (scene.device.twist.angular - w) * gains.angular_damping;
    let (mut force, mut torque) = (coupling_force + scene.gravity * body.mass, coupling_torque);

    // A change of (x, R, v, ω), as a column of the Jacobian makes it, and what the wrench makes of it.
    struct Change {
        x: DVec3,
        r: DMat3,
        v: DVec3,
        w: DVec3,
        turn: DVec3,
    }
    let mut changes = Vec::new();
    let still =
        || Change { x: DVec3::ZERO, r: DMat3::ZERO, v: DVec3::ZERO, w: DVec3::ZERO, turn: DVec3::ZERO };
    changes.extend(DVec3::AXES.map(|e| Change { x: e, ..still() }));
    for (dr, turn) in rotation_derivatives(q).into_iter().zip(turn.1) {
        let dw = dr * (inverse_inertia * (r.transpose() * l)) + r * (inverse_inertia * (dr.transpose() * l)); // 5.13
        changes.push(Change { r: dr, w: dw, turn, ..still() });
    }
    changes.extend(DVec3::AXES.map(|e| Change { v: e / body.mass, ..still() }));
    changes.extend(DVec3::AXES.map(|e| Change { w: spin_by_l * e, ..still() }));

    let mut columns: Vec<(DVec3, DVec3)> = changes
        .iter()
        .map(|d| {
            let darm = d.r * gains.grasp.translation;
            let df = (d.x + darm) * -gains.linear_stiffness
                - (d.v + d.w.cross(arm) + w.cross(darm)) * gains.linear_damping;
            let dt = arm.cross(df) + darm.cross(coupling_force) + d.turn * gains.angular_stiffness
                - d.w * gains.angular_damping;
            (df, dt)
        })
        .collect();

    for c in scene.contacts.contacts() {
        let arm = r * c.point;
        let overlap = c.normal.dot(x + arm - c.scene_point) + c.tolerance;
        let size = c.stiffness * overlap + c.damping * c.normal.dot(v + w.cross(arm));
        if overlap <= 0.0 || size <= 0.0 {
            continue;
        }
        let contact_force = c.normal * -size;
        force += contact_force;
        torque += arm.cross(contact_force);
        for (d, column) in changes.iter().zip(&mut columns) {
            let darm = d.r * c.point;
            let size = c.stiffness * c.normal.dot(d.x + darm)
                + c.damping * c.normal.dot(d.v + d.w.cross(arm) + w.cross(darm));
            let df = c.normal * -size;
            column.0 += df;
            column.1 += arm.cross(df) + darm.cross(contact_force);
        }
    }

    let rate = join(v, quaternion_rate(q, w), force, torque);
    let mut jacobian = [[0.0; N]; N];
    for (j, (d, (df, dt))) in changes.iter().zip(&columns).enumerate() {
        let mut dq = quaternion_rate(q, d.w);
        if (3..7).contains(&j) {
            let own = quaternion_rate(unit4(j - 3), w);
            dq = std::array::from_fn(|i| dq[i] + own[i]);
        }
        for (i, value) in join(d.v, dq, *df, *dt).into_iter().enumerate() {
            jacobian[i][j] = value;
        }
    }
    (rate, jacobian)
}

/// Plain Gauss–Jordan elimination with full row pivoting, apart from the crate's own solver.
fn gauss_jordan(mut a: Matrix, mut b: Vector) -> Vector {
    for column in 0..N {
        let pivot = (column..N).max_by(|&i, &j| a[i][column].abs().total_cmp(&a[j][column].abs())).unwrap();
        a.swap(column, pivot);
        b.swap(column, pivot);
        let scale = a[column][column];
        assert!(scale.abs() > 1e-300, "the oracle's matrix is singular");
        a[column] = a[column].map(|v| v / scale);
        b[column] /= scale;
        for row in (0..N).filter(|&row| row != column) {
            let factor = a[row][column];
            let pivot_row = a[column];
            for (entry, value) in a[row].iter_mut().zip(pivot_row) {
                *entry -= factor * value;
            }
            b[row] -= factor * b[column];
        }
    }
    b
}

/// Eq. 5.7.
fn thirteen_variable_step(scene: &Scene, state: &BodyState, h: f64) -> BodyState {
    let y = to_vector(&scene.body, state);
    let (rate, jacobian) = motion(scene, &y);
    let matrix =
        std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j)) - h * jacobian[i][j]));
    let change = gauss_jordan(matrix, rate.map(|v| v * h));
    to_state(&scene.body, &std::array::from_fn(|i| y[i] + change[i]))
}

fn six_unknown_step(scene: &Scene, state: &BodyState, h: f64) -> BodyState {
    let step = semi_implicit_step(
        &scene.body,
        state,
        &scene.device,
        &scene.coupling,
        &scene.contacts,
        scene.gravity,
        h,
    );
    assert!(step.status.is_ok() && !step.status.geometric_stiffness_dropped);
    let all = (1 << scene.contacts.contacts().len()) - 1;
    assert_eq!(step.active, all, "a contact opened");
    step.state
}

/// A body off its grasp by some millimetres and tenths of a radian, spinning, held against `contacts` planes.
fn scene(contacts: usize, turn: f64) -> (Scene, BodyState) {
    let axes = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(0.4, -0.3, 0.9)));
    let inertia = axes * DMat3::from_diagonal(DVec3::new(2e-5, 5e-5, 6e-5)) * axes.transpose();
    let body = Body::new(0.1, inertia).unwrap();
    let grasp = Pose::new(DVec3::new(0.03, -0.02, 0.05), DQuat::from_scaled_axis(DVec3::new(0.5, 0.2, -0.1)));
    let coupling = VirtualCoupling::critically_damped(&body, grasp, 200.0, 0.05);
    let pose = Pose::new(DVec3::new(0.1, 0.2, -0.1), DQuat::from_scaled_axis(DVec3::new(-0.7, 1.1, 0.3)));
    let state =
        BodyState { pose, twist: Twist::new(DVec3::new(0.05, -0.02, 0.04), DVec3::new(4.0, -3.0, 2.0)) };
    let held = pose * grasp;
    let off = DQuat::from_scaled_axis(DVec3::new(0.6, 0.7, -0.3).normalize() * turn);
    let device = DeviceMotion {
        pose: Pose::new(
            held.translation + DVec3::new(0.004, 0.003, -0.005),
            (off * held.rotation).normalize(),
        ),
        twist: Twist::new(DVec3::new(0.02, 0.01, 0.0), DVec3::new(0.5, 0.0, -0.4)),
    };
    let found = (0..contacts).map(|i| {
        let angle = i as f64 * 2.4;
        let arm = DVec3::new(0.04 * angle.cos(), 0.04 * angle.sin(), -0.03);
        Contact {
            point: pose.transform_point(arm),
            scene_point: DVec3::ZERO,
            normal: pose.transform_vector(DVec3::new(0.3 * angle.cos(), 0.3 * angle.sin(), -1.0).normalize()),
            depth: 0.03,
        }
    });
    // Deep enough that nothing opens or closes: the clamp has a kink, where no order is to be seen.
    let parameters =
        ContactParameters { stiffness: 25.0, damping: 0.1, tolerance: 0.02, friction: Friction::NONE };
    let contacts = LinearContactModel::from_contacts(found, &pose, &parameters, 0.0);
    (Scene { body, coupling, device, contacts, gravity: DVec3::NEG_Z * 9.81 }, state)
}

/// The largest difference of two states, each part over its natural size (5 mm, 0.1 rad, 0.1 m/s, 5 rad/s).
fn difference(a: &BodyState, b: &BodyState) -> f64 {
    [
        (a.pose.translation - b.pose.translation).length() / 0.005,
        a.pose.rotation_vector_to(&b.pose).length() / 0.1,
        (a.twist.linear - b.twist.linear).length() / 0.1,
        (a.twist.angular - b.twist.angular).length() / 5.0,
    ]
    .into_iter()
    .fold(0.0, f64::max)
}

#[test]
fn the_oracles_own_jacobian_equals_central_differences() {
    for (contacts, turn) in [(0, 0.3), (3, 0.3), (3, 2.5), (5, 3.0)] {
        let (scene, state) = scene(contacts, turn);
        let y = to_vector(&scene.body, &state);
        let (_, jacobian) = motion(&scene, &y);
        for j in 0..N {
            let at = |s: f64| {
                let mut moved = y;
                moved[j] += s;
                motion(&scene, &moved).0
            };
            // Angular momenta of this body are of the order of 1e-4.
            let h = if j < 10 { 1e-4 } else { 1e-6 };
            let (a, b, c, d) = (at(h), at(-h), at(2.0 * h), at(-2.0 * h));
            let column: Vector = std::array::from_fn(|i| (8.0 * (a[i] - b[i]) - (c[i] - d[i])) / (12.0 * h));
            // Each kind of entry (rate of x, q, P, L) against the largest of its kind in the column.
            for block in [0..3, 3..7, 7..10, 10..13] {
                let size = block.clone().fold(0.0, |m: f64, i| m.max(column[i].abs()));
                for i in block {
                    let error = (jacobian[i][j] - column[i]).abs();
                    assert!(error <= 1e-6 * size, "entry ({i}, {j}): {} not {}", jacobian[i][j], column[i]);
                }
            }
        }
    }
}

#[test]
fn one_step_of_each_differs_by_the_cube_of_the_time_step() {
    // Turned less than 150°, from where the crate's angular spring fades: the dissertation's does not.
    for (contacts, turn) in [(0, 0.3), (3, 0.3), (3, 1.5), (5, 2.5)] {
        let (scene, state) = scene(contacts, turn);
        let at = |h: f64| {
            difference(&six_unknown_step(&scene, &state, h), &thirteen_variable_step(&scene, &state, h))
        };
        let steps = [4e-4, 2e-4, 1e-4, 5e-5];
        let found = steps.map(at);
        println!("{contacts} contacts, u_c {turn} rad: differences {found:?}");
        for pair in found.windows(2) {
            let order = (pair[0] / pair[1]).log2();
            assert!(
                order > 1.8,
                "{contacts} contacts, u_c {turn} rad: one-step difference has order {order}"
            );
        }
        let last = (found[2] / found[3]).log2();
        assert!(last > 2.7, "{contacts} contacts, u_c {turn} rad: the order tends to {last}");
        // Not the same up to rounding either, or the test would compare a method with itself.
        assert!(found[0] > 1e-9);
    }
}

#[test]
fn a_given_time_of_each_differs_by_the_square_of_the_time_step() {
    for (contacts, turn) in [(0, 0.3), (3, 0.3), (3, 1.5)] {
        let (scene, start) = scene(contacts, turn);
        let at = |steps: u32| {
            let h = 0.04 / f64::from(steps);
            let (mut six, mut thirteen) = (start, start);
            for _ in 0..steps {
                six = six_unknown_step(&scene, &six, h);
                thirteen = thirteen_variable_step(&scene, &thirteen, h);
            }
            difference(&six, &thirteen)
        };
        let found = [40, 80, 160, 320, 640].map(at);
        println!("{contacts} contacts, u_c {turn} rad: differences after 40 ms {found:?}");
        for pair in found[1..].windows(2) {
            let ratio = pair[0] / pair[1];
            assert!(ratio > 2.5, "{contacts} contacts, u_c {turn} rad: halving h divides by {ratio}");
        }
        let last = found[3] / found[4];
        assert!(last > 3.5, "{contacts} contacts, u_c {turn} rad: halving h divides by {last} at the end");
    }
}
