//! References to the entries of `docs/troubleshooting.md`, which explains every fault and every refusal.

use core::fmt::Debug;

use tesaki::fault::FaultCause;
use tesaki::protocol::Refusal;
use tesaki::task::TaskRefusal;
use tesaki::task::grasping::GraspRefusal;
use tesaki::task::impedance::ImpedanceRefusal;
use tesaki::task::joint_servo::JointServoRefusal;

/// The document.
pub const DOCUMENT: &str = "docs/troubleshooting.md";
const TEXT: &str = include_str!("../../docs/troubleshooting.md");

/// Returns the entry of a fault, such as `docs/troubleshooting.md#fault-3-followingerror`.
pub fn fault(cause: FaultCause) -> String {
    entry("FaultCause", &cause)
}

/// The document's explanation of a fault, each part as one line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Explanation {
    /// Description of the event.
    pub what: String,
    /// Likely causes.
    pub likely: String,
    /// What to do.
    pub remedy: String,
}

/// Returns the text of a fault's entry.
pub fn explanation(cause: FaultCause) -> Explanation {
    let heading = format!("### Fault {}: ", cause.number());
    let entry = TEXT.split_once(&heading).map_or("", |(_, rest)| rest);
    let entry = entry.split_once('\n').map_or("", |(_, body)| body);
    let entry = entry.split("\n#").next().unwrap_or_default();
    // Markdown's line breaks and backticks are removed.
    let line = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ").replace('`', "");
    let (entry, remedy) = entry.split_once("- *Do:*").unwrap_or((entry, ""));
    let (what, likely) = entry.split_once("- *Likely:*").unwrap_or((entry, ""));
    Explanation { what: line(what), likely: line(likely), remedy: line(remedy) }
}

/// Returns the entry of a refusal. If it contains another refusal or a fault, returns the entry of the inner
/// one.
pub fn refusal(refusal: &Refusal) -> String {
    match refusal {
        // The limit is another one than that of the fault.
        Refusal::Unsafe(inner) if inner.cause == FaultCause::VelocityLimit => entry("Refusal", refusal),
        Refusal::Unsafe(inner) => fault(inner.cause),
        Refusal::Limit(limit) => entry("LimitRefusal", limit),
        Refusal::Model(error) => entry("Problem", &error.problem),
        Refusal::Task(refusal) => task_refusal(refusal),
        other => entry("Refusal", other),
    }
}

fn task_refusal(refusal: &TaskRefusal) -> String {
    match refusal {
        TaskRefusal::JointServo(JointServoRefusal::Limit(limit)) => entry("LimitRefusal", limit),
        TaskRefusal::JointServo(refusal) => entry("JointServoRefusal", refusal),
        TaskRefusal::Grasping(refusal) => grasp_refusal(refusal),
        TaskRefusal::Impedance(refusal) => impedance_refusal(refusal),
        TaskRefusal::Telexistence(refusal) => entry("TelexistenceRefusal", refusal),
        TaskRefusal::VisualApproach(refusal) => entry("VisualApproachRefusal", refusal),
    }
}

/// Returns the entry of a refused grasp command.
pub fn grasp_refusal(refusal: &GraspRefusal) -> String {
    match refusal {
        GraspRefusal::Plan(plan) => entry("InvalidPlan", plan),
        other => entry("GraspRefusal", other),
    }
}

fn impedance_refusal(refusal: &ImpedanceRefusal) -> String {
    match refusal {
        ImpedanceRefusal::Settings(settings) => entry("InvalidImpedanceSettings", settings),
        ImpedanceRefusal::Setpoint(setpoint) => entry("SetpointError", setpoint),
        other => entry("ImpedanceRefusal", other),
    }
}

/// Returns the entry of a variant in the section of its enumeration; the document alone if there is no such
/// entry.
fn entry(section: &str, variant: &impl Debug) -> String {
    let debug = format!("{variant:?}");
    let name = debug.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default();
    let mut is_in_section = false;
    for heading in headings(TEXT) {
        match heading.level {
            2 => is_in_section = heading.name == section,
            _ if is_in_section && heading.name == name => return format!("{DOCUMENT}#{}", heading.anchor),
            _ => {}
        }
    }
    DOCUMENT.to_owned()
}

