//! The time of a moving scene: play, pause, scrub, speed (backwards too), loop, ping-pong, frame by frame.
//!
//! Scene time runs from 0 to 1 in [`TimeControl::duration`] seconds at speed 1. It is kept in f64 and advanced by what
//! really passed, so that a dropped frame neither slows a scene down nor lets two eyes drift apart.

use std::time::Duration;

/// What happens at the ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Repeat {
    /// Begins again at the other end: 1 is the same moment as 0.
    #[default]
    Loop,
    /// Turns round.
    PingPong,
    /// Stops.
    Once,
}

impl Repeat {
    /// Every value and its name.
    pub const ALL: [(Self, &'static str); 3] =
        [(Self::Loop, "loop"), (Self::PingPong, "ping-pong"), (Self::Once, "once")];
}

/// Fastest speed either way.
pub const MAX_SPEED: f64 = 16.0;
/// Slowest speed that [`TimeCommand::Slower`] goes down to.
const MIN_SPEED: f64 = 1.0 / 16.0;

/// What a key, a button or a menu can ask of playback.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TimeCommand {
    /// Plays or pauses.
    Toggle,
    /// Pauses, and goes so many frames on.
    Step(i32),
    /// Goes to a time, and stays as it is: playing or paused.
    Scrub(f64),
    /// Goes on by a part of the scene (back, where negative), as playback does at the ends.
    Jump(f64),
    /// Twice as fast.
    Faster,
    /// Half as fast.
    Slower,
    /// The other way.
    Reverse,
    /// What happens at the ends.
    Repeat(Repeat),
    /// The next way to deal with the ends.
    NextRepeat,
    /// Whether only the scene's own frames are shown, not the moments between them.
    WholeFrames(bool),
}

/// The state of playback.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeControl {
    time: f64,
    playing: bool,
    speed: f64,
    repeat: Repeat,
    /// Whether ping-pong is on its way back.
    returning: bool,
    duration: f64,
    frames: u32,
    whole_frames: bool,
}

impl Default for TimeControl {
    /// For a scene whose file says neither how long it takes nor of how many frames it was made: the public ones are of
    /// 50 frames.
    fn default() -> Self {
        Self::new(5.0, 50)
    }
}

impl TimeControl {
    /// A scene of `duration` seconds and `frames` frames, playing from its beginning. A duration or number that makes
    /// no sense becomes a second, or a frame.
    pub fn new(duration: f64, frames: u32) -> Self {
        let duration = if duration.is_finite() && duration > 0.0 { duration } else { 1.0 };
        Self {
            time: 0.0,
            playing: true,
            speed: 1.0,
            repeat: Repeat::Loop,
            returning: false,
            duration,
            frames: frames.max(1),
            whole_frames: false,
        }
    }

    /// Scene time that is shown, `0 ..= 1`.
    pub fn time(&self) -> f32 {
        self.shown(self.time)
    }

    /// What is shown at a time: the time itself, or the beginning of its frame.
    fn shown(&self, time: f64) -> f32 {
        if self.whole_frames { self.start_of(self.frame_of(time)) as f32 } else { time as f32 }
    }

    fn frame_of(&self, time: f64) -> u32 {
        ((time * f64::from(self.frames) + 1e-9) as u32).min(self.frames - 1)
    }

    fn start_of(&self, frame: u32) -> f64 {
        f64::from(frame) / f64::from(self.frames)
    }

    /// Seconds that a scene takes at speed 1.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Which of the scene's frames is shown, `0 .. frames`.
    pub fn frame(&self) -> u32 {
        self.frame_of(self.time)
    }

    /// Number of frames.
    pub fn frames(&self) -> u32 {
        self.frames
    }

    /// Whether time passes.
    pub fn playing(&self) -> bool {
        self.playing
    }

    /// Scene seconds a second; negative: backwards.
    pub fn speed(&self) -> f64 {
        self.speed
    }

    /// Whether scene time runs backwards: at a negative speed, or on the way back of a ping-pong.
    pub fn backwards(&self) -> bool {
        (self.speed < 0.0) != self.returning
    }

    /// What happens at the ends.
    pub fn repeat(&self) -> Repeat {
        self.repeat
    }

    /// Whether only the scene's own frames are shown.
    pub fn whole_frames(&self) -> bool {
        self.whole_frames
    }

