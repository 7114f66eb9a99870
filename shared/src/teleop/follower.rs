use nalgebra::{Quaternion, UnitQuaternion, Vector1, Vector3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::hand::{Estimate, Moving};
use super::pace::Aim;
use super::turn::{turn, turned};
use super::{BadFollower, HandModel, Pace, Refused};
use crate::kinematics::{ElbowSetpoint, PosePoint};
use crate::{TICK, math};

/// The norm of a unit quaternion is this near to 1.
const UNIT: f32 = 1e-3;
/// Clocks that are set to each other differ by less than this [s].
const CLOCKS: f32 = 2e-3;
/// After so long without a sample nothing is left of the motion before [s].
const RESTS: f32 = 0.3;
/// After so long without a sample its time is forgotten [µs]: a small part of the half hour after which [`Instant`]s cannot be
/// told apart.
const FORGOTTEN: i32 = 10_000_000;
/// No hand is farther from where the master counts from [m].
const FARTHEST: f32 = 100.0;
/// No elbow is turned farther [rad].
const MOST_TURNED: f32 = 100.0;

/// A time of the clock that master and slave share: microseconds, which may wrap around.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Instant(pub u32);

impl Instant {
    /// How long it is after another [s], which must be within half an hour.
    #[expect(clippy::cast_precision_loss, reason = "exact below 16 s")]
    pub const fn since(self, other: Self) -> f32 {
        self.0.wrapping_sub(other.0).cast_signed() as f32 * 1e-6
    }

    /// A time longer ago than [`FORGOTTEN`] stays that long ago, so that a clock that wraps around does not make it seem later
    /// than now. So does one as far ahead, which only a clock that was set can make.
    fn forget(&mut self, now: Self) {
        if !(-FORGOTTEN..=FORGOTTEN).contains(&now.0.wrapping_sub(self.0).cast_signed()) {
            self.0 = now.0.wrapping_sub(FORGOTTEN.cast_unsigned());
        }
    }
}

/// Where the master's hand was.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct MasterSample {
    /// When.
    pub time: Instant,
    /// Position [m], in axes parallel to those of the slave's base.
    pub position: [f32; 3],
    /// Orientation as a unit quaternion, `[x, y, z, w]`.
    pub rotation: [f32; 4],
}

/// A setting: its name, its value, the least and the most that it may be.
pub(super) type Number = (&'static str, f32, [f32; 2]);

/// How a slave is to follow.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FollowerSettings {
    /// Of the hand's position.
    pub position: HandModel,
    /// Of its orientation.
    pub rotation: HandModel,
    /// Of the elbow's angle.
    pub elbow: HandModel,
    /// The tool's way for the hand's: 0.001 to 100.
    pub scale: f32,
    /// A sample that is farther from where the hand should be is refused [m, rad]: 0.1 mm to 10 m, 0.1 mrad to 3 rad,
    /// less than half a turn.
    pub jump: [f32; 2],
    /// A sample that is older is refused [s]: 0.001 to 1.
    pub oldest: f32,
    /// Of the tool's set-point [m/s, m/s²].
    pub travel: Pace,
    /// Of its orientation [rad/s, rad/s²].
    pub turn: Pace,
    /// Of the elbow's set-point [rad/s, rad/s²].
    pub swing: Pace,
}

impl FollowerSettings {
    /// For a person's arm at a master with encoders of 16 bits, and a gravity sensor at the elbow.
    ///
    /// The jerk of a hand that moves ±0.1 m at half a hertz changes by 10 m/s³ in a second, at the ends of a stroke of 0.2 m in
    /// 1.5 s by 4 or 7 at once; an unsupported hand trembles by some 0.05 mm along each axis.
    pub const HUMAN: Self = Self {
        position: HandModel { wander: 30.0, tremor: 2e-4, noise: 2e-5 },
        rotation: HandModel { wander: 80.0, tremor: 2e-4, noise: 1e-4 },
        elbow: HandModel { wander: 20.0, tremor: 1e-3, noise: 5e-3 },
        scale: 1.0,
        jump: [0.1, 0.5],
        oldest: 0.2,
        travel: Pace { speed: 1.0, acceleration: 8.0 },
        turn: Pace { speed: 4.0, acceleration: 40.0 },
        swing: Pace { speed: 2.0, acceleration: 20.0 },
    };
}

