//! `record`.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde_json::json;
use tesaki::model::RobotModel;
use tesaki::protocol::codec::{MAX_FRAME, checksum, encode};
use tesaki::protocol::{
    EXPORT_CHUNK, FromBoard, Item, LogEntry, LogRecord, LogStart, MODEL_CHUNK, Refusal, Request,
    RequestFrame, SCHEMA_KEY, Stream, Telemetry,
};
use tesaki_description::robot::RobotFolder;
use tesaki_recording::{McapError, McapFile, Recording};
use tesaki_supervisor::faults::{FaultFollower, FaultsBefore, describe};
use tesaki_supervisor::publication::{Publication, STREAMS, require_own};
use tesaki_supervisor::{Board, BoardError, Exported};

use crate::args::{Options, Record};
use crate::board_session::{BoardSession, hex, interrupted, version};
use crate::failure::Failure;
use crate::model::urdf_text;
use crate::output;

/// Period of the lines of JSON, and of requests for streams that have stopped.
const REPORT: Duration = Duration::from_secs(1);
/// Telemetry without entries of the log for this time: the board was reset and streams no log.
const SILENCE: Duration = Duration::from_millis(300);
/// A board that is silent for longer is considered lost.
const GONE: Duration = Duration::from_secs(30);
/// An entry that is farther behind the last one comes from a board that was reset [entries].
const MAX_DELAY: i32 = 100;
/// Maximum number of entries in transit when the state is read.
const MAX_BACKLOG: i32 = 10_000;

pub fn record(options: &Options, args: &Record) -> Result<(), Failure> {
    if args.name.file_name().is_none() || args.name.as_os_str().as_encoded_bytes().ends_with(b"/") {
        return Err(Failure::Usage(format!(
            "{}: it is a folder: give the name of a recording, such as {}",
            args.name.display(),
            args.name.join("recording").display()
        )));
    }
    let interrupted = interrupted()?;
    let mut session = BoardSession::open(options)?;
    let mut recorder = Recorder::create(options, args, &mut session)?;
    let start = Instant::now();
    while !interrupted.load(Ordering::Relaxed)
        && args.duration.is_none_or(|duration| start.elapsed() < duration)
    {
        if let Err(failure) = recorder.step(&mut session) {
            recorder.silent |= matches!(
                failure,
                Failure::Late(_) | Failure::Board(BoardError::Timeout { .. } | BoardError::Link(_))
            );
            // What was recorded until then is whole.
            let _ = recorder.end_log();
            return Err(failure);
        }
    }
    let _ = session.board.set_rate(Stream::Log, 0);
    recorder.finish()
}

/// A recording in progress, in both files.
struct Recorder<'a> {
    options: &'a Options,
    log_path: PathBuf,
    mcap_path: PathBuf,
    log: ReplayLog,
    viewer: Publication<McapFile>,
    /// The present model of the board and its checksum.
    model: Option<(RobotModel, u32)>,
    faults: FaultFollower,
    /// When a line of JSON was last printed.
    reported: Instant,
    /// When the board was last heard.
    heard: Instant,
    /// When the last entry of the log came.
    logged: Instant,
    /// When a silent board last answered the request for its streams.
    asked: Instant,
    /// When the entries were last handed to the operating system.
    flushed: Instant,
    /// When the rate of a stream was last requested.
    requested: Instant,
    last_tick: Option<u32>,
    /// Whether the board is silent, which was told.
    silent: bool,
    /// Of the file that the log has replaced.
    _place_lock: File,
}

/// The files of a recording beside their places, until it has begun: one that cannot begin replaces none.
struct Unfinished {
    places: [PathBuf; 2],
    files: [PathBuf; 2],
    /// Whether there was a log before: else its place is to be empty again.
    replaces: bool,
    is_done: bool,
}

impl Unfinished {
    fn new(places: [&PathBuf; 2], replaces: bool) -> Self {
        // A link stays one.
        let places = places.map(|path| path.canonicalize().unwrap_or_else(|_| path.clone()));
        let files = places.each_ref().map(|path| {
            let name = path.file_name().unwrap_or_default().display();
            path.with_file_name(format!(".{name}.{}.tmp", std::process::id()))
        });
        Self { places, files, replaces, is_done: false }
    }

