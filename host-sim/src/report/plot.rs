//! Figures as SVG.
//!
//! plotters writes the elements; where they go is decided here, because its own layout knows neither shared axes nor
//! legends beside a title. It snaps to whole pixels, so everything is drawn [`SCALE`] times as large as it is shown.
//! The colours written are those for a light page; the style sheet in the page swaps them for a dark one.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "pixels of a figure of bounded size"
)]

use std::ops::Range;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::figure::{Figure, Layout, Line, LineStyle, Panel};
use super::page::escape;
use super::range::{X_TICKS, axis_label, equal_ranges, shared_y_range, ticks, x_range};

/// Groups of points that are kept of a line, see `Line::decimated`.
pub(super) const BUCKETS: usize = 300;

/// Drawn pixels for one on the screen.
const SCALE: f64 = 4.0;
const WIDTH: f64 = 860.0;
const LEFT: f64 = 66.0;
/// Right margin without and with words in it.
const RIGHT: (f64, f64) = (14.0, 108.0);
const ROW: f64 = 19.0;
const AXIS: f64 = 42.0;
const GAP: f64 = 12.0;

const TEXT: f64 = 12.0;
const SMALL: f64 = 11.0;
/// Words of windows, which unlike those of size `SMALL` have no margin around them.
const PLAIN: f64 = 10.75;
/// Mean width of a character of a sans-serif font, in its size.
const CHARACTER: f64 = 0.53;

const INK: RGBColor = RGBColor(0x1B, 0x1F, 0x24);
const MUTED: RGBColor = RGBColor(0x57, 0x60, 0x6A);
const GRID: RGBColor = RGBColor(0xDD, 0xE2, 0xE7);
const SHADE: RGBColor = RGBColor(0xE6, 0xEB, 0xF1);
const BAND: RGBColor = RGBColor(0xF4, 0xF6, 0xF9);
const LIMIT: RGBColor = RGBColor(0x9A, 0x1F, 0x40);

/// Okabe and Ito's colours, told apart by colour-blind people too; the palest last but one, black last.
pub(super) const PALETTE: [RGBColor; 8] = [
    RGBColor(0x00, 0x72, 0xB2),
    RGBColor(0xD5, 0x5E, 0x00),
    RGBColor(0x00, 0x9E, 0x73),
    RGBColor(0xCC, 0x79, 0xA7),
    RGBColor(0xE6, 0x9F, 0x00),
    RGBColor(0x56, 0xB4, 0xE9),
    RGBColor(0xF0, 0xE4, 0x42),
    INK,
];

/// Widths that are used for nothing else, so that dashes can be added to what plotters wrote.
const DASHES: [(u32, &str); 2] = [(6, "20 15"), (5, "9 9")];
const SOLID_WIDTH: u32 = 7;
const DASHED_WIDTH: u32 = DASHES[0].0;
const RULE_WIDTH: u32 = DASHES[1].0;

type Root<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

fn px(value: f64) -> i32 {
    (value * SCALE).round() as i32
}

/// A pair of axes on the drawing, in pixels of the screen.
struct Axes {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
    x: Range<f64>,
    y: Range<f64>,
}

impl Axes {
    fn at_x(&self, x: f64) -> f64 {
        self.left + (x - self.x.start) / (self.x.end - self.x.start) * (self.right - self.left)
    }

    fn at_y(&self, y: f64) -> f64 {
        self.bottom - (y - self.y.start) / (self.y.end - self.y.start) * (self.bottom - self.top)
    }

    fn at(&self, (x, y): (f64, f64)) -> (i32, i32) {
        (px(self.at_x(x)), px(self.at_y(y)))
    }
}

/// The figure as SVG: a document of its own on a white ground, or a part of a page that styles it.
pub(super) fn svg(figure: &Figure, buckets: usize, alone: bool) -> String {
    let legends = legends(figure);
    let (width, height) = (WIDTH, height(figure, &legends));
    let mut drawn = String::new();
    // The errors of the backend are those of writing a file, and this one writes a string.
    draw(&mut drawn, figure, &legends, buckets, height, alone).expect("drawing into a string does not fail");
    for (line, dashes) in DASHES {
        let attribute = format!("stroke-width=\"{line}\"");
        drawn = drawn.replace(&attribute, &format!("{attribute} stroke-dasharray=\"{dashes}\""));
    }
    // Words on lines keep a margin around them.
    let size = format!("font-size=\"{}\"", SMALL * SCALE);
    let halo = "paint-order=\"stroke\" stroke=\"#FFFFFF\" stroke-width=\"14\"";
    drawn = drawn.replace(&size, &format!("{size} {halo}"));
    let body = drawn.split_once('>').map_or("", |(_, rest)| rest);
    let size = if alone { format!(" width=\"{width}\" height=\"{height}\"") } else { String::new() };
    let title = escape(&figure.title);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\"{size} role=\"img\" stroke-linejoin=\"round\" \
         aria-label=\"{title}\"><title>{title}</title>{body}",
        px(width),
        px(height),
    )
}

