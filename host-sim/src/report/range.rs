//! What axes span, and the numbers on them.
#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts of digits")]

use std::ops::Range;

use plotters::coord::ranged1d::{BoldPoints, Ranged};
use plotters::coord::types::RangedCoordf64;

use super::figure::Panel;

/// Numbers on a horizontal axis over the whole width.
pub(super) const X_TICKS: usize = 10;

fn span(values: impl Iterator<Item = f64>) -> Option<Range<f64>> {
    values.filter(|v| v.is_finite()).fold(None, |range, v| match range {
        None => Some(v..v),
        Some(r) => Some(r.start.min(v)..r.end.max(v)),
    })
}

/// `range` with room on both sides, and never empty.
fn padded(range: Option<Range<f64>>, share: f64) -> Range<f64> {
    let range = range.unwrap_or(0.0..1.0);
    let width = range.end - range.start;
    // A range that is a rounding error wide would have ticks that all read the same.
    let least = 1e-9 * range.start.abs().max(range.end.abs());
    if width <= least || !width.is_finite() {
        let half = (range.start.abs() * 0.1).clamp(1e-3, f64::MAX / 4.0);
        let middle = range.start.clamp(-f64::MAX / 4.0, f64::MAX / 4.0);
        return middle - half..middle + half;
    }
    range.start - share * width..range.end + share * width
}

pub(super) fn x_range(panels: &[Panel]) -> Range<f64> {
    let range = padded(span(panels.iter().flat_map(|p| &p.lines).flat_map(|l| l.x.iter().copied())), 0.0);
    // A run of 6 s ends at 5.99 s: to the next round number if it is that near.
    let step = step(&round_numbers(&range, X_TICKS));
    let near = |from: f64, to: f64| (from - to).abs() < 0.02 * (range.end - range.start);
    let (start, end) = ((range.start / step).floor() * step, (range.end / step).ceil() * step);
    let start = if near(range.start, start) { start } else { range.start };
    start..if near(range.end, end) { end } else { range.end }
}

/// Data and limits with some room; a limit far beyond the data is left out, and a word says where it is.
fn y_range(panel: &Panel) -> Range<f64> {
    let data = span(panel.lines.iter().flat_map(|l| l.y.iter().copied()));
    let extent = data.clone().map_or(0.0, |d| d.start.abs().max(d.end.abs()));
    let near = panel.rules.iter().filter(|r| extent == 0.0 || r.value.abs() <= 5.0 * extent);
    let rules = near.flat_map(|r| if r.band { vec![r.value, -r.value] } else { vec![r.value] });
    let range = padded(span(data.into_iter().flat_map(|d| [d.start, d.end]).chain(rules)), 0.09);
    // The words of windows stand below everything else.
    let foot = if panel.windows.is_empty() { 0.0 } else { 0.12 * (range.end - range.start) };
    range.start - foot..range.end
}

/// Panels of one quantity share a scale, so that they can be compared.
pub(super) fn shared_y_range(panels: &[Panel], panel: &Panel) -> Range<f64> {
    let alike = |other: &&Panel| (&other.quantity, &other.unit) == (&panel.quantity, &panel.unit);
    panels
        .iter()
        .filter(alike)
        .map(y_range)
        .fold(y_range(panel), |a, b| a.start.min(b.start)..a.end.max(b.end))
}

/// Ranges of one scale that hold the panel's lines.
pub(super) fn equal_ranges(panel: &Panel, aspect: f64) -> (Range<f64>, Range<f64>) {
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
    /// Where, and what is written there.
    pub at: Vec<(f64, String)>,
    /// The power of ten that was taken out of what is written, a multiple of three.
    pub exponent: i32,
}

/// At most `count` round numbers in `range`.
pub(super) fn ticks(range: &Range<f64>, count: usize) -> Ticks {
    let values = round_numbers(range, count);
    let step = step(&values);
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

fn round_numbers(range: &Range<f64>, count: usize) -> Vec<f64> {
    RangedCoordf64::from(range.clone()).key_points(BoldPoints(count))
}

fn step(values: &[f64]) -> f64 {
    values.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min)
}

/// `quantity [unit]`, with the power of ten that was taken out of the ticks.
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
            let line = super::super::Line::solid("", 0, vec![0.0, 1.0], vec![-1.0, 4.0]);
            y_range(&Panel::new("", "", "").line(line).band(limit, ""))
        };
        assert!(panel(12.0).end > 12.0 && panel(12.0).start < -12.0);
        assert!(panel(100.0).end < 5.0);
    }

    #[test]
    fn panels_of_one_quantity_share_their_scale() {
        let panel = |quantity, y| {
            Panel::new("", quantity, "N").line(super::super::Line::solid("", 0, vec![0.0, 1.0], vec![0.0, y]))
        };
        let panels = [panel("force", 1.0), panel("force", 4.0), panel("weight", 9.0)];
        let ranges = panels.each_ref().map(|panel| shared_y_range(&panels, panel));
        assert_eq!(ranges[0], ranges[1]);
        assert!((4.0..5.0).contains(&ranges[0].end) && ranges[2].end > 9.0);
    }

    #[test]
    fn six_seconds_end_at_six() {
        let line = super::super::Line::solid("", 0, vec![0.0, 5.99], vec![0.0, 0.0]);
        assert_eq!(x_range(&[Panel::new("", "", "").line(line)]), 0.0..6.0);
    }
}
