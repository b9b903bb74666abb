//! Pictures of successive times: one file each, or one animated PNG.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use motes_app::opened::Opened;
use motes_app::sequence::ReadAhead;
use motes_scenes::{LoadOptions, Splats, load_many, looks_like_sequence, sequence_frames};
use std::sync::Arc;

use crate::error::CommandError;
use crate::measure::Picture;

/// Times of a moving scene or a sequence, and how they are put together.
#[derive(Clone, Debug, Default, clap::Args)]
#[command(next_help_heading = "Moving scenes")]
pub struct VideoArgs {
    /// Pictures at so many times from 0 to 1: into the folder OUT, or into an animated picture where OUT ends in .png.
    /// A folder of numbered scenes is a sequence, whose frames the times choose
    #[arg(long, value_name = "FROM:TO:COUNT", allow_hyphen_values = true)]
    pub times: Option<Times>,
    /// The whole scene once, in so many seconds of --fps pictures each; it ends where it begins anew
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, default_missing_value = "5", conflicts_with = "times")]
    #[arg(value_parser = clap::value_parser!(u16).range(1..=3600))]
    pub video: Option<u16>,
    /// Pictures a second of an animated picture
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u16).range(1..=240))]
    pub fps: u16,
    /// Memory for the frames of a sequence that are read ahead, MiB
    #[arg(long, value_name = "MIB", default_value_t = 1024)]
    pub read_ahead: u64,
}

/// A list of times.
#[derive(Clone, Debug, PartialEq)]
pub struct Times(pub Vec<f32>);

impl std::str::FromStr for Times {
    type Err = motes_app::time::TimesError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        motes_app::time::times(text).map(Self)
    }
}

impl VideoArgs {
    /// The times that were asked for; none for a single moment.
    pub fn times(&self) -> Option<Vec<f32>> {
        let video = |seconds: u16| {
            let count = u32::from(seconds) * u32::from(self.fps);
            (0..count).map(|i| (f64::from(i) / f64::from(count)) as f32).collect()
        };
        self.times.as_ref().map(|t| t.0.clone()).or(self.video.map(video))
    }

    /// The sequence that is to be shown, where times were given and a folder of frames.
    ///
    /// # Errors
    /// The folder cannot be listed.
    pub fn sequence(&self, scenes: &[PathBuf]) -> Result<Option<Vec<PathBuf>>, CommandError> {
        match scenes {
            [folder] if self.times().is_some() && folder.is_dir() && looks_like_sequence(folder) => {
                Ok(Some(sequence_frames(folder)?))
            }
            _ => Ok(None),
        }
    }
}

/// What is shown at a time: one scene, or the frames of a sequence.
pub enum Footage {
    /// A scene, still or moving.
    Scene(Arc<Splats>),
    /// Frames, read ahead; each with its own splats.
    Sequence(ReadAhead<Arc<Splats>>),
}

impl Footage {
    /// Of an opened scene, or of a sequence's frames.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn new(
        opened: &mut Opened,
        frames: Option<Vec<PathBuf>>,
        options: &LoadOptions,
        mebibytes: u64,
    ) -> Result<Self, CommandError> {
        let Some(frames) = frames else {
            return Ok(Self::Scene(Arc::new(std::mem::take(&mut opened.scene.splats))));
        };
        let options = options.clone();
        let count = frames.len();
        let read = move |frame: usize| {
            let path = frames.get(frame).ok_or("there is no such frame")?;
            let splats = load_many(&[path], &options).map_err(|e| e.to_string())?.splats;
            let bytes = splats.len() * Splats::bytes_per_splat(splats.sh_degree, splats.motion.is_some());
            Ok((Arc::new(splats), bytes as u64))
        };
        let reader = ReadAhead::new(count, mebibytes << 20, read).map_err(CommandError::io("read ahead"))?;
        Ok(Self::Sequence(reader))
    }

    /// The splats to show at a time.
    ///
    /// # Errors
    /// The frame cannot be read.
    pub fn at(&mut self, time: f32) -> Result<Arc<Splats>, CommandError> {
        match self {
            Self::Scene(splats) => Ok(splats.clone()),
            Self::Sequence(reader) => {
                let frame = reader.frame_at(time);
                let splats = reader.wait_for(frame);
                splats
                    .map(|s| s.as_ref().clone())
                    .map_err(|e| CommandError::Usage(format!("frame {frame}: {e}")))
            }
        }
    }
}

/// An animated PNG, written picture by picture. The file appears under its name only once it is complete.
pub struct Animation {
    path: PathBuf,
    partial: PathBuf,
    writer: Option<png::Writer<BufWriter<File>>>,
    count: u32,
    /// Pictures so far.
    written: u32,
    fps: u16,
}