/// Rows of the head of a panel: which entries of the legend stand in which row; the title is in the first.
type Legend = Vec<Vec<(usize, f64)>>;

fn text_width(text: &str, size: f64) -> f64 {
    text.chars().count() as f64 * size * CHARACTER
}

/// An entry stands where it first appears: in a stacked figure once, otherwise once a panel.
fn legends(figure: &Figure) -> Vec<Legend> {
    let mut seen: Vec<(&str, usize, LineStyle)> = Vec::new();
    let mut legends = Vec::new();
    for panel in &figure.panels {
        if figure.layout == Layout::Paths {
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
        legends.push(flow(named.into_iter(), text_width(&panel.title, 13.5) + 20.0, panel_width(figure)));
    }
    legends
}

/// Fills rows from the left, the first beside the title if all fits there.
fn flow<'a>(lines: impl Iterator<Item = (usize, &'a Line)>, title: f64, width: f64) -> Legend {
    let entries: Vec<(usize, f64)> =
        lines.map(|(i, line)| (i, 32.0 + text_width(&line.name, TEXT) + 14.0)).collect();
    let total: f64 = entries.iter().map(|e| e.1).sum();
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

fn right_margin(figure: &Figure) -> f64 {
    let words = figure.panels.iter().any(|panel| !panel.rules.is_empty());
    if words && figure.layout == Layout::Stacked { RIGHT.1 } else { RIGHT.0 }
}

fn panel_width(figure: &Figure) -> f64 {
    match figure.layout {
        Layout::Stacked => WIDTH - LEFT - right_margin(figure),
        Layout::Paths => WIDTH / (figure.panels.len().max(1) as f64) - LEFT - RIGHT.0,
    }
}

fn plot_height(figure: &Figure) -> f64 {
    match (figure.layout, figure.panels.len()) {
        (Layout::Stacked, 1) => 260.0,
        (Layout::Stacked, 2) => 190.0,
        (Layout::Stacked, 3) => 138.0,
        (Layout::Stacked, _) => 112.0,
        (Layout::Paths, _) => panel_width(figure).min(420.0),
    }
}

fn height(figure: &Figure, legends: &[Legend]) -> f64 {
    let heads = legends.iter().map(|legend| legend.len() as f64 * ROW + 6.0);
    let panel = plot_height(figure);
    match figure.layout {
        Layout::Stacked => heads.map(|head| head + panel + GAP).sum::<f64>() + AXIS,
        Layout::Paths => heads.fold(ROW, f64::max) + panel + AXIS + GAP,
    }
}

fn draw(
    target: &mut String,
    figure: &Figure,
    legends: &[Legend],
    buckets: usize,
    height: f64,
    alone: bool,
) -> Drawn {
    let root = SVGBackend::with_string(target, (px(WIDTH) as u32, px(height) as u32)).into_drawing_area();
    if alone {
        root.fill(&WHITE)?;
    }
    let shared = x_range(&figure.panels);
    let mut left = LEFT;
    let mut top = 0.0;
    for (i, (panel, legend)) in figure.panels.iter().zip(legends).enumerate() {
        let head = match figure.layout {
            Layout::Stacked => legend.len() as f64 * ROW + 6.0,
            Layout::Paths => legends.iter().map(|l| l.len() as f64 * ROW + 6.0).fold(ROW, f64::max),
        };
        let (width, tall) = (panel_width(figure), plot_height(figure));
        let (x, y) = match figure.layout {
            Layout::Stacked => (shared.clone(), shared_y_range(&figure.panels, panel)),
            Layout::Paths => equal_ranges(panel, width / tall),
        };
        let axes = Axes { left, right: left + width, top: top + head, bottom: top + head + tall, x, y };
        draw_head(&root, panel, legend, &axes, top)?;
        let last = i + 1 == figure.panels.len() || figure.layout == Layout::Paths;
        draw_axes(&root, figure, panel, &axes, last)?;
        draw_lines(&root, panel, &axes, buckets)?;
        draw_windows(&root, panel, &axes)?;
        draw_rule_labels(&root, panel, &axes, figure.layout)?;
        draw_marks(&root, panel, &axes)?;
        match figure.layout {
            Layout::Stacked => top = axes.bottom + GAP,
            Layout::Paths => left += WIDTH / figure.panels.len() as f64,
        }
    }
    root.present()?;
    Ok(())
}

fn style(size: f64, colour: RGBColor, h: HPos, v: VPos) -> TextStyle<'static> {
    // plotters divides by 1.24 what it writes.
    ("sans-serif", size * SCALE * 1.24).into_font().color(&colour).pos(Pos::new(h, v))
}

