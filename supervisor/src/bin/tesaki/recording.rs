//! `record` and `replay`.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde_json::json;
use tesaki::model::RobotModel;
use tesaki::node::{Node, Replay};
use tesaki::protocol::codec::{Decoder, MAX_FRAME, checksum, encode};
use tesaki::protocol::{
    EXPORT_CHUNK, FromBoard, Item, LogEntry, LogRecord, LogStart, MODEL_CHUNK, Refusal, Request,
    RequestFrame, SCHEMA_KEY, Stream, Telemetry,
};
use tesaki_description::robot::RobotFolder;
use tesaki_recording::{LogLevel, McapError, Recording};
use tesaki_supervisor::{Board, BoardError};

use crate::args::{Options, Record};
use crate::board_session::{BoardSession, hex, interrupted, version, words};
use crate::failure::Failure;
use crate::output;

/// A control period [ns].
const TICK: u64 = 10_000_000;
/// From one line of JSON to the next.
const REPORT: Duration = Duration::from_secs(1);
/// A board that is silent for longer has gone.
const GONE: Duration = Duration::from_secs(30);
/// An entry that is farther behind the last one comes from a board that was reset.
const DELAYED: i32 = 100;
/// So many entries may be on the way when the state is read.
const BACKLOG: i32 = 10_000;

pub fn record(options: &Options, record: &Record) -> Result<(), Failure> {
    let interrupted = interrupted()?;
    let mut session = BoardSession::open(options)?;
    let model = session.model()?;
    let robot = record.robot.as_deref().map(RobotFolder::load).transpose()?;
    let urdf = robot.as_ref().map(|robot| std::fs::read_to_string(robot.path.join("robot.urdf")));
    let urdf = urdf.transpose().map_err(Failure::file("robot.urdf"))?;
    let log_path = record.name.with_extension("log");
    let mcap_path = record.name.with_extension("mcap");

    let about = BTreeMap::from([
        ("robot".to_owned(), model.name.to_string()),
        ("firmware".to_owned(), version(session.identity.firmware)),
        ("image".to_owned(), hex(&session.identity.image, "none")),
        ("board".to_owned(), hex(&session.identity.board, "none")),
    ]);
    let mcap_failure = |error: McapError| Failure::Other(format!("{}: {error}", mcap_path.display()));
    let mut recording = Recording::create(&mcap_path, urdf.as_deref()).map_err(mcap_failure)?;
    recording.metadata("tesaki", about).map_err(mcap_failure)?;
    let mut viewer = Viewer { recording, epoch: None, faults: session.board.faults()?.total };
    let file = File::create(&log_path).map_err(Failure::file(&log_path))?;
    let mut log =
        Log { file: BufWriter::new(file), model: None, last: 0, in_step: false, ticks: 0, gaps: 0, lost: 0 };
    log.begin(&mut session).map_err(log_failure(&log_path))?;
    session.board.set_rate(Stream::Telemetry, 1)?;
    output::notice(
        options,
        &format!(
            "recording {} to {} and {}; Ctrl-C ends",
            model.name,
            log_path.display(),
            mcap_path.display()
        ),
    );

    let start = Instant::now();
    let (mut reported, mut heard, mut asked) = (start, start, start);
    let mut last_tick = None;
    while !interrupted.load(Ordering::Relaxed)
        && record.duration.is_none_or(|duration| start.elapsed() < duration)
    {
        let event = session.board.next_event(Instant::now() + Duration::from_millis(50))?;
        let now = Instant::now();
        match event {
            Some(FromBoard::Log(entry)) => {
                heard = now;
                log.entry(&mut session, entry).map_err(log_failure(&log_path))?;
            }
            Some(FromBoard::Telemetry(telemetry)) => {
                heard = now;
                if telemetry.faults != viewer.faults {
                    viewer.faults = telemetry.faults;
                    let fault = session.board.faults()?.faults.last().copied();
                    let text = fault.map_or_else(String::new, |fault| words(&fault, log.robot()));
                    viewer.fault(&telemetry, &text).map_err(mcap_failure)?;
                    output::notice(options, &text);
                }
                viewer.telemetry(&telemetry, log.robot()).map_err(mcap_failure)?;
                // Rates are the board's, not ours: another program may have lowered this one.
                let step =
                    last_tick.replace(telemetry.tick).map_or(1, |last| telemetry.tick.wrapping_sub(last));
                if step > 1 && now - asked > REPORT {
                    asked = now;
                    session.board.set_rate(Stream::Telemetry, 1)?;
                }
            }
            _ => {}
        }
        if now - heard > GONE {
            return Err(Failure::Late(format!(
                "nothing came from the board for {} s; what came before is in {}",
                GONE.as_secs(),
                log_path.display()
            )));
        }
        if now - heard > REPORT && session.revive(&[(Stream::Log, 1), (Stream::Telemetry, 1)])? {
            session.board.set_timeout(options.timeout);
            log.gap(&mut session, 0).map_err(log_failure(&log_path))?;
        }
        if options.json && now - reported > REPORT {
            reported = now;
            output::line(&json!({ "ticks": log.ticks, "gaps": log.gaps, "lost": log.lost }).to_string())?;
        }
    }
    let _ = session.board.set_rate(Stream::Log, 0);
    log.file.flush().map_err(Failure::file(&log_path))?;
    viewer.recording.finish().map_err(mcap_failure)?;
    let value =
        json!({ "log": log_path, "mcap": mcap_path, "ticks": log.ticks, "gaps": log.gaps, "lost": log.lost });
    output::result(options, &value, || {
        format!(
            "{} ticks recorded, {} gaps, {} entries lost on the line\n{}: try `tesaki replay {}`\n{}: for Foxglove, PlotJuggler or Rerun",
            log.ticks,
            log.gaps,
            log.lost,
            log_path.display(),
            log_path.display(),
            mcap_path.display()
        )
    })
}

