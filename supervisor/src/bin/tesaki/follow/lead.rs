//! From the poses of a hand to set-points of the tool: clutch, stops and counts.

use std::f32::consts::TAU;
use std::fmt::Write as _;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use serde_json::{Value, json};
use tesaki::math;
use tesaki::protocol::Request;
use tesaki::task::TaskCommand;
use tesaki::task::impedance::{
    ImpedanceCommand, ImpedanceSettings, ImpedanceTelemetry, Redundancy, SetpointError,
};
use tesaki::teleop::{Follower, FollowerError, FollowerState, MasterSample, Workspace};

use super::pace::{self, FastStep, Pace};
use super::reflect::Reflection;
use super::source::{Entry, Sample, Source};
use crate::args::{Follow, State, Switch};
use crate::feed::{MAX_TAKEN, RESTART};
use crate::impedance::norm;
use crate::output;

/// Without an accepted sample for this time the clutch opens.
const STOP: Duration = Duration::from_millis(500);
/// A time without samples that the prediction does not bridge [s].
const GAP: f64 = 0.06;
/// The clutch opens before the tool is as far from its set-point as the settings permit: at this fraction.
const MAX_DEVIATION: f32 = 0.7;
/// The set-point is at a border within the first distance, and off it beyond the second [m].
const AT_BORDER: [f32; 2] = [1e-3, 5e-3];

/// What the operator is told when it happens.
pub struct Event {
    pub text: String,
    pub value: Value,
}

/// Samples that were followed, those that were not, and those that did not come.
#[derive(Default)]
struct Counts {
    followed: u32,
    lost: u64,
    gaps: u32,
    late: u32,
    out_of_order: u32,
    jumped: u32,
    elbows: u32,
    stops: u32,
}

/// Leads the set-point of the tool by the samples of a source.
pub struct Lead {
    pub source: Source,
    follower: Follower,
    /// Displacement of the tool per displacement of the hand.
    scale: f32,
    pace: Pace,
    state: FollowerState,
    workspace: Option<Workspace>,
    rotates: bool,
    leads_elbow: bool,
    max_deviation: [f32; 2],
    /// The begin of the follower's clock.
    start: Instant,
    /// Whether a closed clutch is asked for.
    asked: bool,
    /// The last position of the pedal.
    pedal: Option<bool>,
    /// When the last sample was accepted.
    accepted: Option<Instant>,
    /// The latest time stamp [s].
    latest: Option<f64>,
    /// The last accepted angle of the elbow [rad], and whether the elbow stays since.
    elbow: Option<f32>,
    elbow_stays: bool,
    /// Why samples after that were not.
    rejected: Option<String>,
    /// Why the last one was not, of all.
    last_rejected: Option<String>,
    counts: Counts,
    /// How late the last sample came [s].
    age: f32,
    /// The last telemetry of the arm.
    tool: ImpedanceTelemetry,
    /// Largest distance of the tool from its set-point [m], and largest force [N].
    largest: [f32; 2],
    /// The border at which the set-point is: axis and coordinate [m].
    border: Option<(usize, f32)>,
    /// The limit of the reflected force, if it is reached [N].
    limit: Option<f32>,
    pub events: Vec<Event>,
}

/// The time of the follower's clock.
fn instant(start: Instant, time: Instant) -> tesaki::teleop::Instant {
    #[expect(clippy::cast_possible_truncation, reason = "it wraps around")]
    tesaki::teleop::Instant(time.saturating_duration_since(start).as_micros() as u32)
}

/// The angle within half a turn of the one `before`: the arm angle jumps at half a turn, the elbow does not.
fn unwrapped(angle: f32, before: f32) -> f32 {
    angle - TAU * math::round((angle - before) / TAU)
}

impl Lead {
    pub fn new(source: Source, follower: Follower, args: &Follow, settings: &ImpedanceSettings) -> Self {
        Self {
            source,
            follower,
            scale: args.scale,
            pace: Pace::default(),
            state: FollowerState::at([0.0; 3], [0.0, 0.0, 0.0, 1.0], 0.0),
            workspace: args.workspace,
            rotates: args.rotation == Switch::On,
            leads_elbow: settings.redundancy != Redundancy::None,
            max_deviation: settings.max_deviation,
            start: Instant::now(),
            asked: args.clutch == State::Closed,
            pedal: None,
            accepted: None,
            latest: None,
            elbow: None,
            elbow_stays: false,
            rejected: None,
            last_rejected: None,
            counts: Counts::default(),
            age: 0.0,
            tool: ImpedanceTelemetry::NONE,
            largest: [0.0; 2],
            border: None,
            limit: None,
            events: Vec::new(),
        }
    }