fn word(root: &Root<'_>, text: &str, (x, y): (f64, f64), style: TextStyle<'static>) -> Drawn {
    root.draw(&Text::new(text.to_owned(), (px(x), px(y)), style))?;
    Ok(())
}

fn stroke(root: &Root<'_>, points: Vec<(i32, i32)>, colour: RGBColor, width: u32) -> Drawn {
    root.draw(&PathElement::new(points, colour.stroke_width(width)))?;
    Ok(())
}

fn rectangle(root: &Root<'_>, corners: [(f64, f64); 2], colour: RGBColor) -> Drawn {
    root.draw(&Rectangle::new(corners.map(|(x, y)| (px(x), px(y))), colour.filled()))?;
    Ok(())
}

fn line_width(line: &Line) -> u32 {
    if line.style == LineStyle::Dashed { DASHED_WIDTH } else { SOLID_WIDTH }
}

fn draw_head(root: &Root<'_>, panel: &Panel, legend: &Legend, axes: &Axes, top: f64) -> Drawn {
    let middle = |row: usize| top + (row as f64 + 0.5) * ROW;
    let title = FontDesc::new(FontFamily::SansSerif, 13.5 * SCALE * 1.24, FontStyle::Bold).color(&INK);
    word(root, &panel.title, (axes.left, middle(0)), title.pos(Pos::new(HPos::Left, VPos::Center)))?;
    for (row, entries) in legend.iter().enumerate() {
        let total: f64 = entries.iter().map(|e| e.1).sum();
        let mut x = if row == 0 { axes.right - total + 14.0 } else { axes.left };
        for &(i, width) in entries {
            let line = &panel.lines[i];
            let y = middle(row);
            stroke(
                root,
                vec![(px(x), px(y)), (px(x + 26.0), px(y))],
                PALETTE[line.colour % PALETTE.len()],
                line_width(line),
            )?;
            word(root, &line.name, (x + 32.0, y), style(TEXT, INK, HPos::Left, VPos::Center))?;
            x += width;
        }
    }
    Ok(())
}

fn draw_axes(root: &Root<'_>, figure: &Figure, panel: &Panel, axes: &Axes, x_labels: bool) -> Drawn {
    let &Axes { left, right, top, bottom, .. } = axes;
    for rule in panel.rules.iter().filter(|rule| rule.band) {
        let (low, high) = ((-rule.value).max(axes.y.start), rule.value.min(axes.y.end));
        if high < axes.y.end && low < high {
            rectangle(root, [(left, axes.at_y(high)), (right, axes.at_y(low))], BAND)?;
        }
    }
    for window in &panel.windows {
        let (from, to) = (window.from.max(axes.x.start), window.to.min(axes.x.end));
        if from < to {
            rectangle(root, [(axes.at_x(from), top), (axes.at_x(to), bottom)], SHADE)?;
        }
    }
    let x_ticks = ticks(
        &axes.x,
        if right - left > WIDTH / 2.0 { X_TICKS } else { ((right - left) / 65.0).max(3.0) as usize },
    );
    for (x, text) in x_ticks.at {
        let at = axes.at_x(x);
        stroke(root, vec![(px(at), px(top)), (px(at), px(bottom))], GRID, 3)?;
        stroke(root, vec![(px(at), px(bottom)), (px(at), px(bottom + 4.0))], MUTED, 4)?;
        if x_labels {
            word(root, &text, (at, bottom + 7.0), style(TEXT, MUTED, HPos::Center, VPos::Top))?;
        }
    }
    let y_ticks = ticks(&axes.y, ((bottom - top) / 28.0).max(2.0) as usize);
    for (y, text) in y_ticks.at {
        let at = axes.at_y(y);
        let (colour, width) = if y == 0.0 { (MUTED, 3) } else { (GRID, 3) };
        stroke(root, vec![(px(left), px(at)), (px(right), px(at))], colour, width)?;
        stroke(root, vec![(px(left - 4.0), px(at)), (px(left), px(at))], MUTED, 4)?;
        word(root, &text, (left - 7.0, at), style(TEXT, MUTED, HPos::Right, VPos::Center))?;
    }
    let frame = [(left, top), (left, bottom), (right, bottom)];
    stroke(root, frame.iter().map(|&(x, y)| (px(x), px(y))).collect(), MUTED, 4)?;

    let y_label = style(TEXT, INK, HPos::Center, VPos::Top).transform(FontTransform::Rotate270);
    let label = axis_label(&panel.quantity, &panel.unit, y_ticks.exponent);
    word(root, &label, (left - LEFT + 4.0, f64::midpoint(top, bottom)), y_label)?;
    if x_labels {
        let label = axis_label(&figure.quantity, &figure.unit, x_ticks.exponent);
        word(
            root,
            &label,
            (f64::midpoint(left, right), bottom + 25.0),
            style(TEXT, INK, HPos::Center, VPos::Top),
        )?;
    }
    Ok(())
}

