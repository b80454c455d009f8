use palpate::Wrench;
use palpate::glam::DVec3;

use super::session::{BROKEN, Measure, as_asked, run};
use super::*;

fn part(outcome: &Outcome, measure: Measure) -> f64 {
    let Outcome::Ended(ended) = outcome else { panic!("{outcome:?}") };
    let at = Measure::ALL.iter().position(|other| *other == measure);
    ended.parts[at.expect("one of all")]
}

/// With fixed seeds, so that a failure can be reproduced: `cargo xtask harm --seconds 2 --session SEED`.
#[test]
fn random_sessions_do_no_harm() {
    let (mut ended, mut touched) = (0, 0);
    for seed in 0..40 {
        let genome = Genome::new(seed);
        let outcome = run(&genome, 2.0, as_asked);
        assert!(!outcome.is_harm(), "{genome}: {outcome:?}");
        if let Outcome::Ended(session) = outcome {
            ended += 1;
            touched += usize::from(session.touched);
        }
    }
    assert!(ended > 35 && touched > 15, "{ended} ended, {touched} touched something");
}

/// Sessions in which a search found faults of the engine or of its checks, since fixed.
#[test]
fn sessions_that_once_did_harm_do_none() {
    const FOUND: [&str; 13] = [
        // A host whose `dt` differed from its clock: heat.
        "72d288b58175a8e0",
        "9166d3cb4390ac9d",
        "fc1f9d47c1a5266c",
        // Steps of negative duration: engagement.
        "cd8fc2b647da69d",
        "14bd0a11af48b4ca",
        // Contacts without a valid time: fault.
        "b8f47a17463108e8",
        "a56a78496968e01a:020b09002f18d3036152f0497e440544be10698ef50a3881d0c0907c0c9579e0fec64c10b6ab9148ce98187c5fb2126283229a98e27a81ec",
        // Old contacts after late ones: fault.
        "b63c44dfe8876981",
        "d098f30f43a84fec",
        // Energy stored before the wrench was last zero: energy.
        "273d34d5df0a9573",
        // A driver that did not report that it withheld the wrench, a fault of the search: slew.
        "80524c8a014d6e7a",
        // Apparent energy from the encoder's steps: energy.
        "be5b5aa7b2f72df2",
        "e84573e148d8bf64",
    ];
    for text in FOUND {
        let genome: Genome = text.parse().expect("a genome");
        let outcome = run(&genome, 10.0, as_asked);
        assert!(!outcome.is_harm(), "{genome}: {outcome:?}");
    }
}

#[test]
fn a_session_is_the_same_each_time() {
    let genome = Genome::new(3);
    let (one, two) = (run(&genome, 0.5, as_asked), run(&genome, 0.5, as_asked));
    assert_eq!(one, two);
}

/// Wrenches that are changed between the engine and the device are judged as harm.
#[test]
fn harm_is_found_where_it_is_done() {
    let worst = |measure: Measure, tamper: bench::Tamper| {
        (0..30)
            .map(|seed| run(&Genome::new(seed), 2.0, tamper))
            .map(|it| part(&it, measure))
            .fold(0.0, f64::max)
    };
    let stronger = |wrench: &Wrench, _: &Wrench| *wrench * 1.3;
    let kept = |wrench: &Wrench, held: &Wrench| if *wrench == Wrench::ZERO { *held } else { *wrench };
    let refused = |wrench: &Wrench, held: &Wrench| {
        let odd = held.force.length() > 0.1;
        Wrench::new(if odd { DVec3::splat(f64::NAN) } else { wrench.force }, wrench.torque)
    };
    for (measure, tamper) in [
        (Measure::SeenPeak, stronger as bench::Tamper),
        (Measure::SeenSlew, stronger),
        (Measure::SeenFault, kept),
        (Measure::SeenFinite, refused),
    ] {
        let (usual, harmful) = (worst(measure, as_asked), worst(measure, tamper));
        assert!(usual <= BROKEN && harmful > BROKEN, "{}: {usual} and {harmful}", measure.name());
    }
}

/// The mutations come nearer to harm than random sessions, and are the same each time.
#[test]
fn a_search_comes_nearer_to_harm() {
    let search = Search { sessions: 500, seed: 5, random: 0.5 };
    let at_random = Search { sessions: 250, ..search };
    let faults = Sessions { seconds: 0.3 };
    let speed = |found: &Found| {
        let at = Measure::ALL.iter().position(|it| *it == Measure::TrueSpeed).expect("one of all");
        found.worst[at].first().map_or(0.0, |worst| worst.part)
    };
    let found = search.run(&faults);
    assert!(found.harm.is_empty(), "{:?}", found.harm);
    assert!(speed(&found) >= speed(&at_random.run(&faults)));
    assert_eq!(found.json(), search.run(&faults).json());
}

/// Sessions of a kind that do harm, each with what came of it.
fn harmful(trial: &dyn Trial, genomes: impl Iterator<Item = Genome>) -> Vec<String> {
    let found = Found::of(trial, &genomes.collect::<Vec<_>>());
    assert!(
        found.touched * 4 > found.sessions && found.refused == 0,
        "{}: {}",
        found.sessions,
        found.touched
    );
    found.harm.iter().map(|(genome, outcome)| format!("{genome}: {outcome:?}")).collect()
}

