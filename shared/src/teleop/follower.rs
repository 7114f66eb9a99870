use nalgebra::{UnitQuaternion, Vector1, Vector3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::operator_estimate::{OperatorEstimate, PredictedMotion};
use super::{FollowerError, OperatorModel, Workspace};
use crate::kinematics::{ElbowSetpoint, PosePoint};
use crate::math::{self, orientation, rotated_by, rotation_between};
use crate::signal::{MotionLimits, MotionTarget};
use crate::{OutOfRange, TICK};

/// Tolerance of the norm of a unit quaternion.
const NORM_TOLERANCE: f32 = 1e-3;
/// Tolerance of clock synchronisation [s].
const CLOCK_TOLERANCE: f32 = 2e-3;
/// A gap between samples longer than this resets the estimator [s].
const MAX_GAP: f32 = 0.3;
/// Older time stamps are limited to this age [µs], far below the half hour at which [`Instant`]s become
/// ambiguous.
const MAX_KEPT_AGE: i32 = 10_000_000;
/// Maximum distance of the operator's hand from the master's origin [m].
const MAX_DISTANCE: f32 = 100.0;
/// Maximum elbow angle [rad].
const MAX_ELBOW_ANGLE: f32 = 100.0;

/// A time of the clock that master and slave share, in microseconds. It may wrap around.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Instant(pub u32);

impl Instant {
    /// Time since `other` [s], which must be within half an hour.
    #[expect(clippy::cast_precision_loss, reason = "exact below 16 s")]
    pub const fn since(self, other: Self) -> f32 {
        self.0.wrapping_sub(other.0).cast_signed() as f32 * 1e-6
    }

    /// Limits the age to [`MAX_KEPT_AGE`], so that wrap-around of the clock cannot make an old time a future
    /// one. A time that far in the future, possible only after the clock was set, is limited likewise.
    fn limit_age(&mut self, now: Self) {
        if !(-MAX_KEPT_AGE..=MAX_KEPT_AGE).contains(&now.0.wrapping_sub(self.0).cast_signed()) {
            self.0 = now.0.wrapping_sub(MAX_KEPT_AGE.cast_unsigned());
        }
    }
}

/// A measured pose of the operator's hand.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct MasterSample {
    /// Time of the measurement.
    pub time: Instant,
    /// Position [m], in axes parallel to those of the slave's base.
    pub position: [f32; 3],
    /// Orientation as a unit quaternion, `[x, y, z, w]`.
    pub rotation: [f32; 4],
}

/// A setting: name, value, minimum and maximum.
pub(super) type Setting = (&'static str, f32, [f32; 2]);

/// Settings of a [`Follower`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FollowerSettings {
    /// Model of the hand's position.
    pub position_model: OperatorModel,
    /// Model of the hand's orientation.
    pub rotation_model: OperatorModel,
    /// Model of the elbow's angle.
    pub elbow_model: OperatorModel,
    /// Tool displacement per hand displacement: 0.001 to 100.
    pub scale: f32,
    /// Innovation gate for position [m] and orientation [rad]: 0.1 mm to 10 m, 0.1 mrad to 3 rad. Samples
    /// beyond it are rejected.
    pub max_innovation: [f32; 2],
    /// Maximum age of a sample [s]: 0.001 to 1.
    pub max_sample_age: f32,
    /// Limits of the tool's translation [m/s, m/s²]: speed 0.001 to 100, acceleration 0.001 to 10⁴, here and
    /// below.
    pub position_limits: MotionLimits,
    /// Limits of the tool's rotation [rad/s, rad/s²].
    pub rotation_limits: MotionLimits,
    /// Limits of the elbow's angle [rad/s, rad/s²].
    pub elbow_limits: MotionLimits,
    /// Box in which the set-point of the tool stays. If the hand is beyond it, the tool follows along the
    /// border.
    pub workspace: Option<Workspace>,
}

