use core::f32::consts::{FRAC_PI_2, PI};

use nalgebra::{Quaternion, UnitQuaternion, Vector1, Vector3};

use super::operator_estimate::OperatorEstimate;
use super::*;
use crate::kinematics::PosePoint;
use crate::signal::MotionLimits;
use crate::{TICK, math};

/// Time [µs] and position [m] of each sample; position, velocity and acceleration 25 ms later
/// (`tests/oracles/hand_estimate.py`).
const ESTIMATE: &[(u32, f64, [f64; 3])] = include!("../../../tests/oracles/data/hand_estimate.in");

const IDENTITY: [f32; 4] = [0.0, 0.0, 0.0, 1.0];
/// Delay of the link [µs].
const DELAY: u32 = 22_000;

#[test]
fn the_estimate_is_that_of_a_kalman_filter_in_double_precision() {
    let model = FollowerSettings::HUMAN.position_model;
    let mut known: Option<(u32, OperatorEstimate<1>)> = None;
    for &(time, sample, expected) in ESTIMATE {
        let place = Vector1::new(sample as f32);
        let estimate = match known {
            None => OperatorEstimate::new(&model, &place),
            Some((before, mut estimate)) => {
                estimate.advance(&model, (time - before) as f32 * 1e-6);
                estimate.correct(&model, &place);
                estimate
            }
        };
        let prediction = estimate.predict(0.025);
        let found = [prediction.position.x, prediction.velocity.x, prediction.acceleration.x].map(f64::from);
        for ((found, expected), tolerance) in found.into_iter().zip(expected).zip([2e-6, 2e-4, 2e-2]) {
            assert!((found - expected).abs() < tolerance, "{time}: {found} {expected}");
        }
        known = Some((time, estimate));
    }
    assert!(ESTIMATE.len() > 180);
}

/// A hand, a link with a constant delay, and a follower.
struct Run {
    follower: Follower,
    state: FollowerState,
    point: PosePoint,
    /// Number of samples.
    count: u32,
    now: u32,
    /// Maximum linear and angular acceleration.
    max_acceleration: [f32; 2],
}

type Pose = (Vector3<f32>, UnitQuaternion<f32>);

impl Run {
    /// Close to wrap-around of the clock.
    const START: u32 = u32::MAX - 900_000;

    fn new() -> Self {
        let follower = Follower::try_new(FollowerSettings::HUMAN).unwrap();
        let mut state = FollowerState::at([0.3, 0.1, -0.2], IDENTITY, 0.2);
        let point = follower.tick(&mut state, Instant(Self::START)).0;
        Self { follower, state, point, count: 0, now: 0, max_acceleration: [0.0; 2] }
    }

    fn now(&self) -> Instant {
        Instant(Self::START.wrapping_add(self.now))
    }

    fn take(&mut self, late: u32, (position, rotation): Pose) -> Result<(), FollowerError> {
        let time = Instant(self.now().0.wrapping_sub(late));
        let sample = MasterSample { time, position: position.into(), rotation: rotation.coords.into() };
        let now = self.now();
        self.follower.add_sample(&mut self.state, now, &sample)
    }

    fn close(&mut self) -> Result<(), FollowerError> {
        let now = self.now();
        self.follower.close_clutch(&mut self.state, now)
    }

    /// Runs until a time [s], with the hand as a function of time, and whether its sample of that time
    /// arrives.
    fn until(&mut self, end: f32, hand: &dyn Fn(f32) -> Pose, arrives: &dyn Fn(f32) -> bool) {
        while (self.now as f32) < end * 1e6 {
            self.now += 2000;
            // Every 4 ms, not synchronised to the ticks.
            if self.now.is_multiple_of(4000) && self.now > DELAY {
                let sampled = (self.now - DELAY) as f32 * 1e-6;
                if arrives(sampled) {
                    self.take(DELAY, hand(sampled)).unwrap();
                    self.count += 1;
                }
            }
            if self.now.is_multiple_of(10_000) {
                let before = self.point;
                let now = self.now();
                self.point = self.follower.tick(&mut self.state, now).0;
                let FollowerSettings { position_limits, rotation_limits, .. } = FollowerSettings::HUMAN;
                for (first, max_acceleration, limits) in [(0, 0, position_limits), (3, 1, rotation_limits)] {
                    let change = Vector3::from_fn(|axis, _| {
                        self.point.velocity[first + axis] - before.velocity[first + axis]
                    });
                    let change = change.norm() / TICK;
                    assert!(change <= 1.001 * limits.acceleration, "{change}");
                    self.max_acceleration[max_acceleration] =
                        self.max_acceleration[max_acceleration].max(change);
                }
            }
        }
    }