/// Floor, tiles, slot, ridge, corners, bearing and clutter; among them scenes in which a contact ahead of a
/// ridge once pushed with 2 N, one of a fine mesh over a floor with 2.4 N, one of a bent surface at a ridge
/// with 0.24 N, in which a body lagged 30 mm behind in free air, was drawn back with 5 N by points that had
/// not come to rest, and went 0.07 mm into a slot's floor past points at its walls; was pushed sideways with
/// 0.02 N where it landed with 34 N at a tilt of a sixteenth of a degree, waited among 36 balls that it did
/// not touch, and went 0.04 mm into an object at which all points had gone to the same place; stopped in free
/// air, with 0.5 N, since a far point had not come to rest; and landed with 0.1 and 0.4 N sideways. To rerun
/// one: `cargo xtask harm --scene SEED`, in hexadecimal digits.
#[test]
fn plain_scenes_feel_right() {
    let small = [0x3, 0x4, 0x7, 0x8, 0xa, 0xb, 0x10, 0x12];
    let large = [
        0x33b1_fbc6_c540_fc90,
        0x1fb0_3045_cf1e_9766,
        0x910a_2dec_8902_5cc1,
        0xc941_74d6_12fb_7f19,
        0x2ef6_ef77_9643_644d,
        0x8763_dc80_8fa9_d3df,
        0xf6e6_bd48_2033_e83c,
        0x3216_e1c6_cb21_f7d9,
        0xebb9_00ea_f943_a11b,
        0xc123_9a82_f440_9653,
        0xb5c2_895a_d531_5560,
        0x6245_253b_3ca5_c44a,
        // Pushed sideways where a blow turned the body, where it left a slot of exactly its width (0.6 N),
        // and by a facet beside that on which it lay.
        0x478e_bffa_49d4_d4e7,
        0x5629_d0ba_4d0b_afe3,
        0x4755_fa26_4b54_d00e,
        // Overlaps at a vertex that no point could reach, and where points ended a hair before a tip.
        0x7dc2_b9ed_63d0_a8d6,
        0x45ee_8d51_20dc_08d5,
        // Held in free air, with 7.6 N, by objects that it had left behind.
        0xb13e_ad95_fd7e_f716,
        // Went in by 0.06 mm where a point had left its start, and was pushed along a ridge that it passed.
        0x8c53_387c_eadc_f9c2,
        0x508c_817b_52a2_7a0d,
    ];
    let seeds = small.into_iter().chain(large);
    let harm = harmful(&Scenes, seeds.map(Genome::new));
    assert!(harm.is_empty(), "{harm:#?}");
}

/// Pokes that went in by 0.05 to 2.3 mm: past places of a plate that coarse points stood for, along blades,
/// at the end of a steep descent, beside a tip; with a knife whose far side looked like an overlap; with
/// teeth that turned by 0.1 rad in a step; with a block whose edge crossed one of the slab while its points
/// were outside; with a knife that fell flat, and teeth that were held by a face which they had passed; with
/// a tip that turned on to its plate, and teeth that came in around an edge.
#[test]
fn pokes_that_went_in_are_held() {
    let known = [
        "1188267406d417a9",
        "1188267406d417a9:0077d2400e563b00f3bd1",
        "1188267406d417a9:001b732003bc00006b5f9009654d00b5221",
        "9fe5f966c755da48:000ffff001b7290021eca003edb5004fa4c005fb65006bcd60073a58008a8cc009581200abb9b00b6ae800ce47a00d704400e387e",
        "d19064eaf88492ae:000ffff001f4ff0023505003255100495b80056a450067adc0073b740083f5d009a76a00ac3f900b0b9600cc8df00dbdbd00edf4d00fbf65",
        "d19064eaf88492ae:00404530058cd70068cd8007249b00ce4a000dc549",
        "98136467ba955e9e:001f6da003093600452d70050a30006bdad008222e00d67ee00e0893",
        "7d52d986ac93f5e1:001c3a9003ff0e00421f0005e02a00647a10071ff1008b315009aa3300a63f000b438e00cc49d00d64ca00ee5d600fd1bd",
        "323e39c372c65ea2:001fbe4002a60e0033b6a0041886005258b006ae9400741b800a4e9f00b2c3c00cfaaa00d000000e6ee0",
        "fce95703ce8cf14e:00005850019414002166d0044ce50053dc00061ebc00748ef008b35c009a19600a96f700b141f00c0c7300da08900ed47c00fd604",
        "d19064eaf88492ae:001fff1002e2c500328f900cdca400e0e37",
    ];
    let harm = harmful(&Pokes, known.into_iter().map(|genome| genome.parse().expect("a genome")));
    assert!(harm.is_empty(), "{harm:#?}");
}

/// To rerun one: `cargo xtask harm --poke SEED`.
#[test]
fn nothing_is_poked_into_a_slab() {
    // Of few shapes, as each takes a second to prepare.
    let some = (0..).map(Genome::new).filter(|genome| pokes::shape_of(genome) < 18);
    let harm = harmful(&Pokes, some.take(100));
    assert!(harm.is_empty(), "{harm:#?}");
}