    /// Does what was asked for.
    pub fn obey(&mut self, command: TimeCommand) {
        match command {
            TimeCommand::Toggle => self.toggle(),
            TimeCommand::Step(frames) => self.step(frames),
            TimeCommand::Scrub(time) => self.scrub(time),
            TimeCommand::Jump(part) if part.is_finite() => {
                (self.time, self.returning) = moved(self.time, self.returning, part, self.repeat);
            }
            TimeCommand::Jump(_) => {}
            TimeCommand::Faster => self.double_speed(2.0),
            TimeCommand::Slower => self.double_speed(0.5),
            TimeCommand::Reverse => self.speed = -self.speed,
            TimeCommand::Repeat(repeat) => self.set_repeat(repeat),
            TimeCommand::NextRepeat => self.set_repeat(match self.repeat {
                Repeat::Loop => Repeat::PingPong,
                Repeat::PingPong => Repeat::Once,
                Repeat::Once => Repeat::Loop,
            }),
            TimeCommand::WholeFrames(whole) => self.whole_frames = whole,
        }
    }

    fn double_speed(&mut self, factor: f64) {
        let magnitude = (self.speed.abs() * factor).clamp(MIN_SPEED, MAX_SPEED);
        self.speed = magnitude.copysign(self.speed);
    }

    /// Lets time pass. A scene that was played to its end begins again.
    pub fn play(&mut self) {
        let (start, end) = if self.speed >= 0.0 { (0.0, 1.0) } else { (1.0, 0.0) };
        if self.repeat == Repeat::Once && self.time == end {
            self.time = start;
        }
        self.playing = true;
    }

    /// Stops time.
    pub fn pause(&mut self) {
        self.playing = false;
    }

    /// Plays or pauses.
    pub fn toggle(&mut self) {
        if self.playing { self.pause() } else { self.play() }
    }

    /// Goes to a time, `0 ..= 1`; a time outside to the nearest end, NaN nowhere.
    pub fn scrub(&mut self, time: f64) {
        if !time.is_nan() {
            self.time = time.clamp(0.0, 1.0);
            self.returning = false;
        }
    }

    /// Changes the speed, at most [`MAX_SPEED`] either way; NaN changes nothing.
    pub fn set_speed(&mut self, speed: f64) {
        if !speed.is_nan() {
            self.speed = speed.clamp(-MAX_SPEED, MAX_SPEED);
        }
    }

    /// Changes what happens at the ends.
    pub fn set_repeat(&mut self, repeat: Repeat) {
        self.repeat = repeat;
        self.returning = false;
    }

    /// Pauses, and goes so many frames on (or back) to the beginning of a frame; past an end as playback does.
    pub fn step(&mut self, frames: i32) {
        self.pause();
        let count = f64::from(self.frames);
        let frame = f64::from(self.frame()) + f64::from(frames);
        let last = count - 1.0;
        let frame = match self.repeat {
            Repeat::Loop => frame.rem_euclid(count),
            Repeat::Once => frame.clamp(0.0, last),
            Repeat::PingPong if last == 0.0 => 0.0,
            Repeat::PingPong => {
                let phase = frame.rem_euclid(2.0 * last);
                if phase > last { 2.0 * last - phase } else { phase }
            }
        };
        self.time = frame / count;
        self.returning = false;
    }

    /// Lets so much of the viewer's time pass; says what the scene's time is then.
    pub fn advance(&mut self, passed: Duration) -> f32 {
        if self.playing {
            let delta = passed.as_secs_f64() * self.speed / self.duration;
            (self.time, self.returning) = moved(self.time, self.returning, delta, self.repeat);
            let end = if delta > 0.0 { 1.0 } else { 0.0 };
            if self.repeat == Repeat::Once && delta != 0.0 && self.time == end {
                self.playing = false;
            }
        }
        self.time()
    }

    /// The scene's time a little later, as [`TimeControl::advance`] will have it: for a sort that is to be ready then.
    pub fn predict(&self, ahead: Duration) -> f32 {
        if !self.playing {
            return self.time();
        }
        let delta = ahead.as_secs_f64() * self.speed / self.duration;
        self.shown(moved(self.time, self.returning, delta, self.repeat).0)
    }
}

/// Time and direction after a change by `delta`.
fn moved(time: f64, returning: bool, delta: f64, repeat: Repeat) -> (f64, bool) {
    let to = time + delta;
    match repeat {
        Repeat::Once => (to.clamp(0.0, 1.0), false),
        Repeat::Loop if (0.0..=1.0).contains(&to) => (to, false),
        Repeat::Loop => (to.rem_euclid(1.0), false),
        Repeat::PingPong => {
            // There and back is a circle of length 2.
            let phase = if returning { 2.0 - time } else { time };
            let phase = (phase + delta).rem_euclid(2.0);
            if phase > 1.0 { (2.0 - phase, true) } else { (phase, false) }
        }
    }
}

