//! Scenarios: a robot, a task, a plant, and what is measured.

mod arm;
mod arm7_bilateral;
mod arm7_contact;
mod arm7_elbow;
mod arm7_follow;
mod arm7_paper;
mod arm7_paper_bilateral;
mod arm7_paper_elbow;
mod arm7_paper_matrices;
mod arm7_release;
mod arm7_straight;
mod arm7_wall;
pub(crate) mod common;
mod film;
pub mod finger_on_chip;
mod grasping;
mod hand;
mod hand3_first_motion;
mod hand3_force;
mod hand3_grasp;
mod hand3_paper;
mod hand3_reach;
mod hand3_servo;
mod hand3_shift;
mod hand3_turn;
mod hand3_weights;
mod hand5_calibrate;
mod hand5_reach;
mod hand5_teleop;
mod knob_find;
mod knob_grasp;
mod knob_pictures;
pub(crate) mod needs;
mod possible;
mod unilateral;

pub use grasping::scene;
pub use knob_pictures::{KnobPicture, KnobPictures};
pub use needs::Kind;
pub use possible::Impossible;

use std::path::{Path, PathBuf};

use tesaki::model::RobotModel;
use tesaki::protocol::LogRecord;
use tesaki_description::FileError;
use tesaki_description::calibration::CalibrationError;
use tesaki_supervisor::BoardError;
use tesaki_supervisor::identify::IdentifyError;

use crate::controller::Watched;
use crate::law::LawFile;
use crate::live_run::LiveRun;
use crate::motion::Motion;
use crate::plant::{PlantError, SharedIntervention};
use crate::report::{Figure, Summary};
use grasping::scene::SceneError;

/// Longest time that can be asked for [s].
const LONGEST: f64 = 600.0;

/// A named experiment.
pub struct Scenario {
    /// Its name on the command line.
    pub name: &'static str,
    /// The title of its page.
    pub title: &'static str,
    /// What it shows, in one line.
    pub about: &'static str,
    /// The folder of its robot in `robots/`.
    pub robot: &'static str,
    /// What robots it is for.
    pub kind: Kind,
    /// Files of the robot's folder that it reads besides those of every robot; its laws can be chosen.
    pub files: &'static [&'static str],
    /// The document, and its section, that states how many machines meet its limits.
    pub results: &'static str,
    /// Simulated time when nothing else is asked for [s].
    pub duration: f64,
    /// The shortest time that can be asked for [s]; `None`: its time is fixed.
    pub shortest: Option<f64>,
    /// The laws of its robot that it compares when nothing else is asked for; `None`: it does not compare
    /// laws.
    pub laws: Option<&'static [&'static str]>,
    /// What its page begins with.
    pub lead: &'static [&'static str],
    pub(crate) run: fn(&mut Setting<'_, '_>) -> Result<Outcome, ScenarioError>,
}

/// All scenarios.
pub const SCENARIOS: &[Scenario] = &[
    hand3_servo::SCENARIO,
    hand3_reach::SCENARIO,
    hand3_force::SCENARIO,
    hand3_weights::SCENARIO,
    hand3_turn::SCENARIO,
    hand3_shift::SCENARIO,
    hand3_grasp::SCENARIO,
    hand3_paper::FORCE,
    hand3_paper::MOTION,
    arm7_release::SCENARIO,
    arm7_elbow::SCENARIO,
    arm7_straight::SCENARIO,
    arm7_wall::SCENARIO,
    arm7_contact::SCENARIO,
    arm7_bilateral::SCENARIO,
    arm7_follow::SCENARIO,
    arm7_paper::SCENARIO,
    arm7_paper_elbow::SCENARIO,
    arm7_paper_bilateral::SCENARIO,
    hand5_calibrate::SCENARIO,
    hand5_reach::SCENARIO,
    hand5_teleop::SCENARIO,
    knob_find::SCENARIO,
    knob_grasp::SCENARIO,
    hand3_paper::CURVES,
    arm7_paper_matrices::SCENARIO,
    hand3_first_motion::SCENARIO,
];

