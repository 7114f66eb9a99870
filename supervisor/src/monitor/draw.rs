use ratatui::Frame;
use ratatui::layout::{Alignment, Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, BorderType, Chart, Clear, Dataset, GraphType, Padding, Paragraph, Wrap};

use super::joints::{self, BOLD, DIM, number, shorten};
use super::{JointView, LinkView, State, View};

const MIN_SIZE: (u16, u16) = (60, 12);
/// Minimum height of the panels below the joints with their borders; with less room they are hidden.
const PANELS: u16 = 5;
const KEYS: [(&str, &str); 6] =
    [("space", "stop"), ("d", "disable"), ("f", "faults"), ("↑↓", "joint"), ("?", "help"), ("q", "quit")];

/// Draws the view with the joint at `selected`, if any, in detail.
pub fn draw(frame: &mut Frame, view: &View, selected: Option<usize>) {
    let area = frame.area();
    if area.width < MIN_SIZE.0 || area.height < MIN_SIZE.1 {
        return draw_too_small(frame, area);
    }
    let selected = selected.filter(|&index| index < view.joints.len());
    let rows = u16::try_from(view.joints.len()).unwrap_or(u16::MAX).saturating_add(3);
    let spare = area.height - 5;
    let panels = if spare.saturating_sub(rows) >= PANELS { spare - rows } else { 0 };
    let [top, mode, table, below, link, hint, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(1),
        Constraint::Fill(1),
        Constraint::Length(panels),
        Constraint::Length(1),
        Constraint::Length(1),
        Constraint::Length(1),
    ])
    .areas(area);

    let (badge, style) = badge(view.state);
    let title = Line::from(vec![Span::styled(badge, style), Span::raw(" "), Span::styled(&view.title, BOLD)]);
    split(frame, top, title, clock(view.time).into());
    let supply = view.supply.map_or_else(String::new, |supply| format!("supply {supply:.1} V "));
    split(frame, mode, Line::raw(format!(" {}", view.mode)), supply.into());
    draw_joints(frame, view, selected, table);
    if panels > 0 {
        let [left, right] = Layout::horizontal([Constraint::Fill(3), Constraint::Fill(2)]).areas(below);
        draw_detail(frame, selected.map(|index| &view.joints[index]), left);
        draw_fault_panel(frame, &view.faults, right);
    }
    draw_link(frame, &view.link, link);
    let fault = if panels > 0 { None } else { view.faults.last() };
    draw_hint(frame, &view.hint, fault, hint);
    draw_keys(frame, keys);
}

/// Draws the help over the view.
pub fn draw_help(frame: &mut Frame) {
    let lines = [
        ("space", "stop the motion"),
        ("d", "disable: switch the actuators off"),
        ("f", "read and show the faults"),
        ("↑ ↓  k j", "select a joint"),
        ("?  h", "show or hide this help"),
        ("q  Esc  Ctrl-C", "quit"),
        ("", ""),
        ("█  ◆", "measured position, reference"),
        ("~  !", "near a limit (5 %), beyond a limit"),
        ("◀  ▶", "off the end of the scale"),
        ("○  ?", "not homed, no reading"),
    ];
    let lines: Vec<Line> = lines
        .iter()
        .map(|(key, text)| Line::from(vec![Span::styled(format!("{key:>14}  "), BOLD), Span::raw(*text)]))
        .collect();
    over(frame, " help ", 56, lines);
}

/// Draws all faults over the view, the newest first.
pub fn draw_faults(frame: &mut Frame, view: &View) {
    let lines = if view.faults.is_empty() {
        vec![Line::styled("no faults", DIM)]
    } else {
        view.faults.iter().rev().map(|fault| Line::raw(format!("! {fault}"))).collect()
    };
    over(frame, &format!(" faults: {}, newest first ", view.faults.len()), 100, lines);
}

fn over(frame: &mut Frame, title: &str, width: u16, lines: Vec<Line>) {
    let screen = frame.area();
    if screen.width < MIN_SIZE.0 || screen.height < MIN_SIZE.1 {
        return;
    }
    let width = width.min(screen.width - 2);
    let inside = usize::from(width - 4);
    // Lines are broken between words, which wastes some space.
    let height = |line: &Line| if line.width() <= inside { 1 } else { line.width().div_ceil(inside - 8) };
    let rows: usize = lines.iter().map(height).sum();
    let height = u16::try_from(rows + 2).unwrap_or(u16::MAX).min(screen.height - 2);
    let area = screen.centered(Constraint::Length(width), Constraint::Length(height));
    let block = panel(title).border_style(Style::new());
    frame.render_widget(Clear, area);
    frame.render_widget(Paragraph::new(lines).wrap(Wrap { trim: false }).block(block), area);
}

