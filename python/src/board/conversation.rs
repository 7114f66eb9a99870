//! The link to a board: requests, keeping it enabled, its faults.

use std::time::{Duration, Instant};

use pyo3::prelude::*;
use tesaki::protocol::{FromBoard, Mode, Refusal, Reply, ReplyFrame, Request, Status, Stream, Telemetry};
use tesaki::task::TaskCommand;
use tesaki_supervisor::faults;
use tesaki_supervisor::port::Reopening;
use tesaki_supervisor::publication::STREAMS;
use tesaki_supervisor::timing::{KEEP_ALIVE, LAST_WORD};
use tesaki_supervisor::{Board as _, BoardError as Failure, LinkBoard};

use super::Board;
use crate::error::{BoardError, FaultError, RefusedError, board_of};

impl Board {
    /// Talks to the board while other Python threads run.
    pub(super) fn call<T: Send>(
        &mut self,
        py: Python<'_>,
        ask: impl FnOnce(&mut LinkBoard<Reopening>) -> Result<T, Failure> + Send,
    ) -> PyResult<T> {
        if !self.is_open {
            return Err(BoardError::new_err("the board was closed: make another Board"));
        }
        let link = &mut self.board;
        let answer = py.detach(|| {
            let answer = ask(link);
            // The board has forgotten its commander, and needs this one for what comes next.
            if matches!(answer, Err(Failure::Reset)) {
                let _ = link.take_command(false);
            }
            answer
        });
        answer.map_err(|error| self.wrong(error))
    }

    /// Returns the exception for an error. What another program has enabled since is its own, and a board
    /// that was reset has no model.
    fn wrong(&mut self, error: Failure) -> PyErr {
        if matches!(error, Failure::Reset) {
            (self.model, self.is_enabled) = (None, false);
        }
        let is_lost = matches!(
            error,
            Failure::Reset
                | Failure::Refused { refusal: Refusal::NotCommander | Refusal::Commanded { .. }, .. }
        );
        self.is_enabled &= !is_lost;
        board_of(self.model.as_ref(), error)
    }

    /// Requests all streams of a recording, or only that of the joints, and drops earlier messages.
    pub(super) fn stream_recorded(&mut self, py: Python<'_>, begins: bool) -> PyResult<()> {
        self.call(py, |link| {
            for &(stream, every) in STREAMS {
                let is_kept = begins || stream == Stream::Telemetry;
                link.set_rate(stream, if is_kept { every } else { 0 })?;
            }
            while link.next_event(Instant::now())?.is_some() {}
            Ok(())
        })
    }

    /// Sends a command to the task.
    pub(super) fn send(&mut self, py: Python<'_>, command: TaskCommand) -> PyResult<()> {
        self.goals.clear();
        let asked = self.call(py, |link| link.command(command));
        // A board in fault refuses everything: the fault is the reason.
        match asked {
            Err(error) if error.is_instance_of::<RefusedError>(py) && self.is_enabled => {
                let mode = self.call(py, |link| link.status())?.node.mode;
                if mode == Mode::Fault { Err(self.fault(py)) } else { Err(error) }
            }
            other => other,
        }
    }

    /// Sends `request` every 20 ms until `done` accepts a message of the board, or until `until`.
    pub(super) fn drive(
        &mut self,
        py: Python<'_>,
        until: Instant,
        request: &Request,
        mut done: impl FnMut(&FromBoard) -> bool + Send,
    ) -> PyResult<()> {
        self.call(py, |link| link.set_rate(Stream::Telemetry, 1))?;
        let mut heard = Instant::now();
        let mut next = Instant::now();
        // Telemetry that is still on its way may contain an earlier fault.
        let mut was_enabled = false;
        while Instant::now() < until {
            py.check_signals()?;
            next = (next + KEEP_ALIVE).max(Instant::now());
            let enabled = self.is_enabled;
            let done = &mut done;
            let deadline = next.min(until);
            let (news, refused) = self.call(py, |link| {
                if enabled || *request != Request::Keep {
                    link.post(request.clone())?;
                }
                let (mut news, mut refused) = (Vec::new(), None);
                while let Some(event) = link.next_event(deadline)? {
                    match event {
                        FromBoard::Reply(ReplyFrame { reply: Reply::Refused(refusal), .. }) => {
                            refused = Some(refusal);
                        }
                        event => news.push(event),
                    }
                }
                Ok((news, refused))
            })?;
            for event in &news {
                let is_done = done(event);
                let FromBoard::Telemetry(telemetry) = event else {
                    if is_done {
                        return Ok(());
                    }
                    continue;
                };
                heard = Instant::now();
                was_enabled |= matches!(telemetry.mode, Mode::Enabled(_));
                if self.is_enabled
                    && (was_enabled || telemetry.faults != self.faults.total)
                    && telemetry.mode == Mode::Fault
                {
                    return Err(self.fault(py));
                }
                if self.is_enabled && was_enabled && telemetry.mode == Mode::Disabled {
                    self.is_enabled = false;
                    return Err(BoardError::new_err("the board was disabled by another program, or reset"));
                }
                if is_done {
                    return Ok(());
                }
            }
            match refused {
                Some(Refusal::WrongMode(Mode::Fault)) if !self.is_enabled => return Err(self.fault(py)),
                None | Some(Refusal::Stale { .. } | Refusal::WrongMode(Mode::Fault)) => {}
                Some(refusal) => {
                    if refusal == Refusal::NotCommander {
                        self.require_no_reset(py)?;
                    }
                    // `wait` and `record` keep the board enabled, or read.
                    let action = match request {
                        Request::Keep => "stay enabled",
                        Request::ReadStatus => "tell its state",
                        _ => "move",
                    };
                    return Err(self.wrong(Failure::refused(action, refusal)));
                }
            }
            if heard.elapsed() > self.timeout {
                return Err(self.no_readings("telemetry"));
            }
        }
        Ok(())
    }