/// What a run is given.
pub struct Setting<'a, 'b> {
    /// The robot's folder.
    pub robot: &'a Path,
    /// Where the control core runs.
    pub controller: &'a mut Watched<'b>,
    /// Decides the machine's deviations and noise.
    pub seed: u64,
    /// Simulated time [s].
    pub duration: f64,
    /// What a scenario compares that compares laws.
    pub laws: &'a [LawFile],
    /// Called with the fraction that is done, 0 to 1.
    pub progress: &'a dyn Fn(f64),
    /// What acts on the plants from outside the experiment.
    pub intervention: Option<SharedIntervention>,
    /// Who looks on while it is computed.
    pub live: Option<&'a LiveRun>,
}

impl<'a, 'b> Setting<'a, 'b> {
    /// A robot without laws, for so long [s]; nobody looks on or interferes.
    pub const fn plain(robot: &'a Path, controller: &'a mut Watched<'b>, seed: u64, duration: f64) -> Self {
        let progress = &|_| {};
        Self { robot, controller, seed, duration, laws: &[], progress, intervention: None, live: None }
    }

    /// What is going to move: the joints of a robot.
    pub fn motion(&self, robot: &RobotModel) -> Motion {
        Motion::new(robot.joints.iter().map(|joint| joint.name.as_str())).shown_to(self.live)
    }

    /// The error for a robot that the scenario is not for.
    fn other_robot(&self, reason: impl ToString) -> ScenarioError {
        ScenarioError::OtherRobot { robot: self.robot.display().to_string(), reason: reason.to_string() }
    }
}

/// What a run leaves.
pub struct Outcome {
    /// Measured values and limits.
    pub summary: Summary,
    /// For the page.
    pub figures: Vec<Figure>,
    /// Tables of recorded values: file name and CSV text.
    pub tables: Vec<(String, String)>,
    /// What moved, for the recording.
    pub motion: Motion,
}

