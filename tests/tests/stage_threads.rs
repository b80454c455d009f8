//! Stages that a scene does not need are not started: a session has its two loops' threads and no other, and
//! looks for no GPU.
//!
//! A program of its own with one test, since other tests' threads would be counted.

use std::convert::Infallible;
use std::io::Write as _;
use std::sync::atomic::AtomicBool;

use palpate::settings::{TextureBackend, TextureSettings};
use palpate::texture_pd::WgpuBackend;
use palpate::{HapticRenderer, Pose, Scene, Settings, explore};
use palpate_tests::model;

/// Returns the number of threads of this process.
fn threads() -> usize {
    std::fs::read_dir("/proc/self/task").expect("the threads").count()
}

/// Returns whether the Vulkan loader, through which a GPU is found, is in memory.
fn vulkan_is_loaded() -> bool {
    std::fs::read_to_string("/proc/self/maps").expect("what is in memory").contains("libvulkan")
}

#[test]
fn a_session_without_textures_has_two_threads_and_no_gpu() {
    if !cfg!(target_os = "linux") {
        return;
    }
    let probe = model("ellipsoid@500");
    let scene = Scene::new().with(model("golf-ball@2000"), Pose::IDENTITY);
    let device = explore::open_device("emulated", &probe, &scene).expect("emulated device");
    // A GPU is requested, in case there are textures.
    let textures = TextureSettings { backend: TextureBackend::Auto, ..TextureSettings::default() };
    let before = threads();
    let settings = Settings { textures, ..Settings::default() };
    let renderer = HapticRenderer::new(probe, scene, device, settings).expect("renderer");
    let mut counts = std::collections::BTreeSet::new();
    let mut loaded = false;
    let Ok(_) = renderer.run_realtime(0.3, &AtomicBool::new(false), |_| {
        counts.insert(threads());
        loaded |= vulkan_is_loaded();
        Ok::<(), Infallible>(())
    });
    // While the session ends, a loop that has ended is no longer counted.
    assert_eq!(counts.last(), Some(&(before + 2)), "{counts:?}, {before} before");
    assert!(!loaded && !vulkan_is_loaded(), "a GPU was looked for");

    // Shows that a GPU backend would have been noticed.
    match WgpuBackend::new() {
        Ok(_gpu) => {
            assert!(vulkan_is_loaded() && threads() > before, "{} threads, {before} before", threads())
        }
        // Written to the stream directly, since the test runner captures the print macros.
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "skipped: no GPU backend: {error}");
        }
    }
}
