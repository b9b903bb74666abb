//! Comfort: how turning and moving are softened for who feels sick otherwise.

use serde::{Deserialize, Serialize};

/// Comfort options of the settings file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Comfort {
    /// Degrees of a snap turn; 0 turns smoothly.
    pub snap_degrees: f64,
    /// Degrees a second of the smooth turn.
    pub turn_speed: f64,
    /// Metres of the stage a second at full stick.
    pub walk_speed: f64,
    /// Darkens the rim while moving or turning smoothly, `0 ..= 1`: 0 is off.
    pub vignette: f64,
    /// The other hand leads.
    pub left_handed: bool,
}

impl Default for Comfort {
    fn default() -> Self {
        Self { snap_degrees: 30.0, turn_speed: 90.0, walk_speed: 1.5, vignette: 0.6, left_handed: false }
    }
}

impl Comfort {
    /// Whether the values can be used.
    ///
    /// # Errors
    /// The first that cannot, and what is possible.
    pub fn check(&self) -> Result<(), String> {
        let check = |name: &str, value: f64, most: f64| {
            if value >= 0.0 && value <= most {
                Ok(())
            } else {
                Err(format!("{name} must be 0 to {most}, not {value}"))
            }
        };
        check("snap_degrees", self.snap_degrees, 180.0)?;
        check("turn_speed", self.turn_speed, 720.0)?;
        check("walk_speed", self.walk_speed, 100.0)?;
        check("vignette", self.vignette, 1.0)
    }
}

/// The rim's darkness, which follows motion within a fifth of a second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vignette {
    strength: f64,
}

impl Vignette {
    /// Follows motion: `speed` is 0 at rest and 1 at full speed; `dt` in seconds.
    pub fn update(&mut self, speed: f64, comfort: &Comfort, dt: f64) {
        const SECONDS: f64 = 0.2;
        let wanted = comfort.vignette * speed.clamp(0.0, 1.0);
        let step = dt / SECONDS;
        self.strength += (wanted - self.strength).clamp(-step, step);
    }

    /// `0 ..= 1`; 0 shows nothing.
    pub fn strength(&self) -> f64 {
        self.strength
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rim_darkens_with_motion_and_clears_at_rest() {
        let comfort = Comfort::default();
        let mut rim = Vignette::default();
        rim.update(1.0, &comfort, 0.05);
        assert!((rim.strength() - 0.25).abs() < 1e-12);
        rim.update(1.0, &comfort, 1.0);
        assert_eq!(rim.strength(), 0.6);
        rim.update(0.0, &comfort, 0.06);
        assert!((rim.strength() - 0.3).abs() < 1e-12);
        rim.update(0.0, &comfort, 1.0);
        assert_eq!(rim.strength(), 0.0);
        rim.update(1.0, &Comfort { vignette: 0.0, ..comfort }, 1.0);
        assert_eq!(rim.strength(), 0.0);
    }

    #[test]
    fn values_out_of_range_are_named() {
        assert!(Comfort::default().check().is_ok());
        for bad in [f64::NAN, -1.0, 200.0] {
            let text = Comfort { snap_degrees: bad, ..Default::default() }.check().unwrap_err();
            assert!(text.contains("snap_degrees"), "{text}");
        }
    }
}
