//! The ways to decompose a surface, compared. `docs/decomposition.md` has the tables and what they say; they are
//! printed by
//!
//! ```text
//! cargo test --release -p palpate-clod-build --lib -- --ignored --nocapture decomposition::comparison
//! ```
//!
//! for the built-in models of Table 3.2, or for those that the environment variable `MODELS` names: names of models
//! with or without `@TRIANGLES`, and files, with spaces between.
//!
//! All methods use the one test of convexity, and to all a closed convex piece is one patch. Their bookkeeping is the
//! plainest: pairs are put in the queue again whenever their priority changes. What a method costs is counted in points
//! of the hulls that it asks for, so that it does not depend on the machine.

mod after;
mod growing;
mod pairing;

use std::path::Path;

use palpate_core::TriMesh;
use palpate_models::Model;

use super::*;
use crate::progress::unwatched;
use crate::surface::Surface;
use growing::{Next, Seed};
use pairing::Pair;

const TABLE: &str = "lower-jaw upper-jaw ball-joint-ball golf-club golf-ball cup spoon";

/// A method is given up when it has cost this many times what ours does.
const PATIENCE: usize = 10;

/// A surface to be decomposed.
struct Problem {
    surface: Surface,
    adjacency: Adjacency,
    tolerance: f64,
}

impl Problem {
    fn new(mesh: &TriMesh) -> Self {
        let sphere = mesh.bounding_sphere();
        let surface = Surface::new(mesh, sphere.center, sphere.radius);
        let tolerance = 1e-6 * sphere.radius * surface.scale;
        Self { surface, adjacency: mesh.adjacency(), tolerance }
    }

    fn ours(&self) -> Decomposition {
        let mut callback = unwatched;
        let mut progress = Progress::new(&mut callback);
        decompose(&self.surface, &self.adjacency, self.tolerance, &mut progress).expect("nobody cancels it")
    }

    fn tests(&self) -> Tests<'_> {
        Tests {
            convexity: Convexity::new(&self.surface, self.adjacency.neighbours(), self.tolerance),
            buffers: JoinBuffers::default(),
            cost: 0,
            limit: usize::MAX,
        }
    }

    fn start(&self, tests: &mut Tests<'_>) -> (Vec<Option<Member>>, Vec<u32>) {
        start(&self.surface, &self.adjacency, &tests.convexity, &mut tests.buffers)
    }

    /// The triangles across the sides of one where the surface is 2-manifold and oriented, with the side.
    fn across(&self, t: u32) -> impl Iterator<Item = (usize, u32)> {
        (0..3).filter_map(move |side| {
            let edge = self.adjacency.triangle_edges()[t as usize][side];
            let manifold = edge != u32::MAX && self.adjacency.edge_kind(edge) == EdgeKind::Manifold;
            Some((side, self.adjacency.neighbour(t, side as u32).filter(|_| manifold)?))
        })
    }

    fn area(&self, t: u32) -> f64 {
        let [a, b, c] = self.surface.corners(t);
        0.5 * (b - a).cross(c - a).length()
    }

    /// The angle between the planes of two triangles, rad.
    fn angle(&self, t: u32, u: u32) -> f64 {
        let [m, n] = [t, u].map(|t| self.surface.planes[t as usize].normal);
        m.cross(n).length().atan2(m.dot(n))
    }
}

/// The test of convexity, and what it has cost.
struct Tests<'a> {
    convexity: Convexity<'a>,
    buffers: JoinBuffers,
    /// Points of the hulls asked for.
    cost: usize,
    /// The cost at which a method gives up.
    limit: usize,
}

impl Tests<'_> {
    fn join(&mut self, a: &Patch, b: &Patch, mine: impl Fn(u32) -> bool) -> Option<crate::convexity::Join> {
        self.cost += a.extreme.len() + b.extreme.len();
        self.convexity.join(a, b, mine, &mut self.buffers)
    }

    fn given_up(&self) -> bool {
        self.cost > self.limit
    }
}

/// The bits of a number that is not negative: in the order of such numbers.
fn ascending(x: f64) -> u64 {
    x.max(0.0).to_bits()
}

fn descending(x: f64) -> u64 {
    u64::MAX - ascending(x)
}

fn models() -> Vec<(String, TriMesh)> {
    let names = std::env::var("MODELS").unwrap_or_else(|_| TABLE.to_owned());
    let named = names.split_whitespace().map(|name| {
        let mesh = match Model::parse(name) {
            Ok((model, triangles)) => model.generate(triangles).expect("within range"),
            Err(_) => {
                palpate_mesh_io::load(Path::new(name), &Default::default()).expect("a model or file").mesh
            }
        };
        (name.rsplit('/').next().unwrap_or(name).to_owned(), mesh)
    });
    named.collect()
}

