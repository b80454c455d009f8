//! Normal impulses against all sets of pushing contacts, each solved densely.

use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

use super::*;

type Six = Vector<6>;
type Side = super::Side<6>;
type Normals = super::Normals<6>;

const COMPLIANCE: f64 = 1e-4;

/// Contacts with random rows, some of them redundant: the same row again, or one that opposes it.
fn random(rng: &mut StdRng, count: usize) -> Vec<Side> {
    let mut sides: Vec<Side> = Vec::new();
    for _ in 0..count {
        let mut row: Six = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        if let Some(known) = sides.last().filter(|_| rng.random_range(0..3) == 0) {
            let sign = if rng.random_range(0..4) == 0 { -1.0 } else { 1.0 };
            row = known.row.map(|entry| sign * entry);
        }
        let excess = rng.random_range(-0.5..1.0);
        sides.push(Side { row, excess, stiffness: 1.0 / (COMPLIANCE * dot(&row, &row)) });
    }
    sides
}

fn normals(sides: &[Side], pushed: u64) -> Normals {
    let mut normals = Normals::default();
    for (index, side) in sides.iter().enumerate() {
        normals.push(*side, pushed >> index & 1 != 0);
    }
    normals
}

fn impulses(normals: &Normals) -> Vec<f64> {
    (0..normals.sides.len()).map(|index| normals.impulse(index)).collect()
}

/// Solves a dense system by Gaussian elimination with partial pivoting.
fn solved(mut rows: Vec<Vec<f64>>) -> Vec<f64> {
    let count = rows.len();
    for column in 0..count {
        let pivot = (column..count).max_by(|a, b| rows[*a][column].abs().total_cmp(&rows[*b][column].abs()));
        rows.swap(column, pivot.expect("a row"));
        let pivot = rows[column].clone();
        for (_, row) in rows.iter_mut().enumerate().filter(|(row, _)| *row != column) {
            let factor = row[column] / pivot[column];
            row.iter_mut().zip(&pivot).for_each(|(entry, above)| *entry -= factor * above);
        }
    }
    (0..count).map(|i| rows[i][count] / rows[i][i]).collect()
}

/// The impulses of the one set that meets all conditions: (W + c) p = q where contacts push, p > 0 there, and
/// no approach elsewhere.
fn by_all_sets(sides: &[Side], others: &Six) -> Vec<f64> {
    let approach: Vec<f64> = sides.iter().map(|side| side.excess - dot(&side.row, others)).collect();
    let (mut best, mut least) = (Vec::new(), f64::INFINITY);
    for set in 0..1_u64 << sides.len() {
        let chosen: Vec<usize> = (0..sides.len()).filter(|index| set >> index & 1 != 0).collect();
        let rows = chosen.iter().map(|&i| {
            let entry = |&j: &usize| {
                let compliance = if i == j { 1.0 / sides[i].stiffness } else { 0.0 };
                dot(&sides[i].row, &sides[j].row) + compliance
            };
            chosen.iter().map(entry).chain([approach[i]]).collect()
        });
        let found = solved(rows.collect());
        let mut all = vec![0.0; sides.len()];
        chosen.iter().zip(&found).for_each(|(&index, &impulse)| all[index] = impulse);
        let off = |i: usize| {
            let pushed: f64 = (0..sides.len()).map(|j| dot(&sides[i].row, &sides[j].row) * all[j]).sum();
            if set >> i & 1 != 0 { -all[i] } else { approach[i] - pushed }
        };
        let violation = (0..sides.len()).map(off).fold(0.0, f64::max);
        if violation < least {
            (best, least) = (all, violation);
        }
    }
    assert!(least < 1e-9, "no set meets the conditions: {least}");
    best
}