struct Heading<'a> {
    level: usize,
    /// The text between backticks.
    name: &'a str,
    anchor: String,
}

/// Returns the headings of a Markdown document with GitHub's anchors: lower case, without punctuation, spaces
/// as hyphens; a repeated anchor is numbered.
fn headings(text: &str) -> Vec<Heading<'_>> {
    let mut slugs: Vec<String> = Vec::new();
    let mut headings = Vec::new();
    for line in text.lines().filter(|line| line.starts_with('#')) {
        let title = line.trim_start_matches('#');
        let level = line.len() - title.len();
        let kept = title.trim().to_lowercase().replace(' ', "-");
        let slug: String = kept.chars().filter(|c| c.is_alphanumeric() || matches!(c, '-' | '_')).collect();
        let repeats = slugs.iter().filter(|other| **other == slug).count();
        let anchor = if repeats == 0 { slug.clone() } else { format!("{slug}-{repeats}") };
        slugs.push(slug);
        headings.push(Heading { level, name: title.split('`').nth(1).unwrap_or_default(), anchor });
    }
    headings
}

#[cfg(test)]
mod tests {
    use tesaki::fault::Fault;

    use super::*;

    #[test]
    fn faults_and_refusals_lead_to_their_entries() {
        let fault_entry = fault(FaultCause::FollowingError);
        assert_eq!(fault_entry, "docs/troubleshooting.md#fault-3-followingerror");
        assert_eq!(refusal(&Refusal::NoModel), "docs/troubleshooting.md#nomodel");
        let cause = FaultCause::EmergencyStop;
        let pressed = Refusal::Unsafe(Fault { cause, joint: None, value: 0.0, limit: 0.0, tick: 7 });
        assert_eq!(refusal(&pressed), "docs/troubleshooting.md#fault-9-emergencystop");
        let falling =
            Fault { cause: FaultCause::VelocityLimit, joint: Some(1), value: 2.0, limit: 1.0, tick: 7 };
        assert_eq!(refusal(&Refusal::Unsafe(falling)), "docs/troubleshooting.md#unsafe");
        let grasping = TaskRefusal::Grasping(GraspRefusal::NotAHand);
        assert_eq!(refusal(&Refusal::Task(grasping)), "docs/troubleshooting.md#notahand");
        // The name occurs in several sections.
        let grasping = TaskRefusal::Grasping(GraspRefusal::NotFinite);
        assert_eq!(refusal(&Refusal::Task(grasping)), "docs/troubleshooting.md#notfinite-1");
        let impedance = TaskRefusal::Impedance(ImpedanceRefusal::NoForceSensor);
        assert_eq!(refusal(&Refusal::Task(impedance)), "docs/troubleshooting.md#noforcesensor-1");
    }

    #[test]
    fn every_fault_says_what_to_do() {
        let stop = explanation(FaultCause::FollowingError);
        assert_eq!(stop.what, "A joint is more than limits.following_error from its reference.");
        assert!(stop.likely.starts_with("a blocked or overloaded joint, a torque limit"), "{stop:?}");
        assert!(stop.remedy.starts_with("move the joint by hand;"), "{stop:?}");
        let causes = (0..).map_while(|number: u8| postcard::from_bytes::<FaultCause>(&[number]).ok());
        for cause in causes {
            let Explanation { what, remedy, .. } = explanation(cause);
            assert!(!what.is_empty() && !remedy.is_empty(), "{cause:?}");
        }
    }

    #[test]
    fn anchors_are_unique() {
        let mut anchors: Vec<String> = headings(TEXT).into_iter().map(|heading| heading.anchor).collect();
        let count = anchors.len();
        anchors.sort_unstable();
        anchors.dedup();
        assert_eq!(anchors.len(), count);
        assert!(count > 90, "{count}");
    }
}
