//! The statement as a text of at most a hundred columns.

use std::fmt;

use super::{Bin, Bounds, Histogram, MotionStatement, Statement};

/// Columns of the longest bar.
const BAR: usize = 40;

/// A histogram with more bins than this is shown by decades.
const MAX_ROWS: usize = 14;

/// Share of the values that an end of a histogram may hold and still be told in one line.
const TAIL: f64 = 0.001;

impl fmt::Display for Statement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for source in &self.sources {
            writeln!(
                f,
                "{}: {}, {} splats, SH degree {}, {}{}",
                source.path.display(),
                source.format,
                grouped(source.splats.len()),
                source.sh_degree,
                bytes(source.bytes),
                if source.antialiased { ", trained antialiased" } else { "" }
            )?;
        }
        if self.sources.len() > 1 {
            let (splats, files) = (grouped(self.splats), self.sources.len());
            writeln!(f, "together: {splats} splats of {files} files, SH degree {}", self.sh_degree)?;
        }
        let each = |total: u64| total as f64 / self.splats.max(1) as f64;
        writeln!(f)?;
        let (disk, memory) = (self.bytes_on_disk, self.bytes_in_memory);
        writeln!(f, "on disk    {:>10}   {:6.1} bytes a splat", bytes(disk), each(disk))?;
        writeln!(f, "in memory  {:>10}   {:6.1} bytes a splat", bytes(memory), each(memory))?;
        self.write_loading(f)?;
        if let Some(bounds) = &self.bounds {
            bounds.write(f)?;
        }

        let opacity = &self.opacity;
        write!(f, "\nopacity: median {}", number(opacity.histogram.median))?;
        for (count, what) in [(opacity.exactly_zero, "0"), (opacity.exactly_one, "1")] {
            if count > 0 {
                write!(f, "; {} exactly {what}", grouped(count))?;
            }
        }
        writeln!(f)?;
        opacity.histogram.write(f)?;

        let size = &self.size;
        write!(f, "\nsize (largest standard deviation, scene units): median {}", number(size.median))?;
        writeln!(f, ", 99 % below {}, largest {}", number(size.p99), number(size.max))?;
        size.write(f)?;

        let anisotropy = &self.anisotropy;
        write!(f, "\nanisotropy (largest over smallest): median {}", number(anisotropy.median))?;
        writeln!(f, ", 99 % below {}, largest {}", number(anisotropy.p99), number(anisotropy.max))?;
        anisotropy.write(f)?;

        if self.bands.len() > 1 {
            writeln!(
                f,
                "\ncolour that depends on direction: RMS in steps of 255, splats with at least one step"
            )?;
            let strongest = self.bands[1..].iter().map(|band| band.rms).fold(0.0, f64::max);
            for band in &self.bands[1..] {
                let share = if strongest > 0.0 { band.rms / strongest } else { 0.0 };
                let (rms, visible) = (band.rms * 255.0, percent(band.visible));
                writeln!(f, "  degree {}           {rms:8.2}  {visible:>7}  {}", band.degree, bar(share))?;
            }
        }
        if let Some(motion) = &self.motion {
            motion.write(f)?;
        }
        if let Some(labels) = &self.labels {
            writeln!(f, "\nlabels: {} classes", labels.len())?;
            let most = labels.values().copied().max().unwrap_or(0);
            for (label, count) in labels {
                let name = if *label == 0 { "none".to_owned() } else { label.to_string() };
                row(f, &name, *count, self.splats, most)?;
            }
        }
        Ok(())
    }
}

impl Statement {
    fn write_loading(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let loading = &self.loading;
        if loading.dropped_total() == 0 {
            writeln!(f, "dropped          none")?;
        } else {
            let (dropped, read) = (grouped(loading.dropped_total()), grouped(loading.read));
            writeln!(f, "dropped    {dropped:>10}   of {read}:")?;
            for (reason, count) in &loading.dropped {
                writeln!(f, "  {:>19}   {reason}", grouped(*count))?;
            }
        }
        for (count, what) in [
            (loading.raised_scales, "scales of zero raised to the smallest"),
            (loading.bounded_widths, "widths in time bounded"),
        ] {
            if count > 0 {
                writeln!(f, "changed    {:>10}   {what}", grouped(count))?;
            }
        }
        for warning in &loading.warnings {
            writeln!(f, "warning: {warning}")?;
        }
        Ok(())
    }
}

impl Bounds {
    fn write(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "\nbounds (scene units)")?;
        writeln!(f, "            {:>24}   {:>24}", "all", "1 to 99 %")?;
        for (k, axis) in ["x", "y", "z"].iter().enumerate() {
            let range = |min: f64, max: f64| format!("{:>10} … {:>10}", number(min), number(max));
            let (all, inner) = (range(self.min[k], self.max[k]), range(self.inner_min[k], self.inner_max[k]));
            writeln!(f, "  {axis}         {all:>24}   {inner:>24}")?;
        }
        if self.origin != [0.0; 3] {
            writeln!(f, "  kept relative to {:?}: the scene lies far from its origin", self.origin)?;
        }
        Ok(())
    }
}

