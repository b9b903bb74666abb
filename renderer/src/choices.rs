//! Every field of [`RenderConfig`] by its name, as text: what the command line parses, the panel shows and a report
//! prints. A new field is one line in [`CHOICES`].

use crate::config::{
    Axis, Composite, Expansion, KeyBits, Lens, LowPass, Marks, OrderKey, Precision, Projection, QuadShape,
    RadiusRule, RenderConfig, ShPrecision, Sorter, TargetFormat, TimeCull, Upscale,
};

/// How a choice is made.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// One of some names, each with a line about it.
    Names(fn() -> Vec<(&'static str, &'static str)>),
    /// Yes or no.
    Switch,
    /// A whole number in a range.
    Whole(u32, u32),
    /// A number in a range. The range is what makes sense; [`RenderConfig::check`] decides what is allowed.
    Number(f32, f32),
    /// A positive number whose order of magnitude counts, in a range.
    Magnitude(f32, f32),
    /// Three numbers from 0 to 1, sRGB-encoded.
    Colour,
}

/// A field of [`RenderConfig`].
pub struct Choice {
    /// Its name on the command line.
    pub name: &'static str,
    /// What it decides, one line.
    pub about: &'static str,
    /// How it is made.
    pub kind: Kind,
    get: fn(&RenderConfig) -> String,
    set: fn(&mut RenderConfig, &str) -> Result<(), String>,
}

impl Choice {
    /// The value in a configuration, as [`Choice::set`] reads it.
    pub fn get(&self, config: &RenderConfig) -> String {
        (self.get)(config)
    }

    /// Changes the value in a configuration.
    ///
    /// # Errors
    /// A sentence that says what was expected.
    pub fn set(&self, config: &mut RenderConfig, value: &str) -> Result<(), String> {
        (self.set)(config, value.trim())
    }

    /// The choice with a name.
    pub fn named(name: &str) -> Option<&'static Self> {
        CHOICES.iter().find(|c| c.name == name)
    }
}

/// A value with a textual form.
trait Text: Sized {
    fn write(&self) -> String;
    fn read(text: &str) -> Result<Self, String>;
}

impl<A: Axis> Text for A {
    fn write(&self) -> String {
        self.name().to_owned()
    }

    fn read(text: &str) -> Result<Self, String> {
        Self::ALL.iter().copied().find(|v| v.name() == text).ok_or_else(|| {
            let names: Vec<_> = Self::ALL.iter().map(|v| v.name()).collect();
            format!("'{text}' is none of: {}", names.join(", "))
        })
    }
}

macro_rules! plain_text {
    ($($type:ty: $expected:literal),+) => {$(
        impl Text for $type {
            fn write(&self) -> String {
                self.to_string()
            }

            fn read(text: &str) -> Result<Self, String> {
                text.parse().map_err(|_| format!(concat!("'{}' is not ", $expected), text))
            }
        }
    )+};
}

plain_text!(bool: "true or false", u32: "a whole number", u8: "a small whole number");

impl Text for f32 {
    fn write(&self) -> String {
        self.to_string()
    }

    /// A number, or a fraction: thresholds are often `1/255`.
    fn read(text: &str) -> Result<Self, String> {
        let number = |t: &str| t.trim().parse::<Self>().map_err(|_| format!("'{text}' is not a number"));
        match text.split_once('/') {
            Some((over, under)) => Ok(number(over)? / number(under)?),
            None => number(text),
        }
    }
}

impl Text for [f32; 3] {
    fn write(&self) -> String {
        self.map(|c| c.to_string()).join(",")
    }

    fn read(text: &str) -> Result<Self, String> {
        let parts: Vec<_> = text.split(',').map(f32::read).collect::<Result<_, _>>()?;
        parts.try_into().map_err(|_| format!("'{text}' is not three numbers, like 0,0.5,1"))
    }
}

fn names<A: Axis>() -> Vec<(&'static str, &'static str)> {
    A::ALL.iter().map(|v| (v.name(), v.about())).collect()
}

macro_rules! choice {
    ($field:ident: $axis:ty, $about:literal) => {
        choice!($field, <$axis as Axis>::NAME, Kind::Names(names::<$axis>), $about)
    };
    ($field:ident, $name:expr, $kind:expr, $about:literal) => {
        Choice {
            name: $name,
            about: $about,
            kind: $kind,
            get: |c| Text::write(&c.$field),
            set: |c, text| Text::read(text).map(|value| c.$field = value),
        }
    };
}

