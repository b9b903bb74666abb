//! The splats that a region of a picture shows: what a brush or a box on the screen is meant for.

use motes_scenes::Splats;

use super::sums::Sums;
use crate::View;
use crate::reference::{self, ReferenceError, ReferenceOptions};

/// A splat shows where it has at least this share of some marked pixel.
const SHOWS: f64 = 0.02;
/// A splat is meant where at least this share of all that the view shows of it lies in the region: a wall is not, where the
/// brush goes over a corner of it.
const MEANT: f64 = 0.5;

/// The splats that the marked pixels (by rows, one a pixel of the view) show, rising. What is hidden behind them is not
/// among them.
///
/// # Errors
/// Marks that are not one a pixel, or the reference's.
pub fn marked(
    splats: &Splats,
    view: &View,
    marks: &[bool],
    options: &ReferenceOptions,
) -> Result<Vec<u32>, ReferenceError> {
    let width = view.size[0] as usize;
    if marks.len() != width * view.size[1] as usize {
        let what = format!("{} marks are not one for each pixel of {:?}", marks.len(), view.size);
        return Err(ReferenceError::View { what });
    }
    let n = splats.len();
    let (inside, whole, peak) = (Sums::new(n), Sums::new(n), Sums::new(n));
    reference::trace(splats, view, options, |[x, y], layers| {
        let mark = marks[y as usize * width + x as usize];
        for layer in layers {
            let (i, weight) = (layer.splat as usize, layer.weight());
            whole.add(i, weight);
            if mark {
                inside.add(i, weight);
                peak.raise(i, weight);
            }
        }
    })?;
    let each = inside.values().zip(whole.values()).zip(peak.values());
    let meant = |((inside, whole), peak): ((f64, f64), f64)| peak >= SHOWS && inside >= MEANT * whole;
    Ok((0..).zip(each).filter(|(_, of)| meant(*of)).map(|(i, _)| i).collect())
}

#[cfg(test)]
mod tests {
    use super::super::tests::{ahead, balls};
    use super::*;

    #[test]
    fn what_shows_in_the_region_is_meant_and_nothing_else() {
        let splats = balls(&[
            ([-0.8, 0.0, 3.0], 0.4, 0.99, [1.0; 3]), // left
            ([0.8, 0.0, 3.0], 0.1, 0.95, [1.0; 3]),  // right
            ([-1.6, 0.0, 6.0], 0.05, 0.3, [1.0; 3]), // hidden behind the left one
            ([0.0, 0.0, 8.0], 9.0, 0.5, [1.0; 3]),   // behind all
        ]);
        let (view, options) = (ahead(), ReferenceOptions::default());
        let half = |left: bool| (0..32 * 32).map(|i| (i % 32 < 16) == left).collect::<Vec<_>>();
        let found = |marks: &[bool]| marked(&splats, &view, marks, &options).unwrap();
        assert_eq!(found(&half(true)), [0]);
        assert!(found(&half(false)).contains(&1) && !found(&half(false)).contains(&0));
        assert!(found(&[false; 1024]).is_empty());
        // Control: all of the picture shows everything but what is hidden.
        assert_eq!(found(&[true; 1024]), [0, 1, 3]);
        assert!(marked(&splats, &view, &[true; 7], &options).is_err());
    }
}
