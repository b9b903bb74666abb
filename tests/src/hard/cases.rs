//! The list of hard cases: what is drawn, what must hold, and what must not pass.

use super::rig::Rig;
use super::{colour, input, order, view};

/// What a case measured.
#[derive(Clone, Debug)]
pub struct Found {
    /// The figure that the bound is about; larger is worse.
    pub worst: f64,
    /// Where it was found.
    pub place: String,
    /// The same figure on input that is wrong on purpose: must be above the bound.
    pub control: f64,
}

impl Found {
    /// A figure, where it was found, and the control's figure.
    pub fn new(worst: f64, place: impl Into<String>, control: f64) -> Self {
        Self { worst, place: place.into(), control }
    }
}

/// One row of the hard cases.
pub struct Case {
    /// Part of the list: input, view, colour, order.
    pub group: &'static str,
    /// The test's name.
    pub name: &'static str,
    /// What breaks viewers.
    pub row: &'static str,
    /// What must hold.
    pub property: &'static str,
    /// Largest allowed figure.
    pub bound: f64,
    /// Its unit.
    pub unit: &'static str,
    /// Draws and measures.
    pub measure: Measure,
}

/// A measurement.
pub type Measure = fn(&mut Rig) -> Found;

/// Writes rows of a part of the list: name, what breaks viewers, what must hold, bound, its unit, measurement.
pub(super) fn rows(
    group: &'static str,
) -> impl Fn(&'static str, &'static str, &'static str, f64, &'static str, Measure) -> Case {
    move |name, row, property, bound, unit, measure| Case { group, name, row, property, bound, unit, measure }
}

/// Distance from the reference: steps of an 8-bit image, worst pixel.
pub const STEPS: &str = "1/255";
/// Pixels that differ at all.
pub const PIXELS: &str = "pixels";

/// Every case, by group.
pub fn all() -> Vec<Case> {
    [input::cases(), view::cases(), colour::cases(), order::cases()].into_iter().flatten().collect()
}

/// Runs the cases of a group and says what is wrong with them.
///
/// # Errors
/// One line for each case above its bound, and for each control that is not.
pub fn run(group: &str) -> Result<(), String> {
    let mut rig = Rig::new();
    let mut wrong = Vec::new();
    for case in all().iter().filter(|c| c.group == group) {
        let Found { worst, place, control } = (case.measure)(&mut rig);
        println!("{}: {worst:.3} of {} {} ({place}); control {control:.3}", case.name, case.bound, case.unit);
        if !(worst <= case.bound) {
            wrong.push(format!("{}: {worst} is above {} {} ({place})", case.name, case.bound, case.unit));
        }
        if !(control > case.bound) {
            wrong.push(format!("{}: the control passes with {control}: the case tests nothing", case.name));
        }
    }
    if wrong.is_empty() { Ok(()) } else { Err(wrong.join("\n")) }
}