fn draw_lines(root: &Root<'_>, panel: &Panel, axes: &Axes, buckets: usize) -> Drawn {
    let shown = |v: f64| v > axes.y.start && v < axes.y.end;
    for rule in &panel.rules {
        for value in if rule.band { vec![rule.value, -rule.value] } else { vec![rule.value] } {
            if shown(value) {
                stroke(
                    root,
                    vec![axes.at((axes.x.start, value)), axes.at((axes.x.end, value))],
                    LIMIT,
                    RULE_WIDTH,
                )?;
            }
        }
    }
    for line in &panel.lines {
        for piece in line.decimated(buckets).split(Option::is_none) {
            let mut points: Vec<(i32, i32)> = piece.iter().flatten().map(|&p| axes.at(p)).collect();
            points.dedup();
            if points.len() > 1 {
                stroke(root, points, PALETTE[line.colour % PALETTE.len()], line_width(line))?;
            }
        }
    }
    Ok(())
}

fn draw_windows(root: &Root<'_>, panel: &Panel, axes: &Axes) -> Drawn {
    for window in &panel.windows {
        let from = window.from.max(axes.x.start);
        let at = (axes.at_x(from) + 5.0, axes.bottom - 9.0);
        word(root, &window.label, at, style(PLAIN, MUTED, HPos::Left, VPos::Center))?;
    }
    Ok(())
}

/// At the right margin from the top, each at its line or just below its neighbour; inside where there is no margin.
fn draw_rule_labels(root: &Root<'_>, panel: &Panel, axes: &Axes, layout: Layout) -> Drawn {
    let mut rules: Vec<_> = panel.rules.iter().collect();
    rules.sort_by(|a, b| b.value.total_cmp(&a.value));
    let mut free = axes.top;
    for rule in rules {
        let (above, below) = (rule.value >= axes.y.end, rule.value <= axes.y.start);
        let arrow = if above {
            " ↑"
        } else if below {
            " ↓"
        } else {
            ""
        };
        let wanted = axes.at_y(rule.value.clamp(axes.y.start, axes.y.end));
        let y = wanted.max(free + 6.0);
        let (x, y, h) = match layout {
            Layout::Stacked => (axes.right + 6.0, y, HPos::Left),
            Layout::Paths => (axes.right - 4.0, y + 8.0, HPos::Right),
        };
        word(root, &format!("{}{arrow}", rule.label), (x, y), style(SMALL, LIMIT, h, VPos::Center))?;
        free = y + 8.0;
    }
    Ok(())
}

fn draw_marks(root: &Root<'_>, panel: &Panel, axes: &Axes) -> Drawn {
    for mark in &panel.marks {
        let (x, y) = (axes.at_x(mark.x), axes.at_y(mark.y));
        if !x.is_finite() || !y.is_finite() {
            continue;
        }
        root.draw(&Circle::new((px(x), px(y)), px(3.4) as u32, INK.stroke_width(SOLID_WIDTH)))?;
        // Away from the nearer edge, above what is high and below what is low, as long as there is room.
        let (h, dx) = if x > axes.right - 150.0 { (HPos::Right, -8.0) } else { (HPos::Left, 8.0) };
        let up = (mark.y >= 0.0 && y - axes.top > 16.0) || axes.bottom - y < 16.0;
        word(
            root,
            &mark.label,
            (x + dx, y + if up { -8.0 } else { 8.0 }),
            style(SMALL, INK, h, VPos::Center),
        )?;
    }
    if panel.lines.iter().all(|line| line.x.is_empty() || line.y.is_empty()) {
        let middle = (f64::midpoint(axes.left, axes.right), f64::midpoint(axes.top, axes.bottom));
        word(root, "no data", middle, style(TEXT, MUTED, HPos::Center, VPos::Center))?;
    }
    Ok(())
}
