use super::*;
use crate::test_support::joint as test_joint;

fn refused(mass: f32, inertia: [f32; 6]) -> Option<ModelError> {
    let joint =
        JointModel { link: Inertial { mass, center_of_mass: [0.0; 3], inertia }, ..test_joint("elbow") };
    joint.validate(Check { joint: Some(4) }).err()
}

#[test]
fn masses_that_no_body_has_are_refused_with_joint_field_and_margin() {
    let expect = |error: Option<ModelError>, field: Field, problem: Problem, value: f32| {
        let error = error.unwrap_or_else(|| panic!("{field:?} {problem:?}: accepted"));
        assert_eq!((error.joint, error.field, error.problem), (Some(4), field, problem));
        assert!((error.value - value).abs() < 1e-6, "{error}");
    };
    let rod = [1e-4, 2e-3, 2e-3, 0.0, 0.0, 0.0];
    expect(refused(-0.5, rod), Field::Mass, Problem::Below(0.0), -0.5);
    // A negative principal moment: on the diagonal, and only off it.
    let negative = [-1e-3, 2e-3, 2e-3, 0.0, 0.0, 0.0];
    expect(refused(0.5, negative), Field::Inertia, Problem::NotPhysical, -1e-3);
    // xy = 3e-3: principal moments 2e-3 and 2e-3 ± 3e-3; half the trace less the largest is −2e-3.
    let indefinite = [2e-3, 2e-3, 2e-3, 3e-3, 0.0, 0.0];
    expect(refused(0.5, indefinite), Field::Inertia, Problem::NotPhysical, -2e-3);
    // The triangle inequality: 9e-3 is more than 2e-3 + 2e-3, by 5e-3; the margin is half of that.
    let triangle = [9e-3, 2e-3, 2e-3, 0.0, 0.0, 0.0];
    expect(refused(0.5, triangle), Field::Inertia, Problem::NotPhysical, -2.5e-3);
    for value in [f32::NAN, f32::INFINITY] {
        let error =
            refused(0.5, [value, 2e-3, 2e-3, 0.0, 0.0, 0.0]).map(|error| (error.field, error.problem));
        assert_eq!(error, Some((Field::Inertia, Problem::NotFinite)));
    }
}

#[test]
fn an_axis_must_be_a_unit_vector_as_it_is_not_normalised() {
    let validated = |length: f32| {
        let joint = JointModel { axis: [0.6 * length, 0.0, 0.8 * length], ..test_joint("elbow") };
        joint.validate(Check { joint: Some(4) })
    };
    assert_eq!(validated(1.0), Ok(()));
    for length in [1.0001, 0.9999] {
        let error = validated(length).expect_err("accepted");
        assert_eq!((error.joint, error.field, error.problem), (Some(4), Field::Axis, Problem::NotUnit));
        assert!((error.value - length).abs() < 1e-6, "{error}");
    }
}

#[test]
fn values_that_no_robot_has_are_refused_with_their_bound() {
    let mut robot = crate::test_support::finger();
    let refused = |change: &dyn Fn(&mut RobotModel), field: Field, limit: f32| {
        let mut robot = robot.clone();
        change(&mut robot);
        let error = robot.validate().expect_err("accepted");
        assert_eq!((error.field, error.problem), (field, Problem::Above(limit)), "{error}");
    };
    refused(&|robot| robot.joints[0].servo.observer.inertia = 3e38, Field::ServoInertia, 1e4);
    refused(&|robot| robot.joints[0].limits.torque = 1e30, Field::LimitTorque, 1e6);
    refused(&|robot| robot.joints[0].limits.velocity = 158.0, Field::LimitVelocity, MAX_VELOCITY);
    refused(&|robot| robot.safety.command_timeout = 1e30, Field::CommandTimeout, 10.0);
    refused(&|robot| robot.safety.damping = 1e30, Field::Damping, 1e6);
    refused(&|robot| robot.safety.supply_max = 66.0, Field::SupplyMax, 65.534);
    refused(&|robot| robot.gravity = [0.0, 0.0, 1e30], Field::Gravity, 100.0);
    robot.gravity = [0.0, -1e30, 0.0];
    assert_eq!(robot.validate().expect_err("accepted").problem, Problem::Below(-100.0));
}

/// A sensor frame has 16 bits for a current and for the supply.
#[test]
fn currents_and_voltages_that_a_sensor_frame_cannot_tell_of_are_no_limits() {
    let robot = crate::test_support::finger();
    let with = |change: &dyn Fn(&mut RobotModel)| {
        let mut robot = robot.clone();
        change(&mut robot);
        robot.validate().map_err(|error| (error.joint, error.field))
    };
    // 32 767 counts of 1 mA are 1.25 times 26.2136 A: 26.2 A can be exceeded, 26.22 A cannot.
    assert_eq!(with(&|robot| robot.joints[1].motor.current_limit = 26.2), Ok(()));
    let current = Err((Some(1), Field::CurrentLimit));
    assert_eq!(with(&|robot| robot.joints[1].motor.current_limit = 26.22), current);
    assert_eq!(with(&|robot| robot.joints[1].motor.current_resolution = 5e-5), current);
    assert_eq!(with(&|robot| robot.safety.supply_max = 65.534), Ok(()));
    assert_eq!(with(&|robot| robot.safety.supply_max = 65.535), Err((None, Field::SupplyMax)));
}