    /// The arm is enabled, with its tool there.
    pub fn begin(&mut self, tool: &ImpedanceTelemetry) {
        self.rest_at(tool);
        (self.counts, self.last_rejected) = (Counts::default(), None);
        self.source.start();
    }

    fn rest_at(&mut self, tool: &ImpedanceTelemetry) {
        self.tool = *tool;
        self.state = FollowerState::at(tool.position, tool.rotation, tool.elbow);
    }

    /// Takes the samples that have come. Returns whether there is one to begin with.
    pub fn take(&mut self) -> bool {
        for _ in 0..MAX_TAKEN {
            let Some((arrived, content)) = self.source.feed.next() else { break };
            match content.read() {
                None => {}
                Some(Ok(Entry::Clutch(closed))) => self.ask(closed),
                Some(Ok(Entry::Sample(sample))) => self.add(arrived, &sample),
                Some(Err(error)) => self.source.feed.reject(arrived, &error),
            }
        }
        self.source.waits() || self.accepted.is_some()
    }

    fn add(&mut self, arrived: Instant, sample: &Sample) {
        // The clutch opens by any sample, but closes only by one that is followed.
        if sample.clutch == Some(false) {
            self.obey(false);
        }
        let is_latest = self.latest.is_none_or(|latest| !(latest - RESTART..=latest).contains(&sample.time));
        // A sample that was overtaken is judged by the follower.
        if self.latest == Some(sample.time) {
            let why = format!("time {0} s does not follow {0} s: times must rise", sample.time);
            self.reject(&why);
            return self.source.feed.reject(arrived, &why);
        }
        let age = self.source.feed.accept(arrived, sample.time);
        let fast = self.check_pace(sample);
        self.count_missing(sample.time);
        if let Err(FastStep { message, goes_on }) = fast {
            self.counts.jumped += 1;
            self.reject(&message);
            if goes_on {
                self.stop(&message);
            }
            return;
        }
        let now = instant(self.start, Instant::now());
        // Before the program began, too: the clock wraps around.
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it wraps around")]
        let micros = (1e6 * f64::from(age)) as u64 as u32;
        let time = tesaki::teleop::Instant(instant(self.start, arrived).0.wrapping_sub(micros));
        let rotation = if self.rotates { sample.rotation } else { [0.0, 0.0, 0.0, 1.0] };
        let master = MasterSample { time, position: sample.position, rotation };
        if let Err(error) = self.follower.add_sample(&mut self.state, now, &master) {
            return self.count(&error);
        }
        if let Err(why) = pace::check_velocity(&self.state.hand_velocity(), self.scale) {
            self.counts.jumped += 1;
            self.reject(&why);
            return self.stop(&why);
        }
        self.rejected = None;
        if is_latest && sample.clutch == Some(true) {
            self.obey(true);
        }
        if let Some(angle) = sample.elbow.filter(|_| self.leads_elbow) {
            let angle = self.elbow.map_or(angle, |before| unwrapped(angle, before));
            match self.follower.add_elbow_sample(&mut self.state, now, time, angle) {
                Ok(()) => (self.elbow, self.elbow_stays) = (Some(angle), false),
                Err(error) => self.elbow_was_refused(&error),
            }
        }
        self.counts.followed += u32::from(self.state.is_clutch_closed());
        (self.accepted, self.age) = (Some(arrived), age);
    }

    /// Refuses a step that is too fast. A sample that was overtaken is judged by the follower.
    fn check_pace(&mut self, sample: &Sample) -> Result<(), FastStep> {
        match self.latest {
            Some(latest) if sample.time <= latest - RESTART => self.pace.forget(),
            Some(latest) if sample.time <= latest => return Ok(()),
            _ => {}
        }
        self.pace.check(sample, self.scale)
    }

    /// The pedal is in a position.
    fn obey(&mut self, pedal: bool) {
        if self.pedal.replace(pedal) != Some(pedal) {
            self.ask(pedal);
        }
    }

    fn elbow_was_refused(&mut self, error: &FollowerError) {
        self.counts.elbows += 1;
        if !std::mem::replace(&mut self.elbow_stays, true) {
            self.events.push(Event {
                text: format!(
                    "the elbow stays, the tool follows on: {error}. Open and close the clutch to lead it again"
                ),
                value: json!({ "elbow": "stays", "reason": error.to_string() }),
            });
        }
    }

    fn reject(&mut self, why: &str) {
        self.rejected = Some(why.to_owned());
        self.last_rejected = Some(why.to_owned());
    }

