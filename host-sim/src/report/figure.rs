//! Content of a figure: panels with lines, limits, marks, phases and events. `drawing.rs` draws it.

/// Style of a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LineStyle {
    /// Measured values.
    #[default]
    Solid,
    /// References, targets and computed curves.
    Dashed,
}

/// A line of a panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Its name in the legend.
    pub name: String,
    /// Abscissae, in drawing order.
    pub x: Vec<f64>,
    /// Ordinates, one for each abscissa; a non-finite value is a gap.
    pub y: Vec<f64>,
    /// Index into the eight colours of the palette, which are those of Okabe and Ito adjusted; wraps around.
    /// [`Line::INK`] is the last.
    pub colour: usize,
    /// Its style.
    pub style: LineStyle,
}

impl Line {
    /// The colour of the text, for references that do not belong to a joint.
    pub const INK: usize = 7;

    /// Creates a solid line.
    pub fn solid(name: impl Into<String>, colour: usize, x: Vec<f64>, y: Vec<f64>) -> Self {
        Self { name: name.into(), x, y, colour, style: LineStyle::Solid }
    }

    /// Creates a dashed line.
    pub fn dashed(name: impl Into<String>, colour: usize, x: Vec<f64>, y: Vec<f64>) -> Self {
        Self { style: LineStyle::Dashed, ..Self::solid(name, colour, x, y) }
    }

    /// Returns the line with at most `buckets` groups of points, of which first, last and extremes are kept.
    ///
    /// A point is `None` where the line is interrupted. A line that is short enough is unchanged.
    pub(super) fn decimated(&self, buckets: usize) -> Vec<Option<(f64, f64)>> {
        let points =
            || self.x.iter().zip(&self.y).map(|(&x, &y)| (x.is_finite() && y.is_finite()).then_some((x, y)));
        let length = points().len();
        if length <= buckets * 8 {
            return points().collect();
        }
        let all: Vec<_> = points().collect();
        all.chunks(length.div_ceil(buckets.max(1))).flat_map(keep).collect()
    }
}

/// Returns first, last, extremes in both directions and one gap of a group of points, in their order.
fn keep(group: &[Option<(f64, f64)>]) -> Vec<Option<(f64, f64)>> {
    let finite = || group.iter().enumerate().filter_map(|(i, p)| p.map(|p| (i, p)));
    let extreme = |key: fn((f64, f64)) -> f64| {
        finite().reduce(|a, b| if key(b.1) > key(a.1) { b } else { a }).map(|(i, _)| i)
    };
    let mut kept: Vec<usize> = [
        finite().next().map(|(i, _)| i),
        finite().next_back().map(|(i, _)| i),
        extreme(|p| p.0),
        extreme(|p| -p.0),
        extreme(|p| p.1),
        extreme(|p| -p.1),
        group.iter().position(Option::is_none),
    ]
    .into_iter()
    .flatten()
    .collect();
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter().map(|i| group[i]).collect()
}

/// A horizontal line with a label at the right margin.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Rule {
    pub value: f64,
    /// Whether it is also drawn at `-value`, with the space between the two shaded.
    pub band: bool,
    /// Its start on the horizontal axis; `None` for the left end of the axis.
    pub from: Option<f64>,
    pub label: String,
}

/// A labelled point.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Abscissa.
    pub x: f64,
    /// Ordinate.
    pub y: f64,
    /// The label, beside the point.
    pub label: String,
}

/// A picture behind the lines.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Picture {
    pub png: Vec<u8>,
    /// Left and right edge on the horizontal axis; upper and lower edge on the vertical axis.
    pub x: [f64; 2],
    pub y: [f64; 2],
}

/// A named interval of the horizontal axis: a phase of a grasp, or the time in which errors are evaluated.
#[derive(Clone, Debug, PartialEq)]
pub struct Phase {
    /// Its start.
    pub from: f64,
    /// Its end.
    pub to: f64,
    /// Its name.
    pub label: String,
}

/// A named point of the horizontal axis: a step, the start or end of a contact.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    /// Its position.
    pub at: f64,
    /// Its name.
    pub label: String,
}

/// One pair of axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Title above the panel.
    pub title: String,
    /// The quantity of the vertical axis.
    pub quantity: String,
    /// Its unit; empty for counts and ratios.
    pub unit: String,
    /// The lines, the first at the bottom.
    pub lines: Vec<Line>,
    pub(super) rules: Vec<Rule>,
    pub(super) marks: Vec<Mark>,
    pub(super) picture: Option<Picture>,
    /// Minimum extent of the vertical axis.
    pub(super) min_height: f64,
}

