//! `motes info`: what is in a scene.

use std::fmt::Write as _;
use std::io::Write as _;

use motes_app::opened::Opened;
use motes_renderer::{Axis, Packing, Precision, ShPrecision};
use motes_scenes::statement::Statement;
use motes_scenes::{LoadOptions, Splats};

use crate::commands::plan::{PlanArgs, PlanReport};
use crate::density::Density;
use crate::error::CommandError;
use crate::scene_args::SceneArgs;

/// State what is in a scene: counts, bounds, histograms, settings, bytes
#[derive(Clone, Debug, clap::Args)]
pub struct InfoArgs {
    /// Which scenes
    #[command(flatten)]
    pub scenes: SceneArgs,
    /// Level of a streamed scene, 0 is the finest
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub level: u32,
    /// Count splats by voxels with this side (1 m: the thesis's)
    #[arg(long, value_name = "METRES", num_args = 0..=1, default_missing_value = "1", value_parser = super::render::voxel)]
    pub density: Option<f64>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    // No doc comment: clap would take it for the text of the help.
    #[command(flatten)]
    #[allow(missing_docs, reason = "as above")]
    pub plan: PlanArgs,
}

/// Bytes that a scene takes on the device in one packing.
#[derive(Clone, Debug, serde::Serialize)]
struct OnDevice {
    precision: Precision,
    sh_precision: ShPrecision,
    bytes: u64,
}

/// The packings worth telling apart: of geometry alone where there are no harmonics.
fn on_device(splats: &Splats) -> Vec<OnDevice> {
    let mut list = Vec::new();
    for &precision in Precision::ALL {
        for &sh_precision in ShPrecision::ALL {
            if splats.sh_degree == 0 && sh_precision != ShPrecision::F32 {
                continue;
            }
            let packing = Packing { precision, sh_precision, sh_degree: splats.sh_degree };
            list.push(OnDevice { precision, sh_precision, bytes: packing.bytes(splats) });
        }
    }
    list
}

fn density(opened: &Opened, metres: f64) -> Density {
    Density::of(&opened.scene.splats, Some(metres / opened.settings.scale))
}

/// Prints the statement.
///
/// # Errors
/// The scene cannot be read.
pub fn run(args: &InfoArgs) -> Result<(), CommandError> {
    let options = LoadOptions { level: args.level, ..Default::default() };
    let opened = Opened::load(&args.scenes.paths(), &options)?;
    let statement = Statement::of(&opened.scene);
    let device = on_device(&opened.scene.splats);
    let plan = args.plan.plan.then(|| PlanReport::of(&opened.scene, &statement, &args.plan.overrides()));
    let density = args.density.map(|side| (side, density(&opened, side)));
    let text = if args.json {
        let mut json = serde_json::json!({
            "statement": statement,
            "settings": opened.settings.to_json(),
            "settings_found": opened.settings_found,
            "on_device": device,
            "cameras": opened.cameras.len(),
        });
        if let Some(plan) = &plan {
            json["plan"] = serde_json::to_value(plan).map_err(|e| CommandError::Print(e.into()))?;
        }
        if let Some((side, density)) = &density {
            json["density"] = serde_json::json!({
                "voxel_metres": side,
                "voxels": density.of_voxels.len(),
                "median": density.quantile(0.5),
                "95_percent": density.quantile(0.95),
                "most": density.quantile(1.0),
            });
        }
        format!("{json:#}\n")
    } else {
        let mut text = statement.to_string();
        let each = |bytes: u64| bytes as f64 / statement.splats.max(1) as f64;
        text.push_str("\non the device\n");
        for d in &device {
            let harmonics = if statement.sh_degree == 0 {
                String::new()
            } else {
                format!(", harmonics {}", d.sh_precision)
            };
            let name = format!("{}{harmonics}", d.precision);
            let (mega, each) = (d.bytes as f64 / 1e6, each(d.bytes));
            let _ = writeln!(text, "  {name:28} {mega:9.2} MB   {each:6.1} bytes a splat");
        }
        if let Some((side, density)) = &density {
            let [median, most_of, most] = [0.5, 0.95, 1.0].map(|share| density.quantile(share));
            let voxels = density.of_voxels.len();
            let _ = writeln!(
                text,
                "\n{voxels} voxels of {side} m hold splats: median {median}, 95 % up to {most_of}, at most {most}"
            );
        }
        if let Some(plan) = &plan {
            text.push_str(&plan.to_string());
        }
        let settings = serde_json::Value::Object(opened.settings.to_json());
        let found = if opened.settings_found { "beside the scene" } else { "assumed" };
        let _ = write!(text, "\nsettings ({found}): {settings}\n");
        let _ = writeln!(text, "cameras of the data set: {}", opened.cameras.len());
        text
    };
    std::io::stdout().write_all(text.as_bytes()).map_err(CommandError::Print)
}