    fn place(&self) -> Vector3<f32> {
        self.point.position.into()
    }

    fn rotation(&self) -> UnitQuaternion<f32> {
        let [x, y, z, w] = self.point.rotation;
        UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z))
    }
}

fn resting(_: f32) -> Pose {
    (Vector3::new(0.5, 0.0, 0.0), UnitQuaternion::identity())
}

/// ±0.1 m and ±0.3 rad at half a hertz from 1 s on.
fn waving(time: f32) -> Pose {
    let fraction = if time > 1.0 { math::sin_cos(PI * (time - 1.0)).0 } else { 0.0 };
    let (place, _) = resting(time);
    (place + Vector3::x() * (0.1 * fraction), UnitQuaternion::new(Vector3::new(0.0, 0.2, 0.2236) * fraction))
}

fn always(_: f32) -> bool {
    true
}

/// A run with the clutch closed at 0.5 s.
fn following() -> Run {
    let mut run = Run::new();
    run.until(0.5, &resting, &always);
    run.close().unwrap();
    run
}

#[test]
fn the_setpoint_is_at_the_present_pose_of_the_hand() {
    let mut run = following();
    for step in 51..600_u16 {
        let time = f32::from(step) * TICK;
        run.until(time, &waving, &always);
        let (hand, turned) = waving(time);
        let error = run.place() - Vector3::new(0.3, 0.1, -0.2) - (hand - resting(0.0).0);
        // The motion begins with a velocity step, which is not physical.
        if time < 2.0 {
            run.max_acceleration = [0.0; 2];
        } else {
            assert!(error.norm() < 2e-4, "{time}: {error}");
            assert!(run.rotation().angle_to(&turned) < 1e-3, "{time}");
        }
    }
    // The accelerations of the hand are 1 m/s² and 3 rad/s².
    assert!(run.max_acceleration[0] < 1.1 && run.max_acceleration[1] < 3.3, "{:?}", run.max_acceleration);
}

#[test]
fn without_samples_the_setpoint_comes_to_rest_and_then_catches_up() {
    let mut run = following();
    let gap = |time: f32| !(1.98..2.4).contains(&time);
    run.until(2.0, &waving, &gap);
    let speed = Vector3::new(run.point.velocity[0], run.point.velocity[1], run.point.velocity[2]).norm();
    assert!((speed - 0.1 * PI).abs() < 5e-3, "{speed}");
    run.until(2.41, &waving, &gap);
    assert!(run.point.velocity.iter().all(|speed| speed.abs() < 0.02), "{:?}", run.point.velocity);
    // The estimator restarts after the gap; the hand is 43 mm from the set-point at rest.
    run.until(3.2, &waving, &gap);
    let error = run.place() - Vector3::new(0.3, 0.1, -0.2) - (waving(3.2).0 - resting(0.0).0);
    assert!(error.norm() < 5e-4, "{error}");
}