/// Tells trouble with the file from trouble with the board.
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

/// The file from which the run can be repeated.
struct Log {
    file: BufWriter<File>,
    /// The model in the file and its checksum.
    model: Option<(RobotModel, u32)>,
    /// Index of the last entry.
    last: u32,
    /// Whether entries have come since the state was written.
    in_step: bool,
    ticks: u64,
    gaps: u64,
    lost: u64,
}

impl Log {
    /// What made the recording, the model if there is one, the state: all that a node needs that is as after
    /// power-on.
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
        self.state(session)
    }

    /// The model, in its encoding.
    fn push(&mut self, model: &[u8]) -> Result<(), LogError> {
        self.model = Some((postcard::from_bytes(model).map_err(BoardError::from)?, checksum(model)));
        // As a client of its own would have sent it; the state that follows knows nothing of that client.
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

    fn robot(&self) -> Option<&RobotModel> {
        self.model.as_ref().map(|(robot, _)| robot)
    }

    /// Entries are missing, or the board was reset: what follows cannot be repeated without its state, and
    /// its model when that is another.
    fn gap(&mut self, session: &mut BoardSession, missing: u32) -> Result<(), LogError> {
        self.gaps += 1;
        self.lost += u64::from(missing);
        self.write(&LogRecord::Gap { missing })?;
        let mut go_on = || {
            let known = self.model.as_ref().map_or(0, |(_, checksum)| *checksum);
            if session.board.status()?.node.model_checksum == known {
                self.state(session)
            } else {
                self.begin(session)
            }
        };
        match go_on() {
            // The next entry, when there is one, shows the gap again.
            Err(LogError::Board(BoardError::Timeout { .. })) => Ok(()),
            other => other,
        }
    }

    /// The state of the node now. Entries from before it that are still to come will be left out.
    fn state(&mut self, session: &mut BoardSession) -> Result<(), LogError> {
        let tesaki_supervisor::Exported { bytes: state, index, key } = session.board.export(Item::State)?;
        for (offset, data) in (0..).step_by(EXPORT_CHUNK).zip(state.chunks(EXPORT_CHUNK)) {
            let data = heapless::Vec::from_slice(data).unwrap_or_default();
            self.write(&LogRecord::State { offset, data })?;
        }
        let length = u32::try_from(state.len()).unwrap_or(u32::MAX);
        self.write(&LogRecord::Restore { length, checksum: checksum(&state), key })?;
        (self.last, self.in_step) = (index, false);
        Ok(())
    }

    fn entry(&mut self, session: &mut BoardSession, entry: LogEntry) -> Result<(), LogError> {
        let step = entry.index.wrapping_sub(self.last).cast_signed();
        // From before the state; or the line doubled or delayed it.
        let old = step <= 0 && step > if self.in_step { -DELAYED } else { -BACKLOG };
        if old {
            return Ok(());
        }
        if step != 1 {
            return self.gap(session, u32::try_from(step - 1).unwrap_or(0));
        }
        (self.last, self.in_step) = (entry.index, true);
        self.ticks += u64::from(matches!(entry.record, LogRecord::Actuators(_)));
        self.write(&entry.record)
    }

    fn write(&mut self, record: &LogRecord) -> Result<(), LogError> {
        let mut frame = [0; MAX_FRAME];
        let length = encode(record, &mut frame).map_err(std::io::Error::other)?;
        Ok(self.file.write_all(&frame[..length])?)
    }
}

