//! Poses and fields of view as a headset states them.

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// A place and a direction, as a runtime states them (f32): x right, y up, z back.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Unit quaternion `(x, y, z, w)`.
    #[serde(with = "exact")]
    pub orientation: [f32; 4],
    /// Metres.
    #[serde(with = "exact")]
    pub position: [f32; 3],
}

impl Default for Pose {
    fn default() -> Self {
        Self { orientation: [0.0, 0.0, 0.0, 1.0], position: [0.0; 3] }
    }
}

impl Pose {
    /// The orientation, of length 1 in f64; the identity where the runtime states none.
    pub fn rotation(&self) -> DQuat {
        let q = DQuat::from_array(self.orientation.map(f64::from));
        let length = q.length();
        if length > 0.5 && length.is_finite() { q / length } else { DQuat::IDENTITY }
    }

    /// The position in f64.
    pub fn place(&self) -> DVec3 {
        DVec3::from_array(self.position.map(f64::from))
    }

    /// Midway between two poses: the head, from its eyes. Canted displays turn the eyes apart; the middle does not.
    pub fn between(a: &Self, b: &Self) -> Self {
        let rotation = a.rotation().slerp(b.rotation(), 0.5);
        let place = (a.place() + b.place()) / 2.0;
        Self {
            orientation: rotation.to_array().map(|v| v as f32),
            position: place.to_array().map(|v| v as f32),
        }
    }

    /// Where its −z axis points: for an aim pose, along the ray.
    pub fn forward(&self) -> DVec3 {
        self.rotation() * DVec3::NEG_Z
    }
}

/// Angles from the forward axis to the four edges of an eye's image, radians; `left` and `down` are usually negative.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EyeFov {
    /// To the left edge.
    #[serde(with = "exact_one")]
    pub left: f32,
    /// To the right edge.
    #[serde(with = "exact_one")]
    pub right: f32,
    /// To the upper edge.
    #[serde(with = "exact_one")]
    pub up: f32,
    /// To the lower edge.
    #[serde(with = "exact_one")]
    pub down: f32,
}

impl EyeFov {
    /// The tangents of the angles, in the renderer's signs (y down).
    pub fn tangents(&self) -> motes_renderer::Fov {
        let tan = |angle: f32| f64::from(angle).tan();
        motes_renderer::Fov {
            left: tan(self.left),
            right: tan(self.right),
            up: -tan(self.up),
            down: -tan(self.down),
        }
    }
}

/// One eye at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Eye {
    /// Where it is, in the stage.
    pub pose: Pose,
    /// What it sees.
    pub fov: EyeFov,
}

/// Floats that a file gives back bit for bit: an f32 is written as the f64 that it is, so that a reader that is off by
/// one unit in the last place of the f64 still rounds to the same f32.
mod exact {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer, const N: usize>(values: &[f32; N], s: S) -> Result<S::Ok, S::Error> {
        values.map(f64::from).as_slice().serialize(s)
    }

    pub fn deserialize<'de, D: Deserializer<'de>, const N: usize>(d: D) -> Result<[f32; N], D::Error> {
        let values = Vec::<f64>::deserialize(d)?;
        let values: [f64; N] =
            values.try_into().map_err(|v: Vec<f64>| D::Error::invalid_length(v.len(), &"another count"))?;
        Ok(values.map(|v| v as f32))
    }
}

/// [`exact`] for one value.
mod exact_one {
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(value: &f32, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_f64(f64::from(*value))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<f32, D::Error> {
        Ok(f64::deserialize(d)? as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motes_scenes::synthetic::Random;

    #[test]
    fn a_file_gives_back_every_bit() {
        let mut random = Random::new(5);
        let mut any = || loop {
            let v = f32::from_bits(random.bits() as u32);
            if v.is_finite() {
                break v;
            }
        };
        for _ in 0..2000 {
            let pose = Pose { orientation: [any(), any(), any(), any()], position: [any(), any(), any()] };
            let eye = Eye { pose, fov: EyeFov { left: any(), right: any(), up: any(), down: any() } };
            let text = serde_json::to_string(&eye).unwrap();
            assert_eq!(serde_json::from_str::<Eye>(&text).unwrap(), eye, "{text}");
        }
        let short = r#"{"orientation":[0,0,0],"position":[0,0,0]}"#;
        assert!(serde_json::from_str::<Pose>(short).is_err());
    }

    #[test]
    fn an_orientation_of_no_length_is_the_identity() {
        for orientation in [[0.0; 4], [f32::NAN; 4], [f32::INFINITY, 0.0, 0.0, 0.0]] {
            let pose = Pose { orientation, ..Pose::default() };
            assert_eq!(pose.rotation(), DQuat::IDENTITY);
        }
        let pose = Pose { orientation: [0.0, 2.0, 0.0, 2.0], ..Pose::default() };
        assert!((pose.rotation().length() - 1.0).abs() < 1e-15);
        assert!((pose.forward() - DVec3::NEG_X).length() < 1e-12, "a quarter turn to the left");
    }
}