/// Why a range of times cannot be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is not a range of times: write from:to:count, such as 0:1:30, with finite times and 1 to 100000 of them"
)]
pub struct TimesError(pub String);

/// `from:to:count` as that many times at equal distances, both ends among them; or a single time.
///
/// # Errors
/// Anything else.
pub fn times(text: &str) -> Result<Vec<f32>, TimesError> {
    let refuse = || TimesError(text.to_owned());
    let number = |t: &str| t.trim().parse::<f64>().ok().filter(|t| t.is_finite()).ok_or_else(refuse);
    let parts: Vec<_> = text.split(':').collect();
    match parts[..] {
        [one] => Ok(vec![number(one)? as f32]),
        [from, to, count] => {
            let (from, to) = (number(from)?, number(to)?);
            let count: u32 = count.trim().parse().map_err(|_| refuse())?;
            if !(1..=100_000).contains(&count) {
                return Err(refuse());
            }
            let steps = f64::from(count.max(2) - 1);
            Ok((0..count).map(|i| (from + (to - from) * f64::from(i) / steps) as f32).collect())
        }
        _ => Err(refuse()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TENTH: Duration = Duration::from_millis(100);

    fn near(a: f32, b: f32) -> bool {
        (a - b).abs() < 1e-6
    }

    #[test]
    fn plays_pauses_and_scrubs() {
        let mut t = TimeControl::new(2.0, 60);
        assert!(near(t.advance(TENTH), 0.05));
        t.pause();
        assert!(near(t.advance(TENTH), 0.05));
        t.scrub(0.5);
        assert_eq!(t.time(), 0.5);
        t.toggle();
        assert!(near(t.advance(TENTH), 0.55));
        for wrong in [f64::NAN, 7.0, -7.0] {
            t.scrub(wrong);
            assert!((0.0..=1.0).contains(&t.time()));
        }
        assert_eq!(t.time(), 0.0);
    }

    #[test]
    fn speeds_go_both_ways_and_have_bounds() {
        let mut t = TimeControl::new(1.0, 10);
        t.scrub(0.5);
        t.set_speed(-2.0);
        assert!(near(t.advance(TENTH), 0.3));
        t.set_speed(f64::NAN);
        assert_eq!(t.speed(), -2.0);
        t.set_speed(f64::INFINITY);
        assert_eq!(t.speed(), MAX_SPEED);
        t.set_speed(0.0);
        assert!(near(t.advance(TENTH), 0.3));
    }

    #[test]
    fn a_loop_has_a_seam_at_both_ends() {
        let mut t = TimeControl::new(1.0, 10);
        t.scrub(0.95);
        assert!(near(t.advance(TENTH), 0.05));
        t.set_speed(-1.0);
        assert!(near(t.advance(TENTH), 0.95));
        // However long a stall lasts.
        assert!((0.0..=1.0).contains(&t.advance(Duration::from_secs(86_400))));
    }

    #[test]
    fn ping_pong_turns_round() {
        let mut t = TimeControl::new(1.0, 10);
        t.set_repeat(Repeat::PingPong);
        t.scrub(0.95);
        assert!(near(t.advance(TENTH), 0.95));
        assert!(near(t.advance(TENTH), 0.85));
        t.scrub(0.05);
        t.set_speed(-1.0);
        assert!(near(t.advance(TENTH), 0.05));
        assert!(near(t.advance(TENTH), 0.15));
    }

    #[test]
    fn once_stops_at_the_end_and_can_begin_again() {
        let mut t = TimeControl::new(1.0, 10);
        t.set_repeat(Repeat::Once);
        t.scrub(0.95);
        assert_eq!(t.advance(TENTH), 1.0);
        assert!(!t.playing());
        t.play();
        assert_eq!(t.time(), 0.0);
        t.set_speed(-1.0);
        assert_eq!(t.advance(TENTH), 0.0);
        assert!(!t.playing());
        t.play();
        assert!(near(t.advance(TENTH), 0.9));
    }

    #[test]
    fn steps_go_from_frame_to_frame() {
        let mut t = TimeControl::new(1.0, 4);
        t.scrub(0.3);
        assert_eq!(t.frame(), 1);
        t.step(1);
        assert_eq!((t.time(), t.frame(), t.playing()), (0.5, 2, false));
        t.step(2);
        assert_eq!(t.frame(), 0);
        t.step(-1);
        assert_eq!(t.frame(), 3);
        t.set_repeat(Repeat::PingPong);
        t.step(1);
        assert_eq!(t.frame(), 2);
        t.set_repeat(Repeat::Once);
        t.step(-9);
        assert_eq!(t.frame(), 0);
        t.step(9);
        assert_eq!(t.frame(), 3);
        // Every frame of a long scene is reached, one by one.
        let mut t = TimeControl::new(1.0, 977);
        for frame in 1..977 {
            t.step(1);
            assert_eq!(t.frame(), frame);
        }
    }

    #[test]
    fn prediction_is_what_comes() {
        for repeat in [Repeat::Loop, Repeat::PingPong, Repeat::Once] {
            let mut t = TimeControl::new(0.7, 10);
            t.set_repeat(repeat);
            t.set_speed(-1.3);
            for _ in 0..50 {
                let predicted = t.predict(TENTH);
                let before = t.time();
                assert_eq!(t.advance(TENTH), predicted);
                assert!(before != predicted || !t.playing());
            }
        }
    }

    #[test]
    fn commands_do_what_they_say() {
        let mut t = TimeControl::new(1.0, 10);
        t.obey(TimeCommand::Toggle);
        assert!(!t.playing());
        t.obey(TimeCommand::Jump(-0.25));
        assert_eq!(t.time(), 0.75, "over the seam of a loop");
        t.obey(TimeCommand::Step(1));
        assert_eq!((t.frame(), t.time()), (8, 0.8));
        for (command, speed) in [
            (TimeCommand::Faster, 2.0),
            (TimeCommand::Reverse, -2.0),
            (TimeCommand::Slower, -1.0),
            (TimeCommand::Slower, -0.5),
        ] {
            t.obey(command);
            assert_eq!(t.speed(), speed);
        }
        for _ in 0..9 {
            t.obey(TimeCommand::Faster);
        }
        assert_eq!(t.speed(), -MAX_SPEED);
        let mut seen = Vec::new();
        for _ in 0..3 {
            t.obey(TimeCommand::NextRepeat);
            seen.push(t.repeat());
        }
        assert_eq!(seen, [Repeat::PingPong, Repeat::Once, Repeat::Loop]);
        t.obey(TimeCommand::Scrub(0.33));
        t.obey(TimeCommand::Jump(f64::NAN));
        assert_eq!(t.time(), 0.33);
    }

    #[test]
    fn whole_frames_are_shown_at_their_beginning_and_predicted_so() {
        // 30 frames a second, seen 72 times a second: each is shown two or three times, and none is left out.
        let mut t = TimeControl::new(1.0, 30);
        t.obey(TimeCommand::WholeFrames(true));
        let view = Duration::from_nanos(1_000_000_000 / 72);
        let mut times = Vec::new();
        for _ in 0..70 {
            let predicted = t.predict(view);
            times.push(t.advance(view));
            assert_eq!(times.last(), Some(&predicted));
        }
        assert!(times.iter().all(|time| (time * 30.0 - (time * 30.0).round()).abs() < 1e-5));
        let mut runs = vec![(times[0], 0)];
        for time in times {
            match runs.last_mut() {
                Some((last, count)) if *last == time => *count += 1,
                _ => runs.push((time, 1)),
            }
        }
        let inner = &runs[1..runs.len() - 1];
        assert_eq!(runs.len(), 30);
        assert!(inner.iter().all(|(_, count)| (2..=3).contains(count)), "{runs:?}");
        // Control: without, every view has a time of its own.
        t.obey(TimeCommand::WholeFrames(false));
        let a = t.advance(view);
        assert_ne!(a, t.advance(view));
    }

    #[test]
    fn an_hour_at_72_hz_does_not_drift() {
        let mut t = TimeControl::new(10.0, 300);
        let frame = Duration::from_nanos(1_000_000_000 / 72);
        for _ in 0..72 * 3600 {
            t.advance(frame);
        }
        let exact = (frame.as_secs_f64() * f64::from(72 * 3600) / 10.0).rem_euclid(1.0);
        assert!((f64::from(t.time()) - exact).abs() < 1e-6);
    }

    #[test]
    fn ranges_of_times_are_read() {
        assert_eq!(times("0:1:5").unwrap(), [0.0, 0.25, 0.5, 0.75, 1.0]);
        assert_eq!(times("1:0:2").unwrap(), [1.0, 0.0]);
        assert_eq!(times("0.3:0.9:1").unwrap(), [0.3]);
        assert_eq!(times("0.25").unwrap(), [0.25]);
        for wrong in
            ["", "0:1", "0:1:0", "0:1:x", "nan:1:3", "0:inf:3", "0:1:3:4", "0:1:-3", "0:1:1000000000"]
        {
            assert!(times(wrong).is_err(), "{wrong}");
        }
    }
}
