use super::tuning::NORMAL_TOLERANCE;
use super::*;
use crate::control::ServoMode;

/// A box of 80 mm between fingers 1 and 2, 60 mm apart, and finger 3 opposite the middle between them.
fn plan() -> GraspPlan {
    let contact = |position, normal| PlannedContact { position, normal };
    GraspPlan {
        contacts: [
            contact([-0.04, 0.03, 0.1], [2.0, 0.0, 0.0]),
            contact([-0.04, -0.03, 0.1], [1.0, 0.0, 0.0]),
            contact([0.04, 0.0, 0.1], [-0.5, 0.0, 0.0]),
        ],
        clearance: 0.01,
        touch_force: 0.1,
        friction: Some(0.5),
        internal: least_grip(0.2, 0.3, 1.0),
        force_limit: 9.0,
        feedback: true,
        control: ObjectControl::Differential(ServoMode::Observer),
        object_frame: ObjectFrame::Rolling,
        load: LoadSource::Measured,
        joint_targets: JointTargets::ClosedForm,
    }
}

const NORMAL: InternalForce = InternalForce::Normal { strength: 2.0 };
const PAIRWISE: InternalForce = InternalForce::Pairwise { strengths: [1.0, 1.0, 0.1] };
const GAINS: WrenchGains =
    WrenchGains { position: [150.0, 300.0], orientation: [0.5, 1.0], damping: 0.03, compensated: true };

const fn least_grip(margin: f32, capacity_at_rest: f32, capacity_in_motion: f32) -> InternalForce {
    InternalForce::LeastGrip { margin, capacity_at_rest, capacity_in_motion }
}

fn wrench(change: fn(&mut WrenchGains)) -> ObjectControl {
    let mut gains = GAINS;
    change(&mut gains);
    ObjectControl::Wrench(gains)
}

#[test]
fn plans_may_combine_every_internal_force_and_control() {
    for internal in [plan().internal, NORMAL, PAIRWISE] {
        for control in [plan().control, ObjectControl::Wrench(GAINS)] {
            for friction in [Some(0.5), Some(3.0), None] {
                assert_eq!(GraspPlan { internal, control, friction, ..plan() }.validate(), Ok(()));
            }
        }
    }
    // The limits are included.
    let max = least_grip(0.9, 4.5, 4.5);
    let far = GraspPlan { clearance: 0.05, touch_force: 4.5, internal: max, ..plan() };
    assert_eq!(far.validate(), Ok(()));
    let none = InternalForce::Pairwise { strengths: [0.0; 3] };
    assert_eq!(GraspPlan { clearance: 0.001, internal: none, ..plan() }.validate(), Ok(()));
}

type Change = fn(&mut GraspPlan);

#[test]
fn values_outside_their_range_are_refused_with_field_and_range() {
    let cases: &[(Change, PlanField, f32, f32, f32)] = &[
        (|p| p.clearance = 0.0, PlanField::Clearance, 0.0, 0.001, 0.05),
        (|p| p.clearance = 0.06, PlanField::Clearance, 0.06, 0.001, 0.05),
        (|p| p.force_limit = 200.0, PlanField::ForceLimit, 200.0, 0.1, 100.0),
        (|p| p.touch_force = 0.01, PlanField::TouchForce, 0.01, 0.02, 4.5),
        (|p| p.touch_force = 5.0, PlanField::TouchForce, 5.0, 0.02, 4.5),
        (|p| p.friction = Some(0.0), PlanField::Friction, 0.0, 0.05, 3.0),
        (|p| p.friction = Some(f32::INFINITY), PlanField::Friction, f32::INFINITY, 0.05, 3.0),
        (|p| p.load = LoadSource::Constant { mass: 5.5 }, PlanField::Mass, 5.5, 0.0, 5.0),
        (|p| p.load = LoadSource::Constant { mass: -0.1 }, PlanField::Mass, -0.1, 0.0, 5.0),
        (|p| p.internal = least_grip(1.0, 0.3, 1.0), PlanField::Margin, 1.0, 0.0, 0.9),
        (|p| p.internal = least_grip(0.2, -0.5, 1.0), PlanField::Capacity, -0.5, 0.0, 4.5),
        (|p| p.internal = least_grip(0.2, 0.5, 0.25), PlanField::Capacity, 0.25, 0.5, 4.5),
        (
            |p| (p.friction, p.internal) = (Some(0.05), least_grip(0.2, 0.25, 1.0)),
            PlanField::Capacity,
            1.0,
            0.25,
            0.05 * 9.0,
        ),
        (|p| p.internal = InternalForce::Normal { strength: 10.0 }, PlanField::Strength, 10.0, 0.0, 9.0),
        (
            |p| p.internal = InternalForce::Pairwise { strengths: [1.0, 1.0, -1.0] },
            PlanField::Strength,
            -1.0,
            0.0,
            9.0,
        ),
        (|p| p.control = wrench(|g| g.position[0] = -1.0), PlanField::Gain, -1.0, 0.0, 1e4),
        (|p| p.control = wrench(|g| g.position[1] = 2e5), PlanField::Gain, 2e5, 0.0, 1e5),
        (|p| p.control = wrench(|g| g.orientation[0] = 200.0), PlanField::Gain, 200.0, 0.0, 1e2),
        (|p| p.control = wrench(|g| g.orientation[1] = 2e3), PlanField::Gain, 2e3, 0.0, 1e3),
        (|p| p.control = wrench(|g| g.damping = 1.5), PlanField::Gain, 1.5, 0.0, 1.0),
    ];
    for &(change, field, value, lower, upper) in cases {
        let mut plan = plan();
        change(&mut plan);
        assert_eq!(plan.validate(), Err(InvalidPlan::Value { field, value, lower, upper }), "{plan:?}");
    }
}