/// Prints a row: the patches that a method makes in each problem, in terms of ours, and in brackets what it costs.
fn row(
    name: &str,
    ours: &[(usize, usize)],
    problems: &[Problem],
    method: impl Fn(&Problem, &mut Tests<'_>) -> Option<Decomposition>,
) {
    print!("| {name} |");
    for ((patches, cost), problem) in ours.iter().zip(problems) {
        let mut tests = problem.tests();
        tests.limit = PATIENCE * cost;
        match method(problem, &mut tests) {
            Some(made) => print!(
                " {:+.1} % ({:.1}) |",
                100.0 * (made.patches.len() as f64 / *patches as f64 - 1.0),
                tests.cost as f64 / *cost as f64
            ),
            None => print!(" (> {PATIENCE}) |"),
        }
    }
    println!();
}

/// The problems, with the patches and cost of the plain form of our method; prints the head of a table.
fn problems() -> (Vec<Problem>, Vec<(usize, usize)>) {
    let models = models();
    println!();
    println!("| |{}", models.iter().map(|(name, _)| format!(" {name} |")).collect::<String>());
    println!("|---|{}", "---|".repeat(models.len()));
    print!("| triangles |");
    for (_, mesh) in &models {
        print!(" {} |", mesh.triangles().len());
    }
    print!("\n| patches |");
    let problems: Vec<Problem> = models.iter().map(|(_, mesh)| Problem::new(mesh)).collect();
    let ours = problems
        .iter()
        .map(|problem| {
            let patches = problem.ours().patches.len();
            print!(" {patches} |");
            let mut tests = problem.tests();
            pairing::join_pairs(problem, Pair::SmallestUnion, &mut tests);
            (patches, tests.cost)
        })
        .collect();
    println!();
    (problems, ours)
}

#[test]
#[ignore = "takes minutes; prints a table"]
fn orders() {
    let (problems, ours) = problems();
    for (order, name) in Pair::ALL {
        row(&format!("pairs: {name}"), &ours, &problems, |p, t| pairing::join_pairs(p, order, t));
    }
    let first = Next::ALL.map(|next| (Seed::ALL[0], next));
    let others = Seed::ALL[1..].iter().map(|seed| (*seed, Next::ALL[0]));
    for ((seed, from), (next, name)) in first.into_iter().chain(others) {
        let name = format!("growing from the {from} triangle: {name}");
        row(&name, &ours, &problems, |p, t| growing::grow(p, seed, next, t));
    }
}

#[test]
#[ignore = "takes minutes; prints a table"]
fn improvements() {
    let (problems, ours) = problems();
    for largest in [2, 16] {
        let name = format!("then dissolving patches of up to {largest} triangles");
        row(&name, &ours, &problems, |p, t| after::dissolve(p, p.ours(), largest, t));
    }
    for rounds in [1, 4] {
        let name = format!("then joining groups of 6 anew, rounds: {rounds}");
        row(&name, &ours, &problems, |p, t| after::join_anew(p, p.ours(), rounds, t));
    }
}

/// All methods make decompositions: a partition into patches each of which is one by its definition.
#[test]
fn all_make_convex_patches() {
    let problem = Problem::new(&Model::Cup.generate(1000).expect("within range"));
    let ours = problem.ours();
    let mut tests = problem.tests();
    let mut made: Vec<Option<Decomposition>> = Vec::new();
    made.extend(Pair::ALL.map(|(order, _)| pairing::join_pairs(&problem, order, &mut tests)));
    made.extend(Next::ALL.map(|(next, _)| growing::grow(&problem, Seed::First, next, &mut tests)));
    made.push(after::dissolve(&problem, problem.ours(), 16, &mut tests));
    made.push(after::join_anew(&problem, problem.ours(), 1, &mut tests));
    for (method, made) in made.into_iter().chain([Some(problem.ours())]).enumerate() {
        let made = made.expect("without limit");
        let mut seen = vec![false; problem.surface.triangles.len()];
        for (k, patch) in made.patches.iter().enumerate() {
            for t in &patch.triangles {
                assert!(
                    !std::mem::replace(&mut seen[*t as usize], true),
                    "method {method}: triangle {t} is in two"
                );
                assert_eq!(made.patch_of[*t as usize], k as u32);
                let plane = problem.surface.planes[*t as usize];
                for v in patch.triangles.iter().flat_map(|t| problem.surface.corners(*t)) {
                    assert!(plane.height(v) <= problem.tolerance, "method {method}, patch {k}");
                }
            }
        }
        assert!(seen.iter().all(|s| *s), "method {method} has left triangles");
        let ratio = made.patches.len() as f64 / ours.patches.len() as f64;
        assert!((0.7..1.4).contains(&ratio), "method {method} makes {ratio} times as many");
    }
}