/// Makes set-points for a slave arm of what comes from a master.
#[derive(Clone, Copy, Debug)]
pub struct Follower {
    settings: FollowerSettings,
}

/// What a [`Follower`] knows of the hand, and where the set-point is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowerState {
    hand: Option<Hand>,
    elbow: Option<Elbow>,
    /// With the clutch closed.
    grip: Option<Grip>,
    place: Vector3<f32>,
    rotation: UnitQuaternion<f32>,
    velocity: Vector3<f32>,
    spin: Vector3<f32>,
    elbow_angle: Vector1<f32>,
    elbow_rate: Vector1<f32>,
}

/// As of the last sample.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Hand {
    time: Instant,
    position: Estimate<3>,
    /// The estimate of the rotation vector counts from here.
    rotation: UnitQuaternion<f32>,
    turn: Estimate<3>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Elbow {
    time: Instant,
    angle: Estimate<1>,
}

/// What lies between hand and tool.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Grip {
    /// The tool's place less the hand's, scaled.
    shift: Vector3<f32>,
    /// The tool's orientation seen from the hand.
    rotation: UnitQuaternion<f32>,
    /// Not without a sample of the elbow.
    elbow: Option<Vector1<f32>>,
}

impl FollowerState {
    /// The clutch open, the tool at rest: position [m], orientation `[x, y, z, w]`, angle of the elbow [rad].
    pub fn at(position: [f32; 3], [x, y, z, w]: [f32; 4], elbow: f32) -> Self {
        Self {
            hand: None,
            elbow: None,
            grip: None,
            place: position.into(),
            rotation: UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)),
            velocity: Vector3::zeros(),
            spin: Vector3::zeros(),
            elbow_angle: Vector1::new(elbow),
            elbow_rate: Vector1::zeros(),
        }
    }

    /// Whether the clutch is closed.
    pub const fn is_closed(&self) -> bool {
        self.grip.is_some()
    }
}

impl Hand {
    /// `time` after the last sample [s]: translations, and rotation vectors from the orientation.
    fn ahead(&self, time: f32) -> (Moving<3>, Moving<3>) {
        (self.position.ahead(time), self.turn.ahead(time))
    }
}

impl Follower {
    /// With settings that are checked.
    ///
    /// # Errors
    /// The first number that is wrong.
    pub fn try_new(settings: FollowerSettings) -> Result<Self, BadFollower> {
        let models = [&settings.position, &settings.rotation, &settings.elbow];
        let of_models = models.into_iter().flat_map(HandModel::numbers);
        let paces = [&settings.travel, &settings.turn, &settings.swing];
        let of_paces = paces.into_iter().flat_map(Pace::numbers);
        let [distance, angle] = settings.jump;
        let others = [
            ("scale", settings.scale, [1e-3, 100.0]),
            ("jump of the position", distance, [1e-4, 10.0]),
            ("jump of the orientation", angle, [1e-4, 3.0]),
            ("oldest", settings.oldest, [1e-3, 1.0]),
        ];
        let wrong = |&(_, value, [least, most]): &Number| !(least..=most).contains(&value);
        match of_models.chain(of_paces).chain(others).find(wrong) {
            Some((field, value, [least, limit])) => Err(BadFollower { field, value, least, limit }),
            None => Ok(Self { settings }),
        }
    }