impl FollowerSettings {
    /// Settings for a human operator, a master with 16-bit encoders and a gravity sensor at the elbow.
    ///
    /// Strokes of ±0.1 m at 0.5 Hz change the jerk by 10 m/s³ per second, the ends of a stroke of 0.2 m in
    /// 1.5 s by a step of 4 to 7 m/s³; the tremor of an unsupported hand is about 0.05 mm per axis.
    pub const HUMAN: Self = Self {
        position_model: OperatorModel { jerk_diffusion: 30.0, tremor: 2e-4, noise: 2e-5 },
        rotation_model: OperatorModel { jerk_diffusion: 80.0, tremor: 2e-4, noise: 1e-4 },
        elbow_model: OperatorModel { jerk_diffusion: 20.0, tremor: 1e-3, noise: 5e-3 },
        scale: 1.0,
        max_innovation: [0.1, 0.5],
        max_sample_age: 0.2,
        position_limits: MotionLimits { speed: 1.0, acceleration: 8.0 },
        rotation_limits: MotionLimits { speed: 4.0, acceleration: 40.0 },
        elbow_limits: MotionLimits { speed: 2.0, acceleration: 20.0 },
        workspace: None,
    };
}

/// Computes set-points of a slave arm from the samples of a master.
#[derive(Clone, Copy, Debug)]
pub struct Follower {
    settings: FollowerSettings,
}

/// State of a [`Follower`]: estimate of the operator and present set-point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowerState {
    hand: Option<OperatorHand>,
    elbow: Option<Elbow>,
    /// Offsets; `None` while the clutch is open.
    clutch: Option<ClutchOffset>,
    position: Vector3<f32>,
    rotation: UnitQuaternion<f32>,
    velocity: Vector3<f32>,
    angular_velocity: Vector3<f32>,
    elbow_angle: Vector1<f32>,
    elbow_velocity: Vector1<f32>,
}

/// Estimate at the last sample.
#[derive(Clone, Copy, Debug, PartialEq)]
struct OperatorHand {
    time: Instant,
    position: OperatorEstimate<3>,
    /// Origin of the rotation vector.
    rotation: UnitQuaternion<f32>,
    rotation_vector: OperatorEstimate<3>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Elbow {
    time: Instant,
    angle: OperatorEstimate<1>,
}

/// Offset between operator's hand and tool while the clutch is closed.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ClutchOffset {
    /// Tool position minus scaled hand position [m].
    translation: Vector3<f32>,
    /// Tool orientation in the frame of the hand.
    rotation: UnitQuaternion<f32>,
    /// Elbow offset [rad]; `None` without a sample of the elbow.
    elbow: Option<Vector1<f32>>,
}

impl FollowerState {
    /// The state with open clutch and the tool at rest at `position` [m], the unit quaternion `rotation`,
    /// `[x, y, z, w]`, and elbow angle [rad].
    pub fn at(position: [f32; 3], rotation: [f32; 4], elbow: f32) -> Self {
        Self {
            hand: None,
            elbow: None,
            clutch: None,
            position: position.into(),
            rotation: orientation(rotation),
            velocity: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
            elbow_angle: Vector1::new(elbow),
            elbow_velocity: Vector1::zeros(),
        }
    }

    /// Moves the set-point of the elbow to an angle [rad] at rest, for an arm whose elbow is elsewhere. The
    /// elbow does not follow the operator until the clutch closes again.
    pub fn reset_elbow(&mut self, angle: f32) {
        (self.elbow_angle, self.elbow_velocity) = (Vector1::new(angle), Vector1::zeros());
        if let Some(clutch) = &mut self.clutch {
            clutch.elbow = None;
        }
    }

    /// Estimated velocity of the hand at its last sample [m/s]; 0 without a sample.
    pub fn hand_velocity(&self) -> Vector3<f32> {
        self.hand.map_or_else(Vector3::zeros, |hand| hand.position.predict(0.0).velocity)
    }

    /// Whether the clutch is closed.
    pub const fn is_clutch_closed(&self) -> bool {
        self.clutch.is_some()
    }
}