    /// Puts the files in their places; the one for viewers first, because it can be made again.
    fn finish(mut self) -> Result<(), Failure> {
        for (file, place) in self.files.iter().zip(&self.places).rev() {
            std::fs::rename(file, place).map_err(Failure::file(place))?;
        }
        self.is_done = true;
        Ok(())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        if self.is_done {
            return;
        }
        let place = (!self.replaces).then_some(&self.places[0]);
        for file in self.files.iter().chain(place) {
            let _ = std::fs::remove_file(file);
        }
    }
}

impl<'a> Recorder<'a> {
    fn create(options: &'a Options, args: &Record, session: &mut BoardSession) -> Result<Self, Failure> {
        let model = session.model()?;
        let robot = args.robot.as_deref().map(RobotFolder::load).transpose()?;
        require_own(robot.as_ref(), &model)?;
        let urdf = robot.as_ref().map(urdf_text).transpose()?;
        let [log_path, mcap_path] = ["log", "mcap"].map(|extension| with_extension(&args.name, extension));
        if !args.force
            && let Some(path) = [&log_path, &mcap_path].into_iter().find(|path| path.exists())
        {
            return Err(Failure::Usage(format!(
                "{} exists: name another recording (`tesaki record NAME`), or replace it with --force",
                path.display()
            )));
        }
        // A device or a pipe is not replaced by a file.
        let is_other = |path: &&PathBuf| std::fs::metadata(path).is_ok_and(|place| !place.is_file());
        if let Some(path) = [&log_path, &mcap_path].into_iter().find(is_other) {
            return Err(Failure::Usage(format!("{} is no file: name another recording", path.display())));
        }
        let replaces = log_path.exists();
        let place_lock = lock(&log_path)?;
        let unfinished = Unfinished::new([&log_path, &mcap_path], replaces);
        let [log_file, mcap_file] = &unfinished.files;
        let log_file = lock(log_file)?;
        log_file.set_len(0).map_err(Failure::file(&log_path))?;
        let metadata = BTreeMap::from([
            ("robot".to_owned(), model.name.to_string()),
            ("firmware".to_owned(), version(session.identity.firmware)),
            ("image".to_owned(), hex(&session.identity.image, "none")),
            ("board".to_owned(), hex(&session.identity.board, "none")),
        ]);
        let mut recording =
            Recording::create_compressed(mcap_file, urdf.as_deref()).map_err(mcap_failure(&mcap_path))?;
        recording.metadata("tesaki", metadata).map_err(mcap_failure(&mcap_path))?;
        let viewer = Publication::new(recording, robot);
        let faults = FaultFollower::new(FaultsBefore::from(&session.board.status()?.node));
        // Before the log starts: what comes meanwhile is dropped.
        for &(stream, every) in STREAMS {
            session.board.set_rate(stream, every)?;
        }
        let mut log = ReplayLog::new(log_file);
        log.begin(session).map_err(log_failure(&log_path))?;
        unfinished.finish()?;
        let (log_file, mcap_file) = (log_path.display(), mcap_path.display());
        let notice = format!("recording {} to {log_file} and {mcap_file}; Ctrl-C stops", model.name);
        output::notice(options, &notice);
        let now = Instant::now();
        Ok(Self {
            options,
            log_path,
            mcap_path,
            model: log.model.clone(),
            log,
            viewer,
            faults,
            reported: now,
            heard: now,
            logged: now,
            asked: now,
            flushed: now,
            requested: now,
            last_tick: None,
            silent: false,
            _place_lock: place_lock,
        })
    }

    /// Takes the next event, if one comes within 50 ms.
    fn step(&mut self, session: &mut BoardSession) -> Result<(), Failure> {
        let event = session.board.next_event(Instant::now() + Duration::from_millis(50))?;
        let now = Instant::now();
        match event {
            Some(FromBoard::Log(entry)) => {
                (self.heard, self.logged) = (now, now);
                self.log.entry(session, entry).map_err(log_failure(&self.log_path))?;
            }
            Some(FromBoard::Telemetry(telemetry)) => {
                self.heard = now;
                self.telemetry(session, &telemetry)?;
            }
            Some(FromBoard::Tips(tips)) => {
                self.viewer.tips(&tips).map_err(mcap_failure(&self.mcap_path))?;
            }
            Some(FromBoard::Task(task)) => {
                self.viewer.task(&task).map_err(mcap_failure(&self.mcap_path))?;
            }
            Some(FromBoard::Status(status)) => {
                session.board.update_model(&mut self.model, &status)?;
                self.viewer.status(&status).map_err(mcap_failure(&self.mcap_path))?;
            }
            Some(FromBoard::Reply(_)) | None => {}
        }
        self.tell_silence(now);
        if now - self.heard > GONE {
            return Err(Failure::Late(format!(
                "no data from the board for {} s; the recording up to then is in {}",
                GONE.as_secs(),
                self.log_path.display()
            )));
        }
        if now - self.heard.max(self.asked) > REPORT
            && session.board.reconnect(&[&[(Stream::Log, 1)], STREAMS].concat())?
        {
            self.asked = now;
            self.log.gap(session, 0).map_err(log_failure(&self.log_path))?;
        }
        // A process that is killed loses one second at most.
        if now - self.flushed > REPORT {
            self.flushed = now;
            self.log.file.flush().map_err(Failure::file(&self.log_path))?;
        }
        if self.options.json && now - self.reported > REPORT {
            self.reported = now;
            let ReplayLog { ticks, gaps, lost, .. } = self.log;
            output::line(&json!({ "ticks": ticks, "gaps": gaps, "lost": lost }).to_string())?;
        }
        Ok(())
    }

