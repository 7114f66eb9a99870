//! The report page of a run.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::drawing::{BUCKETS, inline_svg};
use super::figure::Figure;
use super::group::groups;
use super::metric_table::{fact, section};
use super::summary::Summary;

/// Number of point groups on a whole page, so that it stays below 2 MB.
const PAGE_BUCKETS: usize = 30_000;

/// A self-contained HTML file: results, figures, how to read them, how they were made.
///
/// The page follows the reader's choice of light or dark, fits narrow screens and prints. Each figure has a
/// link to its file from [`figure_files`], which is stored beside the page.
#[derive(Clone, Debug)]
pub struct Page<'a> {
    title: &'a str,
    summaries: &'a [Summary],
    lead: &'a [&'a str],
    replay: Option<&'a str>,
    figures: &'a [Figure],
    command: Option<&'a str>,
    commit: Option<&'a str>,
    files: &'a [(&'a str, &'a str)],
}

impl<'a> Page<'a> {
    /// Creates a page on these runs.
    pub fn new(title: &'a str, summaries: &'a [Summary]) -> Self {
        Self {
            title,
            summaries,
            lead: &[],
            replay: None,
            figures: &[],
            command: None,
            commit: None,
            files: &[],
        }
    }

    /// Sets the paragraphs that describe the experiment.
    #[must_use]
    pub fn lead(mut self, paragraphs: &'a [&'a str]) -> Self {
        self.lead = paragraphs;
        self
    }

    /// Sets the replay of the run, as JSON that is safe in HTML ([`tesaki_viewer::script_json`]).
    #[must_use]
    pub fn replay(mut self, replay: &'a str) -> Self {
        self.replay = Some(replay);
        self
    }

    /// Sets the figures, numbered in this order.
    #[must_use]
    pub fn figures(mut self, figures: &'a [Figure]) -> Self {
        self.figures = figures;
        self
    }

    /// Sets the command that reproduces these files.
    #[must_use]
    pub fn command(mut self, command: &'a str) -> Self {
        self.command = Some(command);
        self
    }

    /// Sets the commit of the sources that ran.
    #[must_use]
    pub fn commit(mut self, commit: &'a str) -> Self {
        self.commit = Some(commit);
        self
    }

    /// Sets the files beside the page, each with its content.
    #[must_use]
    pub fn files(mut self, files: &'a [(&'a str, &'a str)]) -> Self {
        self.files = files;
        self
    }

    /// Returns the text of the file.
    pub fn html(&self) -> String {
        let groups = groups(self.summaries);
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    title { (self.title) }
                    style { (PreEscaped(include_str!("page.css"))) }
                    @if self.replay.is_some() { style { (PreEscaped(tesaki_viewer::STYLE)) } }
                }
                body {
                    main {
                        h1 { (self.title) }
                        @for text in self.lead { p class="lead" { (text) } }
                        @for group in &groups { (section(group, groups.len() > 1)) }
                        (self.replay_section())
                        (self.figure_section())
                        (self.how_to_read())
                        (self.how_it_was_made())
                        footer { "Written by tesaki " (env!("CARGO_PKG_VERSION")) "." }
                    }
                    @if self.replay.is_some() { script { (PreEscaped(tesaki_viewer::SCRIPT)) } }
                }
            }
        };
        page.into_string()
    }

    fn replay_section(&self) -> Markup {
        html! {
            @if let Some(replay) = self.replay {
                section {
                    h2 { "The run" }
                    noscript { p { "The replay needs JavaScript; the figures below do not." } }
                    div class="tv-replay" {
                        script type="application/json" { (PreEscaped(replay)) }
                    }
                }
            }
        }
    }

    fn figure_section(&self) -> Markup {
        let lines: usize = self.figures.iter().map(Figure::line_count).sum();
        let buckets = BUCKETS.min(PAGE_BUCKETS / lines.max(1)).max(8);
        html! {
            @if !self.figures.is_empty() {
                section {
                    h2 { "Figures" }
                    @for (figure, number) in self.figures.iter().zip(1..) {
                        @let file = file_name(number, figure);
                        figure {
                            h3 { "Figure " (number) ". " (figure.title) }
                            div class="scroll plot" { (PreEscaped(inline_svg(figure, buckets))) }
                            figcaption {
                                (figure.caption) " "
                                a class="save" href={ "figures/" (file) } download=(file) { "Save as SVG" }
                            }
                        }
                    }
                }
            }
        }
    }

    fn how_to_read(&self) -> Markup {
        html! {
            section {
                h2 { "How to read this" }
                p {
                    "Each row of the table is one measured quantity. Green means that it meets its limit; a \
                     row without a limit is reported only. On the small scale the green part is within the \
                     limit, and each dot is one seed."
                }
                p {
                    "In the figures solid lines are measured values and dashed lines are references, targets \
                     or computed curves. Dotted red lines are limits, or values to compare with. Names above \
                     a figure mark phases and events, and every other phase is shaded. Panels that show the \
                     same quantity share a scale, unless one of them would be too flat to read."
                }
            }
        }
    }

    fn how_it_was_made(&self) -> Markup {
        let first = self.summaries.first();
        let digest = first.and_then(|run| run.frames_sha256.as_deref());
        let image = first.and_then(|run| run.elf_sha256.as_deref());
        html! {
            @if self.command.is_some() || !self.files.is_empty() {
                section {
                    h2 { "How it was made" }
                    @if let Some(command) = self.command {
                        pre { code { (command) } }
                        p { "The same seed and controller give the same numbers: nothing in a run depends on the clock." }
                    }
                    dl class="wide" {
                        @if let Some(commit) = self.commit { (fact("Commit", commit)) }
                        @if let Some(run) = first { (fact("Seed of figures and recordings", &run.seed.to_string())) }
                        @if let Some(digest) = digest { (fact("SHA-256 of the controller's output", digest)) }
                        @if let Some(image) = image { (fact("SHA-256 of the firmware image", image)) }
                    }
                    @if !self.files.is_empty() {
                        ul {
                            @for (name, text) in self.files { li { a href=(name) { code { (name) } } ": " (text) } }
                        }
                    }
                }
            }
        }
    }
}

/// Returns the figures as files for the folder `figures` beside the page: names and stand-alone SVG
/// documents.
pub fn figure_files(figures: &[Figure]) -> Vec<(String, String)> {
    figures.iter().zip(1..).map(|(figure, number)| (file_name(number, figure), figure.svg())).collect()
}

/// Returns a file name such as `1-peak-error.svg`.
fn file_name(number: usize, figure: &Figure) -> String {
    let words = figure.title.split(|letter: char| !letter.is_ascii_alphanumeric());
    let words = words.filter(|word| !word.is_empty()).map(str::to_ascii_lowercase);
    let name = std::iter::once(number.to_string()).chain(words).collect::<Vec<_>>().join("-");
    format!("{name}.svg")
}