#[test]
fn values_that_are_not_numbers_are_refused() {
    for change in [
        (|p| p.clearance = f32::NAN) as Change,
        |p| p.force_limit = f32::NAN,
        |p| p.touch_force = f32::NAN,
        |p| p.friction = Some(f32::NAN),
        |p| p.internal = InternalForce::Normal { strength: f32::NAN },
        |p| p.control = wrench(|gains| gains.damping = f32::NAN),
    ] {
        let mut plan = plan();
        change(&mut plan);
        assert!(
            matches!(plan.validate(), Err(InvalidPlan::Value { value, .. }) if value.is_nan()),
            "{plan:?}"
        );
    }
}

#[test]
fn contacts_without_a_position_or_a_direction_are_refused() {
    for change in [
        (|c| c.position[1] = f32::NAN) as fn(&mut PlannedContact),
        |c| c.position[0] = f32::INFINITY,
        |c| c.normal = [0.0; 3],
        |c| c.normal[2] = f32::NAN,
    ] {
        for finger in 0..3_u8 {
            let mut plan = plan();
            change(&mut plan.contacts[usize::from(finger)]);
            assert_eq!(plan.validate(), Err(InvalidPlan::Contact { finger }), "{plan:?}");
        }
    }
}

#[test]
fn contacts_in_line_or_at_the_same_position_are_no_triangle() {
    for internal in [plan().internal, NORMAL, PAIRWISE] {
        let mut in_line = GraspPlan { internal, ..plan() };
        in_line.contacts[2].position = [-0.04, 0.0, 0.1];
        assert_eq!(in_line.validate(), Err(InvalidPlan::NoTriangle));
        let mut same = GraspPlan { internal, ..plan() };
        same.contacts[1].position = same.contacts[0].position;
        assert_eq!(same.validate(), Err(InvalidPlan::NoTriangle));
        same.contacts[2].position = same.contacts[0].position;
        assert_eq!(same.validate(), Err(InvalidPlan::NoTriangle));
    }
}

#[test]
fn contacts_whose_friction_cones_cannot_balance_are_refused() {
    for internal in [plan().internal, PAIRWISE] {
        let mut parallel = GraspPlan { internal, ..plan() };
        parallel.contacts[2].normal = [1.0, 0.0, 0.0];
        assert_eq!(parallel.validate(), Err(InvalidPlan::CannotGrip), "{internal:?}");
    }
    // Finger 3 is 60 mm beside finger 1 and 80 mm opposite it: a friction of 0.75 is enough to grip with
    // these two.
    let mut beside = plan();
    beside.contacts[2].position[1] = 0.09;
    (beside.friction, beside.internal) = (Some(0.05), least_grip(0.2, 0.1, 0.2));
    assert_eq!(beside.validate(), Err(InvalidPlan::CannotGrip));
    beside.friction = Some(2.0);
    assert_eq!(beside.validate(), Ok(()));
    // The margin leaves 0.72 and 0.81 of a friction of 0.9.
    for (margin, possible) in [(0.2, false), (0.1, true)] {
        (beside.friction, beside.internal) = (Some(0.9), least_grip(margin, 0.1, 0.2));
        assert_eq!(beside.validate().is_ok(), possible, "{margin}: {:?}", beside.validate());
    }
}

