//! `palpate view` on a virtual display, Xvfb. Skipped if that is not installed (`apt-get install xvfb`).

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use x11rb::connection::Connection as _;
use x11rb::protocol::xproto::{
    BUTTON_PRESS_EVENT, BUTTON_RELEASE_EVENT, ConnectionExt as _, ImageFormat, MOTION_NOTIFY_EVENT,
};
use x11rb::protocol::xtest::ConnectionExt as _;

/// Virtual display of 1280 × 800 pixels.
struct Display {
    server: Child,
    name: String,
}

impl Display {
    /// Starts a display; `None` if Xvfb is not installed.
    fn open() -> Option<Self> {
        let arguments = ["-displayfd", "1", "-screen", "0", "1280x800x24", "-nolisten", "tcp"];
        let server =
            Command::new("Xvfb").args(arguments).stdout(Stdio::piped()).stderr(Stdio::null()).spawn();
        let Ok(mut server) = server else {
            let _ = writeln!(std::io::stderr(), "skipped: Xvfb is not installed");
            return None;
        };
        let mut number = String::new();
        BufReader::new(server.stdout.take().expect("its output")).read_line(&mut number).expect("a number");
        Some(Self { server, name: format!(":{}", number.trim()) })
    }

    /// Starts `palpate view` on the display.
    fn view(&self, arguments: &[&str], folder: &Path) -> Child {
        view(arguments, folder).env("DISPLAY", &self.name).spawn().expect("palpate starts")
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

fn view(arguments: &[&str], folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate"));
    command
        .arg("view")
        .args(arguments)
        .current_dir(folder)
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY");
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn succeeded(output: &Output) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
}

/// The picture has both objects, patches in the colours of coarse levels, an arrow and the plots, on an empty
/// background; the recording has the session's full length.
#[test]
fn the_window_shows_a_session() {
    let Some(display) = Display::open() else { return };
    let folder = tempfile::tempdir().expect("temporary folder");
    let session =
        ["ellipsoid@500", "golf-ball@5000", "--device", "emulated:hand=firm,task=press", "--error", "2.5%"];
    let output = ["--seconds", "2", "--screenshot", "window.png", "--record", "r.csv"];
    let child = display.view(&[&session[..], &output].concat(), folder.path());
    succeeded(&child.wait_with_output().expect("it ends"));

    let picture = image::open(folder.path().join("window.png")).expect("a picture").to_rgb8();
    assert_eq!(picture.dimensions(), (1280, 800));
    let count = |alike: &dyn Fn([u8; 3]) -> bool| picture.pixels().filter(|pixel| alike(pixel.0)).count();
    let near =
        |[r, g, b]: [u8; 3], [x, y, z]: [u8; 3]| r.abs_diff(x) < 8 && g.abs_diff(y) < 8 && b.abs_diff(z) < 8;
    let [empty, plotted] = [[247, 247, 245], [20, 110, 160]].map(|color| count(&|pixel| near(pixel, color)));
    let coloured = count(&|[r, g, b]| r.max(g).max(b) - r.min(g).min(b) > 120);
    let grey = count(&|[r, g, b]| (60..200).contains(&r) && r.abs_diff(g) < 12 && g.abs_diff(b) < 14);
    assert!(empty > 200_000, "{empty} pixels are empty");
    assert!(grey > 20_000, "{grey} pixels of the ball");
    assert!(coloured > 300, "{coloured} pixels of patches and arrows");
    assert!(plotted > 40, "{plotted} pixels of the force's line");
    let rows = std::fs::read_to_string(folder.path().join("r.csv")).expect("a recording").lines().count();
    assert!((1500..=2001).contains(&rows), "{rows} rows of two seconds");
}

/// When the mouse drags down by an eighth of the picture's height, the hand moves down.
#[test]
fn the_mouse_moves_the_hand() {
    let Some(display) = Display::open() else { return };
    let folder = tempfile::tempdir().expect("temporary folder");
    let session = ["ellipsoid@500", "golf-ball@1000", "--seconds", "120", "--record", "r.csv"];
    let child = display.view(&session, folder.path());

    let (pointer, screen) = x11rb::connect(Some(&display.name)).expect("the display answers");
    let root = pointer.setup().roots[screen].root;
    let send = |kind, button, x, y| {
        pointer.xtest_fake_input(kind, button, 0, root, x, y, 0).expect("sent").check().expect("taken");
        sleep(Duration::from_millis(50));
    };
    // An empty screen is black, and a drawn window is not. Slow machines take seconds to draw it.
    let started = Instant::now();
    let is_drawn = || {
        let pixel = pointer.get_image(ImageFormat::Z_PIXMAP, root, 400, 300, 1, 1, !0).expect("sent");
        pixel.reply().is_ok_and(|pixel| pixel.data.iter().take(3).any(|value| *value != 0))
    };
    while !is_drawn() {
        assert!(started.elapsed() < Duration::from_secs(60), "no window is drawn");
        sleep(Duration::from_millis(100));
    }
    // Busy machines take a second for a picture; what is pressed and released within one is no drag.
    let some_pictures = || sleep(Duration::from_secs(3));
    send(MOTION_NOTIFY_EVENT, 0, 400, 300);
    some_pictures();
    send(BUTTON_PRESS_EVENT, 1, 0, 0);
    some_pictures();
    for step in 1..=10 {
        send(MOTION_NOTIFY_EVENT, 0, 400, 300 + 10 * step);
    }
    some_pictures();
    send(BUTTON_RELEASE_EVENT, 1, 0, 0);
    sleep(Duration::from_secs(5));
    let ended = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    assert!(ended.is_ok_and(|status| status.success()), "the session is interrupted");
    succeeded(&child.wait_with_output().expect("it ends"));

    let mut rows = csv::Reader::from_path(folder.path().join("r.csv")).expect("a recording");
    let column =
        rows.headers().expect("a header").iter().position(|name| name == "device_pz").expect("a column");
    let heights: Vec<f64> =
        rows.records().map(|row| row.expect("a row")[column].parse().expect("a number")).collect();
    let (first, last) = (heights[0], heights[heights.len() - 1]);
    // The golf ball is 43 mm wide, and the picture shows the probe above it.
    assert!((2e-3..50e-3).contains(&(first - last)), "from {first} to {last} m");
}

#[test]
fn errors_of_the_window_name_the_option() {
    let folder = tempfile::tempdir().expect("temporary folder");
    for (arguments, said) in [
        (&["--seconds", "1"][..], "no window could be opened"),
        (&["--lockstep", "--seconds", "1"], "--lockstep"),
        (&["--screenshot", "a.png"], "--seconds"),
        (&["--seconds", "1", "--screenshot", "a.png", "--record", "a.png"], "named twice"),
    ] {
        let output =
            view(&[&["ellipsoid@500", "golf-ball@1000"], arguments].concat(), folder.path()).output();
        let output = output.expect("palpate runs");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{stderr}");
        assert!(stderr.contains(said), "{said}: {stderr}");
        assert!(!folder.path().join("a.png").exists());
    }
}
