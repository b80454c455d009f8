//! The deepest samples near a place, among the finest.

use wide::f32x4;

use crate::cells::ContactSample;
use crate::samples::Sample;
use crate::side::Side;

/// No sample.
const NONE: u32 = u32::MAX;

/// The deepest of the samples around one that is in contact, from its own level to the finest: of those below it and its three
/// neighbours, following the deepest two of each level.
pub fn deepest_around(side: &Side, touch: &ContactSample) -> ContactSample {
    let mut best = *touch;
    let first = touch.sample.index & !3;
    let mut followed = [first, first + 1, first + 2, first + 3];
    for level in (0..touch.sample.level).rev() {
        let mut next = [(f32::NEG_INFINITY, NONE); 2];
        for parent in followed {
            // Fours below neighbours at the end of a level may not exist.
            if parent as usize >= side.samples.fours(level.into()) {
                continue;
            }
            let points = side.samples.four(level.into(), parent as usize);
            let read = side.read(&points);
            for (lane, inside) in (0..).zip(read.inside.to_array()) {
                let found = (inside, 4 * parent + lane);
                if inside > next[0].0 {
                    next = [found, next[0]];
                } else if inside > next[1].0 {
                    next[1] = found;
                }
            }
            if read.in_contact != 0 && read.inside.simd_gt(f32x4::splat(best.reach * side.reach())).any() {
                side.contacts(&points, &read, |lane, found| {
                    if found.reach > best.reach {
                        let index = 4 * parent + lane as u32;
                        best = ContactSample { sample: Sample { level, index }, ..found };
                    }
                });
            }
        }
        followed = [next[0].1, next[1].1, NONE, NONE];
    }
    best
}
