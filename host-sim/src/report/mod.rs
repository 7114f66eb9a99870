//! Results of a run: a table in the terminal, and CSV, JSON and a page with figures in a folder.
//!
//! A scenario fills a [`Summary`] per seed with [`Metric`]s, and [`Figure`]s with the recorded lines. All
//! outputs are made from those two: [`table()`] for the terminal, [`json()`] for machines, [`Page`] for
//! people, [`csv()`] for plots with other programs. The limits come from the scenario; a NaN never passes.
//!
//! ```
//! use tesaki_sim::report::{Figure, Line, Metric, Page, Panel, Summary, table};
//! let summary = Summary::new("hand3-servo", "native", 1)
//!     .ticks(600)
//!     .metric("peak_error", Metric::at_most("Peak error", 8.3, 12.0, "mrad"));
//! assert!(summary.pass());
//! println!("{}", table(std::slice::from_ref(&summary), false));
//!
//! let panel = Panel::new("Finger 1", "error", "mrad")
//!     .line(Line::solid("base", 0, vec![0.0, 0.01, 0.02], vec![0.0, 8.3, 1.2]))
//!     .band(12.0, "limit");
//! let figures = [Figure::stacked("Tracking error", "Against the filtered reference.", "time", "s").panel(panel)];
//! let page = Page::new("Joint servo", std::slice::from_ref(&summary)).figures(&figures).html();
//! assert!(page.contains("<svg"));
//! ```

mod axis;
mod csv;
mod drawing;
mod figure;
mod group;
mod layout;
mod metric_table;
mod number;
mod page;
mod palette;
mod summary;
mod terminal;
mod verdict;
mod write;

pub use csv::{Column, Table, csv};
pub use figure::{Event, Figure, Line, LineStyle, Mark, Panel, Phase};
pub use page::{Page, figure_files};
pub use summary::{Bound, Metric, Summary, json};
pub use terminal::table;
pub use verdict::{Verdict, VerdictRow};
pub use write::{WriteError, create, write};
