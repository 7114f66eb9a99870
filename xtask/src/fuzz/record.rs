//! The record of fuzzing, and its table in the documents.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};

use super::coverage::Part;

/// File of the record.
pub const FILE: &str = "docs/fuzzing.json";
/// The page with the table, and the markers around it.
const DOCUMENT: &str = "docs/measurements.md";
const BEGIN: &str = "<!-- fuzz:begin -->\n";
const END: &str = "<!-- fuzz:end -->";

/// Result of one run of a target.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Session {
    /// The commit that was fuzzed.
    pub commit: String,
    /// Core time of the fuzzer [s].
    pub seconds: u64,
    /// Number of inputs that were run.
    pub executions: u64,
}

/// Result of a target: its runs, each of which began with the inputs kept by the earlier ones, and the
/// coverage of the last one.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Run {
    /// The runs, the latest at the end; those of one commit are combined.
    pub sessions: Vec<Session>,
    /// Number of inputs that are kept, and their size.
    pub inputs: u64,
    pub bytes: u64,
    /// Edges of the project's code: covered, and in the program.
    pub edges: Part,
    /// Functions of the project's code: covered, and in the program.
    pub functions: Part,
    /// Functions of the modules that the target tests: covered, and in the program.
    pub of_target: Part,
    /// Number of inputs that crashed it.
    pub crashes: u64,
}

impl fmt::Display for Run {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { inputs, bytes, edges, functions, of_target, crashes, .. } = self;
        let [seconds, executions] = self.totals();
        let rate = executions / seconds.max(1);
        write!(f, "{executions} executions in {seconds} s ({rate}/s), {crashes} crashes")?;
        if *crashes > 0 {
            return Ok(());
        }
        write!(
            f,
            "; covered: {} of the functions it is about, {} of all in the program, {} edges; {inputs} inputs of {bytes} \
             bytes cover that",
            part(*of_target),
            part(*functions),
            part(*edges)
        )
    }
}

impl Run {
    /// Total time [s] and executions of all sessions.
    fn totals(&self) -> [u64; 2] {
        self.sessions.iter().fold([0; 2], |[seconds, executions], session| {
            [seconds + session.seconds, executions + session.executions]
        })
    }

    /// Returns the result after a further run: the sessions of both.
    fn followed_by(&self, next: Self) -> Self {
        let mut sessions = self.sessions.clone();
        for session in next.sessions {
            match sessions.last_mut().filter(|last| last.commit == session.commit) {
                Some(last) => {
                    last.seconds += session.seconds;
                    last.executions += session.executions;
                }
                None => sessions.push(session),
            }
        }
        Self { sessions, ..next }
    }
}

fn part([covered, all]: Part) -> String {
    format!("{covered} of {all}")
}

/// The results by target.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Record(BTreeMap<String, Run>);

impl Record {
    /// Reads the record; empty if there is none.
    ///
    /// # Errors
    /// When the file cannot be read, or holds something else.
    pub fn load() -> Result<Self> {
        if !Path::new(FILE).exists() {
            return Ok(Self::default());
        }
        let text = std::fs::read_to_string(FILE).context(FILE)?;
        serde_json::from_str(&text).context(FILE)
    }

    /// Adds a further run of a target.
    pub fn with(mut self, target: &str, run: Run) -> Self {
        let run = match self.0.get(target) {
            Some(before) => before.followed_by(run),
            None => run,
        };
        self.0.insert(target.to_owned(), run);
        self
    }

    /// Writes the record and its table.
    ///
    /// # Errors
    /// When a file cannot be written, or the document has no place for the table.
    pub fn save(&self) -> Result<()> {
        std::fs::write(FILE, serde_json::to_string_pretty(self)? + "\n").context(FILE)?;
        let text = std::fs::read_to_string(DOCUMENT).context(DOCUMENT)?;
        std::fs::write(DOCUMENT, replace(&text, &self.table())?).context(DOCUMENT)
    }

    /// Checks the table in the document.
    ///
    /// # Errors
    /// When the table differs, or the document has no place for it.
    pub fn check(&self) -> Result<()> {
        let text = std::fs::read_to_string(DOCUMENT).context(DOCUMENT)?;
        ensure!(
            replace(&text, &self.table())? == text,
            "{DOCUMENT}: the table of fuzzing differs from {FILE}; `cargo xtask fuzz --record` writes both"
        );
        Ok(())
    }

    fn table(&self) -> String {
        let mut table = "\n| target | time | of it, by commit | executions | functions it is about | edges of the project | kept inputs | \
             crashes |\n|---|---|---|---|---|---|---|---|\n"
            .to_owned();
        for (name, run) in &self.0 {
            let Run { sessions, inputs, bytes, edges, of_target, crashes, .. } = run;
            let [seconds, executions] = run.totals();
            let commits =
                sessions.iter().map(|Session { commit, seconds, .. }| format!("{commit} {seconds} s"));
            let commits = commits.collect::<Vec<_>>().join(", ");
            let size = bytes.div_ceil(1000);
            table += &format!(
                "| `{name}` | {seconds} s | {commits} | {executions} | {} | {} | {inputs}, {size} kB | {crashes} |\n",
                part(*of_target),
                part(*edges)
            );
        }
        table + "\n"
    }
}

/// Returns the text with `table` between the markers.
fn replace(text: &str, table: &str) -> Result<String> {
    let (head, rest) = text.split_once(BEGIN).with_context(|| format!("{DOCUMENT} has no {BEGIN}"))?;
    let (_, tail) = rest.split_once(END).with_context(|| format!("{DOCUMENT} has no {END}"))?;
    Ok(format!("{head}{BEGIN}{table}{END}{tail}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_by_hand() {
        let run = |commit: &str, seconds, bytes| {
            let session = Session { commit: commit.into(), seconds, executions: 7 };
            Run { sessions: vec![session], bytes, ..Run::default() }
        };
        let record = Record::default().with("node", run("0123abc", 60, 3000));
        let record = record.with("node", run("0123abc", 30, 2000)).with("node", run("4567def", 10, 1001));
        let text = "head\n<!-- fuzz:begin -->\nold\n<!-- fuzz:end -->\ntail\n";
        let after = replace(text, &record.table()).expect("the markers are there");
        let row = "| `node` | 100 s | 0123abc 90 s, 4567def 10 s | 21 | 0 of 0 | 0 of 0 | 0, 2 kB | 0 |\n\n<!-- fuzz:end -->\ntail\n";
        assert!(
            after.starts_with("head\n<!-- fuzz:begin -->\n\n| target") && after.ends_with(row),
            "{after}"
        );
        assert!(replace("head", "").is_err());
    }
}
