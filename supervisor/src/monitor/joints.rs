use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};

use super::JointView;

/// This close to a limit, as a fraction of the range, counts as near.
const NEAR: f64 = 0.05;
const SPARKS: [&str; 8] = ["▁", "▂", "▃", "▄", "▅", "▆", "▇", "█"];

pub(super) const DIM: Style = Style::new().add_modifier(Modifier::DIM);
pub(super) const BOLD: Style = Style::new().add_modifier(Modifier::BOLD);

#[derive(Clone, Copy, PartialEq, Eq)]
enum Column {
    Mark,
    Name,
    Lower,
    Track,
    Upper,
    Position,
    Degrees,
    Reference,
    Velocity,
    Bar,
    Torque,
    Limit,
    History,
}

/// State of a joint's position relative to its limits.
#[derive(Clone, Copy, PartialEq, Eq)]
enum LimitState {
    NotHomed,
    NoReading,
    NoLimits,
    Inside,
    Near,
    Outside,
}

impl LimitState {
    fn of(joint: &JointView) -> Self {
        if !joint.homed {
            return Self::NotHomed;
        }
        if !joint.position.is_finite() {
            return Self::NoReading;
        }
        let Some(fraction) = fraction(joint.position, joint) else { return Self::NoLimits };
        if !(0.0..=1.0).contains(&fraction) {
            Self::Outside
        } else if !(NEAR..=1.0 - NEAR).contains(&fraction) {
            Self::Near
        } else {
            Self::Inside
        }
    }

    const fn mark(self) -> &'static str {
        match self {
            Self::NotHomed => "○",
            Self::NoReading => "?",
            Self::Near => "~",
            Self::Outside => "!",
            Self::NoLimits | Self::Inside => " ",
        }
    }

    const fn style(self) -> Style {
        match self {
            Self::NotHomed => DIM,
            Self::NoLimits | Self::Inside => Style::new(),
            Self::Near => Style::new().fg(Color::Yellow),
            Self::NoReading | Self::Outside => Style::new().fg(Color::Red).add_modifier(Modifier::BOLD),
        }
    }
}

/// Draws the heading and the joints from `first` on, one per line.
pub(super) fn draw(
    joints: &[JointView],
    first: usize,
    selected: Option<usize>,
    area: Rect,
    buffer: &mut Buffer,
) {
    let columns = columns(joints, area.width);
    let widths = columns.iter().map(|&(_, width)| width);
    let row = Rect { height: 1.min(area.height), ..area };
    let cells = Layout::horizontal(widths).spacing(1).split(row);
    for (&(column, _), &cell) in columns.iter().zip(cells.iter()) {
        let (text, right) = heading(column);
        write(text, right, cell, DIM, buffer);
    }
    for ((index, joint), y) in joints.iter().enumerate().skip(first).zip(area.y + 1..area.bottom()) {
        for (&(column, _), &cell) in columns.iter().zip(cells.iter()) {
            draw_cell(column, joint, selected == Some(index), Rect { y, ..cell }, buffer);
        }
    }
}

/// Returns the columns that fit into `width`.
fn columns(joints: &[JointView], width: u16) -> Vec<(Column, Constraint)> {
    let longest = joints.iter().map(|joint| joint.name.chars().count()).max().unwrap_or(0);
    let max = if width < 76 { 12 } else { 16 + width.saturating_sub(94) / 4 };
    let name = u16::try_from(longest).unwrap_or(max).clamp(5, max.min(32));
    let number = Constraint::Length(6);
    let all = [
        (0, Column::Mark, Constraint::Length(2)),
        (0, Column::Name, Constraint::Length(name)),
        (112, Column::Lower, number),
        (0, Column::Track, Constraint::Fill(5)),
        (112, Column::Upper, number),
        (0, Column::Position, number),
        (94, Column::Degrees, number),
        (76, Column::Reference, number),
        (0, Column::Velocity, number),
        (0, Column::Bar, Constraint::Fill(3)),
        (0, Column::Torque, number),
        (94, Column::Limit, number),
        (130, Column::History, Constraint::Fill(4)),
    ];
    all.into_iter().filter(|&(from, ..)| width >= from).map(|(_, column, size)| (column, size)).collect()
}

