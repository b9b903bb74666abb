//! The render configuration on the command line, generated from [`CHOICES`]: an option per field, and presets.

use clap::builder::{PossibleValue, PossibleValuesParser};
use clap::{Arg, ArgMatches, Command};
use motes_renderer::{CHOICES, Choice, Kind, PRESETS, RenderConfig};

/// What was said about how to draw.
#[derive(Clone, Debug, Default)]
pub struct ConfigArgs {
    preset: Option<String>,
    /// Names and values, valid each.
    given: Vec<(&'static str, String)>,
}

impl ConfigArgs {
    /// The preset with the given values.
    pub fn config(&self) -> RenderConfig {
        let preset = PRESETS.iter().find(|p| Some(p.name) == self.preset.as_deref());
        let mut config = preset.map_or_else(RenderConfig::default, |p| (p.config)());
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

    /// The preset's name, where one was given.
    pub fn preset(&self) -> Option<&str> {
        self.preset.as_deref()
    }

    /// Whether a field was named.
    pub fn names(&self, field: &str) -> bool {
        self.given.iter().any(|(name, _)| *name == field)
    }
}

impl clap::FromArgMatches for ConfigArgs {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let text = |name: &str| matches.get_one::<String>(name).cloned();
        let given = CHOICES.iter().filter_map(|c| Some((c.name, text(c.name)?))).collect();
        Ok(Self { preset: text("preset"), given })
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
        let mut arguments = vec![preset];
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
    fn what_is_not_offered_is_refused() {
        for line in
            ["--projection cubist", "--near close", "--preset none", "--background 1,2", "--batches 2.5"]
        {
            assert!(parse(line).is_err(), "{line}");
        }
    }
}