    /// Fails if the board was reset, which the answer to a posted request does not tell.
    fn require_no_reset(&mut self, py: Python<'_>) -> PyResult<()> {
        self.call(py, |link| match link.keep() {
            Err(error @ Failure::Reset) => Err(error),
            _ => Ok(()),
        })
    }

    /// Returns the next telemetry.
    pub(super) fn telemetry_now(&mut self, py: Python<'_>) -> PyResult<Telemetry> {
        let (timeout, keeps) = (self.timeout, self.is_enabled);
        let telemetry = self.call(py, |link| {
            link.set_rate(Stream::Telemetry, 1)?;
            while link.next_event(Instant::now())?.is_some() {}
            await_event(link, timeout, keeps, |event| match event {
                FromBoard::Telemetry(telemetry) => Some(telemetry),
                _ => None,
            })
        })?;
        telemetry.ok_or_else(|| self.no_readings("telemetry"))
    }

    /// Returns the error that the board answers, but does not send `what`.
    pub(super) fn no_readings(&self, what: &str) -> PyErr {
        BoardError::new_err(format!(
            "no {what} within {} s: the board has no sensor readings, or its control loop does not run (try \
             `tesaki doctor`)",
            self.timeout.as_secs_f64()
        ))
    }

    /// Returns the fault that stopped the board, as an exception.
    pub(super) fn fault(&mut self, py: Python<'_>) -> PyErr {
        self.is_enabled = false;
        let log = match self.call(py, |link| link.faults()) {
            Ok(log) => log,
            Err(error) => return error,
        };
        let causes = self.faults.cause(&log);
        let outputs = if causes.last().is_none_or(|fault| fault.cause.leaves_control()) {
            "\nIts outputs may hold the robot; disable() switches them off"
        } else {
            ""
        };
        let text = faults::explain(causes, self.model.as_ref());
        FaultError::new_err(format!("the board is in fault: {text}{outputs}"))
    }

    pub(super) fn described(&self, fault: &tesaki::fault::Fault) -> String {
        faults::describe(fault, self.model.as_ref())
    }

    /// Disables the board if this program has enabled it, and releases command, so that the next client
    /// does not wait for the lease to expire.
    pub(super) fn leave(&mut self) -> Result<(), Failure> {
        if !std::mem::take(&mut self.is_open) {
            return Ok(());
        }
        self.board.set_timeout(self.timeout.min(LAST_WORD));
        let client = Some(self.board.client());
        // A board in fault reacts as its model says: disabled, an arm that it holds would fall.
        let is_own = std::mem::take(&mut self.is_enabled)
            && self.board.status().map_or(true, |Status { node, .. }| {
                node.commander == client && matches!(node.mode, Mode::Enabled(_))
            });
        let disabled = if is_own { self.board.disable() } else { Ok(()) };
        let _ = self.board.set_rate(Stream::Telemetry, 0);
        let _ = self.board.ask("release command", Request::ReleaseCommand);
        disabled
    }
}

/// Returns what `find` first finds in the board's messages within `timeout`; `keeps` the board enabled
/// meanwhile.
pub(super) fn await_event<T>(
    link: &mut LinkBoard<Reopening>,
    timeout: Duration,
    keeps: bool,
    find: impl Fn(FromBoard) -> Option<T>,
) -> Result<Option<T>, Failure> {
    let until = Instant::now() + timeout;
    while Instant::now() < until {
        if keeps {
            link.post(Request::Keep)?;
        }
        let next = until.min(Instant::now() + KEEP_ALIVE);
        while let Some(event) = link.next_event(next)? {
            if let Some(found) = find(event) {
                return Ok(Some(found));
            }
        }
    }
    Ok(None)
}
