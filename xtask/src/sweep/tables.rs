//! Tables in the documents, written from the recorded sweeps between
//! `<!-- sweep:begin NAME -->` and `<!-- sweep:end -->`.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use tesaki_output::say;

use super::check;
use super::record::{FOLDER, Sweep};
use super::rows::{Bound, Pair, Row, Rows, Table, tables};
use super::set::{EVALUATION_MACHINES, Set};
use super::stats;

const END: &str = "<!-- sweep:end -->";

/// Advice for a table that differs from its sweep.
const REFRESH: &str = "run `cargo xtask sweep tables`";

/// Writes all tables into their documents; with `check` only compares, and fails if one differs, or if a
/// figure of a paper shows a run other than the recorded one.
pub fn run(check: bool) -> Result<()> {
    let folder = Path::new(FOLDER);
    let mut documents: BTreeMap<&str, String> = BTreeMap::new();
    for table in tables() {
        let before = match documents.get(table.document) {
            Some(text) => text.clone(),
            None => std::fs::read_to_string(table.document).with_context(|| table.document.to_owned())?,
        };
        let lines = generate(table, folder).with_context(|| format!("table {}", table.name))?;
        let after = replace(&before, table.name, &lines).with_context(|| table.document.to_owned())?;
        if check {
            let (document, name) = (table.document, table.name);
            ensure!(before == after, "{document}: table {name} differs from {FOLDER}: {REFRESH}");
        }
        documents.insert(table.document, after);
    }
    if check {
        check::figures()?;
    }
    for (document, text) in documents {
        check_markers(document, &text)?;
        if !check {
            std::fs::write(document, text)?;
            say!("{document}: tables written");
        }
    }
    Ok(())
}

/// Checks that every marker in a document belongs to a table, so that no table becomes outdated unnoticed.
fn check_markers(document: &str, text: &str) -> Result<()> {
    for line in text.lines().filter(|line| line.starts_with("<!-- sweep:begin")) {
        let known = tables().any(|table| table.document == document && line == begin(table.name));
        ensure!(known, "{document}: there is no table for the marker {line}");
    }
    Ok(())
}

fn begin(name: &str) -> String {
    format!("<!-- sweep:begin {name} -->")
}

/// Returns the text with `lines` between the markers of a table.
fn replace(text: &str, name: &str, lines: &str) -> Result<String> {
    let begin = begin(name);
    let (head, rest) = text.split_once(&begin).with_context(|| format!("the marker {begin} is missing"))?;
    let (old, tail) = rest.split_once(END).with_context(|| format!("no {END} follows {begin}"))?;
    ensure!(!old.contains("<!-- sweep:begin"), "no {END} follows {begin}");
    Ok(format!("{head}{begin}\n{lines}{END}{tail}"))
}

/// Recorded sweeps of the evaluation machines by scenario; `None` if nothing is recorded.
type Sweeps = BTreeMap<&'static str, Option<Sweep>>;

/// Returns the lines of a table, and a sentence about its machines.
fn generate(table: &Table, folder: &Path) -> Result<String> {
    match table.rows {
        Rows::Limits(rows) => limits(rows, &load(rows.iter().copied(), folder)?),
        Rows::Comparison(pairs) => comparison(pairs, &load(pairs.iter().flat_map(Pair::rows), folder)?),
    }
}

fn load(rows: impl Iterator<Item = Row>, folder: &Path) -> Result<Sweeps> {
    let mut sweeps = Sweeps::new();
    for row in rows {
        let sweep = Sweep::load(folder, row.scenario, Set::Evaluation)?;
        sweeps.insert(row.scenario, sweep.filter(|sweep| !sweep.machines.is_empty()));
    }
    Ok(sweeps)
}

/// Returns the paper's printed value of a metric.
fn printed<'a>(row: &Row, sweeps: &'a Sweeps) -> Option<&'a str> {
    let (_, metric) = sweeps[row.scenario].as_ref()?.metric(row.metric).ok()?;
    metric.paper.as_deref()
}

