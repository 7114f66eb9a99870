//! `replay`: the control core over a recording.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use serde_json::json;
use tesaki::node::{Node, Replay};
use tesaki::protocol::codec::Decoder;
use tesaki::protocol::{LogRecord, LogStart};

use crate::args::Options;
use crate::board_session::{hex, version};
use crate::failure::Failure;
use crate::output;

/// What was found so far.
#[derive(Default)]
struct Found {
    start: Option<LogStart>,
    /// Ticks that were compared, all of them identical.
    identical: u64,
    /// Ticks behind a gap or a damaged record, whose state is unknown.
    skipped: u64,
    /// Entries that were lost when the log was recorded.
    gaps: u64,
    /// Gaps since the last record that is none.
    open_gaps: u64,
    /// Whether the board was silent when the recording ended: a gap stands before the end record.
    is_board_lost: bool,
    /// Records that cannot be read.
    damaged: u64,
    /// The last tick that was read, and the last before the first damaged record.
    last_tick: Option<u32>,
    damaged_after: Option<u32>,
    /// The number of ticks in the end record, if the file ends with it.
    end: Option<u32>,
}

impl Found {
    fn take(&mut self, record: &LogRecord, is_identical: bool) {
        (self.end, self.is_board_lost) = (None, false);
        let open_gaps = std::mem::take(&mut self.open_gaps);
        match record {
            LogRecord::End { ticks } => {
                (self.end, self.is_board_lost) = (Some(*ticks), open_gaps > 0);
                // Nothing is missing between two parts of the recording.
                self.gaps -= open_gaps;
            }
            LogRecord::Start(start) => self.start = Some(*start),
            LogRecord::Gap { .. } => {
                self.gaps += 1;
                self.open_gaps = open_gaps + 1;
            }
            LogRecord::Actuators(frame) => {
                self.last_tick = Some(frame.sequence);
                *(if is_identical { &mut self.identical } else { &mut self.skipped }) += 1;
            }
            _ => {}
        }
    }

    /// The damaged records, if there are any.
    fn damage(&self) -> Option<String> {
        let records = output::counted(usize::try_from(self.damaged).unwrap_or(usize::MAX), "damaged record");
        (self.damaged > 0).then(|| format!("{records}, the first {}", after(self.damaged_after)))
    }

    /// What is wrong with the file.
    fn problem(&self) -> Option<String> {
        let Self { identical, skipped, .. } = self;
        let is_cut = self.start.is_some() && self.end.is_none();
        if self.end == Some(0) && self.last_tick.is_none() && self.damaged == 0 {
            return Some("no tick was recorded".to_owned());
        }
        if self.identical == 0 && self.damaged == 0 && !is_cut {
            return Some(
                "no tick could be compared; is this a log of `tesaki record`, or a simulator's frames.log?"
                    .to_owned(),
            );
        }
        if let Some(damage) = self.damage() {
            return Some(format!(
                "{damage}: {skipped} ticks could not be compared, {identical} are identical to the last bit"
            ));
        }
        let read = identical + skipped;
        match self.end {
            Some(ticks) if u64::from(ticks) == read => None,
            Some(ticks) => Some(format!(
                "its end record counts {ticks} ticks, but it has {read}: records were removed or added; \
                 {identical} ticks are identical to the last bit"
            )),
            None => Some(format!(
                "the recording ends without its end record {}: its recorder was killed, or the file was cut; {read} \
                 ticks were read, {identical} of them are identical to the last bit",
                after(self.last_tick)
            )),
        }
    }

    fn text(&self) -> String {
        let origin = self.start.map_or_else(String::new, |start| {
            let image = hex(&start.identity.image, "none");
            format!(" (recorded with firmware {}, image {image})", version(start.identity.firmware))
        });
        let gaps = if self.gaps == 0 {
            String::new()
        } else {
            let gaps = output::counted(usize::try_from(self.gaps).unwrap_or(usize::MAX), "gap");
            format!("; {gaps}, {} ticks behind could not be compared", self.skipped)
        };
        let lost = if self.is_board_lost {
            let last = self.last_tick.map_or_else(String::new, |tick| format!(", after tick {tick}"));
            format!("\nthe board was silent when the recording ended{last}: what it did then is not recorded")
        } else {
            String::new()
        };
        format!("{} ticks identical to the last bit{origin}{gaps}{lost}", self.identical)
    }
}

/// Where in the recording something is.
fn after(tick: Option<u32>) -> String {
    tick.map_or_else(|| "before the first tick".to_owned(), |tick| format!("after tick {tick}"))
}

pub fn run(options: &Options, path: &Path) -> Result<(), Failure> {
    if path.extension().is_some_and(|extension| extension == "mcap") {
        return Err(Failure::Usage(format!(
            "{} is the file for viewers: replay {}",
            path.display(),
            path.with_extension("log").display()
        )));
    }
    let log = PathBuf::from(format!("{}.log", path.display()));
    if !path.exists() && log.exists() {
        return Err(Failure::Usage(format!("{} does not exist: replay {}", path.display(), log.display())));
    }
    let mut file = File::open(path).map_err(Failure::file(path))?;
    let mut node = Box::new(Node::new());
    let mut replay = Replay::new(&mut node);
    let mut decoder = Decoder::new();
    let mut found = Found::default();
    let mut buffer = vec![0; 65_536];
    // A zero ends a record and occurs nowhere else.
    let mut ends_with_record = false;
    loop {
        let length = file.read(&mut buffer).map_err(Failure::file(path))?;
        let Some(last) = buffer[..length].last() else { break };
        ends_with_record = *last == 0;
        let mut bytes = &buffer[..length];
        while decoder.take(&mut bytes) {
            // It is unknown what a damaged record was, so what follows cannot be compared.
            let record = decoder.message::<LogRecord>();
            if record.is_err() {
                if found.damaged == 0 {
                    found.damaged_after = found.last_tick;
                }
                found.damaged += 1;
            }
            let record_or_gap = record.as_ref().unwrap_or(&LogRecord::Gap { missing: 0 });
            let is_identical = replay.feed(record_or_gap).map_err(|error| {
                // What was damaged may be why: a request, or a part of the model.
                let damage = found.damage().map_or_else(String::new, |damage| format!("{damage}; "));
                Failure::Other(format!("{}: {damage}{error}", path.display()))
            })?;
            if let Ok(record) = &record {
                found.take(record, is_identical);
            }
        }
    }
    found.end = found.end.filter(|_| ends_with_record);
    if let Some(problem) = found.problem() {
        return Err(Failure::Other(format!("{}: {problem}", path.display())));
    }
    let Found { identical, skipped, gaps, is_board_lost, start, .. } = &found;
    let value = json!({
        "identical_ticks": identical, "skipped_ticks": skipped, "gaps": gaps, "board_lost": is_board_lost,
        "start": start,
    });
    output::result(options, &value, || found.text())
}