    /// Says once that the board is silent, and once that it is heard again.
    fn tell_silence(&mut self, now: Instant) {
        let silent = now - self.heard > self.options.timeout;
        if silent && !self.silent {
            output::complain(&format!(
                "no data from the board for {} s; the recording ends when it is silent for {} s",
                self.options.timeout.as_secs_f64(),
                GONE.as_secs()
            ));
        } else if self.silent && !silent {
            output::complain("the board is heard again");
        }
        self.silent = silent;
    }

    fn telemetry(&mut self, session: &mut BoardSession, telemetry: &Telemetry) -> Result<(), Failure> {
        let Self { model, viewer, faults, mcap_path, .. } = self;
        viewer.use_model(model.as_ref().map(|(model, checksum)| (model, *checksum)));
        if faults.is_due(telemetry) {
            // If no answer comes, they are asked for again with the next telemetry.
            let read = answered(session.board.faults())?;
            for fault in read.iter().flat_map(|read| faults.take(telemetry, read)) {
                let text = describe(fault, model.as_ref().map(|(model, _)| model));
                viewer.fault(telemetry.tick, &text).map_err(mcap_failure(mcap_path))?;
                output::notice(self.options, &text);
            }
        }
        viewer.telemetry(telemetry).map_err(mcap_failure(mcap_path))?;
        // The board was reset, or what shares it has started again: others may have asked since.
        let last = self.last_tick.replace(telemetry.tick);
        let step = last.map_or(1, |last| telemetry.tick.wrapping_sub(last));
        let now = Instant::now();
        if step > 1 && now - self.requested > REPORT {
            self.requested = now;
            answered(session.board.set_rate(Stream::Telemetry, 1))?;
        }
        // The same, when others have asked for telemetry alone.
        if now - self.logged > SILENCE && now - self.requested > SILENCE {
            self.requested = now;
            answered(session.board.set_rate(Stream::Log, 1))?;
        }
        Ok(())
    }

    /// Ends the log. A gap before the end record says that the board was silent.
    fn end_log(&mut self) -> std::io::Result<()> {
        if self.silent {
            self.log.write(&LogRecord::Gap { missing: 0 })?;
        }
        self.log.end()
    }

    fn finish(mut self) -> Result<(), Failure> {
        self.end_log().map_err(Failure::file(&self.log_path))?;
        self.viewer.publisher.finish().map_err(mcap_failure(&self.mcap_path))?;
        let ReplayLog { ticks, gaps, lost, .. } = self.log;
        let (log_path, mcap_path) = (&self.log_path, &self.mcap_path);
        let value = json!({
            "log": log_path.display().to_string(),
            "mcap": mcap_path.display().to_string(),
            "ticks": ticks,
            "gaps": gaps,
            "lost": lost,
            "board_lost": self.silent,
        });
        output::result(self.options, &value, || {
            let gaps = output::counted(usize::try_from(gaps).unwrap_or(usize::MAX), "gap");
            let silent = if self.silent { "; the board was silent at the end" } else { "" };
            format!(
                "{ticks} ticks recorded, {gaps}, {lost} entries lost on the line{silent}\n{}: for `tesaki replay`\n{}: for \
                 Foxglove, PlotJuggler or Rerun",
                log_path.display(),
                mcap_path.display()
            )
        })
    }
}

