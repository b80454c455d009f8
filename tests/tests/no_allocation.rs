//! The real-time path does not allocate: 100,000 haptic steps, and contact steps in steady state.

use allocation_counter::measure;
use palpate::{HapticRenderer, Pose, Scene, Settings, explore};
use palpate_tests::model;

/// Fewer than there are contacts at times.
const CLUSTERS: usize = 2;

/// How often `work` allocates.
fn allocations_in(work: impl FnOnce()) -> u64 {
    measure(work).count_total
}

#[test]
fn the_loops_do_not_allocate() {
    assert!(allocations_in(|| drop(std::hint::black_box(vec![1u8]))) > 0, "the counter counts");

    let probe = model("spoon@5000");
    let cup = model("cup@5000");
    let scene = Scene::new().with(cup, Pose::IDENTITY);
    let device = explore::open_device("emulated", &probe, &scene).expect("emulated device");
    let settings = Settings { clusters: CLUSTERS, ..Settings::default() };
    let renderer = HapticRenderer::new(probe, scene, device, settings).expect("renderer");
    let (mut haptic, mut contact, mut device) = renderer.into_loops();

    let (mut in_haptic, mut in_contact, mut touched) = (0, 0, false);
    for step in 1..=100_000 {
        let now = f64::from(step) * 1e-3;
        if step % 4 == 0 {
            let mut update = None;
            let count = allocations_in(|| update = Some(contact.step(haptic.body_state(), now)));
            // The exploration repeats every ten seconds: the first lets the workspaces grow to the scene.
            in_contact += if now > explore::CYCLE { count } else { 0 };
            let update = update.expect("a contact step ran");
            touched |= update.contacts as usize > CLUSTERS;
            in_haptic += allocations_in(|| haptic.update_contacts(&update));
        }
        in_haptic += allocations_in(|| {
            std::hint::black_box(haptic.step_device(device.as_mut(), now, 1e-3));
        });
    }
    assert!(touched, "the spoon never touched the cup, so nothing was tested");
    assert_eq!(in_haptic, 0, "allocations in 100,000 haptic steps");
    assert_eq!(in_contact, 0, "allocations in contact steps after the first ten seconds");
}
