//! Quantities swept over their whole range: every rung stays within its bound of its own f64 twin everywhere.
//! `cargo xtask stability` draws the same sweeps as plots.

use motes_renderer::Precision;
use motes_tests::hard::rig::Rig;
use motes_tests::hard::sweeps::{self, Rung, VALID};

/// Values per sweep; the stability report takes more.
const VALUES: usize = 9;

#[test]
fn every_rung_stays_within_its_bound() {
    let mut rig = Rig::new();
    let mut wrong = Vec::new();
    // Controls: halves in everything must break somewhere, and so must the affine approximation.
    let (mut naive, mut affine) = (0.0f64, 0.0f64);
    for sweep in sweeps::all() {
        for value in sweep.values(VALUES) {
            if sweep.name == "resolution" && value > 600.0 {
                continue; // the report goes up to 4096: a second a picture for the reference
            }
            for (rung, sample) in Rung::ALL.into_iter().zip(sweep.measure(&mut rig, value)) {
                match sweep.bound_of(rung, value) {
                    Some(bound) if !(sample.own.worst <= bound) => {
                        let found = sample.own.worst;
                        wrong.push(format!(
                            "{} at {value:.3e}, {}: {found:.2} of {bound}",
                            sweep.name,
                            rung.name()
                        ));
                    }
                    _ => {}
                }
                if rung.precision == Precision::F16Naive {
                    naive = naive.max(sample.own.worst);
                }
                if rung == Rung::ALL[0] && sweep.name == "field-of-view" {
                    affine = affine.max(sample.truth.worst);
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(naive > 50.0, "naive halves pass with {naive}: the sweeps test nothing");
    assert!(affine > VALID, "affine at 170 degrees passes with {affine}");
}
