//! Ranges of axes, and their tick labels.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "counts of digits"
)]

use std::ops::Range;

use super::figure::{Panel, Picture};

/// Maximum number of labels on a horizontal axis over the whole width.
pub(super) const X_TICKS: usize = 10;

/// Fraction of a shared scale that a panel must fill.
const MIN_FILL: f64 = 0.6;

fn span(values: impl Iterator<Item = f64>) -> Option<Range<f64>> {
    values.filter(|v| v.is_finite()).fold(None, |range, v| match range {
        None => Some(v..v),
        Some(r) => Some(r.start.min(v)..r.end.max(v)),
    })
}

/// Returns `range` with margins on both sides, never empty.
fn padded(range: Option<Range<f64>>, margin: f64) -> Range<f64> {
    let range = range.unwrap_or(0.0..1.0);
    let width = range.end - range.start;
    // A range as small as a rounding error would have ticks with equal labels.
    let min_width = 1e-9 * range.start.abs().max(range.end.abs());
    if width <= min_width || !width.is_finite() {
        let half = (range.start.abs() * 0.1).clamp(1e-3, f64::MAX / 4.0);
        let middle = range.start.clamp(-f64::MAX / 4.0, f64::MAX / 4.0);
        return middle - half..middle + half;
    }
    range.start - margin * width..range.end + margin * width
}

pub(super) fn x_range(panels: &[Panel]) -> Range<f64> {
    let range = padded(span(panels.iter().flat_map(|p| &p.lines).flat_map(|l| l.x.iter().copied())), 0.0);
    // A run of 6 s ends at 5.99 s: round up to the next round number if it is that near.
    let (step, _) = round_numbers(&range, X_TICKS);
    let near = |from: f64, to: f64| (from - to).abs() < 0.02 * (range.end - range.start);
    let (start, end) = ((range.start / step).floor() * step, (range.end / step).ceil() * step);
    let start = if near(range.start, start) { start } else { range.start };
    start..if near(range.end, end) { end } else { range.end }
}

/// Returns the range of data and limits with margins; a limit far beyond the data is left out, and stated as
/// text.
fn y_range(panel: &Panel) -> Range<f64> {
    let data = span(panel.lines.iter().flat_map(|l| l.y.iter().copied()));
    let extent = data.clone().map_or(0.0, |d| d.start.abs().max(d.end.abs()));
    let near = panel.rules.iter().filter(|r| extent == 0.0 || r.value.abs() <= 5.0 * extent);
    let rules = near.flat_map(|r| if r.band { vec![r.value, -r.value] } else { vec![r.value] });
    let shown = span(data.into_iter().flat_map(|d| [d.start, d.end]).chain(rules));
    let higher = |range: Range<f64>| {
        let missing = 0.5 * (panel.min_height - (range.end - range.start)).max(0.0);
        range.start - missing..range.end + missing
    };
    padded(shown.map(higher), 0.09)
}

/// Panels of one quantity share a scale for comparison, unless it would flatten one of them: a panel that
/// fills less than [`MIN_FILL`] of the largest range has its own scale.
pub(super) fn shared_y_range(panels: &[Panel], panel: &Panel) -> Range<f64> {
    let alike = |other: &&Panel| (&other.quantity, &other.unit) == (&panel.quantity, &panel.unit);
    let ranges = || panels.iter().filter(alike).map(y_range);
    let width = |range: &Range<f64>| range.end - range.start;
    let widest = ranges().map(|range| width(&range)).fold(0.0, f64::max);
    let fills = |range: &Range<f64>| width(range) >= MIN_FILL * widest;
    let own = y_range(panel);
    if !fills(&own) {
        return own;
    }
    ranges().filter(fills).fold(own, |a, b| a.start.min(b.start)..a.end.max(b.end))
}

/// Returns ranges with equal scale that contain the panel's lines, or its picture. If the lower edge of a
/// picture has the larger ordinate, the vertical axis points down: its range begins with the larger value.
pub(super) fn equal_ranges(panel: &Panel, aspect: f64) -> (Range<f64>, Range<f64>) {
    if let Some(Picture { x, y, .. }) = &panel.picture {
        let ([left, right], [upper, lower]) = (*x, *y);
        let scale = ((right - left) / aspect).max((lower - upper).abs());
        let (middle, half) = (f64::midpoint(left, right), 0.5 * scale * aspect);
        let (center, up) = (f64::midpoint(upper, lower), 0.5 * scale * (upper - lower).signum());
        return (middle - half..middle + half, center - up..center + up);
    }
    let x = padded(span(panel.lines.iter().flat_map(|l| l.x.iter().copied())), 0.08);
    let y = padded(span(panel.lines.iter().flat_map(|l| l.y.iter().copied())), 0.08);
    let scale = ((x.end - x.start) / aspect).max(y.end - y.start);
    let around = |r: &Range<f64>, width: f64| {
        let middle = f64::midpoint(r.start, r.end);
        middle - width / 2.0..middle + width / 2.0
    };
    (around(&x, scale * aspect), around(&y, scale))
}

/// Round numbers on an axis.
pub(super) struct Ticks {
    /// Positions and labels.
    pub at: Vec<(f64, String)>,
    /// Power of ten by which the labels are divided, a multiple of three.
    pub exponent: i32,
}

