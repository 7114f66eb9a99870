//! `approach`: the behaviour of a visual approach. Leads an arm to a door knob by the circles that vision
//! finds.

mod poses;
mod vision;

use std::cell::RefCell;
use std::time::{Duration, Instant};

use serde_json::json;
use tesaki::behavior::{Approach, ApproachPhase};
use tesaki::kinematics::Chain;
use tesaki::model::{Pose, RobotModel};
use tesaki::protocol::{Request, TaskReport};
use tesaki::task::visual_approach::{VisualApproachSettings, VisualApproachTelemetry};
use tesaki::task::{TaskCommand, TaskConfig, TaskRefusal, TaskTelemetry};
use tesaki::vision::Circle;
use tesaki_description::approach::{self, ApproachFile};

use crate::args::{Approach as Arguments, Options, SightSource};
use crate::failure::Failure;
use crate::motion::{End, Motion, News, PERIOD};
use crate::output;
use crate::sight::{Answer, Search, Sight};
use poses::Poses;
use vision::{Line, Vision};

/// Period of the decisions.
const DECISION: Duration = Duration::from_millis(20);

pub fn run(options: &Options, args: &Arguments) -> Result<(), Failure> {
    let mut motion = Motion::begin_after(options, args.resume)?;
    let ApproachFile { task, behavior, size } = approach::load(&args.robot, &motion.model)?;
    let mut vision = Vision::open(&args.from)?;
    let approach = Approach::new(behavior);
    output::notice(options, &format!("waiting for circles at {}", vision.place()));
    let initial = Search::from(approach.search(&Pose::IDENTITY));
    motion.wait_until(|| vision.greet(initial, size))?;
    let warning = format!("The hand of {} will go to a door knob and grip it.", motion.model.name);
    let is_led_by_input = args.from == SightSource::StandardInput;
    vision.greet_during(initial, size, || output::confirm_lead(options, &warning, is_led_by_input))?;
    motion.enable(TaskConfig::VisualApproach(task))?;
    // What was seen before is of no use. A vision that has ended meanwhile is one that stops.
    let _ = vision.greet(initial, size);
    motion.announce_ctrl_c(motion.load().as_ref());
    let poses = Poses::new(hand(&motion.model, &task));
    let leader = RefCell::new(Leader {
        options,
        approach,
        vision,
        size,
        poses,
        report: None,
        begin: Instant::now(),
        decided: None,
        looks: false,
        told: None,
        live: output::Live::new(options),
    });
    let end = motion.drive(
        PERIOD,
        |now| leader.borrow_mut().decide(now),
        |news, _| {
            let mut leader = leader.borrow_mut();
            leader.hear(news);
            leader.has_ended()
        },
    );
    let leader = leader.into_inner();
    leader.live.end();
    let end = end?;
    if end == End::Interrupted {
        return motion.break_off();
    }
    let outcome = leader.tell_outcome()?;
    let load = motion.load();
    motion.stay(args.stay.hold, args.stay.no_hold, load.as_ref(), DECISION, |_| Request::Keep)?;
    motion.end(false)?;
    outcome
}

/// Pose of the hand by the angles of the joints; the gripper counts as at 0.
fn hand(model: &RobotModel, task: &VisualApproachSettings) -> impl Fn(&[f32]) -> Option<Pose> + use<> {
    let index = usize::from(task.chain);
    let range = model.chain_ranges().nth(index);
    let chain = Chain::of_model(model, index);
    let gripper = usize::from(task.gripper.joint);
    move |angles| {
        let mut angles = angles.to_vec();
        *angles.get_mut(gripper)? = 0.0;
        let posture = chain.posture(angles.get(range.clone()?)?);
        let rotation = nalgebra::UnitQuaternion::from_rotation_matrix(&posture.tip().rotation);
        Some(Pose { translation: posture.tip().translation.vector.into(), rotation: rotation.coords.into() })
    }
}

/// What leads the arm.
struct Leader<'a, F> {
    options: &'a Options,
    approach: Approach,
    vision: Vision,
    /// Of the pictures with which the camera was calibrated [px].
    size: Option<[usize; 2]>,
    poses: Poses<F>,
    report: Option<VisualApproachTelemetry>,
    begin: Instant,
    decided: Option<Instant>,
    /// Whether pictures are needed.
    looks: bool,
    /// The phase that was told last.
    told: Option<ApproachPhase>,
    live: output::Live,
}