/// Why a scenario did not come to its end.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// A file of the robot cannot be used.
    #[error(transparent)]
    File(#[from] FileError),
    /// No scenario has this name.
    #[error("no scenario {0:?}: `cargo sim list` shows all")]
    Unknown(String),
    /// A schedule of faults that cannot be judged.
    #[error("nothing was judged in {scenario}: {reason}")]
    Unjudged {
        /// The scenario.
        scenario: String,
        /// Why.
        reason: String,
    },
    /// A law lacks the section of an experiment.
    #[error(
        "the law {law} has no {section}, which this scenario runs: add it as in robots/arm7/laws/paper.toml"
    )]
    LawWithout {
        /// Its name.
        law: String,
        /// What is missing.
        section: &'static str,
    },
    /// A law has an impedance without a spring.
    #[error("the law {law} has a stiffness of 0: this scenario needs a spring in every direction")]
    LawWithoutSpring {
        /// Its name.
        law: String,
    },
    /// Where a grasp is to begin.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The same of a grasp file.
    #[error("{path}: {source}", path = path.display())]
    Grasp {
        /// The file.
        path: PathBuf,
        /// Why.
        source: SceneError,
    },
    /// The plant.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The controller.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The board on a modelled chip.
    #[error(transparent)]
    Chip(#[from] crate::chip::ChipError),
    /// The identification.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// What it found makes no sense.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// The scenario is for robots of another kind.
    #[error("{robot} is not a robot for this scenario: {reason}")]
    OtherRobot {
        /// Its folder.
        robot: String,
        /// Why.
        reason: String,
    },
    /// The folder lacks files.
    #[error("{robot} has no {missing}: {scenario} needs {files}; robots/{example} has all of them")]
    MissingFiles {
        /// The folder.
        robot: String,
        /// What it lacks.
        missing: String,
        /// The scenario.
        scenario: &'static str,
        /// All that it needs.
        files: String,
        /// The folder of the scenario's own robot.
        example: &'static str,
    },
    /// The operator's hand.
    #[error("the operator's hand: {0}")]
    Operator(#[from] crate::operator::calibration_trial::TrialError),
    /// A search for circles.
    #[error(transparent)]
    Vision(#[from] tesaki::vision::VisionError),
    /// A picture for the page.
    #[error(transparent)]
    Png(#[from] png::EncodingError),
    /// The node gave up.
    #[error("the controller stopped after {time:.2} s of {trial}: {fault}")]
    Fault {
        /// In which part.
        trial: String,
        /// When [s].
        time: f64,
        /// Why.
        fault: String,
    },
    /// The time is too short for what is to be measured.
    #[error("--duration {duration} is too short: {name} needs at least {minimum} s")]
    TooShort {
        /// As asked for [s].
        duration: f64,
        /// The scenario.
        name: &'static str,
        /// Needed [s].
        minimum: f64,
    },
    /// The time is so long that its record fills the memory.
    #[error("--duration {duration} is too long: {name} runs at most {LONGEST} s")]
    TooLong {
        /// As asked for [s].
        duration: f64,
        /// The scenario.
        name: &'static str,
    },
    /// The scenario has no other time.
    #[error("--duration {duration}: the time of {name} is fixed, {fixed} s; leave the option out")]
    FixedDuration {
        /// As asked for [s].
        duration: f64,
        /// The scenario.
        name: &'static str,
        /// Its own [s].
        fixed: f64,
    },
}

impl Scenario {
    /// The scenario called `name`.
    pub fn find(name: &str) -> Option<&'static Self> {
        SCENARIOS.iter().find(|scenario| scenario.name == name)
    }

    /// Runs it; the summary is that of a controller in this process.
    ///
    /// # Errors
    /// Why it did not come to its end. Missing a goal is not an error but a failed metric.
    pub fn run(&self, setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
        self.check_duration(setting.duration)?;
        self.check_robot(setting.robot)?;
        let mut outcome = (self.run)(setting)?;
        let summary = &mut outcome.summary;
        self.name.clone_into(&mut summary.scenario);
        "native".clone_into(&mut summary.controller);
        summary.seed = setting.seed;
        summary.ticks = outcome.motion.ticks().into();
        summary.frames_sha256 = Some(setting.controller.frames_sha256());
        for impossible in self.impossible(setting.robot, setting.seed)?.unwrap_or_default() {
            outcome.summary.waive(&impossible.metric, &impossible.why);
        }
        Ok(outcome)
    }

    /// Refuses a time [s] that the scenario cannot have.
    fn check_duration(&self, duration: f64) -> Result<(), ScenarioError> {
        let name = self.name;
        match self.shortest {
            _ if duration.to_bits() == self.duration.to_bits() => Ok(()),
            None => Err(ScenarioError::FixedDuration { duration, name, fixed: self.duration }),
            Some(minimum) if duration.is_nan() || duration < minimum => {
                Err(ScenarioError::TooShort { duration, name, minimum })
            }
            Some(_) if duration > LONGEST => Err(ScenarioError::TooLong { duration, name }),
            Some(_) => Ok(()),
        }
    }

    /// The limits for which the machine of this seed leaves a controller no room, by the plant's truth alone:
    /// nothing is run. `None` if that is not computed for this scenario.
    ///
    /// # Errors
    /// The robot's folder.
    pub fn impossible(&self, robot: &Path, seed: u64) -> Result<Option<Vec<Impossible>>, ScenarioError> {
        possible::impossible(self.name, robot, seed)
    }
}

/// A recording as bytes: one frame a record, as on a wire.
///
/// # Errors
/// Never with records that a node has seen.
pub fn encode_record(record: &[LogRecord]) -> Result<Vec<u8>, tesaki::protocol::codec::TooLong> {
    use tesaki::protocol::codec::{MAX_FRAME, encode};
    let mut bytes = Vec::new();
    let mut frame = [0; MAX_FRAME];
    for entry in record {
        let length = encode(entry, &mut frame)?;
        bytes.extend_from_slice(&frame[..length]);
    }
    Ok(bytes)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn every_scenario_names_a_section_that_exists() {
        let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
        for Scenario { name, results, .. } in SCENARIOS {
            let (file, section) = results.split_once('#').unwrap_or((results, ""));
            let text = std::fs::read_to_string(root.join(file)).unwrap();
            let headings = text.lines().filter_map(|line| line.strip_prefix('#'));
            let is_kept = |letter: &char| letter.is_alphanumeric() || *letter == '-';
            let anchor = |heading: &str| -> String {
                let heading = heading.trim_start_matches('#').trim().to_lowercase().replace(' ', "-");
                heading.chars().filter(is_kept).collect()
            };
            assert!(section.is_empty() || headings.map(anchor).any(|anchor| anchor == section), "{name}");
        }
    }
}
