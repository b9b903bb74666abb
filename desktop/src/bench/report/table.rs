//! The report as CSV: a row for every scene and configuration.

use super::super::outcome::Outcome;
use super::super::record::Refusal;

type Column = (&'static str, fn(&Outcome) -> String);

fn number(value: f64) -> String {
    value.to_string()
}

fn optional(value: Option<f64>) -> String {
    value.map(number).unwrap_or_default()
}

const COLUMNS: &[Column] = &[
    ("flip", |o| number(o.flip)),
    ("flip_weighted_median", |o| number(o.flip_median)),
    ("flip_weighted_quartile_1", |o| number(o.flip_quartiles[0])),
    ("flip_weighted_quartile_3", |o| number(o.flip_quartiles[1])),
    ("flip_min", |o| number(o.flip_range[0])),
    ("flip_max", |o| number(o.flip_range[1])),
    ("psnr_db", |o| optional(o.psnr)),
    ("ssim", |o| optional(o.ssim)),
    ("worst_pixel", |o| number(o.worst)),
    ("layers_per_pixel", |o| number(o.layers)),
    ("fragments", |o| number(o.fragments)),
    ("primitives", |o| number(o.primitives)),
    ("vertices", |o| number(o.vertices)),
    ("splats_drawn", |o| number(o.visible)),
    ("draw_calls", |o| number(o.draws)),
    ("dispatches", |o| number(o.dispatches)),
    ("render_passes", |o| number(o.passes)),
    ("bytes_moved", |o| number(o.bytes)),
    ("bytes_off_chip", |o| number(o.off_chip)),
    ("scene_bytes", |o| o.scene_bytes.to_string()),
    ("device_bytes", |o| o.memory.to_string()),
    ("device_ms_median", |o| number(o.device_ms.median)),
    ("device_ms_quartile_1", |o| number(o.device_ms.low)),
    ("device_ms_quartile_3", |o| number(o.device_ms.high)),
    ("device_ms_mad", |o| number(o.device_ms.mad)),
    ("upload_ms", |o| number(o.passes_ms[0])),
    ("prepare_ms", |o| number(o.passes_ms[1])),
    ("draw_ms", |o| number(o.passes_ms[2])),
    ("time_over_default_median", |o| optional(o.ratio.map(|r| r.median))),
    ("time_over_default_quartile_1", |o| optional(o.ratio.map(|r| r.low))),
    ("time_over_default_quartile_3", |o| optional(o.ratio.map(|r| r.high))),
    ("wall_ms_median", |o| number(o.wall_ms.median)),
    ("sort_ms_median", |o| optional(o.sort_ms.map(|s| s.median))),
    ("rounds", |o| o.device_ms.count.to_string()),
    ("predicted_headset_ms", |o| number(o.predicted.ms())),
    ("predicted_headset_ms_low", |o| number(o.predicted.range_ms()[0])),
    ("predicted_headset_ms_high", |o| number(o.predicted.range_ms()[1])),
];

/// The table, with a line of names; configurations that cannot run follow with their reason.
pub fn csv(outcomes: &[Outcome], refusals: &[Refusal]) -> String {
    let mut text = String::from("scene,configuration,refused");
    for (name, _) in COLUMNS {
        text.push(',');
        text.push_str(name);
    }
    text.push('\n');
    for o in outcomes {
        text.push_str(&format!("{},{},", quoted(&o.scene), quoted(&o.configuration)));
        for (_, value) in COLUMNS {
            text.push(',');
            text.push_str(&value(o));
        }
        text.push('\n');
    }
    for r in refusals {
        let cells = ",".repeat(COLUMNS.len());
        text.push_str(&format!(
            "{},{},{}{cells}\n",
            quoted(&r.scene),
            quoted(&r.configuration),
            quoted(&r.reason)
        ));
    }
    text
}

/// A cell, quoted where it must be (RFC 4180).
fn quoted(cell: &str) -> String {
    if cell.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", cell.replace('"', "\"\""))
    } else {
        cell.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_quoted_where_they_must_be() {
        assert_eq!(quoted("a b=c"), "a b=c");
        assert_eq!(quoted("a,\"b\""), "\"a,\"\"b\"\"\"");
        let refusal = Refusal { scene: "s".into(), configuration: "c".into(), reason: "no, never".into() };
        let text = csv(&[], &[refusal]);
        let commas = |line: &str| line.replace("no, never", "").matches(',').count();
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(commas(lines[0]), commas(lines[1]));
    }
}