fn limits(rows: &[Row], sweeps: &Sweeps) -> Result<String> {
    let mut text = caption(sweeps);
    let paper = rows.iter().any(|row| printed(row, sweeps).is_some());
    text += "\n| | limit | median | 95th percentile | machines within the limit |";
    text += if paper { " paper |\n|---|---|---|---|---|---|\n" } else { "\n|---|---|---|---|---|\n" };
    for row in rows {
        let cells = sweeps[row.scenario].as_ref().map(|sweep| cells(row, sweep)).transpose()?;
        let cells = cells.unwrap_or_else(|| ["–", "–", "–", "not yet run"].map(str::to_owned));
        text += &format!("| {} | {} |", row.label, cells.join(" | "));
        if paper {
            text += &format!(" {} |", printed(row, sweeps).unwrap_or_default());
        }
        text.push('\n');
    }
    Ok(text)
}

/// Returns medians and 95th percentiles of the paper's law and of ours, beside the paper's printed values. If
/// only our law ran, two columns are enough.
fn comparison(pairs: &[Pair], sweeps: &Sweeps) -> Result<String> {
    let mut text = caption(sweeps);
    let both = pairs.iter().any(|pair| pair.papers_law.is_some());
    text += if both {
        "\n| median (95th percentile) | the paper | its law here | ours | error: its law over ours |\n|---|---|---|---|---|\n"
    } else {
        "\n| median (95th percentile) | the paper | here |\n|---|---|---|\n"
    };
    let dash = || "–".to_owned();
    for pair in pairs {
        let known = pair.rows().find_map(|row| printed(&row, sweeps)).or(pair.paper);
        text += &format!("| {} | {} |", pair.label, known.unwrap_or("–"));
        let law = pair.papers_law.map(|row| value(&row, sweeps)).transpose()?;
        let ours = pair.ours.map(|row| value(&row, sweeps)).transpose()?;
        let factor = law.as_ref().zip(ours.as_ref()).map(|((law, _), (ours, _))| law.abs() / ours.abs());
        let factor = factor
            .filter(|factor| pair.is_error && factor.is_finite())
            .map(|factor| format!("{} ×", significant(factor, 2)));
        let [law, ours] = [law, ours].map(|value| value.map_or_else(dash, |(_, text)| text));
        text += &if both {
            format!(" {law} | {ours} | {} |\n", factor.unwrap_or_else(dash))
        } else {
            format!(" {ours} |\n")
        };
    }
    Ok(text)
}

/// Returns the median of a row, and the text of median and 95th percentile.
fn value(row: &Row, sweeps: &Sweeps) -> Result<(f64, String)> {
    let Some(sweep) = &sweeps[row.scenario] else { return Ok((f64::NAN, "not yet run".to_owned())) };
    let (statistics, (_, metric)) = (stats::of(row, sweep)?, sweep.metric(row.metric)?);
    let median = with_unit(&digits(statistics.median, None), &metric.unit);
    Ok((statistics.median, format!("{median} ({})", digits(statistics.percentile_95, None))))
}

/// Returns the machines and commits of a table, and how many machines are missing.
fn caption(sweeps: &Sweeps) -> String {
    let all = EVALUATION_MACHINES;
    let mut commits: Vec<&str> = sweeps.values().flatten().map(|sweep| sweep.commit.as_str()).collect();
    commits.sort_unstable();
    commits.dedup();
    let machines = |sweep: &Option<Sweep>| sweep.as_ref().map_or(0, |sweep| sweep.machines.len());
    let missing = sweeps.iter().map(|(scenario, sweep)| (scenario, machines(sweep)));
    let missing: Vec<String> = missing
        .filter(|(_, machines)| *machines < all)
        .map(|(scenario, machines)| format!("{machines} of `{scenario}`"))
        .collect();
    let mut text = format!("\n{all} evaluation machines");
    if !missing.is_empty() {
        text += " planned";
    }
    if !commits.is_empty() {
        text += &format!(", commit {}", commits.join(", "));
    }
    if !missing.is_empty() {
        text += &format!("; recorded so far: {}", missing.join(", "));
    }
    text + ".\n"
}