/// Returns at most `count` round numbers in `range`.
pub(super) fn ticks(range: &Range<f64>, count: usize) -> Ticks {
    let (step, values) = round_numbers(range, count);
    let largest = values.iter().fold(0.0, |a: f64, v| a.max(v.abs()));
    let readable = largest == 0.0 || (1e-3..1e5).contains(&largest) || !largest.is_normal();
    let exponent = if readable { 0 } else { (largest.log10() / 3.0).floor() as i32 * 3 };
    let factor = 10.0_f64.powi(-exponent);
    let decimals = (-(step * factor * 1.000_001).log10().floor()).clamp(0.0, 9.0) as usize;
    let text = |v: f64| {
        format!("{:.decimals$}", if v.abs() < 1e-9 * step { 0.0 } else { v * factor }).replace('-', "−")
    };
    Ticks { at: values.iter().map(|&v| (v, text(v))).collect(), exponent }
}

/// Returns the smallest step of 1, 2 or 5 times a power of ten with at most `count` multiples in `range`, and
/// these multiples.
fn round_numbers(range: &Range<f64>, count: usize) -> (f64, Vec<f64>) {
    let min_step = (range.end - range.start) / count.max(1) as f64;
    let power = 10.0_f64.powf(min_step.log10().floor());
    let multiples = |step: f64| {
        let (first, last) = ((range.start / step - 1e-9).ceil(), (range.end / step + 1e-9).floor());
        (0..=(last - first).max(0.0) as usize).map(|i| (first + i as f64) * step).collect::<Vec<_>>()
    };
    let steps = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0].map(|factor| factor * power);
    let mut tried = steps.into_iter().map(|step| (step, multiples(step)));
    tried.find(|(_, values)| values.len() <= count).unwrap_or((steps[5], Vec::new()))
}

/// Returns `quantity [unit]`, with the power of ten by which the ticks are divided.
pub(super) fn axis_label(quantity: &str, unit: &str, exponent: i32) -> String {
    const SUPERSCRIPTS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let digit = |c: char| c.to_digit(10).map_or('⁻', |d| SUPERSCRIPTS[d as usize]);
    let power: String = exponent.to_string().chars().map(digit).collect();
    match (unit, exponent) {
        ("", 0) => quantity.to_owned(),
        (_, 0) => format!("{quantity} [{unit}]"),
        ("", _) => format!("{quantity} [10{power}]"),
        _ => format!("{quantity} [10{power} {unit}]"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::figure::Line;
    use super::*;

    fn texts(range: Range<f64>, count: usize) -> (Vec<String>, i32) {
        let ticks = ticks(&range, count);
        (ticks.at.into_iter().map(|(_, text)| text).collect(), ticks.exponent)
    }

    #[test]
    fn numbers_have_as_many_digits_as_their_step() {
        assert_eq!(texts(-0.1..0.11, 5).0, ["−0.10", "−0.05", "0.00", "0.05", "0.10"]);
        assert_eq!(texts(0.0..6.0, 10).0, ["0", "1", "2", "3", "4", "5", "6"]);
    }

    #[test]
    fn powers_of_ten_go_to_the_label() {
        let (texts, exponent) = texts(0.0..2.1e-7, 3);
        assert_eq!((texts[1].as_str(), exponent), ("100", -9));
        assert_eq!(axis_label("power", "W", exponent), "power [10⁻⁹ W]");
    }

    #[test]
    fn limits_are_in_sight_unless_far_away() {
        let panel = |limit| {
            let line = Line::solid("", 0, vec![0.0, 1.0], vec![-1.0, 4.0]);
            y_range(&Panel::new("", "", "").line(line).band(limit, ""))
        };
        assert!(panel(12.0).end > 12.0 && panel(12.0).start < -12.0);
        assert!(panel(100.0).end < 5.0);
    }

    #[test]
    fn a_panel_is_as_high_as_it_says_at_least() {
        let line = Line::solid("", 0, vec![0.0, 1.0], vec![2.0, 2.1]);
        let range = y_range(&Panel::new("", "", "").at_least(1.0).line(line.clone()));
        // From 1.55 to 2.55, with margins of 9 %.
        assert!((range.start - 1.46).abs() < 1e-9 && (range.end - 2.64).abs() < 1e-9, "{range:?}");
        let range = y_range(&Panel::new("", "", "").at_least(0.05).line(line));
        assert!((range.start - 1.991).abs() < 1e-9 && (range.end - 2.109).abs() < 1e-9, "{range:?}");
    }

    #[test]
    fn panels_of_one_quantity_share_their_scale() {
        let panel = |quantity, y| {
            Panel::new("", quantity, "N").line(Line::solid("", 0, vec![0.0, 1.0], vec![0.0, y]))
        };
        let panels = [panel("force", 3.0), panel("force", 4.0), panel("weight", 9.0), panel("force", 1.0)];
        let ranges = panels.each_ref().map(|panel| shared_y_range(&panels, panel));
        assert_eq!(ranges[0], ranges[1]);
        assert!((4.0..5.0).contains(&ranges[0].end) && ranges[2].end > 9.0);
        assert!((1.0..1.2).contains(&ranges[3].end), "a shared scale would flatten this one");
    }

    #[test]
    fn six_seconds_end_at_six() {
        let line = Line::solid("", 0, vec![0.0, 5.99], vec![0.0, 0.0]);
        assert_eq!(x_range(&[Panel::new("", "", "").line(line)]), 0.0..6.0);
    }
}
