//! `motes label`: a class for every splat, from masks of photographs, from a list of ids, or from the files of a scene.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use motes_app::opened::Opened;
use motes_renderer::detail::vote::{Elected, Votes, mask_of};
use motes_renderer::detail::{Census, Importance};
use motes_renderer::reference::ReferenceOptions;
use motes_renderer::{RenderConfig, View};
use motes_scenes::cameras::{self, Camera};
use motes_scenes::labels::{Class, Labels, class_colour};
use motes_scenes::{LoadOptions, Splats};

use crate::error::CommandError;
use crate::measure::ClassMask;
use crate::shots::resized;

/// Give every splat a class; saved beside the scene, shown by `motes render --heat labels`
#[derive(Clone, Debug, clap::Args)]
pub struct LabelArgs {
    /// Scene files or folders; of several, each is a class of its own
    #[arg(required = true)]
    pub scenes: Vec<PathBuf>,
    /// A folder of masks, palette or grey PNGs named like the cameras: pixel values are classes
    #[arg(long, value_name = "FOLDER", conflicts_with = "ids")]
    pub masks: Option<PathBuf>,
    /// Ids from a JSON file: a list, or an object with `labels`, or point annotations
    #[arg(long, value_name = "FILE")]
    pub ids: Option<PathBuf>,
    /// How masks vote
    #[arg(long, value_enum, default_value_t = By::Weight)]
    pub by: By,
    /// Power of the visible weights in a vote: the higher, the less a splat listens where others cover it
    #[arg(long, value_name = "N", default_value_t = SHARPNESS, value_parser = clap::value_parser!(i32).range(1..=16))]
    pub sharpness: i32,
    /// Leave neighbours out: each splat has only its own votes
    #[arg(long)]
    pub alone: bool,
    /// The masks' cameras (those beside the scene)
    #[arg(long, value_name = "FILE")]
    pub cameras: Option<PathBuf>,
    /// Name and colour of a class; as often as there are classes
    #[arg(long = "class", value_name = "ID=NAME[#RRGGBB]")]
    pub classes: Vec<NamedClass>,
    /// Where the labels are saved (beside the scene)
    #[arg(short, long, value_name = "OUT.json")]
    pub output: Option<PathBuf>,
    /// Compare with these labels, splat by splat
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// Write a mask for every camera from the labels
    #[arg(long, value_name = "FOLDER")]
    pub write_masks: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// How masks vote.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum By {
    /// By visible blending weight, which respects what hides what
    Weight,
    /// By where centres lie, as if nothing hid anything
    Centres,
}

/// How masks become labels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Vote {
    /// By visible weight or by centres.
    pub by: By,
    /// Power of visible weights.
    pub sharpness: i32,
    /// Whether neighbours have a say.
    pub neighbours: bool,
}

impl Default for Vote {
    fn default() -> Self {
        Self { by: By::Weight, sharpness: SHARPNESS, neighbours: true }
    }
}

/// A class as an argument.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedClass(pub Class);

impl FromStr for NamedClass {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("'{text}' is no class; write its id and name, like 3=wall or 3=wall#c0ffee");
        let (id, rest) = text.split_once('=').ok_or_else(wrong)?;
        let id = id.trim().parse().ok().filter(|&id: &u16| id > 0).ok_or_else(wrong)?;
        let (name, colour) = match rest.rsplit_once('#') {
            None => (rest, class_colour(id)),
            Some((name, hex)) => {
                let value = u32::from_str_radix(hex, 16).ok().filter(|_| hex.len() == 6).ok_or_else(wrong)?;
                let [_, r, g, b] = value.to_be_bytes();
                (name, [r, g, b])
            }
        };
        Ok(Self(Class { id, name: name.trim().to_owned(), colour }))
    }
}

/// Power of visible weights in votes: the best of 1 to 8 on the sample scenes.
pub const SHARPNESS: i32 = 4;
/// How much of a pixel must be covered by labelled splats for a class in a written mask.
const COVERED: f64 = 0.5;
/// Shares of a pixel that a splat must have somewhere to count as visible in the comparison.
const VISIBLE: [f64; 4] = [0.0, 0.02, 0.1, 0.25];

/// Agreement of labels with others, over the visible splats.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Agreement {
    /// Share of a pixel that a splat must have somewhere to count, exclusive.
    pub above: f64,
    /// Splats that count.
    pub splats: usize,
    /// Share of them with the same class, `0 ..= 1`.
    pub share: f64,
    /// The same, weighted by their visible weight in all pictures.
    pub weighted: f64,
}

/// What is said at the end.
#[derive(Debug, serde::Serialize)]
struct Report {
    file: PathBuf,
    splats: usize,
    unlabelled: usize,
    masks: usize,
    classes: Vec<Line>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    agreement: Vec<Agreement>,
}