    /// Takes a sample of the hand, which arrives `now`.
    ///
    /// # Errors
    /// Why it is not taken. One that was overtaken is no reason to worry.
    pub fn take(
        &self,
        state: &mut FollowerState,
        now: Instant,
        sample: &MasterSample,
    ) -> Result<(), Refused> {
        if !sample.position.iter().chain(&sample.rotation).all(|number| number.is_finite()) {
            return Err(Refused::NotFinite);
        }
        let [x, y, z, w] = sample.rotation;
        let rotation = Quaternion::new(w, x, y, z);
        let norm = math::sqrt(rotation.norm_squared());
        if math::abs(norm - 1.0) > UNIT {
            return Err(Refused::NotAUnit { norm });
        }
        let rotation = UnitQuaternion::new_unchecked(rotation * (1.0 / norm));
        let place = Vector3::from(sample.position);
        let passed = self.passed(now, sample.time, state.hand.map(|hand| hand.time))?;
        let value = math::sqrt(place.norm_squared());
        if value > FARTHEST {
            return Err(Refused::Distance { value, limit: FARTHEST });
        }

        let known = match (state.hand, passed) {
            (Some(hand), Some(passed)) => self.known(state, &hand, passed, &place, &rotation)?,
            _ => None,
        };
        let FollowerSettings { position: of_place, rotation: of_turn, .. } = &self.settings;
        let mut hand = known.unwrap_or_else(|| Hand {
            time: sample.time,
            position: Estimate::new(of_place, &place),
            rotation,
            turn: Estimate::new(of_turn, &Vector3::zeros()),
        });
        if let (Some(_), Some(passed)) = (known, passed) {
            hand.time = sample.time;
            hand.position.advance(of_place, passed);
            hand.position.correct(of_place, &place);
            hand.turn.advance(of_turn, passed);
            hand.rotation = turned(&hand.rotation, &hand.turn.rebase());
            hand.turn.correct(of_turn, &turn(&hand.rotation, &rotation));
            hand.rotation = turned(&hand.rotation, &hand.turn.rebase());
        }
        state.hand = Some(hand);
        Ok(())
    }

    /// Takes a sample of the elbow's angle [rad], of the time `time`, which arrives `now`.
    ///
    /// # Errors
    /// Why it is not taken. One that was overtaken is no reason to worry.
    pub fn take_elbow(
        &self,
        state: &mut FollowerState,
        now: Instant,
        time: Instant,
        angle: f32,
    ) -> Result<(), Refused> {
        if !angle.is_finite() {
            return Err(Refused::NotFinite);
        }
        let (model, sample) = (&self.settings.elbow, Vector1::new(angle));
        let passed = self.passed(now, time, state.elbow.map(|elbow| elbow.time))?;
        if math::abs(angle) > MOST_TURNED {
            return Err(Refused::Turn { value: math::abs(angle), limit: MOST_TURNED });
        }
        let mut estimate = Estimate::new(model, &sample);
        if let (Some(elbow), Some(passed)) = (state.elbow, passed) {
            let value = math::abs(angle - elbow.angle.ahead(passed).place.x);
            let [_, limit] = self.settings.jump;
            if value > limit && state.is_closed() {
                return Err(Refused::Turn { value, limit });
            }
            if value <= limit && passed <= RESTS {
                estimate = elbow.angle;
                estimate.advance(model, passed);
                estimate.correct(model, &sample);
            }
        }
        state.elbow = Some(Elbow { time, angle: estimate });
        Ok(())
    }

    /// Closes the clutch: hand and tool, as they are, belong together from now on. The hand counts as it was in its last
    /// sample, without tremor; what it has moved since then is made up for.
    ///
    /// # Errors
    /// Nobody knows where the hand is.
    pub fn close(&self, state: &mut FollowerState, now: Instant) -> Result<(), Refused> {
        let recent = |time: Instant| (-CLOCKS..=self.settings.oldest).contains(&now.since(time));
        let hand = state.hand.filter(|hand| recent(hand.time)).ok_or(Refused::NoSample)?;
        let elbow = state.elbow.filter(|elbow| recent(elbow.time));
        state.grip = Some(Grip {
            shift: state.place - hand.position.ahead(0.0).place * self.settings.scale,
            rotation: hand.rotation.inverse() * state.rotation,
            elbow: elbow.map(|elbow| state.elbow_angle - elbow.angle.ahead(0.0).place),
        });
        Ok(())
    }

    /// Opens the clutch: the tool comes to rest, whatever the hand does.
    pub const fn open(&self, state: &mut FollowerState) {
        state.grip = None;
    }

