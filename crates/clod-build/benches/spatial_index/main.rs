//! What the spatial index of simplification costs: our tree of boxes against `obvhs` and against a grid.
//!
//! `cargo bench -p palpate-clod-build --bench spatial_index`; `… -- /10000/` for a short one. Each index goes through
//! the same collapses, of a torus down to a sixteenth of its triangles; the throughput is in collapses. What comes of
//! it stands in the documentation of `box_tree.rs`.

#![allow(missing_docs, reason = "a benchmark")]

#[path = "../../src/box_tree.rs"]
#[allow(dead_code, unused_imports, reason = "the bench uses some of it")]
mod box_tree;
mod collapses;
mod grid;
mod hierarchy;

use std::cell::OnceCell;

use box_tree::{Bounds, BoxTree, EMPTY, meet};
use collapses::{Collapse, Collapses};
use criterion::{BatchSize, BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use grid::Grid;
use hierarchy::{Moving, Refitted};

/// A spatial index over triangles, of which it holds the boxes.
trait Index {
    fn new(boxes: &[Bounds]) -> Self;
    /// How many triangles' boxes meet a box.
    fn count(&mut self, query: Bounds) -> usize;
    fn moved(&mut self, triangle: u32, bounds: Bounds);
    fn removed(&mut self, triangle: u32);
    /// Half of the triangles are gone.
    fn halved(&mut self);
}

struct Ours {
    boxes: Vec<Bounds>,
    tree: BoxTree,
    stack: Vec<u32>,
}

impl Index for Ours {
    fn new(boxes: &[Bounds]) -> Self {
        Self { boxes: boxes.to_vec(), tree: BoxTree::new(boxes), stack: Vec::new() }
    }

    fn count(&mut self, query: Bounds) -> usize {
        let mut count = 0;
        let boxes = &self.boxes;
        self.tree.any_near(query, &mut self.stack, |t| {
            count += usize::from(meet(boxes[t as usize], query));
            false
        });
        count
    }

    fn moved(&mut self, triangle: u32, bounds: Bounds) {
        let Self { boxes, tree, .. } = self;
        boxes[triangle as usize] = bounds;
        tree.refit(triangle, |t| boxes[t as usize]);
    }

    fn removed(&mut self, triangle: u32) {
        self.moved(triangle, EMPTY);
    }

    fn halved(&mut self) {
        self.tree = BoxTree::new(&self.boxes);
    }
}

/// All collapses, each with some tries of which each asks for the surroundings; how many triangles were found.
///
/// Not inlined, so that `valgrind --tool=callgrind --toggle-collect='*replay*' … --bench --test FILTER` counts it alone
/// (together with [`agree`], whose share is what a filter that nothing passes leaves).
#[inline(never)]
fn replay<I: Index>(index: &mut I, collapses: &Collapses, tries: usize) -> usize {
    let (mut found, mut left) = (0, collapses.boxes.len());
    let mut halved = left;
    for Collapse { query, moved, removed } in &collapses.all {
        for _ in 0..tries {
            found += index.count(*query);
        }
        for t in removed {
            index.removed(*t);
        }
        for (t, bounds) in moved {
            index.moved(*t, *bounds);
        }
        left -= removed.len();
        if left < halved / 2 {
            halved = left;
            index.halved();
        }
    }
    found
}

fn bench<I: Index>(criterion: &mut Criterion, name: &str) {
    let mut group = criterion.benchmark_group(name);
    group.sample_size(10).warm_up_time(std::time::Duration::from_millis(100));
    for triangles in [10_000, 100_000, 1_000_000] {
        let made = OnceCell::new();
        for tries in [0, 1, 8] {
            let collapses = || made.get_or_init(|| Collapses::of_a_torus(triangles));
            group.bench_function(BenchmarkId::new(format!("{triangles}/tries"), tries), |bencher| {
                let collapses = collapses();
                bencher.iter_batched_ref(
                    || I::new(&collapses.boxes),
                    |index| replay(index, collapses, tries),
                    BatchSize::PerIteration,
                );
            });
            if let Some(collapses) = made.get() {
                group.throughput(Throughput::Elements(collapses.all.len() as u64));
            }
        }
    }
    group.finish();
}

fn indices(criterion: &mut Criterion) {
    agree();
    bench::<Ours>(criterion, "ours");
    bench::<Refitted>(criterion, "obvhs, refitted");
    bench::<Moving>(criterion, "obvhs, moving");
    bench::<Grid<false>>(criterion, "grid");
    bench::<Grid<true>>(criterion, "grid, made anew");
}

/// All of them find the same.
fn agree() {
    let collapses = Collapses::of_a_torus(3000);
    let expected = replay(&mut Ours::new(&collapses.boxes), &collapses, 1);
    assert_eq!(replay(&mut Refitted::new(&collapses.boxes), &collapses, 1), expected);
    assert_eq!(replay(&mut Moving::new(&collapses.boxes), &collapses, 1), expected);
    assert_eq!(replay(&mut Grid::<false>::new(&collapses.boxes), &collapses, 1), expected);
    assert_eq!(replay(&mut Grid::<true>::new(&collapses.boxes), &collapses, 1), expected);
}

criterion_group!(benches, indices);
criterion_main!(benches);