/// Returns a column's title, and whether it is right-aligned.
const fn heading(column: Column) -> (&'static str, bool) {
    match column {
        Column::Mark => ("", false),
        Column::Name => ("joint", false),
        Column::Lower => ("lower", true),
        Column::Track => ("position", false),
        Column::Upper => ("upper", false),
        Column::Position => ("rad", true),
        Column::Degrees => ("deg", true),
        Column::Reference => ("ref", true),
        Column::Velocity => ("rad/s", true),
        Column::Bar => ("torque", false),
        Column::Torque => ("N·m", true),
        Column::Limit => ("max", true),
        Column::History => ("history", false),
    }
}

fn draw_cell(column: Column, joint: &JointView, selected: bool, area: Rect, buffer: &mut Buffer) {
    let limit_state = LimitState::of(joint);
    let grey = if joint.homed { Style::new() } else { DIM };
    let right = |text: String, style: Style, buffer: &mut Buffer| write(&text, true, area, style, buffer);
    match column {
        Column::Mark => {
            write(if selected { "▸" } else { " " }, false, area, BOLD, buffer);
            write(limit_state.mark(), true, area, limit_state.style(), buffer);
        }
        Column::Name => {
            let style = limit_state.style();
            write(
                &shorten(&joint.name, area.width),
                false,
                area,
                if selected { style.patch(BOLD) } else { style },
                buffer,
            );
        }
        Column::Lower => right(number(joint.lower, 2), DIM, buffer),
        Column::Track => draw_track(joint, limit_state, area, buffer),
        Column::Upper => write(number(joint.upper, 2).trim_start(), false, area, DIM, buffer),
        Column::Position => right(number(joint.position, 3), limit_state.style(), buffer),
        Column::Degrees => right(number(joint.position.to_degrees(), 1), limit_state.style(), buffer),
        Column::Reference => right(number(joint.reference, 3), grey, buffer),
        Column::Velocity => right(number(joint.velocity, 3), grey, buffer),
        Column::Bar => draw_bar(joint, area, buffer),
        Column::Torque => right(number(joint.torque, 3), torque_style(joint), buffer),
        Column::Limit => right(number(joint.torque_limit, 3), DIM, buffer),
        Column::History => draw_history(joint, area, buffer),
    }
}

/// Draws the range of the joint as a line, and the position as a block on it in steps of half a cell.
fn draw_track(joint: &JointView, limit_state: LimitState, area: Rect, buffer: &mut Buffer) {
    let word = match limit_state {
        LimitState::NotHomed => "not homed",
        LimitState::NoReading => "no reading",
        LimitState::NoLimits => "no limits",
        LimitState::Inside | LimitState::Near | LimitState::Outside => "",
    };
    if !word.is_empty() || area.width < 5 {
        let text = format!("{:╌^1$}", format!(" {word} "), usize::from(area.width));
        return write(
            &text,
            false,
            area,
            if limit_state == LimitState::NoReading { limit_state.style() } else { DIM },
            buffer,
        );
    }
    for x in area.x..area.right() {
        let sign = if x == area.x {
            "├"
        } else if x + 1 == area.right() {
            "┤"
        } else {
            "─"
        };
        buffer[(x, area.y)].set_symbol(sign).set_style(DIM);
    }
    let (Some(position), reference) = (fraction(joint.position, joint), fraction(joint.reference, joint))
    else {
        return;
    };
    let style =
        if limit_state == LimitState::Inside { Style::new().fg(Color::Green) } else { limit_state.style() };
    let mut put = |x: u16, sign: &str| {
        let cell = &mut buffer[(area.x + x, area.y)];
        cell.reset();
        cell.set_symbol(sign).set_style(style);
    };
    let last = area.width - 1;
    if limit_state == LimitState::Outside {
        put(if position < 0.0 { 0 } else { last }, if position < 0.0 { "◀" } else { "▶" });
    } else {
        let half = step(position, 2 * last + 1);
        if half.is_multiple_of(2) {
            put(half / 2, "█");
        } else {
            put(half / 2, "▐");
            put(half / 2 + 1, "▌");
        }
    }
    if let Some(reference) = reference {
        let cell = &mut buffer[(area.x + step(reference, 2 * last + 1).div_ceil(2).min(last), area.y)];
        let over = ["█", "▐", "▌"].contains(&cell.symbol());
        if !["◀", "▶"].contains(&cell.symbol()) {
            let style = if over { style.add_modifier(Modifier::REVERSED) } else { BOLD };
            cell.reset();
            cell.set_symbol("◆").set_style(style);
        }
    }
}

