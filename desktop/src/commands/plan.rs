//! `motes info --plan`: what a scene calls for, why, what it saves, and how to ask for something else.

use std::fmt;

use motes_renderer::plan::{Decision, Overrides, Plan};
use motes_renderer::{Precision, Projection, ShPrecision};
use motes_scenes::Scene;
use motes_scenes::statement::Statement;

/// What is asked for whatever the scene calls for.
#[derive(Clone, Debug, Default, clap::Args)]
#[command(next_help_heading = "The plan")]
pub struct PlanArgs {
    /// State which effects the scene is drawn with, why, and what that saves
    #[arg(long)]
    pub plan: bool,
    /// Plan with this highest degree of spherical harmonics
    #[arg(long, value_name = "N", requires = "plan", value_parser = clap::value_parser!(u8).range(0..=3))]
    pub sh_degree: Option<u8>,
    /// Plan with this storage of spherical harmonics
    #[arg(long, value_name = "NAME", requires = "plan")]
    pub sh_precision: Option<ShPrecision>,
    /// Plan with this storage of geometry
    #[arg(long, value_name = "NAME", requires = "plan")]
    pub precision: Option<Precision>,
    /// Plan with this projection
    #[arg(long, value_name = "NAME", requires = "plan")]
    pub projection: Option<Projection>,
}

impl PlanArgs {
    /// As the plan takes it.
    pub fn overrides(&self) -> Overrides {
        Overrides {
            sh_degree: self.sh_degree,
            sh_precision: self.sh_precision,
            precision: self.precision,
            projection: self.projection,
        }
    }
}

/// A decision, and what it would take to switch everything on that the scene has.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PlannedEffect {
    /// What the plan decides.
    #[serde(flatten)]
    pub decision: Decision,
    /// Bytes a splat that this effect takes with everything switched on.
    pub bytes_per_splat_switched_on: u64,
    /// The option that overrides it; `None`: the scene alone decides.
    pub option: Option<String>,
}

/// The plan of a scene in figures.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PlanReport {
    /// Every effect.
    pub effects: Vec<PlannedEffect>,
    /// Bytes of the splats on the device by the plan.
    pub bytes: u64,
    /// The same with everything switched on that the scene has data for.
    pub bytes_switched_on: u64,
    /// The same where every buffer exists in full precision whatever the scene holds.
    pub bytes_of_every_buffer: u64,
    /// The options that draw by the plan.
    pub options: Vec<String>,
    /// Pictures by plan, where nothing is asked for, and with everything switched on are at least this alike, dB.
    pub bound_db: f64,
}

impl PlanReport {
    /// Plans for a scene.
    pub fn of(scene: &Scene, statement: &Statement, overrides: &Overrides) -> Self {
        let plan = Plan::of(statement, overrides);
        let all = Plan::of(statement, &Overrides::EVERYTHING);
        let flag = |name: &str| format!("--{name}");
        let effect = |d: &Decision| {
            let mut switched_on = all.decisions.iter().filter(|a| a.topic == d.topic);
            PlannedEffect {
                bytes_per_splat_switched_on: switched_on.next().map_or(0, |a| a.bytes_per_splat),
                option: d.topic.option().map(flag),
                decision: d.clone(),
            }
        };
        let mut effects: Vec<_> = plan.decisions.iter().map(effect).collect();
        // What the plan leaves out whole is listed with what it would take.
        for missing in &all.decisions {
            if plan.decisions.iter().all(|d| d.topic != missing.topic) {
                let reason = "nothing to store".to_owned();
                let left_out = Decision { on: false, bytes_per_splat: 0, reason, ..missing.clone() };
                let left_out = Decision { choice: "none".into(), overridden: false, ..left_out };
                effects.push(effect(&left_out));
            }
        }
        let options = plan
            .decisions
            .iter()
            .filter_map(|d| Some([flag(d.topic.option()?), d.choice.clone()]))
            .flatten()
            .collect();
        let splats = &scene.splats;
        Self {
            effects,
            bytes: plan.packing.bytes(splats),
            bytes_switched_on: all.packing.bytes(splats),
            bytes_of_every_buffer: Plan::FULL_BYTES * splats.len() as u64,
            options,
            bound_db: Plan::BOUND_DB,
        }
    }
}

impl fmt::Display for PlanReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "\nplan: only what the scene calls for (bytes a splat, of those with everything switched on)"
        )?;
        for PlannedEffect { decision: d, bytes_per_splat_switched_on: whole, option } in &self.effects {
            let on = if d.on { "on" } else { "off" };
            let by = match (option, d.overridden) {
                (None, _) => "by the scene".to_owned(),
                (Some(option), false) => format!("by the scene (or {option})"),
                (Some(option), true) => format!("asked for by {option}"),
            };
            let bytes = format!("{} of {whole} B", d.bytes_per_splat);
            writeln!(f, "  {:18} {on:3}  {:8} {bytes:>12}  {by}", d.topic.name(), d.choice)?;
            writeln!(f, "  {:22}  {}", "", d.reason)?;
        }
        let mega = |bytes: u64| bytes as f64 / 1e6;
        let share = 100.0 * self.bytes as f64 / self.bytes_switched_on.max(1) as f64;
        writeln!(
            f,
            "  on the device: {:.2} MB of {:.2} MB with everything that the scene has switched on ({share:.0} %); {:.2} \
             MB where every buffer exists",
            mega(self.bytes),
            mega(self.bytes_switched_on),
            mega(self.bytes_of_every_buffer),
        )?;
        if self.effects.iter().all(|e| !e.decision.overridden) {
            writeln!(f, "  pictures of both are at least {} dB alike", self.bound_db)?;
        }
        writeln!(f, "  drawn so by: {}", self.options.join(" "))
    }
}
