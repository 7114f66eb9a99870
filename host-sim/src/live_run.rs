//! Shows a run in a browser while it is computed: `cargo sim run SCENARIO --view`.
//!
//! The run stores its results ([`LiveRun`]) and waits for no page, so it is the same with and without pages.
//! A thread sends each page the data that it lacks, at the page's pace: a page reports how much it has, and
//! gets the following data. So a page that is slow, or opened late, misses nothing.

use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};
use tesaki_viewer::server::{Event, Server, Site};
use tesaki_viewer::{Note, Object, RUN_PAGE, SCRIPT, STYLE, Sample, Scene};

use crate::report::Verdict;

/// Interval of the samples that are shown [ticks], as in the replay of a report.
pub const EVERY: usize = 2;
/// The same [s].
const PERIOD: f64 = 0.02;
/// Maximum number of samples in a message: some hundred kilobytes.
const MAX_SAMPLES: usize = 400;
/// Interval at which the pages are served.
const TURN: Duration = Duration::from_millis(10);
/// Path of the report.
const REPORT: &str = "/report/";

static SITE: Site = Site {
    files: &[
        ("/", "text/html; charset=utf-8", RUN_PAGE),
        ("/viewer.js", "text/javascript; charset=utf-8", SCRIPT),
        ("/viewer.css", "text/css; charset=utf-8", STYLE),
    ],
    socket: "/live",
    protocols: &[],
    origins: &[],
    name: "the run",
    choose: ": another program listens there, perhaps another run; choose another port, as in --view=localhost:7482",
};

/// The results of a run so far, shared with the pages.
#[derive(Clone, Debug, Default)]
pub struct LiveRun(Arc<Mutex<Computed>>);

#[derive(Debug, Default)]
struct Computed {
    samples: Vec<Sample>,
    objects: Vec<Object>,
    notes: Vec<Note>,
    end: Option<End>,
    /// Folder of the report.
    report: Option<PathBuf>,
}

/// Result of a run.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "lowercase")]
enum End {
    /// With a report.
    Verdict(Verdict),
    /// With an error.
    Error(String),
}

/// Amounts of data that a page has.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
struct Has {
    samples: usize,
    objects: usize,
    notes: usize,
}

/// First message to a page.
#[derive(Debug, Serialize)]
pub struct About<'a> {
    /// Title of the scenario.
    pub title: &'a str,
    /// Its name.
    pub scenario: &'a str,
    /// Description of the scenario.
    pub about: &'a str,
    /// Where the control core runs.
    pub controller: &'a str,
    /// Seed of the machine.
    pub seed: u64,
    /// The robot.
    pub scene: Scene,
}

impl LiveRun {
    fn computed(&self) -> MutexGuard<'_, Computed> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a sample.
    pub fn sample(&self, sample: Sample) {
        self.computed().samples.push(sample);
    }

    /// Adds a body that exists from now on.
    pub fn object(&self, object: Object) {
        self.computed().objects.push(object);
    }

    /// Adds a note.
    pub fn note(&self, note: Note) {
        self.computed().notes.push(note);
    }

    /// Whether there are samples yet.
    pub fn has_begun(&self) -> bool {
        !self.computed().samples.is_empty()
    }

    /// Ends the run with a report in a folder.
    pub fn end(&self, verdict: Verdict, report: &Path) {
        let mut computed = self.computed();
        (computed.end, computed.report) = (Some(End::Verdict(verdict)), Some(report.to_owned()));
    }

    /// Ends the run with an error.
    pub fn fail(&self, error: &str) {
        self.computed().end = Some(End::Error(error.to_owned()));
    }
}

impl Computed {
    /// Returns the message with the data that a page lacks; `None` if it has everything.
    fn behind(&self, has: Has) -> Option<String> {
        let last = self.samples.len().min(has.samples.saturating_add(MAX_SAMPLES));
        let samples = self.samples.get(has.samples..last).unwrap_or_default();
        let objects = self.objects.get(has.objects..).unwrap_or_default();
        let notes = self.notes.get(has.notes..).unwrap_or_default();
        let end = self.end.as_ref().filter(|_| last == self.samples.len());
        if samples.is_empty() && objects.is_empty() && notes.is_empty() && end.is_none() {
            return None;
        }
        let part = serde_json::json!({
            "kind": "part", "samples": samples, "objects": objects, "notes": notes, "end": end
        });
        Some(part.to_string())
    }
}