#[derive(Debug, serde::Serialize)]
struct Line {
    id: u16,
    name: String,
    splats: usize,
}

/// What pictures are looked at by: the default way, up to a pixel that is all but opaque.
pub fn options() -> ReferenceOptions {
    ReferenceOptions { stop_below: 1e-4, ..ReferenceOptions::of_config(&RenderConfig::default()) }
}

/// Labels.
///
/// # Errors
/// A file cannot be read or written, or masks and cameras do not fit.
pub fn run(args: &LabelArgs) -> Result<(), CommandError> {
    let opened = Opened::load(&args.scenes, &LoadOptions::default())?;
    for warning in &opened.scene.report.warnings {
        eprintln!("{warning}");
    }
    let splats = &opened.scene.splats;
    let loaded = args.cameras.as_deref().map(cameras::load).transpose()?;
    let cameras = loaded.as_deref().unwrap_or(&opened.cameras);
    let mut masks = 0;
    let mut labels = if let Some(folder) = &args.masks {
        let how = Vote { by: args.by, sharpness: args.sharpness, neighbours: !args.alone };
        let (elected, used) = elect(splats, cameras, folder, how)?;
        masks = used;
        Labels::of_ids(elected.labels)
    } else if let Some(file) = &args.ids {
        let labels = Labels::load(file)?;
        labels.apply(&mut splats.clone(), file)?;
        labels
    } else {
        Labels::of_splats(splats, &opened.classes).ok_or_else(|| {
            CommandError::Usage(
                "nothing says which class is which: give --masks, --ids, or several files".into(),
            )
        })?
    };
    if let Some(truth) = args.truth.as_deref().map(Labels::load).transpose()? {
        adopt(&mut labels, &truth.classes);
    }
    adopt(&mut labels, &args.classes.iter().map(|c| c.0.clone()).collect::<Vec<_>>());
    let agreement = match &args.truth {
        None => Vec::new(),
        Some(file) => {
            let truth = Labels::load(file)?;
            truth.apply(&mut splats.clone(), file)?;
            let seen = census(splats, cameras, args.masks.as_deref())?;
            VISIBLE.map(|above| agreement(&labels.ids, &truth.ids, &seen, above)).to_vec()
        }
    };
    if let Some(folder) = &args.write_masks {
        write_masks(splats, &labels, cameras, folder)?;
    }
    let file = args.output.clone().unwrap_or_else(|| Labels::path_of(&args.scenes[0]));
    labels.save(&file)?;
    let counts = labels.counts();
    let count = |id: u16| counts.get(usize::from(id)).copied().unwrap_or(0);
    let classes = labels.classes.iter().map(|c| Line { id: c.id, name: c.name.clone(), splats: count(c.id) });
    let report = Report {
        file,
        splats: splats.len(),
        unlabelled: count(0),
        masks,
        classes: classes.collect(),
        agreement,
    };
    print(&report, args.json)
}

/// Takes names and colours over from another list of classes.
fn adopt(labels: &mut Labels, classes: &[Class]) {
    for class in classes {
        labels.classes.retain(|c| c.id != class.id);
        labels.classes.push(class.clone());
    }
    labels.classes.sort_by_key(|c| c.id);
}

/// Lets every mask in a folder vote that has a camera of its name; returns how many did.
///
/// # Errors
/// There is none, or one cannot be read.
pub fn elect(
    splats: &Splats,
    cameras: &[Camera],
    folder: &Path,
    how: Vote,
) -> Result<(Elected, usize), CommandError> {
    let masks = masks_of(cameras, folder)?;
    if masks.is_empty() {
        return Err(CommandError::Usage(format!(
            "{} has no mask of a camera: {} cameras are known, masks are called NAME.png after them",
            folder.display(),
            cameras.len()
        )));
    }
    let highest = masks.iter().flat_map(|(_, mask)| mask.classes()).copied().max().unwrap_or(0);
    let mut votes = Votes::new(splats.len(), highest);
    let options = options();
    for (view, mask) in &masks {
        match how.by {
            By::Weight => votes.by_weight(splats, view, mask.classes(), how.sharpness, &options)?,
            By::Centres => votes.by_centres(splats, view, mask.classes(), &options)?,
        }
    }
    let elected = if how.neighbours { votes.elect_among_neighbours(splats) } else { votes.elect() };
    Ok((elected, masks.len()))
}

/// The masks in a folder, each with the view that it was made from, at its own size.
fn masks_of(cameras: &[Camera], folder: &Path) -> Result<Vec<(View, ClassMask)>, CommandError> {
    let mut masks = Vec::new();
    for camera in cameras {
        let file = mask_file(folder, camera);
        if file.is_file() {
            let mask = ClassMask::load(&file)?;
            masks.push((resized(&View::from_camera(camera), mask.size()), mask));
        }
    }
    Ok(masks)
}

