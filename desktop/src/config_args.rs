//! The render configuration on the command line, generated from [`CHOICES`]: an option per field, and presets.

use clap::builder::{PossibleValue, PossibleValuesParser};
use clap::{Arg, ArgAction, ArgMatches, Command};
use motes_app::quality::{Quality, Table};
use motes_renderer::gpu::Gpu;
use motes_renderer::plan::Overrides;
use motes_renderer::{CHOICES, Choice, Kind, PRESETS, RenderConfig, View};

/// What was said about how to draw.
#[derive(Clone, Debug, Default)]
pub struct ConfigArgs {
    preset: Option<String>,
    quality: Option<RenderConfig>,
    by_plan: bool,
    /// Names and values, valid each.
    given: Vec<(&'static str, String)>,
}

impl ConfigArgs {
    /// The preset, or what the quality stands for, with the given values.
    pub fn config(&self) -> RenderConfig {
        let preset = PRESETS.iter().find(|p| Some(p.name) == self.preset.as_deref());
        let base = || self.quality.clone().unwrap_or_default();
        let mut config = preset.map_or_else(base, |p| (p.config)());
        for (name, value) in &self.given {
            // The parser has let only values through that can be set.
            if let Some(choice) = Choice::named(name)
                && let Err(error) = choice.set(&mut config, value)
            {
                log::error!("--{name}: {error}");
            }
        }
        config
    }

    /// A configuration with the expansion that is fastest on a device for so many splats, where none was asked for.
    pub fn on(&self, config: RenderConfig, gpu: &Gpu, splats: u32, views: &[View]) -> RenderConfig {
        if self.leaves_expansion() { config.on(&gpu.capabilities, splats, views) } else { config }
    }

    /// Whether nobody has said which expansion to draw with.
    pub fn leaves_expansion(&self) -> bool {
        !self.names("expansion") && self.preset.is_none()
    }

    /// What goes before the scene's plan, where scenes are drawn by plan.
    pub fn by_plan(&self) -> Option<Overrides> {
        let config = self.config();
        self.by_plan.then(|| Overrides {
            sh_degree: self.names("sh-degree").then_some(config.sh_degree),
            sh_precision: self.names("sh-precision").then_some(config.sh_precision),
            precision: self.names("precision").then_some(config.precision),
            projection: self.names("projection").then_some(config.projection),
        })
    }

    /// The preset's name, where one was given.
    pub fn preset(&self) -> Option<&str> {
        self.preset.as_deref()
    }

