//! Reading and writing a device allocates nothing.

use allocation_counter::measure;
use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};
use palpate_device::{
    Emulation, HapticDevice, IntendedPath, Interpolation, Keyframe, MotionPath, ReplayDevice,
};

fn path() -> MotionPath {
    let keyframes = (0..100)
        .map(|i| {
            let a = 0.1 * f64::from(i);
            Keyframe {
                time: a,
                pose: Pose::new(DVec3::new(a.sin(), 0.0, 0.1) * 0.1, DQuat::from_rotation_y(a)),
            }
        })
        .collect();
    MotionPath::new(keyframes, Interpolation::Smooth).unwrap()
}

#[test]
fn reading_and_writing_allocate_nothing() {
    let circle = |t: f64| (Pose::from_translation(DVec3::new(t.cos(), t.sin(), 0.0) * 0.1), Twist::ZERO);
    let devices: [Box<dyn HapticDevice>; 4] = [
        Box::new(Emulation::default().open(Pose::IDENTITY).unwrap()),
        Box::new(Emulation::preset("omega").unwrap().open(path()).unwrap()),
        Box::new(Emulation::default().open(IntendedPath::function(circle)).unwrap()),
        Box::new(ReplayDevice::new("path", path())),
    ];
    for mut device in devices {
        let mut moved = 0.0;
        let counted = measure(|| {
            for i in 0..12_000 {
                // Every event too: a clock that runs back, a gap, a clipped and a refused wrench, the path's end.
                let now = match i % 1000 {
                    998 => f64::NAN,
                    999 => 0.0,
                    _ => f64::from(i) * 0.001 + f64::from(i / 5000) * 0.5,
                };
                let state = device.read(now).unwrap();
                moved += state.twist.linear.length();
                let force = if i % 777 == 0 { DVec3::NAN } else { state.pose.translation * -1e3 };
                device.write(&Wrench::new(force, DVec3::X)).unwrap();
            }
        });
        assert_eq!(counted.count_total, 0, "{} ({moved})", device.specification().name);
    }
    assert_eq!(measure(|| drop(std::hint::black_box(Box::new(1)))).count_total, 1, "the counter counts");
}