#[test]
fn invalid_samples_are_rejected_by_name_and_change_nothing() {
    let mut run = following();
    run.until(0.6, &resting, &always);
    let before = run.state;
    run.now += 1000;
    let (place, rotation) = resting(0.0);
    let far = run.take(DELAY - 2000, (place + Vector3::y(), rotation)).unwrap_err();
    assert_eq!(far.to_string(), "the hand is 1 m from its prediction; at most 0.1 m is accepted");
    let half = UnitQuaternion::new(Vector3::z() * 3.1);
    let twisted = run.take(DELAY - 2000, (place, half)).unwrap_err();
    assert!(
        matches!(twisted, FollowerError::Angle { value, limit: 0.5 } if (value - 3.1).abs() < 1e-4),
        "{twisted:?}"
    );
    assert_eq!(run.take(DELAY - 2000, (place * f32::NAN, rotation)), Err(FollowerError::NotFinite));
    let long = UnitQuaternion::new_unchecked(Quaternion::new(1.1, 0.0, 0.0, 0.0));
    assert_eq!(run.take(DELAY - 2000, (place, long)), Err(FollowerError::NotUnit { norm: 1.1 }));
    let future = run.take(0_u32.wrapping_sub(5000), (place, rotation)).unwrap_err();
    assert_eq!(future.to_string(), "the time of the sample is 0.005 s in the future: the clocks differ");
    assert_eq!(run.take(300_000, (place, rotation)), Err(FollowerError::Age { value: 0.3, limit: 0.2 }));
    let Err(FollowerError::OutOfOrder { by }) = run.take(DELAY + 20_000, (place, rotation)) else {
        panic!("taken")
    };
    assert!((by - 0.019).abs() < 4e-3, "{by}");
    assert_eq!(run.state, before);
    // With an open clutch the hand may be anywhere.
    run.follower.open_clutch(&mut run.state);
    assert_eq!(run.take(DELAY - 2000, (place + Vector3::y(), half)), Ok(()));
}

#[test]
fn with_an_open_clutch_the_tool_is_at_rest_and_closing_causes_no_jump() {
    let mut run = following();
    run.until(2.0, &waving, &always);
    run.follower.open_clutch(&mut run.state);
    run.until(2.3, &waving, &always);
    let stands = run.place();
    run.until(3.6, &waving, &always);
    assert!((run.place() - stands).norm() < 1e-5 && !run.state.is_clutch_closed());
    run.close().unwrap();
    let (hand, _) = waving(3.6 - DELAY as f32 * 1e-6);
    run.until(5.0, &waving, &always);
    let error = run.place() - stands - (waving(5.0).0 - hand);
    // The offset is that of the hand at the last sample.
    assert!(error.norm() < 5e-4, "{error}");
}

#[test]
fn rotation_is_about_base_axes_and_translation_is_scaled() {
    let settings = FollowerSettings { scale: 0.5, ..FollowerSettings::HUMAN };
    let mut run = Run::new();
    run.follower = Follower::try_new(settings).unwrap();
    let tool = UnitQuaternion::from_euler_angles(0.4, -0.3, 1.0);
    run.state = FollowerState::at([0.0; 3], tool.coords.into(), 0.0);
    let held = UnitQuaternion::from_euler_angles(-1.0, 0.2, 0.1);
    let hand = move |time: f32| {
        let fraction = (time - 1.0).clamp(0.0, 1.0);
        let turn = UnitQuaternion::new(Vector3::z() * (FRAC_PI_2 * fraction));
        (Vector3::x() * (0.2 * fraction), turn * held)
    };
    run.until(0.5, &hand, &always);
    run.close().unwrap();
    run.until(3.0, &hand, &always);
    let expected = UnitQuaternion::new(Vector3::z() * FRAC_PI_2) * tool;
    assert!(run.rotation().angle_to(&expected) < 1e-3, "{}", run.rotation().angle_to(&expected));
    assert!((run.place() - Vector3::x() * 0.1).norm() < 1e-4, "{}", run.place());
}

#[test]
fn the_elbow_follows_with_an_offset_and_needs_no_sensor() {
    let follower = Follower::try_new(FollowerSettings::HUMAN).unwrap();
    for sensor in [true, false] {
        let mut run = following();
        run.state.clone_from(&FollowerState::at([0.0; 3], IDENTITY, 0.2));
        let mut angle = f32::NAN;
        for tick in 0..300_u32 {
            let now = Instant(tick * 10_000);
            let sample = MasterSample { time: now, position: [0.0; 3], rotation: IDENTITY };
            follower.add_sample(&mut run.state, now, &sample).unwrap();
            let tilt = 0.5 + 0.3 * (tick as f32 * TICK - 1.0).clamp(0.0, 1.0);
            if sensor {
                follower.add_elbow_sample(&mut run.state, now, now, tilt).unwrap();
            }
            if tick == 50 {
                follower.close_clutch(&mut run.state, now).unwrap();
            }
            angle = follower.tick(&mut run.state, now).1.angle;
        }
        let expected = if sensor { 0.5 } else { 0.2 };
        assert!((angle - expected).abs() < 2e-3, "{angle}");
    }
}