/// Every field, in the order of the structure.
pub const CHOICES: &[Choice] = &[
    choice!(expansion: Expansion, "Where a splat becomes a polygon"),
    choice!(projection: Projection, "How a splat is projected"),
    choice!(lens: Lens, "How directions become places in the image"),
    choice!(low_pass: LowPass, "The filter that keeps small splats from flickering"),
    choice!(shape: QuadShape, "The polygon that covers a splat"),
    choice!(radius: RadiusRule, "How far a splat's polygon reaches"),
    choice!(
        max_radius,
        "max-radius",
        Kind::Magnitude(0.01, f32::INFINITY),
        "Largest projected radius, as a fraction of the larger image side (inf: no cap)"
    ),
    choice!(order: OrderKey, "What splats are ordered by"),
    choice!(key_bits: KeyBits, "Bits of the sort key"),
    choice!(sorter: Sorter, "Who sorts"),
    choice!(sort_per_eye, "sort-per-eye", Kind::Switch, "An own order for each eye"),
    choice!(sort_interval, "sort-interval", Kind::Whole(1, 60), "A new order every n-th frame"),
    choice!(samples, "samples", Kind::Whole(1, 4096), "Stochastic: frames that a picture is averaged from"),
    choice!(time_cull: TimeCull, "Which splats of a moving scene a frame looks at"),
    choice!(composite: Composite, "In which direction splats are blended"),
    choice!(batches, "batches", Kind::Whole(2, 128), "Early stop: batches per frame"),
    choice!(marks, "marks", Kind::Names(names::<Marks>), "Early stop: where saturated pixels are looked for"),
    choice!(
        stop_below,
        "stop-below",
        Kind::Magnitude(1e-4, 0.5),
        "Early stop: transmittance below which a pixel is finished"
    ),
    choice!(precision: Precision, "How splats are stored on the device"),
    choice!(sh_precision: ShPrecision, "How spherical harmonics are stored on the device"),
    choice!(sh_degree, "sh-degree", Kind::Whole(0, 3), "Highest degree of spherical harmonics"),
    choice!(target: TargetFormat, "Format of the image that splats are blended into"),
    choice!(
        resolution_scale,
        "resolution-scale",
        Kind::Number(0.5, 1.0),
        "Side of the rendered image over the side of the shown one"
    ),
    choice!(upscale: Upscale, "How a reduced resolution is brought back to full size"),
    choice!(sharpen, "sharpen", Kind::Number(0.0, 1.0), "Sharpening of the shown image (0: none)"),
    choice!(min_opacity, "min-opacity", Kind::Magnitude(1e-4, 0.5), "Splats of lower opacity are left out"),
    choice!(
        min_contribution,
        "min-contribution",
        Kind::Number(0.0, 10.0),
        "Splats whose whole contribution (pixels) is lower are left out"
    ),
    choice!(near, "near", Kind::Magnitude(1e-3, 10.0), "Nearest depth that is drawn, metres"),
    choice!(near_fade, "near-fade", Kind::Number(0.0, 1.0), "Splats fade in over this distance, metres"),
    choice!(background, "background", Kind::Colour, "Colour behind the splats, sRGB-encoded"),
    choice!(time, "time", Kind::Number(0.0, 1.0), "Moment of a moving scene"),
];

/// A configuration with a name.
pub struct Preset {
    /// Its name on the command line.
    pub name: &'static str,
    /// What it stands for, one line.
    pub about: &'static str,
    /// Makes it.
    pub config: fn() -> RenderConfig,
}

/// Configurations with a name.
pub const PRESETS: &[Preset] = &[
    Preset {
        name: "default",
        about: "Optimal projection, octagons, early stop",
        config: RenderConfig::default,
    },
    Preset {
        name: "inria",
        about: "The trainers' semantics: affine, depth order, every layer",
        config: RenderConfig::inria,
    },
    Preset {
        name: "quest-report",
        about: "The Quest report's viewer: geometry stage, squares, back to front",
        config: RenderConfig::quest_report,
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    /// A field that was forgotten here would be missing from the command line, the panel and every report.
    #[test]
    fn every_field_is_a_choice() {
        let json = serde_json::to_value(RenderConfig::default()).unwrap();
        let mut fields: Vec<_> = json.as_object().unwrap().keys().map(|k| k.replace('_', "-")).collect();
        let mut names: Vec<_> = CHOICES.iter().map(|c| c.name.to_owned()).collect();
        let sorter = fields.iter_mut().find(|f| *f == "sorter").unwrap();
        *sorter = "sort".to_owned();
        let target = fields.iter_mut().find(|f| *f == "target").unwrap();
        *target = "target-format".to_owned();
        fields.sort();
        names.sort();
        assert_eq!(fields, names);
    }

    #[test]
    fn values_survive_their_text() {
        for preset in PRESETS {
            let wanted = (preset.config)();
            let mut config = RenderConfig { time: 0.5, near: 7.0, ..Default::default() };
            for choice in CHOICES {
                choice.set(&mut config, &choice.get(&wanted)).unwrap();
            }
            assert_eq!(config, wanted, "{}", preset.name);
        }
    }

    #[test]
    fn mistakes_are_explained() {
        let mut config = RenderConfig::default();
        let error = Choice::named("projection").unwrap().set(&mut config, "cubist").unwrap_err();
        assert!(error.contains("cubist") && error.contains("tangent"), "{error}");
        assert!(Choice::named("background").unwrap().set(&mut config, "1,2").is_err());
        assert!(Choice::named("near").unwrap().set(&mut config, "close").is_err());
        assert_eq!(config, RenderConfig::default());
        Choice::named("stop-below").unwrap().set(&mut config, "1/255").unwrap();
        assert_eq!(config, RenderConfig { stop_below: 1.0 / 255.0, ..RenderConfig::default() });
    }
}
