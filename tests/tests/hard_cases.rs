//! Every row of the hard cases, drawn in every projection and expansion, mono and stereo, against the f64 reference.
//! The cases themselves, their bounds and their controls are in `src/hard`; docs/stability.md lists them.

use motes_tests::hard::cases;

#[test]
fn hard_input() -> Result<(), String> {
    cases::run("input")
}

#[test]
fn hard_views() -> Result<(), String> {
    cases::run("view")
}

#[test]
fn hard_colours() -> Result<(), String> {
    cases::run("colour")
}

#[test]
fn hard_orders() -> Result<(), String> {
    cases::run("order")
}
