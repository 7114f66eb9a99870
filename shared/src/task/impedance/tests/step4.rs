//! Step 4 of the paper as printed and with its missing terms; the impedance in axes of the tool.

use nalgebra::{SVector, Vector3, Vector6};

use super::fixture::{ArmFixture, POSTURES, SOFT, accelerations};
use crate::control::{Impedance, ImpedanceAxes};
use crate::kinematics::ElbowSetpoint;
use crate::task::impedance::{ArmMeasurement, DirectLaw, ImpedanceSettings, ImpedanceState, Law, Redundancy};

type Seven = [f32; 7];
/// Joint angles and velocities, acceleration of the tool, of the driven joint; joint accelerations as
/// printed, with the term of the driven joint, by the pseudo-inverse. From numpy
/// (`tests/oracles/arm_step4.py`).
type Case = (Seven, Seven, [f32; 6], f32, Seven, Seven, Seven);
#[allow(clippy::excessive_precision, reason = "the digits of the script")]
const CASES: &[Case] = include!("../../../../../tests/oracles/data/arm_step4.in");

/// Damping and stiffness 0: step 3 then gives the set-point's acceleration.
const FREE: Impedance = Impedance::diagonal([1.0; 6], [0.0; 6], [0.0; 6]);

/// Joint accelerations for a tool `acceleration` and a given acceleration of the driven joint.
fn resolved(case: &Case, redundancy: Redundancy, law: DirectLaw) -> SVector<f32, 7> {
    let (angles, velocities, acceleration, driven, ..) = case;
    let fixture = ArmFixture::new();
    let settings = ImpedanceSettings { impedance: FREE, law: Law::Direct(law), redundancy, ..SOFT };
    let mut state = fixture.state(&settings, angles);
    let mut point = fixture.point(angles);
    point.acceleration = *acceleration;
    // The elbow has no control error.
    let elbow = ElbowSetpoint { angle: angles[2], velocity: velocities[2], acceleration: *driven };
    state.set_target(&fixture.arm(), &point, &elbow).unwrap();
    let measurement =
        ArmMeasurement { angles: *angles, velocities: *velocities, ..ArmMeasurement::default() };
    accelerations(&state.tick(&fixture.arm(), &measurement).unwrap())
}

#[test]
fn step_4_is_that_of_the_paper_as_printed_and_with_its_missing_terms() {
    let driven = Redundancy::DrivenJoint { joint: 2 };
    let (printed, corrected) = (DirectLaw::PRINTED, DirectLaw::CORRECTED);
    for case in CASES {
        let (velocities, expected) = (SVector::from(case.1), [case.4, case.5, case.6].map(SVector::from));
        let close = |value: SVector<f32, 7>, expected: &SVector<f32, 7>| {
            assert!((value - expected).norm() < 1e-3 * expected.norm(), "{value} {expected}");
        };
        close(resolved(case, driven, printed), &expected[0]);
        close(resolved(case, driven, corrected), &expected[1]);
        close(resolved(case, Redundancy::None, printed), &expected[2]);
        // The damping, which the paper omits, acts against the motion, and only in the null space.
        let fixture = ArmFixture::new();
        let damping = resolved(case, Redundancy::None, corrected) - expected[2];
        assert!(damping.dot(&velocities) < 0.0 && damping.norm() > 1.0, "{damping}");
        assert!((fixture.jacobian(&case.0) * damping).norm() < 1e-3 * damping.norm());
    }
}

/// The elbow at 90°: the tool is at (0.36, 0, −0.3) from the axis of the yaw, which points up. Each radian
/// that the other joints do not compensate therefore moves the tool by (0, 0.36, 0) m and turns it by (0, 0,
/// 1).
#[test]
fn without_its_term_the_driven_joint_moves_the_hand() {
    let mut case = CASES[0];
    (case.1, case.2) = ([0.0; 7], [0.0; 6]);
    let fixture = ArmFixture::new();
    let driven = Redundancy::DrivenJoint { joint: 2 };
    let motion = fixture.jacobian(&case.0) * resolved(&case, driven, DirectLaw::PRINTED) / case.3;
    let expected = Vector6::new(0.0, 0.36, 0.0, 0.0, 0.0, 1.0);
    assert!((motion - expected).norm() < 1e-4, "{motion}");
    let motion = fixture.jacobian(&case.0) * resolved(&case, driven, DirectLaw::CORRECTED) / case.3;
    assert!(motion.norm() < 1e-4, "{motion}");
}

