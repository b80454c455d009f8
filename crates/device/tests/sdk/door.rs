//! Test interface of a substitute library.

use std::collections::HashSet;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::ThreadId;

use crate::numbers::*;

static NUMBERS: [AtomicU64; COUNT] = [const { AtomicU64::new(0) }; COUNT];
static THREADS: Mutex<Option<HashSet<ThreadId>>> = Mutex::new(None);

#[unsafe(no_mangle)]
pub extern "C" fn fake_get(index: usize) -> f64 {
    f64::from_bits(NUMBERS[index].load(Ordering::SeqCst))
}

#[unsafe(no_mangle)]
pub extern "C" fn fake_set(index: usize, number: f64) {
    NUMBERS[index].store(number.to_bits(), Ordering::SeqCst);
}

/// Resets the library to its state when loaded: no wrench, the identity pose, and no calls.
#[unsafe(no_mangle)]
pub extern "C" fn fake_reset() {
    *THREADS.lock().unwrap() = None;
    (0..COUNT).for_each(|index| fake_set(index, 0.0));
    fake_set(POSE + 6, 1.0);
}

/// Whether the calling thread has made calls of the maker's functions.
#[unsafe(no_mangle)]
pub extern "C" fn fake_has_seen_me() -> bool {
    THREADS.lock().unwrap().as_ref().is_some_and(|all| all.contains(&std::thread::current().id()))
}

/// Records the calling thread.
pub fn called() {
    let mut threads = THREADS.lock().unwrap();
    let all = threads.get_or_insert_default();
    all.insert(std::thread::current().id());
    fake_set(CALLERS, all.len() as f64);
}

pub fn is(index: usize) -> bool {
    fake_get(index) != 0.0
}

pub fn count(index: usize) {
    fake_set(index, fake_get(index) + 1.0);
}

#[allow(dead_code)]
pub fn several<const N: usize>(first: usize) -> [f64; N] {
    std::array::from_fn(|index| fake_get(first + index))
}

/// Rotation of the pose, as the columns of its matrix.
#[allow(dead_code)]
pub fn columns() -> [[f64; 3]; 3] {
    let [x, y, z, w] = several(POSE + 3);
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}
