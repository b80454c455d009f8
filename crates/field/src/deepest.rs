//! The deepest samples near a place, among the finest.

use crate::cells::ContactSample;
use crate::selection::Sample;
use crate::side::Side;

/// Samples of a level that are followed to the next.
const FOLLOWED: usize = 4;

/// The deepest of the samples around one that is in contact, from its own level to the finest: of those below it and its three
/// neighbours, following the deepest few of each level.
pub fn deepest_around(side: &Side, touch: &ContactSample) -> ContactSample {
    let mut best = *touch;
    let first = touch.sample.index & !3;
    let mut followed = [0, 1, 2, 3].map(|lane| Some(first + lane));
    for level in (0..touch.sample.level).rev() {
        let mut next = [(f32::NEG_INFINITY, None); FOLLOWED];
        for parent in followed.into_iter().flatten() {
            if parent as usize >= side.samples.fours(level.into()) {
                continue;
            }
            let points = side.samples.four(level.into(), parent as usize);
            let read = side.read(&points);
            for (lane, inside) in (0..).zip(read.inside.to_array()) {
                // In order, the deepest first.
                let place = next.partition_point(|(other, _)| *other >= inside);
                if place < FOLLOWED {
                    next[place..].rotate_right(1);
                    next[place] = (inside, Some(4 * parent + lane));
                }
            }
            side.contacts(&points, &read, |lane, found| {
                if found.reach > best.reach {
                    let index = 4 * parent + lane as u32;
                    best = ContactSample { sample: Sample { level, index }, ..found };
                }
            });
        }
        followed = next.map(|(_, sample)| sample);
    }
    best
}