impl OperatorHand {
    /// Prediction `time` after the last sample [s]: translation, and rotation vector from `rotation`.
    fn predict(&self, time: f32) -> (PredictedMotion<3>, PredictedMotion<3>) {
        (self.position.predict(time), self.rotation_vector.predict(time))
    }
}

impl Follower {
    /// Checks the settings.
    ///
    /// # Errors
    /// The first value outside its limits. Each side of a workspace is 1 mm to 100 m long.
    pub fn try_new(settings: FollowerSettings) -> Result<Self, OutOfRange> {
        let models = [&settings.position_model, &settings.rotation_model, &settings.elbow_model];
        let of_models = models.into_iter().flat_map(OperatorModel::settings);
        let limits = [&settings.position_limits, &settings.rotation_limits, &settings.elbow_limits];
        let of_limits = limits.into_iter().flat_map(|limits| {
            [("speed", limits.speed, [1e-3, 100.0]), ("acceleration", limits.acceleration, [1e-3, 1e4])]
        });
        let [distance, angle] = settings.max_innovation;
        let others = [
            ("scale", settings.scale, [1e-3, 100.0]),
            ("innovation of the position", distance, [1e-4, 10.0]),
            ("innovation of the orientation", angle, [1e-4, 3.0]),
            ("sample age", settings.max_sample_age, [1e-3, 1.0]),
        ];
        let of_workspace = settings.workspace.iter().flat_map(|Workspace { lower, upper }| {
            let sides = [
                "side of the workspace along x, in m,",
                "side of the workspace along y, in m,",
                "side of the workspace along z, in m,",
            ]
            .into_iter()
            .zip(lower.iter().zip(upper));
            sides.map(|(axis, (lower, upper))| (axis, upper - lower, [1e-3, 100.0]))
        });
        for (field, value, range) in of_models.chain(of_limits).chain(others).chain(of_workspace) {
            OutOfRange::check(field, value, range)?;
        }
        Ok(Self { settings })
    }

    /// Adds a sample of the hand that arrives `now`.
    ///
    /// # Errors
    /// The sample is invalid, out of order, too old or beyond the innovation gate. Out-of-order samples are
    /// normal on a link that reorders.
    pub fn add_sample(
        &self,
        state: &mut FollowerState,
        now: Instant,
        sample: &MasterSample,
    ) -> Result<(), FollowerError> {
        if !sample.position.iter().chain(&sample.rotation).all(|number| number.is_finite()) {
            return Err(FollowerError::NotFinite);
        }
        let rotation = math::quaternion(sample.rotation);
        let norm = math::sqrt(rotation.norm_squared());
        if math::abs(norm - 1.0) > NORM_TOLERANCE {
            return Err(FollowerError::NotUnit { norm });
        }
        let rotation = UnitQuaternion::new_unchecked(rotation * (1.0 / norm));
        let position = Vector3::from(sample.position);
        let elapsed = self.time_since_last(now, sample.time, state.hand.map(|hand| hand.time))?;
        OutOfRange::check("distance of the hand", math::norm(&position), [0.0, MAX_DISTANCE])
            .map_err(FollowerError::OutOfRange)?;

        let estimate = match (state.hand, elapsed) {
            (Some(hand), Some(elapsed)) => self.gate(state, &hand, elapsed, &position, &rotation)?,
            _ => None,
        };
        let FollowerSettings { position_model, rotation_model, .. } = &self.settings;
        let mut hand = estimate.unwrap_or_else(|| OperatorHand {
            time: sample.time,
            position: OperatorEstimate::new(position_model, &position),
            rotation,
            rotation_vector: OperatorEstimate::new(rotation_model, &Vector3::zeros()),
        });
        if let (Some(_), Some(elapsed)) = (estimate, elapsed) {
            hand.time = sample.time;
            hand.position.advance(position_model, elapsed);
            hand.position.correct(position_model, &position);
            hand.rotation_vector.advance(rotation_model, elapsed);
            hand.rotation = rotated_by(&hand.rotation, &hand.rotation_vector.rebase());
            hand.rotation_vector.correct(rotation_model, &rotation_between(&hand.rotation, &rotation));
            hand.rotation = rotated_by(&hand.rotation, &hand.rotation_vector.rebase());
        }
        state.hand = Some(hand);
        Ok(())
    }