#[test]
fn impulses_are_those_of_the_one_set_that_meets_the_conditions() {
    let seed = 311;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut pushing, mut free) = (0, 0);
    for case in 0..300 {
        let sides = random(&mut rng, 1 + case % 8);
        let mut warm = normals(&sides, rng.random_range(0..1 << sides.len()));
        // Friction changes from pass to pass, and with it only the right-hand side, or the set as well.
        for pass in 0..4 {
            let size = [0.0, 1e-3, 0.1, 0.5][pass];
            let others: Six = std::array::from_fn(|_| rng.random_range(-size..=size));
            let wanted = by_all_sets(&sides, &others);
            let (y, ended) = warm.solve(&others, 1.0);
            let mut cold = normals(&sides, 0);
            let mut searched = normals(&sides, rng.random_range(0..1 << sides.len()));
            searched.system.change(searched.active, &searched.sides);
            let start = searched.system.least(&others);
            searched.active = searched.approach(&sum(&start, &others), 1.0).0;
            assert!(ended && cold.solve(&others, 1.0).1 && searched.search(&others, 1.0).1, "case {case}");
            let largest = wanted.iter().fold(1e-3, |most: f64, impulse| most.max(*impulse));
            for (name, found) in [("warm", &warm), ("cold", &cold), ("searched", &searched)] {
                for (found, wanted) in impulses(found).iter().zip(&wanted) {
                    let off = (found - wanted).abs() / largest;
                    assert!(
                        off < 1e-8,
                        "seed {seed}, case {case}, pass {pass}, {name}: {found}, not {wanted}"
                    );
                }
            }
            let mut pressed = [0.0; 6];
            for (side, impulse) in sides.iter().zip(&wanted) {
                add(&mut pressed, *impulse, &side.row);
            }
            for (found, wanted) in y.iter().zip(pressed) {
                assert!((found - wanted).abs() < 1e-8 * largest, "seed {seed}, case {case}: y {y:?}");
            }
            pushing += wanted.iter().filter(|impulse| **impulse > 0.0).count();
            free += wanted.iter().filter(|impulse| **impulse == 0.0).count();
        }
    }
    assert!(pushing > 500 && free > 500, "{pushing} push, {free} do not: the cases show nothing");
}

/// With as many contacts as a step may have, where sets change by many contacts at once.
#[test]
fn many_redundant_contacts_meet_the_conditions() {
    let seed = 312;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..200 {
        let sides = random(&mut rng, MAX_CONSTRAINTS);
        let mut found = normals(&sides, rng.random());
        let (y, ended) = found.solve(&[0.0; 6], 1.0);
        assert!(ended, "seed {seed}, case {case}");
        let all = impulses(&found);
        for (i, side) in sides.iter().enumerate() {
            let pushed: f64 = (0..sides.len()).map(|j| dot(&side.row, &sides[j].row) * all[j]).sum();
            let slack = pushed + all[i] / side.stiffness - side.excess;
            assert!(slack > -1e-9 && all[i] >= 0.0, "seed {seed}, case {case}: {slack}, {}", all[i]);
            assert!(all[i] == 0.0 || slack < 1e-9, "seed {seed}, case {case}: pushes {slack} too early");
            assert!((pushed - dot(&side.row, &y)).abs() < 1e-9, "seed {seed}, case {case}: y {y:?}");
        }
    }
}

#[test]
fn factors_solve_what_gaussian_elimination_does() {
    let seed = 313;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..200 {
        let sides = random(&mut rng, 20);
        let mut system = System::default();
        // Grows, shrinks, and grows again.
        for set in [0b1, 0b111_1001, 0xFFFFF, 0b1010, 0b1110] {
            system.change(set, &sides);
            let others: Six = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
            let mut rows: Vec<Vec<f64>> =
                identity::<6>().iter().map(|row| [row.as_slice(), &[0.0]].concat()).collect();
            for side in members(set).map(|index| &sides[index]) {
                for (row, along) in rows.iter_mut().zip(side.row) {
                    let approach = side.excess - dot(&side.row, &others);
                    let entries = side.row.iter().chain([&approach]);
                    row.iter_mut().zip(entries).for_each(|(to, entry)| *to += side.stiffness * along * entry);
                }
            }
            for (found, wanted) in system.least(&others).iter().zip(solved(rows)) {
                let off = (found - wanted).abs();
                assert!(off < 1e-9, "seed {seed}, case {case}: {found}, not {wanted}");
            }
        }
    }
}