impl MotionStatement {
    fn write(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "\nmotion")?;
        for (what, share) in [
            ("leave their place by a tenth of their size", self.moving),
            ("turn by a degree", self.turning),
            ("are seen during the whole scene", self.permanent),
        ] {
            writeln!(f, "  {:>7}  {what}", percent(share))?;
        }
        writeln!(f, "  {} splats are seen at a moment, on average", grouped(self.alive.round() as usize))?;
        writeln!(f, "\nseen for (share of the duration): median {}", number(self.support.median))?;
        self.support.write(f)?;
        let far = &self.displacement;
        write!(f, "\nway from their place while seen (scene units): median {}", number(far.median))?;
        writeln!(f, ", 99 % below {}", number(far.p99))?;
        far.write(f)
    }
}

impl Histogram {
    /// A line a bin, or a decade where there are many; thin ends in one line each.
    fn write(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut bins = self.bins.clone();
        if bins.len() > MAX_ROWS {
            bins = decades(&bins);
        }
        let (mut start, mut below) = (0, 0);
        let (mut end, mut above) = (bins.len(), 0);
        // Only logarithmic histograms have ends to shorten: the others begin with 0.
        if bins.first().is_some_and(|bin| bin.from > 0.0) {
            let thin = (self.count as f64 * TAIL) as usize;
            while start + 1 < end && below + bins[start].count <= thin {
                below += bins[start].count;
                start += 1;
            }
            while end > start + 1 && above + bins[end - 1].count <= thin {
                above += bins[end - 1].count;
                end -= 1;
            }
        }
        let shown = &bins[start..end];
        let most = shown.iter().map(|bin| bin.count).max().unwrap_or(0);
        if let (true, Some(first)) = (below > 0, shown.first()) {
            row(f, &format!("below {}", number(first.from)), below, self.count, most)?;
        }
        for Bin { from, to, count } in shown {
            row(f, &format!("{} – {}", number(*from), number(*to)), *count, self.count, most)?;
        }
        if let (true, Some(last)) = (above > 0, shown.last()) {
            row(f, &format!("above {}", number(last.to)), above, self.count, most)?;
        }
        Ok(())
    }
}

/// Joins the bins of every decade.
fn decades(bins: &[Bin]) -> Vec<Bin> {
    let mut joined: Vec<Bin> = Vec::new();
    for bin in bins {
        let power = 10f64.powf(bin.from.log10().floor());
        let starts_decade = number(power) == number(bin.from);
        match joined.last_mut() {
            Some(last) if !starts_decade => {
                last.to = bin.to;
                last.count += bin.count;
            }
            _ => joined.push(*bin),
        }
    }
    joined
}

/// A line: name, count, share, bar.
fn row(f: &mut fmt::Formatter<'_>, name: &str, count: usize, of: usize, most: usize) -> fmt::Result {
    let share = |part: usize, whole: usize| if whole == 0 { 0.0 } else { part as f64 / whole as f64 };
    let line = format!(
        "  {name:<16}  {:>11}  {:>7}  {}",
        grouped(count),
        percent(share(count, of)),
        bar(share(count, most))
    );
    writeln!(f, "{}", line.trim_end())
}

/// A bar for a share, in eighths of a column; whatever is not nothing shows.
fn bar(share: f64) -> String {
    const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];
    let eighths = (share.clamp(0.0, 1.0) * (BAR * 8) as f64).round() as usize;
    let eighths = if share > 0.0 { eighths.max(1) } else { 0 };
    "█".repeat(eighths / 8) + EIGHTHS[eighths % 8]
}

fn percent(share: f64) -> String {
    format!("{:.1} %", share * 100.0)
}

/// A count with its thousands set apart.
fn grouped(count: usize) -> String {
    let digits = count.to_string();
    let mut out = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

/// Bytes in the unit that leaves a few digits.
fn bytes(count: u64) -> String {
    const UNITS: [&str; 4] = ["KiB", "MiB", "GiB", "TiB"];
    if count < 1024 {
        return format!("{count} B");
    }
    let mut value = count as f64 / 1024.0;
    let mut unit = 0;
    while value >= 1023.95 && unit + 1 < UNITS.len() {
        value /= 1024.0;
        unit += 1;
    }
    format!("{value:.1} {}", UNITS[unit])
}

/// A number with four digits or all before the point: in full between 0.001 and a million, else with an exponent.
fn number(v: f64) -> String {
    if v == 0.0 {
        return "0".to_owned();
    }
    let exponent = v.abs().log10().floor() as i32;
    if !(-3..6).contains(&exponent) {
        let text = format!("{v:.3e}");
        return match text.split_once('e') {
            Some((digits, exponent)) => format!("{}e{exponent}", trimmed(digits)),
            None => text,
        };
    }
    if exponent > 3 {
        let sign = if v < 0.0 { "-" } else { "" };
        return format!("{sign}{}", grouped(v.abs().round() as usize));
    }
    let decimals = (3 - exponent) as usize;
    trimmed(&format!("{v:.decimals$}")).to_owned()
}

/// Without zeros at the end of a fraction.
fn trimmed(text: &str) -> &str {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text }
}
