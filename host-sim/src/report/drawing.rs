//! Figures as SVG.
//!
//! Colours are written as attributes, so that a file looks right wherever it is opened; with the additional
//! classes, the page's style sheet replaces the colours on dark pages.

use base64::Engine;
use svg::Document;
use svg::node::element::{Circle, Group, Image, Polyline, Rectangle, Text, Title};

use super::axis::{X_TICKS, axis_label, ticks};
use super::figure::{Arrangement, Figure, LineStyle, Panel, Picture};
use super::layout::{
    Axes, LEFT, LEGEND_SAMPLE, Layout, Legend, ROW, SMALL, STRIP_ROW, StripLabel, TEXT, TITLE, WIDTH,
};
use super::palette::{BAND, GRID, GROUND, INK, LIMIT, LINES, MUTED, Paint, SHADE};

/// Number of point groups that are kept of a line, see `Line::decimated`.
pub(super) const BUCKETS: usize = 300;

const FONT: &str =
    "system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', 'Liberation Sans', Arial, sans-serif";

/// Width of a stroke [px] and its dashes.
type Stroke = (f64, &'static str);
const SOLID: Stroke = (1.75, "");
const DASHED: Stroke = (1.5, "5 3.5");
const RULE: Stroke = (1.25, "2 2.5");
const EVENT: Stroke = (0.75, "3 3");
const HAIR: Stroke = (0.75, "");
const FRAME: Stroke = (1.0, "");

impl Figure {
    /// Draws the figure as a stand-alone SVG document on a white background.
    pub fn svg(&self) -> String {
        let layout = Layout::new(self);
        let ground = rectangle([(0.0, 0.0), (WIDTH, layout.height)], GROUND);
        let body = draw(self, &layout, BUCKETS);
        let size = |document: Document| document.set("width", WIDTH).set("height", round(layout.height));
        size(document(self, &layout)).add(ground).add(body).to_string() + "\n"
    }
}

/// Draws the figure as a part of a page that styles it.
pub(super) fn inline_svg(figure: &Figure, buckets: usize) -> String {
    let layout = Layout::new(figure);
    document(figure, &layout).add(draw(figure, &layout, buckets)).to_string()
}

fn document(figure: &Figure, layout: &Layout<'_>) -> Document {
    Document::new()
        .set("viewBox", format!("0 0 {WIDTH} {}", round(layout.height)))
        .set("role", "img")
        .add(Title::new(figure.title.as_str()))
}

fn draw(figure: &Figure, layout: &Layout<'_>, buckets: usize) -> Group {
    let mut group = Group::new().set("fill", "none").set("stroke-linejoin", "round").set("font-family", FONT);
    for (i, (panel, (top, axes))) in figure.panels.iter().zip(&layout.panels).enumerate() {
        let last = i + 1 == figure.panels.len() || figure.arrangement == Arrangement::Paths;
        group = draw_head(group, panel, &layout.legends[i], axes, *top);
        group = draw_phases(group, figure, axes);
        group = draw_axes(group, figure, panel, axes, last);
        group = draw_picture(group, panel, axes);
        group = draw_lines(group, panel, axes, buckets);
        group = draw_rule_labels(group, panel, axes, figure.arrangement);
        group = draw_marks(group, panel, axes);
        if i == 0 {
            group = draw_strip(group, layout, axes);
        }
    }
    group
}

/// Rounds to a tenth of a pixel.
fn round(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

#[derive(Clone, Copy)]
enum Anchor {
    Start,
    Middle,
    End,
}

/// Creates a text whose small letters are vertically centred at `y`.
fn text(content: &str, (x, y): (f64, f64), size: f64, paint: Paint, anchor: Anchor) -> Text {
    let anchor = match anchor {
        Anchor::Start => "start",
        Anchor::Middle => "middle",
        Anchor::End => "end",
    };
    Text::new(content)
        .set("x", round(x))
        .set("y", round(y + 0.35 * size))
        .set("font-size", size)
        .set("text-anchor", anchor)
        .set("fill", paint.colour)
        .set("class", paint.class)
}

/// Creates a text with an outline in the colour of the background, for text on lines.
fn text_on_lines(content: &str, at: (f64, f64), paint: Paint, anchor: Anchor) -> Text {
    text(content, at, SMALL, paint, anchor)
        .set("paint-order", "stroke")
        .set("stroke", GROUND.colour)
        .set("stroke-width", 3.5)
}

fn polyline(points: impl IntoIterator<Item = (f64, f64)>, paint: Paint, (width, dashes): Stroke) -> Polyline {
    let points: Vec<String> = points.into_iter().map(|(x, y)| format!("{},{}", round(x), round(y))).collect();
    let line = Polyline::new()
        .set("points", points.join(" "))
        .set("stroke", paint.colour)
        .set("class", paint.class)
        .set("stroke-width", width);
    if dashes.is_empty() { line } else { line.set("stroke-dasharray", dashes) }
}

fn rectangle([(left, top), (right, bottom)]: [(f64, f64); 2], paint: Paint) -> Rectangle {
    Rectangle::new()
        .set("x", round(left))
        .set("y", round(top))
        .set("width", round(right - left))
        .set("height", round(bottom - top))
        .set("fill", paint.colour)
        .set("class", paint.class)
}

/// Draws title and legend.
fn draw_head(mut group: Group, panel: &Panel, legend: &Legend, axes: &Axes, top: f64) -> Group {
    let mut y = top + 0.5 * ROW;
    let title = text(&panel.title, (axes.left, y), TITLE, INK, Anchor::Start);
    group = group.add(title.set("font-weight", "bold"));
    let (sample, space, after) = LEGEND_SAMPLE;
    for (row, entries) in legend.iter().enumerate() {
        let total: f64 = entries.iter().map(|entry| entry.1).sum();
        let mut x = if row == 0 { axes.right - total + after } else { axes.left };
        for &(i, width) in entries {
            let line = &panel.lines[i];
            let (paint, stroke) = (LINES[line.colour % LINES.len()], stroke(line.style));
            group = group.add(polyline([(x, y), (x + sample, y)], paint, stroke)).add(text(
                &line.name,
                (x + sample + space, y),
                TEXT,
                INK,
                Anchor::Start,
            ));
            x += width;
        }
        y += ROW;
    }
    group
}

const fn stroke(style: LineStyle) -> Stroke {
    match style {
        LineStyle::Solid => SOLID,
        LineStyle::Dashed => DASHED,
    }
}

fn draw_picture(group: Group, panel: &Panel, axes: &Axes) -> Group {
    let Some(Picture { png, x, y }) = &panel.picture else { return group };
    let ([left, right], [top, bottom]) = (x.map(|x| axes.at_x(x)), y.map(|y| axes.at_y(y)));
    let data = base64::engine::general_purpose::STANDARD.encode(png);
    let picture = Image::new()
        .set("x", round(left))
        .set("y", round(top))
        .set("width", round(right - left))
        .set("height", round(bottom - top))
        .set("preserveAspectRatio", "none")
        .set("href", format!("data:image/png;base64,{data}"));
    group.add(picture)
}

/// Shades every other phase, and draws a line at each event.
fn draw_phases(mut group: Group, figure: &Figure, axes: &Axes) -> Group {
    if figure.arrangement == Arrangement::Paths {
        return group;
    }
    for phase in figure.phases.iter().step_by(2) {
        let (from, to) = (phase.from.max(axes.x.start), phase.to.min(axes.x.end));
        if from < to {
            let corners = [(axes.at_x(from), axes.top), (axes.at_x(to), axes.bottom)];
            group = group.add(rectangle(corners, SHADE));
        }
    }
    for event in figure.events.iter().filter(|event| axes.x.contains(&event.at)) {
        let x = axes.at_x(event.at);
        group = group.add(polyline([(x, axes.top), (x, axes.bottom)], MUTED, EVENT));
    }
    group
}

/// Draws the names of phases and events above the first panel, over all lines.
fn draw_strip(mut group: Group, layout: &Layout<'_>, axes: &Axes) -> Group {
    #[expect(clippy::cast_precision_loss, reason = "a few rows")]
    let foot = |label: &StripLabel<'_>| axes.top - label.row as f64 * STRIP_ROW;
    for label in &layout.strip {
        let (x, foot) = (axes.at_x(label.at), foot(label));
        let stroke = if label.is_event { EVENT } else { HAIR };
        group = group.add(polyline([(x, foot - STRIP_ROW + 2.0), (x, axes.top)], MUTED, stroke));
    }
    for label in &layout.strip {
        let at = (label.x, foot(label) - 0.5 * STRIP_ROW);
        group = group.add(text_on_lines(label.text, at, MUTED, Anchor::Start));
    }
    group
}

/// Draws grid, numbers, frame and quantities.
fn draw_axes(mut group: Group, figure: &Figure, panel: &Panel, axes: &Axes, x_labels: bool) -> Group {
    let &Axes { left, right, top, bottom, .. } = axes;
    for rule in panel.rules.iter().filter(|rule| rule.band) {
        let (low, high) = ((-rule.value).max(axes.y.start), rule.value.min(axes.y.end));
        if high < axes.y.end && low < high {
            let left = axes.begin_of(rule);
            let band = rectangle([(left, axes.at_y(high)), (right, axes.at_y(low))], BAND);
            // Phases remain visible.
            group = group.add(band.set("fill-opacity", 0.6));
        }
    }
    let x_ticks = ticks(&axes.x, count((right - left) / 65.0, X_TICKS));
    for (x, label) in &x_ticks.at {
        let x = axes.at_x(*x);
        group = group.add(polyline([(x, top), (x, bottom)], GRID, HAIR)).add(polyline(
            [(x, bottom), (x, bottom + 4.0)],
            MUTED,
            FRAME,
        ));
        if x_labels {
            group = group.add(text(label, (x, bottom + 13.0), TEXT, MUTED, Anchor::Middle));
        }
    }
    let upwards = axes.y.start.min(axes.y.end)..axes.y.end.max(axes.y.start);
    let y_ticks = ticks(&upwards, count((bottom - top) / 26.0, usize::MAX));
    for (y, label) in &y_ticks.at {
        let (at, paint) = (axes.at_y(*y), if *y == 0.0 { MUTED } else { GRID });
        group = group
            .add(polyline([(left, at), (right, at)], paint, HAIR))
            .add(polyline([(left - 4.0, at), (left, at)], MUTED, FRAME))
            .add(text(label, (left - 7.0, at), TEXT, MUTED, Anchor::End));
    }
    group = group.add(polyline([(left, top), (left, bottom), (right, bottom)], MUTED, FRAME));
    let (x, y) = (left - LEFT + 10.0, f64::midpoint(top, bottom));
    let quantity = axis_label(&panel.quantity, &panel.unit, y_ticks.exponent);
    let quantity = text(&quantity, (x, y), TEXT, INK, Anchor::Middle);
    group = group.add(quantity.set("transform", format!("rotate(-90 {} {})", round(x), round(y))));
    if x_labels {
        let quantity = axis_label(&figure.quantity, &figure.unit, x_ticks.exponent);
        let at = (f64::midpoint(left, right), bottom + 31.0);
        group = group.add(text(&quantity, at, TEXT, INK, Anchor::Middle));
    }
    group
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few numbers on an axis")]
fn count(room: f64, max: usize) -> usize {
    (room.max(3.0) as usize).min(max)
}

/// Draws limits, and lines above them.
fn draw_lines(mut group: Group, panel: &Panel, axes: &Axes, buckets: usize) -> Group {
    let shown = |value: &f64| *value > axes.y.start && *value < axes.y.end;
    for rule in &panel.rules {
        let values = [Some(rule.value), rule.band.then_some(-rule.value)];
        for value in values.into_iter().flatten().filter(shown) {
            let y = axes.at_y(value);
            group = group.add(polyline([(axes.begin_of(rule), y), (axes.right, y)], LIMIT, RULE));
        }
    }
    for line in &panel.lines {
        for piece in line.decimated(buckets).split(Option::is_none) {
            let at = |(x, y): (f64, f64)| (round(axes.at_x(x)), round(axes.at_y(y)));
            let mut points: Vec<(f64, f64)> = piece.iter().flatten().copied().map(at).collect();
            points.dedup();
            if points.len() > 1 {
                group = group.add(polyline(points, LINES[line.colour % LINES.len()], stroke(line.style)));
            }
        }
    }
    group
}

/// Draws the labels of limits at the right margin from the top, each at its line or just below its neighbour;
/// inside the axes if there is no margin.
fn draw_rule_labels(mut group: Group, panel: &Panel, axes: &Axes, arrangement: Arrangement) -> Group {
    let mut rules: Vec<_> = panel.rules.iter().collect();
    rules.sort_by(|a, b| b.value.total_cmp(&a.value));
    let mut free = axes.top;
    for rule in rules {
        let arrow = if rule.value >= axes.y.end {
            " ↑"
        } else if rule.value <= axes.y.start {
            " ↓"
        } else {
            ""
        };
        let y = axes.at_y(rule.value.clamp(axes.y.start, axes.y.end)).max(free + 6.0);
        let label = format!("{}{arrow}", rule.label);
        group = group.add(match arrangement {
            Arrangement::Stacked => text(&label, (axes.right + 6.0, y), SMALL, LIMIT, Anchor::Start),
            Arrangement::Paths => text_on_lines(&label, (axes.right - 4.0, y + 8.0), LIMIT, Anchor::End),
        });
        free = y + 8.0;
    }
    group
}

fn draw_marks(mut group: Group, panel: &Panel, axes: &Axes) -> Group {
    for mark in &panel.marks {
        let (x, y) = (axes.at_x(mark.x), axes.at_y(mark.y));
        if !x.is_finite() || !y.is_finite() {
            continue;
        }
        // Away from the nearer edge; above high points and below low ones, as long as there is room.
        let (anchor, dx) = if x > axes.right - 150.0 { (Anchor::End, -8.0) } else { (Anchor::Start, 8.0) };
        let up = (mark.y >= 0.0 && y - axes.top > 16.0) || axes.bottom - y < 16.0;
        let point = Circle::new()
            .set("cx", round(x))
            .set("cy", round(y))
            .set("r", 3.4)
            .set("stroke", INK.colour)
            .set("class", INK.class)
            .set("stroke-width", SOLID.0);
        let at = (x + dx, y + if up { -8.0 } else { 8.0 });
        group = group.add(point).add(text_on_lines(&mark.label, at, INK, anchor));
    }
    if panel.lines.iter().all(|line| line.x.is_empty() || line.y.is_empty()) {
        let middle = (f64::midpoint(axes.left, axes.right), f64::midpoint(axes.top, axes.bottom));
        group = group.add(text("no data", middle, TEXT, MUTED, Anchor::Middle));
    }
    group
}