impl Animation {
    /// Of so many pictures.
    pub fn new(path: &Path, count: u32, fps: u16) -> Self {
        let mut partial = path.as_os_str().to_owned();
        partial.push(".part");
        Self { path: path.to_owned(), partial: partial.into(), writer: None, count, written: 0, fps }
    }

    fn problem(&self, error: png::EncodingError) -> CommandError {
        let source = match error {
            png::EncodingError::IoError(source) => source,
            other => std::io::Error::other(other.to_string()),
        };
        CommandError::Io { path: self.path.clone(), source }
    }

    /// Appends a picture; all must be of the first one's size.
    ///
    /// # Errors
    /// The disk is full, or a picture is of another size.
    pub fn add(&mut self, picture: &Picture) -> Result<(), CommandError> {
        if self.writer.is_none() {
            let file = File::create(&self.partial).map_err(CommandError::io(&self.partial))?;
            let [width, height] = picture.size();
            let mut encoder = png::Encoder::new(BufWriter::new(file), width, height);
            encoder.set_color(png::ColorType::Rgb);
            encoder.set_depth(png::BitDepth::Eight);
            encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
            encoder.set_animated(self.count, 0).map_err(|e| self.problem(e))?;
            encoder.set_frame_delay(1, self.fps).map_err(|e| self.problem(e))?;
            self.writer = Some(encoder.write_header().map_err(|e| self.problem(e))?);
        }
        let bytes = picture.to_rgb8();
        match self.writer.as_mut().map(|w| w.write_image_data(&bytes)) {
            Some(Err(e)) => return Err(self.problem(e)),
            _ => self.written += 1,
        }
        Ok(())
    }

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    /// The disk is full, or there are fewer pictures than announced.
    pub fn finish(mut self) -> Result<(), CommandError> {
        if self.written != self.count {
            let what = format!("{} pictures of {} were made: no animation", self.written, self.count);
            return Err(CommandError::Io { path: self.path.clone(), source: std::io::Error::other(what) });
        }
        if let Some(writer) = self.writer.take() {
            writer.finish().map_err(|e| self.problem(e))?;
        }
        std::fs::rename(&self.partial, &self.path).map_err(CommandError::io(&self.path))
    }
}

impl Drop for Animation {
    fn drop(&mut self) {
        // What is left of a video that failed; where it was finished there is nothing of that name.
        let _ = std::fs::remove_file(&self.partial);
    }
}

/// Whether OUT is one animated picture rather than a folder.
pub fn is_animated(output: &Path) -> bool {
    output.extension().is_some_and(|e| e.eq_ignore_ascii_case("png") || e.eq_ignore_ascii_case("apng"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_video_is_the_whole_scene_once() {
        let args = VideoArgs { video: Some(2), fps: 25, ..VideoArgs::default() };
        let times = args.times().unwrap();
        assert_eq!((times.len(), times[0], times[1], times[25]), (50, 0.0, 0.02, 0.5));
        assert!(times.iter().all(|t| *t < 1.0), "1 is 0 of the next round");
        assert_eq!(VideoArgs { video: None, ..args }.times(), None);
    }

    #[test]
    fn an_animation_holds_all_its_pictures() {
        let folder = std::env::temp_dir().join(format!("motes-animation-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("three.png");
        let picture = |v: u8| Picture::from_rgb8([4, 2], &[v; 24]).unwrap();
        let mut animation = Animation::new(&path, 3, 25);
        for v in [10, 100, 200] {
            animation.add(&picture(v)).unwrap();
            assert!(!path.exists());
        }
        animation.finish().unwrap();
        let mut reader =
            png::Decoder::new(std::io::BufReader::new(File::open(&path).unwrap())).read_info().unwrap();
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 3);
        let mut buffer = vec![0; reader.output_buffer_size().unwrap()];
        for v in [10, 100, 200] {
            reader.next_frame(&mut buffer).unwrap();
            assert_eq!(&buffer[..24], &[v; 24]);
            let control = reader.info().frame_control().unwrap();
            assert_eq!((control.delay_num, control.delay_den), (1, 25));
        }
        // One picture short: no file appears, and nothing is left behind.
        let short = folder.join("short.png");
        let mut animation = Animation::new(&short, 3, 25);
        animation.add(&picture(1)).unwrap();
        assert!(animation.finish().is_err());
        assert!(!short.exists());
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(is_animated(Path::new("a.APNG")) && !is_animated(Path::new("folder")));
    }
}
