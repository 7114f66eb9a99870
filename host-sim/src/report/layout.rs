//! Layout of a figure: panels, legends, and the strip with the names of phases and events.
#![allow(clippy::cast_precision_loss, reason = "counts of panels and letters")]

use std::ops::Range;

use super::axis::{equal_ranges, shared_y_range, x_range};
use super::figure::{Arrangement, Figure, Line, LineStyle, Panel, Rule};

/// Width of the drawing [px].
pub(super) const WIDTH: f64 = 860.0;
/// Margin left of the axes, for the numbers and the quantity [px].
pub(super) const LEFT: f64 = 66.0;
/// Range of the margin right of the axes, which holds the labels of limits [px].
const RIGHT: (f64, f64) = (16.0, 170.0);
/// Height of a row of a panel's head [px].
pub(super) const ROW: f64 = 19.0;
/// Height of a row of the strip with the names of phases and events [px].
pub(super) const STRIP_ROW: f64 = 15.0;
/// Space below the lowest axes [px].
const AXIS: f64 = 42.0;
const GAP: f64 = 14.0;
/// Space above everything [px].
const PAD: f64 = 4.0;

/// Sizes of text [px].
pub(super) const TITLE: f64 = 13.5;
pub(super) const TEXT: f64 = 12.0;
pub(super) const SMALL: f64 = 11.0;

/// Length of a line's sample in the legend, distance from there to its name, and to the next sample [px].
pub(super) const LEGEND_SAMPLE: (f64, f64, f64) = (26.0, 6.0, 16.0);

/// A pair of axes on the drawing [px], and their ranges.
pub(super) struct Axes {
    pub left: f64,
    pub right: f64,
    pub top: f64,
    pub bottom: f64,
    pub x: Range<f64>,
    pub y: Range<f64>,
}

impl Axes {
    pub fn at_x(&self, x: f64) -> f64 {
        self.left + (x - self.x.start) / (self.x.end - self.x.start) * (self.right - self.left)
    }

    /// Returns where the line of a limit begins [px].
    pub fn begin_of(&self, rule: &Rule) -> f64 {
        rule.from.map_or(self.left, |from| self.at_x(from).clamp(self.left, self.right))
    }

    pub fn at_y(&self, y: f64) -> f64 {
        self.bottom - (y - self.y.start) / (self.y.end - self.y.start) * (self.bottom - self.top)
    }
}

/// Rows of a panel's head: the lines that are explained in each row, and the width of each entry. The title
/// is in the first row.
pub(super) type Legend = Vec<Vec<(usize, f64)>>;

/// A name in the strip above the axes.
pub(super) struct StripLabel<'a> {
    /// Start of the phase, or time of the event, on the horizontal axis.
    pub at: f64,
    pub text: &'a str,
    /// Row, counted from the lowest, 0.
    pub row: usize,
    pub is_event: bool,
    /// Where the text begins [px].
    pub x: f64,
}

/// Positions of all parts.
pub(super) struct Layout<'a> {
    pub height: f64,
    pub legends: Vec<Legend>,
    pub strip: Vec<StripLabel<'a>>,
    /// For each panel, the top of its head and its axes.
    pub panels: Vec<(f64, Axes)>,
}

impl<'a> Layout<'a> {
    pub fn new(figure: &'a Figure) -> Self {
        let legends = legends(figure);
        let (width, tall) = (panel_width(figure), plot_height(figure));
        let shared = x_range(&figure.panels);
        let stacked = figure.arrangement == Arrangement::Stacked;
        let strip = if stacked { strip(figure, &shared, width) } else { Vec::new() };
        let rows = strip.iter().map(|label| label.row + 1).max().unwrap_or(0);
        let strip_height = rows as f64 * STRIP_ROW;
        let head = |legend: &Legend| legend.len() as f64 * ROW + 6.0;
        let highest = legends.iter().map(head).fold(ROW, f64::max);
        let (mut left, mut top, mut bottom) = (LEFT, PAD, 0.0_f64);
        let mut panels = Vec::new();
        for (i, (panel, legend)) in figure.panels.iter().zip(&legends).enumerate() {
            let (x, y, head) = if stacked {
                let y = shared_y_range(&figure.panels, panel);
                (shared.clone(), y, head(legend) + if i == 0 { strip_height } else { 0.0 })
            } else {
                let (x, y) = equal_ranges(panel, width / tall);
                (x, y, highest)
            };
            let axes = Axes { left, right: left + width, top: top + head, bottom: top + head + tall, x, y };
            bottom = axes.bottom;
            panels.push((top, axes));
            if stacked {
                top = bottom + GAP;
            } else {
                left += WIDTH / figure.panels.len() as f64;
            }
        }
        Self { height: bottom + AXIS, legends, strip, panels }
    }
}

/// Estimates the width of a text in a common sans-serif font [px].
fn text_width(text: &str, size: f64) -> f64 {
    let width = |letter: char| match letter {
        'i' | 'j' | 'l' | 'I' | '\'' | '.' | ',' | ':' | ';' | '|' | '·' => 0.28,
        'f' | 't' | 'r' | ' ' | '(' | ')' | '[' | ']' | '/' | '-' => 0.36,
        'm' | 'w' | 'M' | 'W' | '→' | '↑' | '↓' => 0.88,
        'A'..='Z' => 0.68,
        _ => 0.57,
    };
    text.chars().map(width).sum::<f64>() * size
}