    /// Adds a sample of the elbow angle [rad], measured at `time`, that arrives `now`.
    ///
    /// # Errors
    /// The same as for [`Self::add_sample`].
    pub fn add_elbow_sample(
        &self,
        state: &mut FollowerState,
        now: Instant,
        time: Instant,
        angle: f32,
    ) -> Result<(), FollowerError> {
        if !angle.is_finite() {
            return Err(FollowerError::NotFinite);
        }
        let (model, sample) = (&self.settings.elbow_model, Vector1::new(angle));
        let elapsed = self.time_since_last(now, time, state.elbow.map(|elbow| elbow.time))?;
        OutOfRange::check("angle of the elbow", angle, [-MAX_ELBOW_ANGLE, MAX_ELBOW_ANGLE])
            .map_err(FollowerError::OutOfRange)?;
        let mut estimate = OperatorEstimate::new(model, &sample);
        if let (Some(elbow), Some(elapsed)) = (state.elbow, elapsed) {
            let value = math::abs(angle - elbow.angle.predict(elapsed).position.x);
            let [_, limit] = self.settings.max_innovation;
            if value > limit && state.is_clutch_closed() {
                return Err(FollowerError::Angle { value, limit });
            }
            if value <= limit && elapsed <= MAX_GAP {
                estimate = elbow.angle;
                estimate.advance(model, elapsed);
                estimate.correct(model, &sample);
            }
        }
        state.elbow = Some(Elbow { time, angle: estimate });
        Ok(())
    }

    /// Closes the clutch: stores the offsets between hand and tool. The hand's pose is its estimate at the
    /// last sample without tremor; the motion since then is followed.
    ///
    /// # Errors
    /// There is no recent sample of the hand.
    pub fn close_clutch(&self, state: &mut FollowerState, now: Instant) -> Result<(), FollowerError> {
        let recent =
            |time: Instant| (-CLOCK_TOLERANCE..=self.settings.max_sample_age).contains(&now.since(time));
        let hand = state.hand.filter(|hand| recent(hand.time)).ok_or(FollowerError::NoSample)?;
        let elbow = state.elbow.filter(|elbow| recent(elbow.time));
        state.clutch = Some(ClutchOffset {
            translation: state.position - hand.position.predict(0.0).position * self.settings.scale,
            rotation: hand.rotation.inverse() * state.rotation,
            elbow: elbow.map(|elbow| state.elbow_angle - elbow.angle.predict(0.0).position),
        });
        Ok(())
    }

    /// Opens the clutch: the tool comes to rest, independent of the hand.
    pub const fn open_clutch(&self, state: &mut FollowerState) {
        state.clutch = None;
    }

