//! The table at the end of a run.

use comfy_table::{
    Attribute, Cell, CellAlignment, Color, ColumnConstraint, ContentArrangement, Table, presets,
};

use super::group::{Group, Row, groups, seeds, ticks, verdict_line, verdict_word};
use super::number;
use super::summary::Summary;

/// Maximum width of a table.
const WIDTH: u16 = 100;

/// Formats measured values beside their limits, at most 100 columns wide, with one block for each pair of
/// scenario and controller.
///
/// For one seed the columns are measured, limit and verdict; for several they are median, worst (and its
/// seed), limit and verdict. The papers' values stand beside them if a metric has one. With `colour`, the
/// terminal's green and red are used; without, the text is plain.
pub fn table(summaries: &[Summary], colour: bool) -> String {
    groups(summaries).iter().map(|group| block(group, colour)).collect::<Vec<_>>().join("\n")
}

fn block(group: &Group<'_>, colour: bool) -> String {
    let rows = group.rows();
    let notes = notes(&rows);
    let mut verdict = plain_table(colour);
    let word = verdict_word(group);
    let cell = Cell::new(word).add_attribute(Attribute::Bold);
    let word = match word {
        "PASS" => cell.fg(Color::DarkGreen),
        "FAIL" => cell.fg(Color::DarkRed),
        _ => cell,
    };
    verdict.add_row([word, Cell::new(verdict_line(group))]);
    let mut parts = vec![title(group, colour), String::new(), metrics(group, &rows, &notes, colour)];
    parts.extend([String::new(), text(&verdict)]);
    if !notes.is_empty() {
        let mut list = plain_table(colour);
        for (number, note) in (1..).zip(&notes) {
            list.add_row([dim(format!("[{number}]")), dim(*note)]);
        }
        parts.push(text(&list));
    }
    parts.join("\n") + "\n"
}

/// Creates a table without lines; the first column keeps its width, and long text is broken between words.
fn plain_table(colour: bool) -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_content_arrangement(ContentArrangement::Dynamic).set_width(WIDTH);
    if colour {
        table.enforce_styling()
    } else {
        table.force_no_tty()
    };
    table
}

fn text(table: &Table) -> String {
    table.trim_fmt()
}

fn bold(text: impl ToString) -> Cell {
    Cell::new(text).add_attribute(Attribute::Bold)
}

fn dim(text: impl ToString) -> Cell {
    Cell::new(text).add_attribute(Attribute::Dim)
}

fn title(group: &Group<'_>, colour: bool) -> String {
    let first = group.runs[0];
    let seed = if group.runs.len() == 1 { "seed" } else { "seeds" };
    let mut facts = vec![first.controller.clone(), format!("{seed} {}", seeds(&group.runs))];
    facts.push(format!("{} ticks", ticks(&group.runs)));
    if let Some(hash) = &first.elf_sha256 {
        facts.push(format!("image {}", hash.chars().take(12).collect::<String>()));
    }
    if let Some(identical) = group.identical() {
        facts.push(if identical { "identical to native" } else { "DIFFERS from native" }.to_owned());
    }
    let mut table = plain_table(colour);
    table.add_row([bold(&first.scenario), dim(facts.join(" · "))]);
    text(&table)
}

/// Returns all notes without duplicates, in the order in which they are first needed.
fn notes<'a>(rows: &'a [Row<'_>]) -> Vec<&'a str> {
    let mut notes = Vec::new();
    for note in rows.iter().flat_map(|row| &row.notes) {
        let note = note.as_str();
        if !notes.contains(&note) {
            notes.push(note);
        }
    }
    notes
}

fn metrics(group: &Group<'_>, rows: &[Row<'_>], notes: &[&str], colour: bool) -> String {
    let several = group.runs.len() > 1;
    let paper = rows.iter().any(|row| row.metric.paper.is_some());
    let mut header = vec!["quantity"];
    header.extend(if several { &["median", "worst (seed)", "limit"][..] } else { &["measured", "limit"] });
    header.extend(paper.then_some("paper"));
    header.push("verdict");
    let last = header.len() - 1;

    let mut table = plain_table(colour);
    table.style_mut().header_separator.fill = Some('─');
    table.set_header(header.into_iter().map(bold));
    for row in rows {
        table.add_row(cells(row, several, paper, notes));
    }
    // The label column shrinks, to several lines if necessary.
    for (i, column) in table.column_iter_mut().enumerate().skip(1) {
        column.set_constraint(ColumnConstraint::ContentWidth);
        if i < last {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    text(&table)
}

fn cells(row: &Row<'_>, several: bool, paper: bool, notes: &[&str]) -> Vec<Cell> {
    let metric = row.metric;
    let place = |note: &String| notes.iter().position(|other| other == note);
    let marks: String = row.notes.iter().filter_map(place).map(|index| format!(" [{}]", index + 1)).collect();
    let mut cells = vec![Cell::new(format!("{}{marks}", metric.label))];
    if several {
        let worst = number::measured(row.worst.value, row.worst.limit);
        let worst = format!("{} ({})", number::with_unit(&worst, &metric.unit), row.worst_seed);
        cells.extend([row.median_text(), worst].map(Cell::new));
    } else {
        cells.push(Cell::new(row.worst.measured_text()));
    }
    cells.push(Cell::new(metric.limit_text()));
    if paper {
        cells.push(Cell::new(metric.paper.as_deref().unwrap_or("–")));
    }
    let verdict = Cell::new(row.verdict());
    cells.push(match (row.pass(), metric.limit) {
        (false, _) => verdict.fg(Color::DarkRed).add_attribute(Attribute::Bold),
        (true, Some(_)) => verdict.fg(Color::DarkGreen),
        (true, None) => verdict.add_attribute(Attribute::Dim),
    });
    cells
}
