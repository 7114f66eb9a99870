//! The page that a person reads after a run.

use std::fmt::Write as _;

use super::group::{Group, Row, groups, seeds, ticks, verdict_line};
use super::{Bound, Figure, Metric, Summary, plot};

/// Groups of points on a whole page, so that it stays below 2 MB whatever is recorded.
const BUCKETS: usize = 40_000;

/// One HTML file with everything in it: facts, the table, figures, how to read them, how to get them again.
///
/// All text is escaped. The page follows the reader's choice of light or dark, fits narrow screens and prints.
#[derive(Clone, Debug)]
pub struct Page<'a> {
    title: &'a str,
    summaries: &'a [Summary],
    lead: &'a [&'a str],
    figures: &'a [Figure],
    reading: &'a [&'a str],
    command: Option<&'a str>,
    files: &'a [(&'a str, &'a str)],
}

impl<'a> Page<'a> {
    /// A page on these runs.
    pub fn new(title: &'a str, summaries: &'a [Summary]) -> Self {
        Self { title, summaries, lead: &[], figures: &[], reading: &[], command: None, files: &[] }
    }

    /// Paragraphs that say what was done.
    #[must_use]
    pub fn lead(mut self, paragraphs: &'a [&'a str]) -> Self {
        self.lead = paragraphs;
        self
    }

    /// The figures, numbered in this order.
    #[must_use]
    pub fn figures(mut self, figures: &'a [Figure]) -> Self {
        self.figures = figures;
        self
    }

    /// Paragraphs that say how to read table and figures, beside what is said of every page.
    #[must_use]
    pub fn reading(mut self, paragraphs: &'a [&'a str]) -> Self {
        self.reading = paragraphs;
        self
    }

    /// The command that makes these very files again.
    #[must_use]
    pub fn command(mut self, command: &'a str) -> Self {
        self.command = Some(command);
        self
    }

    /// The files beside the page, each with what is in it.
    #[must_use]
    pub fn files(mut self, files: &'a [(&'a str, &'a str)]) -> Self {
        self.files = files;
        self
    }

    /// The file's text.
    pub fn html(&self) -> String {
        let title = escape(self.title);
        let mut out = format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>{title}</title>\n<style>\n{}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n",
            include_str!("page.css")
        );
        for text in self.lead {
            push(&mut out, format_args!("<p class=\"lead\">{}</p>\n", escape(text)));
        }
        let groups = groups(self.summaries);
        for run in &groups {
            group(&mut out, run, groups.len() > 1);
        }
        self.push_figures(&mut out);
        self.how_to_read(&mut out);
        self.reproduce(&mut out);
        push(
            &mut out,
            format_args!(
                "<footer>Written by tesaki {}.</footer>\n</main>\n</body>\n</html>\n",
                env!("CARGO_PKG_VERSION")
            ),
        );
        out
    }

    fn push_figures(&self, out: &mut String) {
        if self.figures.is_empty() {
            return;
        }
        let lines: usize = self.figures.iter().map(Figure::line_count).sum();
        let buckets = plot::BUCKETS.min(BUCKETS / lines.max(1)).max(8);
        out.push_str("<section>\n<h2>Figures</h2>\n");
        for (i, figure) in self.figures.iter().enumerate() {
            push(
                out,
                format_args!(
                    "<figure>\n<h3>Figure {}. {}</h3>\n<div class=\"scroll plot\">{}</div>\n<figcaption>{}</figcaption>\n\
                     </figure>\n",
                    i + 1,
                    escape(&figure.title),
                    plot::svg(figure, buckets, false),
                    escape(&figure.caption)
                ),
            );
        }
        out.push_str("</section>\n");
    }

    fn how_to_read(&self, out: &mut String) {
        out.push_str("<section>\n<h2>How to read this</h2>\n");
        out.push_str(
            "<p>Each row of the table is one measured quantity. Green means that it is on the right side of what was \
             wanted; a row without a limit is reported only. In the small scale beside the values the green part is \
             what was wanted, and each dot is one seed. ",
        );
        out.push_str(
            "In the figures solid lines are measured and dashed ones are references; dotted red lines are ",
        );
        out.push_str(
            "limits or values to compare with, and the pale band is the space between limits.</p>\n",
        );
        for text in self.reading {
            push(out, format_args!("<p>{}</p>\n", escape(text)));
        }
        out.push_str("</section>\n");
    }

    fn reproduce(&self, out: &mut String) {
        if self.command.is_none() && self.files.is_empty() {
            return;
        }
        out.push_str("<section>\n<h2>Get it again</h2>\n");
        if let Some(command) = self.command {
            push(out, format_args!("<pre><code>{}</code></pre>\n", escape(command)));
            out.push_str(
                "<p>Same seed, same controller, same numbers: nothing in a run depends on the clock.</p>\n",
            );
        }
        if !self.files.is_empty() {
            out.push_str("<ul>\n");
            for (name, text) in self.files {
                let name = escape(name);
                push(
                    out,
                    format_args!("<li><a href=\"{name}\"><code>{name}</code></a>: {}</li>\n", escape(text)),
                );
            }
            out.push_str("</ul>\n");
        }
        out.push_str("</section>\n");
    }
}

fn push(out: &mut String, text: std::fmt::Arguments<'_>) {
    // Writing to a string does not fail.
    let _ = out.write_fmt(text);
}