    fn count(&mut self, error: &FollowerError) {
        self.reject(&error.to_string());
        match error {
            FollowerError::Age { .. } => self.counts.late += 1,
            FollowerError::OutOfOrder { .. } => self.counts.out_of_order += 1,
            _ => self.counts.jumped += 1,
        }
    }

    /// Counts what is missing before a sample with this time stamp [s].
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of samples")]
    fn count_missing(&mut self, time: f64) {
        // Far back in time the source has begun anew.
        let before = self.latest.filter(|latest| time > latest - RESTART);
        let passed = before.map_or(0.0, |before| time - before);
        if before.is_none() || passed > 0.0 {
            self.latest = Some(time);
            self.counts.gaps += u32::from(passed > GAP);
        }
        let Some(period) = self.source.period else { return };
        if passed > 0.0 {
            self.counts.lost += ((passed / period).round() as u64).saturating_sub(1);
        } else if passed < 0.0 {
            // Overtaken, not lost.
            self.counts.lost = self.counts.lost.saturating_sub(1);
        }
    }

    /// The operator asks for a closed or an open clutch.
    pub fn ask(&mut self, closed: bool) {
        self.asked = closed;
        if !closed && self.state.is_clutch_closed() {
            self.open("it was asked for");
        }
    }

    /// Opens the clutch: the set-point comes to rest.
    pub fn open(&mut self, why: &str) {
        self.follower.open_clutch(&mut self.state);
        self.asked = false;
        self.events.push(Event {
            text: format!("the clutch is open: {why}"),
            value: json!({ "clutch": "open", "reason": why }),
        });
    }

    /// Opens it, which the operator did not ask for.
    fn stop(&mut self, why: &str) {
        if self.state.is_clutch_closed() {
            self.counts.stops += 1;
            let end = if why.ends_with('?') { "" } else { "." };
            self.open(&format!("{why}{end} The arm stays; close the clutch again to go on"));
        }
    }

    /// The request for the period that begins now.
    pub fn tick(&mut self, now: Instant) -> Request {
        let silence = self.accepted.map_or(Duration::MAX, |at| now.saturating_duration_since(at));
        if self.state.is_clutch_closed() && silence > STOP {
            let seconds = STOP.as_secs_f32();
            match self.rejected.clone() {
                Some(error) => self.stop(&format!("no sample was accepted for {seconds} s; {error}")),
                None => self.stop(&format!("no sample for {seconds} s")),
            }
        }
        let now = instant(self.start, now);
        if self.asked
            && !self.state.is_clutch_closed()
            && self.follower.close_clutch(&mut self.state, now).is_ok()
        {
            let text = "the clutch is closed: the tool follows".to_owned();
            self.events.push(Event { text, value: json!({ "clutch": "closed" }) });
        }
        let (point, elbow) = self.follower.tick(&mut self.state, now);
        self.watch_border(&point.position);
        let point = match &mut self.source.reflection {
            Some(reflection) => reflection.limit(point),
            None => point,
        };
        Request::Task(TaskCommand::Impedance(ImpedanceCommand::SetTarget { point, elbow }))
    }

    /// Tells when the set-point comes to a border of the workspace.
    fn watch_border(&mut self, position: &[f32; 3]) {
        let Some(Workspace { lower, upper }) = &self.workspace else { return };
        let within = if self.border.is_some() { AT_BORDER[1] } else { AT_BORDER[0] };
        let borders = position.iter().zip(lower.iter().zip(upper)).enumerate();
        let found = borders.into_iter().find_map(|(axis, (value, (&lower, &upper)))| {
            let border = if value - lower < upper - value { lower } else { upper };
            ((value - border).abs() < within).then_some((axis, border))
        });
        if let (None, Some((axis, border))) = (self.border, found) {
            let axis = ["x", "y", "z"][axis];
            self.events.push(Event {
                text: format!("the set-point is at the border of the workspace: {axis} = {border} m"),
                value: json!({ "workspace": axis, "border": output::exact(&border) }),
            });
        }
        self.border = found;
    }