/// The answer of a board; `None` if there was none, which may pass.
fn answered<T>(answer: Result<T, BoardError>) -> Result<Option<T>, Failure> {
    match answer {
        Err(error) if error.passes() => Ok(None),
        answer => Ok(Some(answer?)),
    }
}

/// Opens the file for this recorder alone, as long as it is open.
fn lock(path: &Path) -> Result<File, Failure> {
    let file = OpenOptions::new().write(true).create(true).truncate(false).open(path);
    let file = file.map_err(Failure::written(path))?;
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            return Err(Failure::Usage(format!(
                "{} is being written by another `tesaki record`: end that one, or name another recording",
                path.display()
            )));
        }
        // A file system without locks.
        Err(TryLockError::Error(_)) => {}
    }
    Ok(file)
}

/// `name` with `.log` or `.mcap`; the point of `run.2` belongs to the name.
fn with_extension(name: &Path, extension: &str) -> PathBuf {
    let named = name.extension().is_some_and(|found| found == "log" || found == "mcap");
    let mut path = if named { name.with_extension("") } else { name.to_owned() }.into_os_string();
    path.push(".");
    path.push(extension);
    path.into()
}

fn mcap_failure(path: &Path) -> impl FnOnce(McapError) -> Failure + '_ {
    move |error| match error {
        // It names the path.
        McapError::Create { .. } => Failure::Other(error.to_string()),
        _ => Failure::Other(format!("{}: {error}; what came before is kept", path.display())),
    }
}

/// Distinguishes errors of the file from errors of the board.
fn log_failure(path: &Path) -> impl FnOnce(LogError) -> Failure + '_ {
    move |error| match error {
        LogError::File(source) => Failure::file(path)(source),
        LogError::Board(error) => error.into(),
    }
}