    /// The set-points for the control period that begins `now`. Called once a period.
    pub fn tick(&self, state: &mut FollowerState, now: Instant) -> (PosePoint, ElbowSetpoint) {
        let FollowerSettings { travel, turn: turning, swing, scale, .. } = &self.settings;
        let times = [
            state.hand.as_mut().map(|hand| &mut hand.time),
            state.elbow.as_mut().map(|elbow| &mut elbow.time),
        ];
        times.into_iter().flatten().for_each(|time| time.forget(now));
        let (acceleration, spin_up) = match (&state.grip, &state.hand) {
            (Some(grip), Some(hand)) => {
                let (moving, spinning) = hand.ahead(now.since(hand.time));
                let rotation = turned(&hand.rotation, &spinning.place) * grip.rotation;
                let place = Aim {
                    way: moving.place * *scale + grip.shift - state.place,
                    velocity: moving.velocity * *scale,
                    acceleration: moving.acceleration * *scale,
                };
                let orientation = Aim {
                    way: turn(&state.rotation, &rotation),
                    velocity: spinning.velocity,
                    acceleration: spinning.acceleration,
                };
                (
                    travel.acceleration(&state.velocity, &place),
                    turning.acceleration(&state.spin, &orientation),
                )
            }
            _ => (travel.stop(&state.velocity), turning.stop(&state.spin)),
        };
        let offset = state.grip.and_then(|grip| grip.elbow);
        let elbow_acceleration = match (offset, &state.elbow) {
            (Some(offset), Some(elbow)) => {
                let Moving { place, velocity, acceleration } = elbow.angle.ahead(now.since(elbow.time));
                let aim = Aim { way: place + offset - state.elbow_angle, velocity, acceleration };
                swing.acceleration(&state.elbow_rate, &aim)
            }
            _ => swing.stop(&state.elbow_rate),
        };
        let point = PosePoint {
            position: state.place.into(),
            rotation: state.rotation.coords.into(),
            velocity: joined(&state.velocity, &state.spin),
            acceleration: joined(&acceleration, &spin_up),
        };
        let elbow = ElbowSetpoint {
            angle: state.elbow_angle.x,
            velocity: state.elbow_rate.x,
            acceleration: elbow_acceleration.x,
        };
        let half = 0.5 * TICK * TICK;
        state.place += state.velocity * TICK + acceleration * half;
        state.velocity += acceleration * TICK;
        state.rotation = turned(&state.rotation, &(state.spin * TICK + spin_up * half));
        state.spin += spin_up * TICK;
        state.elbow_angle += state.elbow_rate * TICK + elbow_acceleration * half;
        state.elbow_rate += elbow_acceleration * TICK;
        (point, elbow)
    }

    /// How long after the last sample another was taken [s], `None` for the first.
    fn passed(&self, now: Instant, time: Instant, last: Option<Instant>) -> Result<Option<f32>, Refused> {
        let (value, limit) = (now.since(time), self.settings.oldest);
        if !(-CLOCKS..=limit).contains(&value) {
            return Err(Refused::Age { value, limit });
        }
        let Some(last) = last else { return Ok(None) };
        let passed = time.since(last);
        if passed <= 0.0 { Err(Refused::Overtaken { by: -passed }) } else { Ok(Some(passed)) }
    }

    /// What is known of the hand, if that is of use for a sample `passed` after the last [s].
    fn known(
        &self,
        state: &FollowerState,
        hand: &Hand,
        passed: f32,
        place: &Vector3<f32>,
        rotation: &UnitQuaternion<f32>,
    ) -> Result<Option<Hand>, Refused> {
        let (moving, spinning) = hand.ahead(passed);
        let distance = math::sqrt((place - moving.place).norm_squared());
        let angle = math::sqrt(turn(&turned(&hand.rotation, &spinning.place), rotation).norm_squared());
        let [far, twisted] = self.settings.jump;
        if distance <= far && angle <= twisted {
            return Ok((passed <= RESTS).then_some(*hand));
        }
        // With an open clutch the hand may be anywhere.
        match state.is_closed() {
            false => Ok(None),
            true if distance > far => Err(Refused::Distance { value: distance, limit: far }),
            true => Err(Refused::Turn { value: angle, limit: twisted }),
        }
    }
}

/// `[v; ω]`.
fn joined(linear: &Vector3<f32>, angular: &Vector3<f32>) -> [f32; 6] {
    [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
}