    /// Returns the set-points for the control period that begins `now`. Call it once per period.
    pub fn tick(&self, state: &mut FollowerState, now: Instant) -> (PosePoint, ElbowSetpoint) {
        let FollowerSettings { position_limits, rotation_limits, elbow_limits, scale, .. } = &self.settings;
        let times = [
            state.hand.as_mut().map(|hand| &mut hand.time),
            state.elbow.as_mut().map(|elbow| &mut elbow.time),
        ];
        times.into_iter().flatten().for_each(|time| time.limit_age(now));
        let (acceleration, angular_acceleration) = match (&state.clutch, &state.hand) {
            (Some(clutch), Some(hand)) => {
                let (translation, rotation_vector) = hand.predict(now.since(hand.time));
                let rotation = rotated_by(&hand.rotation, &rotation_vector.position) * clutch.rotation;
                let position = MotionTarget {
                    offset: translation.position * *scale + clutch.translation - state.position,
                    velocity: translation.velocity * *scale,
                    acceleration: translation.acceleration * *scale,
                };
                let orientation = MotionTarget {
                    offset: rotation_between(&state.rotation, &rotation),
                    velocity: rotation_vector.velocity,
                    acceleration: rotation_vector.acceleration,
                };
                (
                    position_limits.acceleration(&state.velocity, &position),
                    rotation_limits.acceleration(&state.angular_velocity, &orientation),
                )
            }
            _ => (position_limits.stop(&state.velocity), rotation_limits.stop(&state.angular_velocity)),
        };
        let acceleration = match &self.settings.workspace {
            Some(workspace) => {
                workspace.limit(position_limits, &state.position, &state.velocity, &acceleration)
            }
            None => acceleration,
        };
        let offset = state.clutch.and_then(|clutch| clutch.elbow);
        let elbow_acceleration = match (offset, &state.elbow) {
            (Some(offset), Some(elbow)) => {
                let PredictedMotion { position, velocity, acceleration } =
                    elbow.angle.predict(now.since(elbow.time));
                let target =
                    MotionTarget { offset: position + offset - state.elbow_angle, velocity, acceleration };
                elbow_limits.acceleration(&state.elbow_velocity, &target)
            }
            _ => elbow_limits.stop(&state.elbow_velocity),
        };
        let point = PosePoint {
            position: state.position.into(),
            rotation: state.rotation.coords.into(),
            velocity: math::stack([state.velocity, state.angular_velocity]).into(),
            acceleration: math::stack([acceleration, angular_acceleration]).into(),
        };
        let elbow = ElbowSetpoint {
            angle: state.elbow_angle.x,
            velocity: state.elbow_velocity.x,
            acceleration: elbow_acceleration.x,
        };
        let half = 0.5 * TICK * TICK;
        state.position += state.velocity * TICK + acceleration * half;
        state.velocity += acceleration * TICK;
        state.rotation =
            rotated_by(&state.rotation, &(state.angular_velocity * TICK + angular_acceleration * half));
        state.angular_velocity += angular_acceleration * TICK;
        state.elbow_angle += state.elbow_velocity * TICK + elbow_acceleration * half;
        state.elbow_velocity += elbow_acceleration * TICK;
        (point, elbow)
    }

    /// Time from the last sample to this one [s]; `None` for the first.
    fn time_since_last(
        &self,
        now: Instant,
        time: Instant,
        last: Option<Instant>,
    ) -> Result<Option<f32>, FollowerError> {
        let (value, limit) = (now.since(time), self.settings.max_sample_age);
        if !(-CLOCK_TOLERANCE..=limit).contains(&value) {
            return Err(FollowerError::Age { value, limit });
        }
        let Some(last) = last else { return Ok(None) };
        let elapsed = time.since(last);
        if elapsed <= 0.0 { Err(FollowerError::OutOfOrder { by: -elapsed }) } else { Ok(Some(elapsed)) }
    }

    /// Innovation gate: the estimate to update with a sample `elapsed` after the last one [s]; `None` if the
    /// estimator must restart.
    fn gate(
        &self,
        state: &FollowerState,
        hand: &OperatorHand,
        elapsed: f32,
        position: &Vector3<f32>,
        rotation: &UnitQuaternion<f32>,
    ) -> Result<Option<OperatorHand>, FollowerError> {
        let (translation, rotation_vector) = hand.predict(elapsed);
        let distance = math::norm(&(position - translation.position));
        let angle = math::sqrt(
            rotation_between(&rotated_by(&hand.rotation, &rotation_vector.position), rotation).norm_squared(),
        );
        let [max_distance, max_angle] = self.settings.max_innovation;
        if distance <= max_distance && angle <= max_angle {
            return Ok((elapsed <= MAX_GAP).then_some(*hand));
        }
        // With an open clutch the hand may be anywhere.
        match state.is_clutch_closed() {
            false => Ok(None),
            true if distance > max_distance => {
                Err(FollowerError::Distance { value: distance, limit: max_distance })
            }
            true => Err(FollowerError::Angle { value: angle, limit: max_angle }),
        }
    }
}