fn draw_too_small(frame: &mut Frame, area: Rect) {
    let size = format!("{}x{}, needs {}x{}", area.width, area.height, MIN_SIZE.0, MIN_SIZE.1);
    let text = Paragraph::new(vec![Line::styled("terminal too small", BOLD), Line::raw(size)]);
    let middle = area.centered_vertically(Constraint::Length(area.height.min(2)));
    frame.render_widget(text.alignment(Alignment::Center), middle);
}

const fn badge(state: State) -> (&'static str, Style) {
    let (text, colour) = match state {
        State::Disabled => (" ○ DISABLED ", Color::Reset),
        State::Enabled => (" ● ENABLED ", Color::Green),
        State::Fault => (" ! FAULT ", Color::Red),
        State::Lost => (" ? LOST ", Color::Magenta),
    };
    (text, Style::new().fg(colour).add_modifier(Modifier::BOLD).add_modifier(Modifier::REVERSED))
}

fn draw_joints(frame: &mut Frame, view: &View, selected: Option<usize>, area: Rect) {
    let (count, shown) = (view.joints.len(), usize::from(area.height.saturating_sub(3)));
    let first = selected.map_or(0, |index| index.saturating_sub(shown / 2)).min(count.saturating_sub(shown));
    let mut title = format!(" joints: {count} ");
    if shown < count {
        title = format!(" joints: {}–{} of {count}, ↑↓ for more ", first + 1, first + shown);
    }
    let lost = view.state == State::Lost;
    if lost {
        title = format!("{title}(outdated: no data for {:.1} s) ", view.link.last_seconds);
    }
    let legend = Line::from(" █ measured  ◆ reference  ~ near limit  ! beyond ").right_aligned();
    let block = panel(&title).padding(Padding::ZERO).title_bottom(legend);
    let inside = block.inner(area);
    frame.render_widget(block, area);
    joints::draw(&view.joints, first, selected, inside, frame.buffer_mut());
    if lost {
        frame.buffer_mut().set_style(inside, DIM);
    }
}

/// Draws the selected joint with its values and a curve.
fn draw_detail(frame: &mut Frame, joint: Option<&JointView>, area: Rect) {
    let Some(joint) = joint else {
        let text = Paragraph::new(Line::styled("select a joint with ↑↓ to see its curve", DIM));
        return frame.render_widget(text.block(panel(" joint ")), area);
    };
    let block = panel(&format!(" {} ", joint.name));
    let inside = block.inner(area);
    frame.render_widget(block, area);
    let [text, curve] = Layout::vertical([Constraint::Length(1), Constraint::Fill(1)]).areas(inside);
    let error = joint.reference - joint.position;
    let parts = [
        format!("{} rad", number(joint.position, 3)),
        format!("{}°", number(joint.position.to_degrees(), 1)),
        format!("error {} rad", number(error, 3)),
        format!("limits {} … {}", number(joint.lower, 2), number(joint.upper, 2)),
    ];
    frame.render_widget(fitting(parts.into_iter().map(Span::raw), text.width), text);

    let points: Vec<(f64, f64)> = (0_u32..)
        .zip(&joint.history)
        .filter(|(_, position)| position.is_finite())
        .map(|(index, &position)| (f64::from(index), f64::from(position)))
        .collect();
    let lowest = points.iter().map(|point| point.1).fold(f64::INFINITY, f64::min);
    let highest = points.iter().map(|point| point.1).fold(f64::NEG_INFINITY, f64::max);
    let (Some(start), Some(end)) = (points.first(), points.last()) else { return };
    let margin = (0.05 * (highest - lowest)).max(0.01);
    let (lowest, highest) = (lowest - margin, highest + margin);
    let curves = vec![
        Dataset::default()
            .marker(Marker::Braille)
            .graph_type(GraphType::Line)
            .style(Style::new().fg(Color::Green))
            .data(&points),
    ];
    let label = |value: f64| format!("{value:6.2}");
    let chart = Chart::new(curves)
        .x_axis(Axis::default().bounds([start.0, end.0.max(start.0 + 1.0)]))
        .y_axis(Axis::default().bounds([lowest, highest]).labels([label(lowest), label(highest)]).style(DIM));
    frame.render_widget(chart, curve);
}

/// Draws the newest faults first, as many as there is room for.
fn draw_fault_panel(frame: &mut Frame, faults: &[String], area: Rect) {
    let sign = || Span::styled("! ", Style::new().fg(Color::Red));
    let newest = faults.iter().rev().take(usize::from(area.height));
    let mut lines: Vec<Line> = newest.map(|fault| Line::from(vec![sign(), Span::raw(fault)])).collect();
    if lines.is_empty() {
        lines.push(Line::styled("none", DIM));
    }
    let title = if faults.len() > 1 {
        format!(" faults: {}, newest first ", faults.len())
    } else {
        " faults ".into()
    };
    frame.render_widget(Paragraph::new(lines).wrap(Wrap { trim: false }).block(panel(&title)), area);
}

