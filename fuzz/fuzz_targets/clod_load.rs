//! Any bytes as a `.clod` file: as they are, and with a corrected header so that they reach the checks behind
//! it. Reading takes memory in proportion to the file, and accepted files survive contact queries.

#![no_main]

use std::sync::LazyLock;

use allocation_counter::measure;
use libfuzzer_sys::fuzz_target;
use palpate::Pose;
use palpate::clod_build::{BuildOptions, build, unwatched};
use palpate::collide::{ContactQuery, QuerySettings, Shape};
use palpate::core::Clod;
use palpate::glam::DVec3;
use palpate::models::Model;

/// Magic, version, length of the body, checksum.
const HEADER: usize = 24;

static SOUND: LazyLock<Clod> = LazyLock::new(|| {
    let mesh = Model::Ellipsoid.generate(60).expect("within range");
    build(&mesh, &BuildOptions::default(), &mut unwatched).expect("the model builds")
});

fuzz_target!(|data: &[u8]| {
    try_bytes(data);
    let Some((header, body)) = data.split_at_checked(HEADER) else { return };
    let mut sealed = Vec::with_capacity(data.len());
    sealed.extend_from_slice(b"palpclod");
    sealed.extend_from_slice(&header[8..12]);
    sealed.extend_from_slice(&(body.len() as u64).to_le_bytes());
    sealed.extend_from_slice(&crc32fast::hash(body).to_le_bytes());
    sealed.extend_from_slice(body);
    try_bytes(&sealed);
});

fn try_bytes(bytes: &[u8]) {
    let mut read = None;
    let memory = measure(|| read = Some(Clod::read(bytes))).bytes_max;
    let allowed = 4 * bytes.len() as u64 + (200 << 10);
    assert!(memory <= allowed, "{memory} bytes of memory for a file of {}", bytes.len());
    match read {
        Some(Ok(clod)) => touch(&clod),
        Some(Err(error)) => assert!(error.to_string().len() < 400, "{error}"),
        None => {}
    }
}

fn touch(clod: &Clod) {
    let sound = &*SOUND;
    let settings = QuerySettings::new(0.02 * sound.bounding_radius());
    let mut query =
        ContactQuery::with_capacity(&Shape::new(clod.clone()), &Shape::new(sound.clone()), 64, 1024);
    for reach in [0.0, 0.5] {
        let pose = Pose { translation: DVec3::ONE * reach * sound.bounding_radius(), ..Pose::IDENTITY };
        // A file may say that its object is smaller than the tolerance.
        let Ok(outcome) = query.run(&pose, &Pose::IDENTITY, &settings) else { continue };
        assert!(outcome.visited <= clod.nodes().len() * sound.nodes().len());
        for contact in query.contacts() {
            let c = &contact.contact;
            assert!(
                c.point.is_finite()
                    && c.scene_point.is_finite()
                    && c.normal.is_finite()
                    && c.depth.is_finite()
            );
        }
    }
}