impl<F: Fn(&[f32]) -> Option<Pose>> Leader<'_, F> {
    /// The request for the period that begins now.
    fn decide(&mut self, now: Instant) -> Request {
        self.look();
        let is_due = self.decided.is_none_or(|decided| now.saturating_duration_since(decided) >= DECISION);
        let Some(report) = self.report.filter(|_| is_due) else { return Request::Keep };
        let elapsed = self.decided.map_or(DECISION, |decided| now.saturating_duration_since(decided));
        self.decided = Some(now);
        let order = self.approach.update(&report, elapsed.as_secs_f32());
        self.looks = order.look;
        self.tell_phase();
        order.command.map_or(Request::Keep, |command| Request::Task(TaskCommand::VisualApproach(command)))
    }

    /// Takes what vision has sent.
    fn look(&mut self) {
        while let Some(line) = self.vision.next() {
            match Sight::read(&line.text, self.size) {
                Ok(sight) => self.see(&line, &sight),
                Err(error) => self.vision.reject(&line, error),
            }
        }
    }

    fn see(&mut self, line: &Line, sight: &Sight) {
        let exposed = line.arrived.checked_sub(Duration::from_secs_f64(sight.age));
        let pose = exposed.and_then(|exposed| self.poses.at(exposed));
        match (&sight.circle, pose) {
            (None, pose) => {
                let pose = pose.filter(|_| self.looks);
                let search = pose.map(|pose| Search::from(self.approach.search(&pose)));
                line.answer(&Answer::Search { picture: sight.picture, search });
            }
            (Some(circle), Some(pose)) => {
                self.vision.accept();
                let circle = circle.map(Circle::from);
                if self.looks {
                    self.approach.look(&pose, circle.as_ref());
                }
            }
            // Before the first telemetry, or while it is late, a picture is of no use; it is none that is
            // wrong.
            (Some(_), None) => {}
        }
    }

    /// Takes what the board has sent.
    fn hear(&mut self, news: &News) {
        if let (Some(telemetry), Some(arrived)) = (&news.telemetry, news.arrived) {
            self.poses.add(arrived, telemetry);
        }
        if let Some(TaskReport { telemetry: TaskTelemetry::VisualApproach(report), .. }) = &news.task {
            self.report = Some(*report);
        }
        if let Some(TaskRefusal::VisualApproach(refusal)) = &news.refused {
            self.approach.refused(refusal);
        }
        let text = self.one_line();
        self.live.show(&text);
    }

    const fn has_ended(&self) -> bool {
        matches!(self.approach.phase(), ApproachPhase::Done | ApproachPhase::Failed(_))
    }

    /// Says what it begins to do.
    fn tell_phase(&mut self) {
        let phase = self.approach.phase();
        if self.told.replace(phase) == Some(phase) {
            return;
        }
        let text = match phase {
            ApproachPhase::Look => "looking for the rose",
            ApproachPhase::Center => "going before the knob",
            ApproachPhase::Advance => "going beside the knob",
            ApproachPhase::Grip => "closing the gripper",
            ApproachPhase::Verify => "pulling at what it holds",
            ApproachPhase::Retreat => "going back for another try",
            ApproachPhase::Done | ApproachPhase::Failed(_) => return,
        };
        if self.options.json {
            // If nobody reads it, the next report says so.
            let _ = output::line(&json!({ "phase": text, "time": self.time() }).to_string());
        } else {
            self.live.end();
            output::notice(self.options, &format!("{:6.2} s  {text}", self.time()));
        }
    }

    /// Time since the arm was enabled [s].
    fn time(&self) -> f64 {
        (self.begin.elapsed().as_secs_f64() * 100.0).round() / 100.0
    }

    fn one_line(&mut self) -> String {
        let rose = self.approach.rose().zip(self.report).map_or_else(String::new, |(rose, report)| {
            let hand = nalgebra::Point3::from(report.hand.translation);
            let distance = nalgebra::distance(&rose.place(), &hand);
            format!(", rose {:.0} mm away, radius {:.1} mm", 1e3 * distance, 1e3 * rose.radius())
        });
        format!("{}{rose}", self.vision.one_line())
    }

    /// Prints what came of it.
    fn tell_outcome(&self) -> Result<Result<(), Failure>, Failure> {
        let (time, tries) = (self.time(), u32::from(self.approach.tries()) + 1);
        let (seen, bad) = self.vision.counts();
        let reason = match self.approach.phase() {
            ApproachPhase::Failed(reason) => Some(reason.to_string()),
            _ => None,
        };
        let rose = self.approach.rose().map(|rose| output::exact(&rose.radius()));
        let value = json!({
            "gripped": reason.is_none(), "reason": reason, "time": time, "tries": tries, "pictures": seen, "bad": bad,
            "bad_line": self.vision.error(), "rose_radius": rose,
        });
        output::result(self.options, &value, || {
            let what = reason
                .as_ref()
                .map_or_else(|| "the hand holds the knob".to_owned(), |reason| format!("given up: {reason}"));
            let pictures = output::counted(seen as usize, "picture");
            let error =
                self.vision.error().map_or_else(String::new, |error| format!(", the last one: {error}"));
            format!("{what}; {time:.1} s, try {tries}, {pictures}, {bad} bad lines{error}")
        })?;
        Ok(reason.map_or(Ok(()), |reason| Err(Failure::Grasp(format!("the knob is not held: {reason}")))))
    }
}