    /// Whether a field was named.
    pub fn names(&self, field: &str) -> bool {
        self.given.iter().any(|(name, _)| *name == field)
    }
}

/// What a quality stands for.
fn quality(text: &str) -> Result<RenderConfig, String> {
    let quality: Quality = text.parse()?;
    Table::built_in().and_then(|table| table.config(quality)).map_err(|e| e.to_string())
}

impl clap::FromArgMatches for ConfigArgs {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let text = |name: &str| matches.get_one::<String>(name).cloned();
        let given = CHOICES.iter().filter_map(|c| Some((c.name, text(c.name)?))).collect();
        let quality = matches.get_one::<RenderConfig>("quality").cloned();
        Ok(Self { preset: text("preset"), quality, by_plan: matches.get_flag("by-plan"), given })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl clap::Args for ConfigArgs {
    fn augment_args(command: Command) -> Command {
        const HEADING: &str = "How it is drawn";
        let presets = PRESETS.iter().map(|p| PossibleValue::new(p.name).help(p.about));
        let preset = Arg::new("preset")
            .long("preset")
            .value_name("NAME")
            .value_parser(PossibleValuesParser::new(presets))
            .help("Choices that belong together; options change them further");
        let quality = Arg::new("quality")
            .long("quality")
            .value_name("exact|balanced|fast|FLIP")
            .conflicts_with("preset")
            .value_parser(quality)
            .help("The cheapest way that came so close on every scene that was measured (motes bench)");
        let by_plan = Arg::new("by-plan")
            .long("by-plan")
            .action(ArgAction::SetTrue)
            .conflicts_with_all(["preset", "quality"])
            .help("Only the effects that the scene calls for (motes info --plan); options override them");
        let mut arguments = vec![preset, quality, by_plan];
        for choice in CHOICES {
            let argument = Arg::new(choice.name).long(choice.name).help(choice.about);
            arguments.push(match choice.kind {
                Kind::Names(names) => {
                    let values =
                        names().into_iter().map(|(name, about)| PossibleValue::new(name).help(about));
                    argument.value_name("NAME").value_parser(PossibleValuesParser::new(values))
                }
                Kind::Switch => argument
                    .num_args(0..=1)
                    .default_missing_value("true")
                    .value_name("true|false")
                    .value_parser(PossibleValuesParser::new(["true", "false"])),
                Kind::Whole(..) | Kind::Number(..) | Kind::Magnitude(..) | Kind::Colour => argument
                    .value_name(if matches!(choice.kind, Kind::Colour) { "R,G,B" } else { "N" })
                    .value_parser(|text: &str| {
                        choice.set(&mut RenderConfig::default(), text).map(|()| text.to_owned())
                    }),
            });
        }
        command.args(arguments.into_iter().map(|a| a.help_heading(HEADING)))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may")]
mod tests {
    use super::*;
    use clap::Parser;
    use motes_renderer::{OrderKey, Projection, QuadShape};

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        config: ConfigArgs,
    }

    fn parse(line: &str) -> Result<RenderConfig, clap::Error> {
        Line::try_parse_from(std::iter::once("motes").chain(line.split_whitespace()))
            .map(|l| l.config.config())
    }

    #[test]
    fn options_change_a_preset() {
        assert_eq!(parse("").unwrap(), RenderConfig::default());
        let config =
            parse("--preset inria --shape square --stop-below 1/255 --sort-per-eye --background 1,0,0.5");
        let config = config.unwrap();
        assert_eq!((config.projection, config.order), (Projection::Affine, OrderKey::Depth));
        assert_eq!((config.shape, config.sort_per_eye), (QuadShape::Square, true));
        assert_eq!(config.background, [1.0, 0.0, 0.5]);
        assert!(!parse("--sort-per-eye false").unwrap().sort_per_eye);
    }

    #[test]
    fn a_quality_is_what_was_measured() {
        let table = Table::built_in().unwrap();
        let fast = parse("--quality fast").unwrap();
        assert_eq!(fast, table.config(Quality::Fast).unwrap());
        let shaped = parse("--quality fast --shape axis-aligned").unwrap();
        assert_eq!(shaped, RenderConfig { shape: QuadShape::AxisAligned, ..fast });
        // Everything is within an error of 1: the cheapest of all.
        let cheapest = table.points.last().unwrap();
        assert_eq!(parse("--quality 1").unwrap(), table.config(Quality::Within(cheapest.flip)).unwrap());
        for line in ["--quality best", "--quality 0", "--quality fast --preset inria"] {
            assert!(parse(line).is_err(), "{line}");
        }
    }

    #[test]
    fn options_go_before_the_plan() {
        let line = |text: &str| {
            Line::try_parse_from(std::iter::once("motes").chain(text.split_whitespace())).map(|l| l.config)
        };
        assert_eq!(line("--precision f16").unwrap().by_plan(), None);
        let overrides = line("--by-plan --sh-degree 1 --projection exact").unwrap().by_plan().unwrap();
        let expected = Overrides {
            sh_degree: Some(1),
            projection: Some(motes_renderer::Projection::Exact),
            ..Default::default()
        };
        assert_eq!(overrides, expected);
        assert!(line("--by-plan --preset inria").is_err() && line("--by-plan --quality fast").is_err());
    }

    #[test]
    fn what_is_not_offered_is_refused() {
        for line in
            ["--projection cubist", "--near close", "--preset none", "--background 1,2", "--batches 2.5"]
        {
            assert!(parse(line).is_err(), "{line}");
        }
    }
}