fn draw_link(frame: &mut Frame, link: &LinkView, area: Rect) {
    let bad = |bad: bool, text: String| {
        if bad { Span::styled(format!("{text} !"), Style::new().fg(Color::Yellow)) } else { Span::raw(text) }
    };
    let mut parts = vec![
        if link.open {
            Span::raw(" link open")
        } else {
            Span::styled(" link closed !", Style::new().fg(Color::Red).add_modifier(Modifier::BOLD))
        },
        match (link.rate, link.expected_rate) {
            (None, expected) => Span::raw(format!("{expected:.0} frames/s expected")),
            // Another program may have requested more.
            (Some(rate), expected) if rate > 1.1 * expected => Span::raw(format!("{rate:.0} frames/s")),
            (Some(rate), expected) => {
                bad(rate < 0.9 * expected, format!("{rate:.0} of {expected:.0} frames/s"))
            }
        },
        bad(link.lost > 0, format!("lost {}", link.lost)),
        bad(link.damaged > 0, format!("damaged {}", link.damaged)),
    ];
    let late = link.last_seconds.is_nan() || link.last_seconds > 0.5;
    let last = bad(late, format!("last {:.1} s ago", link.last_seconds));
    if late {
        parts.insert(1, last);
    } else {
        parts.push(last);
    }
    parts.extend(link.round_trip_ms.map(|time| Span::raw(format!("round trip {time:.1} ms"))));
    frame.render_widget(fitting(parts, area.width), area);
}

fn draw_hint(frame: &mut Frame, hint: &str, fault: Option<&String>, area: Rect) {
    let mut spans = vec![Span::raw(" ")];
    if !hint.is_empty() {
        spans.push(Span::styled(format!("▸ {hint}  "), BOLD));
    }
    if let Some(fault) = fault {
        let room = usize::from(area.width).saturating_sub(spans.iter().map(Span::width).sum());
        let text = shorten(&format!("! {fault}"), u16::try_from(room).unwrap_or(u16::MAX));
        spans.push(Span::styled(text, Style::new().fg(Color::Red)));
    }
    frame.render_widget(Line::from(spans), area);
}

fn draw_keys(frame: &mut Frame, area: Rect) {
    let mut spans = vec![Span::raw(" ")];
    for (key, text) in KEYS {
        // The arrow keys are left out first, because they are obvious.
        if key == "↑↓" && area.width < 72 {
            continue;
        }
        spans.push(Span::styled(format!(" {key} "), Style::new().add_modifier(Modifier::REVERSED)));
        spans.push(Span::raw(format!(" {text} ")));
    }
    frame.render_widget(Line::from(spans), area);
}

fn panel(title: &str) -> Block<'static> {
    Block::bordered()
        .border_type(BorderType::Rounded)
        .border_style(DIM)
        .padding(Padding::horizontal(1))
        .title(Span::styled(title.to_owned(), BOLD.remove_modifier(Modifier::DIM)))
}

/// Returns the first parts that fit into a line of `width`.
fn fitting<'a>(parts: impl IntoIterator<Item = Span<'a>>, width: u16) -> Line<'a> {
    let mut line = Line::default();
    for part in parts {
        let gap = if line.spans.is_empty() { "" } else { "   " };
        if line.width() + gap.len() + part.width() > usize::from(width) {
            break;
        }
        line.push_span(Span::raw(gap));
        line.push_span(part);
    }
    line
}

/// Draws a line with a left and a right part; the right one is never truncated.
fn split(frame: &mut Frame, area: Rect, left: Line, right: Line) {
    let width = u16::try_from(right.width()).unwrap_or(u16::MAX);
    let [start, end] =
        Layout::horizontal([Constraint::Fill(1), Constraint::Length(width)]).spacing(1).areas(area);
    frame.render_widget(left, start);
    frame.render_widget(right, end);
}

/// Formats the time since the board started: hours, minutes, seconds.
fn clock(time: f64) -> String {
    if !time.is_finite() || time < 0.0 {
        return "up ? ".to_owned();
    }
    let tenths = (time * 10.0).floor();
    let (hours, minutes) = ((tenths / 36_000.0).floor(), (tenths / 600.0).floor() % 60.0);
    format!("up {hours:.0}:{minutes:02.0}:{:04.1} ", tenths % 600.0 / 10.0)
}
