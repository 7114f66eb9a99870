//! The table at the end of a run.

use super::group::{Group, Row, groups, seeds, ticks, verdict_line};
use super::{Summary, number};

/// No line of a table is longer than this.
const WIDTH: usize = 100;

const GREEN: &str = "\x1b[32m";
const RED: &str = "\x1b[1;31m";
const BOLD: &str = "\x1b[1m";
const DIM: &str = "\x1b[2m";
const RESET: &str = "\x1b[0m";

/// Measured beside wanted, at most 100 columns wide; one block for each pair of scenario and controller.
///
/// For one seed the columns are measured, wanted and verdict; for several median, worst (and its seed), wanted and
/// verdict. What the papers got stands beside it where a metric tells it. With `colour` the terminal's green and red
/// are used; without, the text is plain.
pub fn table(summaries: &[Summary], colour: bool) -> String {
    groups(summaries).iter().map(|group| block(group, colour)).collect::<Vec<_>>().join("\n")
}

struct Cell {
    text: String,
    style: &'static str,
}

fn block(group: &Group<'_>, colour: bool) -> String {
    let rows = group.rows();
    let several = group.runs.len() > 1;
    let paper = rows.iter().any(|row| row.metric.paper.is_some());
    let mut notes: Vec<&str> = Vec::new();

    let mut header = vec!["quantity"];
    header.extend(if several { &["median", "worst (seed)", "wanted"][..] } else { &["measured", "wanted"] });
    header.extend(paper.then_some("paper"));
    header.push("verdict");
    let mut lines: Vec<Vec<Cell>> =
        vec![header.into_iter().map(|text| Cell { text: text.to_owned(), style: BOLD }).collect()];
    lines.extend(rows.iter().map(|row| cells(row, several, paper, &mut notes)));

    let mut widths = vec![0; lines[0].len()];
    for line in &lines {
        for (width, cell) in widths.iter_mut().zip(line) {
            *width = (*width).max(cell.text.chars().count());
        }
    }
    // The label gives way, on two lines if need be, but never below what is readable.
    let others: usize = widths[1..].iter().map(|w| w + 2).sum();
    widths[0] = widths[0].min(WIDTH.saturating_sub(others + 1)).max(12);

    let mut text = title(group, colour);
    for (i, line) in lines.iter().enumerate() {
        push_line(&mut text, line, &widths, colour);
        if i == 0 {
            let rule = widths.iter().map(|w| "─".repeat(*w)).collect::<Vec<_>>().join("  ");
            text.push_str(&format!(" {}\n", paint(&rule, DIM, colour)));
        }
    }
    let (word, style) = if group.pass() { ("PASS", GREEN) } else { ("FAIL", RED) };
    text.push_str(&format!("\n {}  {}\n", paint(word, style, colour), verdict_line(group)));
    for (i, note) in notes.iter().enumerate() {
        for (j, line) in wrap(note, WIDTH - 6).into_iter().enumerate() {
            let head = if j == 0 { format!("[{}]", i + 1) } else { "   ".to_owned() };
            text.push_str(&paint(&format!(" {head} {line}"), DIM, colour));
            text.push('\n');
        }
    }
    text
}

fn title(group: &Group<'_>, colour: bool) -> String {
    let first = group.runs[0];
    let seed = if group.runs.len() == 1 { "seed" } else { "seeds" };
    let mut facts = vec![first.controller.clone(), format!("{seed} {}", seeds(&group.runs))];
    facts.push(format!("{} ticks", ticks(&group.runs)));
    if let Some(hash) = &first.elf_sha256 {
        facts.push(format!("image {}", hash.chars().take(12).collect::<String>()));
    }
    let identical = group.runs.iter().filter_map(|run| run.identical).reduce(|a, b| a && b);
    if let Some(identical) = identical {
        facts.push(if identical { "identical to native" } else { "DIFFERS from native" }.to_owned());
    }
    let plain = facts.join(" · ");
    let lines = wrap(&plain, WIDTH.saturating_sub(first.scenario.chars().count() + 4).max(20));
    let indent = " ".repeat(first.scenario.chars().count());
    let mut text = String::new();
    for (i, line) in lines.iter().enumerate() {
        let head = if i == 0 { paint(&first.scenario, BOLD, colour) } else { indent.clone() };
        text.push_str(&format!(" {head}  {}\n", paint(line, DIM, colour)));
    }
    text + "\n"
}

fn cells<'a>(row: &Row<'a>, several: bool, paper: bool, notes: &mut Vec<&'a str>) -> Vec<Cell> {
    let metric = row.metric;
    let mut label = metric.label.clone();
    if let Some(note) = &metric.note {
        let index = notes.iter().position(|n| n == note).unwrap_or_else(|| {
            notes.push(note);
            notes.len() - 1
        });
        label.push_str(&format!(" [{}]", index + 1));
    }
    let style = match (row.pass(), metric.limit) {
        (false, _) => RED,
        (true, Some(_)) => GREEN,
        (true, None) => DIM,
    };
    let plain = |text: String| Cell { text, style: "" };
    let mut cells = vec![plain(label)];
    if several {
        cells.push(plain(row.median_text()));
        let worst = number::measured(row.worst.value, row.worst.limit);
        cells.push(plain(format!("{} ({})", number::with_unit(&worst, &metric.unit), row.worst_seed)));
    } else {
        cells.push(plain(row.worst.measured()));
    }
    cells.push(plain(metric.wanted()));
    if paper {
        cells.push(plain(metric.paper.clone().unwrap_or_else(|| "–".to_owned())));
    }
    cells.push(Cell { text: row.verdict(), style });
    cells
}

/// Label and verdict to the left, values to the right of their columns; a long label takes several lines.
fn push_line(text: &mut String, line: &[Cell], widths: &[usize], colour: bool) {
    let label = wrap(&line[0].text, widths[0]);
    for (i, part) in label.iter().enumerate() {
        let mut out = format!(" {}", pad(part, widths[0], line[0].style, colour, false));
        if i == 0 {
            for (j, (cell, width)) in line.iter().zip(widths).enumerate().skip(1) {
                out.push_str("  ");
                out.push_str(&pad(&cell.text, *width, cell.style, colour, j + 1 < line.len()));
            }
        }
        text.push_str(out.trim_end());
        text.push('\n');
    }
}

fn pad(text: &str, width: usize, style: &str, colour: bool, right: bool) -> String {
    let fill = " ".repeat(width.saturating_sub(text.chars().count()));
    let text = paint(text, style, colour);
    if right { fill + &text } else { text + &fill }
}

fn paint(text: &str, style: &str, colour: bool) -> String {
    if colour && !style.is_empty() { format!("{style}{text}{RESET}") } else { text.to_owned() }
}

/// Breaks between words; a word that is longer than a line is cut.
fn wrap(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    let mut room = width;
    for word in text.split_whitespace() {
        let mut word: Vec<char> = word.chars().collect();
        if word.len() + 1 > room && room < width {
            lines.push(String::new());
            room = width;
        }
        while !word.is_empty() {
            let rest = word.split_off(word.len().min(width));
            let Some(line) = lines.last_mut() else { break };
            if !line.is_empty() {
                line.push(' ');
                room = room.saturating_sub(1);
            }
            line.extend(&word);
            room = room.saturating_sub(word.len());
            if !rest.is_empty() {
                lines.push(String::new());
                room = width;
            }
            word = rest;
        }
    }
    lines
}
