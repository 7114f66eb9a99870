//! The page that shows a robot in a browser: live (`tesaki view`), for a run while it is computed (`cargo sim
//! run --view`), and in the reports of the simulator. [`server`] serves it.
//!
//! The page is one script and one style sheet, [`SCRIPT`] and [`STYLE`], built by esbuild from the sources in
//! `viewer/web` (`npm run build` there). Both are committed, so that only Rust is needed to build this crate,
//! and the page loads nothing from elsewhere. Its input is JSON: a [`Scene`], and for a report a [`Replay`].

mod replay;
mod scene;
pub mod server;

pub use replay::{Contact, Frame, Note, Object, Replay, Sample, Shape};
pub use scene::{Scene, SceneJoint, Solid, SolidShape, Tip};

/// The script: three.js, uPlot and the sources in `viewer/web/src`, with the licences of the first two.
pub const SCRIPT: &str = include_str!("../bundle/viewer.js");
/// The style sheet. Every class begins with `tv-`.
pub const STYLE: &str = include_str!("../bundle/viewer.css");

/// Builds a page that loads both from its server.
macro_rules! served_page {
    ($class:literal) => {
        concat!(
            "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n",
            "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>tesaki</title>\n",
            "<link rel=\"icon\" href=\"data:,\">\n<link rel=\"stylesheet\" href=\"viewer.css\">\n",
            "<main class=\"",
            $class,
            "\"></main>\n<script src=\"viewer.js\"></script>\n</html>\n"
        )
    };
}

/// The live page of a board.
pub const LIVE_PAGE: &str = served_page!("tv-live");
/// The page of a run that is being computed.
pub const RUN_PAGE: &str = served_page!("tv-run");

/// Returns JSON that is safe inside a `<script>` element of HTML.
///
/// # Errors
/// The value cannot be written as JSON.
pub fn script_json(value: &impl serde::Serialize) -> Result<String, serde_json::Error> {
    Ok(serde_json::to_string(value)?.replace('<', "\\u003c"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn script_and_data_cannot_end_their_element() {
        assert!(!SCRIPT.to_ascii_lowercase().contains("</script"));
        assert!(!STYLE.to_ascii_lowercase().contains("</style"));
        let text = script_json(&["</script><script>alert(1)"]).expect("it is text");
        assert!(!text.contains('<'), "{text}");
        let back: Vec<String> = serde_json::from_str(&text).expect("it is JSON");
        assert_eq!(back, ["</script><script>alert(1)"]);
    }

    #[test]
    fn the_page_asks_for_nothing_over_the_network() {
        for text in [SCRIPT, STYLE] {
            for fetched in ["fetch(\"http", "src=\"http", "@import", "url(http", "importScripts("] {
                assert!(!text.contains(fetched), "{fetched}");
            }
        }
    }
}