/// 2³¹ counts, at 10⁹ per turn, are 13.4932 rad. They must cover the limits, 0.2 rad of following error and
/// 0.16 rad of a jump.
#[test]
fn an_angle_that_has_no_count_is_no_limit() {
    let mut joint = test_joint("wrist");
    joint.encoder.counts_per_turn = 1e9;
    let with = |lower: f32, upper: f32| {
        let limits = JointLimits { lower, upper, ..joint.limits };
        let error = JointModel { limits, ..joint.clone() }.validate(Check { joint: Some(0) }).err()?;
        Some(error.field)
    };
    assert_eq!(with(-13.1, 13.1), None);
    assert_eq!(with(-1.0, 13.2), Some(Field::CountsPerTurn));
    assert_eq!(with(-13.2, 1.0), Some(Field::CountsPerTurn));
}

#[test]
fn rods_plates_points_and_cut_digits_are_bodies() {
    let plate = [1e-3, 1e-3, 2e-3, 0.0, 0.0, 0.0];
    let cut = [1e-3, 1e-3, 2.001e-3, 0.0, 0.0, 0.0];
    for inertia in [plate, cut, [0.0, 1e-3, 1e-3, 0.0, 0.0, 0.0], [0.0; 6]] {
        assert_eq!(refused(0.5, inertia), None, "{inertia:?}");
    }
}

/// Calibration matrix, resolutions, readings, independence of the rows; see the data file.
type Sensor = ([[f32; 6]; 6], [f32; 2], &'static [([i32; 6], [f64; 6])], f32);
const SENSORS: &[Sensor] = include!("../../../tests/oracles/data/gauges.in");

fn refused_gauges(calibration_matrix: [[f32; 6]; 6], gains: [u8; 6]) -> Option<(Field, Problem)> {
    let gauges = Gauges { chain: 0, calibration_matrix, gains };
    let error = gauges.validate(Check { joint: Some(2) }, 10.0).err()?;
    assert_eq!(error.joint, Some(2));
    Some((error.field, error.problem))
}

#[test]
fn the_independence_of_rows_is_that_of_numpy() {
    for (matrix, .., expected) in SENSORS {
        assert!((independence(matrix) - expected).abs() < 1e-5, "{}", independence(matrix));
        assert_eq!(refused_gauges(*matrix, [128; 6]), None);
        // The gains of the gauges do not matter.
        let mut scaled = *matrix;
        for row in &mut scaled {
            let gains = [1.0, 8.0, 128.0, 1e-3, 1.0, 2.0];
            row.iter_mut().zip(gains).for_each(|(value, gain)| *value *= gain);
        }
        assert!((independence(&scaled) - expected).abs() < 1e-5, "{}", independence(&scaled));
    }
}

#[test]
fn calibration_matrices_that_no_sensor_has_are_refused() {
    let (matrix, ..) = SENSORS[0];
    let with = |change: &dyn Fn(&mut [[f32; 6]; 6])| {
        let mut changed = matrix;
        change(&mut changed);
        refused_gauges(changed, [128; 6])
    };
    let singular = Some((Field::CalibrationMatrix, Problem::Singular));
    assert_eq!(with(&|rows| rows[4] = [0.0; 6]), singular);
    assert_eq!(with(&|rows| rows.iter_mut().for_each(|row| row[3] = 0.0)), singular);
    assert_eq!(with(&|rows| rows[1] = rows[0].map(|value| 2.0 * value)), singular);
    assert_eq!(with(&|rows| rows.iter_mut().for_each(|row| row[5] = -row[2])), singular);
    let nearly = |part: f32| {
        with(&|rows| {
            let mixed = core::array::from_fn(|gauge| rows[3][gauge] + part * rows[4][gauge]);
            rows[4] = mixed;
        })
    };
    assert_eq!(nearly(1e-3), singular);
    assert_eq!(nearly(0.5), None);
    let not_finite = Some((Field::CalibrationMatrix, Problem::NotFinite));
    assert_eq!(with(&|rows| rows[5][5] = f32::NAN), not_finite);
    // In millinewtons for a hundredth of the range; in volts.
    let range = |factor: f32| {
        with(&|rows| rows.iter_mut().flatten().for_each(|value| *value *= factor)).map(|(field, _)| field)
    };
    assert_eq!(range(1.0), None);
    assert_eq!(range(0.01), Some(Field::GaugeRange));
    assert_eq!(range(7e6), Some(Field::GaugeRange));
}

#[test]
fn gains_are_powers_of_two_up_to_128() {
    let (matrix, ..) = SENSORS[0];
    let with = |gain: u8| refused_gauges(matrix, [1, 2, 4, 64, 128, gain]);
    assert_eq!(with(8), None);
    assert_eq!(with(0), Some((Field::GaugeGains, Problem::Below(1.0))));
    assert_eq!(with(3), Some((Field::GaugeGains, Problem::NotSupported)));
    assert_eq!(with(255), Some((Field::GaugeGains, Problem::Above(128.0))));
}

#[test]
fn gauges_need_a_chain_with_a_force_sensor() {
    let mut model = crate::test_support::finger();
    let gauges = |chain| Gauges { chain, calibration_matrix: SENSORS[0].0, gains: [128; 6] };
    model.gauges = Some(gauges(1));
    let stray = ModelError { joint: None, field: Field::Gauges, value: 1.0, problem: Problem::NotSupported };
    assert_eq!(model.validate(), Err(stray));
    model.gauges = Some(gauges(0));
    assert_eq!(model.validate(), Err(ModelError { joint: Some(2), value: 0.0, ..stray }));
    model.chains[0].force_sensor = Some(crate::test_support::FORCE_SENSOR);
    assert_eq!(model.validate(), Ok(()));
}