/// Serves the pages of a run from a separate thread until the program ends; returns the address.
///
/// # Errors
/// The address is in use, or reachable from other machines.
pub fn serve(address: SocketAddr, about: &About<'_>, run: LiveRun) -> io::Result<SocketAddr> {
    let server = Server::listen(address, &SITE)?;
    let address = server.address();
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    // A page that is left open uses this to detect that another run has taken the address.
    let id = format!("{}-{}", std::process::id(), since.as_nanos());
    let first = serde_json::json!({ "kind": "run", "id": id, "period": PERIOD, "about": about }).to_string();
    std::thread::Builder::new().name("pages".to_owned()).spawn(move || look_after(server, &first, &run))?;
    Ok(address)
}

fn look_after(mut server: Server, first: &str, run: &LiveRun) {
    // Pages that wait for more data.
    let mut waiting: BTreeMap<u64, Has> = BTreeMap::new();
    loop {
        std::thread::sleep(TURN);
        for event in server.turn() {
            match event {
                Event::Opened(id) => server.send(id, first),
                Event::Said(id, text) => {
                    if let Ok(has) = serde_json::from_str(&text) {
                        waiting.insert(id, has);
                    }
                }
                Event::Closed(id) => {
                    waiting.remove(&id);
                }
            }
        }
        let mut computed = run.computed();
        if let Some(report) = computed.report.take() {
            // Files that cannot be read are missing; the page that links to them reports it.
            let _ = server.add_report(REPORT, &report);
        }
        waiting.retain(|&id, has| {
            computed.behind(*has).is_none_or(|part| {
                server.send(id, part);
                false
            })
        });
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::motion::Motion;
    use crate::plant::Truth;
    use crate::report::Summary;

    fn part(run: &LiveRun, has: Has) -> Option<serde_json::Value> {
        run.computed().behind(has).map(|text| serde_json::from_str(&text).unwrap())
    }

    #[test]
    fn a_page_gets_each_sample_once_and_the_end_after_the_last() {
        let run = LiveRun::default();
        assert!(part(&run, Has::default()).is_none(), "there is nothing yet");
        let mut motion = Motion::new(["joint"]).shown_to(Some(&run));
        for tick in 0..1001 {
            motion.tick(&Truth {
                positions: vec![f64::from(tick)],
                velocities: vec![0.0],
                torques: vec![0.0],
                homing_errors: vec![0.0],
            });
            if tick == 700 {
                motion.note("lifted");
            }
        }
        assert_eq!(run.computed().samples.len(), 500, "the last one may still change");
        motion.show_last();
        run.end(Verdict::of(&Summary::new("none", "native", 1)), Path::new("out"));
        let (mut has, mut positions) = (Has::default(), Vec::new());
        let end = loop {
            let part = part(&run, has).unwrap();
            let samples = part["samples"].as_array().unwrap();
            positions.extend(samples.iter().map(|sample| sample["q"][0].as_f64().unwrap()));
            has.samples += samples.len();
            has.notes += part["notes"].as_array().unwrap().len();
            if !part["end"].is_null() {
                break part["end"].clone();
            }
        };
        let expected: Vec<f64> = (0..=500).map(|sample| 2.0 * f64::from(sample)).collect();
        assert_eq!(positions, expected);
        assert_eq!((has.notes, run.computed().notes[0].time), (1, 7.0));
        assert_eq!(end["verdict"]["pass"], false);
        // A page of another run, or a faulty one, asks for data that does not exist.
        let mad = Has { samples: usize::MAX, objects: 9, notes: 9 };
        assert!(part(&run, mad).is_some_and(|part| part["samples"] == serde_json::json!([])));
    }
}