impl Panel {
    /// Creates axes without lines.
    pub fn new(title: impl Into<String>, quantity: impl Into<String>, unit: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            quantity: quantity.into(),
            unit: unit.into(),
            lines: Vec::new(),
            rules: Vec::new(),
            marks: Vec::new(),
            picture: None,
            min_height: 0.0,
        }
    }

    /// Sets a minimum extent of the vertical axis, so that small changes look small.
    #[must_use]
    pub const fn at_least(mut self, height: f64) -> Self {
        self.min_height = height;
        self
    }

    /// Adds a line above the others.
    #[must_use]
    pub fn line(mut self, line: Line) -> Self {
        self.lines.push(line);
        self
    }

    /// Adds a shaded band of ±`limit`; `label` names the limit.
    #[must_use]
    pub fn band(mut self, limit: f64, label: impl Into<String>) -> Self {
        self.rules.push(Rule { value: limit.abs(), band: true, from: None, label: label.into() });
        self
    }

    /// Adds a shaded band of ±`limit` that starts at `from` on the horizontal axis.
    #[must_use]
    pub fn band_from(mut self, limit: f64, from: f64, label: impl Into<String>) -> Self {
        self.rules.push(Rule { value: limit.abs(), band: true, from: Some(from), label: label.into() });
        self
    }

    /// Adds a horizontal line: a one-sided limit, or the paper's value.
    #[must_use]
    pub fn rule(mut self, value: f64, label: impl Into<String>) -> Self {
        self.rules.push(Rule { value, band: false, from: None, label: label.into() });
        self
    }

    /// Adds a picture behind the lines: a PNG file from `x[0]` to `x[1]`, with its upper edge at `y[0]` and
    /// its lower edge at `y[1]`. For figures of [paths](Figure::paths).
    #[must_use]
    pub fn picture(mut self, png: Vec<u8>, x: [f64; 2], y: [f64; 2]) -> Self {
        self.picture = Some(Picture { png, x, y });
        self
    }

    /// Marks a point.
    #[must_use]
    pub fn mark(mut self, x: f64, y: f64, label: impl Into<String>) -> Self {
        self.marks.push(Mark { x, y, label: label.into() });
        self
    }
}

/// Arrangement of the panels of a figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Arrangement {
    /// One above the other, on one horizontal axis.
    Stacked,
    /// Side by side, with equal scales on both axes of each panel.
    Paths,
}

/// Panels that belong together.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Title.
    pub title: String,
    /// Text below the figure.
    pub caption: String,
    /// The quantity of the horizontal axis.
    pub quantity: String,
    /// Its unit; empty for counts and ratios.
    pub unit: String,
    /// The panels, from the top or from the left.
    pub panels: Vec<Panel>,
    /// Named intervals of the horizontal axis, across all panels.
    pub phases: Vec<Phase>,
    /// Named points of the horizontal axis, across all panels.
    pub events: Vec<Event>,
    pub(super) arrangement: Arrangement,
}

impl Figure {
    /// Creates a figure with panels one above the other on a common horizontal axis, as for time series.
    pub fn stacked(
        title: impl Into<String>,
        caption: impl Into<String>,
        quantity: impl Into<String>,
        unit: impl Into<String>,
    ) -> Self {
        Self {
            title: title.into(),
            caption: caption.into(),
            quantity: quantity.into(),
            unit: unit.into(),
            panels: Vec::new(),
            phases: Vec::new(),
            events: Vec::new(),
            arrangement: Arrangement::Stacked,
        }
    }

    /// Creates a figure with panels side by side, each with equal scales on both axes, as for the path of a
    /// fingertip.
    pub fn paths(
        title: impl Into<String>,
        caption: impl Into<String>,
        quantity: impl Into<String>,
        unit: impl Into<String>,
    ) -> Self {
        Self { arrangement: Arrangement::Paths, ..Self::stacked(title, caption, quantity, unit) }
    }

    /// Adds a panel.
    #[must_use]
    pub fn panel(mut self, panel: Panel) -> Self {
        self.panels.push(panel);
        self
    }

    /// Names an interval of the horizontal axis; every other phase is shaded.
    #[must_use]
    pub fn phase(mut self, from: f64, to: f64, label: impl Into<String>) -> Self {
        self.phases.push(Phase { from, to, label: label.into() });
        self
    }

    /// Names a point of the horizontal axis.
    #[must_use]
    pub fn event(mut self, at: f64, label: impl Into<String>) -> Self {
        self.events.push(Event { at, label: label.into() });
        self
    }

    /// Removes the limits, whose labels begin with this word.
    #[must_use]
    pub fn without_limits(mut self) -> Self {
        for panel in &mut self.panels {
            panel.rules.retain(|rule| !rule.label.starts_with("limit"));
        }
        self
    }

    pub(super) fn line_count(&self) -> usize {
        self.panels.iter().map(|panel| panel.lines.len()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimation_keeps_extremes_ends_and_gaps() {
        let n = 100_000_u32;
        let x: Vec<f64> = (0..n).map(f64::from).collect();
        let mut y: Vec<f64> = x.iter().map(|x| (x * 1e-3).sin()).collect();
        y[12_345] = 7.0;
        y[54_321] = -9.0;
        y[77_777] = f64::NAN;
        let line = Line::solid("", 0, x, y);
        let points = line.decimated(300);
        assert!(points.len() <= 300 * 7, "{}", points.len());
        for kept in [Some((12_345.0, 7.0)), Some((54_321.0, -9.0)), None] {
            assert!(points.contains(&kept), "{kept:?}");
        }
        assert_eq!(points.first(), Some(&Some((0.0, 0.0))));
        assert_eq!(points.last().copied().flatten().map(|p| p.0), Some(99_999.0));
        let times: Vec<f64> = points.iter().flatten().map(|p| p.0).collect();
        assert!(times.windows(2).all(|w| w[0] < w[1]));
    }

    #[test]
    fn a_short_line_stays_as_it_is() {
        let line = Line::solid("", 0, vec![0.0, 1.0, 2.0], vec![1.0, f64::INFINITY, 3.0]);
        assert_eq!(line.decimated(300), [Some((0.0, 1.0)), None, Some((2.0, 3.0))]);
    }
}
