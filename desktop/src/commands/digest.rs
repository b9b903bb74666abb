//! `motes digest`: what this machine's processor computes of a scene, to compare it with another machine's.

use std::io::Write as _;
use std::path::PathBuf;

use motes_app::digest::Digest;
use motes_app::opened::Opened;
use motes_scenes::LoadOptions;

use crate::error::CommandError;

/// Digest what the processor computes of scenes (read, examine, order, pack, project), to compare machines
#[derive(Clone, Debug, clap::Args)]
pub struct DigestArgs {
    /// Scene files or folders, merged (the sample, where none is named)
    pub scenes: Vec<PathBuf>,
    /// Write the digest here, as JSON, and its values beside it
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// A digest of the same scene from another machine: say how the two agree, and fail where they do not
    #[arg(long, value_name = "FILE")]
    pub against: Option<PathBuf>,
    /// How far numbers may differ, as a part of the larger one; orders and packed words must be the same
    #[arg(long, value_name = "PART", default_value_t = 1e-6)]
    pub within: f64,
}

/// Digests, and compares.
///
/// # Errors
/// A file cannot be read or written, or the digests do not agree.
pub fn run(args: &DigestArgs) -> Result<(), CommandError> {
    let opened = Opened::load(&args.scenes, &LoadOptions::default())?;
    let digest = Digest::of(&opened)?;
    if let Some(file) = &args.output {
        digest.save(file)?;
    }
    let mut out = std::io::stdout();
    let mut print = |text: String| out.write_all(text.as_bytes()).map_err(CommandError::Print);
    print(format!("{}, {} splats, on {}\n", digest.scene, digest.splats, digest.machine))?;
    let Some(file) = &args.against else {
        for stage in &digest.stages {
            print(format!("{:28} {:>9} values  {}\n", stage.name, stage.count, stage.hash))?;
        }
        return Ok(());
    };
    let other = Digest::load(file)?;
    let Some(agreement) = digest.agreement(&other) else {
        let what = format!("{}: a digest of another scene, or of another version", file.display());
        return Err(CommandError::Failed(what));
    };
    let mut apart = Vec::new();
    for stage in &agreement {
        let how =
            if stage.identical { "bit for bit".to_owned() } else { format!("within {:.1e}", stage.worst) };
        print(format!("{:28} {:>9} values  {how}\n", stage.name, stage.count))?;
        if !stage.identical && !(stage.worst <= args.within) {
            apart.push(stage.name.as_str());
        }
    }
    if apart.is_empty() {
        return print(format!("agrees with {}\n", other.machine));
    }
    Err(CommandError::Failed(format!(
        "{} differs by more than {:e} in: {}",
        other.machine,
        args.within,
        apart.join("; ")
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_digest_agrees_with_itself_and_not_with_another() {
        let folder = std::env::temp_dir().join(format!("motes-digest-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let scene = folder.join("scene.ply");
        let write = |splats| motes_scenes::save(&scene, &splats).unwrap();
        let recipe = motes_scenes::synthetic::Recipe { count: 200, ..Default::default() };
        let file = folder.join("digest.json");
        let args = |output: bool, against: bool| DigestArgs {
            scenes: vec![scene.clone()],
            output: output.then(|| file.clone()),
            against: against.then(|| file.clone()),
            within: 1e-6,
        };
        write(recipe.still());
        run(&args(true, false)).unwrap();
        run(&args(false, true)).unwrap();
        let mut other = recipe.still();
        other.means[3][0] += 0.01;
        write(other);
        let refusal = run(&args(false, true)).unwrap_err().to_string();
        assert!(refusal.contains("read") && refusal.contains("order"), "{refusal}");
        std::fs::write(&file, "{}").unwrap();
        assert!(run(&args(false, true)).unwrap_err().to_string().contains("no digest"));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