/// What is visible, and how much, from the cameras of the masks, or from all.
fn census(splats: &Splats, cameras: &[Camera], masks: Option<&Path>) -> Result<Importance, CommandError> {
    let views: Vec<View> = match masks {
        Some(folder) => masks_of(cameras, folder)?.into_iter().map(|(view, _)| view).collect(),
        None => cameras.iter().map(View::from_camera).collect(),
    };
    let mut census = Census::new(splats.len());
    for view in &views {
        census.look(splats, view, &options())?;
    }
    Ok(census.finish())
}

/// Where a camera's mask is. Cameras' names may hold folders; they stay below the masks' folder.
fn mask_file(folder: &Path, camera: &Camera) -> PathBuf {
    let parts = camera.name.split(['/', '\\']).filter(|p| !p.is_empty() && *p != "." && *p != "..");
    let mut file = folder.join(parts.collect::<PathBuf>());
    file.as_mut_os_string().push(".png");
    file
}

/// How far labels agree with the truth, over the splats that have more than such a share of a pixel somewhere.
pub fn agreement(found: &[u16], truth: &[u16], seen: &Importance, above: f64) -> Agreement {
    let (mut splats, mut same, mut weight, mut weight_same) = (0, 0, 0.0, 0.0);
    for (i, (found, truth)) in found.iter().zip(truth).enumerate() {
        if seen.peak[i] > above {
            splats += 1;
            weight += seen.weight[i];
            if found == truth {
                same += 1;
                weight_same += seen.weight[i];
            }
        }
    }
    let share = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
    Agreement {
        above,
        splats,
        share: share(f64::from(same), splats as f64),
        weighted: share(weight_same, weight),
    }
}

fn write_masks(
    splats: &Splats,
    labels: &Labels,
    cameras: &[Camera],
    folder: &Path,
) -> Result<(), CommandError> {
    if cameras.is_empty() {
        return Err(CommandError::Usage("masks need cameras; name a file of them by --cameras".into()));
    }
    let colour = |id: u8| labels.class(id.into()).map_or_else(|| class_colour(id.into()), |c| c.colour);
    for camera in cameras {
        let view = View::from_camera(camera);
        let mask = mask_of(splats, &labels.ids, &view, COVERED, &options())?;
        let file = mask_file(folder, camera);
        if let Some(parent) = file.parent() {
            std::fs::create_dir_all(parent).map_err(CommandError::io(parent))?;
        }
        ClassMask::new(view.size, mask)?.save(&file, colour)?;
    }
    Ok(())
}

fn print(report: &Report, json: bool) -> Result<(), CommandError> {
    let text = if json {
        serde_json::to_string_pretty(report).map_err(|e| CommandError::Print(e.into()))? + "\n"
    } else {
        let mut text = String::new();
        for Line { id, name, splats } in &report.classes {
            let _ = writeln!(text, "{id:5}  {name:24} {splats:9} splats");
        }
        let _ = writeln!(text, "       unlabelled               {:9} splats", report.unlabelled);
        for a in &report.agreement {
            let _ = writeln!(
                text,
                "of {} splats with more than {:.0} % of a pixel somewhere, {:.2} % have the class of the truth \
                 ({:.2} % by visible weight)",
                a.splats,
                100.0 * a.above,
                100.0 * a.share,
                100.0 * a.weighted
            );
        }
        let _ = writeln!(text, "{}", report.file.display());
        text
    };
    std::io::stdout().write_all(text.as_bytes()).map_err(CommandError::Print)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_are_read() {
        let NamedClass(class) = "3=light wall".parse().unwrap();
        assert_eq!((class.id, class.name.as_str(), class.colour), (3, "light wall", class_colour(3)));
        assert_eq!("3=wall#c0ffee".parse::<NamedClass>().unwrap().0.colour, [0xc0, 0xff, 0xee]);
        for bad in ["wall", "0=wall", "x=wall", "3=wall#12345", "70000=wall"] {
            assert!(bad.parse::<NamedClass>().is_err(), "{bad}");
        }
    }

    #[test]
    fn agreement_counts_what_is_visible() {
        let seen = Importance {
            weight: vec![4.0, 1.0, 5.0, 0.0],
            peak: vec![0.9, 0.2, 0.5, 0.0],
            ..Importance::default()
        };
        let of = |above| agreement(&[1, 2, 3, 0], &[1, 2, 1, 1], &seen, above);
        let a = of(0.0);
        assert_eq!((a.splats, a.share, a.weighted), (3, 2.0 / 3.0, 0.5));
        assert_eq!((of(0.3).splats, of(0.3).share, of(0.95).splats), (2, 0.5, 0));
    }
}
