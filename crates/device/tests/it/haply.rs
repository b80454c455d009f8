//! Haply's messages, and a session with a substitute service.

use std::io::{Read as _, Write as _};
use std::net::TcpListener;
use std::sync::mpsc;
use std::time::{Duration, Instant};

use glam::DVec3;
use palpate_core::Wrench;
use palpate_device::haply::{Dialect, force_message, parse_state};
use palpate_device::{DeviceError, HapticDevice as _, Status};
use rand::rngs::StdRng;
use rand::{Rng as _, RngExt as _, SeedableRng as _};
use tungstenite::Message;

/// A state message as in the maker's documentation.
fn state(x: f64) -> String {
    format!(
        r#"{{"inverse3": [{{"device_id": "049D", "status": {{"calibrated": true, "in_use": true, "ready": true}},
            "state": {{"cursor_position": {{"x": {x}, "y": -0.17, "z": 0.16}},
            "cursor_velocity": {{"x": 0.25, "y": 0, "z": -0.5}},
            "body_orientation": {{"x": 0, "y": 0, "z": 0, "w": 1}}}}}}],
            "wireless_verse_grip": [{{"device_id": "61576", "state": {{"hall": 0, "buttons": {{"a": true, "b": false, "c": true}},
            "orientation": {{"x": 0, "y": 0.6, "z": 0, "w": 0.8}}}}}}]}}"#
    )
}

#[test]
fn states_are_read_and_forces_said_in_both_dialects() {
    let (device, found) = parse_state(&state(0.05)).unwrap();
    assert_eq!((device.as_str(), found.buttons, found.ready), ("049D", 0b101, true));
    assert_eq!((found.position, found.velocity), ([0.05, -0.17, 0.16], [0.25, 0.0, -0.5]));
    assert_eq!(found.orientation, [0.0, 0.6, 0.0, 0.8]);
    let force = |dialect| force_message("049D", [0.0, 0.5, 1.5], dialect);
    let expected = r#"{"inverse3":[{"commands":{"set_cursor_force":{"vector":{"x":0.0,"y":0.5,"z":1.5}}},"device_id":"049D"}]}"#;
    assert_eq!(force(Dialect::Vector), expected);
    assert_eq!(force(Dialect::Values), expected.replace("vector", "values"));
    for (version, dialect) in [
        ("3.1.2", Dialect::Values),
        ("3.5.0", Dialect::Vector),
        ("4", Dialect::Vector),
        ("", Dialect::Vector),
    ] {
        assert_eq!(Dialect::of(version), dialect, "{version}");
    }
}

#[test]
fn messages_that_are_none_give_none() {
    for message in [
        "",
        "{}",
        "[]",
        r#"{"inverse3": []}"#,
        r#"{"inverse3": [{"device_id": 5}]}"#,
        &state(0.0).replace("0.16", "null"),
        &state(0.0).replace("-0.17", "1e999"),
        &state(0.0).replace("0.8", "7"),
    ] {
        assert_eq!(parse_state(message), None, "{message}");
    }
    let mut rng = StdRng::seed_from_u64(95);
    let good = state(0.01).into_bytes();
    let mut read = 0;
    for _ in 0..1_000_000 {
        let mut bytes = good.clone();
        for _ in 0..rng.random_range(1..6) {
            let at = rng.random_range(0..bytes.len());
            bytes[at] = (rng.next_u32() >> 8) as u8;
        }
        if let Some((_, state)) = parse_state(&String::from_utf8_lossy(&bytes)) {
            let numbers = state.position.iter().chain(&state.velocity).chain(&state.orientation);
            assert!(numbers.into_iter().all(|number| number.is_finite()), "{state:?}");
            read += 1;
        }
    }
    assert!(read > 1000, "{read}");
}

/// A service of version 3.1 that answers each message with the cursor's position, and leaves after a while.
#[test]
fn a_session_with_a_service() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let (forces, said) = mpsc::channel();
    let service = std::thread::spawn(move || {
        let (mut asked, _) = listener.accept().unwrap();
        let mut request = [0; 512];
        let length = asked.read(&mut request).unwrap();
        assert!(request[..length].starts_with(b"GET /version HTTP/1.1\r\n"));
        asked.write_all(b"HTTP/1.1 200 OK\r\nContent-Length: 7\r\n\r\n\"3.1.0\"").unwrap();
        drop(asked);
        let mut socket = tungstenite::accept(listener.accept().unwrap().0).unwrap();
        // The inventory comes unasked.
        socket.send(Message::text(state(0.04))).unwrap();
        for i in 0..200 {
            let Ok(Message::Text(message)) = socket.read() else { break };
            forces.send(message.as_str().to_owned()).unwrap();
            if i == 20 {
                socket.send(Message::text("no JSON")).unwrap();
            }
            socket.send(Message::text(state(0.04 + 1e-4 * f64::from(i)))).unwrap();
            std::thread::sleep(Duration::from_millis(1));
        }
    });
    let mut device = palpate_device::open(&format!("haply:{address}")).unwrap();
    let start = Instant::now();
    let (mut furthest, mut malformed, mut lost) = (0.0_f64, false, false);
    while !lost && start.elapsed() < Duration::from_secs(20) {
        match device.read(start.elapsed().as_secs_f64()) {
            Ok(state) => {
                furthest = furthest.max(state.pose.translation.x);
                malformed |= state.status.contains(Status::MALFORMED);
                assert_eq!(state.buttons, 0b101);
            }
            // A busy machine may be silent for a while.
            Err(DeviceError::Lost { status: Status::SILENT }) => {}
            Err(error) => {
                assert!(matches!(error, DeviceError::Lost { status: Status::DISCONNECTED }), "{error}");
                lost = true;
            }
        }
        let _ = device.write(&Wrench::new(DVec3::Y, DVec3::ZERO));
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(lost && malformed && (0.01..0.021).contains(&furthest), "{lost} {malformed} {furthest}");
    drop(device);
    service.join().unwrap();
    let said: Vec<String> = said.iter().collect();
    let pushed =
        said.iter().filter(|message| message.contains(r#""values":{"x":0.0,"y":1.0,"z":0.0}"#)).count();
    assert!(pushed > 50, "{pushed} of {}: {:?}", said.len(), said.last());
}