#[test]
fn the_direct_law_compensates_the_fraction_of_friction_in_its_settings() {
    let fixture = ArmFixture::new();
    for friction in [0.0, 0.6, 1.0] {
        let law = Law::Direct(DirectLaw { friction, ..DirectLaw::CORRECTED });
        let mut state = fixture.state(&ImpedanceSettings { law, ..SOFT }, &POSTURES[0]);
        let measurement = ArmMeasurement { angles: POSTURES[0], ..ArmMeasurement::default() };
        assert_eq!(state.tick(&fixture.arm(), &measurement).unwrap().friction, friction);
    }
    for friction in [-0.1, 1.01, f32::NAN] {
        let law = Law::Direct(DirectLaw { friction, ..DirectLaw::CORRECTED });
        let refused = ImpedanceSettings { law, ..SOFT }.validate(7).unwrap_err().to_string();
        let expected =
            format!("the compensated fraction of the friction is {friction}; it must be from 0 to 1");
        assert_eq!(refused, expected);
    }
}

/// Stiff along z of the tool, 1000 N/m, soft along x and y, 100 N/m; the tool is rotated.
fn along_the_tool() -> ImpedanceSettings {
    let mut settings = ImpedanceSettings { law: Law::Direct(DirectLaw::CORRECTED), ..SOFT };
    settings.impedance.mass[..3].fill(2.0);
    settings.impedance.stiffness[..3].copy_from_slice(&[100.0, 100.0, 1000.0]);
    settings.impedance.axes = ImpedanceAxes::Tool;
    settings
}

/// Acceleration of a tool at rest with a displaced set-point.
fn tool_acceleration(state: &mut ImpedanceState, displacement: &Vector3<f32>) -> Vector3<f32> {
    let fixture = ArmFixture::new();
    let mut point = fixture.point(&POSTURES[2]);
    point.position = (Vector3::from(point.position) + displacement).into();
    let measurement = ArmMeasurement { angles: POSTURES[2], ..ArmMeasurement::default() };
    let elbow = state.telemetry(&fixture.arm(), &measurement, &fixture.chain.posture(&POSTURES[2])).elbow;
    let elbow = ElbowSetpoint { angle: elbow, ..ElbowSetpoint::default() };
    state.set_target(&fixture.arm(), &point, &elbow).unwrap();
    let joints = accelerations(&state.tick(&fixture.arm(), &measurement).unwrap());
    (fixture.jacobian(&POSTURES[2]) * joints).fixed_rows::<3>(0).into_owned()
}

#[test]
fn the_impedance_may_be_that_along_the_axes_of_the_tool() {
    let fixture = ArmFixture::new();
    let posture = fixture.chain.posture(&POSTURES[2]);
    let [across, _, along] = [0, 1, 2].map(|axis| posture.tip().rotation.matrix().column(axis).into_owned());
    let mut state = fixture.state(&along_the_tool(), &POSTURES[2]);
    let a = tool_acceleration(&mut state, &(along * 0.01));
    // 1000 N/m · 0.01 m / 2 kg, 100 N/m · 0.01 m / 2 kg.
    assert!((a - along * 5.0).norm() < 1e-3, "{a}");
    let a = tool_acceleration(&mut state, &(across * 0.01));
    assert!((a - across * 0.5).norm() < 1e-3, "{a}");
}

#[test]
fn a_change_of_the_axes_does_not_step_the_acceleration() {
    let fixture = ArmFixture::new();
    let shift = Vector3::new(0.01, -0.02, 0.015);
    let tool = along_the_tool();
    let mut base = tool;
    base.impedance.axes = ImpedanceAxes::Base;
    for (from, to) in [(tool, base), (base, tool)] {
        let mut state = fixture.state(&from, &POSTURES[2]);
        let before = tool_acceleration(&mut state, &shift);
        let mut other = fixture.state(&to, &POSTURES[2]);
        let goal = tool_acceleration(&mut other, &shift);
        state.configure(&fixture.arm(), &to).unwrap();
        let after = tool_acceleration(&mut state, &shift);
        // A tick blends in a twentieth; the mass is the same along all axes.
        let expected = before + (goal - before) * 0.05;
        assert!((goal - before).norm() > 1.0 && (after - expected).norm() < 2e-3, "{after} {expected}");
        for _ in 0..400 {
            tool_acceleration(&mut state, &shift);
        }
        let reached = tool_acceleration(&mut state, &shift);
        assert!((reached - goal).norm() < 1e-3, "{reached} {goal}");
    }
}