/// Finger 1 presses with e₁₃ = (0.936, −0.351) along the normal x, and with s along −y: (0.351 + s)/0.936 is
/// 0.48, 0.91 and 1.44.
#[test]
fn forces_between_pairs_must_be_inside_the_friction_cones() {
    for (strength, friction, possible) in [
        (0.1, Some(0.5), true),
        (0.5, Some(0.5), false),
        (0.5, Some(0.92), true),
        (0.5, None, true),
        (1.0, None, false),
        (1.0, Some(1.5), true),
    ] {
        let internal = InternalForce::Pairwise { strengths: [1.0, 1.0, strength] };
        let expected = if possible { Ok(()) } else { Err(InvalidPlan::CannotGrip) };
        assert_eq!(GraspPlan { internal, friction, ..plan() }.validate(), expected, "{strength}");
    }
}

#[test]
fn forces_along_the_normals_must_balance() {
    // Normals along x, x and between −x and z do not balance.
    let mut across = GraspPlan { internal: NORMAL, ..plan() };
    across.contacts[2].normal = [-1.0, 0.0, 1.0];
    let Err(InvalidPlan::Unbalanced { residual }) = across.validate() else {
        panic!("{:?}", across.validate())
    };
    assert!(residual > NORMAL_TOLERANCE && residual < 1.0, "{residual}");
    // Within the error of measured contacts they do.
    across.contacts[2].normal = [-1.0, 0.0, 0.05];
    assert_eq!(across.validate(), Ok(()));
    // Other forms do not need balance along the normals.
    across.contacts[2].normal = [-1.0, 0.0, 0.3];
    assert!(matches!(across.validate(), Err(InvalidPlan::Unbalanced { .. })));
    assert_eq!(GraspPlan { internal: PAIRWISE, ..across }.validate(), Ok(()));
}

#[test]
fn texts_of_invalid_plans_name_value_unit_and_range() {
    let value = |field, value, lower, upper| InvalidPlan::Value { field, value, lower, upper }.to_string();
    let texts = [
        (PlanField::Clearance, "the clearance is 2 m; the range is 0.5 to 1 m"),
        (PlanField::TouchForce, "the touch force is 2 N; the range is 0.5 to 1 N"),
        (PlanField::ForceLimit, "the force limit is 2 N; the range is 0.5 to 1 N"),
        (PlanField::Capacity, "the minimum tangential capacity is 2 N; the range is 0.5 to 1 N"),
        (PlanField::Strength, "the internal force is 2 N; the range is 0.5 to 1 N"),
    ];
    for (field, text) in texts {
        assert_eq!(value(field, 2.0, 0.5, 1.0), text);
    }
    for (field, name) in [
        (PlanField::Friction, "coefficient of friction"),
        (PlanField::Margin, "friction margin"),
        (PlanField::Gain, "gain"),
    ] {
        assert_eq!(value(field, 2.0, 0.5, 1.0), format!("the {name} is 2; the range is 0.5 to 1"));
    }
    assert_eq!(
        InvalidPlan::Contact { finger: 0 }.to_string(),
        "the contact of finger 1: its position or normal is not finite, or its normal is 0"
    );
    assert_eq!(
        InvalidPlan::NoTriangle.to_string(),
        "the contacts coincide or are collinear: place them on a triangle"
    );
    assert_eq!(
        InvalidPlan::CannotGrip.to_string(),
        "no contact forces of this form inside the friction cones balance each other: the normals must oppose \
         each other, and pairwise forces press along them: set those between fingers at the same side to 0, or \
         choose another internal force"
    );
    assert_eq!(
        InvalidPlan::Unbalanced { residual: 0.25 }.to_string(),
        "forces along the normals do not balance, the residual is 0.25 of the forces: place finger 3 \
         opposite fingers 1 and 2, or choose another internal force"
    );
}