/// Draws the torque as a bar from the middle; its ends are the limits.
fn draw_bar(joint: &JointView, area: Rect, buffer: &mut Buffer) {
    let side = area.width.saturating_sub(1) / 2;
    let middle = area.x + side;
    for x in area.x..=middle + side {
        buffer[(x, area.y)].set_symbol(if x == middle { "│" } else { "·" }).set_style(DIM);
    }
    let (torque, limit) = (f64::from(joint.torque), f64::from(joint.torque_limit));
    if side == 0 || !torque.is_finite() || !(limit.is_finite() && limit > 0.0) {
        return;
    }
    let filled = step((torque / limit).abs(), 2 * side + 1);
    let style = torque_style(joint);
    let style = if style.fg.is_none() { Style::new().fg(Color::Cyan) } else { style };
    let (half, beyond) = if torque < 0.0 { ("╺", "◀") } else { ("╸", "▶") };
    for cell in 1..=filled.div_ceil(2) {
        let x = if torque < 0.0 { middle - cell } else { middle + cell };
        let sign = if cell == side && torque.abs() > limit {
            beyond
        } else if 2 * cell > filled {
            half
        } else {
            "━"
        };
        let cell = &mut buffer[(x, area.y)];
        cell.reset();
        cell.set_symbol(sign).set_style(style);
    }
}

/// Draws the positions within the joint's limits, newest to the right, one per cell.
fn draw_history(joint: &JointView, area: Rect, buffer: &mut Buffer) {
    let style = if joint.homed { Style::new().fg(Color::Green) } else { DIM };
    let (count, width) = (joint.history.len(), usize::from(area.width));
    for (back, x) in (area.x..area.right()).rev().enumerate() {
        let age = if count > width { back * count / width } else { back };
        let position = joint.history.iter().rev().nth(age);
        let fraction = position.and_then(|&position| fraction(position, joint));
        let sign = fraction.map_or(" ", |fraction| SPARKS[usize::from(step(fraction, 8))]);
        buffer[(x, area.y)].set_symbol(sign).set_style(style);
    }
}

fn torque_style(joint: &JointView) -> Style {
    let (torque, limit) = (joint.torque.abs(), joint.torque_limit);
    if torque.is_nan() || torque > limit {
        Style::new().fg(Color::Red).add_modifier(Modifier::BOLD)
    } else if torque > 0.9 * limit {
        Style::new().fg(Color::Yellow)
    } else if joint.homed {
        Style::new()
    } else {
        DIM
    }
}

/// Returns the relative position of an angle in the joint's range: 0 at the lower limit, 1 at the upper one.
fn fraction(angle: f32, joint: &JointView) -> Option<f64> {
    let (lower, upper) = (f64::from(joint.lower), f64::from(joint.upper));
    let fraction = (f64::from(angle) - lower) / (upper - lower);
    (upper > lower && fraction.is_finite()).then_some(fraction)
}

/// Returns the index of the step that contains a fraction, of `steps` equal steps.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded before")]
fn step(fraction: f64, steps: u16) -> u16 {
    ((fraction.clamp(0.0, 1.0) * f64::from(steps)) as u16).min(steps.saturating_sub(1))
}

/// Formats with at most six characters, with fewer decimals for larger numbers.
pub(super) fn number(value: f32, decimals: usize) -> String {
    if !value.is_finite() {
        return value.to_string().to_lowercase();
    }
    let texts = (0..=decimals).rev().map(|decimals| format!("{value:.decimals$}"));
    let text = texts.into_iter().find(|text| text.len() <= 6).unwrap_or_else(|| format!("{value:.0e}"));
    if text.starts_with('-') && !text.contains(|sign: char| ('1'..='9').contains(&sign)) {
        text[1..].to_owned()
    } else {
        text
    }
}

/// Fits `text` into `width` cells, with an ellipsis if it is truncated.
pub(super) fn shorten(text: &str, width: u16) -> String {
    let width = usize::from(width);
    if text.chars().count() <= width {
        return text.to_owned();
    }
    text.chars().take(width.saturating_sub(1)).chain(['…']).collect()
}

fn write(text: &str, right: bool, area: Rect, style: Style, buffer: &mut Buffer) {
    let width = u16::try_from(text.chars().count()).unwrap_or(area.width).min(area.width);
    let x = if right { area.right() - width } else { area.x };
    buffer.set_stringn(x, area.y, text, usize::from(area.width), style);
}