/// The file for viewers.
struct Viewer {
    recording: Recording,
    /// When tick 0 was [ns since 1970].
    epoch: Option<u64>,
    faults: u32,
}

impl Viewer {
    fn time(&mut self, telemetry: &Telemetry) -> u64 {
        let since_start = u64::from(telemetry.tick) * TICK;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let now = u64::try_from(now.as_nanos()).unwrap_or(u64::MAX);
        *self.epoch.get_or_insert(now.saturating_sub(since_start)) + since_start
    }

    fn telemetry(&mut self, telemetry: &Telemetry, robot: Option<&RobotModel>) -> Result<(), McapError> {
        let time = self.time(telemetry);
        let joints = robot.map_or(&[][..], |robot| &robot.joints);
        if joints.len() != telemetry.joints.len() {
            return Ok(()); // the board has just got another model
        }
        let names: Vec<String> = joints.iter().map(|joint| joint.name.to_string()).collect();
        let list = |value: fn(&tesaki::protocol::JointTelemetry) -> f32| -> Vec<f64> {
            telemetry.joints.iter().map(|joint| f64::from(value(joint))).collect()
        };
        let (position, velocity, effort) =
            (list(|joint| joint.position), list(|joint| joint.velocity), list(|joint| joint.torque));
        self.recording.joint_states(time, &names, &position, &velocity, &effort)?;
        self.recording.references(time, &names, &list(|joint| joint.reference), &[], &[])
    }

    fn fault(&mut self, telemetry: &Telemetry, text: &str) -> Result<(), McapError> {
        let time = self.time(telemetry);
        self.recording.log(time, LogLevel::Error, "board", text)
    }
}

pub fn replay(options: &Options, path: &Path) -> Result<(), Failure> {
    let mut file = File::open(path).map_err(Failure::file(path))?;
    let mut node = Box::new(Node::new());
    let mut replay = Replay::new(&mut node);
    let mut decoder = Decoder::new();
    let (mut ticks, mut gaps, mut damaged) = (0_u64, 0_u64, 0_u64);
    let mut start = None;
    let mut buffer = vec![0; 65_536];
    loop {
        let length = file.read(&mut buffer).map_err(Failure::file(path))?;
        if length == 0 {
            break;
        }
        let mut bytes = &buffer[..length];
        while decoder.take(&mut bytes) {
            let record = match decoder.message::<LogRecord>() {
                Ok(record) => record,
                Err(_) => {
                    damaged += 1;
                    // What was lost is unknown, so what follows cannot be compared.
                    LogRecord::Gap { missing: 0 }
                }
            };
            match &record {
                LogRecord::Start(made) => start = Some(*made),
                LogRecord::Gap { .. } => gaps += 1,
                _ => {}
            }
            let same = replay
                .feed(&record)
                .map_err(|error| Failure::Other(format!("{}: {error}", path.display())))?;
            ticks += u64::from(same);
        }
    }
    if ticks == 0 {
        return Err(Failure::Other(format!(
            "{}: no tick could be compared; is this a recording of `tesaki record` or a simulator's frames.log?",
            path.display()
        )));
    }
    let value = json!({ "identical_ticks": ticks, "gaps": gaps, "damaged_frames": damaged, "start": start });
    output::result(options, &value, || {
        let made = start.map_or_else(String::new, |start| {
            let image = hex(&start.identity.image, "none");
            format!(" (recorded with firmware {}, image {image})", version(start.identity.firmware))
        });
        let gaps =
            if gaps == 0 { String::new() } else { format!("; {gaps} gaps, {damaged} damaged entries") };
        format!("{ticks} ticks identical, to the last bit{made}{gaps}")
    })
}
