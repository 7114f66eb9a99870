//! Findings about joints: what is the same for several of them is said once.

use crate::finding::Report;

/// What is said of joints in `controller.toml`, with the names of those of which the same is said.
#[derive(Default)]
pub struct OfJoints(Vec<(JointFinding, Vec<String>)>);

/// Something that is said of a joint.
#[derive(PartialEq, Eq)]
struct JointFinding {
    is_error: bool,
    line: Option<usize>,
    message: String,
    advice: String,
}

impl OfJoints {
    /// Something about a joint that does not work.
    pub fn error(&mut self, joint: &str, line: Option<usize>, message: String, advice: impl Into<String>) {
        self.add(joint, JointFinding { is_error: true, line, message, advice: advice.into() });
    }

    /// Something about a joint that deserves attention.
    pub fn warning(&mut self, joint: &str, line: Option<usize>, message: String, advice: impl Into<String>) {
        self.add(joint, JointFinding { is_error: false, line, message, advice: advice.into() });
    }

    fn add(&mut self, joint: &str, finding: JointFinding) {
        let name = joint.to_owned();
        match self.0.iter_mut().find(|(known, _)| *known == finding) {
            Some((_, names)) => names.push(name),
            None => self.0.push((finding, vec![name])),
        }
    }

    /// Reports each finding once, with all joints of which it is true.
    pub fn report(self, settings: &mut Report) {
        for (JointFinding { is_error, line, message, advice }, names) in self.0 {
            let plural = if names.len() > 1 { "s" } else { "" };
            let message = format!("joint{plural} {}: {message}", names.join(", "));
            if is_error {
                settings.dynamics(line, message, advice);
            } else {
                settings.warning(line, message, advice);
            }
        }
    }
}