/// Returns limit, median, 95th percentile and how many machines meet the limit.
fn cells(row: &Row, sweep: &Sweep) -> Result<[String; 4]> {
    let (_, metric) = sweep.metric(row.metric)?;
    let statistics = stats::of(row, sweep)?;
    let shown = |value: f64| with_unit(&digits(value, metric.limit), &metric.unit);
    let sign = match row.bound {
        // A count or a fraction, which cannot be negative.
        Bound::AtMost if metric.limit == Some(0.0) => "",
        Bound::AtMost => "≤ ",
        Bound::AtLeast => "≥ ",
        Bound::Within => "±",
    };
    let limit = metric.limit.map(|limit| with_unit(&format!("{sign}{limit}"), &metric.unit));
    let demanded = statistics.machines - statistics.exempt;
    let met = statistics.met.map(|met| {
        let met = if met == demanded { met.to_string() } else { format!("**{met}**") };
        let possible = if statistics.exempt > 0 { " possible" } else { "" };
        format!("{met} of {demanded}{possible}")
    });
    let dash = || "–".to_owned();
    Ok([
        limit.unwrap_or_else(dash),
        shown(statistics.median),
        shown(statistics.percentile_95),
        met.unwrap_or_else(dash),
    ])
}

/// Formats three significant digits, or more if three would hide on which side of the limit the value is.
fn digits(value: f64, limit: Option<f64>) -> String {
    if !value.is_finite() {
        return "none".to_owned();
    }
    let shown = |count| significant(value, count);
    let side = |value: f64| limit.map(|limit| value.abs().total_cmp(&limit.abs()));
    let honest = |text: &String| text.parse().is_ok_and(|shown: f64| side(shown) == side(value));
    (3..7).map(shown).find(honest).unwrap_or_else(|| shown(6))
}

fn significant(value: f64, count: usize) -> String {
    let scientific = format!("{value:.*e}", count - 1);
    let exponent = scientific.split_once('e').and_then(|(_, exponent)| exponent.parse::<i32>().ok());
    let decimals = i32::try_from(count).unwrap_or(3) - 1 - exponent.unwrap_or(0);
    let text = format!("{value:.*}", usize::try_from(decimals.min(5)).unwrap_or(0));
    // Zeros after the decimal point of a count or a zero are left out.
    if value.fract().abs() > 0.0 { text } else { format!("{value:.0}") }
}