#[test]
fn a_clutch_without_samples_stays_open_and_invalid_settings_are_named() {
    let mut run = Run::new();
    assert_eq!(run.close(), Err(FollowerError::NoSample));
    run.until(0.5, &resting, &always);
    run.now += 300_000;
    assert_eq!(run.close(), Err(FollowerError::NoSample));
    let bad = FollowerSettings { scale: 0.0, ..FollowerSettings::HUMAN };
    let error = Follower::try_new(bad).unwrap_err().to_string();
    assert_eq!(error, "scale is 0; it must be 0.001 to 100");
    let bad = FollowerSettings { max_innovation: [0.1, 3.2], ..FollowerSettings::HUMAN };
    assert_eq!(Follower::try_new(bad).unwrap_err().field, "innovation of the orientation");
}

#[test]
fn samples_after_a_pause_longer_than_the_clock_range_are_accepted() {
    for pause in [30_u32, 36, 50, 71, 72, 100] {
        for closed in [true, false] {
            let mut run = Run::new();
            run.until(0.6, &resting, &always);
            let time = Instant(run.now().0.wrapping_sub(DELAY));
            let now = run.now();
            run.follower.add_elbow_sample(&mut run.state, now, time, 0.5).unwrap();
            if closed {
                run.close().unwrap();
            }
            let start = run.now().0;
            for second in 1..=pause * 60 {
                let now = Instant(start.wrapping_add(second.wrapping_mul(1_000_000)));
                run.follower.tick(&mut run.state, now);
            }
            let now = Instant(start.wrapping_add(pause.wrapping_mul(60_000_000)));
            assert_eq!(
                run.follower.close_clutch(&mut run.state.clone(), now),
                Err(FollowerError::NoSample),
                "{pause}"
            );
            let time = Instant(now.0.wrapping_sub(DELAY));
            let (place, rotation) = resting(0.0);
            let mut take = |place: Vector3<f32>, elbow: f32| {
                let sample = MasterSample { time, position: place.into(), rotation: rotation.coords.into() };
                let taken = run.follower.add_sample(&mut run.state, now, &sample);
                taken.and_then(|()| run.follower.add_elbow_sample(&mut run.state, now, time, elbow))
            };
            // A closed clutch rejects a hand that has moved during the pause.
            if closed {
                let far = take(place + Vector3::y(), 0.5);
                assert!(matches!(far, Err(FollowerError::Distance { .. })), "{pause}: {far:?}");
            }
            assert_eq!(take(place, 0.5), Ok(()), "{pause}");
            assert_eq!(run.follower.close_clutch(&mut run.state, now), Ok(()));
        }
    }
}

#[test]
fn a_clutch_does_not_close_on_a_sample_of_an_hour_ago() {
    let mut run = Run::new();
    run.until(0.5, &resting, &always);
    // No tick in between.
    run.now += 3_000_000_000;
    assert_eq!(run.close(), Err(FollowerError::NoSample));
}

#[test]
fn samples_after_the_clock_was_set_back_are_accepted() {
    let mut run = following();
    let now = Instant(run.now().0.wrapping_sub(3_600_000_000 / 4));
    run.follower.tick(&mut run.state, now);
    let (place, rotation) = resting(0.0);
    let sample = MasterSample { time: now, position: place.into(), rotation: rotation.coords.into() };
    assert_eq!(run.follower.add_sample(&mut run.state, now, &sample), Ok(()));
}

/// Settings at their minima and maxima.
fn extremes() -> Vec<FollowerSettings> {
    let ends = |bit: u32, index: u32, [min, max]: [f32; 2]| if bit >> index & 1 == 1 { max } else { min };
    (0..256_u32)
        .map(|bits| {
            let (jerk_diffusion, tremor) = (ends(bits, 0, [0.01, 1e4]), ends(bits, 1, [1e-6, 0.1]));
            let model = OperatorModel { jerk_diffusion, tremor, noise: ends(bits, 2, [1e-6, 0.1]) };
            let (speed, acceleration) = (ends(bits, 3, [1e-3, 100.0]), ends(bits, 4, [1e-3, 1e4]));
            let limits = MotionLimits { speed, acceleration };
            FollowerSettings {
                position_model: model,
                rotation_model: model,
                elbow_model: model,
                scale: ends(bits, 5, [1e-3, 100.0]),
                max_innovation: [ends(bits, 6, [1e-4, 10.0]), ends(bits, 7, [1e-4, 3.0])],
                max_sample_age: 1.0,
                position_limits: limits,
                rotation_limits: limits,
                elbow_limits: limits,
                workspace: None,
            }
        })
        .collect()
}

