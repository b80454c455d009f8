//! The examples of palpate are programs: `cargo run --release --example jaws`.
