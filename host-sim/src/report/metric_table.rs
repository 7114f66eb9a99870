//! Verdict, facts and metrics of the runs of one scenario on one controller, as HTML.

use maud::{Markup, html};

use super::group::{Group, Row, seeds, ticks, verdict_line, verdict_word};
use super::summary::{Bound, Metric};

/// `named` if a page has several.
pub(super) fn section(group: &Group<'_>, named: bool) -> Markup {
    let first = group.runs[0];
    let word = verdict_word(group);
    let class = match word {
        "PASS" => "good",
        "FAIL" => "bad",
        _ => "plain",
    };
    html! {
        section {
            h2 {
                "Results"
                @if named { ": " (first.scenario) ", " (first.controller) }
            }
            p class={ "verdict " (class) } { b { (word) } (verdict_line(group)) }
            dl {
                (fact("Scenario", &first.scenario))
                (fact("Controller", &first.controller))
                (fact(if group.runs.len() == 1 { "Seed" } else { "Seeds" }, &seeds(&group.runs)))
                (fact("Control periods", &ticks(&group.runs)))
                @if let Some(identical) = group.identical() {
                    (fact("Firmware image and native core", if identical { "identical bytes" } else { "DIFFERENT" }))
                }
            }
            (metrics(group))
        }
    }
}

pub(super) fn fact(name: &str, value: &str) -> Markup {
    html! { div { dt { (name) } dd { (value) } } }
}

fn metrics(group: &Group<'_>) -> Markup {
    let rows = group.rows();
    let several = group.runs.len() > 1;
    let paper = rows.iter().any(|row| row.metric.paper.is_some());
    html! {
        div class="scroll" {
            table class="metrics" {
                thead {
                    tr {
                        th { "Quantity" }
                        @if several { th class="n" { "Median" } th class="n" { "Worst" } }
                        @else { th class="n" { "Measured" } }
                        th class="n" { "Limit" }
                        @if paper { th class="n" { "Paper" } }
                        th class="g" { "Against the limit" }
                        th { "Verdict" }
                    }
                }
                tbody { @for row in &rows { (metric(row, several, paper)) } }
            }
        }
    }
}

fn metric(row: &Row<'_>, several: bool, paper: bool) -> Markup {
    let class = match (row.pass(), row.metric.limit) {
        (false, _) => "bad",
        (true, Some(_)) => "good",
        (true, None) => "plain",
    };
    html! {
        tr {
            td {
                (row.metric.label)
                @for note in &row.notes { small { (note) } }
            }
            @if several { td class="n" { (row.median_text()) } }
            td class="n m" {
                (row.worst.measured_text())
                @if several { small { "seed " (row.worst_seed) } }
            }
            td class="n" { (row.metric.limit_text()) }
            @if paper { td class="n" { (row.metric.paper.as_deref().unwrap_or("–")) } }
            td class="g" { (gauge(row)) }
            td class={ "v " (class) } { (row.verdict()) }
        }
    }
}

/// A scale from 0 to a third above the limit, with a dot for each seed.
fn gauge(row: &Row<'_>) -> Markup {
    let Some(limit) = row.metric.limit.filter(|limit| limit.is_finite() && *limit > 0.0) else {
        return html! {};
    };
    const WIDTH: f64 = 132.0;
    let full = limit * 4.0 / 3.0;
    let at = |value: f64| 5.0 + (value / full).clamp(0.0, 1.0) * (WIDTH - 10.0);
    let place = |metric: &Metric| match metric.bound {
        _ if !metric.value.is_finite() => WIDTH - 5.0,
        Bound::Within => at(metric.value.abs()),
        Bound::AtMost | Bound::AtLeast => at(metric.value),
    };
    let (from, to) = match row.metric.bound {
        Bound::AtLeast => (at(limit), WIDTH),
        Bound::AtMost | Bound::Within => (0.0, at(limit)),
    };
    let px = |value: f64| format!("{value:.1}");
    html! {
        svg class="gauge" viewBox=(format!("0 0 {WIDTH} 14")) aria-hidden="true" {
            rect x="0" y="3" width=(WIDTH) height="8" rx="4" {}
            rect class="inside" x=(px(from)) y="3" width=(px(to - from)) height="8" rx="4" {}
            line x1=(px(at(limit))) x2=(px(at(limit))) y1="0" y2="14" stroke-width="1.5" {}
            @for metric in row.values.iter().flatten() {
                circle class=(if metric.pass() { "" } else { "over" }) cx=(px(place(metric))) cy="7" r="3.6" {}
            }
        }
    }
}