#[test]
fn the_setpoint_is_finite_for_all_valid_settings_and_samples() {
    for settings in extremes() {
        let follower = Follower::try_new(settings).unwrap();
        for every in [1, 2, 30] {
            let mut state = FollowerState::at([0.0; 3], IDENTITY, 0.2);
            for step in 0..1000_u32 {
                let now = Instant(step * 10_000);
                let time = step as f32 * TICK;
                let place = Vector3::new(99.0, 0.0, 0.0) + waving(time).0;
                let (position, rotation) = (place.into(), waving(time).1.coords.into());
                // Two samples, a microsecond apart.
                for late in [1, 0] {
                    if step % every == 0 && step > 0 {
                        let time = Instant(now.0 - late);
                        let _ =
                            follower.add_sample(&mut state, now, &MasterSample { time, position, rotation });
                        let _ = follower.add_elbow_sample(&mut state, now, time, 0.3);
                    }
                }
                if step % 250 == 60 {
                    let _ = follower.close_clutch(&mut state, now);
                } else if step % 250 == 240 {
                    follower.open_clutch(&mut state);
                }
                let (point, elbow) = follower.tick(&mut state, now);
                let PosePoint { position, rotation, velocity, acceleration } = point;
                let numbers = [&position[..], &rotation, &velocity, &acceleration].concat();
                assert!(
                    numbers.iter().chain([&elbow.angle, &elbow.velocity]).all(|number| number.is_finite()),
                    "{step}: {point:?} {settings:?}"
                );
            }
        }
    }
}

#[test]
fn settings_and_samples_outside_their_limits_are_refused() {
    let human = FollowerSettings::HUMAN;
    type Change = fn(&mut FollowerSettings, f32);
    let change: [(&str, [f32; 2], Change); 6] = [
        ("jerk diffusion", [0.01, 1e4], |settings, value| settings.position_model.jerk_diffusion = value),
        ("tremor", [1e-6, 0.1], |settings, value| settings.rotation_model.tremor = value),
        ("noise", [1e-6, 0.1], |settings, value| settings.elbow_model.noise = value),
        ("speed", [1e-3, 100.0], |settings, value| settings.position_limits.speed = value),
        ("acceleration", [1e-3, 1e4], |settings, value| settings.elbow_limits.acceleration = value),
        ("innovation of the position", [1e-4, 10.0], |settings, value| settings.max_innovation[0] = value),
    ];
    for (field, [min, max], change) in change {
        let mut settings = human;
        for value in [min, max] {
            change(&mut settings, value);
            assert!(Follower::try_new(settings).is_ok(), "{field}");
        }
        for value in [1.01 * max, 1e30, f32::INFINITY, f32::NAN, 0.99 * min, 0.0, -min] {
            change(&mut settings, value);
            let bad = Follower::try_new(settings).unwrap_err();
            assert_eq!((bad.field, bad.min, bad.max), (field, min, max), "{value}");
        }
    }
    let settings =
        FollowerSettings { position_model: OperatorModel { tremor: 1e30, ..human.position_model }, ..human };
    let text = Follower::try_new(settings).unwrap_err().to_string();
    assert!(text.starts_with("tremor is 1000") && text.ends_with("; it must be 0.000001 to 0.1"), "{text}");

    let mut run = Run::new();
    run.now += 100_000;
    let (place, rotation) = resting(0.0);
    let far = run.take(0, (place + Vector3::x() * 1e38, rotation)).unwrap_err();
    assert!(far.to_string().ends_with("; it must be 0 to 100"), "{far}");
    let now = run.now();
    let twisted = run.follower.add_elbow_sample(&mut run.state, now, now, -1e38).unwrap_err();
    assert!(twisted.to_string().ends_with("; it must be -100 to 100"), "{twisted}");
}

