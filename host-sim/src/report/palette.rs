//! Colours that are distinguishable on white and on the dark page, also for colour-blind readers.

/// A colour of a figure: the value for a white background, and the class by which `page.css` replaces it on a
/// dark one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Paint {
    pub colour: &'static str,
    pub class: &'static str,
}

impl Paint {
    const fn new(colour: &'static str, class: &'static str) -> Self {
        Self { colour, class }
    }
}

pub(super) const GROUND: Paint = Paint::new("#FFFFFF", "ground");
pub(super) const INK: Paint = Paint::new("#1B1F24", "ink");
pub(super) const MUTED: Paint = Paint::new("#57606A", "muted");
pub(super) const GRID: Paint = Paint::new("#DDE2E7", "grid");
/// Shade of phases.
pub(super) const SHADE: Paint = Paint::new("#EDF1F5", "shade");
/// Area between limits.
pub(super) const BAND: Paint = Paint::new("#F1F7F3", "band");
/// Limits and reference values.
pub(super) const LIMIT: Paint = Paint::new("#A3214A", "limit");

/// The colours of lines: those of Okabe and Ito, with the pale ones darkened to a contrast of at least 3
/// against white, and all with the same minimum against the dark page. The last is the colour of the text.
pub(super) const LINES: [Paint; 8] = [
    Paint::new("#0072B2", "line"),
    Paint::new("#D55E00", "line"),
    Paint::new("#009E73", "line"),
    Paint::new("#C0659A", "line"),
    Paint::new("#B07D00", "line"),
    Paint::new("#3A93C8", "line"),
    Paint::new("#7A7F87", "line"),
    INK,
];

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative luminance (WCAG 2.2) of `#RRGGBB`.
    fn luminance(colour: &str) -> f64 {
        let part = |at: usize| {
            let value =
                u8::from_str_radix(&colour[at..at + 2], 16).expect("a colour is six hexadecimal digits");
            let value = f64::from(value) / 255.0;
            if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
        };
        0.2126 * part(1) + 0.7152 * part(3) + 0.0722 * part(5)
    }

    fn contrast(a: &str, b: &str) -> f64 {
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    /// Returns the colour that `page.css` gives a class on dark pages.
    fn dark(class: &str) -> &'static str {
        let css = include_str!("page.css");
        let rule = css.split_once(&format!(".plot .{class} {{")).map_or("", |(_, rest)| rest);
        let at = rule.find('#').expect("the class has a colour");
        &rule[at..at + 7]
    }

    #[test]
    fn everything_that_is_read_stands_out_from_both_grounds() {
        let (white, black) = ("#FFFFFF", "#14181D");
        assert!(include_str!("page.css").contains("--ground: #14181d"));
        for Paint { colour, .. } in &LINES[..7] {
            assert!(contrast(colour, white) >= 3.0, "{colour} on white");
            assert!(contrast(colour, black) >= 3.0, "{colour} on the dark page");
            assert!(contrast(colour, SHADE.colour) >= 2.8, "{colour} on a phase");
        }
        for Paint { colour, class } in [INK, MUTED, LIMIT] {
            assert!(contrast(colour, white) >= 4.5, "{class} on white");
            assert!(contrast(dark(class), black) >= 4.5, "{class} on the dark page");
        }
    }
}
