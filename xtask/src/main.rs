//! `cargo xtask`: set-up, view, test, pack.
fn main() {}