#[derive(Debug, thiserror::Error)]
enum LogError {
    #[error(transparent)]
    File(#[from] std::io::Error),
    #[error(transparent)]
    Board(#[from] BoardError),
}

/// The file for `tesaki replay`.
struct ReplayLog {
    file: BufWriter<File>,
    /// The model in the file and its checksum.
    model: Option<(RobotModel, u32)>,
    /// Index of the last entry.
    last: u32,
    /// Whether entries have come since the state was written.
    in_step: bool,
    /// Whether a model began to be sent since then.
    has_model_begin: bool,
    ticks: u64,
    gaps: u64,
    lost: u64,
    /// Of those, the ones in the gap that is still open: after it no state was written yet.
    lost_in_gap: u32,
}

impl ReplayLog {
    fn new(file: File) -> Self {
        let file = BufWriter::new(file);
        let (in_step, has_model_begin) = (false, false);
        Self {
            file,
            model: None,
            last: 0,
            in_step,
            has_model_begin,
            ticks: 0,
            gaps: 0,
            lost: 0,
            lost_in_gap: 0,
        }
    }

    /// Writes all that a replay needs to start from a node as after power-on: the origin of the recording,
    /// the model, if there is one, and the state.
    fn begin(&mut self, session: &mut BoardSession) -> Result<(), LogError> {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let (identity, unix_time) = (session.identity, since.as_secs());
        self.write(&LogRecord::Start(LogStart { schema: SCHEMA_KEY, identity, unix_time }))?;
        self.model = None;
        match session.board.export(Item::Model) {
            Ok(model) => self.push(&model.bytes)?,
            Err(BoardError::Refused { refusal: Refusal::NoModel, .. }) => {}
            Err(error) => return Err(error.into()),
        }
        session.board.set_rate(Stream::Log, 1)?;
        let state = session.board.export(Item::State)?;
        self.state(&state)
    }

    /// Writes the encoded model.
    fn push(&mut self, model: &[u8]) -> Result<(), LogError> {
        self.model = Some((postcard::from_bytes(model).map_err(BoardError::from)?, checksum(model)));
        // As the requests of a separate client; the state that follows does not contain that client.
        let mut sequence = 0;
        let mut request = |request| {
            sequence += 1;
            LogRecord::Request(RequestFrame { client: 0, sequence, request })
        };
        let length = u32::try_from(model.len()).unwrap_or(u32::MAX);
        let begin = Request::ModelBegin { length, checksum: checksum(model) };
        let mut records = vec![
            request(Request::Hello { schema: SCHEMA_KEY }),
            request(Request::TakeCommand { by_force: true }),
            request(begin),
        ];
        for (offset, data) in (0..).step_by(MODEL_CHUNK).zip(model.chunks(MODEL_CHUNK)) {
            let data = heapless::Vec::from_slice(data).unwrap_or_default();
            records.push(request(Request::ModelChunk { offset, data }));
        }
        records.push(request(Request::ModelCommit));
        for record in &records {
            self.write(record)?;
        }
        Ok(())
    }

    /// Entries are missing, or the board was reset: to replay what follows, its state is needed, and its
    /// model if that has changed.
    fn gap(&mut self, session: &mut BoardSession, missing: u32) -> Result<(), LogError> {
        self.gaps += 1;
        let known = self.model.as_ref().map_or(0, |(_, checksum)| *checksum);
        let same = session.board.status().map(|status| status.node.model_checksum == known);
        let state = match same {
            Ok(true) => session.board.export(Item::State).map(Some),
            Ok(false) => Ok(None),
            Err(error) => Err(error),
        };
        // The entries up to the state are missing, too, if the board was not reset.
        let to_state =
            state.as_ref().ok().and_then(|state| Some(state.as_ref()?.index.wrapping_sub(self.last)));
        let to_state = to_state.filter(|missing| missing.cast_signed() > 0).unwrap_or(0);
        let missing = self.lose(missing.max(to_state));
        self.write(&LogRecord::Gap { missing })?;
        match state.map_err(LogError::from).and_then(|state| match state {
            Some(state) => self.state(&state),
            None => self.begin(session),
        }) {
            // The next entry, if one comes, reveals the gap again.
            Err(LogError::Board(error)) if error.passes() => Ok(()),
            other => other,
        }
    }

    /// Counts the entries that are missing in the open gap; returns how many of them were not counted before.
    fn lose(&mut self, missing: u32) -> u32 {
        let new = missing.saturating_sub(self.lost_in_gap);
        self.lost_in_gap += new;
        self.lost += u64::from(new);
        new
    }

    /// Writes a state of the node. Older entries that still arrive are skipped.
    fn state(&mut self, state: &Exported) -> Result<(), LogError> {
        let Exported { bytes: state, index, key } = state;
        for (offset, data) in (0..).step_by(EXPORT_CHUNK).zip(state.chunks(EXPORT_CHUNK)) {
            let data = heapless::Vec::from_slice(data).unwrap_or_default();
            self.write(&LogRecord::State { offset, data })?;
        }
        let length = u32::try_from(state.len()).unwrap_or(u32::MAX);
        self.write(&LogRecord::Restore { length, checksum: checksum(state), key: *key })?;
        (self.last, self.in_step, self.lost_in_gap) = (*index, false, 0);
        self.has_model_begin = false;
        Ok(())
    }

    fn entry(&mut self, session: &mut BoardSession, entry: LogEntry) -> Result<(), LogError> {
        let step = entry.index.wrapping_sub(self.last).cast_signed();
        // Older than the state, or duplicated or delayed by the line.
        let old = step <= 0 && step > if self.in_step { -MAX_DELAY } else { -MAX_BACKLOG };
        if old {
            return Ok(());
        }
        if step != 1 {
            return self.gap(session, u32::try_from(step - 1).unwrap_or(0));
        }
        (self.last, self.in_step) = (entry.index, true);
        if let LogRecord::Request(RequestFrame { request, .. }) = &entry.record {
            self.has_model_begin |= matches!(request, Request::ModelBegin { .. });
            // What was sent of this model before the state is not in the file.
            if matches!(request, Request::ModelCommit) && !self.has_model_begin {
                return self.gap(session, 1);
            }
        }
        self.ticks += u64::from(matches!(entry.record, LogRecord::Actuators(_)));
        Ok(self.write(&entry.record)?)
    }

    fn end(&mut self) -> std::io::Result<()> {
        self.write(&LogRecord::End { ticks: u32::try_from(self.ticks).unwrap_or(u32::MAX) })?;
        self.file.flush()
    }

    fn write(&mut self, record: &LogRecord) -> std::io::Result<()> {
        let mut frame = [0; MAX_FRAME];
        let length = encode(record, &mut frame).map_err(std::io::Error::other)?;
        self.file.write_all(&frame[..length])
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn an_entry_that_is_missing_in_a_gap_is_lost_once() {
        let mut log = ReplayLog::new(tempfile::tempfile().unwrap());
        // The state cannot be read, and the next entries reveal the gap again.
        let new: Vec<u32> = [3, 4, 4, 9].map(|missing| log.lose(missing)).into();
        assert_eq!((new, log.lost), (vec![3, 1, 0, 5], 9));
    }
}