    /// Telemetry of the arm.
    pub fn heard(&mut self, tool: &ImpedanceTelemetry) {
        self.tool = *tool;
        if let Some(reflection) = &mut self.source.reflection {
            reflection.heard(tool, self.state.is_clutch_closed());
            let limit = reflection.felt().limit;
            if let (None, Some(limit)) = (std::mem::replace(&mut self.limit, limit), limit) {
                self.events.push(Event {
                    text: format!("the force at the handle is at its limit: {limit:.1} N"),
                    value: json!({ "handle": "limit", "force": output::exact(&limit) }),
                });
            }
        }
        let [largest, force] = self.largest;
        self.largest = [largest.max(norm(&tool.error)), force.max(norm(&tool.wrench))];
        let angle = Vector3::from_column_slice(&tool.error[3..]).norm();
        let deviations = [(norm(&tool.error), "m"), (angle, "rad")];
        for ((value, unit), limit) in deviations.into_iter().zip(self.max_deviation) {
            let limit = MAX_DEVIATION * limit;
            if value > limit {
                self.stop(&format!(
                    "the tool is {value:.3} {unit} from its set-point, limit {limit:.3} {unit} ({MAX_DEVIATION} of \
                     max_deviation): is it blocked, or a joint at its limit?"
                ));
            }
        }
    }

    /// The board refused a set-point: it comes to rest, the part that was refused where tool or elbow are.
    pub fn refused(&mut self, error: SetpointError) {
        self.stop(&format!("the board refused a set-point: {error}"));
        let tool = self.tool;
        match error {
            SetpointError::Elbow { .. } => self.state.reset_elbow(tool.elbow),
            _ => self.rest_at(&tool),
        }
    }

    /// State of clutch, source and tool.
    pub fn one_line(&mut self, now: Instant) -> String {
        let clutch = match (self.state.is_clutch_closed(), self.asked) {
            (true, _) => "closed",
            (false, true) => "waits for samples",
            (false, false) => "open",
        };
        let mut text = format!(
            "clutch {clutch}, {:.0} samples/s, {:.0} ms late, tool {:.1} mm from its set-point",
            self.source.feed.rate(now),
            1e3 * self.age,
            1e3 * norm(&self.tool.error)
        );
        if let Some(reflection) = &self.source.reflection {
            let _ = write!(text, ", {:.1} N at the handle", reflection.felt().force);
        }
        if let Some(error) = &self.rejected {
            let _ = write!(text, "; rejected: {error}");
        }
        if let Some(error) = self.source.feed.error() {
            let _ = write!(text, "; {error}");
        }
        text
    }

    /// As text and as JSON.
    pub fn summary(&self) -> (String, Value) {
        let Counts { followed, lost, gaps, late, out_of_order, jumped, elbows, stops } = self.counts;
        let [distance, force] = self.largest;
        let bad = self.source.feed.dropped;
        let of_source = self.source.period.map(|_| lost);
        let told = of_source.map_or_else(String::new, |lost| format!(", {lost} lost"));
        let felt = self.source.reflection.as_ref().map(Reflection::felt);
        let reflected = felt.as_ref().map_or_else(String::new, |felt| {
            format!(
                ", largest at the handle {:.1} N; energy of the link {:+.0} mJ",
                felt.largest,
                1e3 * felt.balance
            )
        });
        let why = self
            .last_rejected
            .as_ref()
            .map_or_else(String::new, |why| format!(" (the last rejected: {why})"));
        let of_elbow = if elbows == 0 {
            String::new()
        } else {
            format!("; {} of the elbow rejected", output::counted(elbows as usize, "angle"))
        };
        let text = format!(
            "done: {} followed{told}, {}; rejected: {late} late, {out_of_order} out of order, {jumped} that jumped, {bad} bad{why}{of_elbow}; \
             the clutch opened by itself {}; largest error of the commanded motion {:.1} mm, \
             largest force {force:.1} N{reflected}",
            output::counted(followed as usize, "sample"),
            output::counted(gaps as usize, "gap"),
            output::counted(stops as usize, "time"),
            1e3 * distance
        );
        let value = json!({
            "samples": followed,
            "lost": of_source,
            "gaps": gaps,
            "rejected": { "late": late, "out_of_order": out_of_order, "jumped": jumped, "bad": bad, "elbows": elbows },
            "last_rejected": self.last_rejected,
            "stops": stops,
            "largest_distance": output::exact(&distance),
            "largest_force": output::exact(&force),
            "reflected": felt.map(|felt| json!({
                "largest_force": output::exact(&felt.largest), "energy_balance": output::exact(&felt.balance),
            })),
        });
        (text, value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_elbow_that_turns_on_does_not_jump() {
        for (angle, before, expected) in
            [(-3.1, 3.1, TAU - 3.1), (3.1, -3.1, 3.1 - TAU), (0.5, 0.4, 0.5), (3.1, 9.3, 3.1 + TAU)]
        {
            assert!((unwrapped(angle, before) - expected).abs() < 1e-5, "{angle} after {before}");
        }
    }
}