/// A hand that moves 0.4 m beyond a border and returns, while it also moves along the border.
#[test]
fn the_set_point_stays_in_the_workspace_and_follows_along_its_border() {
    let workspace = Workspace { lower: [-1.0; 3], upper: [0.1, 1.0, 1.0] };
    let settings = FollowerSettings { workspace: Some(workspace), ..FollowerSettings::HUMAN };
    let follower = Follower::try_new(settings).unwrap();
    let mut state = FollowerState::at([0.0; 3], IDENTITY, 0.0);
    let hand = |time: f32| {
        let part = ((time - 0.5) / 1.8).clamp(0.0, 1.0);
        let there = 4.0 * part * (1.0 - part);
        [0.5 * there * there, 0.1 * (time - 0.5).max(0.0), 0.0]
    };
    let (mut point, mut farthest) = (follower.tick(&mut state, Instant(0)).0, 0.0_f32);
    for millisecond in (0..2500_u32).step_by(5) {
        let (time, now) = (millisecond as f32 * 1e-3, Instant(1000 * millisecond));
        let sample = MasterSample { time: now, position: hand(time), rotation: IDENTITY };
        follower.add_sample(&mut state, now, &sample).unwrap();
        if millisecond == 300 {
            follower.close_clutch(&mut state, now).unwrap();
        }
        if millisecond.is_multiple_of(10) {
            let before = core::mem::replace(&mut point, follower.tick(&mut state, now).0);
            assert!(workspace.contains(&point.position), "{time} s: {:?}", point.position);
            let change = (point.velocity[0] - before.velocity[0]).abs() / TICK;
            assert!(change < 1.01 * settings.position_limits.acceleration, "{time} s: {change} m/s²");
            farthest = farthest.max(point.position[0]);
            if millisecond > 600 {
                assert!((point.position[1] - hand(time)[1]).abs() < 2e-3, "{time} s: {:?}", point.position);
            }
        }
    }
    assert!(farthest > 0.099, "{farthest} m");
    // It has not slipped along x.
    assert!(point.position[0].abs() < 1e-3, "{:?}", point.position);

    // Outside the box it can only return.
    let mut state = FollowerState::at([0.15, 0.0, 0.0], IDENTITY, 0.0);
    for millisecond in (0..800_u32).step_by(10) {
        let (time, now) = (millisecond as f32 * 1e-3, Instant(1000 * millisecond));
        let position = [0.2 * (time - 0.3).max(0.0) * if time < 0.5 { 1.0 } else { -1.0 }, 0.0, 0.0];
        let _ =
            follower.add_sample(&mut state, now, &MasterSample { time: now, position, rotation: IDENTITY });
        if millisecond == 200 {
            follower.close_clutch(&mut state, now).unwrap();
        }
        point = follower.tick(&mut state, now).0;
        assert!(point.position[0] < 0.1501, "{time} s: {:?}", point.position);
    }
    assert!(point.position[0] < 0.14, "{:?}", point.position);

    for (upper, field) in
        [(-1.0, "side of the workspace along x, in m,"), (f32::NAN, "side of the workspace along x, in m,")]
    {
        let workspace = Workspace { upper: [upper, 1.0, 1.0], ..workspace };
        let refused =
            Follower::try_new(FollowerSettings { workspace: Some(workspace), ..settings }).unwrap_err();
        assert_eq!(refused.field, field);
    }
}

/// Only the elbow restarts; the tool continues.
#[test]
fn the_elbow_can_be_reset_while_the_tool_follows() {
    let mut run = Run::new();
    let hand = |time: f32| (Vector3::new(0.1 * (time - 0.5).max(0.0), 0.0, 0.0), UnitQuaternion::identity());
    run.until(0.4, &hand, &|_| true);
    run.close().unwrap();
    run.until(1.0, &hand, &|_| true);
    let velocity = run.point.velocity;
    run.state.reset_elbow(-0.7);
    let now = run.now();
    let (point, elbow) = run.follower.tick(&mut run.state, now);
    assert_eq!((elbow.angle, elbow.velocity, elbow.acceleration), (-0.7, 0.0, 0.0));
    assert!(run.state.is_clutch_closed() && (point.velocity[0] - velocity[0]).abs() < 0.02);
}
