//! `motes device`: what a device offers, and how it compares with what Motes takes for granted of a headset.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use motes_renderer::gpu::DeviceReport;

use crate::error::CommandError;
use crate::studio::DeviceArgs;

/// State what a device offers (this machine's, or from a headset's device.json), and check it against the Quest profile
#[derive(Clone, Debug, clap::Args)]
pub struct DeviceReportArgs {
    /// A report that a headset wrote: device.json in the application's folder (this machine's device, where none is named)
    pub file: Option<PathBuf>,
    /// Write the report here
    #[arg(short, long, value_name = "FILE", conflicts_with = "file")]
    pub output: Option<PathBuf>,
    /// Print limits, features and extensions too
    #[arg(long)]
    pub all: bool,
    #[command(flatten)]
    device: DeviceArgs,
}

/// States, and checks.
///
/// # Errors
/// The file cannot be read, there is no device, or it lacks what Motes cannot do without.
pub fn run(args: &DeviceReportArgs) -> Result<(), CommandError> {
    let report = match &args.file {
        Some(file) => read(file)?,
        None => DeviceReport::of(&*args.device.offscreen()?),
    };
    if let Some(file) = &args.output {
        let text = serde_json::to_string_pretty(&report).map_err(|e| CommandError::Usage(e.to_string()))?;
        std::fs::write(file, text).map_err(CommandError::io(file))?;
    }
    let mut out = std::io::stdout();
    out.write_all(state(&report, args.all).as_bytes()).map_err(CommandError::Print)?;
    let findings = report.against_profile();
    let missing: Vec<_> = findings.iter().filter(|f| f.required && !f.holds).map(|f| f.what).collect();
    if missing.is_empty() {
        return Ok(());
    }
    Err(CommandError::Failed(format!("Motes cannot run on this device; it lacks: {}", missing.join(", "))))
}

fn read(file: &Path) -> Result<DeviceReport, CommandError> {
    let text = std::fs::read_to_string(file).map_err(CommandError::io(file))?;
    serde_json::from_str(&text)
        .map_err(|e| CommandError::Usage(format!("{} is no report of a device: {e}", file.display())))
}

fn state(report: &DeviceReport, all: bool) -> String {
    let c = &report.capabilities;
    let mut text = format!(
        "{} ({}), Vulkan {}; Motes {} on {}\n",
        c.device, c.driver, c.api, report.version, report.system
    );
    let heaps: Vec<_> = report
        .heaps
        .iter()
        .map(|(bytes, own)| format!("{} MiB{}", bytes >> 20, if *own { " of the device" } else { "" }))
        .collect();
    text += &format!("memory: {}\n", heaps.join(", "));
    for line in report.headset.iter().chain(&report.fallbacks) {
        text += &format!("{line}\n");
    }
    text += &format!("\n{:36} {:26} {:26}\n", "", "profile of a Quest", "here");
    for f in report.against_profile() {
        let otherwise = if f.holds { "" } else { f.otherwise };
        text += &format!("{:36} {:26} {:26} {otherwise}\n", f.what, f.expected, f.found);
    }
    if all {
        text.push('\n');
        for (name, value) in &report.limits {
            text += &format!("{name:44} {value}\n");
        }
        for (name, there) in &report.features {
            text += &format!("{name:44} {there}\n");
        }
        for name in &report.extensions {
            text += &format!("{name}\n");
        }
    }
    text
}