fn with_unit(text: &str, unit: &str) -> String {
    match unit {
        "" => text.to_owned(),
        _ if text == "none" => text.to_owned(),
        "°" => format!("{text}°"),
        _ => format!("{text} {unit}"),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;
    use crate::sweep::record::Metric;
    use crate::sweep::record::fixtures::sweep;
    use crate::sweep::rows::fixtures::row;

    const TABLE: Table =
        Table { document: "made-up.md", name: "arm", rows: Rows::Limits(&[row(Bound::AtMost)]) };

    #[test]
    fn a_table_by_hand() {
        let folder = tempfile::tempdir().unwrap();
        let missing = generate(&TABLE, folder.path()).unwrap();
        assert!(
            missing.contains("100 evaluation machines planned; recorded so far: 0 of `arm`."),
            "{missing}"
        );
        assert!(missing.contains("| Error | – | – | – | not yet run |\n"), "{missing}");
        let mut three = sweep(Some(1.0), &[Some(0.25), Some(0.5), Some(1.004)]);
        three.save(folder.path()).unwrap();
        let expected = "
100 evaluation machines planned, commit 0123abc; recorded so far: 3 of `arm`.

| | limit | median | 95th percentile | machines within the limit |
|---|---|---|---|---|
| Error | ≤ 1 mm | 0.500 mm | 1.004 mm | **2** of 3 |
";
        assert_eq!(generate(&TABLE, folder.path()).unwrap(), expected);
        three.machines[2].missed.clear();
        three.machines[2].exempt.push("error".into());
        three.metrics[0].paper = Some("1–2 mm".into());
        three.save(folder.path()).unwrap();
        let exempt = generate(&TABLE, folder.path()).unwrap();
        assert!(exempt.contains("| 1.004 mm | 2 of 2 possible | 1–2 mm |\n"), "{exempt}");
        sweep(None, &[Some(0.25); 100]).save(folder.path()).unwrap();
        let complete = generate(&TABLE, folder.path()).unwrap();
        assert!(complete.starts_with("\n100 evaluation machines, commit 0123abc.\n"), "{complete}");
        assert!(complete.contains("| Error | – | 0.250 mm | 0.250 mm | – |\n"), "{complete}");
    }

    #[test]
    fn a_comparison_by_hand() {
        let folder = tempfile::tempdir().unwrap();
        let pair = Pair {
            label: "Error",
            paper: None,
            papers_law: Some(row(Bound::AtMost)),
            ours: None,
            is_error: true,
        };
        let table = |pairs| Table { rows: Rows::Comparison(pairs), ..TABLE };
        let missing = generate(&table(Box::leak(Box::new([pair]))), folder.path()).unwrap();
        assert!(missing.ends_with("| Error | – | not yet run | – | – |\n"), "{missing}");
        let mut three = sweep(None, &[Some(0.25), Some(0.5), Some(1.0)]);
        three.metrics[0].paper = Some("1–2 mm".into());
        three.metrics.push(Metric { name: "ours".into(), paper: None, ..three.metrics[0].clone() });
        for (machine, value) in three.machines.iter_mut().zip([0.1, 0.2, 0.25]) {
            machine.values.push(Some(value));
        }
        three.save(folder.path()).unwrap();
        let ours = Row { metric: "ours", ..row(Bound::AtMost) };
        let pair = Pair { ours: Some(ours), ..pair };
        let told = generate(&table(Box::leak(Box::new([pair]))), folder.path()).unwrap();
        // 0.5 divided by 0.2.
        let expected = "| Error | 1–2 mm | 0.500 mm (1) | 0.200 mm (0.250) | 2.5 × |\n";
        assert!(told.ends_with(expected), "{told}");
    }

    #[test]
    fn only_what_is_between_the_markers_changes() {
        let text = "head\n<!-- sweep:begin arm -->\nold\n<!-- sweep:end -->\ntail\n";
        let expected = "head\n<!-- sweep:begin arm -->\nnew\n<!-- sweep:end -->\ntail\n";
        assert_eq!(replace(text, "arm", "new\n").unwrap(), expected);
        assert_eq!(replace(expected, "arm", "new\n").unwrap(), expected);
        assert!(replace(text, "hand", "new\n").is_err());
        assert!(replace("<!-- sweep:begin arm -->\nold\n", "arm", "new\n").is_err());
        assert!(check_markers("made-up.md", text).is_err());
    }

    #[test]
    fn three_digits_or_as_many_as_show_the_side_of_the_limit() {
        for (value, limit, text) in [
            (8.314_159, None, "8.31"),
            (1234.6, None, "1235"),
            (0.012_345, None, "0.0123"),
            (0.0, Some(2.0), "0"),
            (20.0, None, "20"),
            (12.004, Some(12.0), "12.004"),
            (11.998, Some(12.0), "11.998"),
            (2e-9, Some(1.0), "0.00000"),
            (f64::INFINITY, None, "none"),
        ] {
            assert_eq!(digits(value, limit), text);
        }
    }

    #[test]
    fn every_table_is_named_once_and_has_rows() {
        for (index, table) in tables().enumerate() {
            assert!(match table.rows {
                Rows::Limits(rows) => !rows.is_empty(),
                Rows::Comparison(pairs) => pairs.iter().all(|pair| pair.rows().next().is_some()),
            });
            let again = |other: &Table| (other.document, other.name) == (table.document, table.name);
            assert!(!tables().skip(index + 1).any(again), "{}", table.name);
        }
    }
}