/// Verdict, facts and table of the runs of one scenario on one controller; `named` where there are several such.
fn group(out: &mut String, group: &Group<'_>, named: bool) {
    let first = group.runs[0];
    let (class, word) = if group.pass() { ("good", "PASS") } else { ("bad", "FAIL") };
    push(
        out,
        format_args!(
            "<section>\n<h2>Measured and wanted{}</h2>\n<p class=\"verdict {class}\"><b>{word}</b>{}</p>\n<dl>\n",
            if named {
                escape(&format!(": {}, {}", first.scenario, first.controller))
            } else {
                String::new()
            },
            escape(&verdict_line(group))
        ),
    );
    fact(out, "Scenario", &first.scenario, "");
    fact(out, "Controller", &first.controller, "");
    fact(out, if group.runs.len() == 1 { "Seed" } else { "Seeds" }, &seeds(&group.runs), "");
    fact(out, "Ticks", &ticks(&group.runs), "");
    if let Some(identical) = group.runs.iter().filter_map(|run| run.identical).reduce(|a, b| a && b) {
        let text = if identical { "identical bytes" } else { "DIFFERENT" };
        fact(out, "Image and native", text, "");
    }
    if let Some(hash) = &first.elf_sha256 {
        fact(out, "SHA-256 of the firmware image", hash, " class=\"wide\"");
    }
    out.push_str("</dl>\n");
    rows(out, group);
    out.push_str("</section>\n");
}

fn fact(out: &mut String, name: &str, value: &str, class: &str) {
    push(out, format_args!("<div{class}><dt>{}</dt><dd>{}</dd></div>\n", escape(name), escape(value)));
}

fn rows(out: &mut String, group: &Group<'_>) {
    let rows = group.rows();
    let several = group.runs.len() > 1;
    let paper = rows.iter().any(|row| row.metric.paper.is_some());
    out.push_str("<div class=\"scroll\"><table>\n<thead><tr><th>Quantity</th>");
    out.push_str(if several {
        "<th class=\"n\">Median</th><th class=\"n\">Worst</th>"
    } else {
        "<th class=\"n\">Measured</th>"
    });
    out.push_str("<th class=\"n\">Wanted</th>");
    out.push_str(if paper { "<th class=\"n\">Paper</th>" } else { "" });
    out.push_str("<th>Against the limit</th><th>Verdict</th></tr></thead>\n<tbody>\n");
    for row in &rows {
        push(out, format_args!("<tr><td>{}", escape(&row.metric.label)));
        if let Some(note) = &row.metric.note {
            push(out, format_args!("<small>{}</small>", escape(note)));
        }
        out.push_str("</td>");
        if several {
            push(out, format_args!("<td class=\"n\">{}</td>", escape(&row.median_text())));
        }
        push(out, format_args!("<td class=\"n m\">{}", escape(&row.worst.measured())));
        if several {
            push(out, format_args!("<small>seed {}</small>", row.worst_seed));
        }
        push(out, format_args!("</td><td class=\"n\">{}</td>", escape(&row.metric.wanted())));
        if paper {
            push(
                out,
                format_args!("<td class=\"n\">{}</td>", escape(row.metric.paper.as_deref().unwrap_or("–"))),
            );
        }
        let class = match (row.pass(), row.metric.limit) {
            (false, _) => "bad",
            (true, Some(_)) => "good",
            (true, None) => "plain",
        };
        push(
            out,
            format_args!(
                "<td>{}</td><td class=\"v {class}\">{}</td></tr>\n",
                gauge(row),
                escape(&row.verdict())
            ),
        );
    }
    out.push_str("</tbody>\n</table></div>\n");
}

/// A scale from nothing to a third above the limit, with a dot for each seed.
fn gauge(row: &Row<'_>) -> String {
    let Some(limit) = row.metric.limit.filter(|l| l.is_finite() && *l > 0.0) else {
        return String::new();
    };
    const WIDTH: f64 = 132.0;
    let full = limit * 4.0 / 3.0;
    let at = |v: f64| 5.0 + (v / full).clamp(0.0, 1.0) * (WIDTH - 10.0);
    let position = |m: &Metric| if m.bound == Bound::Within { m.value.abs() } else { m.value };
    let (from, to) = match row.metric.bound {
        Bound::AtLeast => (at(limit), WIDTH),
        Bound::AtMost | Bound::Within => (0.0, at(limit)),
    };
    let mut svg = format!(
        "<svg class=\"gauge\" viewBox=\"0 0 {WIDTH} 14\" aria-hidden=\"true\"><rect x=\"0\" y=\"3\" width=\"{WIDTH}\" \
         height=\"8\" rx=\"4\"/><rect class=\"want\" x=\"{from:.1}\" y=\"3\" width=\"{:.1}\" height=\"8\" rx=\"4\"/>\
         <line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"0\" y2=\"14\" stroke-width=\"1.5\"/>",
        to - from,
        x = at(limit),
    );
    for metric in row.values.iter().flatten() {
        let x = if metric.value.is_finite() { at(position(metric)) } else { WIDTH - 5.0 };
        let class = if metric.pass() { "" } else { " class=\"over\"" };
        push(&mut svg, format_args!("<circle{class} cx=\"{x:.1}\" cy=\"7\" r=\"3.6\"/>"));
    }
    svg + "</svg>"
}

/// Text that is neither markup nor the end of an attribute.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
    }
    out
}
