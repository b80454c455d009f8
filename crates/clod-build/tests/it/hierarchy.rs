//! The tree of hulls over the patches: its shape, its parameters and that it does not depend on the number of
//! threads.

#![allow(
    clippy::print_stdout,
    reason = "seeds, figures and what was skipped, shown by --nocapture or on failure"
)]

use crate::shapes::{built, cube, globe, mapped, plain, shared_mesh, together, torus};
use glam::DVec3;
use palpate_clod_build::{BuildError, BuildOptions, Stage, build};
use palpate_core::clod::{NO_NODE, Parts};
use palpate_models::Model;
use std::ops::ControlFlow;

fn bytes(clod: &Parts) -> Vec<u8> {
    let mut out = Vec::new();
    clod.write(&mut out).expect("memory can be written to");
    out
}

fn check_levels(clod: &Parts) {
    assert!(!clod.levels[0].free && clod.levels[1..].iter().all(|l| l.free));
    assert_eq!(clod.nodes[0].parent, NO_NODE);
    for (k, level) in clod.levels.iter().enumerate() {
        let nodes = clod.level(k);
        assert_eq!(nodes.len(), level.nodes.len());
        for node in nodes {
            assert!((1..=2).contains(&node.children.len()) || k == 0, "one or two children above the leaves");
            assert_eq!((node.deviation, node.hausdorff), (0.0, 0.0));
            assert!(node.radius <= 1.001 * clod.bounding_radius() + 1e-300);
        }
        if k > 0 {
            let finer = clod.level(k - 1).len();
            assert!(
                nodes.len() < finer && nodes.len() >= finer / 2,
                "level {k} has {} of {finer}",
                nodes.len()
            );
        }
        assert_eq!(level.resolution, clod.levels[0].resolution);
    }
}

#[test]
fn levels_halve() {
    for mesh in [torus(20, 0.4), globe(30, |p| 0.1 * (9.0 * p.x).sin() * (9.0 * p.y).sin())] {
        let clod = built(&mesh);
        check_levels(&clod);
        let ideal = (clod.leaves().len() as f64).log2().ceil() as usize + 1;
        assert!(
            clod.levels.len() <= ideal + 3,
            "{} levels for {} patches",
            clod.levels.len(),
            clod.leaves().len()
        );
    }
}

#[test]
fn patches_around_one_large_one_do_not_wait_for_it() {
    let Ok(mesh) = Model::Gear.generate(25_600) else { return };
    let clod = built(&mesh);
    check_levels(&clod);
    let ideal = (clod.leaves().len() as f64).log2().ceil() as usize + 1;
    assert!(
        clod.levels.len() <= ideal + 4,
        "{} levels for {} patches",
        clod.levels.len(),
        clod.leaves().len()
    );
}

#[test]
fn pieces_merge_by_proximity() {
    // Two clouds of cubes, far apart: no node but the root should span both.
    let cubes: Vec<_> = (0..600)
        .map(|k| {
            let at = DVec3::new(f64::from(k % 10), f64::from(k / 10 % 10), f64::from(k / 100)) * 3.0;
            let at = if k >= 300 { at + DVec3::X * 1000.0 } else { at };
            mapped(&cube(1), glam::DMat3::IDENTITY, at)
        })
        .collect();
    let clod = built(&together(&cubes));
    check_levels(&clod);
    assert_eq!(clod.leaves().len(), 600);
    assert!(clod.leaves().iter().all(|n| n.all_real && n.contained));
    assert!(clod.levels.len() <= 14, "{} levels", clod.levels.len());
    let spanning = clod.nodes.iter().filter(|n| n.radius > 400.0).count();
    assert!(spanning <= 3, "{spanning} nodes span the gap");
    // The curve keeps pairs together: on the second level of the hierarchy, pairs touch or nearly so.
    let mean = clod.level(1).iter().map(|n| n.radius).sum::<f64>() / clod.level(1).len() as f64;
    assert!(mean < 5.0, "{mean}");
}

#[test]
fn one_and_many_threads_build_the_same_bytes() {
    let mesh = match shared_mesh("models/good/ycb_mug.obj") {
        Some(mesh) => mesh,
        None => torus(30, 0.4),
    };
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        bytes(&pool.install(|| built(&mesh)))
    };
    let one = with(1);
    for threads in [2, 3, 8] {
        assert!(with(threads) == one, "{threads} threads");
    }
}

#[test]
fn progress_runs_through_the_stages() {
    let mut seen: Vec<(Stage, f64)> = Vec::new();
    build(&torus(20, 0.4), &plain(), &mut |stage, done| {
        assert!((0.0..=1.0).contains(&done));
        if let Some((last, before)) = seen.last() {
            assert!(*last != stage || done >= *before, "{stage:?} went from {before} to {done}");
        }
        seen.push((stage, done));
        ControlFlow::Continue(())
    })
    .expect("a torus builds");
    let mut stages: Vec<Stage> = seen.iter().map(|(stage, _)| *stage).collect();
    stages.dedup();
    assert_eq!(stages, [Stage::Mesh, Stage::Decomposition, Stage::Hierarchy, Stage::Parameters]);
}

#[test]
fn parameters_of_a_cube() {
    let mesh = cube(4);
    let clod = built(&mesh);
    assert!((clod.levels[0].resolution - 2.0).abs() < 1e-12, "edges of length 0.5");
    assert_eq!(clod.levels[0].triangles, 192);
    let [leaf] = clod.leaves() else { panic!("a cube is one patch") };
    // Packing rounds it up.
    assert!((0.0..1e-6).contains(&(leaf.radius - 3f64.sqrt())), "{}", leaf.radius);
    let inside: f64 = (0..clod.vertices.len())
        .filter(|k| clod.vertices[*k].abs().to_array().iter().filter(|x| **x == 1.0).count() == 1)
        .map(|k| clod.support_areas[k])
        .sum();
    // Each of the 54 vertices in the sides has its six triangles of 0.125 m², or four of eight of them.
    assert!(inside > 54.0 * 0.5 && inside < 54.0 * 1.0 + 1e-9, "{inside}");
    assert!((clod.source.unit_inertia.x_axis.x - 2.0 / 3.0).abs() < 1e-12);
}

#[test]
fn a_build_can_be_cancelled_in_every_stage() {
    let mesh = torus(20, 0.4);
    let options = BuildOptions::default();
    let mut stages = Vec::new();
    build(&mesh, &options, &mut |stage, _| {
        stages.push(stage);
        ControlFlow::Continue(())
    })
    .expect("a torus builds");
    stages.dedup();
    for last in stages {
        let mut after = 0;
        let cancelled = build(&mesh, &options, &mut |stage, _| {
            after += usize::from(stage == last);
            if stage == last { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        assert_eq!((cancelled, after), (Err(BuildError::Cancelled), 1), "{last}");
    }
}