/// A line is explained at its first appearance: in a stacked figure once, otherwise once per panel.
fn legends(figure: &Figure) -> Vec<Legend> {
    let mut seen: Vec<(&str, usize, LineStyle)> = Vec::new();
    let mut legends = Vec::new();
    for panel in &figure.panels {
        if figure.arrangement == Arrangement::Paths {
            seen.clear();
        }
        let mut named = Vec::new();
        for (i, line) in panel.lines.iter().enumerate().filter(|(_, line)| !line.name.is_empty()) {
            let key = (line.name.as_str(), line.colour, line.style);
            if !seen.contains(&key) {
                seen.push(key);
                named.push((i, line));
            }
        }
        legends.push(flow(named.into_iter(), text_width(&panel.title, TITLE) + 20.0, panel_width(figure)));
    }
    legends
}

/// Fills rows from the left; the first is beside the title if everything fits there.
fn flow<'a>(lines: impl Iterator<Item = (usize, &'a Line)>, title: f64, width: f64) -> Legend {
    let (sample, space, after) = LEGEND_SAMPLE;
    let entries: Vec<(usize, f64)> =
        lines.map(|(i, line)| (i, sample + space + text_width(&line.name, TEXT) + after)).collect();
    let total: f64 = entries.iter().map(|entry| entry.1).sum();
    if title + total <= width {
        return vec![entries];
    }
    let mut rows: Legend = vec![Vec::new(), Vec::new()];
    let mut used = 0.0;
    for entry in entries {
        if used > 0.0 && used + entry.1 > width {
            rows.push(Vec::new());
            used = 0.0;
        }
        used += entry.1;
        if let Some(row) = rows.last_mut() {
            row.push(entry);
        }
    }
    rows
}

/// Places each name in the lowest row in which it does not touch those to its left.
fn strip<'a>(figure: &'a Figure, range: &Range<f64>, width: f64) -> Vec<StripLabel<'a>> {
    let phases = figure.phases.iter().map(|phase| (phase.from, phase.label.as_str(), false));
    let events = figure.events.iter().map(|event| (event.at, event.label.as_str(), true));
    let mut marks: Vec<_> =
        phases.chain(events).filter(|(at, text, _)| !text.is_empty() && range.contains(at)).collect();
    marks.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut ends: Vec<f64> = Vec::new();
    let mut labels = Vec::new();
    for (at, text, is_event) in marks {
        let wide = text_width(text, SMALL) + 8.0;
        let from = LEFT + (at - range.start) / (range.end - range.start) * width + 3.0;
        // At the right edge, the text ends at the edge of the figure.
        let x = from.min(WIDTH - wide).max(LEFT);
        let row = ends.iter().position(|end| *end <= x - 3.0).unwrap_or(ends.len());
        if row == ends.len() {
            ends.push(0.0);
        }
        ends[row] = x + wide;
        labels.push(StripLabel { at, text, row, is_event, x });
    }
    labels
}

fn right_margin(figure: &Figure) -> f64 {
    let widths = |panel: &Panel| {
        panel.rules.iter().map(|rule| text_width(&rule.label, SMALL) + 24.0).fold(RIGHT.0, f64::max)
    };
    match figure.arrangement {
        Arrangement::Stacked => figure.panels.iter().map(widths).fold(RIGHT.0, f64::max).min(RIGHT.1),
        Arrangement::Paths => RIGHT.0,
    }
}

fn panel_width(figure: &Figure) -> f64 {
    match figure.arrangement {
        Arrangement::Stacked => WIDTH - LEFT - right_margin(figure),
        Arrangement::Paths => WIDTH / (figure.panels.len().max(1) as f64) - LEFT - RIGHT.0,
    }
}

fn plot_height(figure: &Figure) -> f64 {
    match (figure.arrangement, figure.panels.len()) {
        (Arrangement::Stacked, 1) => 260.0,
        (Arrangement::Stacked, 2) => 190.0,
        (Arrangement::Stacked, 3) => 146.0,
        (Arrangement::Stacked, _) => 118.0,
        (Arrangement::Paths, _) => panel_width(figure).min(420.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_phases_do_not_overlap() {
        let panel = Panel::new("", "", "").line(Line::solid("", 0, vec![0.0, 10.0], vec![0.0, 1.0]));
        let mut figure = Figure::stacked("", "", "time", "s").panel(panel);
        for k in 0..20_u32 {
            figure =
                figure.phase(f64::from(k) * 0.5, f64::from(k + 1) * 0.5, format!("the phase number {k}"));
        }
        figure = figure.event(9.99, "the end of everything");
        let layout = Layout::new(&figure);
        assert_eq!(layout.strip.len(), 21);
        for (i, a) in layout.strip.iter().enumerate() {
            let end = a.x + text_width(a.text, SMALL);
            assert!(a.x >= LEFT && end <= WIDTH, "{}", a.text);
            for b in &layout.strip[i + 1..] {
                assert!(
                    a.row != b.row || end < b.x || b.x + text_width(b.text, SMALL) < a.x,
                    "{} {}",
                    a.text,
                    b.text
                );
            }
        }
    }
}
